"""Joint commands that make a model reach wanted poses: damped Newton steps, all targets at once.

With e the error of a pose, A its Jacobian to the joints and r the way back to the joints of the start, a step is

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

from robacc.geometry import Array

_STEPS = 25
_PATIENCE = 5
"""Steps without gain after which a target is given up."""
_SETTLED = 1e-8
"""Step (rad, slides in arm lengths) at which a target is done; a micrometre is a hundred such steps."""
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-14, 1e-16, 1e3
_RAISED = 1e-7
"""Damping after the first step that brings a target no nearer."""
_LARGEST_STEP = 0.3
"""rad: largest step of a joint; longer steps leave the configuration."""

Evaluate = Callable[[Array, NDArray[np.int64]], tuple[Array, Array]]
"""Errors ``(R, M)`` and their Jacobian ``(R, J, M)`` at joints ``(J, M)`` of the targets with numbers ``(M,)``."""


@dataclass(frozen=True, slots=True)
class JointSpace:
    """Joints of an arm as the solver scales and limits them."""

    low: Array
    """``(J,)`` rad or m; -inf without a limit."""
    high: Array
    scale: Array
    """``(J,)`` size of a joint's unit step: 1 rad, or the arm's length for a slide."""


@dataclass(frozen=True, slots=True)
class JointSolution:
    """Joints at the end of the iteration."""

    q: Array
    """``(J, N)`` rad or m."""
    error: Array
    """``(R, N)`` remaining error, m and rad."""
    settled: NDArray[np.bool_]
    """``(N,)`` whether the last step was below the tolerance."""


def solve(
    evaluate: Evaluate, start: Array, joints: JointSpace, weights: Array, first: Array | None = None
) -> JointSolution:
    """Return the joints nearest to ``start`` ``(J, N)`` whose error is least.

    Args:
        evaluate: Errors and Jacobian.
        start: Joints to stay near, as far as an arm is redundant.
        joints: Limits and scales.
        weights: ``(R,)`` weight of each component of the error: 1 for m, a length for rad.
        first: Joints to begin with; None for ``start``.
    """
    low, high, scale = (part[:, None] for part in (joints.low, joints.high, joints.scale))
    q, n = np.clip(start if first is None else first, low, high), start.shape[1]
    error, jacobian = np.zeros((weights.size, n)), np.zeros((weights.size, len(start), n))
    cost, damping = np.full(n, np.inf), np.full(n, _FIRST_DAMPING)
    stalled, settled = np.zeros(n, dtype=int), np.zeros(n, dtype=bool)
    index, trial = np.arange(n), q.copy()
    for _ in range(_STEPS):
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
        back = (start[:, index] - q[:, index]) / scale
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
