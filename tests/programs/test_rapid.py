"""ABB RAPID: targets, frames and notes of the sample modules."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robacc.programs.program import Program, ProgramTarget, read_program

SAMPLES = Path(__file__).parent / "samples"


def by_name(program: Program) -> dict[str, ProgramTarget]:
    return {target.name: target for target in program.targets}


def reasons(program: Program) -> list[str]:
    return [note.reason for note in program.notes]


def test_targets_have_tool_and_work_object() -> None:
    targets = by_name(read_program(SAMPLES / "glue.mod"))
    assert list(targets) == ["p10", "p20", "p30", "jHome"]
    np.testing.assert_allclose(targets["jHome"].values, np.radians([0, -20.5, 30, 0, 80.25, -10]))
    p20 = targets["p20"]
    np.testing.assert_allclose(p20.values, (0.506291651, -0.150257853, 0.679799999, 0.5, 0, 0.866025404, 0), atol=1e-9)
    np.testing.assert_allclose(p20.tool.frame.xyz, (0.031792631019, 0, 0.229638935148))
    # The object frame lies in the user frame, which is turned by 90 degrees about z.
    np.testing.assert_allclose(p20.base.frame.xyz, (0.98, -0.03, 0.83), atol=1e-9)
    np.testing.assert_allclose(p20.base.frame.rpy, (0, 0, np.pi / 2), atol=1e-8)
    moving = targets["p30"]
    assert moving.base.frame is None
    assert moving.configuration == "[0,-2,-1,4]"


def test_quaternions_begin_with_the_scalar() -> None:
    target = by_name(read_program(SAMPLES / "glue.mod"))["p10"]
    w, x, y, z = target.values[3:]
    rotation = Rotation.from_quat((x, y, z, w)).as_matrix()
    expected = Rotation.from_quat((0.727571, 0.686033, -2.82384e-06, 1.13796e-06)).as_matrix()
    np.testing.assert_allclose(rotation, expected, atol=1e-12)


def test_offs_and_reltool_are_listed() -> None:
    program = read_program(SAMPLES / "glue.mod")
    assert [note.text for note in program.notes] == ["MoveL Offs(p20,0,0,100),v100,fine,tGlue\\WObj:=wDoor;"]
    assert reasons(program) == ["the target is computed at run time"]


def test_elements_of_an_array_are_targets() -> None:
    program = read_program(SAMPLES / "array.mod")
    assert [target.name for target in program.targets] == ["cube{1}", "cube{2}", "cube{3}"]
    assert program.moves == (0, 1, 2, 1)
    assert reasons(program) == ["the target is computed at run time"]


def test_names_are_local_to_their_routine() -> None:
    program = read_program(SAMPLES / "literal.mod")
    assert [target.name for target in program.targets].count("pLocal") == 1
    local = by_name(program)["pLocal"]
    np.testing.assert_allclose(local.values[:3], (0.007, 0.008, 0.009))
    assert "the program assigns it at run time in line 12" in reasons(program)


def test_literals_of_instructions_are_targets() -> None:
    program = read_program(SAMPLES / "literal.mod")
    kinds = [target.kind for target in program.targets if target.name != "pLocal"]
    assert kinds == ["joint", *["cartesian"] * 4]
    assert program.moves == (0, 1, 2, 3, 4, 5)
    assert "the target is computed at run time" in reasons(program)


def test_search_points_and_displacements_are_listed() -> None:
    program = read_program(SAMPLES / "weldline.mod", [SAMPLES / "cell.sys"])
    targets = by_name(program)
    assert list(targets) == ["pW10", "pW20", "pSearch"]
    assert "the program assigns it at run time in line 11" in reasons(program)
    assert "pBad lacks some of the numbers of a robtarget" in reasons(program)
    assert any(reason.startswith("PDispOn moves targets") for reason in reasons(program))
    weld = targets["pW20"]
    np.testing.assert_allclose(weld.tool.frame.xyz, (0, 0, 0.4005))
    assert targets["pW10"].tool is None, "two tools go to it"


@pytest.mark.slow
def test_ten_thousand_targets_take_linear_time(tmp_path: Path) -> None:
    unused = "[9E9,9E9,9E9,9E9,9E9,9E9]"
    lines = [f"CONST robtarget p{i}:=[[{i},0,1],[1,0,0,0],[0,0,0,0],{unused}];" for i in range(10_000)]
    moves = [f"MoveL p{i},v100,fine,tool0;" for i in range(10_000)]
    path = tmp_path / "large.mod"
    path.write_text("\n".join(["MODULE a", *lines, "PROC main()", *moves, "ENDPROC", "ENDMODULE"]), encoding="ascii")
    program = read_program(path)
    assert len(program.targets) == len(program.moves) == 10_000
    np.testing.assert_allclose([target.values[0] for target in program.targets], np.arange(10_000) * 1e-3)
