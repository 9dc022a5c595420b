"""The confidence curve of a figure: for each level, the bound below which the true value lies with that confidence.

Read the other way round it is the confidence that the true value lies below a limit: the conformity probability of
JCGM 106, 7, with the interval's method in place of a prior. It goes through the bounds of the interval that a result
carries, so that a decision by the curve and one by the interval agree; between them it is linear in the normal
quantile of the level, for a figure that is positive in its logarithm.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from robacc.statistics.confidence import ConfidenceCurve as ExactCurve
from robacc.statistics.distributions import normal_cdf, normal_quantile
from robacc.statistics.intervals import Interval

LEVELS = (0.3, 0.9, 0.99)
"""Confidences of the intervals that a curve is drawn through where the errors of every pose are there."""
_REACHES = 1.2
"""Normal quantile of the outermost bound, from which on a curve may be carried further: about 88 %."""
_AROUND_LIMIT = 5.0
_STEPS = 20


@dataclass(frozen=True, slots=True)
class BoundCurve:
    """Bounds of a figure, from the lowest level to the highest; empty where no interval could be had."""

    z: tuple[float, ...]
    """Normal quantile of each bound's level."""
    bounds: tuple[float, ...]
    """In the figure's unit, never falling."""
    method: str
    why: str | None = None
    """Why bounds are missing."""
    exact: ExactCurve | None = None
    """The interval's own method read the other way round, where it is at hand; goes before the line between bounds."""

    @classmethod
    def through(cls, intervals: Iterable[Interval], centre: float | None = None) -> BoundCurve:
        """The curve through one-sided and two-sided bounds; ``centre`` is the bound at one half, where it is known."""
        points: dict[float, float] = {} if centre is None else {0.0: centre}
        method, why, exact = "none", None, None
        for interval in intervals:
            tail = 0.5 * (1.0 - interval.confidence)
            named = ((tail, interval.lower), (1.0 - tail, interval.upper), (interval.confidence, interval.upper_bound))
            points |= {round(normal_quantile(level), 9): bound for level, bound in named if bound is not None}
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
        """Whether it holds a bound from above."""
        return bool(self.z) and self.z[-1] >= _REACHES

    @property
    def has_lower(self) -> bool:
        """Whether it holds a bound from below."""
        return bool(self.z) and self.z[0] <= -_REACHES

    @property
    def positive(self) -> bool:
        """Whether all bounds are above zero, so that the figure is treated in its logarithm."""
        return bool(self.bounds) and self.bounds[0] > 0.0

    def scale(self, value: float) -> float:
        """``value`` on the scale in which the curve is close to normal."""
        return (math.log(value) if value > 0.0 else -math.inf) if self.positive else value

    def bound(self, level: float) -> float | None:
        """The value that the true one lies below with confidence ``level``; None beyond the bounds that are known."""
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
        """The confidence that the true value lies at or below ``limit``; None where no bound reaches that far."""
        if not self.z:
            return None
        if self.bounds[0] == self.bounds[-1]:
            return 1.0 if self.bounds[0] <= limit else 0.0
        if self.exact is not None:
            return self.exact.below(limit)
        wanted = self.scale(limit)
        places = [self.scale(bound) for bound in self.bounds]
        if places[0] <= wanted <= places[-1]:
            i = min(max(bisect_left(places, wanted), 1), len(places) - 1)
            step = places[i] - places[i - 1]
            share = 1.0 if step == 0.0 else (wanted - places[i - 1]) / step
            return normal_cdf(self.z[i - 1] + share * (self.z[i] - self.z[i - 1]))
        above = wanted > places[-1]
        if not (self.has_upper if above else self.has_lower):
            return None
        slope = (places[-1] - places[0]) / (self.z[-1] - self.z[0])
        end = -1 if above else 0
        return normal_cdf(self.z[end] + (wanted - places[end]) / slope)

    def standard_error(self, level: float) -> float | None:
        """Half the width between the bounds at 1 - ``level`` and ``level``, per normal quantile, on the curve's scale.

        By the one half that is there, counted from the middle, where the other bound is missing.
        """
        low, middle, high = (self.bound(one) for one in (1.0 - level, 0.5, level))
        reach = normal_quantile(level)
        if low is not None and high is not None:
            return (self.scale(high) - self.scale(low)) / (2.0 * reach)
        outer = high if low is None else low
        if outer is None or middle is None:
            return None
        return abs(self.scale(outer) - self.scale(middle)) / reach


def difference(value: float, one: BoundCurve, baseline: float, other: BoundCurve) -> BoundCurve:
    """The curve of ``value`` - ``baseline`` of two samples that have nothing to do with each other.

    Each bound is put together from the two samples' own by the method of variance estimates recovery (G. Y. Zou,
    A. Donner, "Construction of confidence limits about effect measures", Statistics in Medicine 27, 2008).
    """
    points = {}
    for z in (-2.33, -1.96, -1.645, -1.28, -0.67, 0.0, 0.67, 1.28, 1.645, 1.96, 2.33):
        level = normal_cdf(z)
        own, its = one.bound(level), other.bound(1.0 - level)
        if own is not None and its is not None:
            reach = math.hypot(own - value, its - baseline)
            points[z] = value - baseline + math.copysign(reach, z) if z else value - baseline
    if not any(points):
        return BoundCurve((), (), "none", one.why or other.why or "one of the two results has no interval of it")
    rising = sorted(points.values())
    method = "two samples, bounds put together by variance estimates recovery"
    return BoundCurve(tuple(sorted(points)), tuple(rising), method, one.why or other.why)


def operating_curve(
    limit: float, curve: BoundCurve, error: float, passes: Callable[[float], float]
) -> tuple[tuple[float, float], ...]:
    """Probability to pass over the true value, with as many poses as there were.

    Args:
        limit: Of the criterion.
        curve: Says on which scale the figure is close to normal.
        error: Its standard error on that scale.
        passes: Probability to pass where the true value is so many standard errors above the limit.
    """
    centre = curve.scale(limit)
    if not math.isfinite(centre) or error <= 0.0:
        return ()
    points = []
    for k in range(_STEPS + 1):
        away = _AROUND_LIMIT * (2.0 * k / _STEPS - 1.0)
        place = centre + away * error
        points.append((math.exp(place) if curve.positive else place, passes(away)))
    return tuple(points)
