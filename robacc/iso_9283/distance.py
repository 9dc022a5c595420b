"""Length of a mean vector with its interval: the distance between barycentres."""

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

NONCENTRAL = "noncentral: the true distances under which the measured distance is likely, scatter as between visits"
_MAX_STEPS = 60
_ROOT_TOLERANCE = 1e-5
"""Relative accuracy of a limit."""
_SMALLEST_PROBABILITY = 1e-15
"""Probabilities are clipped to at least this, and to at most its complement."""
_FAR_FROM_ZERO = 20.0
"""Standard errors from zero beyond which a distance has the error of its own direction (to 1 part in 800)."""


def distance(difference: Array, covariance: Array, dof: float) -> IntervalEstimate:
    """Return the length of a mean vector ``(3,)`` with covariance ``(3, 3)`` on ``dof`` degrees of freedom.

    The length is never negative, and it is too large for a vector that is small compared with its scatter. The limits
    are therefore the true lengths under which a length as large or as small has the probability of the tail. Each uses
    the direction under which the measured vector is likeliest, the constrained maximum of the likelihood (T. J.
    DiCiccio, M. A. Martin, S. E. Stern, Canadian Journal of Statistics 29, 2001). The scatter is widened by Student's t
    over the normal quantile, which is exact where the length is large.
    """
    value = float(np.linalg.norm(difference))
    if dof < 1:
        return without_interval(value, ONE_VISIT)
    variances, axes = principal_axes(covariance)
    components = axes.T @ difference
    if value**2 > _FAR_FROM_ZERO**2 * float(np.sum(variances)):
        return student(value, math.sqrt(float(np.sum(variances * components**2))) / value, dof)

    def solve(tail: float, upper_tail: bool) -> float:
        widened = variances * (student_quantile(1.0 - tail, dof) / normal_quantile(1.0 - tail)) ** 2

        target = normal_quantile(1.0 - tail if upper_tail else tail)

        def excess(length: float) -> float:
            """Return the normal quantile's excess, which rises nearly linearly through zero with the true length."""
            probability = min(
                max(
                    length_probability(value, _likeliest_mean(components, variances, length), widened),
                    _SMALLEST_PROBABILITY,
                ),
                1.0 - _SMALLEST_PROBABILITY,
            )
            return target - normal_quantile(probability)

        return _rising_root(excess, value + 6.0 * math.sqrt(float(np.sum(widened))), value)

    def interval_at(confidence: float) -> Interval:
        tail = 0.5 * (1.0 - confidence)
        # No true length is likely for a vector much shorter than its scatter, and the upper limit would be zero; the
        # scatter along the longest axis bounds it from below.
        upper, bound = (
            max(
                solve(tail_probability, False),
                value,
                math.sqrt(float(variances[0])) * student_quantile(1.0 - tail_probability, dof),
            )
            for tail_probability in (tail, 1.0 - confidence)
        )
        return Interval(solve(tail, True), upper, bound, confidence, NONCENTRAL)

    def lower_at(confidence: float) -> float:
        return solve(0.5 * (1.0 - confidence), True)

    if not np.any(variances > 0.0):
        return IntervalEstimate(value, lambda confidence: Interval(value, value, value, confidence, "no scatter"))
    return IntervalEstimate(value, interval_at, lower_at)


def _likeliest_mean(components: Array, variances: Array, length: float) -> Array:
    """Return the mean ``(3,)`` of that length under which ``components`` are likeliest, in principal axes.

    The mean is c_i / (1 + lambda v_i); its length falls with lambda, from infinity at -1 / (largest v) to nearly zero.
    """
    scaled = [
        (float(component), float(ratio / variances[0])) for component, ratio in zip(components, variances, strict=True)
    ]

    def mean_at(multiplier: float) -> list[float]:
        return [component / (1.0 + multiplier * ratio) for component, ratio in scaled]

    low, high = 1e-12, 1e9
    for _ in range(_MAX_STEPS):
        # The length is even in the logarithm of 1 + lambda.
        middle = math.sqrt(low * high)
        low, high = (middle, high) if math.hypot(*mean_at(middle - 1.0)) > length else (low, middle)
    likeliest = mean_at(math.sqrt(low * high) - 1.0)
    likeliest_length = math.hypot(*likeliest)
    if likeliest_length == 0.0:
        return np.array([length, 0.0, 0.0])
    return np.array(likeliest) * (length / likeliest_length)


def _rising_root(function: Callable[[float], float], high: float, guess: float) -> float:
    """Return the zero of a rising function in ``0 … high``, or an end if it has none (secants within a bracket)."""
    low = 0.0
    if (value_low := function(low)) >= 0.0:
        return low
    value_high, root = function(high), guess
    for _ in range(_MAX_STEPS):
        value = function(root)
        low, value_low, high, value_high = (
            (root, value, high, value_high) if value < 0.0 else (low, value_low, root, value)
        )
        last, root = root, low - value_low * (high - low) / (value_high - value_low)
        if not low + 0.01 * (high - low) < root < high - 0.01 * (high - low):
            # Close to an end: step past the root, so that the other end moves too.
            root = min(max(root, low + 0.01 * (high - low)), high - 0.01 * (high - low))
        if abs(root - last) <= _ROOT_TOLERANCE * root or high - low <= _ROOT_TOLERANCE * high:
            break
    return root
