"""Gauss-Newton with exact Jacobians, re-linearised to convergence: the sum of whitened squares and of Gaussian priors.

Residual and Jacobian of a step are one evaluation; the last step needs the residual alone. A step that would make
things worse is halved until it does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robacc.errors import EquilibriumError
from robacc.fitting.normal_equations import NormalEquations, PoseEquations, Prediction
from robacc.fitting.whitening import Whitening
from robacc.geometry import Array

_STEPS = 40
_DAMPINGS = (1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2)
"""Of the scaled normal matrix, whose diagonal is one."""
_FIRST_HALVINGS = 2
_HALVINGS = 12
_FAST = 0.1
"""Steps that shrink by at least this factor are trusted to shrink on."""
_PARALLEL = 0.95
"""Cosine from which two steps go the same way."""
_QUICK, _ENDLESS = 0.05, 0.97
"""Ratios of successive steps that are worth summing: smaller ones end by themselves, larger ones need not end."""
_EXACT = 1e-15
"""m or rad: rounding of a predicted position (at some metres) or orientation."""


@dataclass(frozen=True, slots=True)
class Minimum:
    """Where Gauss-Newton ended."""

    outcome: Prediction
    normal: NormalEquations
    """The last linearisation: what stands at the minimum follows from it by one step, which is taken."""
    steps: int


@dataclass(frozen=True, slots=True)
class _Move:
    outcome: Prediction
    normal: NormalEquations | None
    cost: float
    share: float
    """Of the step that was proposed."""


def minimise(
    equations: PoseEquations,
    begin: Prediction,
    normal: NormalEquations | None,
    white: Whitening,
    precision: Array,
    tolerance: float,
) -> Minimum:
    """Go from ``begin``, whose linearisation is ``normal`` where it is known already, to the minimum.

    ``white`` whitens residuals, ``precision`` ``(P,)`` is of priors about zero. The last step is one that changes the
    whitened prediction, or is expected to leave it, within ``tolerance`` of the residual.
    """
    columns = equations.columns
    prior = precision[columns]
    outcome = begin
    if normal is None:
        outcome, normal = equations.linearise(begin.theta, white)
    cost = float(normal.energy + prior @ np.square(normal.theta))
    rounding = _EXACT * float(white.weight.max(initial=0.0))
    previous: Array | None = None
    before: float | None = None
    count = 0
    while columns.size and count < _STEPS:
        count += 1
        step = _step(normal, prior)
        length = _length(step, normal.gram)
        enough = max(tolerance * (1.0 + float(np.sqrt(cost))), rounding * float(np.sqrt(columns.size)))
        last = length <= enough or _expected(length, before) <= enough
        step, previous = _extrapolated(step, previous, normal.gram)
        # Near the minimum rounding decides which of two costs is the lower; a full step is then still taken.
        limit = cost + 4.0 * rounding * float(np.sqrt(cost)) + rounding**2 * white.weight.size
        move = _searched(equations, outcome, step, limit, white, prior, derivative=not last, halvings=_FIRST_HALVINGS)
        if move is None:
            # Along a direction that the poses hardly show a step is as long as they are uncertain of it and leaves what
            # is linear. Halved, it would hold up all the others; damped, only itself.
            move = _damped(equations, outcome, normal, limit, white, prior)
            previous = None
        if move is None:
            move = _searched(equations, outcome, step, limit, white, prior, derivative=not last)
        if move is None:
            break
        outcome, cost = move.outcome, min(move.cost, cost)
        before = length if move.share == 1.0 and previous is not None else None
        if move.normal is None:
            break
        normal = move.normal
    return Minimum(outcome, normal, count)


def posterior(gram: Array, prior: Array) -> Array:
    """``(K, K)`` inverse of the normal matrix with the priors' precision ``(K,)``, through unit diagonal."""
    scale = 1.0 / np.sqrt(np.diag(gram) + prior)
    scale[~np.isfinite(scale)] = 0.0
    inverse: Array = scale[:, None] * np.linalg.inv((gram + np.diag(prior)) * scale[:, None] * scale) * scale
    return inverse


def _step(normal: NormalEquations, prior: Array, damping: float = 0.0) -> Array:
    scale = 1.0 / np.sqrt(np.diag(normal.gram) + prior)
    matrix = (normal.gram + np.diag(prior)) * scale[:, None] * scale + damping * np.eye(scale.size)
    step: Array = scale * np.linalg.solve(matrix, scale * (normal.gradient - prior * normal.theta))
    return step


def _length(step: Array, gram: Array) -> float:
    return float(np.sqrt(max(float(step @ gram @ step), 0.0)))


def _expected(length: float, before: float | None) -> float:
    """What is left to go after a step of ``length``, the one before having been ``before`` long.

    Gauss-Newton converges at a constant rate in the end and faster before, so the series of steps is at most geometric.
    """
    if before is None or before <= 0 or length > _FAST * before:
        return np.inf
    rate = length / before
    return length * rate / (1.0 - rate)


def _searched(
    equations: PoseEquations,
    present: Prediction,
    step: Array,
    limit: float,
    white: Whitening,
    prior: Array,
    *,
    derivative: bool,
    halvings: int = _HALVINGS,
) -> _Move | None:
    """The step, halved until the cost is within ``limit``; None where it never is."""
    columns = equations.columns
    for halving in range(halvings):
        share = 0.5**halving
        theta = present.theta.copy()
        theta[columns] += step * share
        normal: NormalEquations | None = None
        try:
            if derivative:
                outcome, normal = equations.linearise(theta, white)
                squares = normal.energy
            else:
                outcome = equations.outcome(theta)
                squares = float(np.sum(np.square(white.apply(outcome.residual))))
        except EquilibriumError:
            continue
        new = float(squares + prior @ np.square(theta[columns]))
        if new <= limit:
            return _Move(outcome, normal, new, share)
    return None


def _damped(
    equations: PoseEquations, present: Prediction, normal: NormalEquations, limit: float, white: Whitening, prior: Array
) -> _Move | None:
    """The least damped of some Levenberg-Marquardt steps that lowers the cost; None where none does."""
    for damping in _DAMPINGS:
        step = _step(normal, prior, damping)
        if (move := _searched(equations, present, step, limit, white, prior, derivative=True, halvings=1)) is not None:
            return move
    return None


def _extrapolated(step: Array, previous: Array | None, gram: Array) -> tuple[Array, Array | None]:
    """Along a weak direction with curvature steps shrink by a constant ratio rho and stay parallel: sum the series.

    Aitken's delta-squared in the metric of the data; the line search still judges the result.
    """
    if previous is None:
        return step, step
    energy, shared = float(previous @ gram @ previous), float(step @ gram @ previous)
    length = float(step @ gram @ step)
    if energy <= 0 or length <= 0:
        return step, step
    ratio = shared / energy
    if abs(shared) < _PARALLEL * np.sqrt(energy * length) or not _QUICK < abs(ratio) < _ENDLESS:
        return step, step
    return step / (1 - ratio), None
