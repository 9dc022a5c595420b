"""Gauss-Newton with exact Jacobians, re-linearised to convergence: the sum of whitened squares and of Gaussian priors.

Residual and Jacobian of a step are one evaluation; the last step needs the residual alone. A step that would raise
the cost is halved until it does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robacc.errors import EquilibriumError
from robacc.fitting.linear_algebra import solved
from robacc.fitting.normal_equations import NormalEquations, PoseEquations, PredictedPoses
from robacc.fitting.whitening import Whitening
from robacc.geometry import Array

_STEPS = 40
_DAMPINGS = (1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2)
"""Damping of the scaled normal matrix, whose diagonal is one."""
_FIRST_HALVINGS = 2
_HALVINGS = 12
_FAST = 0.1
"""Steps that shrink by at least this factor are trusted to shrink on."""
_PARALLEL = 0.95
"""Cosine from which two steps are parallel."""
_QUICK, _ENDLESS = 0.05, 0.97
"""Limits of the ratio of successive steps between which the series is summed: smaller ratios converge by themselves,
larger ones need not converge."""
_EXACT = 1e-15
"""m or rad: rounding of a predicted position (at some metres) or orientation."""
_SHORT = 0.03
"""Length of a step, over the residual's, below which a fit that cannot be improved counts as converged."""


@dataclass(frozen=True, slots=True)
class Minimum:
    """Minimum at which Gauss-Newton ended."""

    predicted: PredictedPoses
    normal: NormalEquations
    """The last linearisation; the minimum follows from it by one step, which is taken."""
    steps: int
    converged: bool
    """False if the steps ended before they were short."""


@dataclass(frozen=True, slots=True)
class _Move:
    predicted: PredictedPoses
    normal: NormalEquations | None
    cost: float
    step_share: float
    """Share of the proposed step."""


def minimise(
    equations: PoseEquations,
    begin: PredictedPoses,
    normal: NormalEquations | None,
    white: Whitening,
    precision: Array,
    tolerance: float,
) -> Minimum:
    """Go from ``begin``, whose linearisation is ``normal`` if it is known already, to the minimum.

    ``white`` whitens residuals, ``precision`` ``(P,)`` is of priors about zero. The last step is one that changes the
    whitened prediction by less than ``tolerance`` of the residual, or whose successors are expected to.
    """
    columns = equations.columns
    prior = precision[columns]
    predicted = begin
    if normal is None:
        predicted, normal = equations.linearise(begin.theta, white)
    cost = float(normal.cost + prior @ np.square(normal.theta))
    rounding = _EXACT * float(white.weight.max(initial=0.0))
    previous_step: Array | None = None
    previous_length: float | None = None
    count = 0
    converged = columns.size == 0
    while columns.size and count < _STEPS:
        count += 1
        step = _step(normal, prior)
        length = _length(step, normal.gram)
        settled_length = max(tolerance * (1.0 + float(np.sqrt(cost))), rounding * float(np.sqrt(columns.size)))
        is_last = length <= settled_length or _expected_length(length, previous_length) <= settled_length
        step, previous_step = _extrapolated(step, previous_step, normal.gram)
        # Near the minimum, rounding decides which of two costs is lower; a full step is then still taken.
        limit = cost + 4.0 * rounding * float(np.sqrt(cost)) + rounding**2 * white.weight.size
        move = _line_search(
            equations, predicted, step, limit, white, prior, derivative=not is_last, halvings=_FIRST_HALVINGS
        )
        if move is None:
            # Along a weakly identifiable direction a step is as long as its uncertainty and leaves the linear range.
            # Halving it would hold up all other directions; damping holds up only this one.
            move = _damped(equations, predicted, normal, limit, white, prior)
            previous_step = None
        if move is None:
            move = _line_search(equations, predicted, step, limit, white, prior, derivative=not is_last)
        if move is None:
            converged = length <= _SHORT * (1.0 + float(np.sqrt(cost)))
            break
        predicted, cost = move.predicted, min(move.cost, cost)
        previous_length = length if move.step_share == 1.0 and previous_step is not None else None
        if move.normal is None:
            converged = True
            break
        normal = move.normal
    return Minimum(predicted, normal, count, converged)


def _step(normal: NormalEquations, prior: Array, damping: float = 0.0) -> Array:
    with np.errstate(divide="ignore"):
        scale = 1.0 / np.sqrt(np.diag(normal.gram) + prior)
    scale[~np.isfinite(scale)] = 0.0  # without any information: it stays
    matrix = (normal.gram + np.diag(prior)) * scale[:, None] * scale + damping * np.eye(scale.size)
    step: Array = scale * solved(matrix, scale * (normal.gradient - prior * normal.theta))
    return step


def _length(step: Array, gram: Array) -> float:
    return float(np.sqrt(max(float(step @ gram @ step), 0.0)))


def _expected_length(length: float, previous_length: float | None) -> float:
    """Return the expected length of all further steps after one of ``length`` and one of ``previous_length``.

    Gauss-Newton converges at a constant rate in the end and faster before, so the series of steps is at most geometric.
    """
    if previous_length is None or previous_length <= 0 or length > _FAST * previous_length:
        return np.inf
    rate = length / previous_length
    return length * rate / (1.0 - rate)


def _line_search(
    equations: PoseEquations,
    present: PredictedPoses,
    step: Array,
    limit: float,
    white: Whitening,
    prior: Array,
    *,
    derivative: bool,
    halvings: int = _HALVINGS,
) -> _Move | None:
    """Return the step, halved until the cost is within ``limit``; None if it never is."""
    columns = equations.columns
    for halving in range(halvings):
        step_share = 0.5**halving
        theta = present.theta.copy()
        theta[columns] += step * step_share
        normal: NormalEquations | None = None
        try:
            if derivative:
                predicted, normal = equations.linearise(theta, white)
                residual_cost = normal.cost
            else:
                predicted = equations.predict(theta)
                residual_cost = float(np.sum(np.square(white.apply(predicted.residual))))
        except EquilibriumError:
            continue
        cost = float(residual_cost + prior @ np.square(theta[columns]))
        if cost <= limit:
            return _Move(predicted, normal, cost, step_share)
    return None


def _damped(
    equations: PoseEquations,
    present: PredictedPoses,
    normal: NormalEquations,
    limit: float,
    white: Whitening,
    prior: Array,
) -> _Move | None:
    """Return the least damped Levenberg-Marquardt step that lowers the cost; None if none does."""
    for damping in _DAMPINGS:
        step = _step(normal, prior, damping)
        if (
            move := _line_search(equations, present, step, limit, white, prior, derivative=True, halvings=1)
        ) is not None:
            return move
    return None


def _extrapolated(step: Array, previous_step: Array | None, gram: Array) -> tuple[Array, Array | None]:
    """Sum the series of parallel steps along a weak direction with curvature, which shrink by a constant ratio.

    Aitken's delta-squared in the metric of the data; the line search still judges the result.
    """
    if previous_step is None:
        return step, step
    previous_square, product = float(previous_step @ gram @ previous_step), float(step @ gram @ previous_step)
    length = float(step @ gram @ step)
    if previous_square <= 0 or length <= 0:
        return step, step
    ratio = product / previous_square
    if abs(product) < _PARALLEL * np.sqrt(previous_square * length) or not _QUICK < abs(ratio) < _ENDLESS:
        return step, step
    return step / (1 - ratio), None
