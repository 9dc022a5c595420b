"""Joints outside the chain that follow others, against matrices and a potential energy of their own."""

from __future__ import annotations

import re

import numpy as np
import pytest
from homogeneous import frame

from robacc.errors import InputError
from robacc.gravity import weight_torques
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.robots.urdf import parse_urdf, robot_to_urdf
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml

GRAVITY = 9.81
YAML = """robacc: 1
convention: urdf
units: {length: mm, angle: deg}
gravity: [0, 0, -9.81]
joints:
  - {name: waist, type: revolute, origin: {xyz: [0, 0, 600], rpy: [0, 0, 0]}, axis: [0, 1, 0],
     mass: 14, com: [20, 0, 250]}
  - {name: lift, type: revolute, origin: {xyz: [0, -300, 500], rpy: [0, 0, 0]}, axis: [0, 1, 0],
     mass: 3, com: [150, 0, 20]}
branches:
  - {name: shoulder, parent: waist, type: revolute, origin: {xyz: [0, 300, 500], rpy: [0, 0, 0]}, axis: [0, 1, 0],
     mass: 3, com: [150, 0, 20]}
  - {name: elbow, parent: shoulder, type: revolute, origin: {xyz: [350, 0, 0], rpy: [0, 0, 0]}, axis: [0, 1, 0],
     mass: 2, com: [120, 10, 0], mimic: {joint: shoulder, multiplier: -0.5, offset: 20}}
  - {name: counterweight, parent: waist, type: prismatic, origin: {xyz: [-100, 0, 300], rpy: [0, 0, 0]},
     axis: [1, 0, 0], mass: 5, com: [0, 0, 30], limits: [-100, 200], mimic: {joint: lift, multiplier: -2, offset: 50}}
"""
# Millimetres per degree in the file; m per rad here.
SLIDE = -2e-3 * 180 / np.pi


def energy(waist: float, lift: float, shoulder: float, elbow: float, slide: float) -> float:
    """Potential energy of all links."""
    trunk = frame((0, 0, 0.6), (0, waist, 0))
    arm = trunk @ frame((0, -0.3, 0.5), (0, lift, 0))
    upper = trunk @ frame((0, 0.3, 0.5), (0, shoulder, 0))
    fore = upper @ frame((0.35, 0, 0), (0, elbow, 0))
    bodies = [
        (trunk, 14.0, (0.02, 0, 0.25)),
        (arm, 3.0, (0.15, 0, 0.02)),
        (upper, 3.0, (0.15, 0, 0.02)),
        (fore, 2.0, (0.12, 0.01, 0)),
        (trunk, 5.0, (-0.1 + slide, 0, 0.33)),
    ]
    return sum(mass * GRAVITY * float((place @ np.append(com, 1.0))[2]) for place, mass, com in bodies)


def torques(waist: float, lift: float, shoulder: float) -> list[float]:
    """Minus the slope of the energy along each joint of the chain; the drives of the others hold them still."""
    elbow, slide = -0.5 * shoulder + np.radians(20), SLIDE * lift + 0.05
    step, others = 1e-6, (shoulder, elbow, slide)
    return [
        (energy(waist - step, lift, *others) - energy(waist + step, lift, *others)) / (2 * step),
        (energy(waist, lift - step, *others) - energy(waist, lift + step, *others)) / (2 * step),
    ]


@pytest.fixture(name="poses", scope="module")
def _poses() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    return rng.uniform(-1.2, 1.2, (2, 15)), rng.uniform(-1.2, 1.2, (1, 15))


def followed(robot: Robot, poses: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    q, other = poses
    return weight_torques(Arm.of(robot), Measurements(np.zeros((3, q.shape[1])), q=q, branches=other))


@pytest.mark.parametrize("form", ["file", "yaml", "urdf"])
def test_joints_of_branches_follow_their_masters(form: str, poses: tuple[np.ndarray, np.ndarray]) -> None:
    robot = parse_robot(YAML, "torso.yaml")
    if form == "yaml":
        robot = parse_robot(robot_to_yaml(robot), "again.yaml")
    elif form == "urdf":
        robot = parse_urdf(robot_to_urdf(robot)[0], "again.urdf", tip_link="lift_link")
    assert [branch.joint.name for branch in robot.branch_variables] == ["shoulder"]
    expected = np.array([torques(*q, *other) for q, other in zip(poses[0].T, poses[1].T, strict=True)]).T
    np.testing.assert_allclose(followed(robot, poses), expected, atol=1e-6)


def test_without_columns_masters_stand_at_their_positions(poses: tuple[np.ndarray, np.ndarray]) -> None:
    robot = parse_robot(
        YAML.replace("com: [150, 0, 20]}\n  - {name: elbow", "com: [150, 0, 20], position: 30}\n  - {name: elbow"),
        "t.yaml",
    )
    expected = np.array([torques(*q, np.radians(30)) for q in poses[0].T]).T
    actual = weight_torques(Arm.of(robot), Measurements(np.zeros((3, 15)), q=poses[0]))
    np.testing.assert_allclose(actual, expected, atol=1e-6)


def test_a_master_that_a_joint_of_the_chain_follows_stands_as_that_one_tells() -> None:
    text = robot_to_urdf(parse_robot(YAML, "torso.yaml"))[0]
    # Lift follows the shoulder outside the chain: lift = 2 shoulder + 0.1, and lift has the column.
    follows = '<mimic joint="shoulder" multiplier="2" offset="0.1"/>'
    text = re.sub(r'(<joint name="lift".*?)(</joint>)', rf"\1{follows}\2", text, flags=re.DOTALL)
    robot = parse_urdf(text, "torso.urdf", tip_link="lift_link")
    assert robot.variable_names == ("waist", "lift")
    assert robot.branch_variables == ()
    q = np.random.default_rng(5).uniform(-1, 1, (2, 8))
    expected = np.array([torques(waist, lift, (lift - 0.1) / 2) for waist, lift in q.T]).T
    actual = weight_torques(Arm.of(robot), Measurements(np.zeros((3, 8)), q=q))
    np.testing.assert_allclose(actual, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("joint: shoulder,", "joint: nobody,", r"branches\[1\].mimic.joint: 'elbow' follows 'nobody', which is not"),
        ("joint: lift,", "joint: elbow,", "'counterweight' follows 'elbow', which follows another joint itself"),
        ("offset: 50}", "offset: 50}, position: 3", "a joint that follows another has no position of its own"),
    ],
)
def test_rules_that_nothing_can_follow_are_refused(old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_robot(YAML.replace(old, new), "torso.yaml")
