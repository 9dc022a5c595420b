"""URDF written from any description: read again it is the same arm; what it cannot carry is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robacc.geometry import Array
from robacc.modelling.robot_file import read_robot
from robacc.robots.arm import build_chain
from robacc.robots.description import ORIGIN_PARAMETERS, Frame, Joint, Mimic, Robot
from robacc.robots.urdf import parse_urdf, robot_to_urdf

PROJECT = Path(__file__).resolve().parents[2]
CONFIGS = sorted((PROJECT / "configs" / "robots").glob("*.yaml"))


def random_joint(rng: np.random.Generator, i: int, convention: str) -> Joint:
    kind = ("revolute", "prismatic", "revolute")[i % 3]
    names = (
        ("x", "y", "z", "roll", "pitch", "yaw", "offset")
        if convention == "urdf"
        else ("theta", "d", "a", "alpha", "beta")
    )
    axis = rng.normal(size=3) if convention == "urdf" else np.array([0.0, 0, 1])
    return Joint(
        f"j{i}",
        "fixed" if convention == "urdf" and i == 4 else kind,
        dict(zip(names, rng.normal(size=len(names)), strict=True)),
        axis=tuple(axis / np.linalg.norm(axis)),
        limits=(-1.5, 2.0) if i % 2 else None,
        is_continuous=convention != "urdf" and i == 2,
        sign=-1 if i in (1, 2) else 1,
        mass=float(i + 1),
        com=tuple(rng.normal(size=3)),
        mimic=Mimic("j0", -1.5, 0.2) if convention == "urdf" and i == 2 else None,
    )


def assert_same_arm(robot: Robot, reread: Robot, target: Frame | None = None) -> None:
    chains = build_chain(robot if target is None else replace(robot, tool=target)), build_chain(reread)
    assert robot.variable_names == reread.variable_names
    q = np.random.default_rng(4).uniform(-2, 2, (len(robot.variables), 20))
    ours, theirs = (chain.forward(q).matrices() for chain in chains)
    np.testing.assert_allclose(theirs, ours, atol=1e-9)
    for expected, actual in zip(*(centres(chain, q) for chain in chains), strict=True):
        np.testing.assert_allclose(actual, expected, atol=1e-9)


def centres(chain, q: Array) -> list[Array]:
    """Return the centre of mass of each body over the poses."""
    frames = chain.sweep(chain.scalars(q), q.shape[1], (), tuple(body.after for body in chain.bodies)).frames
    return [
        np.einsum("ijn,j->in", frame.rotation, body.com) + frame.translation
        for frame, body in zip(frames, chain.bodies, strict=True)
    ]


@pytest.mark.parametrize("convention", ["standard", "modified", "urdf"])
@pytest.mark.parametrize("seed", range(4))
def test_written_and_read_again_gives_the_same_poses(convention: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    frames = [Frame(tuple(rng.normal(size=3)), tuple(rng.normal(size=3))) for _ in range(2)]
    joints = tuple(random_joint(rng, i, convention) for i in range(6))
    robot = Robot("arm", convention, joints, base=frames[0], tool=frames[1])  # type: ignore[arg-type]
    text, losses = robot_to_urdf(robot)
    reread = parse_urdf(text, "again.urdf")
    assert (reread.base_link, reread.tip_link) == ("measuring_frame", "tool0")
    assert_same_arm(robot, reread)
    for joint, again in zip(robot.variables, reread.variables, strict=True):
        is_unknown = joint.type == "revolute" and joint.limits is None and not joint.is_continuous
        assert again.limits == ((-2 * np.pi, 2 * np.pi) if is_unknown else joint.limits)
        assert again.is_continuous == joint.is_continuous
    assert [line for line in losses if "unlimited range" not in line and "missing limits" not in line] == []
    # And once more: nothing is added to what is already a URDF.
    assert robot_to_urdf(reread)[0].count("<link") == text.count("<link")
    assert_same_arm(robot, parse_urdf(robot_to_urdf(reread)[0], "third.urdf"))


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_the_projects_arms_go_to_urdf_and_back(path: Path) -> None:
    robot = read_robot(path)
    assert_same_arm(robot, parse_urdf(robot_to_urdf(robot)[0], "again.urdf"))


@pytest.mark.parametrize("pitch", [np.pi / 2, 1.5707963, 1.57079632, -1.5707963267, 1.5708])
def test_poses_survive_a_pitch_near_ninety_degrees(pitch: float) -> None:
    # The pitch comes about in two turns, so its cosine is rounded: roll and yaw are each almost undetermined then, and
    # only what they do together counts.
    values = {"x": 0.3, "y": 0.2, "z": 0.1, "roll": 0.0, "pitch": pitch - 0.6, "yaw": 0.3, "offset": 0.6}
    joints = tuple(Joint(f"j{i}", "revolute", values | {"yaw": 0.3 * i}, axis=(0.0, 1.0, 0.0)) for i in range(3))
    robot = Robot("pole", "urdf", joints)
    assert_same_arm(robot, parse_urdf(robot_to_urdf(robot)[0], "again.urdf"))


def test_targets_become_links() -> None:
    targets = {"left": Frame((0.1, 0, 0)), "right": Frame((-0.1, 0, 0), (0, 0, 1))}
    robot = replace(read_robot(CONFIGS[0]), targets=targets)
    text, losses = robot_to_urdf(robot)
    for name, frame in targets.items():
        assert_same_arm(robot, parse_urdf(text, "again.urdf", None, name), frame)
    assert "targets: each becomes a link" in losses


def test_what_a_urdf_cannot_carry_is_listed() -> None:
    robot = replace(
        read_robot(PROJECT / "configs" / "robots" / "puma560.yaml"),
        effects=({"effect": "backlash"}, {"other": 1}),
        base_tolerance={"x": 1e-3},
        tool_tolerance={"x": 1e-3},
        gravity=(0.0, 9.81, 0.0),
    )
    slide = Joint("slide", "prismatic", {"theta": 0.0, "d": 0.0, "a": 0.0, "alpha": 0.0})
    losses = robot_to_urdf(replace(robot, joints=(*robot.joints, slide)))[1]
    assert losses == (
        "effect backlash",
        "effect ?",
        "tolerances of j1, j2, j3, j4, j5, j6",
        "tolerances of the base",
        "tolerances of the tool",
        "gear ratio of j1, j2, j3, j4, j5, j6",
        "gravity other than 9.81 m/s^2 downwards",
        "the payload's centre of mass",
        "an unlimited range (a URDF requires limits) of slide",
    )


def test_revolute_joints_stay_revolute_and_continuous_joints_continuous() -> None:
    # Pinocchio gives a continuous joint two numbers (cosine and sine): an arm of six had nq = 12.
    robot = read_robot(PROJECT / "configs" / "robots" / "puma560.yaml")
    joints = [replace(joint, limits=None) for joint in robot.joints]
    joints[5] = replace(joints[5], is_continuous=True)
    text, losses = robot_to_urdf(replace(robot, joints=tuple(joints)))
    assert text.count('type="revolute"') == text.count("<limit") == 5
    assert text.count('type="continuous"') == 1
    assert "missing limits (one turn either way is written) of j1, j2, j3, j4, j5" in losses


def test_names_that_the_robot_uses_are_left_to_it() -> None:
    joint = Joint("measuring_frame_to_base", "revolute", dict.fromkeys(ORIGIN_PARAMETERS, 0.1), link="tool0")
    robot = Robot("r", "urdf", (joint,), base=Frame((1, 0, 0)), tool=Frame((0, 1, 0)), base_link="measuring_frame")
    reread = parse_urdf(robot_to_urdf(robot)[0], "again.urdf")
    assert [item.name for item in reread.joints] == ["measuring_frame_to_base_2", "measuring_frame_to_base", "to_tool0"]
    assert_same_arm(robot, reread)
