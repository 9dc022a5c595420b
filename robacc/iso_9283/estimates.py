"""Estimates that can state their interval at any confidence, for every kind of number that ISO 9283 asks for.

Visits of one commanded pose are taken as independent Gaussian draws; a drift during the run counts as scatter, which
makes the intervals wider, not narrower. The systematic part of the measuring uncertainty is in none of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from robacc.geometry import Array
from robacc.iso_9283.records import Figure
from robacc.statistics.distributions import normal_quantile, student_quantile
from robacc.statistics.intervals import Interval, chi2_interval, interpolated, tails
from robacc.statistics.multivariate import principal_axes
from robacc.statistics.quadratic_form import length_probability

STUDENT = "Student's t"
NONCENTRAL = "noncentral: the distances under which the one found is likely, scatter as between visits"
PIVOT = "parametric bootstrap: RP over the true RP, for Gaussian visits that scatter as these do"
DELTA = "delta method, normal"
CHI_SQUARE = "chi-square"
MOVER = "from the intervals of the two (method of variance estimates recovery)"
_ONE = "one visit shows no scatter"
_FEW = "fewer than three visits"
_DRAWS = 4000
_MOST_FOR_BOOTSTRAP = 300
"""With more visits the delta method's error is far within the scatter of the draws."""
_MOST_STEPS = 60
_FINE = 1e-5
"""Of a limit, as a part of it."""
_RARE = 1e-15
"""Probability below which none is told apart."""
_CLEAR = 20.0
"""Standard errors from zero on, a distance errs as its component along itself does (to 1 part in 800)."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number and how to get its interval."""

    value: float
    at: Callable[[float], Interval]
    """The interval at a confidence."""
    low: Callable[[float], float | None] | None = None
    """Its lower limit alone, where that costs less; the largest of many asks for it at a stricter confidence."""

    def __post_init__(self) -> None:
        """Remember the intervals: places and their largest ask for the same ones."""
        object.__setattr__(self, "at", lru_cache(maxsize=8)(self.at))

    def lower(self, confidence: float) -> float | None:
        """The lower limit of the interval at a confidence."""
        return self.at(confidence).lower if self.low is None else self.low(confidence)

    def figure(self, confidence: float) -> Figure:
        """The number with its interval at that confidence."""
        return Figure(self.value, self.at(confidence))


def without_interval(value: float, why: str) -> Estimate:
    """A number that nothing is known of besides."""
    return Estimate(value, lambda confidence: Interval.missing(confidence, why))


def student(value: float, error: float, dof: float, method: str = STUDENT) -> Estimate:
    """A number with a standard error on ``dof`` degrees of freedom; infinite for a normal one."""

    def at(confidence: float) -> Interval:
        below, _, bound = (
            normal_quantile(p) if math.isinf(dof) else student_quantile(p, dof) for p in tails(confidence)
        )
        return Interval(value + below * error, value - below * error, value + bound * error, confidence, method)

    return Estimate(value, at)


def mean(values: Array, offset: float = 0.0) -> Estimate:
    """The mean of ``values`` ``(n,)`` less ``offset``, by Student's t."""
    value = float(np.mean(values)) - offset
    if values.size < 2:
        return without_interval(value, _ONE)
    return student(value, float(np.std(values, ddof=1)) / math.sqrt(values.size), values.size - 1)


def size(signed: Estimate) -> Estimate:
    """The absolute value of a signed estimate."""

    def at(confidence: float) -> Interval:
        one = signed.at(confidence)
        if one.lower is None or one.upper is None or one.upper_bound is None:
            return one
        nearest = max(0.0, one.lower, -one.upper)
        bound = abs(signed.value) + (one.upper_bound - signed.value)
        return Interval(nearest, max(-one.lower, one.upper), bound, confidence, one.method)

    def low(confidence: float) -> float | None:
        lower = signed.lower(confidence) if signed.value >= 0.0 else at(confidence).lower
        return None if lower is None else max(lower, 0.0)

    return Estimate(abs(signed.value), at, low)


def threefold_sd(values: Array) -> Estimate:
    """3 S of ``values`` ``(n,)``, S with divisor n - 1; n at least 2. The interval is exact for Gaussian values."""
    value = 3.0 * float(np.std(values, ddof=1))
    dof = values.size - 1.0
    return Estimate(value, lambda confidence: chi2_interval(value**2, dof, confidence, CHI_SQUARE).root())


def distance(difference: Array, covariance: Array, dof: float) -> Estimate:
    """The length of a mean vector ``(3,)`` whose covariance ``(3, 3)`` was estimated on ``dof`` degrees of freedom.

    The length is never negative and, of a vector that is small beside its scatter, too large. The limits are therefore
    the true lengths under which a length so large or so small has the probability of the tail; each with the direction
    under which the vector found is likeliest, the constrained maximum of the likelihood (T. J. DiCiccio, M. A. Martin,
    S. E. Stern, Canadian Journal of Statistics 29, 2001). The scatter is widened by Student's t over the normal
    quantile, which is exact where the length is large.
    """
    value = float(np.linalg.norm(difference))
    if dof < 1:
        return without_interval(value, _ONE)
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
        return Estimate(value, lambda confidence: Interval(value, value, value, confidence, "no scatter"))
    return Estimate(value, at, low)


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


def position_repeatability(residuals: Array, seed: tuple[int, ...]) -> Estimate:
    """RP_l = mean l + 3 S_l with l the lengths of ``residuals`` ``(3, n)`` about their barycentre, n at least 2."""
    n = residuals.shape[1]
    length = np.sqrt(np.sum(np.square(residuals), axis=0))
    spread = float(np.std(length, ddof=1))
    value = float(np.mean(length)) + 3.0 * spread
    if n < 3:
        return without_interval(value, _FEW)
    if not np.any(length > 0.0):
        return Estimate(0.0, lambda confidence: Interval(0.0, 0.0, 0.0, confidence, "no scatter"))
    if n > _MOST_FOR_BOOTSTRAP:
        # What one visit adds to mean + 3 S: its length and 3 times its square's part of dS = d(S^2) / (2 S).
        influence = length + 1.5 * np.square(length - np.mean(length)) / spread if spread > 0.0 else length
        return student(value, float(np.std(influence, ddof=1)) / math.sqrt(n), math.inf, DELTA)
    variances, _ = principal_axes(residuals @ residuals.T / (n - 1.0))
    ratios = _ratios(variances, n, seed)

    def at(confidence: float) -> Interval:
        below, above, bound = tails(confidence)
        high, low, top = interpolated(ratios, [p * (ratios.size - 1) for p in (below, above, 1.0 - bound)])
        return Interval(value / low, value / high, value / top, confidence, f"{PIVOT}, {_DRAWS} draws")

    return Estimate(value, at)


def _ratios(variances: Array, n: int, seed: tuple[int, ...]) -> Array:
    """RP of ``n`` simulated visits over the RP that infinitely many would have, ``(draws,)``."""
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((3, _DRAWS, n)) * np.sqrt(variances)[:, None, None]
    points -= points.mean(axis=2, keepdims=True)
    length = np.sqrt(np.sum(np.square(points), axis=0))
    found = length.mean(axis=1) + 3.0 * length.std(axis=1, ddof=1)
    mean_length = mean_gaussian_length(variances)
    truth = mean_length + 3.0 * math.sqrt(max(float(np.sum(variances)) - mean_length**2, 0.0))
    result: Array = found / truth
    return result


def mean_gaussian_length(variances: Array) -> float:
    """E|z| of z ~ N(0, diag(v)), v ``(3,)``: the integral over s of (1 - prod (1 + 2 v_i s^2)^-1/2) / s^2 / sqrt(pi).

    From E sqrt(Q) = (1 / (2 sqrt(pi))) integral of (1 - E exp(-t Q)) t^-3/2 dt with t = s^2; s = tan(u) / sqrt(2 tr).
    """
    trace = float(np.sum(variances))
    nodes, weights = np.polynomial.legendre.leggauss(120)
    angle = 0.25 * math.pi * (nodes + 1.0)
    s = np.tan(angle)
    product = np.prod(1.0 + variances[:, None] / trace * s**2, axis=0) ** -0.5
    integral = float(np.sum(weights * (1.0 - product) / np.sin(angle) ** 2)) * 0.25 * math.pi
    return math.sqrt(2.0 * trace / math.pi) * integral


def change(after: Estimate, before: Estimate) -> Estimate:
    """``after - before`` of two independent estimates, from their intervals.

    Source: G. Y. Zou, A. Donner, "Construction of confidence limits about effect measures", Statistics in Medicine 27,
    2008.
    """
    value = after.value - before.value

    def at(confidence: float) -> Interval:
        one, other = after.at(confidence), before.at(confidence)
        if one.lower is None or one.upper is None or other.lower is None or other.upper is None:
            return one if one.lower is None else other
        low = value - math.hypot(after.value - one.lower, other.upper - before.value)
        high = value + math.hypot(one.upper - after.value, before.value - other.lower)
        if one.upper_bound is None:
            return Interval.missing(confidence, _FEW)
        # The lower limit at twice the tail is the one-sided one.
        double = before.at(2.0 * confidence - 1.0).lower if confidence > 0.5 else before.value
        bound = value + math.hypot(one.upper_bound - after.value, before.value - (double or 0.0))
        return Interval(low, high, bound, confidence, MOVER)

    return Estimate(value, at)


def largest(estimates: Sequence[Estimate], confidence: float) -> tuple[int, Figure]:
    """Which of the estimates is largest, and the figure of the largest of their true values.

    The greatest of the upper limits holds as it stands, for it is at least the upper limit of whichever is truly the
    largest; the greatest of the lower ones would be carried up by chance, so each is taken at the tail divided by their
    number (Bonferroni).
    """
    best = max(range(len(estimates)), key=lambda i: estimates[i].value)
    value = estimates[best].value
    intervals = [one.at(confidence) for one in estimates]
    missing = next((one for one in intervals if one.upper is None), None)
    if missing is not None or len(estimates) == 1:
        return best, Figure(value, missing or intervals[0])
    lower = _lower_of_largest(estimates, confidence)
    upper = max(one.upper or 0.0 for one in intervals)
    bound = max(one.upper_bound or 0.0 for one in intervals)
    method = f"{intervals[best].method}; largest of {len(estimates)}"
    return best, Figure(value, Interval(lower, upper, bound, confidence, method))


def _lower_of_largest(estimates: Sequence[Estimate], confidence: float) -> float:
    strict = 1.0 - (1.0 - confidence) / len(estimates)
    return max(one.lower(strict) or 0.0 for one in estimates)


def largest_of(estimates: Sequence[Estimate]) -> Estimate:
    """The largest of the estimates' true values, as an estimate."""
    value = max(one.value for one in estimates)
    return Estimate(
        value,
        lambda confidence: largest(estimates, confidence)[1].interval,
        lambda confidence: _lower_of_largest(estimates, confidence),
    )
