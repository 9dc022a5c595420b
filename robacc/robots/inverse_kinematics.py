"""Inverse kinematics: damped least squares on the chain's exact Jacobian.

Each problem is one desired pose and one start. With r the pose's error (position, and the rotation vector times a
length, so that both are lengths) and J its Jacobian to the joint variables, a step solves

    (J^T J + lambda D) dq = J^T r,    D = diag(J^T J) + a floor

(K. Levenberg 1944; D. W. Marquardt 1963; for arms C. W. Wampler 1986), lambda falling where a step brings the target
nearer and rising elsewhere. Steps stop at the joint limits; a joint that is at a limit and would leave its range is
fixed for the step. All problems are solved side by side, poses last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem
from robacc.geometry import Array, Poses, compose, log_so3, rms_length, transpose
from robacc.robots.arm import Arm
from robacc.robots.library import low_discrepancy

_STEPS = 80
_REACHED = 1e-11
"""Residual, in units of the arm's length, at which a pose counts as reached; some hundred roundings."""
_SLOW, _PATIENCE = 0.98, 6
"""Ratio and number of steps: a descent ends after so many steps that leave more than this share of the residual."""
_FIRST_DAMPING = 1e-3
_MIN_DAMPING, _MAX_DAMPING = 1e-12, 1e6
_FLOOR = 1e-6
"""Lowest scale of the damping as a share of the largest: a joint without effect on the pose does not move."""
_POOL = 2048
"""Configurations over the joint ranges; those with the nearest poses are the starts."""


@dataclass(frozen=True, slots=True)
class Solutions:
    """Solutions for N poses from S starts each, starts last."""

    q: Array
    """``(J, N, S)`` joint variables, rad or m, within the limits."""
    converged: NDArray[np.bool_]
    """``(N, S)``: whether the pose is reached to rounding."""
    error: Array
    """``(N, S)`` remaining error: m, with rotation times the arm's length."""


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


def inverse_kinematics(arm: Arm, desired: Poses, *, starts: int | Array = 16, oriented: bool = True) -> Solutions:
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
    q, error = _descend(arm, repeated, q0.reshape(joints, n * s), oriented, length)
    low, high = (limits[:, None] for limits in joint_ranges(arm))
    unlimited = np.isinf(low) & np.isinf(high)
    q = np.where(unlimited, np.arctan2(np.sin(q), np.cos(q)), q)
    return Solutions(
        np.clip(q, low, high).reshape(joints, n, s), (error <= _REACHED * length).reshape(n, s), error.reshape(n, s)
    )


def _length(arm: Arm) -> float:
    """Return the arm's size, m, which weighs radians against lengths independently of the unit of length."""
    poses = arm.chain.forward(spread_configurations(arm, 64))
    base = np.array(arm.robot.base.xyz)[:, None]
    return max(rms_length(poses.translation - base), 1e-9)


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


def _residual(poses: Poses, desired: Poses, weight: float) -> tuple[Array, Array]:
    """Return the error ``(6, M)``, m, rotations times ``weight`` (m; 0 for positions alone), and its norm ``(M,)``."""
    turn = log_so3(compose(desired.rotation, transpose(poses.rotation)))
    residual = np.concatenate((desired.translation - poses.translation, weight * turn))
    return residual, np.sqrt(np.sum(np.square(residual), axis=0))


def _descend(arm: Arm, desired: Poses, q: Array, oriented: bool, length: float) -> tuple[Array, Array]:
    """Return joint variables ``(J, M)`` and residual norms ``(M,)`` of M problems after Levenberg-Marquardt steps."""
    weight = length if oriented else 0.0
    low, high = (limits[:, None] for limits in joint_ranges(arm))
    q = np.clip(q, low, high)
    error = np.full(q.shape[1], np.inf)
    damping = np.full(q.shape[1], _FIRST_DAMPING)
    stalled = np.zeros(q.shape[1], dtype=int)
    open_ = np.arange(q.shape[1])
    for _ in range(_STEPS):
        target = Poses(desired.rotation[..., open_], desired.translation[:, open_])
        poses, jacobian = pose_jacobian(arm, q[:, open_])
        residual, before = _residual(poses, target, weight)
        jacobian[3:] *= weight
        trial = np.clip(q[:, open_] + _step(jacobian, residual, q[:, open_], low, high, damping[open_]), low, high)
        _, after = _residual(arm.chain.forward(trial), target, weight)
        nearer = after < before
        q[:, open_] = np.where(nearer, trial, q[:, open_])
        damping[open_] = np.clip(damping[open_] * np.where(nearer, 0.1, 8.0), _MIN_DAMPING, _MAX_DAMPING)
        error[open_] = np.where(nearer, after, before)
        # A problem is done at a tenth of the residual that counts as reached, or out of reach after slow steps.
        slow = ~nearer | (error[open_] > _SLOW * before)
        stalled[open_] = np.where(slow, stalled[open_] + 1, 0)
        unfinished = (error[open_] > 0.1 * _REACHED * length) & (stalled[open_] < _PATIENCE)
        open_ = open_[unfinished]
        if open_.size == 0:
            break
    return q, error


def _step(jacobian: Array, residual: Array, q: Array, low: Array, high: Array, damping: Array) -> Array:
    """Return the damped step ``(J, M)``; joints at a limit that would leave their range stay fixed."""
    gradient = np.einsum("ijm,im->jm", jacobian, residual)
    fixed = ((q <= low) & (gradient < 0)) | ((q >= high) & (gradient > 0))
    jacobian = np.where(fixed, 0.0, jacobian)
    gradient = np.where(fixed, 0.0, gradient)
    matrix = np.einsum("ijm,ikm->mjk", jacobian, jacobian)
    diagonal = np.einsum("mjj->mj", matrix)
    scale = diagonal + _FLOOR * np.max(diagonal, axis=1, keepdims=True, initial=0.0) + 1e-300
    matrix = matrix + np.einsum("mj,jk->mjk", damping[:, None] * scale, np.eye(q.shape[0]))
    # A fixed joint's row is zero but for its damping; a unit diagonal keeps the matrix regular at any damping.
    matrix[:, np.arange(q.shape[0]), np.arange(q.shape[0])] += fixed.T
    return np.asarray(np.linalg.solve(matrix, gradient.T[..., None])[..., 0].T)
