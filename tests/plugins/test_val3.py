"""Staubli VAL3 data files: points in nested frames, tools of the programs beside them, and what is left alone."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robacc.errors import InputError, UsageError
from robacc.programs.program import Program, ProgramTarget, read_program
from robacc.programs.targets import flange_targets, with_targets, write_program

SAMPLES = Path(__file__).parents[1] / "programs" / "samples" / "val3"


def transform(x: float, y: float, z: float, rx: float, ry: float, rz: float) -> np.ndarray:
    """The matrix of mm and degrees about moving axes, in mm."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("XYZ", (rx, ry, rz), degrees=True).as_matrix()
    matrix[:3, 3] = x, y, z
    return matrix


def named(program: Program, name: str) -> ProgramTarget:
    return next(target for target in program.targets if target.name == name)


def test_targets_are_points_and_joints_whose_numbers_are_written() -> None:
    program = read_program(SAMPLES / "cell.dtx")
    assert program.dialect == "val3"
    names = [target.name for target in program.targets]
    assert names == ["jStart[0]", "jStart[1]", "pPick[0]", "pPick[1]", "pPick[2]"]
    np.testing.assert_allclose(program.targets[0].values, np.radians([0, 10.5, 90, 0, 80, -200]))
    assert [target.motion for target in program.targets] == ["joint", None, "linear", "circular", "circular"]
    assert named(program, "pPick[0]").configuration == "lefty epositive wpositive"


def test_points_lead_through_nested_frames_and_tools_to_the_flange() -> None:
    program = read_program(SAMPLES / "cell.dtx")
    numbers, flange, _ = flange_targets(program)
    places = {program.targets[number].name: k for k, number in enumerate(numbers)}
    table = transform(362.042, -49.91, -265.9, 0, 0, 90)
    gripper = transform(0, 5, 180, 0, 45, 0)
    pick = transform(169.837325, -700.0334453, 372.398311, -179.999244, -0.000734286, 88.845311)
    expected = {
        "pPick[0]": table @ pick @ np.linalg.inv(gripper @ transform(0, 0, 20, 0, 0, 0)),
        "pPick[1]": table @ transform(10, 20, 30, 10, -20, 30) @ transform(100.5, 20, 0.25, 170, -30, 45)
        @ np.linalg.inv(gripper),
    }  # fmt: skip
    assert set(places) == set(expected)
    for name, matrix in expected.items():
        k = places[name]
        np.testing.assert_allclose(flange.translation[:, k], 1e-3 * matrix[:3, 3], atol=1e-12)
        np.testing.assert_allclose(flange.rotation[..., k], matrix[:3, :3], atol=1e-12)


def test_a_frame_that_a_program_sets_is_unknown() -> None:
    program = read_program(SAMPLES / "cell.dtx")
    base = named(program, "pPick[2]").base
    assert (base.name, base.frame) == ("fMoved[0]", None)


def test_what_is_computed_at_run_time_is_listed() -> None:
    reasons = [note.reason for note in read_program(SAMPLES / "cell.dtx").notes]
    assert reasons.count("the target is computed at run time") == 1
    assert any("pComputed" in note.text for note in read_program(SAMPLES / "cell.dtx").notes)
    assert "line 16 of main.pgx changes it at run time" in reasons
    assert sum(reason.startswith("pHere[0] lacks some of its numbers") for reason in reasons) == 1
    assert len(reasons) == 4


def test_frames_without_a_root_are_unknown() -> None:
    program = read_program(SAMPLES / "scara.dtx")
    assert [target.name for target in program.targets] == ["pSix[0]", "pLoop[0]"]
    assert all(target.base is not None and target.base.frame is None for target in program.targets)


def test_angles_stay_near_those_of_the_program() -> None:
    program = read_program(SAMPLES / "crlf.dtx")
    x, y, z, *quaternion = program.targets[0].values
    turned = Rotation.from_euler("XYZ", (-179.9, 0.05, 0.02), degrees=True).as_quat()
    assert quaternion == pytest.approx([0, 1, 0, 0], abs=1e-15)
    data = with_targets(program, [(x, y, z, turned[3], *turned[:3]), None])
    text = data.decode()
    assert 'rx="180.10000" ry="0.05000" rz="0.02000"' in text or 'rx="-179.90000" ry="0.05000" rz="0.02000"' in text
    assert text.count("\r\n") == text.count("\n")


def test_files_that_cannot_be_read_get_one_message(tmp_path: Path) -> None:
    text = (SAMPLES / "cell.dtx").read_text(encoding="utf-8")
    cut = tmp_path / "cut.dtx"
    cut.write_text(text[: text.index("</Datas>")], encoding="utf-8")
    with pytest.raises(InputError, match="is truncated: it has no </Database>"):
        read_program(cut)
    other = tmp_path / "other.dtx"
    other.write_text("<Database><Datas/></Database>", encoding="utf-8")
    with pytest.raises(InputError, match="is not a VAL3 data file"):
        read_program(other)
    with pytest.raises(InputError, match=r"give the \.dtx file beside it"):
        read_program(SAMPLES / "main.pgx")
    shutil.copy(SAMPLES / "cell.dtx", tmp_path / "inch.dtx")
    (tmp_path / "app.pjx").write_text('<Project><Parameters millimeterUnit="false" /></Project>', encoding="utf-8")
    with pytest.raises(InputError, match="belongs to a project in inches"):
        read_program(tmp_path / "inch.dtx")


def test_no_new_program_of_the_dialect_is_written() -> None:
    with pytest.raises(UsageError, match="writes no new val3 program; choose krl, rapid, fanuc, urscript"):
        write_program("val3", [])
