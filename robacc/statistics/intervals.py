"""Confidence intervals with the name of their method, or the reason why there is none; confidence curves; resamples.

The assumptions decide which of three kinds is used:

- chi-square intervals, exact for variances of Gaussian errors (the diagonal of a Wishart matrix) and, with Welch and
  Satterthwaite's effective degrees of freedom, nearly exact for sums of variances (RMS, radius);
- the studentised bootstrap over poses (P. Hall, The Bootstrap and Edgeworth Expansion, 1992, ch. 3), for the mean of
  any quantity over poses, whatever its distribution; repetitions of one commanded pose are resampled together;
- interpolated order statistics for a percentile (J. Nyblom, "Note on interpolated order statistics", Statistics &
  Probability Letters 14, 1992), which assume no distribution.

An interval is two points of its confidence curve: the confidence that the true value lies within a limit, as a function
of the limit. The curve inverts the interval's own method, so its value at a one-sided upper bound is that bound's
confidence (T. Schweder, N. L. Hjort, Confidence, Likelihood, Probability, 2016, ch. 3). Each curve also computes how
many poses would bring its upper bound within a limit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from statistics import NormalDist
from typing import NamedTuple, Protocol, cast

import numpy as np

from robacc.geometry import Array, NDArray

# Normal, chi-square, Student, F, noncentral F and beta distributions in the standard library alone.
#
# scipy has all of them, but `import scipy.special` takes longer than a complete estimate of 100 poses. An estimate
# needs only these few, written here from :mod:`math`; the tests compare them with scipy.
#
# Sources: NIST Digital Library of Mathematical Functions, 8.9.1 and 8.9.2 (continued fractions of the incomplete gamma
# functions), 8.17.22 (continued fraction of the incomplete beta function), 5.11.1 (Stirling's series).

TINY = 1e-300
_STIRLING_FROM = 10.0
"""Argument from which Stirling's series of four terms is exact to 1e-14."""


def root(function: Callable[[float], float], low: float, high: float, tolerance: float = 1e-15) -> float:
    """Return the zero of a function between ``low`` and ``high``, to the relative ``tolerance``.

    If its signs there are the same, the zero is looked for above ``high``. Inverse quadratic interpolation where it is
    safe, else bisection: T. R. Chandrupatla, "A new hybrid quadratic/bisection algorithm for finding the zero of a
    nonlinear function", Advances in Engineering Software 28 (1997).
    """
    b, a, f_b, f_a = low, high, function(low), function(high)
    while (f_a > 0.0) == (f_b > 0.0) and abs(a) < _LARGEST:
        b, a, f_b, f_a = a, 2.0 * a, f_a, function(2.0 * a)
    c, f_c, share = b, f_b, 0.5
    while True:
        best, f_best = (a, f_a) if abs(f_a) < abs(f_b) else (b, f_b)
        smallest = (tolerance * abs(best) + TINY) / abs(b - a) if a != b else 1.0
        if smallest > 0.5 or f_best == 0.0:
            return best
        x = a + min(max(share, smallest), 1.0 - smallest) * (b - a)
        f_x = function(x)
        if (f_x > 0.0) == (f_a > 0.0):
            c, f_c = a, f_a
        else:
            c, f_c, b, f_b = b, f_b, a, f_a
        a, f_a, share = x, f_x, 0.5
        ratio, height = (a - b) / (c - b), (f_a - f_b) / (f_c - f_b)
        if height**2 < ratio and (1.0 - height) ** 2 < 1.0 - ratio:
            share = f_a / (f_b - f_a) * f_c / (f_b - f_c) + (c - a) / (b - a) * f_a / (f_c - f_a) * f_b / (f_c - f_b)


def normal_cdf(x: float) -> float:
    """Return P(Z <= x) of a standard normal Z."""
    return 0.5 * math.erfc(-x / math.sqrt(2.0))


normal_quantile = NormalDist().inv_cdf
"""Returns the x with P(Z <= x) = a probability between 0 and 1 of a standard normal Z."""


def _stirling_remainder(a: float) -> float:
    """Return the remainder log Gamma(a) - ((a - 1/2) log a - a + log(2 pi)/2) for a >= 10."""
    square = 1.0 / (a * a)
    return (1 / 12 - square * (1 / 360 - square * (1 / 1260 - square * (1 / 1680 - square / 1188)))) / a


def _log_gamma_weight(a: float, x: float) -> float:
    """Return log(x^a e^-x / Gamma(a)); for large a from x - a, because the plain formula loses digits."""
    if a < _STIRLING_FROM:
        return a * math.log(x) - x - math.lgamma(a)
    excess = (x - a) / a
    # log(1 + x) - x without cancellation near zero
    near = math.fsum(-((-excess) ** k) / k for k in range(2, 18)) if abs(excess) <= 0.1 else None
    fall = math.log(x / a) - excess if near is None else near
    return a * fall + 0.5 * math.log(a / (2.0 * math.pi)) - _stirling_remainder(a)


def _continued_fraction(first: float, terms: Callable[[int], tuple[float, float]]) -> float:
    """Return ``1 / (first + n_1 / (d_1 + n_2 / (d_2 + …)))`` with ``terms(i) = (n_i, d_i)``, by Lentz's algorithm."""
    d = value = 1.0 / (first or TINY)
    c = 1.0 / TINY
    for i in range(1, 200_000):
        numerator, denominator = terms(i)
        d = 1.0 / (denominator + numerator * d or TINY)
        c = denominator + numerator / c or TINY
        value *= c * d
        if abs(c * d - 1.0) < 2e-16:
            break
    return value


def _chi2_tail(x: float, dof: float, upper: bool) -> float:
    """Return P(chi-square > x) if ``upper``, else P(chi-square <= x); small probabilities keep their digits."""
    a, half = 0.5 * dof, 0.5 * x
    if half <= 0.0:
        return float(upper)
    is_lower = half < a + 1.0

    def term(i: int) -> tuple[float, float]:
        if is_lower:
            return (-(a + i // 2) if i % 2 else i // 2) * half, a + i
        return -i * (i - a), half + 2.0 * i + 1.0 - a

    fraction = _continued_fraction(a if is_lower else half + 1.0 - a, term)
    tail = fraction * math.exp(_log_gamma_weight(a, half))
    return 1.0 - tail if upper == is_lower else tail


chi2_cdf = partial(_chi2_tail, upper=False)
"""Returns P(chi-square <= x) from x and the degrees of freedom."""


chi2_sf = partial(_chi2_tail, upper=True)
"""Returns P(chi-square > x) from x and the degrees of freedom, exact far in the tail too."""


@lru_cache(maxsize=256)
def chi2_quantile(probability: float, dof: float) -> float:
    """Return the x with P(chi-square <= x) = ``probability``, 0 < probability < 1."""
    if probability < 0.5:  # the nearer tail keeps its digits
        return root(lambda x: chi2_cdf(x, dof) - probability, 0.0, dof)
    return root(lambda x: 1.0 - probability - chi2_sf(x, dof), 0.0, dof)


def _log_beta(a: float, b: float) -> float:
    """Return log B(a, b)."""
    a, b = max(a, b), min(a, b)
    if a < _STIRLING_FROM:
        return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)
    # log Gamma(a) - log Gamma(a + b) from the difference of the Stirling forms.
    difference = b - (a - 0.5) * math.log1p(b / a) - b * math.log(a + b)
    return math.lgamma(b) + difference + _stirling_remainder(a) - _stirling_remainder(a + b)


def beta_cdf(x: float, a: float, b: float, *, complement: float | None = None) -> float:
    """Return P(Beta(a, b) <= x), the regularised incomplete beta function; ``complement`` is a more exact 1 - x."""
    y = 1.0 - x if complement is None else complement
    if x <= 0.0 or y <= 0.0:
        return float(x > 0.0)
    if x > (a + 1.0) / (a + b + 2.0):  # the continued fraction converges fast below about the mean
        return 1.0 - beta_cdf(y, b, a, complement=x)

    def term(i: int) -> tuple[float, float]:
        m = i // 2
        numerator = m * (b - m) if i % 2 == 0 else -(a + m) * (a + b + m)
        return numerator * x / ((a + i - 1) * (a + i)), 1.0

    log_x = math.log(x) if x < 0.5 else math.log1p(-y)
    log_y = math.log(y) if y < 0.5 else math.log1p(-x)
    return math.exp(a * log_x + b * log_y - _log_beta(a, b)) / a * _continued_fraction(1.0, term)


def f_sf(x: float, dof1: float, dof2: float) -> float:
    """Return P(F with ``dof1``, ``dof2`` degrees of freedom > x)."""
    ratio = max(dof1 * x / dof2, 0.0)
    return beta_cdf(1.0 / (1.0 + ratio), 0.5 * dof2, 0.5 * dof1, complement=ratio / (1.0 + ratio))


@lru_cache(maxsize=256)
def student_quantile(probability: float, dof: float) -> float:
    """Return the t with P(Student's t with ``dof`` degrees of freedom <= t) = ``probability``; infinite: normal."""
    if math.isinf(dof) or probability == 0.5:
        return normal_quantile(probability)
    size = math.sqrt(f_critical(2.0 * min(probability, 1.0 - probability), 1.0, dof))
    return math.copysign(size, probability - 0.5)


_LARGEST = 1e60
"""Largest value that is searched."""
_EXACT = 2e4
"""Noncentrality up to which SciPy is exact. Beyond it the numerator varies by less than 1.5 %, which changes
probabilities by less than 3e-4: it counts as its mean."""


@lru_cache(maxsize=256)
def f_critical(tail: float, dof1: float, dof2: float) -> float:
    """Return the x with P(F > x) = ``tail``, 0 < ``tail`` < 1."""
    return root(lambda x: tail - f_sf(x, dof1, dof2), 0.0, 1.0)


def noncentral_f_sf(x: float, dof1: float, dof2: float, noncentrality: float) -> float:
    """Return P(F > x) of the noncentral F distribution: the power of the F test with critical value ``x``.

    ``noncentrality`` is the whitened sum of squares of the effect, orthogonal to the other coefficients of the model.
    """
    if noncentrality > _EXACT:
        return 1.0 - chi2_sf(dof2 * (noncentrality + dof1) / (dof1 * x), dof2)
    from scipy.special import ncfdtr

    return float(1.0 - ncfdtr(dof1, dof2, noncentrality, x))


@lru_cache(maxsize=256)
def needed_noncentrality(power: float, level: float, dof1: float, dof2: float) -> float:
    """Return the noncentrality at which the F test of ``level`` finds an effect with probability ``power``."""
    critical = f_critical(level, dof1, dof2)
    return root(lambda size: noncentral_f_sf(critical, dof1, dof2, size) - power, 0.0, 8.0)


# Confidence curves and intervals.

MOST_FOR_BINOMIAL = 5000
"""Number of poses above which the binomial distribution at 95 % is normal to a hundredth of a standard deviation."""
ASSURANCE = 0.9
"""Probability that a planned number of poses suffices."""
MOST_POSES = 1_000_000
"""Largest number of poses that is proposed."""


class ConfidenceCurve(Protocol):
    """Confidence curve of a quantity that is estimated from n poses."""

    def below(self, value: float) -> float:
        """Return the confidence that the true quantity is at most ``value``."""

    def poses_for(self, limit: float, confidence: float, n: int) -> int | None:
        """Return how many poses make the upper bound meet ``limit`` with probability :data:`ASSURANCE`.

        The estimate from the present ``n`` poses is taken as the truth. None where more than :data:`MOST_POSES` are
        needed.
        """


class ChiSquareCurve(NamedTuple):
    """Confidence curve of a variance-like quantity with dof * ``value`` / truth ~ chi-square(dof)."""

    value: float
    dof: float

    def below(self, value: float) -> float:
        """See :class:`ConfidenceCurve`."""
        return chi2_sf(self.dof * self.value / value, self.dof) if value > 0.0 else 0.0

    def poses_for(self, limit: float, confidence: float, n: int) -> int | None:
        """See :class:`ConfidenceCurve`; the bound is distributed as chi-square(dof) over its lower quantile."""
        if limit <= self.value:
            return None

        def suffices(poses: int) -> bool:
            dof = self.dof * poses / n
            return chi2_quantile(ASSURANCE, dof) * self.value <= chi2_quantile(1.0 - confidence, dof) * limit

        z = normal_quantile(confidence) + normal_quantile(ASSURANCE)
        return smallest_sufficient(suffices, 2.0 * (z / math.log(limit / self.value)) ** 2 * n / self.dof)


class StudentCurve(NamedTuple):
    """Confidence curve of a mean over ``size`` poses, by Student's t and, where given, bootstrap t values.

    Resampled standard errors vary less than true ones if the tails are long, so that Student's t is a floor.
    """

    mean: float
    error: float
    size: float
    bootstrap_t: Array | None
    """Resampled t values, in any order."""
    is_root: bool
    """The mean and its error are on the scale of the quantity's square root."""

    def limit(self, probability: float) -> float:
        """Return the limit below which the true quantity lies with a probability."""
        t = student_quantile(1.0 - probability, self.size - 1.0)
        if self.bootstrap_t is not None:
            drawn = quantiles(self.bootstrap_t, (1.0 - probability,))[0]
            t = max(t, drawn) if probability < 0.5 else min(t, drawn)
        limit = self.mean - t * self.error
        return max(limit, 0.0) ** 2 if self.is_root else limit

    def below(self, value: float) -> float:
        """See :class:`ConfidenceCurve`; each side uses the more cautious distribution, as the interval does."""
        if self.is_root and value <= 0.0:
            return 0.0
        t = (self.mean - (math.sqrt(value) if self.is_root else value)) / self.error
        tail = 0.5 * f_sf(t * t, 1.0, self.size - 1.0)
        student = tail if t > 0.0 else 1.0 - tail
        resampled = student if self.bootstrap_t is None else float(np.mean(self.bootstrap_t > t))
        return max(0.5, min(student, resampled)) if t <= 0.0 else min(0.5, max(student, resampled))

    def poses_for(self, limit: float, confidence: float, n: int) -> int | None:
        """See :class:`ConfidenceCurve`; the error falls with the root of the number of poses."""
        margin = (math.sqrt(limit) if self.is_root else limit) - self.mean
        bound = student_quantile(confidence, self.size - 1.0)
        if self.bootstrap_t is not None:
            ordered = np.sort(self.bootstrap_t)
            bound = max(bound, -float(ordered[int((1.0 - confidence) * (ordered.size - 1))]))
        needed = n * ((bound + normal_quantile(ASSURANCE)) * self.error / max(margin, 1e-300)) ** 2
        return max(math.ceil(needed), 2) if margin > 0.0 and needed <= MOST_POSES else None


class WiderCurve(NamedTuple):
    """Confidence curve of the wider of two intervals: the more cautious confidence on each side of the estimate."""

    curves: tuple[ConfidenceCurve, ConfidenceCurve]

    def below(self, value: float) -> float:
        """See :class:`ConfidenceCurve`."""
        low, high = sorted(curve.below(value) for curve in self.curves)
        return min(max(low, 0.5), high)

    def poses_for(self, limit: float, confidence: float, n: int) -> int | None:
        """See :class:`ConfidenceCurve`."""
        return largest_known([curve.poses_for(limit, confidence, n) for curve in self.curves])


class RootCurve(NamedTuple):
    """Confidence curve of the square root of a quantity that cannot be negative."""

    square: ConfidenceCurve

    def below(self, value: float) -> float:
        """See :class:`ConfidenceCurve`."""
        return self.square.below(value * value) if value > 0.0 else 0.0

    def poses_for(self, limit: float, confidence: float, n: int) -> int | None:
        """See :class:`ConfidenceCurve`."""
        return self.square.poses_for(limit * limit, confidence, n)


class PercentileCurve(NamedTuple):
    """Confidence curve of the ``p`` quantile of lengths: order statistics, and beyond the largest a fitted Gaussian."""

    lengths: Array
    """``(N,)``, repetitions included, in any order."""
    n: int
    """Commanded poses."""
    p: float
    model: ConfidenceCurve | None
    """Curve of the fitted Gaussian's quantile."""
    radius: float | None
    """The ``p`` quantile of the fitted Gaussian, which scales the lengths beyond the sample."""
    dof: float | None
    """Degrees of freedom of the chi-square that the squares of these lengths follow; None without scatter."""
    by_model: bool
    """The interval is the Gaussian's, because the poses are too few for order statistics."""

    def below(self, value: float) -> float:
        """See :class:`ConfidenceCurve`."""
        if self.by_model and self.model is not None:
            return self.model.below(value)
        rank = self._level(value) * (self.n + 1.0)
        by_order = percentile_confidence(rank, self.n, self.p)
        return by_order if rank < self.n or self.model is None else max(by_order, self.model.below(value))

    def poses_for(self, limit: float, confidence: float, n: int) -> int | None:
        """See :class:`ConfidenceCurve`; shares within the limit are the sample's, beyond its largest the Gaussian's."""
        if self.by_model and self.model is not None:
            poses = self.model.poses_for(limit, confidence, n)
            if poses is None or self.p**poses > 0.5 * (1.0 - confidence):
                return poses  # still too few for order statistics, so the model's interval stays in use
        share = self._level(limit)
        if self.radius and self.dof is not None and (self.by_model or share * (self.n + 1.0) >= self.n):
            beyond = chi2_cdf(chi2_quantile(self.p, self.dof) * (limit / self.radius) ** 2, self.dof)
            share = beyond if self.by_model else max(share, beyond)
        if share <= self.p:
            return None

        def suffices(poses: int) -> bool:
            # The bound is the length of this rank, so at least as many lengths must be within the limit.
            normal = self.p * poses + normal_quantile(confidence) * math.sqrt(poses * self.p * (1.0 - self.p))
            rank = smallest_sufficient(
                lambda k: percentile_confidence(k, poses, self.p) >= confidence, normal, 0, poses
            )
            return rank is not None and beta_cdf(share, float(rank), poses + 1.0 - rank) >= ASSURANCE

        quantile_std = normal_quantile(confidence) * math.sqrt(self.p * (1.0 - self.p))
        quantile_std += normal_quantile(ASSURANCE) * math.sqrt(share * (1.0 - share))
        return smallest_sufficient(suffices, (quantile_std / (share - self.p)) ** 2, tolerance=0.01)

    def _level(self, value: float) -> float:
        """Return the rank of ``value`` among the lengths as a fraction of N + 1, linear between neighbours."""
        within = self.lengths <= value
        count, size = int(np.count_nonzero(within)), self.lengths.size
        if count in (0, size) or size > MOST_FOR_BINOMIAL:
            # With so many lengths, interpolation between neighbours changes nothing.
            return count / (size + 1.0)
        low, high = float(np.max(self.lengths[within])), float(np.min(self.lengths[~within]))
        return (count + (value - low) / (high - low)) / (size + 1.0)


def percentile_confidence(rank: float, n: int, p: float) -> float:
    """Return the confidence that the order statistic of (possibly fractional) ``rank`` of n is not below the quantile.

    The k-th of n order statistics is below the quantile with the binomial probability P(Beta(k, n + 1 - k) <= p).
    Between whole ranks Nyblom's interpolation is used, and above 5000 poses the normal approximation of the binomial.
    """
    if n > MOST_FOR_BINOMIAL:
        return normal_cdf((rank / (n + 1.0) - p) / math.sqrt(p * (1.0 - p) / n))
    low = int(min(rank, n))
    between = min(rank, n) - low
    if low < 1:
        return 0.0
    at_low = beta_cdf(p, float(low), float(n + 1 - low))
    if between == 0.0:
        return 1.0 - at_low
    share = 1.0 / (1.0 + (1.0 / between - 1.0) * (n - low) * p / (low * (1.0 - p)))
    return 1.0 - at_low + share * (at_low - beta_cdf(p, low + 1.0, float(n - low)))


@lru_cache(maxsize=64)
def percentile_levels(n: int, p: float, confidence: float) -> tuple[float | None, float | None, float | None]:
    """Return ranks, as fractions of n + 1, of order statistics that bound the ``p`` quantile; None if n is too small.

    They invert :func:`percentile_confidence` at the lower limit, the upper limit and the upper bound.
    """

    def level(wanted: float) -> float | None:
        if percentile_confidence(n, n, p) < wanted or percentile_confidence(1, n, p) > wanted:
            return None
        return root(lambda rank: percentile_confidence(rank, n, p) - wanted, 1.0, n) / (n + 1.0)

    lower, upper, bound = map(level, tails(confidence))
    return lower, upper, bound


def smallest_sufficient(
    suffices: Callable[[int], bool], guess: float, tolerance: float = 0.0, most: int = MOST_POSES
) -> int | None:
    """Return the smallest number of poses that suffices; None above ``most``.

    Args:
        suffices: Monotonic test of a number of poses.
        guess: Number to try first.
        tolerance: Relative excess that the returned number may have.
        most: Largest number that is tried.
    """
    low, high = 1, min(max(math.ceil(guess), 2), most)
    while not suffices(high):
        if high == most:
            return None
        low, high = high, min(math.ceil(1.3 * high), most)
    while low == 1 and high > 2:
        below = max(math.floor(high / 1.3), 2)
        low, high = (low, below) if suffices(below) else (below, high)
    while high - low > max(1.0, tolerance * high):
        middle = (low + high) // 2
        low, high = (low, middle) if suffices(middle) else (middle, high)
    return high


def largest_known(numbers: Sequence[int | None]) -> int | None:
    """Return the largest number; None if one is unknown or there are none."""
    known = [number for number in numbers if number is not None]
    return max(known) if known and len(known) == len(numbers) else None


@lru_cache(maxsize=4)
def resampled_counts(size: int, draws: int, seed: int | tuple[int, ...]) -> Array:
    """Return how often each of ``size`` poses occurs in each resample, ``(draws, size)``; kept for reuse."""
    drawn = np.random.default_rng(seed).integers(size, size=(draws, size)) + size * np.arange(draws)[:, None]
    return np.bincount(drawn.ravel(), minlength=draws * size).reshape(draws, size).astype(float)


STUDENT = "Student's t"
FEWEST = 10
"""Fewer poses give too few distinct resamples for meaningful quantiles, and cannot contradict a Gaussian."""
MOST_FOR_BOOTSTRAP = 1000
"""With more poses the mean is Gaussian to within the bootstrap's own noise, and Student's t is cheaper."""


@dataclass(frozen=True, slots=True)
class Interval:
    """Confidence interval in the unit of its quantity."""

    lower: float | None
    upper: float | None
    """Two-sided: the true value is between ``lower`` and ``upper`` with ``confidence``."""
    upper_bound: float | None
    """One-sided: the true value is below it with ``confidence``."""
    confidence: float
    method: str
    why: str | None = None
    """Reason why a limit is missing."""
    curve: ConfidenceCurve | None = field(default=None, repr=False, compare=False)
    """Confidence of any other limit; None where it is unknown or not needed."""

    @property
    def limits(self) -> tuple[float, float, float] | None:
        """Lower limit, upper limit and upper bound; None where one is missing."""
        ends = self.lower, self.upper, self.upper_bound
        return None if None in ends else cast("tuple[float, float, float]", ends)

    @classmethod
    def missing(cls, confidence: float, why: str) -> Interval:
        """Return an interval without limits, and the reason."""
        return cls(None, None, None, confidence, "none", why)

    @classmethod
    def at(
        cls,
        limit: Callable[[float], float],
        confidence: float,
        method: str,
        curve: ConfidenceCurve | None = None,
    ) -> Interval:
        """Return the interval whose limits are those of a function at the probability of a smaller true value."""
        low, high, bound = map(limit, tails(confidence))
        return cls(low, high, bound, confidence, method, curve=curve)

    @classmethod
    def exact(cls, value: float, confidence: float, why: str = "no scatter") -> Interval:
        """Return the interval of a value without uncertainty, and the reason as its method."""
        return cls(value, value, value, confidence, why)

    def root(self) -> Interval:
        """Return the interval of the square root of a quantity that cannot be negative."""
        squares = self.lower, self.upper, self.upper_bound
        low, high, bound = (None if square is None else math.sqrt(max(square, 0.0)) for square in squares)
        curve = None if self.curve is None else RootCurve(self.curve)
        return replace(self, lower=low, upper=high, upper_bound=bound, curve=curve)

    def wider(self, other: Interval) -> Interval:
        """Return the interval that reaches as far as both, of which each has all limits."""
        (low, low_2), (high, high_2), (bound, bound_2) = zip(self.limits or (), other.limits or (), strict=True)
        curve = None if self.curve is None or other.curve is None else WiderCurve((self.curve, other.curve))
        method = f"the wider of {self.method} and {other.method}"
        ends = min(low, low_2), max(high, high_2), max(bound, bound_2)
        return Interval(*ends, self.confidence, method, curve=curve)


class EstimatedValue(NamedTuple):
    """A number with its interval, in one unit."""

    value: float
    interval: Interval | None


class EstimateOrReason(NamedTuple):
    """A number with its interval, or the reason why there is none."""

    value: float | None
    interval: Interval

    @classmethod
    def missing(cls, confidence: float, why: str) -> EstimateOrReason:
        """Return an estimate without a number, and the reason."""
        return cls(None, Interval.missing(confidence, why))

    @property
    def why(self) -> str | None:
        """Reason why there is no number."""
        return self.interval.why if self.value is None else None


def tails(confidence: float) -> tuple[float, float, float]:
    """Return the probabilities below the lower limit, the upper limit and the one-sided upper bound."""
    return 0.5 * (1.0 - confidence), 0.5 * (1.0 + confidence), confidence


def interpolated(values: Array, positions: Sequence[float]) -> list[float]:
    """Return the order statistics of ``values`` ``(n,)`` at ``positions`` from 0 to n - 1, linear between integers.

    ``np.quantile`` gives the same, but its first call imports numpy.ma, a tenth of the allowed start-up time.
    """
    return np.interp(positions, np.arange(values.size), np.sort(values)).tolist()


def quantiles(values: Array, levels: Sequence[float]) -> list[float]:
    """Return the quantiles of ``values``, linear between order statistics (Hyndman and Fan's type 7)."""
    return interpolated(values, [level * (values.size - 1) for level in levels])


def chi2_interval(value: float, dof: float, confidence: float, method: str) -> Interval:
    """Return the interval of a variance-like quantity with dof * estimate / truth ~ chi-square(dof)."""
    curve = ChiSquareCurve(value, dof)
    return Interval.at(lambda p: dof * value / chi2_quantile(1.0 - p, dof), confidence, method, curve)


def student_interval(
    value: float, standard_error: float, dof: float, confidence: float, method: str = STUDENT
) -> Interval:
    """Return the interval of a number whose standard error has ``dof`` degrees of freedom; infinite: normal."""
    return Interval.at(lambda p: value + standard_error * student_quantile(p, dof), confidence, method)


def difference_limits(
    value: float, limits: tuple[float, float], subtracted: float, its_limits: tuple[float, float]
) -> tuple[float, float]:
    """Return the limits of ``value`` - ``subtracted``, independent estimates with the limits given.

    The method of variance estimates recovery takes each limit of the difference from the distances of the limits that
    face each other (G. Y. Zou, A. Donner, "Construction of confidence limits about effect measures", Statistics in
    Medicine 27, 2008).
    """
    difference = value - subtracted
    below = math.hypot(limits[0] - value, its_limits[1] - subtracted)
    return difference - below, difference + math.hypot(limits[1] - value, its_limits[0] - subtracted)


def covariance_element(first: float, second: float, cross: float, dof: float, confidence: float) -> tuple[float, float]:
    """Return the interval of a covariance from the variances and covariance of Gaussian data.

    The covariance of two variables scaled to unit variance is a quarter of the difference between the variances of
    their sum and of their difference, which are uncorrelated.
    """
    scale = math.sqrt(first * second)
    # Rounding may carry a perfect correlation past one.
    plus = 0.5 + 0.5 * min(1.0, max(-1.0, cross / (scale or 1.0)))
    low, high = (dof / chi2_quantile(1.0 - p, dof) for p in tails(confidence)[:2])
    (below, minus_low), (above, minus_high) = ((plus * end, (1.0 - plus) * end) for end in (low, high))
    limits = difference_limits(plus, (below, above), 1.0 - plus, (minus_low, minus_high))
    return scale * limits[0], scale * limits[1]


@dataclass(frozen=True)
class PoseSampling:
    """Groups of errors that are repetitions of one commanded pose, and the resampling of these groups."""

    n: int
    groups: NDArray[np.int64] | None
    """``(n,)`` index of each error's commanded pose, or None where no pose was repeated."""
    draws: int = 2000
    seed: int = 0
    share: float = 1.0
    """Share of the measured components that frames fitted to them leave as degrees of freedom."""

    @cached_property
    def sizes(self) -> Array:
        """Number of repetitions of each commanded pose, ``(n_groups,)``."""
        return np.ones(self.n) if self.groups is None else np.bincount(self.groups).astype(float)

    @property
    def n_groups(self) -> int:
        """Number of commanded poses."""
        return int(self.sizes.size)

    @property
    def n_independent(self) -> float:
        """Number of poses that intervals count: degrees of freedom of one component of the errors."""
        return round(self.share * self.n_groups, 9)

    @property
    def too_few(self) -> str | None:
        """Reason why no interval can be given; None if the poses suffice."""
        few = f"{self.described}: too few for an interval" if self.n_independent < 2.0 else None
        return "one commanded pose: no scatter between poses to estimate from" if self.n_groups < 2 else few

    @property
    def described(self) -> str:
        """Number of poses in words."""
        text = "1 pose" if self.n_groups == 1 else f"{self.n_groups} poses"
        return text if self.share == 1.0 else f"{text}, of which the fit leaves {self.n_independent:.3g}"

    def standard_error(self, values: Array) -> float:
        """Return the standard error of the mean of ``values`` ``(n,)``; poses are independent, repetitions are not."""
        centred = values - float(np.mean(values))
        return self._error(centred if self.groups is None else np.bincount(self.groups, weights=centred).astype(float))

    def _error(self, deviations: Array) -> float:
        count = deviations.size
        return math.sqrt(count / (round(self.share * count, 9) - 1.0) * float(deviations @ deviations)) / self.n

    def interval(
        self, mean: float, deviations: Array, largest: float, confidence: float, *, positive: bool
    ) -> Interval:
        """Return the interval of a mean over poses.

        Args:
            mean: The mean of a number for each error.
            deviations: ``(n_groups,)`` sum over each commanded pose of the numbers' differences from the mean.
            largest: Largest magnitude of a number.
            confidence: Confidence of the interval.
            positive: The quantity cannot be negative. It is studentised on the scale of its square root, which keeps
                the limits from being negative and reduces the skewness of squares.
        """
        if (why := self.too_few) is not None:
            return Interval.missing(confidence, why)
        # A positive mean of nothing but rounding may even be negative, where it is a sum of terms that cancel.
        if min(error := self._error(deviations), mean if positive else error) <= 1e-13 * largest:
            return Interval.exact(mean, confidence)
        method, resampled = f"Student's t over {self.described}", None
        if FEWEST <= self.n_groups <= MOST_FOR_BOOTSTRAP:
            resampled = self._studentised(deviations, mean, positive)
            method = f"studentised bootstrap over {self.described}, {self.draws} draws, no narrower than Student's t"
        root = math.sqrt(mean) if positive else mean
        curve = StudentCurve(root, error * 0.5 / root if positive else error, self.n_independent, resampled, positive)
        return Interval.at(curve.limit, confidence, method, curve)

    def _studentised(self, sums: Array, mean: float, positive: bool) -> Array:
        """Return (resampled mean - mean) / its own standard error, ``(draws,)``; of the root if ``positive``."""
        counts, sizes, size = resampled_counts(sums.size, self.draws, self.seed), self.sizes, sums.size
        totals = counts @ np.stack((sums, sums * sums, sums * sizes, sizes * sizes, sizes), axis=1)
        total, squares, cross, square_sizes, number = totals.T
        shift = total / number
        variance = squares - 2.0 * shift * cross + shift * shift * square_sizes
        error = np.sqrt(np.maximum(variance, 0.0) * (size / (size - 1.0))) / number
        if positive:
            roots = np.sqrt(np.maximum(mean + shift, 0.0))
            shift = 2.0 * roots * (roots - math.sqrt(mean))
        usable = error > 0.0
        return np.asarray(shift[usable] / error[usable])
