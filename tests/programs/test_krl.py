"""KUKA KRL: targets, frames and notes of the sample programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robacc.errors import InputError
from robacc.programs.program import Program, read_program

SAMPLES = Path(__file__).parent / "samples"


def notes(program: Program) -> dict[int, str]:
    return {note.line: note.reason for note in program.notes}


def line_of(name: str, start: str) -> int:
    lines = (SAMPLES / name).read_text(encoding="cp1252").splitlines()
    return next(k for k, line in enumerate(lines, start=1) if line.strip().startswith(start))


def test_inline_forms_give_tool_and_base_by_number() -> None:
    program = read_program(SAMPLES / "weld.dat", [SAMPLES / "config.dat"])
    assert [t.name for t in program.targets] == ["XP1", "XP2", "XP3", "XP4"]
    assert program.moves == (0, 1, 2, 3)
    assert all(t.tool is not None and t.tool.name == "3" for t in program.targets)
    first = program.targets[0]
    np.testing.assert_allclose(first.tool.frame.xyz, (0.0875, 0, 0.41225))
    np.testing.assert_allclose(first.tool.frame.rpy, np.radians([0, -45, 0]), atol=1e-15)
    np.testing.assert_allclose(first.base.frame.rpy, np.radians([0, 0, 90]), atol=1e-15)
    assert first.configuration == "S 18,T 2"


def test_abc_is_rz_ry_rx() -> None:
    program = read_program(SAMPLES / "weld.dat")
    target = program.targets[1]
    np.testing.assert_allclose(target.values[:3], (1.58776917, -0.890400757, 0.439605072))
    x, y, z, w = Rotation.from_euler("ZYX", (177.082932, 4.31955290, -0.298484027), degrees=True).as_quat()
    expected = np.array((w, x, y, z))
    np.testing.assert_allclose(target.values[3:], expected * np.sign(w), atol=1e-15)


def test_a_src_names_the_file_that_declares_its_targets() -> None:
    program = read_program(SAMPLES / "weld.src")
    assert program.targets == ()
    reasons = notes(program)
    assert "4 targets are declared in weld.dat" in " ".join(reasons.values())
    assert reasons[line_of("weld.src", "PTP  XHOME")] == "the target's numbers are in none of the files read"


def test_literals_of_motions_and_of_single_assignments_are_targets() -> None:
    program = read_program(SAMPLES / "expert.src", [SAMPLES / "config.dat"])
    by_line = {target.line: target for target in program.targets}
    joint = by_line[line_of("expert.src", "PTP {A1 10.0")]
    np.testing.assert_allclose(joint.values, np.radians([10, -95.5, 100.25, 0, 85.25, -10]))
    np.testing.assert_allclose(joint.tool.frame.xyz, (0.0125, 0, 0.21075))
    assert {line_of("expert.src", start) for start in ("ptp {E6AXIS", "target =")} <= {*by_line}


def test_a_tool_set_in_a_branch_is_unknown_after_it() -> None:
    program = read_program(SAMPLES / "expert.src", [SAMPLES / "config.dat"])
    by_line = {target.line: target for target in program.targets}
    inside, after = (by_line[line_of("expert.src", f"LIN {{X {x}.0")] for x in (840, 850))
    assert inside.tool.name == "2"
    assert after.tool is None
    assert after.base.name == "4"


@pytest.mark.parametrize(
    ("start", "reason"),
    [
        ("LIN target : lift", "the target is computed at run time"),
        ("LIN {X 830.0}", "the instruction leaves numbers of the target out or computes them"),
        ("LIN_REL", "a relative motion has no target of its own"),
        ("PTP_REL", "a relative motion has no target of its own"),
    ],
)
def test_what_is_computed_at_run_time_is_listed(start: str, reason: str) -> None:
    assert notes(read_program(SAMPLES / "expert.src"))[line_of("expert.src", start)] == reason


def test_targets_that_the_program_changes_are_left_alone() -> None:
    program = read_program(SAMPLES / "expert.dat")
    assert [target.name for target in program.targets] == ["unused", "PARK"]
    reasons = [(note.text.partition(":")[0], note.reason) for note in program.notes]
    line = line_of("expert.src", "pallet.X")
    assert ("pallet", f"the program assigns it at run time in line {line} of expert.src") in reasons
    assert ("fixture", "is a FRAME that no motion of the files read goes to") in reasons


def test_spline_motions_name_their_frames_themselves() -> None:
    program = read_program(SAMPLES / "spline.dat", [SAMPLES / "config.dat"])
    by_name = {target.name: target for target in program.targets}
    first = by_name["XP1"]
    assert (first.tool.name, first.base.name) == ("1", "0")
    np.testing.assert_allclose(first.tool.frame.xyz, (0, 0, 0.15))
    moving = by_name["XS[3]"]
    assert moving.base.frame is None, "a base on a moving unit is not known from the text"


def test_a_huge_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robacc.programs.program.PROGRAM_LIMIT", 1000)
    path = tmp_path / "huge.src"
    path.write_bytes(b"DEF a()\r\n" + b"; text\r\n" * 1000 + b"END\r\n")
    with pytest.raises(InputError, match="is larger than"):
        read_program(path)


def test_a_component_that_is_computed_makes_no_target(tmp_path: Path) -> None:
    path = tmp_path / "a.src"
    path.write_bytes(b"DEF a()\nLIN {X nHeight,Y 0,Z 0,A 0,B 0,C 0}\nLIN {X 1+2,Y 0,Z 0,A 0,B 0,C 0}\nEND\n")
    program = read_program(path)
    assert program.targets == ()
    assert sorted(notes(program)) == [2, 3]


def test_a_declared_target_with_a_broken_aggregate_is_listed(tmp_path: Path) -> None:
    path = tmp_path / "a.dat"
    path.write_bytes(b"DEFDAT a\nDECL E6POS XP1={X 1,Y 2]0,Z 3,A 0,B 0,C 0}\nENDDAT\n")
    assert notes(read_program(path)) == {2: "XP1 lacks some of the numbers of a target"}
