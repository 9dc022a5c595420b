"""Estimates with intervals at any confidence, for every kind of number in ISO 9283.

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
from robacc.iso_9283.records import CriterionFigure
from robacc.statistics.distributions import normal_quantile, student_quantile
from robacc.statistics.intervals import Interval, chi2_interval, tails

STUDENT = "Student's t"
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
    lower_at: Callable[[float], float | None] | None = None
    """Lower limit alone, where it costs less; the largest of many estimates needs it at a stricter confidence."""

    def __post_init__(self) -> None:
        """Cache the intervals: each place and the largest over places use the same ones."""
        object.__setattr__(self, "interval_at", lru_cache(maxsize=8)(self.interval_at))

    def lower(self, confidence: float) -> float | None:
        """Return the lower limit of the interval at a confidence."""
        return self.interval_at(confidence).lower if self.lower_at is None else self.lower_at(confidence)

    def figure(self, confidence: float) -> CriterionFigure:
        """Return the number with its interval at a confidence."""
        return CriterionFigure(self.value, self.interval_at(confidence))


def without_interval(value: float, reason: str) -> IntervalEstimate:
    """Return a number without an interval, and the reason."""
    return IntervalEstimate(value, lambda confidence: Interval.missing(confidence, reason))


def student(value: float, standard_error: float, dof: float, method: str = STUDENT) -> IntervalEstimate:
    """Return a number with a standard error on ``dof`` degrees of freedom; infinite: normal, below 1: no interval."""
    if dof < 1:
        return without_interval(value, ONE_VISIT)

    def interval_at(confidence: float) -> Interval:
        below, _, bound = (
            normal_quantile(probability) if math.isinf(dof) else student_quantile(probability, dof)
            for probability in tails(confidence)
        )
        return Interval(
            value + below * standard_error,
            value - below * standard_error,
            value + bound * standard_error,
            confidence,
            method,
        )

    return IntervalEstimate(value, interval_at)


def mean(values: Array, offset: float = 0.0) -> IntervalEstimate:
    """Return the mean of ``values`` ``(n,)`` minus ``offset``, by Student's t."""
    value = float(np.mean(values)) - offset
    if values.size < 2:
        return without_interval(value, ONE_VISIT)
    return student(value, float(np.std(values, ddof=1)) / math.sqrt(values.size), values.size - 1)


def magnitude(signed: IntervalEstimate) -> IntervalEstimate:
    """Return the absolute value of a signed estimate."""

    def interval_at(confidence: float) -> Interval:
        interval = signed.interval_at(confidence)
        if interval.lower is None or interval.upper is None or interval.upper_bound is None:
            return interval
        lowest = max(0.0, interval.lower, -interval.upper)
        bound = abs(signed.value) + (interval.upper_bound - signed.value)
        return Interval(lowest, max(-interval.lower, interval.upper), bound, confidence, interval.method)

    def lower_at(confidence: float) -> float | None:
        lower = signed.lower(confidence) if signed.value >= 0.0 else interval_at(confidence).lower
        return None if lower is None else max(lower, 0.0)

    return IntervalEstimate(abs(signed.value), interval_at, lower_at)


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
        after_interval, before_interval = after.interval_at(confidence), before.interval_at(confidence)
        if (
            after_interval.lower is None
            or after_interval.upper is None
            or before_interval.lower is None
            or before_interval.upper is None
        ):
            return after_interval if after_interval.lower is None else before_interval
        lower = value - math.hypot(after.value - after_interval.lower, before_interval.upper - before.value)
        upper = value + math.hypot(after_interval.upper - after.value, before.value - before_interval.lower)
        if after_interval.upper_bound is None:
            return Interval.missing(confidence, FEW_VISITS)
        # The lower limit at twice the tail is the one-sided bound.
        two_sided = before.interval_at(2.0 * confidence - 1.0).lower if confidence > 0.5 else before.value
        bound = value + math.hypot(after_interval.upper_bound - after.value, before.value - (two_sided or 0.0))
        return Interval(lower, upper, bound, confidence, MOVER)

    return IntervalEstimate(value, interval_at)


def largest_figure(estimates: Sequence[IntervalEstimate], confidence: float) -> tuple[int, CriterionFigure]:
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
        return largest, CriterionFigure(value, missing or intervals[0])
    lower = _lower_of_largest(estimates, confidence)
    upper = max(interval.upper or 0.0 for interval in intervals)
    upper_bound = max(interval.upper_bound or 0.0 for interval in intervals)
    method = f"{intervals[largest].method}; largest of {len(estimates)}"
    return largest, CriterionFigure(value, Interval(lower, upper, upper_bound, confidence, method))


def _lower_of_largest(estimates: Sequence[IntervalEstimate], confidence: float) -> float:
    adjusted = 1.0 - (1.0 - confidence) / len(estimates)
    return max(estimate.lower(adjusted) or 0.0 for estimate in estimates)


def largest_estimate(estimates: Sequence[IntervalEstimate]) -> IntervalEstimate:
    """Return the largest of the estimates' true values, as an estimate."""
    value = max(estimate.value for estimate in estimates)
    return IntervalEstimate(
        value,
        lambda confidence: largest_figure(estimates, confidence)[1].interval,
        lambda confidence: _lower_of_largest(estimates, confidence),
    )
