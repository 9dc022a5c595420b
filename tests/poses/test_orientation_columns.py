"""Orientations that exports write as numbered quaternions and as entries of a matrix."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import robacc
from robacc.errors import InputError
from robacc.measurements import Measurements

N = 7
JOINTS = [f"A{i}" for i in range(1, 7)]


def written(tmp_path: Path, names: list[str], columns: np.ndarray, joints: list[str] = JOINTS) -> Path:
    """Write joints, positions unless ``names`` has 12 or 16 entries of a matrix, and the given columns, with ;"""
    rng = np.random.default_rng(1)
    q, position = rng.uniform(-90, 90, (6, N)), rng.uniform(-500, 500, (3, N))
    has_position = len(names) >= 12
    header = [*joints, *([] if has_position else ["X", "Y", "Z"]), *names]
    rows = np.vstack((q, *([] if has_position else [position]), columns)).T
    path = tmp_path / "export.csv"
    text = "\n".join(";".join(f"{value:.12f}".replace(".", ",") for value in row) for row in rows)
    path.write_text(";".join(header) + "\n" + text + "\n", encoding="utf-8")
    return path


def read(path: Path) -> Measurements:
    return robacc.read_poses(robacc.PoseFile(path, units="mm,deg"), ignore_limits=True)


TURNS = Rotation.random(N, random_state=4)


@pytest.mark.parametrize("joints", [JOINTS, [f"J{i}" for i in range(1, 7)], [f"q{i}_deg" for i in range(1, 7)]])
def test_numbers_from_zero_beside_joints_are_a_quaternion_with_the_scalar_part_first(
    joints: list[str], tmp_path: Path
) -> None:
    x, y, z, w = TURNS.as_quat().T
    data = read(written(tmp_path, ["Q0", "Q1", "Q2", "Q3"], np.stack((w, x, y, z)), joints))
    assert data.rotation is not None
    np.testing.assert_allclose(np.moveaxis(data.rotation, 2, 0), TURNS.as_matrix(), atol=1e-9)
    # The joints keep their numbers: it is the quaternion that is counted from zero.
    assert data.q.shape == (6, N)
    assert data.q[0, 0] == pytest.approx(np.radians(np.random.default_rng(1).uniform(-90, 90, (6, N))[0, 0]))


def test_numbers_from_one_are_a_question(tmp_path: Path) -> None:
    path = written(tmp_path, ["Q1", "Q2", "Q3", "Q4"], TURNS.as_quat().T)
    with pytest.raises(InputError, match=r"give `angles`: wxyz \(scalar part first\), xyzw") as caught:
        read(path)
    assert len(caught.value.problems) == 1


@pytest.mark.parametrize(
    "names",
    [
        [f"m_{i}{j}" for i in range(4) for j in range(4)],
        [f"T[{i}][{j}]" for i in range(1, 4) for j in range(1, 5)],
        [f"r{i}{j}" for i in range(1, 4) for j in range(1, 4)],
    ],
)
def test_entries_of_a_matrix_are_a_pose(names: list[str], tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    matrix = np.zeros((N, 4, 4))
    matrix[:, :3, :3], matrix[:, :3, 3], matrix[:, 3, 3] = TURNS.as_matrix(), rng.uniform(-900, 900, (N, 3)), 1.0
    rows, columns = {16: (4, 4), 12: (3, 4), 9: (3, 3)}[len(names)]
    entries = matrix[:, :rows, :columns].reshape(N, -1).T
    data = read(written(tmp_path, names, entries))
    assert data.rotation is not None
    np.testing.assert_allclose(np.moveaxis(data.rotation, 2, 0), TURNS.as_matrix(), atol=1e-9)
    if columns == 4:
        np.testing.assert_allclose(data.position, 1e-3 * matrix[:, :3, 3].T, atol=1e-12)
    assert any("as a matrix" in text for text in data.warnings)


def test_a_matrix_that_is_no_rotation_is_refused_with_its_line(tmp_path: Path) -> None:
    entries = TURNS.as_matrix().reshape(N, 9).T.copy()
    entries[:, 2] *= 1.1
    with pytest.raises(InputError, match="not those of a rotation matrix") as caught:
        read(written(tmp_path, [f"r{i}{j}" for i in range(1, 4) for j in range(1, 4)], entries))
    assert caught.value.problems[0].line == 4


@pytest.mark.parametrize("names", ["Rx [deg],Ry [deg],Rz [deg]", "rx,ry,rz", "roll_deg,pitch_deg,yaw_deg"])
def test_the_order_of_a_quaternion_says_nothing_of_three_angles(tmp_path: Path, names: str) -> None:
    rows = "".join(f"{i / 10},0,0,{i / 10},0.2,{-i / 10},{i / 10},0,0\n" for i in range(1, 4))
    (tmp_path / "poses.csv").write_text(f"x,y,z,{names},cmd_x,cmd_y,cmd_z\n{rows}", encoding="utf-8")
    try:
        assert robacc.read_poses(tmp_path / "poses.csv", angles="wxyz").n == 3
    except InputError as error:
        (problem,) = error.problems
        assert "these may be angles of several conventions" in problem.message
