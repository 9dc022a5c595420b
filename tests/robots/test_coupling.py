"""Coupled joints: a robot file's ``coupling``, through poses, Jacobians, effects and the files written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from homogeneous import dh

from robacc.diagnostics.robot_poses import read_robot_poses
from robacc.errors import InputError
from robacc.robots.arm import Arm, build_chain, find_reach, inverse_kinematics, pose_jacobian
from robacc.robots.urdf import parse_urdf, robot_to_urdf
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml

# A palletiser: the controller counts j3 from the horizontal, and rods keep the wrist level.
PALLETISER = """robacc: 1
name: palletiser
convention: standard
units: {length: mm, angle: deg}
tool: {xyz: [10, 20, 100], rpy: [5, 0, 30]}
joints:
  - {name: j1, type: revolute, theta: 0, d: 800, a: 150, alpha: -90, limits: [-170, 170]}
  - {name: j2, type: revolute, theta: -90, d: 0, a: 900, alpha: 0, limits: [-40, 85]}
  - {name: j3, type: revolute, theta: 90, d: 0, a: 1000, alpha: 0, limits: [-20, 110], sign: -1, coupling: {j2: 1}}
  - {name: rods, type: revolute, theta: 0, d: 0, a: 200, alpha: -90, passive: true, coupling: {j3: 1.0}, mass: 5}
  - {name: j4, type: revolute, theta: 0, d: -100, a: 0, alpha: 180, limits: [-300, 300]}
"""
# A spindle: turning it by j4 moves the quill by 20 mm a turn.
SPINDLE = """robacc: 1
name: spindle
convention: standard
units: {length: mm, angle: deg}
joints:
  - {name: j1, type: revolute, theta: 0, d: 300, a: 250, alpha: 0}
  - {name: j3, type: prismatic, theta: 0, d: 0, a: 0, alpha: 180, limits: [0, 200], coupling: {j4: 0.05555555555}}
  - {name: j4, type: revolute, theta: 0, d: 0, a: 0, alpha: 0}
"""


def test_joints_turn_by_their_own_and_the_coupled_variables() -> None:
    # Written out by hand: joint 3 turns by -(q3 + q2), and the rods turn back by q3.
    robot = parse_robot(PALLETISER.replace("tool: {xyz: [10, 20, 100], rpy: [5, 0, 30]}\n", ""), "p.yaml")
    q = np.array([0.3, -0.2, 0.5, 0.7])
    quarter = np.pi / 2
    expected = (
        dh(q[0], 0.8, 0.15, -quarter)
        @ dh(q[1] - quarter, 0, 0.9, 0)
        @ dh(quarter - (q[2] + q[1]), 0, 1.0, 0)
        @ dh(q[2], 0, 0.2, -quarter)
        @ dh(q[3], -0.1, 0, np.pi)
    )
    assert robot.variable_names == ("j1", "j2", "j3", "j4")
    np.testing.assert_allclose(build_chain(robot).forward(q[:, None]).matrices()[0], expected, atol=1e-14)


def test_rods_keep_the_wrist_level() -> None:
    robot = parse_robot(PALLETISER, "p.yaml")
    q = np.random.default_rng(0).uniform(-1, 1, (4, 50))
    z = build_chain(replace(robot, tool=type(robot.tool)())).forward(q).rotation[:, 2]
    np.testing.assert_allclose(z, np.tile([[0.0], [0.0], [1.0]], 50), atol=1e-12)


@pytest.mark.parametrize("text", [PALLETISER, SPINDLE])
def test_the_jacobian_is_the_derivative(text: str) -> None:
    arm = Arm.of(parse_robot(text, "p.yaml"))
    q = np.random.default_rng(1).uniform(-0.5, 0.5, (arm.chain.n_joints, 7))
    jacobian = pose_jacobian(arm, q)[1]
    for joint in range(q.shape[0]):
        step = np.zeros_like(q)
        step[joint] = 1e-6
        ahead, behind = arm.chain.forward(q + step), arm.chain.forward(q - step)
        np.testing.assert_allclose(
            jacobian[:3, joint], (ahead.translation - behind.translation) / 2e-6, atol=1e-8
        )  # the central difference's own error is of order 1e-10
        turn = np.einsum("ikn,jkn->ijn", ahead.rotation - behind.rotation, arm.chain.forward(q).rotation) / 2e-6
        np.testing.assert_allclose(jacobian[3:, joint], [turn[2, 1], turn[0, 2], turn[1, 0]], atol=1e-8)


@pytest.mark.parametrize("text", [PALLETISER, SPINDLE])
def test_written_files_are_the_same_arm(text: str) -> None:
    robot = parse_robot(text, "p.yaml")
    assert parse_robot(robot_to_yaml(robot), "again.yaml").joints == robot.joints
    urdf, losses = robot_to_urdf(robot)
    reread = parse_urdf(urdf, "again.urdf")
    assert reread.variable_names == robot.variable_names
    assert not any("coupl" in line for line in losses)
    ours, theirs = ([joint.mass for joint in one.joints if joint.mass] for one in (robot, reread))
    assert theirs == ours
    q = np.random.default_rng(2).uniform(-1, 1, (len(robot.variables), 20))
    np.testing.assert_allclose(
        build_chain(reread).forward(q).matrices(), build_chain(robot).forward(q).matrices(), atol=1e-12
    )


def test_units_of_a_mixed_coupling_are_the_files() -> None:
    robot = parse_robot(SPINDLE, "s.yaml")
    assert robot.joints[1].coupling["j4"] * 2 * np.pi == pytest.approx(0.02, rel=1e-9)
    q = np.array([[0.0, 0.0], [0.05, 0.05], [0.0, 2 * np.pi]])
    height = build_chain(robot).forward(q).translation[2]
    assert height[1] - height[0] == pytest.approx(0.02, rel=1e-9)


def test_inverse_kinematics_and_reach_of_coupled_joints() -> None:
    arm = Arm.of(parse_robot(PALLETISER, "p.yaml"))
    q = np.array([[0.4, -0.3], [0.3, 0.6], [0.7, 0.2], [1.0, -1.0]])
    desired = arm.chain.forward(q)
    solutions = inverse_kinematics(arm, desired, starts=16)
    assert solutions.converged.any(axis=1).all()
    reach = find_reach(arm.robot, arm.robot.tool)
    slide = find_reach(parse_robot(SPINDLE, "s.yaml"), arm.robot.tool)
    for each in (reach, slide):
        assert 0.3 < (each["sampled_m"] or 0.0) <= (each["bound_m"] or 0.0) + 1e-12


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("coupling: {j2: 1}", "coupling: {j9: 1}", "joints[2].coupling.j9: 'j9' is not another joint with a variable"),
        ("coupling: {j2: 1}", "coupling: {j3: 1}", "joints[2].coupling.j3: 'j3' is not another joint with a variable"),
        ("coupling: {j2: 1}", "coupling: {rods: 1}", "'rods' is not another joint with a variable; there are j1, j2"),
        ("coupling: {j2: 1}", "coupling: {j2: x}", "joints[2].coupling.j2: expected a number, found 'x'"),
        ("coupling: {j2: 1}", "coupling: j2", "joints[2].coupling: expected joints with their ratios"),
        ("passive: true, coupling: {j3: 1.0}", "passive: true", "joints[3].passive: a passive joint moves by its"),
        ("passive: true", "passive: perhaps", "joints[3].passive: expected true or false, found 'perhaps'"),
    ],
)
def test_wrong_couplings_are_reported(old: str, new: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_robot(PALLETISER.replace(old, new), "p.yaml")
    assert any(message in str(problem) for problem in caught.value.problems), caught.value


HAND = """<robot name="hand">
  <link name="palm"/><link name="thumb"/><link name="left"/><link name="right"/><link name="tip"/>
  <joint name="lead" type="revolute"><parent link="palm"/><child link="thumb"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="a" type="revolute"><origin xyz="0 0.1 0"/><parent link="palm"/><child link="left"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/><mimic joint="lead" multiplier="2" offset="0.1"/></joint>
  <joint name="b" type="revolute"><origin xyz="0.1 0 0"/><parent link="left"/><child link="right"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/><mimic joint="lead" multiplier="-1" offset="0.3"/></joint>
  <joint name="c" type="fixed"><origin xyz="0.1 0 0"/><parent link="right"/><child link="tip"/></joint>
</robot>
"""


def test_followers_of_a_joint_outside_the_chain_move_together() -> None:
    robot = parse_urdf(HAND, "hand.urdf", None, "tip")
    assert robot.variable_names == ("a",)
    lead = 0.4
    a, b = 2 * lead + 0.1, -lead + 0.3
    position = build_chain(robot).forward(np.array([[a]])).translation[:, 0]
    expected = [0.1 * np.cos(a) + 0.1 * np.cos(a + b), 0.1 + 0.1 * np.sin(a) + 0.1 * np.sin(a + b), 0]
    np.testing.assert_allclose(position, expected, atol=1e-15)


@pytest.mark.parametrize("name", ["lead", "lead_deg"])
def test_a_column_of_a_joint_outside_the_chain_is_answered_by_the_rule(tmp_path: Path, name: str) -> None:
    """A lifting column logs the joint that its two stages follow; only the first stage may have a column."""
    robot = parse_urdf(HAND, "hand.urdf", None, "tip")
    poses = tmp_path / "poses.csv"
    poses.write_text(f"{name},x,y,z\n0.1,0.1,0.1,0.0\n")
    with pytest.raises(InputError) as caught:
        read_robot_poses(poses, robot)
    assert f"{name!r} is outside the robot's chain, so write the column a = 2 * lead + 0.1 (rad)" in str(caught.value)
