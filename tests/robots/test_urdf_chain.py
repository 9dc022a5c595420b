"""Chain of a URDF by the columns of the pose file: without the gripper, and the right arm of several."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robot_files import example_robots

import robacc
from robacc.robots.urdf import parse_urdf


def joint(name: str, kind: str, parent: str, child: str) -> str:
    limits = '<limit lower="-2" upper="2" effort="1" velocity="1"/>' if kind in ("revolute", "prismatic") else ""
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="0.1 0 0.2"/><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="0 1 0"/>{limits}</joint>'
    )


JOINTS = [
    ("wheel", "continuous", "ground", "cart"),
    ("mount_left", "fixed", "cart", "left_base"),
    ("left_1", "revolute", "left_base", "l1"),
    ("left_2", "revolute", "l1", "l2"),
    ("left_flange", "fixed", "l2", "l_plate"),
    ("left_camera", "fixed", "l_plate", "l_camera"),
    ("left_tool", "fixed", "l_plate", "tool0"),
    ("right_1", "revolute", "cart", "r1"),
    ("right_2", "revolute", "r1", "r2"),
    ("right_plate", "fixed", "r2", "r_plate"),
    ("right_hand", "fixed", "r_plate", "hand"),
    ("finger", "prismatic", "hand", "finger_link"),
    ("right_3", "revolute", "r1", "r3"),
]
LINKS = dict.fromkeys(name for row in JOINTS for name in row[2:])
ROBOT = f'<robot name="two">{"".join(f"<link name={chr(34)}{n}{chr(34)}/>" for n in LINKS)}{"".join(joint(*row) for row in JOINTS)}</robot>'  # noqa: E501


def chain(*columns: str, tip: str | None = None, base: str | None = None) -> tuple[str | None, str | None, list[str]]:
    robot = parse_urdf(ROBOT, "two.urdf", base, tip, lambda: columns)
    return robot.base_link, robot.tip_link, list(robot.variable_names)


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        # The arm behind the wheel, which the file does not have; the camera is no flange.
        (("left_1", "left_2_deg", "x", "y", "z"), ("left_base", "tool0", ["left_1", "left_2"])),
        (("x_mm", "right_2 [deg]", "right_1 [deg]"), ("cart", "r_plate", ["right_1", "right_2"])),
        (("wheel", "right_1", "right_2"), ("ground", "r_plate", ["wheel", "right_1", "right_2"])),
        (("right_1", "right_3"), ("cart", "r3", ["right_1", "right_3"])),
        (("right_1", "right_2", "finger"), ("cart", "finger_link", ["right_1", "right_2", "finger"])),
        # Numbers: the longest chain without its gripper.
        (("q1", "q2", "q3", "x", "y", "z"), ("ground", "r_plate", ["wheel", "right_1", "right_2"])),
        (("J1", "J2", "J3", "J4"), ("ground", "finger_link", ["wheel", "right_1", "right_2", "finger"])),
        (("x", "y", "z"), ("ground", "finger_link", ["wheel", "right_1", "right_2", "finger"])),
    ],
)
def test_columns_choose_the_chain(columns: tuple[str, ...], expected: tuple[str, str, list[str]]) -> None:
    assert chain(*columns) == expected


def test_links_that_are_given_come_first() -> None:
    assert chain("left_1", "left_2", tip="r2")[1:] == ("r2", ["wheel", "right_1", "right_2"])
    assert chain("left_1", "left_2", base="ground") == ("ground", "tool0", ["wheel", "left_1", "left_2"])


def test_joints_of_two_branches_leave_the_longest_chain() -> None:
    assert chain("left_1", "right_1")[1] == "finger_link"


def test_a_panda_ends_at_its_flange(tmp_path: Path) -> None:
    urdf = example_robots() / "panda_description/urdf/panda.urdf"
    assert len(robacc.read_robot(urdf).variables) == 8  # without poses: into the finger
    made = robacc.simulate("panda", poses=20, noise="0.05mm", seed=1)
    made.write(tmp_path / "numbered.csv")
    text = (tmp_path / "numbered.csv").read_text()
    for i in range(7):
        text = text.replace(f"q{i + 1},", f"panda_joint{i + 1},", 1)
    (tmp_path / "named.csv").write_text(text)
    for poses in (tmp_path / "numbered.csv", tmp_path / "named.csv", made.data):
        found = robacc.estimate(poses, robot=urdf)
        assert (found.robot.tip_link, len(found.robot.variables)) == ("panda_link8", 7)
        # The library's Panda and the URDF are one arm, so noise is all that remains.
        np.testing.assert_allclose(found.position.rms, np.sqrt(3) * 5e-5, rtol=0.35)
