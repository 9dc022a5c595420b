"""Static transforms for ROS: the frames of a model, and those of a camera that its photos show."""

from __future__ import annotations

import dataclasses
import shlex
from pathlib import Path

import numpy as np
from commands import output
from homogeneous import dh, frame, turn
from scipy.spatial.transform import Rotation

import robacc
from robacc.geometry import Array
from robacc.robots.description import Frame
from robacc_plugins.ros import write_transforms

ROOT = Path(__file__).resolve().parents[2]
PHOTOS = ROOT / "sample_data" / "photos"
DIGITS = 1e-8
"""The commands have nine decimals."""


def transforms(text: str) -> dict[tuple[str, str], Array]:
    """What the commands publish: the child's frame in the parent's."""
    found = {}
    for line in text.splitlines()[1:]:
        words = shlex.split(line)
        assert words[:4] == ["ros2", "run", "tf2_ros", "static_transform_publisher"]
        options = dict(zip(words[4::2], words[5::2], strict=True))
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat([float(options[f"--q{axis}"]) for axis in "xyzw"]).as_matrix()
        pose[:3, 3] = [float(options[f"--{axis}"]) for axis in "xyz"]
        found[options["--frame-id"], options["--child-frame-id"]] = pose
    return found


def test_base_and_tool_stand_where_the_model_has_them() -> None:
    base, tool = Frame((0.1, -0.2, 0.3), (0.01, 0.02, 2.5)), Frame((0.05, -0.02, 0.2), (0.3, -0.4, 3.0))
    robot = dataclasses.replace(robacc.read_robot("so101"), base=base, tool=tool)
    result = robacc.export(robot, format="static-transform")
    found = transforms(result.text)
    assert [*found] == [("measuring_frame", "base_link"), ("flange", "tool0")]
    for pose, place in zip(found.values(), (base, tool), strict=True):
        np.testing.assert_allclose(pose, frame(place.xyz, place.rpy), atol=DIGITS)
    assert result.not_carried == ("joint zeros and link geometry, which the format urdf has",)


def test_links_and_targets_have_their_names() -> None:
    targets = {"ball; left": Frame((0.1, 0.0, 0.0)), "right": Frame((-0.1, 0.0, 0.0))}
    robot = dataclasses.replace(
        robacc.read_robot("so101"), name="arm\nof 1", base_link="base", tip_link="wrist", targets=targets
    )
    found = transforms(robacc.export(robot, format="static-transform").text)
    assert [*found] == [("measuring_frame", "base"), ("wrist", "ball; left"), ("wrist", "right")]
    np.testing.assert_allclose(found["wrist", "ball; left"], frame((0.1, 0.0, 0.0), (0.0, 0.0, 0.0)), atol=DIGITS)


def test_a_camera_on_the_hand_sees_the_board_where_the_photos_show_it(tmp_path: Path) -> None:
    model = tmp_path / "model.yaml"
    fitted = ("--camera", PHOTOS / "camera.yaml", "--fit", "base_frame,tool_frame,joint_offset,link_geometry")
    output("calibrate", PHOTOS / "points.csv", "--robot", "ur10", *fitted, "--write-model", model)
    found = transforms(robacc.export(model, format="static-transform").text)
    assert [*found] == [("board", "base_link"), ("flange", "camera_optical_frame")]
    rows = np.genfromtxt(PHOTOS / "points.csv", delimiter=",", skip_header=3, usecols=range(1, 11))
    robot = robacc.read_robot(model)
    pose = found["board", "base_link"]
    for joint, q in zip(robot.joints, rows[:, :6].T, strict=True):
        theta, d, a, alpha = (joint.parameters[name] for name in ("theta", "d", "a", "alpha"))
        pose = pose @ dh(theta + q, d, a, alpha) @ turn(1, joint.parameters.get("beta", 0.0))
    pose = pose @ found["flange", "camera_optical_frame"]
    points = np.column_stack((rows[:, 6:8] * 1e-3, np.zeros(len(rows)), np.ones(len(rows))))
    ahead = np.einsum("nij,nj->ni", np.linalg.inv(pose), points)
    assert np.all(ahead[:, 2] > 0.1), "the z axis points from the camera to the board"
    x, y = ahead[:, :2].T / ahead[:, 2]
    k1, k2, p1, p2 = -0.12, 0.05, 0.001, -0.0005
    square = x**2 + y**2
    radial = 1 + square * (k1 + k2 * square)
    u = 960 + 1400 * (x * radial + 2 * p1 * x * y + p2 * (square + 2 * x**2))
    v = 540 + 1410 * (y * radial + p1 * (square + 2 * y**2) + 2 * p2 * x * y)
    # 0.15 px of the corners, and 0.05 mrad of each joint.
    assert np.sqrt(np.mean((u - rows[:, 8]) ** 2 + (v - rows[:, 9]) ** 2)) < 0.6


def test_a_camera_beside_the_arm_is_the_measuring_frame(tmp_path: Path) -> None:
    model, sample = tmp_path / "model.yaml", ROOT / "sample_data" / "lerobot"
    fitted = ("--camera", sample / "camera.yaml", "--fit", "base_frame,tool_frame,joint_offset")
    output("calibrate", sample / "points.csv", "--robot", "so101", *fitted, "--write-model", model)
    found = transforms(robacc.export(model, format="static-transform").text)
    assert [*found] == [("camera_optical_frame", "base_link"), ("flange", "board")]
    # The sample was made with the camera at this place in the base.
    at = np.linalg.inv(found["camera_optical_frame", "base_link"])[:3, 3]
    np.testing.assert_allclose(at, (0.1151, -0.0935, 0.3141), atol=1e-3)


def test_several_cameras_are_no_measuring_frame() -> None:
    robot = dataclasses.replace(
        robacc.read_robot("so101"), fit={"coefficients": ["base_frame.left.x", "base_frame.right.x"]}
    )
    assert [*transforms(write_transforms(robot).text)] == [("measuring_frame", "base_link"), ("flange", "tool0")]
