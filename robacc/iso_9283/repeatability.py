"""Position repeatability RP_l = mean l + 3 S_l with its interval."""

from __future__ import annotations

import math

import numpy as np

from robacc.geometry import Array
from robacc.iso_9283.estimates import FEW_VISITS, IntervalEstimate, student, without_interval
from robacc.statistics.intervals import Interval, interpolated, tails
from robacc.statistics.multivariate import principal_axes

PIVOT = "parametric bootstrap: RP over the true RP, for Gaussian visits with the same scatter"
DELTA = "delta method, normal"
_DRAWS = 4000
_MAX_FOR_BOOTSTRAP = 300
"""With more visits, the delta method's error is far below the scatter of the draws."""


def position_repeatability(residuals: Array, seed: tuple[int, ...]) -> IntervalEstimate:
    """Return RP_l = mean l + 3 S_l, l the lengths of ``residuals`` ``(3, n)`` about their barycentre, n at least 2."""
    n = residuals.shape[1]
    lengths = np.sqrt(np.sum(np.square(residuals), axis=0))
    length_std = float(np.std(lengths, ddof=1))
    value = float(np.mean(lengths)) + 3.0 * length_std
    if n < 3:
        return without_interval(value, FEW_VISITS)
    if not np.any(lengths > 0.0):
        return IntervalEstimate(0.0, lambda confidence: Interval(0.0, 0.0, 0.0, confidence, "no scatter"))
    if n > _MAX_FOR_BOOTSTRAP:
        # Influence of a visit on mean + 3 S: its length, and 3 times its part of dS = d(S^2) / (2 S).
        influence = lengths + 1.5 * np.square(lengths - np.mean(lengths)) / length_std if length_std > 0.0 else lengths
        return student(value, float(np.std(influence, ddof=1)) / math.sqrt(n), math.inf, DELTA)
    variances, _ = principal_axes(residuals @ residuals.T / (n - 1.0))
    ratios = _simulated_ratios(variances, n, seed)

    def interval_at(confidence: float) -> Interval:
        below, above, bound = tails(confidence)
        high, low, top = interpolated(ratios, [p * (ratios.size - 1) for p in (below, above, 1.0 - bound)])
        return Interval(value / low, value / high, value / top, confidence, f"{PIVOT}, {_DRAWS} draws")

    return IntervalEstimate(value, interval_at)


def _simulated_ratios(variances: Array, n: int, seed: tuple[int, ...]) -> Array:
    """Return RP of ``n`` simulated visits over RP of infinitely many visits, ``(draws,)``."""
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((3, _DRAWS, n)) * np.sqrt(variances)[:, None, None]
    points -= points.mean(axis=2, keepdims=True)
    lengths = np.sqrt(np.sum(np.square(points), axis=0))
    repeatability = lengths.mean(axis=1) + 3.0 * lengths.std(axis=1, ddof=1)
    mean_length = mean_gaussian_length(variances)
    true_repeatability = mean_length + 3.0 * math.sqrt(max(float(np.sum(variances)) - mean_length**2, 0.0))
    result: Array = repeatability / true_repeatability
    return result


def mean_gaussian_length(variances: Array) -> float:
    """Return E|z|, z ~ N(0, diag(v)), v ``(3,)``: the integral over s of (1 - prod (1 + 2 v_i s^2)^-1/2)/s^2/sqrt(pi).

    From E sqrt(Q) = (1 / (2 sqrt(pi))) integral of (1 - E exp(-t Q)) t^-3/2 dt with t = s^2; s = tan(u) / sqrt(2 tr).
    """
    trace = float(np.sum(variances))
    nodes, weights = np.polynomial.legendre.leggauss(120)
    angle = 0.25 * math.pi * (nodes + 1.0)
    s = np.tan(angle)
    product = np.prod(1.0 + variances[:, None] / trace * s**2, axis=0) ** -0.5
    integral = float(np.sum(weights * (1.0 - product) / np.sin(angle) ** 2)) * 0.25 * math.pi
    return math.sqrt(2.0 * trace / math.pi) * integral
