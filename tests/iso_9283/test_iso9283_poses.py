"""Inverse kinematics, the standard's cube and its five poses, and poses planned on every arm."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from arms import CONFIGS, CONFIGURED, arm

from robacc.errors import InputError, UsageError
from robacc.geometry import Poses, compose, log_so3, transpose
from robacc.iso_9283.evaluation import ORIENTATIONS, PLANES, corners, fit_cube, five_points, planned_poses, propose
from robacc.modelling.robot_file import read_robot
from robacc.robots.arm import Arm, inverse_kinematics, joint_ranges
from robacc.robots.description import Frame, Robot

WITH_EDGE = {"scara": 0.15}
"""The stroke of the SCARA's slide is 195 mm: no preferred cube fits."""


def configured(name: str) -> Robot:
    return read_robot(CONFIGS / f"{name}.yaml")


@pytest.mark.parametrize("name", [*CONFIGURED, "urdf:ur10"])
def test_inverse_kinematics_against_forward(name: str) -> None:
    """Poses that exist are found again, to 1e-9, and every answer stays within the limits."""
    robot_arm = arm(name)
    low, high = joint_ranges(robot_arm)
    rng = np.random.default_rng(1)
    ends = np.where(np.isfinite(low), low, -math.pi), np.where(np.isfinite(high), high, math.pi)
    targets = robot_arm.chain.forward(rng.uniform(*(end[:, None] for end in ends), (low.size, 20)))
    solution = inverse_kinematics(robot_arm, targets)
    assert solution.converged.any(axis=1).all()
    assert np.all((solution.q >= low[:, None, None]) & (solution.q <= high[:, None, None]))
    reached = robot_arm.chain.forward(solution.q.reshape(low.size, -1))
    position_errors = np.repeat(targets.translation, 16, axis=1) - reached.translation
    rotation_errors = log_so3(compose(np.repeat(targets.rotation, 16, axis=2), transpose(reached.rotation)))
    converged = solution.converged.ravel()
    assert np.max(np.abs(position_errors[:, converged])) < 1e-9
    assert np.max(np.abs(rotation_errors[:, converged])) < 1e-9
    missed_by = np.linalg.norm(position_errors, axis=0) + np.linalg.norm(rotation_errors, axis=0)
    assert np.all(missed_by[~converged] > 1e-12)


def test_out_of_reach_is_not_converged_and_limits_are_kept() -> None:
    robot_arm = arm("ur10")
    far = Poses(np.eye(3)[..., None], np.array([[9.0], [0.0], [0.0]]))
    solution = inverse_kinematics(robot_arm, far)
    assert not solution.converged.any()
    assert np.min(solution.error) > 7.0
    free = inverse_kinematics(
        robot_arm, dataclasses.replace(far, translation=np.array([[0.5], [0.1], [0.4]])), oriented=False
    )
    assert free.converged.all()


def test_a_slide_without_limits_cannot_be_searched() -> None:
    robot = configured("stanford")
    joints = tuple(dataclasses.replace(j, limits=None) if j.type == "prismatic" else j for j in robot.joints)
    with pytest.raises(InputError, match="the prismatic joint j3 has no limits to search within"):
        propose(dataclasses.replace(robot, joints=joints))


def test_five_points_by_hand() -> None:
    """A cube of 1 m about the origin, plane rising to +x: x = z = ± 0.4, y = ± 0.4."""
    points = five_points(np.zeros(3), 1.0, "x+")
    expected = [[0, -0.4, -0.4, 0.4, 0.4], [0, -0.4, 0.4, 0.4, -0.4], [0, -0.4, -0.4, 0.4, 0.4]]
    assert points == pytest.approx(np.array(expected))
    assert points[:, 1] == pytest.approx(-points[:, 3])
    diagonal = math.sqrt(3)
    for i in range(1, 5):
        nearest = np.min(np.linalg.norm(corners(np.zeros(3), 1.0) - points[:, [i]], axis=0))
        assert nearest == pytest.approx(0.1 * diagonal)


@pytest.mark.parametrize("plane", PLANES)
def test_a_cube_is_recognised_in_any_order(plane: str) -> None:
    points = five_points(np.array([0.3, -0.2, 0.9]), 0.63, plane)  # type: ignore[arg-type]
    centre, edge, share, rising = fit_cube(points[:, [3, 1, 4, 0, 2]])
    assert (centre, rising) == (3, plane)
    assert (edge, share) == pytest.approx((0.63, 0.1))


def test_points_up_to_two_percent_off_are_still_of_a_preferred_cube() -> None:
    points = five_points(np.zeros(3), 0.4, "y-") * (0.5 - 0.085) / 0.4
    assert fit_cube(points)[1:3] == pytest.approx((0.4, 0.085))
    assert fit_cube(five_points(np.zeros(3), 0.5, "y-"))[1:3] == pytest.approx((0.5, 0.1))


GOOD = five_points(np.zeros(3), 0.4, "x+")
TURN = np.array([[math.cos(0.4), -math.sin(0.4), 0], [math.sin(0.4), math.cos(0.4), 0], [0, 0, 1]])


@pytest.mark.parametrize(
    ("points", "reason"),
    [
        (TURN @ GOOD, "not parallel to the axes of the base"),
        (GOOD + 0.05 * np.outer([1, 0, 0], [0, 1, 0, 0, 0]), "no pose is the centre of the other four"),
        (
            np.array([[0, 1, 1, -1, -1], [0, 2, -2, -2, 2], [0, 0, 0, 0, 0]]) * 0.1,
            "the outer poses form a rectangle of 200 mm by 400 mm; a diagonal plane has sides of 1 : √2",
        ),
        (np.zeros((3, 5)), "the five poses are at the same position"),
    ],
)
def test_points_that_are_no_cube_have_a_reason(points: np.ndarray, reason: str) -> None:
    assert reason in str(fit_cube(points))


def test_an_upright_plane_is_none_of_the_standards() -> None:
    assert fit_cube(np.array([[0, 1, 1, -1, -1], [0, 1, 1, -1, -1], [0, 1, -1, -1, 1]]) * 0.16)[3] is None


@pytest.mark.parametrize("name", CONFIGURED)
def test_five_poses_on_every_arm(name: str) -> None:
    """In the standard's cube, within the limits, met to 1e-9 by the robot's own kinematics, one orientation."""
    robot = configured(name)
    proposal = propose(robot, edge=WITH_EDGE.get(name))
    robot_arm = Arm.of(robot)
    low, high = joint_ranges(robot_arm)
    assert proposal.q.shape == (low.size, 5)
    assert np.all((proposal.q >= low[:, None]) & (proposal.q <= high[:, None]))
    reached = robot_arm.chain.forward(proposal.q)
    assert np.max(np.abs(reached.translation - proposal.poses.translation)) < 1e-9
    assert np.max(np.abs(log_so3(compose(proposal.poses.rotation, transpose(reached.rotation))))) < 1e-9
    assert proposal.poses.translation == pytest.approx(
        five_points(proposal.centre, proposal.edge, proposal.plane), abs=1e-12
    )
    assert np.max(np.abs(proposal.poses.rotation - proposal.poses.rotation[..., :1])) < 1e-12
    assert proposal.orientation in ("down", "own")
    if proposal.orientation == "down":
        assert proposal.poses.rotation[:, 2, 0] == pytest.approx([0, 0, -1], abs=1e-9)
    span = high - low
    margins = (
        np.minimum(proposal.q - low[:, None], high[:, None] - proposal.q)[np.isfinite(span)]
        / span[np.isfinite(span), None]
    )
    assert proposal.margin == pytest.approx(margins.min(), abs=1e-6)
    assert proposal.margin >= 0.01
    assert bool(proposal.notes) == (name in WITH_EDGE or proposal.orientation == "own")


def test_the_cube_stands_in_the_axes_of_the_base() -> None:
    """A base that is turned and moved takes the cube with it; joint angles stay."""
    robot = configured("ur10")
    moved = propose(dataclasses.replace(robot, base=Frame((1.0, 2.0, 0.5), (0.1, 0.2, 0.3))), edge=0.4)
    plain = propose(robot, edge=0.4)
    base = Poses.from_xyz_rpy(np.array([[1.0], [2.0], [0.5]]), np.array([[0.1], [0.2], [0.3]]))
    assert moved.q == pytest.approx(plain.q)
    assert moved.poses.translation == pytest.approx((base @ plain.poses).translation)


@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_orientations_that_are_asked_for(orientation: str) -> None:
    proposal = propose(configured("irb1600"), edge=0.25, orientation=orientation, plane="y+")  # type: ignore[arg-type]
    assert (proposal.orientation, proposal.plane) == (orientation, "y+")
    assert proposal.notes == ()
    axis = proposal.poses.rotation[:, 2]
    if orientation == "forward":
        assert axis[2] == pytest.approx(np.zeros(5), abs=1e-9)
    if orientation == "free":
        assert np.ptp(axis, axis=1).max() > 1e-3


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        (
            "scara",
            {},
            r"SCARA \(Adept One\): found no cube of 250 mm or more whose corners and five poses the arm reaches; "
            "give a smaller `edge`",
        ),
        ("scara", {"edge": 0.15, "orientation": "forward"}, "cube of 150 mm with the tool's z axis pointing level"),
        ("ur10", {"edge": 5.0, "plane": "x+"}, "no cube of 5000 mm with the plane x"),
        ("ur10", {"edge": 0.0}, "a length above 0, not 0 m"),
        ("ur10", {"target": "c"}, "no target 'c'; the robot file has one tool without a name"),
    ],
)
def test_an_arm_that_cannot(name: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises((InputError, UsageError), match=message):
        propose(configured(name), **options)


def test_targets() -> None:
    robot = dataclasses.replace(configured("ur10"), targets={"a": Frame((0, 0, 0.1)), "b": Frame((0, 0, 0.2))})
    first, second = propose(robot, edge=0.25), propose(robot, edge=0.25, target="b")
    assert (first.target, second.target) == ("a", "b")
    assert first.notes == ("for the target a, the first of 2",)
    assert set(planned_poses(second, 2).target) == {"b"}
    with pytest.raises(UsageError, match="no target 'c'; the robot file has a, b"):
        propose(robot, target="c")


def test_a_note_says_that_effects_are_not_applied() -> None:
    robot = dataclasses.replace(configured("ur10"), effects=({"effect": "joint_offset"},))
    assert propose(robot, edge=0.25).notes == (
        "joint angles are those of the nominal kinematics; the robot file's effects are not applied",
    )
