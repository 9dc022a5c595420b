"""Bound curve of a figure: for each level, the bound below which the true value lies with that confidence.

Read in the other direction, the curve gives the confidence that the true value lies below a limit: the conformity
probability of JCGM 106, 7, with the interval's method in place of a prior. The curve passes through the bounds of the
interval that a result carries, so that a decision by the curve and a decision by the interval agree. Between the
bounds it is linear in the normal quantile of the level; for a positive figure, its logarithm is.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from robacc.statistics.confidence_curves import ConfidenceCurve as ExactCurve
from robacc.statistics.distributions import normal_cdf, normal_quantile
from robacc.statistics.intervals import Interval

LEVELS = (0.3, 0.9, 0.99)
"""Confidences of the intervals behind a curve where the errors of every pose are available."""
_EXTRAPOLATION_QUANTILE = 1.2
"""Normal quantile, about 88 %: a curve whose outermost bound lies beyond it may be extrapolated."""
_AROUND_LIMIT = 5.0
_STEPS = 20


@dataclass(frozen=True, slots=True)
class BoundCurve:
    """Bounds of a figure, from the lowest level to the highest; empty if no interval exists."""

    z: tuple[float, ...]
    """Normal quantile of each bound's level."""
    bounds: tuple[float, ...]
    """In the figure's unit, non-decreasing."""
    method: str
    why: str | None = None
    """Reason for missing bounds."""
    exact: ExactCurve | None = None
    """Confidence curve of the interval's own method, if known; it takes precedence over interpolation."""

    @classmethod
    def through(cls, intervals: Iterable[Interval], centre: float | None = None) -> BoundCurve:
        """Return the curve through one-sided and two-sided bounds; ``centre`` is the bound at level 1/2, if known."""
        points: dict[float, float] = {} if centre is None else {0.0: centre}
        method, why, exact = "none", None, None
        for interval in intervals:
            tail = 0.5 * (1.0 - interval.confidence)
            levels = ((tail, interval.lower), (1.0 - tail, interval.upper), (interval.confidence, interval.upper_bound))
            points |= {round(normal_quantile(level), 9): bound for level, bound in levels if bound is not None}
            method, why, exact = interval.method, why or interval.why, interval.curve
        if not any(points):
            points = {}
        # Resampled bounds at neighbouring levels may cross by chance.
        rising, highest = [], -math.inf
        for z in sorted(points):
            highest = max(highest, points[z])
            rising.append(highest)
        return cls(tuple(sorted(points)), tuple(rising), method, why, exact)

    @property
    def has_upper(self) -> bool:
        """Return whether the curve has a bound from above."""
        return bool(self.z) and self.z[-1] >= _EXTRAPOLATION_QUANTILE

    @property
    def has_lower(self) -> bool:
        """Return whether the curve has a bound from below."""
        return bool(self.z) and self.z[0] <= -_EXTRAPOLATION_QUANTILE

    @property
    def positive(self) -> bool:
        """Return whether all bounds are above zero, so that the figure is treated in its logarithm."""
        return bool(self.bounds) and self.bounds[0] > 0.0

    def scale(self, value: float) -> float:
        """Return ``value`` on the scale on which the curve is close to normal."""
        return (math.log(value) if value > 0.0 else -math.inf) if self.positive else value

    def bound(self, level: float) -> float | None:
        """Return the upper bound of the true value at confidence ``level``; None outside the known bounds."""
        z = round(normal_quantile(level), 9)
        if not self.z or not self.z[0] <= z <= self.z[-1]:
            return None
        i = min(max(bisect_left(self.z, z), 1), len(self.z) - 1)
        if len(self.z) == 1 or self.z[i] == z:
            return self.bounds[i]
        if self.z[i - 1] == z:
            return self.bounds[i - 1]
        low, high = self.scale(self.bounds[i - 1]), self.scale(self.bounds[i])
        between = low + (high - low) * (z - self.z[i - 1]) / (self.z[i] - self.z[i - 1])
        return math.exp(between) if self.positive else between

    def below(self, limit: float) -> float | None:
        """Return the confidence that the true value is at or below ``limit``; None if no bound reaches that far."""
        if not self.z:
            return None
        if self.bounds[0] == self.bounds[-1]:
            return 1.0 if self.bounds[0] <= limit else 0.0
        if self.exact is not None:
            return self.exact.below(limit)
        scaled_limit = self.scale(limit)
        scaled = [self.scale(bound) for bound in self.bounds]
        if scaled[0] <= scaled_limit <= scaled[-1]:
            i = min(max(bisect_left(scaled, scaled_limit), 1), len(scaled) - 1)
            step = scaled[i] - scaled[i - 1]
            share = 1.0 if step == 0.0 else (scaled_limit - scaled[i - 1]) / step
            return normal_cdf(self.z[i - 1] + share * (self.z[i] - self.z[i - 1]))
        above = scaled_limit > scaled[-1]
        if not (self.has_upper if above else self.has_lower):
            return None
        slope = (scaled[-1] - scaled[0]) / (self.z[-1] - self.z[0])
        end = -1 if above else 0
        return normal_cdf(self.z[end] + (scaled_limit - scaled[end]) / slope)

    def standard_error(self, level: float) -> float | None:
        """Return half the distance between the bounds at 1 - ``level`` and ``level`` per normal quantile, scaled.

        If a bound is missing, the distance of the other bound from the median takes its place.
        """
        low, median, high = (self.bound(probability) for probability in (1.0 - level, 0.5, level))
        quantile = normal_quantile(level)
        if low is not None and high is not None:
            return (self.scale(high) - self.scale(low)) / (2.0 * quantile)
        outer = high if low is None else low
        if outer is None or median is None:
            return None
        return abs(self.scale(outer) - self.scale(median)) / quantile


def difference_curve(value: float, curve: BoundCurve, baseline: float, baseline_curve: BoundCurve) -> BoundCurve:
    """Return the curve of ``value`` - ``baseline`` for two independent samples.

    Each bound combines the bounds of the two samples by the method of variance estimates recovery (G. Y. Zou,
    A. Donner, "Construction of confidence limits about effect measures", Statistics in Medicine 27, 2008).
    """
    points = {}
    for z in (-2.33, -1.96, -1.645, -1.28, -0.67, 0.0, 0.67, 1.28, 1.645, 1.96, 2.33):
        level = normal_cdf(z)
        bound, baseline_bound = curve.bound(level), baseline_curve.bound(1.0 - level)
        if bound is not None and baseline_bound is not None:
            distance = math.hypot(bound - value, baseline_bound - baseline)
            points[z] = value - baseline + math.copysign(distance, z) if z else value - baseline
    why = curve.why or baseline_curve.why
    if not any(points):
        return BoundCurve((), (), "none", why or "the result or the baseline has no interval for this key")
    rising = sorted(points.values())
    method = "two independent samples, bounds by the method of variance estimates recovery"
    return BoundCurve(tuple(sorted(points)), tuple(rising), method, why)


def operating_curve(
    limit: float, curve: BoundCurve, error: float, pass_probability: Callable[[float], float]
) -> tuple[tuple[float, float], ...]:
    """Return the probability to pass over the true value, for the same number of poses.

    Args:
        limit: Limit of the criterion.
        curve: Bounds of the figure; they set the scale on which the figure is close to normal.
        error: Standard error of the figure on that scale.
        pass_probability: Probability to pass, as a function of the true value's distance above the limit in standard
            errors.
    """
    centre = curve.scale(limit)
    if not math.isfinite(centre) or error <= 0.0:
        return ()
    points = []
    for k in range(_STEPS + 1):
        distance = _AROUND_LIMIT * (2.0 * k / _STEPS - 1.0)
        place = centre + distance * error
        points.append((math.exp(place) if curve.positive else place, pass_probability(distance)))
    return tuple(points)
