"""Decision on one figure by its bounds and the rule, with the poses that would decide it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.gates.gate_file import GateCriterion
from robacc.statistics.distributions import normal_cdf, normal_quantile
from robacc.statistics.intervals import ASSURANCE, ConfidenceCurve, Interval, smallest_sufficient

# Bound curve of a figure: for each level, the bound below which the true value lies with that confidence.
#
# Read in the other direction, the curve gives the confidence that the true value lies below a limit: the conformity
# probability of JCGM 106, 7, with the interval's method in place of a prior. The curve passes through the bounds of
# the interval that a result carries, so that a decision by the curve and a decision by the interval agree. Between
# the bounds it is linear in the normal quantile of the level; for a positive figure, its logarithm is.

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
    exact: ConfidenceCurve | None = None
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
        if z in self.z:
            return self.bounds[self.z.index(z)]
        if not self.z or not self.z[0] < z < self.z[-1]:
            return None
        between = float(np.interp(z, self.z, [self.scale(bound) for bound in self.bounds]))
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
            return normal_cdf(float(np.interp(scaled_limit, scaled, self.z)))
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


def operating_curve(criterion: GateCriterion, curve: BoundCurve, error: float) -> tuple[tuple[float, float], ...]:
    """Return the probability to pass over the true value, for the same number of poses.

    Args:
        criterion: The criterion, with a limit.
        curve: Bounds of the figure; they set the scale on which the figure is close to normal.
        error: Standard error of the figure on that scale.
    """
    centre = curve.scale(_limit(criterion))
    if not math.isfinite(centre) or error <= 0.0:
        return ()
    z, sign = normal_quantile(criterion.confidence), -1.0 if criterion.at_least else 1.0
    shift = {"bound": z, "guard_band": z, "simple": 0.0, "guarded_rejection": -z}[criterion.rule]
    # Distances of the true value above the limit, in standard errors.
    distances = [_AROUND_LIMIT * (2.0 * k / _STEPS - 1.0) for k in range(_STEPS + 1)]
    places = [centre + distance * error for distance in distances]
    return tuple(
        (math.exp(place) if curve.positive else place, normal_cdf(-sign * distance - shift))
        for place, distance in zip(places, distances, strict=True)
    )


Outcome = Literal["pass", "fail", "inconclusive", "not_evaluated"]

MOST_POSES = 10_000_000


@dataclass(frozen=True, slots=True)
class Decision:
    """Outcome of one criterion, with its bounds, margin and probability."""

    outcome: Outcome
    why: str | None = None
    """Explanation, where the outcome needs one."""
    lower_bound: float | None = None
    upper_bound: float | None = None
    """One-sided, each at the criterion's confidence."""
    margin: float | None = None
    """Distance from the bound or value that the rule tests to the limit; negative beyond the limit."""
    probability: float | None = None
    """Conformity probability: the confidence that the true value meets the limit."""
    method: str | None = None
    """Method of the bounds."""
    poses_to_decide: int | None = None
    """Number of poses, including those measured, that decides an inconclusive criterion with :data:`ASSURANCE`."""
    poses_if_true: int | None = None
    """The same number if the measured value is the true value."""
    operating_curve: tuple[tuple[float, float], ...] = ()
    """True values and the probability to pass at each, for the same number of poses."""


def decide(criterion: GateCriterion, value: float, curve: BoundCurve | None, n: int | None) -> Decision:
    """Decide on a figure by its bounds.

    Args:
        criterion: The criterion, with a limit.
        value: Value of the figure.
        curve: Bounds of the figure; None if the result has no interval for it.
        n: Number of poses behind the figure.
    """
    limit, sign = _limit(criterion), -1.0 if criterion.at_least else 1.0
    if curve is None:
        if criterion.rule != "simple":
            no_interval = f"the result has no interval for {criterion.key}, which rule: {criterion.rule} needs"
            return Decision("not_evaluated", no_interval)
        return Decision("pass" if sign * (limit - value) >= 0.0 else "fail", margin=sign * (limit - value))
    low, high = curve.bound(1.0 - criterion.confidence), curve.bound(criterion.confidence)
    # Bounds at a low confidence may exclude a biased value, such as a sample's percentile. Nothing passes with a value
    # beyond the limit, and nothing fails with a value within it.
    low, high = None if low is None else min(low, value), None if high is None else max(high, value)
    adverse, favourable = (low, high) if criterion.at_least else (high, low)
    error = curve.standard_error(criterion.confidence if criterion.confidence > 0.6 else 0.9)
    outcome, tested, why = _outcome(criterion, curve, value, adverse, favourable)
    below = curve.below(limit)
    probability = None if below is None else 1.0 - below if criterion.at_least else below
    poses: tuple[int | None, int | None] = (None, None)
    if outcome == "inconclusive" and n is not None and error is not None:
        poses = _poses_needed(criterion, curve, value, error, n)
    return Decision(
        outcome,
        why,
        low,
        high,
        None if tested is None else sign * (limit - tested),
        probability,
        curve.method,
        *poses,
        () if error is None else operating_curve(criterion, curve, error),
    )


def _limit(criterion: GateCriterion) -> float:
    return criterion.limit if criterion.limit is not None else math.nan


def _outcome(
    criterion: GateCriterion, curve: BoundCurve, value: float, adverse: float | None, favourable: float | None
) -> tuple[Outcome, float | None, str | None]:
    """Return the outcome, the number that the rule tests against the limit, and the explanation if one is needed.

    ``adverse`` is the bound towards the limit, ``favourable`` the opposite bound.
    """

    def meets(number: float) -> bool:
        limit = _limit(criterion)
        return number >= limit if criterion.at_least else number <= limit

    if criterion.rule == "simple":
        return "pass" if meets(value) else "fail", value, None
    if criterion.rule == "guarded_rejection":
        if favourable is None:
            return "inconclusive", None, _missing_bound(criterion, curve)
        return "pass" if meets(favourable) else "fail", favourable, None
    if adverse is not None and meets(adverse):
        return "pass", adverse, None
    if criterion.rule == "guard_band" and adverse is not None:
        inside = "the value meets the limit but lies within the guard band" if meets(value) else None
        return "fail", adverse, inside
    if favourable is not None and not meets(favourable):
        return "fail", adverse if adverse is not None else favourable, None
    return "inconclusive", adverse, None if adverse is not None else _missing_bound(criterion, curve)


def _missing_bound(criterion: GateCriterion, curve: BoundCurve) -> str:
    """Return why there is no bound at the criterion's confidence."""
    if curve.why is None and (curve.has_upper or curve.has_lower):
        percent = f"{100 * criterion.confidence:g} %"
        return f"the result's interval does not reach {percent}; compute the result again at {percent} confidence"
    return curve.why or "there are too few poses for an interval"


def _poses_needed(
    criterion: GateCriterion, curve: BoundCurve, value: float, error: float, n: int
) -> tuple[int | None, int | None]:
    """Return the number of poses that decides: given the uncertainty of the value, and if the value is the truth."""
    scaled = curve.scale(_limit(criterion)), curve.scale(value)
    if error <= 0.0 or not all(map(math.isfinite, scaled)):
        return None, None
    z, distance = normal_quantile(criterion.confidence), abs(scaled[0] - scaled[1]) / error
    # The bound lies z standard errors from the estimate, and the estimate scatters by one standard error.
    if_true = math.inf if distance == 0.0 else n * ((z + normal_quantile(ASSURANCE)) / distance) ** 2
    fewest = n + 1
    if criterion.key.endswith(".p95"):
        # With fewer poses, no order statistic bounds a 95th percentile.
        fewest = max(fewest, math.ceil(math.log(1.0 - criterion.confidence) / math.log(0.95)))
    assured = poses_to_decide(distance, z, n)
    return (
        None if assured is None else max(assured, fewest),
        None if if_true > MOST_POSES else max(math.ceil(if_true), fewest),
    )


def poses_to_decide(distance: float, z: float, n: int) -> int | None:
    """Return the smallest number of poses, including the ``n`` measured, that decides with :data:`ASSURANCE`.

    The estimate from m n poses scatters about the present estimate with (1 - 1/m) of the present variance: the poses
    to come add scatter, and the truth is as uncertain as the present interval says. It decides if it is more than
    z / sqrt(m) from the limit (all in present standard errors). The mean of the power over the distribution of the
    truth is called assurance (A. O'Hagan, J. W. Stevens, M. J. Campbell, "Assurance in clinical trial design",
    Pharmaceutical Statistics 4, 2005).

    Args:
        distance: Distance from the estimate to the limit, in present standard errors.
        z: Normal quantile of the bounds' confidence.
        n: Number of poses measured.
    """

    def decides(poses: int) -> bool:
        if poses <= n:
            return False
        ratio = poses / n
        scatter_std, reach = math.sqrt(1.0 - 1.0 / ratio), z / math.sqrt(ratio)
        probability = normal_cdf((distance - reach) / scatter_std) + normal_cdf((-distance - reach) / scatter_std)
        return probability >= ASSURANCE

    return smallest_sufficient(decides, 2.0 * n, most=MOST_POSES)


# Decision on a largest error, which no sample bounds from above: by the share of all poses within the limit.
#
# If a share s of all poses lies within the limit, all of n poses do so with probability s^n. If none of n poses is
# beyond the limit, s is therefore at least (1 - c)^(1/n) with confidence c: Wilks' one-sided tolerance limit (S. S.
# Wilks, "Determination of sample sizes for setting tolerance limits", Annals of Mathematical Statistics 12, 1941). One
# pose beyond the limit shows that the largest error is beyond it.


def decide_largest(criterion: GateCriterion, value: float, n: int) -> Decision:
    """Decide on the largest error of ``n`` poses against an upper limit."""
    share, margin = criterion.share, _limit(criterion) - value
    n_needed = math.ceil(math.log(1.0 - criterion.confidence) / math.log(share))
    claim = f"that {100 * share:g} % of all poses are within the limit"
    method = f"confidence {claim} (Wilks)"
    curve = tuple((1.0 - k * 0.01, (1.0 - k * 0.01) ** n if n >= n_needed else 0.0) for k in range(_STEPS + 1))
    if margin < 0.0:
        # The rules differ in their demands on poses that were not measured; one pose beyond the limit decides.
        return Decision("fail", lower_bound=value, margin=margin, probability=0.0, method=method, operating_curve=curve)
    probability = 1.0 - share**n
    outcome: Outcome = "pass"
    why = n_to_decide = None
    if n < n_needed and criterion.rule != "guarded_rejection":
        outcome = "fail" if criterion.rule == "guard_band" else "inconclusive"
        why = f"{n} poses within the limit show {claim} with a confidence of only {100 * probability:.3g} %"
        n_to_decide = n_needed if outcome == "inconclusive" else None
    return Decision(
        outcome,
        why,
        value,
        margin=margin,
        probability=probability,
        method=method,
        poses_to_decide=n_to_decide,
        poses_if_true=n_to_decide,
        operating_curve=curve,
    )
