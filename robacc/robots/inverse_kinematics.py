"""Inverse kinematics: damped Newton steps on an exact Jacobian, for nominal arms and for models of real ones.

All poses are solved at once. With e the error of a pose, A its Jacobian to the joints and r
the way back to the joints of the start, a step is

    as many joints as errors, or more:  dq = r + A^T (A A^T + mu)^-1 (e - A r)
    fewer joints than errors:           dq = (A^T A + mu)^-1 A^T e

Rotations count as lengths by a weight (m per rad), and so do slides as angles. The first form ends at the solution
nearest to the start (D. E. Whitney 1969), the second at the least weighted error. The damping mu falls where a step
brings the target nearer and rises elsewhere (K. Levenberg 1944), so that singular poses stay in place. Joints stop at
their limits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem
from robacc.geometry import Array, Poses, compose, log_so3, rms_length, transpose
from robacc.robots.arm import Arm
from robacc.robots.library import low_discrepancy

_REACHED = 1e-11
"""Residual, in units of the arm's length, at which a pose counts as reached; some hundred roundings."""
_POOL = 2048
"""Configurations over the joint ranges; those with the nearest poses are the starts."""


def joint_ranges(
    arm: Arm, endless: float = np.inf, purpose: str = "to search within", fix: str | None = None
) -> tuple[Array, Array]:
    """Return lower and upper limit ``(J,)`` of the joint variables.

    Args:
        arm: The arm.
        endless: Limit of a revolute joint without limits, rad.
        purpose: What the ranges are for, and ``fix`` how to do without limits, for the message.
        fix: See ``purpose``.

    Raises:
        InputError: A prismatic joint has no limits.
    """
    joints = arm.robot.variables
    problems = [
        Problem(
            f"the prismatic joint {joint.name} has no limits {purpose}", column=f"joints.{joint.name}.limits", fix=fix
        )
        for joint in joints
        if joint.limits is None and joint.type == "prismatic"
    ]
    if problems:
        raise InputError(problems)
    low, high = np.array([joint.limits or (-endless, endless) for joint in joints]).T
    return low, high


def spread_configurations(arm: Arm, count: int) -> Array:
    """Return joint variables ``(J, count)`` spread evenly over each range.

    Revolute joints stay within half a turn of the middle of theirs.
    """
    low, high = (
        np.where(np.isfinite(limits), limits, sign * np.pi)
        for limits, sign in zip(joint_ranges(arm), (-1, 1), strict=True)
    )
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    revolute = np.array([joint.type == "revolute" for joint in arm.robot.variables])
    half = np.where(revolute, np.minimum(half, np.pi), half)
    return np.asarray(middle[:, None] + half[:, None] * (2.0 * low_discrepancy(low.size, count) - 1.0))


def pose_jacobian(arm: Arm, q: Array) -> tuple[Poses, Array]:
    """Return target poses at ``q`` ``(J, N)`` and their Jacobian ``(6, J, N)`` to ``q``, measuring frame."""
    drives = arm.chain.drives
    sweep = arm.chain.sweep(arm.chain.scalars(q), q.shape[1], [drive.motion for drive in drives])
    jacobian = np.zeros((6, q.shape[0], q.shape[1]))
    for i, drive in enumerate(drives):
        jacobian[:, drive.joint] += drive.coefficient * sweep.jacobian[:, i]
    return sweep.poses, jacobian


def inverse_kinematics(arm: Arm, desired: Poses, *, starts: int | Array = 16, oriented: bool = True) -> JointSolution:
    """Return joint variables for the desired poses, from several starts each.

    Args:
        arm: The arm; its chain is inverted without effects.
        desired: Poses of the target ``(N)`` in the measuring frame.
        starts: Either the number of configurations with the nearest poses to start from, or configurations ``(J, S)``
            to start every pose from.
        oriented: Solve for position and orientation; else for position alone.

    Raises:
        InputError: A prismatic joint has no limits.
    """
    length = _length(arm)
    if isinstance(starts, int):
        q0 = _nearest(arm, desired, starts, oriented, length)
    else:
        q0 = np.repeat(starts[:, None, :], desired.translation.shape[1], axis=1)
    joints, n, s = q0.shape
    repeated = Poses(np.repeat(desired.rotation, s, axis=2), np.repeat(desired.translation, s, axis=1))
    low, high = joint_ranges(arm)
    scale = np.array([1.0 if joint.type == "revolute" else length for joint in arm.robot.variables])
    space = JointSpace(low, high, scale, length, np.repeat([1.0, length][: 1 + oriented], 3))

    def evaluate(q: Array, index: NDArray[np.int64]) -> tuple[Array, Array]:
        poses, jacobian = pose_jacobian(arm, q)
        error = pose_error(part_of(repeated, index), poses, oriented)
        return error, jacobian[: len(error)]

    solution = solve(evaluate, q0.reshape(joints, n * s), space, stay=False)
    error = np.sqrt(np.sum(np.square(space.weights[:, None] * solution.error), axis=0)).reshape(n, s)
    unlimited = np.isinf(low) & np.isinf(high)
    q = np.where(unlimited[:, None], np.arctan2(np.sin(solution.q), np.cos(solution.q)), solution.q)
    return JointSolution(q.reshape(joints, n, s), error, error <= _REACHED * length)


def _length(arm: Arm) -> float:
    """Return the arm's size, m, which weighs radians against lengths independently of the unit of length."""
    poses = arm.chain.forward(spread_configurations(arm, 64))
    return max(rms_length(poses.translation - np.array(arm.robot.base.xyz)[:, None]), 1e-9)


def _nearest(arm: Arm, desired: Poses, count: int, oriented: bool, length: float) -> Array:
    """Return the configurations ``(J, N, count)`` of the pool whose poses are nearest each desired pose."""
    pool = spread_configurations(arm, _POOL)
    pool_poses = arm.chain.forward(pool)
    starts = np.empty((pool.shape[0], desired.translation.shape[1], count))
    for i in range(desired.translation.shape[1]):
        distance = np.sum(np.square(pool_poses.translation - desired.translation[:, [i]]), axis=0)
        if oriented:
            # |R1 - R2|^2 (Frobenius) is 4 (1 - cos angle): near twice the squared angle.
            rotation_distance = np.sum(np.square(pool_poses.rotation - desired.rotation[..., [i]]), axis=(0, 1))
            distance = distance + 0.5 * length**2 * rotation_distance
        starts[:, i] = pool[:, np.argsort(distance, kind="stable")[:count]]
    return starts


def pose_error(wanted: Poses, poses: Poses, oriented: bool) -> Array:
    """Return the way from ``poses`` to ``wanted``: m, and for oriented targets a rotation vector in rad."""
    position = wanted.translation - poses.translation
    if not oriented:
        return position
    return np.concatenate((position, log_so3(compose(wanted.rotation, transpose(poses.rotation)))))


def part_of(poses: Poses, index: NDArray[np.int64]) -> Poses:
    """Return some of the poses."""
    return Poses(poses.rotation[..., index], poses.translation[:, index])


# Damped steps to wanted poses, all targets at once.

_PATIENCE = 5
"""Steps without gain after which a target is given up."""
_SETTLED = 1e-11
"""Step (rad, slides in arm lengths) at which a target is done, far below any resolution."""
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-14, 1e-16, 1e3
_RAISED = 1e-7
"""Damping after the first step that brings a target no nearer."""
_LARGEST_STEP = 0.3
"""rad: largest step of a joint; longer steps leave the configuration."""

Evaluate = Callable[[Array, NDArray[np.int64]], tuple[Array, Array]]
"""Errors ``(R, M)`` and their Jacobian ``(R, J, M)`` at joints ``(J, M)`` of the targets with numbers ``(M,)``."""


@dataclass(frozen=True, slots=True)
class JointSpace:
    """Joints of an arm and errors of its pose, as the solver scales and limits them."""

    low: Array
    """``(J,)`` rad or m; -inf without a limit."""
    high: Array
    scale: Array
    """``(J,)`` size of a joint's unit step: 1 rad, or the arm's length for a slide."""
    length: float
    """Size of the arm, m: RMS distance of its target from its base."""
    weights: Array
    """``(R,)`` weight of each component of the error: 1 for m, a length for rad."""


@dataclass(frozen=True, slots=True)
class JointSolution:
    """Joints at the end of the iteration, for N problems, or for N poses from S starts each with starts last."""

    q: Array
    """``(J, N)`` rad or m, within the limits."""
    error: Array
    """``(R, N)`` remaining error, m and rad; from starts, its size ``(N, S)``: m, rotation times the arm's length."""
    converged: NDArray[np.bool_]
    """``(N,)`` whether the last step was below the tolerance; from starts, whether the pose is reached to rounding."""


def solve(
    evaluate: Evaluate, start: Array, joints: JointSpace, first: Array | None = None, *, stay: bool = True
) -> JointSolution:
    """Return the joints nearest to ``start`` ``(J, N)`` whose error is least.

    Args:
        evaluate: Errors and Jacobian.
        start: Joints to stay near, as far as an arm is redundant.
        joints: Limits, scales and weights.
        first: Joints to begin with; None for ``start``.
        stay: Return to the start as far as the arm is redundant; else each step is the shortest.
    """
    low, high, scale = (part[:, None] for part in (joints.low, joints.high, joints.scale))
    weights = joints.weights
    q, n = np.clip(start if first is None else first, low, high), start.shape[1]
    error, jacobian = np.zeros((weights.size, n)), np.zeros((weights.size, len(start), n))
    cost, damping = np.full(n, np.inf), np.full(n, _FIRST_DAMPING)
    stalled, settled = np.zeros(n, dtype=int), np.zeros(n, dtype=bool)
    index, trial = np.arange(n), q.copy()
    for _ in range(40):
        # Joints that bring a target nearer are taken; elsewhere the damping rises.
        new_error, new_jacobian = evaluate(trial[:, index], index)
        new_cost = np.sum(np.square(weights[:, None] * new_error), axis=0)
        nearer = new_cost <= cost[index] * (1.0 + 1e-9) + np.square(1e-13 * np.max(weights))
        taken, refused = index[nearer], index[~nearer]
        stalled[index] = np.where(new_cost < 0.999 * cost[index], 0, stalled[index] + 1)
        q[:, taken], cost[taken] = trial[:, taken], new_cost[nearer]
        error[:, taken], jacobian[..., taken] = new_error[:, nearer], new_jacobian[..., nearer]
        damping[taken] = np.maximum(0.1 * damping[taken], _LEAST_DAMPING)
        damping[refused] = np.clip(30.0 * damping[refused], _RAISED, _MOST_DAMPING)
        matrix = weights[:, None, None] * jacobian[..., index] * scale
        back = stay * (start[:, index] - q[:, index]) / scale
        at_low, at_high = q[:, index] <= low, q[:, index] >= high
        step = _step(matrix, weights[:, None] * error[:, index], back, damping[index], at_low, at_high)
        settled[index] = np.max(np.abs(step), axis=0, initial=0.0) < _SETTLED
        trial[:, index] = np.clip(q[:, index] + step * scale, low, high)
        index = index[~settled[index] & (stalled[index] < _PATIENCE)]
        if index.size == 0:
            break
    return JointSolution(q, error, settled)


def _step(
    matrix: Array, error: Array, back: Array, damping: Array, at_low: NDArray[np.bool_], at_high: NDArray[np.bool_]
) -> Array:
    """Return the scaled step ``(J, M)``; joints at a limit that would leave their range stay."""
    fixed = np.zeros(back.shape, dtype=bool)
    for _ in range(back.shape[0] + 1):
        step = _damped_step(matrix, error, back, damping)
        added = ((at_low & (step < 0.0)) | (at_high & (step > 0.0))) & ~fixed
        if not added.any():
            break
        fixed |= added
        matrix, back = np.where(fixed, 0.0, matrix), np.where(fixed, 0.0, back)
        damping = np.where(fixed.any(axis=0), np.maximum(damping, _RAISED), damping)
    largest = np.maximum(np.max(np.abs(step), axis=0, initial=0.0), 1e-300)
    return np.asarray(step * np.minimum(1.0, _LARGEST_STEP / largest))


def _damped_step(matrix: Array, error: Array, back: Array, damping: Array) -> Array:
    """Return steps ``(J, M)`` for scaled Jacobians ``(R, J, M)``, errors ``(R, M)`` and ways back ``(J, M)``."""
    rows, columns = matrix.shape[:2]
    stacked = np.moveaxis(matrix, 2, 0)
    transposed = np.swapaxes(stacked, 1, 2)
    size = np.maximum(np.einsum("mij,mij->m", stacked, stacked), 1e-300) / min(rows, columns)
    weak = (damping * size)[:, None, None]
    if columns < rows:
        normal = transposed @ stacked + weak * np.eye(columns)
        return np.asarray(np.linalg.solve(normal, transposed @ error.T[..., None])[..., 0].T)
    if columns == rows:
        back = np.zeros_like(back)
    remaining = error - np.einsum("ijm,jm->im", matrix, back)
    normal = stacked @ transposed + weak * np.eye(rows)
    return np.asarray(back + (transposed @ np.linalg.solve(normal, remaining.T[..., None]))[..., 0].T)
