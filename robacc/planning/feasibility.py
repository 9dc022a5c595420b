"""Filters of candidate poses, with a count of what each excludes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array, Poses
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.planning.collisions import SELF_COLLISION
from robacc.planning.constraints import Constraints, HalfSpace, Sight
from robacc.robots.arm import Arm
from robacc.robots.description import Robot

MARGIN = "joint limits with margin"
_MOVES = 1e-6
"""m; a corner of the arm that moves less stands still and is part of the pedestal."""
_BLOCK = 4096


@dataclass(frozen=True, slots=True)
class Exclusion:
    """Candidates that one reason excludes."""

    reason: str
    count: int
    """Candidates that it excludes, whether another reason does or not."""
    alone: int
    """Candidates that only this reason excludes."""


@dataclass(frozen=True, slots=True)
class Filtered:
    """Outcome of the filters for N poses."""

    feasible: NDArray[np.bool_]
    """``(N,)``"""
    place: NDArray[np.bool_]
    """``(N,)`` poses that the robot may take, whether the instrument sees them or not."""
    position: Array
    """``(3, N)`` target in the base frame, m; the mean of several targets."""
    excluded: dict[str, NDArray[np.bool_]]
    """``(N,)`` excluded poses, by reason."""


def exclusions(parts: Sequence[Filtered]) -> tuple[Exclusion, ...]:
    """Return the count of each reason over several blocks of poses, the largest first."""
    reasons = dict.fromkeys(reason for part in parts for reason in part.excluded)
    counts = []
    for reason in reasons:
        count = alone = 0
        for part in parts:
            if reason not in part.excluded:
                continue
            others = [mask for other, mask in part.excluded.items() if other != reason]
            mask = part.excluded[reason]
            count += int(np.count_nonzero(mask))
            alone += int(np.count_nonzero(mask & ~np.any(others, axis=0))) if others else int(np.count_nonzero(mask))
        counts.append(Exclusion(reason, count, alone))
    return tuple(sorted(counts, key=lambda entry: -entry.count))


def filtered(model: Model, q: Array, constraints: Constraints) -> Filtered:
    """Return which joint variables ``(J, N)`` are feasible, and why the others are not."""
    arm = model.arm
    excluded = {MARGIN: ~within_margin(arm, q, constraints.margin)}
    targets = _targets(model, q)
    position = np.mean([target.translation for target in targets], axis=0)
    if constraints.inside is not None:
        inside = [constraints.inside.contains(target.translation) for target in targets]
        excluded[f"target outside the box {constraints.inside.text}"] = ~np.all(inside, axis=0)
    _exclude_places(excluded, arm, q, targets, constraints)
    if constraints.collisions is not None:
        excluded[SELF_COLLISION] = constraints.collisions.self_collision(q)
    if constraints.max_condition is not None:
        condition = joint_condition(arm, q)
        excluded[f"near a singularity (condition above {constraints.max_condition:g})"] = (
            condition > constraints.max_condition
        )
    place = ~np.any(list(excluded.values()), axis=0)
    if constraints.sight is not None:
        excluded |= _out_of_sight(targets, constraints.sight)
    return Filtered(~np.any(list(excluded.values()), axis=0), place, position, excluded)


def _exclude_places(
    excluded: dict[str, NDArray[np.bool_]], arm: Arm, q: Array, targets: Sequence[Poses], constraints: Constraints
) -> None:
    """Add the poses that take a point of the arm where it must not be."""
    if not (constraints.outside or constraints.half_spaces or constraints.min_height is not None):
        return
    points = np.concatenate((moving_points(arm, q), np.stack([t.translation for t in targets], axis=1)), axis=1)
    links = constraints.collisions
    for box in constraints.outside:
        inside = np.any(box.contains(points), axis=0)
        excluded[f"a point of the arm inside the box {box.text}"] = (
            inside if links is None else inside | links.in_box(q, box.low, box.high)
        )
    sides = [(half_space, f"a point of the arm beyond {half_space.text}") for half_space in constraints.half_spaces]
    if constraints.min_height is not None:
        floor = HalfSpace((0.0, 0.0, -1.0), -constraints.min_height, "")
        sides.append((floor, f"below the minimum height of {constraints.min_height:g} m"))
    for half_space, reason in sides:
        beyond = ~np.all(half_space.contains(points), axis=0)
        excluded[reason] = beyond if links is None else beyond | links.beyond(q, half_space.normal, half_space.offset)


def within_margin(arm: Arm, q: Array, margin: float) -> NDArray[np.bool_]:
    """Return ``(N,)`` which poses keep ``margin``, a share of each range, from the joint limits."""
    result = np.ones(q.shape[1], dtype=bool)
    for row, joint in zip(q, arm.robot.variables, strict=True):
        if joint.limits is not None:
            low, high = joint.limits
            # A microradian: the resolution that commanded joints are rounded to.
            keep = margin * (high - low) - 1e-6
            result &= (row >= low + keep) & (row <= high - keep)
    return result


def _targets(model: Model, q: Array) -> list[Poses]:
    """Return the pose of each target in the base frame."""
    arm = model.arm
    result = []
    for name in tuple(arm.robot.targets) or (None,):
        n = q.shape[1]
        data = Measurements(position=np.zeros((3, n)), q=q, target=None if name is None else np.full(n, name))
        nominal = Model(arm).bind(data).poses(np.zeros(0))
        result.append(in_base_frame(arm, nominal))
    return result


def targets_in_base(robot: Robot, q: Array) -> Array:
    """Return ``(3, N)`` nominal positions of the target in the base frame, m; the mean of several targets."""
    result: Array = np.mean([target.translation for target in _targets(Model(Arm.of(robot)), q)], axis=0)
    return result


def in_base_frame(arm: Arm, poses: Poses) -> Poses:
    """Return poses in the measuring frame as poses in the robot's base frame."""
    base = Poses.from_xyz_rpy(np.array(arm.robot.base.xyz), np.array(arm.robot.base.rpy))
    turn = base.rotation.reshape(3, 3)
    shifted = poses.translation - base.translation.reshape(3, 1)
    return Poses(np.einsum("ji,jkn->ikn", turn, poses.rotation), turn.T @ shifted)


def moving_points(arm: Arm, q: Array) -> Array:
    """Return ``(3, K, N)`` corners of the arm's outline that move, in the base frame, m."""
    motions = arm.chain.motions
    counts = [k + 1 for k, motion in enumerate(motions[: arm.flange]) if motion.kind == "translation"]
    blocks = []
    for start in range(0, max(q.shape[1], 1), _BLOCK):
        part = q[:, start : start + _BLOCK]
        frames = arm.chain.sweep(arm.chain.scalars(part), part.shape[1], (), counts).frames
        places = [np.broadcast_to(frame.translation, (3, part.shape[1])) for frame in frames]
        blocks.append(np.stack(places, axis=1) if places else np.zeros((3, 0, part.shape[1])))
    points = np.concatenate(blocks, axis=2)
    moves = np.ptp(points, axis=2).max(axis=0) > _MOVES if points.shape[2] > 1 else np.ones(points.shape[1], bool)
    points = points[:, moves]
    base = Poses.from_xyz_rpy(np.array(arm.robot.base.xyz), np.array(arm.robot.base.rpy))
    shifted = points - base.translation.reshape(3, 1, 1)
    result: Array = np.einsum("ji,jkn->ikn", base.rotation.reshape(3, 3), shifted)
    return result


def joint_condition(arm: Arm, q: Array) -> Array:
    """Return ``(N,)`` condition number of the joints' Jacobian, lengths in units of the target's mean distance."""
    result = np.empty(q.shape[1])
    for start in range(0, q.shape[1], _BLOCK):
        part = q[:, start : start + _BLOCK]
        jacobian = arm.chain.jacobian(part, arm.chain.joint_axis)
        reach = float(np.mean(np.linalg.norm(in_base_frame(arm, arm.chain.forward(part)).translation, axis=0)))
        jacobian[:3] /= max(reach, 1e-9)
        values = np.linalg.svd(np.moveaxis(jacobian, 2, 0), compute_uv=False)
        with np.errstate(divide="ignore"):
            result[start : start + _BLOCK] = values[:, 0] / values[:, -1]
    return result


def _out_of_sight(targets: Sequence[Poses], sight: Sight) -> dict[str, NDArray[np.bool_]]:
    """Return the poses at which a target is not visible, by reason."""
    near, far = sight.distance
    too_near = np.zeros(targets[0].translation.shape[1], dtype=bool)
    too_far, turned_away = too_near.copy(), too_near.copy()
    for target in targets:
        ray = np.array(sight.position)[:, None] - target.translation
        distance = np.linalg.norm(ray, axis=0)
        too_near |= distance < near
        too_far |= distance > far
        if sight.axis is not None:
            axis = np.array(sight.axis) / np.linalg.norm(sight.axis)
            facing = np.einsum("ijn,j->in", target.rotation, axis)
            cosine = np.sum(facing * ray, axis=0) / np.maximum(distance, 1e-12)
            turned_away |= cosine < np.cos(sight.cone)
    result = {}
    if near > 0:
        result[f"nearer to the instrument than {near:g} m"] = too_near
    if np.isfinite(far):
        result[f"farther from the instrument than {far:g} m"] = too_far
    if sight.axis is not None:
        result[f"reflector turned away by more than {np.degrees(sight.cone):g}°"] = turned_away
    return result
