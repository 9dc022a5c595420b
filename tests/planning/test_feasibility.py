"""Filters of candidates: each against its own definition, and the reason that demands cannot be met."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
import pytest
from arms import arm
from test_expected import target_poses

import robacc
from robacc.errors import InputError, UsageError
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.planning.candidates import (
    Constraints,
    Sight,
    filtered,
    given_candidates,
    joint_condition,
    lengths,
    moving_points,
    parse_box,
    parse_half_space,
    sampled_candidates,
    task_joints,
)


def model(name: str = "irb1600") -> Model:
    return Model(arm(name))


def forward(which: Model, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and rotation of the target, by matrices."""
    pose = target_poses(which.arm.robot, q, {})
    return pose[:, :3, 3].T, np.moveaxis(pose[:, :3, :3], 0, 2)


def samples(which: Model, n: int = 300) -> np.ndarray:
    low, high = np.array([joint.limits for joint in which.arm.robot.variables]).T[..., None]
    return np.random.default_rng(1).uniform(low, high, (len(low), n))


def test_targets_and_visibility_agree_with_matrices() -> None:
    which = model()
    q = samples(which)
    sight = Sight((2.5, 0.4, 1.0), (0.3, 0.0, 1.0), np.radians(40), (1.5, 3.0))
    target, excluded = filtered(which, q, Constraints(margin=0.0, sight=sight))
    position, rotation = forward(which, q)
    np.testing.assert_allclose(target, position, atol=1e-12)
    ray = np.array(sight.position)[:, None] - position
    distance = np.linalg.norm(ray, axis=0)
    axis = np.einsum("ijn,j->in", rotation, np.array(sight.axis) / np.linalg.norm(sight.axis))
    angle = np.degrees(np.arccos(np.sum(axis * ray, axis=0) / distance))
    visible = (distance >= 1.5) & (distance <= 3.0) & (angle <= 40)
    assert 0 < np.count_nonzero(visible) < 300
    np.testing.assert_array_equal(np.any(list(excluded.values()), axis=0), ~visible)


def test_places_hold_for_every_moving_point() -> None:
    which = model()
    q = samples(which)
    points = moving_points(which.arm, q)
    position, _ = forward(which, q)
    for text, wanted in (("z>=0.2", 0.2), ("y<=0.3", 0.3)):
        side = parse_half_space(text, "half_space")
        _, excluded = filtered(which, q, Constraints(margin=0.0, half_spaces=(side,)))
        everything = np.concatenate((points, position[:, None]), axis=1)
        row = everything["xyz".index(text[0])]
        inside = np.all(row >= wanted, axis=0) if ">" in text else np.all(row <= wanted, axis=0)
        np.testing.assert_array_equal(np.any(list(excluded.values()), axis=0), ~inside)
        assert 0 < np.count_nonzero(inside) < 300
    _, excluded = filtered(which, q, Constraints(margin=0.0, min_height=0.2))
    below = np.any(np.concatenate((points, position[:, None]), 1)[2] < 0.2, axis=0)
    np.testing.assert_array_equal(np.any(list(excluded.values()), axis=0), below)


def test_the_outline_has_the_elbow_and_not_the_pedestal() -> None:
    which = model()
    q = samples(which, 50)
    points = moving_points(which.arm, q)
    assert np.ptp(points, axis=2).max(axis=0).min() > 1e-3
    # The elbow: the origin after the second row lies one upper arm away from the shoulder.
    joints = which.arm.robot.joints
    shoulder = np.array([joints[0].parameters["a"] * np.cos(q[0]), joints[0].parameters["a"] * np.sin(q[0])])
    upper = joints[1].parameters["a"]
    distances = np.hypot(np.linalg.norm(points[:2] - shoulder[:, None], axis=0), points[2] - joints[0].parameters["d"])
    assert np.any(np.all(np.abs(distances - upper) < 1e-9, axis=1))


def test_singular_poses_have_a_large_condition() -> None:
    which = model("puma560")
    q = samples(which, 40)
    q[4, :20] = 1e-6  # wrist: axes 4 and 6 in line
    condition = joint_condition(which.arm, q)
    assert condition[:20].min() > 1e4 > np.median(condition[20:])


def test_exclusions_are_counted_by_reason() -> None:
    which = model()
    constraints = Constraints(min_height=0.3, inside=parse_box("x=0.2:1.2", "inside"))
    candidates = sampled_candidates(which, constraints, 400, 0)
    assert candidates.n == 400
    _, masks = filtered(which, candidates.q, constraints)
    assert not np.any(list(masks.values()))
    by_reason = {entry["reason"]: entry for entry in candidates.excluded}
    assert set(by_reason) == {"below the minimum height of 0.3 m", "target outside the box x=0.2:1.2"}
    both = sum(entry["count"] for entry in candidates.excluded) - sum(entry["alone"] for entry in candidates.excluded)
    excluded = sum(entry["alone"] for entry in candidates.excluded) + both // 2
    assert excluded <= candidates.n_drawn - candidates.n


def test_infeasible_demands_name_the_largest_reason() -> None:
    constraints = Constraints(inside=parse_box("x=20:30", "inside"), min_height=0.3)
    with pytest.raises(UsageError, match=r"no pose is feasible: of 16000 poses, 16000 are excluded by: target outside"):
        sampled_candidates(model(), constraints, 400, 0)
    with pytest.raises(UsageError, match="no pose of the task is feasible"):
        task_joints(model(), Constraints(), parse_box("z=9:10", "region"), 0)


def test_given_candidates_outside_the_margin_are_counted() -> None:
    which = model()
    q = samples(which, 60)
    q[0, 0] = which.arm.robot.variables[0].limits[1]  # type: ignore[index]
    candidates = given_candidates(which, Constraints(margin=0.05), Measurements(position=np.zeros((3, 60)), q=q))
    assert candidates.n < 60
    assert candidates.excluded[0]["reason"] == "joint limits with margin"
    assert candidates.excluded[0]["count"] == 60 - candidates.n


def test_a_prismatic_joint_without_limits_is_an_error() -> None:
    which = arm("stanford").robot
    joints = tuple(
        dataclasses.replace(joint, limits=None) if joint.type == "prismatic" else joint for joint in which.joints
    )
    with pytest.raises(InputError, match="no limits to choose poses within"):
        sampled_candidates(Model.of(dataclasses.replace(which, joints=joints)), Constraints(), 100, 0)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (parse_box, "x=0.5:0.2"),
        (parse_box, "w=0:1"),
        (parse_box, "0:1"),
        (parse_half_space, "z=0.1"),
        (parse_half_space, "0.5q>=1"),
        (parse_half_space, "z>=fast"),
        (parse_half_space, "0z>=1"),
        (partial(lengths, expected="three numbers such as 2.5,0,1.2"), "1,2"),
        (partial(lengths, expected="three numbers such as 2.5,0,1.2"), "1,2,3deg"),
        (partial(lengths, expected="nearest and farthest such as 0.5:15"), "5"),
    ],
)
def test_texts_that_mean_nothing_are_refused(call: object, text: str) -> None:
    with pytest.raises(UsageError, match="`option`"):
        call(text, "option")  # type: ignore[operator]


def test_a_farthest_distance_before_the_nearest_is_refused() -> None:
    with pytest.raises(UsageError, match="`distance`: the farthest distance must be beyond the nearest, found '5:2'"):
        robacc.plan(arm("irb1600").robot, instrument="2,0,1", distance="5:2")


def test_texts_of_places() -> None:
    side = parse_half_space("3x - 4y <= 500mm", "half_space")
    assert (side.normals, side.offsets) == (pytest.approx(np.array([[0.6, -0.8, 0.0]])), pytest.approx([0.1]))
    box = parse_box("x=-100mm:0.2,z=0.1:", "inside")
    assert box.offsets.tolist() == [0.2, np.inf, np.inf, 0.1, np.inf, -0.1]
