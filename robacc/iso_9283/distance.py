"""The length of a mean vector, with its interval: how far barycentres are apart."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from robacc.geometry import Array
from robacc.iso_9283.estimates import ONE_VISIT, IntervalEstimate, student, without_interval
from robacc.statistics.distributions import normal_quantile, student_quantile
from robacc.statistics.intervals import Interval
from robacc.statistics.multivariate import principal_axes
from robacc.statistics.quadratic_form import length_probability

NONCENTRAL = "noncentral: the distances under which the one found is likely, scatter as between visits"
_MOST_STEPS = 60
_FINE = 1e-5
"""Of a limit, as a part of it."""
_RARE = 1e-15
"""Probability below which none is told apart."""
_CLEAR = 20.0
"""Standard errors from zero on, a distance errs as its component along itself does (to 1 part in 800)."""


def distance(difference: Array, covariance: Array, dof: float) -> IntervalEstimate:
    """The length of a mean vector ``(3,)`` whose covariance ``(3, 3)`` was estimated on ``dof`` degrees of freedom.

    The length is never negative and, of a vector that is small beside its scatter, too large. The limits are therefore
    the true lengths under which a length so large or so small has the probability of the tail; each with the direction
    under which the vector found is likeliest, the constrained maximum of the likelihood (T. J. DiCiccio, M. A. Martin,
    S. E. Stern, Canadian Journal of Statistics 29, 2001). The scatter is widened by Student's t over the normal
    quantile, which is exact where the length is large.
    """
    value = float(np.linalg.norm(difference))
    if dof < 1:
        return without_interval(value, ONE_VISIT)
    variances, axes = principal_axes(covariance)
    found = axes.T @ difference
    if value**2 > _CLEAR**2 * float(np.sum(variances)):
        return student(value, math.sqrt(float(np.sum(variances * found**2))) / value, dof)

    def solve(tail: float, beyond: bool) -> float:
        widened = variances * (student_quantile(1.0 - tail, dof) / normal_quantile(1.0 - tail)) ** 2

        wanted = normal_quantile(1.0 - tail if beyond else tail)

        def excess(length: float) -> float:
            """Rises through zero with the true length, nearly straight, as a normal quantile does."""
            below = min(
                max(length_probability(value, _likeliest(found, variances, length), widened), _RARE), 1.0 - _RARE
            )
            return wanted - normal_quantile(below)

        return _rising_root(excess, 0.0, value + 6.0 * math.sqrt(float(np.sum(widened))), value)

    def at(confidence: float) -> Interval:
        tail = 0.5 * (1.0 - confidence)
        # Of a vector shorter than its scatter would ever leave it no true length is likely, and the upper limit would
        # be zero; it is kept at what the scatter along one axis allows.
        upper, bound = (
            max(solve(p, False), value, math.sqrt(float(variances[0])) * student_quantile(1.0 - p, dof))
            for p in (tail, 1.0 - confidence)
        )
        return Interval(solve(tail, True), upper, bound, confidence, NONCENTRAL)

    def low(confidence: float) -> float:
        return solve(0.5 * (1.0 - confidence), True)

    if not np.any(variances > 0.0):
        return IntervalEstimate(value, lambda confidence: Interval(value, value, value, confidence, "no scatter"))
    return IntervalEstimate(value, at, low)


def _likeliest(found: Array, variances: Array, length: float) -> Array:
    """The mean ``(3,)`` of that length under which ``found`` is likeliest, in principal axes.

    It is found_i / (1 + lambda v_i); its length falls with lambda, from infinity at -1 / (largest v) to nearly zero.
    """
    parts = [(float(x), float(v / variances[0])) for x, v in zip(found, variances, strict=True)]

    def mean(multiplier: float) -> list[float]:
        return [x / (1.0 + multiplier * v) for x, v in parts]

    low, high = 1e-12, 1e9
    for _ in range(_MOST_STEPS):
        # The length is even in the logarithm of 1 + lambda.
        middle = math.sqrt(low * high)
        low, high = (middle, high) if math.hypot(*mean(middle - 1.0)) > length else (low, middle)
    likeliest = mean(math.sqrt(low * high) - 1.0)
    size_found = math.hypot(*likeliest)
    if size_found == 0.0:
        return np.array([length, 0.0, 0.0])
    return np.array(likeliest) * (length / size_found)


def _rising_root(function: Callable[[float], float], low: float, high: float, guess: float) -> float:
    """Where a rising function passes zero in ``low … high``, an end where it does not (secants within a bracket)."""
    if (below := function(low)) >= 0.0:
        return low
    above, root = function(high), guess
    for _ in range(_MOST_STEPS):
        found = function(root)
        low, below, high, above = (root, found, high, above) if found < 0.0 else (low, below, root, found)
        last, root = root, low - below * (high - low) / (above - below)
        if not low + 0.01 * (high - low) < root < high - 0.01 * (high - low):
            # Next to an end: a step past the root, lest the other end stays where it is.
            root = min(max(root, low + 0.01 * (high - low)), high - 0.01 * (high - low))
        if abs(root - last) <= _FINE * root or high - low <= _FINE * high:
            break
    return root
