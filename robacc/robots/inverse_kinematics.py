"""Joint variables that bring the target to wanted poses: damped least squares on the chain's exact Jacobian.

Each problem is one wanted pose and one start. With r the pose's error (position, and the rotation vector times a
length, so that both are lengths) and J its Jacobian to the joint variables, a step solves

    (J^T J + lambda D) dq = J^T r,    D = diag(J^T J) + a floor

(K. Levenberg 1944; D. W. Marquardt 1963; for arms C. W. Wampler 1986), lambda falling where a step brings the target
nearer and rising where not. Steps stop at the joint limits; a joint that stands on one and would leave takes no part
in the step. All problems go side by side, poses last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem
from robacc.geometry import Array, Poses, compose, log_so3, transpose
from robacc.robots.arm import Arm
from robacc.robots.summary import low_discrepancy

_STEPS = 80
_REACHED = 1e-11
"""Residual, in the arm's own lengths, at which a pose counts as met; some hundred roundings."""
_SLOW, _PATIENCE = 0.98, 6
"""So many steps in a row that leave more than this part of the residual end a descent: the pose is out of reach."""
_FIRST_DAMPING = 1e-3
_LEAST_DAMPING, _MOST_DAMPING = 1e-12, 1e6
_FLOOR = 1e-6
"""Of the damping's scale, as a part of the largest: a joint that moves nothing here stays put."""
_POOL = 2048
"""Configurations over the joint ranges, the nearest of which are the starts."""


@dataclass(frozen=True, slots=True)
class Solutions:
    """What was found for N poses from S starts each, the starts last."""

    q: Array
    """``(J, N, S)`` joint variables, rad or m, within the limits."""
    converged: NDArray[np.bool_]
    """``(N, S)``: whether the pose is met to rounding."""
    error: Array
    """``(N, S)`` what is left: m, with rotation times the arm's length."""


def joint_ranges(arm: Arm) -> tuple[Array, Array]:
    """Lower and upper limit ``(J,)`` of the joint variables; infinite for a turn without limits.

    Raises:
        InputError: a slide has no limits, so that its range cannot be searched.
    """
    joints = arm.robot.variables
    problems = [
        Problem(f"the slide {joint.name} has no limits to search within", column=f"joints.{joint.name}.limits")
        for joint in joints
        if joint.limits is None and joint.type == "prismatic"
    ]
    if problems:
        raise InputError(problems)
    low, high = np.array([joint.limits or (-np.inf, np.inf) for joint in joints]).T
    return low, high


def spread_configurations(arm: Arm, count: int, part: float = 1.0, turn: float = np.pi) -> Array:
    """``(J, count)`` joint variables that fill the middle ``part`` of every range evenly; turns at most ±``turn``."""
    low, high = (
        np.where(np.isfinite(ends), ends, sign * np.pi) for ends, sign in zip(joint_ranges(arm), (-1, 1), strict=True)
    )
    middle, half = 0.5 * (low + high), 0.5 * part * (high - low)
    turns = np.array([joint.type == "revolute" for joint in arm.robot.variables])
    half = np.where(turns, np.minimum(half, turn), half)
    result: Array = middle[:, None] + half[:, None] * (2.0 * low_discrepancy(low.size, count) - 1.0)
    return result


def pose_jacobian(arm: Arm, q: Array) -> tuple[Poses, Array]:
    """Target poses at ``q`` ``(J, N)``, and their Jacobian ``(6, J, N)`` to the joint variables, measuring frame."""
    drives = arm.chain.drives
    sweep = arm.chain.sweep(arm.chain.scalars(q), q.shape[1], [drive.motion for drive in drives])
    jacobian = np.zeros((6, q.shape[0], q.shape[1]))
    for i, drive in enumerate(drives):
        jacobian[:, drive.joint] += drive.coefficient * sweep.jacobian[:, i]
    return sweep.poses, jacobian


def inverse_kinematics(arm: Arm, wanted: Poses, *, starts: int | Array = 16, oriented: bool = True) -> Solutions:
    """Joint variables for the wanted poses, from several starts each.

    Args:
        arm: The arm; its chain is the one that is inverted, without effects.
        wanted: Poses of the target ``(N)`` in the measuring frame.
        starts: Either how many configurations, those whose poses are nearest each wanted one, or configurations
            ``(J, S)`` to start every pose from.
        oriented: Whether orientation is wanted too; else position alone.

    Raises:
        InputError: a slide without limits.
    """
    length = _length(arm)
    q0 = _nearest(arm, wanted, starts, oriented, length) if isinstance(starts, int) else _each(starts, wanted)
    joints, n, s = q0.shape
    repeated = Poses(np.repeat(wanted.rotation, s, axis=2), np.repeat(wanted.translation, s, axis=1))
    q, error = _descend(arm, repeated, q0.reshape(joints, n * s), oriented, length)
    low, high = (ends[:, None] for ends in joint_ranges(arm))
    endless = np.isinf(low) & np.isinf(high)
    q = np.where(endless, np.arctan2(np.sin(q), np.cos(q)), q)
    return Solutions(
        np.clip(q, low, high).reshape(joints, n, s), (error <= _REACHED * length).reshape(n, s), error.reshape(n, s)
    )


def _length(arm: Arm) -> float:
    """The arm's size, m: what a radian is worth, so that no unit of length matters."""
    poses = arm.chain.forward(spread_configurations(arm, 64))
    base = np.array(arm.robot.base.xyz)[:, None]
    return max(float(np.sqrt(np.mean(np.sum(np.square(poses.translation - base), axis=0)))), 1e-9)


def _each(starts: Array, wanted: Poses) -> Array:
    return np.repeat(starts[:, None, :], wanted.translation.shape[1], axis=1)


def _nearest(arm: Arm, wanted: Poses, count: int, oriented: bool, length: float) -> Array:
    """``(J, N, count)`` the configurations of the pool whose poses are nearest each wanted one."""
    pool = spread_configurations(arm, _POOL)
    there = arm.chain.forward(pool)
    found = np.empty((pool.shape[0], wanted.translation.shape[1], count))
    for i in range(wanted.translation.shape[1]):
        distance = np.sum(np.square(there.translation - wanted.translation[:, [i]]), axis=0)
        if oriented:
            # |R1 - R2|^2 (Frobenius) is 4 (1 - cos angle): near twice the squared angle.
            apart = np.sum(np.square(there.rotation - wanted.rotation[..., [i]]), axis=(0, 1))
            distance = distance + 0.5 * length**2 * apart
        found[:, i] = pool[:, np.argsort(distance, kind="stable")[:count]]
    return found


def _residual(poses: Poses, wanted: Poses, oriented: bool, length: float) -> Array:
    """``(6, M)``, or ``(3, M)`` for positions alone, m."""
    position = wanted.translation - poses.translation
    if not oriented:
        return position
    return np.concatenate((position, length * log_so3(compose(wanted.rotation, transpose(poses.rotation)))))


def _descend(arm: Arm, wanted: Poses, q: Array, oriented: bool, length: float) -> tuple[Array, Array]:
    """Levenberg and Marquardt's descent of M problems at once: ``q`` ``(J, M)`` and the residuals' lengths ``(M,)``."""
    low, high = (ends[:, None] for ends in joint_ranges(arm))
    q = np.clip(q, low, high)
    error = np.full(q.shape[1], np.inf)
    damping = np.full(q.shape[1], _FIRST_DAMPING)
    stalled = np.zeros(q.shape[1], dtype=int)
    open_ = np.arange(q.shape[1])
    for _ in range(_STEPS):
        target = Poses(wanted.rotation[..., open_], wanted.translation[:, open_])
        poses, jacobian = pose_jacobian(arm, q[:, open_])
        residual = _residual(poses, target, oriented, length)
        before = error[open_] = np.sqrt(np.sum(np.square(residual), axis=0))
        step = _step(
            jacobian[:3] if not oriented else _scaled(jacobian, length),
            residual,
            q[:, open_],
            low,
            high,
            damping[open_],
        )
        trial = np.clip(q[:, open_] + step, low, high)
        after = _residual(arm.chain.forward(trial), target, oriented, length)
        nearer = np.sqrt(np.sum(np.square(after), axis=0)) < error[open_]
        q[:, open_] = np.where(nearer, trial, q[:, open_])
        damping[open_] = np.clip(damping[open_] * np.where(nearer, 0.1, 8.0), _LEAST_DAMPING, _MOST_DAMPING)
        error[open_] = np.where(nearer, np.sqrt(np.sum(np.square(after), axis=0)), error[open_])
        # Met to a tenth of what counts as met, or out of reach: step after step brings it hardly nearer.
        slow = ~nearer | (error[open_] > _SLOW * before)
        stalled[open_] = np.where(slow, stalled[open_] + 1, 0)
        going = (error[open_] > 0.1 * _REACHED * length) & (stalled[open_] < _PATIENCE)
        open_ = open_[going]
        if open_.size == 0:
            break
    return q, error


def _scaled(jacobian: Array, length: float) -> Array:
    return np.concatenate((jacobian[:3], length * jacobian[3:]))


def _step(jacobian: Array, residual: Array, q: Array, low: Array, high: Array, damping: Array) -> Array:
    """The damped step ``(J, M)``; joints on a limit that would leave it are held."""
    gradient = np.einsum("ijm,im->jm", jacobian, residual)
    held = ((q <= low) & (gradient < 0)) | ((q >= high) & (gradient > 0))
    jacobian = np.where(held, 0.0, jacobian)
    gradient = np.where(held, 0.0, gradient)
    matrix = np.einsum("ijm,ikm->mjk", jacobian, jacobian)
    diagonal = np.einsum("mjj->mj", matrix)
    scale = diagonal + _FLOOR * np.max(diagonal, axis=1, keepdims=True, initial=0.0) + 1e-300
    matrix = matrix + np.einsum("mj,jk->mjk", damping[:, None] * scale, np.eye(q.shape[0]))
    # A held joint's row is zero but for its damping; one there keeps the matrix regular at any damping.
    matrix[:, np.arange(q.shape[0]), np.arange(q.shape[0])] += held.T
    solution: Array = np.linalg.solve(matrix, gradient.T[..., None])[..., 0].T
    return solution
