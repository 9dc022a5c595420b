"""Decision on one figure by its bounds and the rule, with the poses that would decide and the operating curve."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from robacc.gates.bound_curve import BoundCurve, operating_curve
from robacc.gates.criteria import GateCriterion
from robacc.statistics.distributions import normal_cdf, normal_quantile

Outcome = Literal["pass", "fail", "inconclusive", "not_evaluated"]

ASSURANCE = 0.9
"""Probability that the stated number of poses decides."""
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
    limit = criterion.limit if criterion.limit is not None else math.nan
    sign = -1.0 if criterion.at_least else 1.0
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
    error = _standard_error(curve, criterion.confidence)
    outcome, tested, why = _outcome(criterion, curve, value, adverse, favourable)
    below = curve.below(limit)
    probability = None if below is None else 1.0 - below if criterion.at_least else below
    poses: tuple[int | None, int | None] = (None, None)
    if outcome == "inconclusive" and n is not None:
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
        () if error is None else operating_curve(limit, curve, error, _PassProbability.of(criterion)),
    )


def _outcome(
    criterion: GateCriterion, curve: BoundCurve, value: float, adverse: float | None, favourable: float | None
) -> tuple[Outcome, float | None, str | None]:
    """Return the outcome, the number that the rule tests against the limit, and the explanation if one is needed.

    ``adverse`` is the bound towards the limit, ``favourable`` the opposite bound.
    """
    limit = criterion.limit if criterion.limit is not None else math.nan

    def meets(number: float) -> bool:
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


def _standard_error(curve: BoundCurve, confidence: float) -> float | None:
    """Return the standard error on the curve's scale that applies when more poses are measured."""
    return curve.standard_error(confidence if confidence > 0.6 else 0.9)


@dataclass(frozen=True, slots=True)
class _PassProbability:
    """Probability to pass as a function of the true value's distance above the limit, in standard errors."""

    shift: float
    sign: float

    @classmethod
    def of(cls, criterion: GateCriterion) -> _PassProbability:
        z = normal_quantile(criterion.confidence)
        shift = {"bound": z, "guard_band": z, "simple": 0.0, "guarded_rejection": -z}[criterion.rule]
        return cls(shift, -1.0 if criterion.at_least else 1.0)

    def __call__(self, distance: float) -> float:
        return normal_cdf(-self.sign * distance - self.shift)


def _poses_needed(
    criterion: GateCriterion, curve: BoundCurve, value: float, error: float | None, n: int
) -> tuple[int | None, int | None]:
    """Return the number of poses that decides: given the uncertainty of the value, and if the value is the truth."""
    confidence = criterion.confidence
    fewest = n + 1
    if criterion.key.endswith(".p95"):
        # With fewer poses, no order statistic bounds a 95th percentile.
        fewest = max(fewest, math.ceil(math.log(1.0 - confidence) / math.log(0.95)))
    limit = criterion.limit if criterion.limit is not None else math.nan
    if error is None or error <= 0.0 or not math.isfinite(curve.scale(limit)) or not math.isfinite(curve.scale(value)):
        return None, None
    z = normal_quantile(confidence)
    distance = abs(curve.scale(limit) - curve.scale(value)) / error
    assured = poses_to_decide(distance, z, n)
    if_true = None
    if distance > 0.0:
        # The bound lies z standard errors from the estimate, and the estimate scatters by one standard error.
        if_true = math.ceil(min(n * ((z + normal_quantile(ASSURANCE)) / distance) ** 2, MOST_POSES + 1.0))
    return (
        None if assured is None else max(assured, fewest),
        None if if_true is None or if_true > MOST_POSES else max(if_true, fewest),
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
        ratio = poses / n
        scatter_std, reach = math.sqrt(1.0 - 1.0 / ratio), z / math.sqrt(ratio)
        probability = normal_cdf((distance - reach) / scatter_std) + normal_cdf((-distance - reach) / scatter_std)
        return probability >= ASSURANCE

    high = 2 * n
    while not decides(high):
        high *= 2
        if high > MOST_POSES:
            return None
    low = n
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if middle > n and decides(middle) else (middle, high)
    return high
