"""Confidence intervals with the name of their method, or the reason why there is none; resamples.

The assumptions decide which of three kinds is used:

- chi-square intervals, exact for variances of Gaussian errors (the diagonal of a Wishart matrix) and, with Welch and
  Satterthwaite's effective degrees of freedom, nearly exact for sums of variances (RMS, radius);
- the studentised bootstrap over poses (P. Hall, The Bootstrap and Edgeworth Expansion, 1992, ch. 3), for the mean of
  any quantity over poses, whatever its distribution; repetitions of one commanded pose are resampled together;
- interpolated order statistics for a percentile (J. Nyblom, "Note on interpolated order statistics", Statistics &
  Probability Letters 14, 1992), which assume no distribution.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.statistics.confidence_curves import (
    MOST_FOR_BINOMIAL,
    ChiSquareCurve,
    ConfidenceCurve,
    RootCurve,
    StudentCurve,
    WiderCurve,
)
from robacc.statistics.distributions import beta_cdf, chi2_quantile, normal_quantile, student_quantile

# Resamples of poses for the bootstrap.


@lru_cache(maxsize=4)
def resampled_counts(size: int, draws: int, seed: int | tuple[int, ...]) -> Array:
    """Return how often each of ``size`` poses occurs in each resample, ``(draws, size)``, read-only; kept for reuse."""
    indices = np.random.default_rng(seed).integers(size, size=(draws, size))
    indices += size * np.arange(draws)[:, None]
    counts = np.bincount(indices.ravel(), minlength=draws * size).reshape(draws, size).astype(float)
    counts.flags.writeable = False
    return counts


STUDENT = "Student's t"
FEWEST_FOR_BOOTSTRAP = 10
"""Fewer poses give too few distinct resamples for meaningful quantiles."""
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

    @classmethod
    def missing(cls, confidence: float, why: str) -> Interval:
        """Return an interval without limits, and the reason."""
        return cls(None, None, None, confidence, "none", why)

    @classmethod
    def exact(cls, value: float, confidence: float, why: str = "no scatter") -> Interval:
        """Return the interval of a value without uncertainty, and the reason as its method."""
        return cls(value, value, value, confidence, why)

    def root(self) -> Interval:
        """Return the interval of the square root of a quantity that cannot be negative."""
        lower, upper, bound = (
            None if value is None else math.sqrt(max(value, 0.0))
            for value in (self.lower, self.upper, self.upper_bound)
        )
        curve = None if self.curve is None else RootCurve(self.curve)
        return Interval(lower, upper, bound, self.confidence, self.method, self.why, curve)

    def wider(self, other: Interval) -> Interval:
        """Return the interval that reaches as far as both; each must have all limits."""
        limits = [(self.lower, other.lower), (self.upper, other.upper), (self.upper_bound, other.upper_bound)]
        pairs = [(a, b) for a, b in limits if a is not None and b is not None]
        curve = None if self.curve is None or other.curve is None else WiderCurve(self.curve, other.curve)
        method = f"the wider of {self.method} and {other.method}"
        return Interval(min(pairs[0]), max(pairs[1]), max(pairs[2]), self.confidence, method, curve=curve)


@dataclass(frozen=True, slots=True)
class EstimatedValue:
    """A number with its interval, in one unit."""

    value: float
    interval: Interval | None


@dataclass(frozen=True, slots=True)
class EstimateOrReason:
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
    last = values.size - 1
    inside = [min(max(position, 0.0), float(last)) for position in positions]
    low = [min(int(position), max(last - 1, 0)) for position in inside]
    ordered = np.partition(values, sorted({k for rank in low for k in (rank, min(rank + 1, last))}))
    return [
        float(ordered[rank] + (position - rank) * (ordered[min(rank + 1, last)] - ordered[rank]))
        for rank, position in zip(low, inside, strict=True)
    ]


def chi2_interval(value: float, dof: float, confidence: float, method: str) -> Interval:
    """Return the interval of a variance-like quantity with dof * estimate / truth ~ chi-square(dof)."""
    low, high, bound = (dof * value / chi2_quantile(1.0 - p, dof) for p in tails(confidence))
    return Interval(low, high, bound, confidence, method, curve=ChiSquareCurve(value, dof))


def student_interval(
    value: float, standard_error: float, dof: float, confidence: float, method: str = STUDENT
) -> Interval:
    """Return the interval of a number whose standard error has ``dof`` degrees of freedom; infinite: normal."""
    lower, upper, bound = (
        value + standard_error * (normal_quantile(p) if math.isinf(dof) else student_quantile(p, dof))
        for p in tails(confidence)
    )
    return Interval(lower, upper, bound, confidence, method)


def covariance_element(first: float, second: float, cross: float, dof: float, confidence: float) -> tuple[float, float]:
    """Return the interval of a covariance from the variances and covariance of Gaussian data.

    The covariance of two variables scaled to unit variance is a quarter of the difference between the variances of
    their sum and of their difference, which are uncorrelated; the two chi-square intervals are combined by the
    method of variance estimates recovery (G. Y. Zou, A. Donner, "Construction of confidence limits about effect
    measures", Statistics in Medicine 27, 2008).
    """
    scale = math.sqrt(first * second)
    if scale == 0.0:
        return 0.0, 0.0
    # Rounding may carry a perfect correlation past one.
    correlation = min(1.0, max(-1.0, cross / scale))
    plus, minus = 0.5 * (1.0 + correlation), 0.5 * (1.0 - correlation)
    below, above = (dof / chi2_quantile(1.0 - p, dof) - 1.0 for p in tails(confidence)[:2])
    return (
        scale * (correlation - math.hypot(plus * below, minus * above)),
        scale * (correlation + math.hypot(plus * above, minus * below)),
    )


@lru_cache(maxsize=64)
def percentile_levels(n: int, p: float, confidence: float) -> tuple[float | None, float | None, float | None]:
    """Return ranks, as fractions of n + 1, of order statistics that bound the ``p`` quantile; None if n is too small.

    The k-th of n order statistics is below the quantile with the binomial probability P(Beta(k, n + 1 - k) <= p).
    Nyblom's interpolation is used between the two ranks whose probabilities enclose the target, and above 5000 poses
    the normal approximation of the binomial distribution.
    """

    def probability_below(rank: int) -> float:
        return beta_cdf(p, float(rank), float(n + 1 - rank))

    def level(target: float) -> float | None:
        if n > MOST_FOR_BINOMIAL:
            return p + normal_quantile(1.0 - target) * math.sqrt(p * (1.0 - p) / n)
        if probability_below(n) > target or probability_below(1) < target:
            return None
        low, high = 1, n
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if probability_below(middle) >= target else (low, middle)
        share = (probability_below(low) - target) / (probability_below(low) - probability_below(high))
        if share == 0.0:
            return low / (n + 1.0)
        between = 1.0 / (1.0 + low * (1.0 - p) * (1.0 - share) / ((n - low) * p * share))
        return (low + between) / (n + 1.0)

    lower, upper, bound = (level(1.0 - probability) for probability in tails(confidence))
    return lower, upper, bound


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

    @property
    def n_groups(self) -> int:
        """Number of commanded poses."""
        return self.n if self.groups is None else int(self.sizes.size)

    @property
    def n_independent(self) -> float:
        """Number of poses that intervals count: degrees of freedom of one component of the errors."""
        return round(self.share * self.n_groups, 9)

    @property
    def too_few(self) -> str | None:
        """Reason why no interval can be given; None if the poses suffice."""
        if self.n_groups < 2:
            return "one commanded pose: no scatter between poses to estimate from"
        return None if self.n_independent >= 2.0 else f"{self.described}: too few for an interval"

    @property
    def described(self) -> str:
        """Number of poses in words."""
        text = "1 pose" if self.n_groups == 1 else f"{self.n_groups} poses"
        return text if self.share == 1.0 else f"{text}, of which the fitted frames leave {self.n_independent:.3g}"

    def cautious(self, interval: Interval, values: Array, confidence: float) -> Interval:
        """Return the interval of a Gaussian, if frames were fitted the wider of it and that of the mean of ``values``.

        Held-out errors grow with the leverage of the pose, so their squares scatter more than those of a Gaussian.
        """
        if self.share == 1.0:
            return interval
        return interval.wider(self.mean_interval(values, confidence, positive=True))

    @cached_property
    def sizes(self) -> Array:
        """Number of repetitions of each commanded pose, ``(n_groups,)``."""
        return np.ones(self.n) if self.groups is None else np.bincount(self.groups).astype(float)

    def sums(self, values: Array) -> Array:
        """Sum ``values`` ``(n,)`` over each commanded pose, ``(n_groups,)``."""
        if self.groups is None:
            return values
        return np.bincount(self.groups, weights=values).astype(float)

    def standard_error(self, values: Array) -> float:
        """Return the standard error of the mean of ``values`` ``(n,)``; poses are independent, repetitions are not."""
        deviations = self.sums(values - float(np.mean(values)))
        return math.sqrt(self.n_groups / (self.n_independent - 1.0) * float(deviations @ deviations)) / self.n

    def mean_interval(self, values: Array, confidence: float, *, positive: bool) -> Interval:
        """Return the interval of the mean of ``values`` ``(n,)`` over poses.

        Args:
            values: One number for each error.
            confidence: Confidence of the interval.
            positive: The quantity cannot be negative. It is studentised on the scale of its square root, which keeps
                the limits from being negative and reduces the skewness of squares.
        """
        size, count, mean = self.n_groups, self.n_independent, float(np.mean(values))
        if (why := self.too_few) is not None:
            return Interval.missing(confidence, why)
        error = self.standard_error(values)
        if error <= 1e-13 * max(-float(np.min(values)), float(np.max(values))):
            return Interval.exact(mean, confidence)
        below, above, bound = tails(confidence)
        t_above, t_bound = student_quantile(above, count - 1.0), -student_quantile(bound, count - 1.0)
        t_below, method, resampled = -t_above, f"Student's t over {self.described}", None
        if FEWEST_FOR_BOOTSTRAP <= size <= MOST_FOR_BOOTSTRAP:
            resampled = self._studentised(values, mean, positive)
            quantiles = interpolated(resampled, [p * (resampled.size - 1) for p in (below, above, 1.0 - bound)])
            # Resampled standard errors vary less than true ones if the tails are long; Student's t is a floor.
            t_below, t_above = min(t_below, quantiles[0]), max(t_above, quantiles[1])
            t_bound = min(t_bound, quantiles[2])
            method = f"studentised bootstrap over {self.described}, {self.draws} draws, no narrower than Student's t"
        if positive:
            root = math.sqrt(mean)
            low, high, top = (max(root - 0.5 * t * error / root, 0.0) ** 2 for t in (t_above, t_below, t_bound))
        else:
            low, high, top = (mean - t * error for t in (t_above, t_below, t_bound))
        return Interval(low, high, top, confidence, method, curve=StudentCurve(mean, error, count, resampled, positive))

    def _studentised(self, values: Array, mean: float, positive: bool) -> Array:
        """Return (resampled mean - mean) / its own standard error, ``(draws,)``."""
        counts, sizes = resampled_counts(self.n_groups, self.draws, self.seed), self.sizes
        sums = self.sums(values - mean)
        size = self.n_groups
        totals = counts @ np.stack((sums, sums * sums, sums * sizes, sizes * sizes, sizes), axis=1)
        total, squares, cross, square_sizes, number = totals.T
        shift = total / number
        variance = squares - 2.0 * shift * cross + shift * shift * square_sizes
        error = np.sqrt(np.maximum(variance, 0.0) * (size / (size - 1.0))) / number
        usable = error > 0.0
        shift, error = shift[usable], error[usable]
        if not positive:
            result: Array = shift / error
            return result
        root = np.sqrt(np.maximum(mean + shift, 0.0))
        result = 2.0 * root * (root - math.sqrt(mean)) / error
        return result
