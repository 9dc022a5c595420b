"""Confidence curves: the confidence that the true value lies within a limit, as a function of the limit.

An interval is two points of its curve. The curve inverts the interval's own method, so its value at a one-sided upper
bound is that bound's confidence (T. Schweder, N. L. Hjort, Confidence, Likelihood, Probability, 2016, ch. 3). Each
curve also computes how many poses would bring its upper bound within a limit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from robacc.geometry import Array
from robacc.statistics.distributions import (
    beta_cdf,
    chi2_cdf,
    chi2_quantile,
    chi2_sf,
    f_sf,
    normal_cdf,
    normal_quantile,
    student_quantile,
)

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


@dataclass(frozen=True, slots=True)
class ChiSquareCurve:
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


@dataclass(frozen=True, slots=True, eq=False)
class StudentCurve:
    """Confidence curve of a mean over ``size`` poses, by Student's t and, where given, bootstrap t values."""

    mean: float
    error: float
    size: float
    bootstrap_t: Array | None
    """Resampled t values, in any order."""
    positive: bool
    """The mean is studentised on the scale of its square root."""

    def below(self, value: float) -> float:
        """See :class:`ConfidenceCurve`; each side uses the more cautious distribution, as the interval does."""
        if self.positive and value <= 0.0:
            return 0.0
        t = (self._scaled(self.mean) - self._scaled(value)) / self._scaled_error()
        tail = 0.5 * f_sf(t * t, 1.0, self.size - 1.0)
        student = tail if t > 0.0 else 1.0 - tail
        resampled = student if self.bootstrap_t is None else float(np.mean(self.bootstrap_t > t))
        return max(0.5, min(student, resampled)) if t <= 0.0 else min(0.5, max(student, resampled))

    def poses_for(self, limit: float, confidence: float, n: int) -> int | None:
        """See :class:`ConfidenceCurve`; the error falls with the root of the number of poses."""
        margin = self._scaled(limit) - self._scaled(self.mean)
        if margin <= 0.0:
            return None
        bound = student_quantile(confidence, self.size - 1.0)
        if self.bootstrap_t is not None:
            ordered = np.sort(self.bootstrap_t)
            bound = max(bound, -float(ordered[int((1.0 - confidence) * (ordered.size - 1))]))
        poses = math.ceil(n * ((bound + normal_quantile(ASSURANCE)) * self._scaled_error() / margin) ** 2)
        return max(poses, 2) if poses <= MOST_POSES else None

    def _scaled(self, value: float) -> float:
        return math.sqrt(value) if self.positive else value

    def _scaled_error(self) -> float:
        return 0.5 * self.error / math.sqrt(self.mean) if self.positive else self.error


@dataclass(frozen=True, slots=True)
class WiderCurve:
    """Confidence curve of the wider of two intervals: the more cautious confidence on each side of the estimate."""

    first: ConfidenceCurve
    second: ConfidenceCurve

    def below(self, value: float) -> float:
        """See :class:`ConfidenceCurve`."""
        low, high = sorted((self.first.below(value), self.second.below(value)))
        return min(max(low, 0.5), high)

    def poses_for(self, limit: float, confidence: float, n: int) -> int | None:
        """See :class:`ConfidenceCurve`."""
        needed = [curve.poses_for(limit, confidence, n) for curve in (self.first, self.second)]
        return None if None in needed else max(count for count in needed if count is not None)


@dataclass(frozen=True, slots=True)
class RootCurve:
    """Confidence curve of the square root of a quantity that cannot be negative."""

    square: ConfidenceCurve

    def below(self, value: float) -> float:
        """See :class:`ConfidenceCurve`."""
        return self.square.below(value * value) if value > 0.0 else 0.0

    def poses_for(self, limit: float, confidence: float, n: int) -> int | None:
        """See :class:`ConfidenceCurve`."""
        return self.square.poses_for(limit * limit, confidence, n)


@dataclass(frozen=True, slots=True, eq=False)
class PercentileCurve:
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
        if rank < self.n or self.model is None:
            return by_order
        return max(by_order, self.model.below(value))

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

    Inverse of Nyblom's interpolation in :func:`robacc.statistics.intervals.percentile_levels`.
    """
    if n > MOST_FOR_BINOMIAL:
        return normal_cdf((rank / (n + 1.0) - p) / math.sqrt(p * (1.0 - p) / n))
    rank = min(rank, float(n))
    low = int(rank)
    if low < 1:
        return 0.0
    at_low = beta_cdf(p, float(low), float(n + 1 - low))
    between = rank - low
    if between == 0.0:
        return 1.0 - at_low
    at_high = beta_cdf(p, low + 1.0, float(n - low))
    share = 1.0 / (1.0 + (1.0 / between - 1.0) * (n - low) * p / (low * (1.0 - p)))
    return 1.0 - at_low + share * (at_low - at_high)


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
        if suffices(below):
            high = below
        else:
            low = below
    while high - low > max(1.0, tolerance * high):
        middle = (low + high) // 2
        low, high = (low, middle) if suffices(middle) else (middle, high)
    return high
