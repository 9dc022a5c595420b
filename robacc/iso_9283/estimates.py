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
from robacc.iso_9283.records import CriterionFigure
from robacc.statistics.distributions import normal_quantile, student_quantile
from robacc.statistics.intervals import Interval, chi2_interval, tails

STUDENT = "Student's t"
CHI_SQUARE = "chi-square"
MOVER = "from the intervals of the two (method of variance estimates recovery)"
ONE_VISIT = "one visit shows no scatter"
FEW_VISITS = "fewer than three visits"


@dataclass(frozen=True, slots=True)
class IntervalEstimate:
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

    def figure(self, confidence: float) -> CriterionFigure:
        """The number with its interval at that confidence."""
        return CriterionFigure(self.value, self.at(confidence))


def without_interval(value: float, why: str) -> IntervalEstimate:
    """A number that nothing is known of besides."""
    return IntervalEstimate(value, lambda confidence: Interval.missing(confidence, why))


def student(value: float, error: float, dof: float, method: str = STUDENT) -> IntervalEstimate:
    """A number with a standard error on ``dof`` degrees of freedom; infinite for a normal one, none below one."""
    if dof < 1:
        return without_interval(value, ONE_VISIT)

    def at(confidence: float) -> Interval:
        below, _, bound = (
            normal_quantile(p) if math.isinf(dof) else student_quantile(p, dof) for p in tails(confidence)
        )
        return Interval(value + below * error, value - below * error, value + bound * error, confidence, method)

    return IntervalEstimate(value, at)


def mean(values: Array, offset: float = 0.0) -> IntervalEstimate:
    """The mean of ``values`` ``(n,)`` less ``offset``, by Student's t."""
    value = float(np.mean(values)) - offset
    if values.size < 2:
        return without_interval(value, ONE_VISIT)
    return student(value, float(np.std(values, ddof=1)) / math.sqrt(values.size), values.size - 1)


def size(signed: IntervalEstimate) -> IntervalEstimate:
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

    return IntervalEstimate(abs(signed.value), at, low)


def threefold_sd(values: Array) -> IntervalEstimate:
    """3 S of ``values`` ``(n,)``, S with divisor n - 1; n at least 2. The interval is exact for Gaussian values."""
    value = 3.0 * float(np.std(values, ddof=1))
    dof = values.size - 1.0
    return IntervalEstimate(value, lambda confidence: chi2_interval(value**2, dof, confidence, CHI_SQUARE).root())


def change(after: IntervalEstimate, before: IntervalEstimate) -> IntervalEstimate:
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
            return Interval.missing(confidence, FEW_VISITS)
        # The lower limit at twice the tail is the one-sided one.
        double = before.at(2.0 * confidence - 1.0).lower if confidence > 0.5 else before.value
        bound = value + math.hypot(one.upper_bound - after.value, before.value - (double or 0.0))
        return Interval(low, high, bound, confidence, MOVER)

    return IntervalEstimate(value, at)


def largest(estimates: Sequence[IntervalEstimate], confidence: float) -> tuple[int, CriterionFigure]:
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
        return best, CriterionFigure(value, missing or intervals[0])
    lower = _lower_of_largest(estimates, confidence)
    upper = max(one.upper or 0.0 for one in intervals)
    bound = max(one.upper_bound or 0.0 for one in intervals)
    method = f"{intervals[best].method}; largest of {len(estimates)}"
    return best, CriterionFigure(value, Interval(lower, upper, bound, confidence, method))


def _lower_of_largest(estimates: Sequence[IntervalEstimate], confidence: float) -> float:
    strict = 1.0 - (1.0 - confidence) / len(estimates)
    return max(one.lower(strict) or 0.0 for one in estimates)


def largest_of(estimates: Sequence[IntervalEstimate]) -> IntervalEstimate:
    """The largest of the estimates' true values, as an estimate."""
    value = max(one.value for one in estimates)
    return IntervalEstimate(
        value,
        lambda confidence: largest(estimates, confidence)[1].interval,
        lambda confidence: _lower_of_largest(estimates, confidence),
    )
