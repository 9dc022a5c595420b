"""Confidence curves: with what confidence the true value lies within a limit, whatever the limit.

An interval is two points of its curve; the curve is the interval's own method read the other way round, so its value
at a one-sided upper bound is that bound's confidence (T. Schweder, N. L. Hjort, Confidence, Likelihood, Probability,
2016, ch. 3). Each curve also says how much more data would carry its upper bound within a limit.
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
"""With more poses the binomial distribution at 95 % is normal to within a hundredth of a standard deviation or so."""
ASSURANCE = 0.9
"""Probability with which a planned number of poses is to be enough."""
MOST_POSES = 1_000_000
"""Nobody measures more, so no more are proposed."""


class ConfidenceCurve(Protocol):
    """Of one quantity, estimated from n poses."""

    def below(self, value: float) -> float:
        """The confidence with which the true quantity lies at or below ``value``."""

    def poses_for(self, limit: float, confidence: float, n: int) -> int | None:
        """Poses with which the upper bound meets ``limit`` with probability :data:`ASSURANCE`, now that there are n.

        If the estimate is the truth. None where no number of poses below :data:`MOST_POSES` will do.
        """


@dataclass(frozen=True, slots=True)
class ChiSquareCurve:
    """Of a variance-like quantity with dof * ``value`` / truth ~ chi-square(dof)."""

    value: float
    dof: float

    def below(self, value: float) -> float:
        """See :class:`ConfidenceCurve`."""
        return chi2_sf(self.dof * self.value / value, self.dof) if value > 0.0 else 0.0

    def poses_for(self, limit: float, confidence: float, n: int) -> int | None:
        """See :class:`ConfidenceCurve`: the bound, distributed as chi-square(dof) / its lower quantile, is within the limit."""
        if limit <= self.value:
            return None

        def enough(poses: int) -> bool:
            dof = self.dof * poses / n
            return chi2_quantile(ASSURANCE, dof) * self.value <= chi2_quantile(1.0 - confidence, dof) * limit

        z = normal_quantile(confidence) + normal_quantile(ASSURANCE)
        return fewest(enough, 2.0 * (z / math.log(limit / self.value)) ** 2 * n / self.dof)


@dataclass(frozen=True, slots=True, eq=False)
class StudentCurve:
    """Of a mean over ``size`` poses with a standard error, by Student's t and, where drawn, resampled t values."""

    mean: float
    error: float
    size: int
    drawn: Array | None
    """Resampled t, any order."""
    positive: bool
    """Studentised on the scale of the square root."""

    def below(self, value: float) -> float:
        """See :class:`ConfidenceCurve`; on either side the more cautious of the two distributions, as in the interval."""
        if self.positive and value <= 0.0:
            return 0.0
        t = (self._scaled(self.mean) - self._scaled(value)) / self._scaled_error()
        tail = 0.5 * f_sf(t * t, 1.0, self.size - 1.0)
        student = tail if t > 0.0 else 1.0 - tail
        drawn = student if self.drawn is None else float(np.mean(self.drawn > t))
        return max(0.5, min(student, drawn)) if t <= 0.0 else min(0.5, max(student, drawn))

    def poses_for(self, limit: float, confidence: float, n: int) -> int | None:
        """See :class:`ConfidenceCurve`; the error falls with the root of the number of poses."""
        room = self._scaled(limit) - self._scaled(self.mean)
        if room <= 0.0:
            return None
        bound = student_quantile(confidence, self.size - 1.0)
        if self.drawn is not None:
            bound = max(bound, -float(np.sort(self.drawn)[int((1.0 - confidence) * (self.drawn.size - 1))]))
        poses = math.ceil(n * ((bound + normal_quantile(ASSURANCE)) * self._scaled_error() / room) ** 2)
        return max(poses, 2) if poses <= MOST_POSES else None

    def _scaled(self, value: float) -> float:
        return math.sqrt(value) if self.positive else value

    def _scaled_error(self) -> float:
        return 0.5 * self.error / math.sqrt(self.mean) if self.positive else self.error


@dataclass(frozen=True, slots=True)
class RootCurve:
    """Of the square root of a quantity that cannot be negative."""

    square: ConfidenceCurve

    def below(self, value: float) -> float:
        """See :class:`ConfidenceCurve`."""
        return self.square.below(value * value) if value > 0.0 else 0.0

    def poses_for(self, limit: float, confidence: float, n: int) -> int | None:
        """See :class:`ConfidenceCurve`."""
        return self.square.poses_for(limit * limit, confidence, n)


@dataclass(frozen=True, slots=True)
class Tail:
    """Lengths beyond the sample: their squares as a multiple of chi-square with two moments and a quantile alike."""

    radius: float
    """That holds ``p`` of all lengths."""
    dof: float
    p: float

    def share_within(self, limit: float) -> float:
        """The share of all lengths within ``limit``."""
        return chi2_cdf(chi2_quantile(self.p, self.dof) * (limit / self.radius) ** 2, self.dof)


@dataclass(frozen=True, slots=True, eq=False)
class PercentileCurve:
    """Of the ``p`` quantile of lengths, by order statistics of n poses, and beyond the largest by a fitted Gaussian."""

    lengths: Array
    """``(N,)``, repetitions included, any order."""
    n: int
    """Commanded poses."""
    p: float
    model: ConfidenceCurve | None
    """Of the fitted Gaussian's quantile."""
    tail: Tail | None
    by_model: bool
    """The interval is the model's: there are too few poses for order statistics."""

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
        """See :class:`ConfidenceCurve`; with the share of lengths that the sample, or beyond it the Gaussian, has within."""
        if self.by_model and self.model is not None:
            poses = self.model.poses_for(limit, confidence, n)
            if poses is None or self.p**poses > 0.5 * (1.0 - confidence):
                return poses  # still too few for order statistics, so the model's interval stays in use
        share = self._level(limit)
        if self.tail is not None and (self.by_model or share * (self.n + 1.0) >= self.n):
            beyond = min(self.tail.share_within(limit), 1.0)
            share = beyond if self.by_model else max(share, beyond)
        if share <= self.p:
            return None

        def enough(poses: int) -> bool:
            # So many of the lengths must lie within the limit for the bound, which is one of them, to do so.
            rank = _bounding_rank(poses, self.p, confidence)
            return rank is not None and beta_cdf(share, float(rank), poses + 1.0 - rank) >= ASSURANCE

        spread = normal_quantile(confidence) * math.sqrt(self.p * (1.0 - self.p))
        spread += normal_quantile(ASSURANCE) * math.sqrt(share * (1.0 - share))
        return fewest(enough, (spread / (share - self.p)) ** 2, close=0.01)

    def _level(self, value: float) -> float:
        """Rank of ``value`` among the lengths as a fraction of N + 1, linear between neighbours."""
        within = self.lengths <= value
        count, size = int(np.count_nonzero(within)), self.lengths.size
        if count in (0, size) or size > MOST_FOR_BINOMIAL:
            # Of so many, one neighbour is as good as the next.
            return count / (size + 1.0)
        low, high = float(np.max(self.lengths[within])), float(np.min(self.lengths[~within]))
        return (count + (value - low) / (high - low)) / (size + 1.0)


def percentile_confidence(rank: float, n: int, p: float) -> float:
    """The confidence with which the order statistic of ``rank`` of n, whole or between, is not below the quantile.

    Nyblom's interpolation, as in :func:`robacc.statistics.intervals.percentile_levels`, read the other way round.
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


def _bounding_rank(n: int, p: float, confidence: float) -> int | None:
    """Rank of the first of n order statistics that bounds the ``p`` quantile from above; None where n is too small."""
    if p**n > 1.0 - confidence:
        return None
    rank = min(max(math.floor(p * n + normal_quantile(confidence) * math.sqrt(n * p * (1.0 - p))), 1), n)
    while rank < n and percentile_confidence(rank, n, p) < confidence:
        rank += 1
    while rank > 1 and percentile_confidence(rank - 1, n, p) >= confidence:
        rank -= 1
    return rank


def fewest(enough: Callable[[int], bool], guess: float, close: float = 0.0) -> int | None:
    """The smallest number of poses that is enough, if more are never fewer; None above :data:`MOST_POSES`.

    Args:
        enough: Whether a number is.
        guess: Where to look first.
        close: The number found may be greater by this part of it.
    """
    low, high = 1, min(max(math.ceil(guess), 2), MOST_POSES)
    while not enough(high):
        if high == MOST_POSES:
            return None
        low, high = high, min(math.ceil(1.3 * high), MOST_POSES)
    while low == 1 and high > 2:
        below = max(math.floor(high / 1.3), 2)
        if enough(below):
            high = below
        else:
            low = below
    while high - low > max(1.0, close * high):
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high
