"""URDF: every serial chain of real robots against yourdfpy's own kinematics."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robot_files import example_robots
from slow_parameters import some_fast

from robacc.errors import InputError
from robacc.geometry import rotation_from_rpy
from robacc.modelling.robot_file import read_robot
from robacc.robots.arm import build_chain
from robacc.robots.urdf import parse_urdf, robot_to_urdf
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml

PROJECT = Path(__file__).resolve().parents[2]

ARMS = (
    "panda_description/urdf/panda.urdf",
    "z1_description/urdf/z1.urdf",
    "kinova_description/robots/kinova.urdf",
    "xarm_description/urdf/xarm7.urdf",
    "ur_description/urdf/ur3_robot.urdf",
    "ur_description/urdf/ur3_gripper.urdf",
    "ur_description/urdf/ur5_robot.urdf",
    "ur_description/urdf/ur5_gripper.urdf",
    "ur_description/urdf/ur10_robot.urdf",
    "ur_description/urdf/ur10_joint_limited_robot.urdf",
    "so_arm_description/urdf/so100.urdf",
    "so_arm_description/urdf/so101.urdf",
    "baxter_description/urdf/baxter.urdf",
    "talos_data/robots/talos_left_arm.urdf",
    "tiago_description/robots/tiago_no_hand.urdf",
    "tiago_description/robots/tiago.urdf",
    "tiago_description/robots/tiago_dual.urdf",
    "tiago_pro_description/robots/tiago_pro.urdf",
    "pr2_description/urdf/pr2.urdf",
    "icub_description/robots/icub.urdf",
    "romeo_description/urdf/romeo.urdf",
    "b1_description/urdf/b1-z1.urdf",
    "anymal_b_simple_description/robots/anymal-kinova.urdf",
    "alex_description/urdf/alex_psyonic_hands.urdf",
    "allegro_hand_description/urdf/allegro_right_hand.urdf",
    "double_pendulum_description/urdf/double_pendulum_continuous.urdf",
)
"""Under the package's folder of robots: arms, arms on mobile bases, hands with mimic joints, long chains."""


def position(reference: Any, name: str, configuration: Mapping[str, float]) -> float:
    """Return a joint's position; a finger may follow one of another chain."""
    rule = reference.joint_map[name].mimic
    if rule is None:
        return configuration[name]
    return rule.multiplier * position(reference, rule.joint, configuration) + rule.offset


@pytest.mark.parametrize("arm", some_fast(ARMS, 2))
def test_every_serial_chain_of_real_robots_is_yourdfpys(arm: str) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    logging.getLogger("yourdfpy").setLevel(logging.CRITICAL)
    path = example_robots() / arm
    reference = yourdfpy.URDF.load(str(path), load_meshes=False)
    rng = np.random.default_rng(0)
    configurations = [{name: rng.uniform(-2, 2) for name in reference.actuated_joint_names} for _ in range(2)]
    parents = {joint.parent for joint in reference.robot.joints}
    leaves = [link.name for link in reference.robot.links if link.name not in parents]
    text = path.read_text()
    robots = {}
    for leaf in leaves:
        try:
            robots[leaf] = parse_urdf(text, arm, None, leaf)
        except InputError as error:
            # The only chains that are none: nothing moves in them, or a finger follows a joint that the file lacks.
            problems = {problem.message for problem in error.problems}
            assert all("moves" in problem or "which is not a joint of this file" in problem for problem in problems)
    assert robots, "no chain of this robot could be read"
    longest = max(robots.values(), key=lambda robot: len(robot.joints))
    assert parse_robot(robot_to_yaml(longest), "again.yaml") == longest
    reread = parse_urdf(robot_to_urdf(longest)[0], "again.urdf")
    q = rng.uniform(-2, 2, (len(longest.variables), 5))
    ours, theirs = (build_chain(robot).forward(q).matrices() for robot in (longest, reread))
    np.testing.assert_allclose(theirs, ours, atol=1e-9)
    for configuration in configurations:
        reference.update_cfg(np.array([configuration[name] for name in reference.actuated_joint_names]))
        for leaf, robot in robots.items():
            q = np.array([[position(reference, name, configuration)] for name in robot.variable_names])
            expected = reference.get_transform(leaf, robot.base_link)
            np.testing.assert_allclose(build_chain(robot).forward(q).matrices()[0], expected, atol=1e-10, err_msg=leaf)


def test_there_are_at_least_fifteen_robots() -> None:
    assert sum((example_robots() / arm).is_file() for arm in ARMS) >= 15


def test_our_panda_is_the_urdfs_panda() -> None:
    # Two descriptions of one arm by different hands, modified DH and URDF.
    text = (example_robots() / ARMS[0]).read_text()
    theirs = parse_urdf(text, "panda.urdf", "panda_link0", "panda_link8")
    ours = read_robot(PROJECT / "configs" / "robots" / "panda.yaml")
    q = np.random.default_rng(1).uniform(-1, 1, (7, 20))
    np.testing.assert_allclose(
        build_chain(ours).forward(q).matrices(), build_chain(theirs).forward(q).matrices(), atol=1e-12
    )
    moving = [joint for joint in theirs.joints if joint.is_variable]
    assert [joint.name for joint in ours.joints] == [joint.name for joint in moving]
    for our, their in zip(ours.joints, moving, strict=True):
        # The file's figures are rounded to a tenth of a gram; the frames behind the joints are the same.
        assert our.mass == pytest.approx(their.mass, abs=1e-3)
        assert our.com == pytest.approx(their.com, abs=1e-4)


def test_our_ur10_is_the_urdfs_ur10() -> None:
    # The URDF is in metres to four digits and puts its tool frame's axes elsewhere, so points are compared.
    text = (example_robots() / "ur_description/urdf/ur10_robot.urdf").read_text()
    theirs = build_chain(parse_urdf(text, "ur10.urdf", None, "tool0"))
    ours = build_chain(read_robot(PROJECT / "configs" / "robots" / "ur10.yaml"))
    q = np.random.default_rng(1).uniform(-2, 2, (6, 20))
    our, their = ours.forward(q).translation, theirs.forward(q).translation
    turned = rotation_from_rpy(np.array([0, 0, np.pi])) @ our  # base_link looks the other way than base
    np.testing.assert_allclose(turned, their, atol=1e-3)
