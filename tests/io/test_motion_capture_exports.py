"""Exports of motion capture and of rostopic, as their documentation shows them, beside a table of commands."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

import robacc
from robacc.errors import InputError
from robacc.geometry import Array, Poses, quaternion_from_rotation

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"
CENTRE = Poses.from_xyz_rpy(np.array([[2.0], [-1.5], [0.8]]), np.radians([[10.0], [-20.0], [130.0]]))
"""Pose of the robot's base in the instrument's frame."""


@pytest.fixture(scope="module")
def robot() -> robacc.Robot:
    return robacc.read_robot(SAMPLE / "robot.yaml")


@pytest.fixture(scope="module")
def data(robot: robacc.Robot) -> robacc.Measurements:
    return robacc.read_poses(SAMPLE / "poses.csv", robot=robot)


@pytest.fixture(scope="module")
def measured(data: robacc.Measurements) -> Poses:
    """The poses in the instrument's frame."""
    assert data.rotation is not None
    return CENTRE @ Poses(data.rotation, data.position)


@pytest.fixture
def commands(data: robacc.Measurements, tmp_path: Path) -> Path:
    path = tmp_path / "joints.csv"
    lines = ["Pose," + ",".join(f"A{i} [deg]" for i in range(1, 7))]
    lines += [f"P{k}," + ",".join(f"{v:.9f}" for v in q) for k, q in enumerate(np.degrees(data.q.T), 1)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def moving_xyz(rotation: Array) -> Array:
    """Return roll, pitch, yaw ``(3, N)`` of Rx Ry Rz, degrees."""
    pitch = np.arcsin(rotation[0, 2])
    roll = np.arctan2(-rotation[1, 2], rotation[2, 2])
    return np.degrees([roll, pitch, np.arctan2(-rotation[0, 1], rotation[0, 0])])


def table(head: str, rows: Iterable[Iterable[object]], separator: str) -> str:
    return head + "".join(separator.join(map(str, row)) + "\n" for row in rows)


def qualisys(measured: Poses) -> str:
    head = (
        "NO_OF_FRAMES\t60\nNO_OF_CAMERAS\t8\nNO_OF_BODIES\t1\nFREQUENCY\t100\nDESCRIPTION\t--\n"
        "TIME_STAMP\t2026-11-20, 10:47:17\t22107.99179716\nDATA_INCLUDED\t6D\nBODY_NAMES\tTool\n"
        "Frame\tTime\tTool X\tY\tZ\tRoll\tPitch\tYaw\tResidual\tRot[0]\tRot[1]\n"
    )
    columns = np.vstack([1e3 * measured.translation, moving_xyz(measured.rotation)]).T
    rows = ([k, 5.0 * k, *map("{:.7f}".format, row), 0.21, 1.0, 0.0] for k, row in enumerate(columns, 1))
    return table(head, rows, "\t")


def rostopic(measured: Poses) -> str:
    fields = [*(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw")]
    head = ",".join(["%time,field.header.seq,field.header.frame_id", *(f"field.pose.{name}" for name in fields)]) + "\n"
    quaternion = np.roll(quaternion_from_rotation(measured.rotation), -1, axis=0)
    columns = np.vstack([measured.translation, quaternion]).T
    start = 1763635637123456789
    rows = ([start + k * 10**9, k, "tracker", *map("{:.9f}".format, row)] for k, row in enumerate(columns))
    return table(head, rows, ",")


def test_roll_pitch_yaw_about_moving_axes_are_known_by_the_commands(
    measured: Poses, commands: Path, robot: robacc.Robot, tmp_path: Path
) -> None:
    path = tmp_path / "export.tsv"
    path.write_text(qualisys(measured), encoding="utf-8")
    read = robacc.read_poses(path, robot=robot, units="mm,deg", commanded=commands)
    assert any("Roll, Pitch, Yaw taken as moving-xyz" in text for text in read.warnings)
    np.testing.assert_allclose(read.rotation, measured.rotation, atol=1e-8)


def test_documented_roll_pitch_yaw_that_do_not_fit_are_an_error(
    data: robacc.Measurements, robot: robacc.Robot, tmp_path: Path
) -> None:
    assert data.q is not None
    path = tmp_path / "poses.csv"
    head = ",".join([f"q{i}" for i in range(1, 7)]) + ",x,y,z,roll_deg,pitch_deg,yaw_deg\n"
    columns = np.vstack([data.q, data.position, moving_xyz(data.rotation)]).T
    path.write_text(table(head, columns, ","), encoding="utf-8")
    with pytest.raises(InputError, match="documented as about fixed axes, which they do not fit"):
        robacc.read_poses(path, robot=robot)
    read = robacc.read_poses(path, robot=robot, angles="moving-xyz")
    np.testing.assert_allclose(read.rotation, data.rotation, atol=1e-12)


def test_joint_states_of_rostopic_are_in_the_order_of_their_names(
    data: robacc.Measurements, measured: Poses, robot: robacc.Robot, tmp_path: Path
) -> None:
    order = [2, 1, 0, 3, 4, 5]  # as the driver of Universal Robots sorts them
    head = ",".join(["%time", *(f"field.name{i}" for i in range(6)), *(f"field.position{i}" for i in range(6))]) + "\n"
    rows = ([k, *(f"j{i + 1}" for i in order), *data.q[order, k]] for k in range(data.n))
    (tmp_path / "joints.csv").write_text(table(head, rows, ","), encoding="utf-8")
    (tmp_path / "pose.csv").write_text(rostopic(measured), encoding="utf-8")
    read = robacc.read_poses(tmp_path / "pose.csv", robot=robot, commanded=tmp_path / "joints.csv")
    np.testing.assert_allclose(read.q, data.q, rtol=1e-12)
