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
    n = start.shape[1]
    state = _State(evaluate, start, joints, weights, start if first is None else first)
    open_ = np.arange(n)
    trial = state.q.copy()
    for _ in range(_STEPS):
        state.accept(trial, open_)
        step = state.step(open_)
        done = np.max(np.abs(step), axis=0, initial=0.0) < _SETTLED
        state.settled[open_[done]] = True
        trial[:, open_] = state.limited(open_, step)
        open_ = open_[~done & (state.stalled[open_] < _PATIENCE)]
        if open_.size == 0:
            break
    return JointSolution(state.q, state.error, state.settled)


class _State:
    """Best joints so far of every target, with error, Jacobian and damping."""

    def __init__(self, evaluate: Evaluate, start: Array, joints: JointSpace, weights: Array, first: Array) -> None:
        count, n = start.shape
        self.evaluate, self.joints, self.weights = evaluate, joints, weights
        self.start = start
        self.q = np.clip(first, joints.low[:, None], joints.high[:, None])
        self.error = np.zeros((weights.size, n))
        self.jacobian = np.zeros((weights.size, count, n))
        self.cost = np.full(n, np.inf)
        self.damping = np.full(n, _FIRST_DAMPING)
        self.stalled = np.zeros(n, dtype=int)
        self.settled = np.zeros(n, dtype=bool)

    def accept(self, trial: Array, index: NDArray[np.int64]) -> None:
        """Take the trial joints of the targets that they bring nearer; raise the damping of the others."""
        error, jacobian = self.evaluate(trial[:, index], index)
        cost = np.sum(np.square(self.weights[:, None] * error), axis=0)
        rounding = np.square(1e-13 * np.max(self.weights))
        nearer = cost <= self.cost[index] * (1.0 + 1e-9) + rounding
        taken, refused = index[nearer], index[~nearer]
        self.stalled[index] = np.where(cost < 0.999 * self.cost[index], 0, self.stalled[index] + 1)
        self.q[:, taken], self.cost[taken] = trial[:, taken], cost[nearer]
        self.error[:, taken], self.jacobian[..., taken] = error[:, nearer], jacobian[..., nearer]
        self.damping[taken] = np.maximum(0.1 * self.damping[taken], _LEAST_DAMPING)
        self.damping[refused] = np.clip(30.0 * self.damping[refused], _RAISED, _MOST_DAMPING)

    def step(self, index: NDArray[np.int64]) -> Array:
        """Return the scaled step ``(J, M)``; joints at a limit that would leave their range stay."""
        matrix = self.weights[:, None, None] * self.jacobian[..., index] * self.joints.scale[:, None]
        error = self.weights[:, None] * self.error[:, index]
        back = (self.start[:, index] - self.q[:, index]) / self.joints.scale[:, None]
        q, low, high = self.q[:, index], self.joints.low[:, None], self.joints.high[:, None]
        damping, fixed = self.damping[index], np.zeros(q.shape, dtype=bool)
        for _ in range(q.shape[0] + 1):
            step = _damped_step(matrix, error, back, damping)
            added = (((q <= low) & (step < 0.0)) | ((q >= high) & (step > 0.0))) & ~fixed
            if not added.any():
                break
            fixed |= added
            matrix, back = np.where(fixed, 0.0, matrix), np.where(fixed, 0.0, back)
            damping = np.where(fixed.any(axis=0), np.maximum(damping, _RAISED), damping)
        largest = np.maximum(np.max(np.abs(step), axis=0, initial=0.0), 1e-300)
        result: Array = step * np.minimum(1.0, _LARGEST_STEP / largest)
        return result

    def limited(self, index: NDArray[np.int64], step: Array) -> Array:
        """Return the joints after a scaled step, within their limits."""
        moved = self.q[:, index] + step * self.joints.scale[:, None]
        result: Array = np.clip(moved, self.joints.low[:, None], self.joints.high[:, None])
        return result


def _damped_step(matrix: Array, error: Array, back: Array, damping: Array) -> Array:
    """Return steps ``(J, M)`` for scaled Jacobians ``(R, J, M)``, errors ``(R, M)`` and ways back ``(J, M)``."""
    rows, columns = matrix.shape[:2]
    stacked = np.moveaxis(matrix, 2, 0)
    transposed = np.swapaxes(stacked, 1, 2)
    size = np.maximum(np.einsum("mij,mij->m", stacked, stacked), 1e-300) / min(rows, columns)
    weak = (damping * size)[:, None, None]
    if columns < rows:
        normal = transposed @ stacked + weak * np.eye(columns)
        solution: Array = np.linalg.solve(normal, transposed @ error.T[..., None])[..., 0].T
        return solution
    if columns == rows:
        back = np.zeros_like(back)
    remaining = error - np.einsum("ijm,jm->im", matrix, back)
    normal = stacked @ transposed + weak * np.eye(rows)
    solution = back + (transposed @ np.linalg.solve(normal, remaining.T[..., None]))[..., 0].T
    return solution
