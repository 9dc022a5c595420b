"""Estimates with intervals for every kind of number in ISO 9283: distances of means, repeatability, and others.

Visits of one commanded pose are treated as independent Gaussian samples; a drift during the run counts as scatter,
which makes the intervals wider, not narrower. No interval includes the systematic part of the measuring uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from robacc.geometry import Array
from robacc.statistics.distributions import normal_quantile, student_quantile
from robacc.statistics.intervals import (
    STUDENT,
    EstimateOrReason,
    Interval,
    chi2_interval,
    interpolated,
    student_interval,
    tails,
)
from robacc.statistics.lengths import length_probability, mean_lengths
from robacc.statistics.multivariate import principal_axes

CHI_SQUARE = "chi-square"
MOVER = "from the intervals of both estimates (method of variance estimates recovery)"
ONE_VISIT = "one visit has no scatter to estimate an interval from"
FEW_VISITS = "fewer than three visits"


@dataclass(frozen=True, slots=True)
class IntervalEstimate:
    """A number with the functions that compute its interval."""

    value: float
    interval_at: Callable[[float], Interval]
    """Interval at a confidence."""

    def __post_init__(self) -> None:
        """Cache the intervals: each place and the largest over places use the same ones."""
        object.__setattr__(self, "interval_at", lru_cache(maxsize=8)(self.interval_at))

    def figure(self, confidence: float) -> EstimateOrReason:
        """Return the number with its interval at a confidence."""
        return EstimateOrReason(self.value, self.interval_at(confidence))


def without_interval(value: float, reason: str) -> IntervalEstimate:
    """Return a number without an interval, and the reason."""
    return IntervalEstimate(value, lambda confidence: Interval.missing(confidence, reason))


def student(value: float, standard_error: float, dof: float, method: str = STUDENT) -> IntervalEstimate:
    """Return a number with a standard error on ``dof`` degrees of freedom; infinite: normal, below 1: no interval."""
    if dof < 1:
        return without_interval(value, ONE_VISIT)
    return IntervalEstimate(value, lambda confidence: student_interval(value, standard_error, dof, confidence, method))


def mean(values: Array, offset: float = 0.0) -> IntervalEstimate:
    """Return the mean of ``values`` ``(n,)`` minus ``offset``, by Student's t."""
    deviation = float(np.std(values, ddof=1)) if values.size > 1 else 0.0
    return student(float(np.mean(values)) - offset, deviation / math.sqrt(values.size), values.size - 1)


def magnitude(signed: IntervalEstimate) -> IntervalEstimate:
    """Return the absolute value of a signed estimate."""

    def interval_at(confidence: float) -> Interval:
        interval = signed.interval_at(confidence)
        if interval.lower is None or interval.upper is None or interval.upper_bound is None:
            return interval
        lowest = max(0.0, interval.lower, -interval.upper)
        bound = abs(signed.value) + (interval.upper_bound - signed.value)
        return Interval(lowest, max(-interval.lower, interval.upper), bound, confidence, interval.method)

    return IntervalEstimate(abs(signed.value), interval_at)


def threefold_std(values: Array) -> IntervalEstimate:
    """Return 3 S of ``values`` ``(n,)``, n at least 2, S with divisor n - 1; the interval is exact if Gaussian."""
    value = 3.0 * float(np.std(values, ddof=1))
    dof = values.size - 1.0
    return IntervalEstimate(value, lambda confidence: chi2_interval(value**2, dof, confidence, CHI_SQUARE).root())


def change(after: IntervalEstimate, before: IntervalEstimate) -> IntervalEstimate:
    """Return ``after - before`` of two independent estimates, from their intervals.

    Source: G. Y. Zou, A. Donner, "Construction of confidence limits about effect measures", Statistics in Medicine 27,
    2008.
    """
    value = after.value - before.value

    def interval_at(confidence: float) -> Interval:
        later, earlier = after.interval_at(confidence), before.interval_at(confidence)
        for interval in (later, earlier):
            if interval.lower is None or interval.upper is None:
                return interval
        if later.upper_bound is None:
            return Interval.missing(confidence, FEW_VISITS)

        def apart(rise: float | None, fall: float | None) -> float:
            return math.hypot((rise or 0.0) - after.value, before.value - (fall or 0.0))

        # The lower limit at twice the tail is the one-sided bound.
        two_sided = before.interval_at(2.0 * confidence - 1.0).lower if confidence > 0.5 else before.value
        lower, upper = value - apart(later.lower, earlier.upper), value + apart(later.upper, earlier.lower)
        return Interval(lower, upper, value + apart(later.upper_bound, two_sided), confidence, MOVER)

    return IntervalEstimate(value, interval_at)


def largest_figure(estimates: Sequence[IntervalEstimate], confidence: float) -> tuple[int, EstimateOrReason]:
    """Return the index of the largest estimate, and the figure of the largest of the true values.

    The largest upper limit needs no correction: it is at least the upper limit of the estimate whose true value is
    largest. Chance would raise the largest lower limit, so each is computed at the tail divided by the number of
    estimates (Bonferroni).
    """
    largest = max(range(len(estimates)), key=lambda i: estimates[i].value)
    value = estimates[largest].value
    intervals = [estimate.interval_at(confidence) for estimate in estimates]
    missing = next((interval for interval in intervals if interval.upper is None), None)
    if missing is not None or len(estimates) == 1:
        return largest, EstimateOrReason(value, missing or intervals[0])
    adjusted, lower = 1.0 - (1.0 - confidence) / len(estimates), 0.0
    for plain, i in sorted(((interval.lower or 0.0, i) for i, interval in enumerate(intervals)), reverse=True):
        # A limit at a stricter confidence is lower, so that the first few decide.
        if plain <= lower:
            break
        lower = max(lower, estimates[i].interval_at(adjusted).lower or 0.0)
    upper = max(interval.upper or 0.0 for interval in intervals)
    upper_bound = max(interval.upper_bound or 0.0 for interval in intervals)
    method = f"{intervals[largest].method}; largest of {len(estimates)}"
    return largest, EstimateOrReason(value, Interval(lower, upper, upper_bound, confidence, method))


def largest_estimate(estimates: Sequence[IntervalEstimate]) -> IntervalEstimate:
    """Return the largest of the estimates' true values, as an estimate."""
    value = max(estimate.value for estimate in estimates)
    return IntervalEstimate(value, lambda confidence: largest_figure(estimates, confidence)[1].interval)


# Length of a mean vector with its interval: the distance between barycentres.

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

    if not np.any(variances > 0.0):
        return IntervalEstimate(value, lambda confidence: Interval.exact(value, confidence))
    return IntervalEstimate(value, interval_at)


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


# Position repeatability RP_l = mean l + 3 S_l with its interval.

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
        return IntervalEstimate(0.0, lambda confidence: Interval.exact(0.0, confidence))
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
    mean_length = float(mean_lengths(variances[:, None])[0])
    true_repeatability = mean_length + 3.0 * math.sqrt(max(float(np.sum(variances)) - mean_length**2, 0.0))
    return np.asarray(repeatability / true_repeatability)
