"""The decision on one figure: by its bounds and the rule, with what would decide it and how sharp the rule is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from robacc.gates.confidence import BoundCurve, operating_curve
from robacc.gates.criteria import GateCriterion
from robacc.statistics.distributions import normal_cdf, normal_quantile

Outcome = Literal["pass", "fail", "inconclusive", "not_evaluated"]

ASSURANCE = 0.9
"""Probability with which the number of poses that is named decides."""
MOST_POSES = 10_000_000
_GAUSSIAN_P95 = "95 % radius"
"""How the method of a 95th percentile begins that rests on a fitted Gaussian, as it does below some 70 poses."""
_ORDER_STATISTICS_COST = 2.4
"""Order statistics, which take over with more poses, have this much more variance than a Gaussian's radius: 2.33 for
errors alike in three directions, 1.8 for errors along one."""


@dataclass(frozen=True, slots=True)
class Decision:
    """What was decided of a figure, and how firmly."""

    outcome: Outcome
    why: str | None = None
    """Of an outcome that needs an explanation."""
    lower_bound: float | None = None
    upper_bound: float | None = None
    """One-sided, each at the criterion's confidence."""
    margin: float | None = None
    """From what is held against the limit, the bound or the value, to the limit; negative beyond it."""
    probability: float | None = None
    """Of conformity: the confidence that the true value meets the limit."""
    method: str | None = None
    """Of the bounds."""
    poses_to_decide: int | None = None
    """Poses, those measured among them, that decide with probability :data:`ASSURANCE`; for what is inconclusive."""
    poses_if_true: int | None = None
    """The same if the value found is the true one."""
    operating_curve: tuple[tuple[float, float], ...] = ()
    """True value and the probability to pass there, with as many poses."""


def decide(criterion: GateCriterion, value: float, curve: BoundCurve | None, n: int | None) -> Decision:
    """Decide on a figure whose bounds are known.

    Args:
        criterion: With a limit.
        value: As found.
        curve: Of the value; None where the result has no interval of it.
        n: Poses that it is of.
    """
    limit = criterion.limit if criterion.limit is not None else math.nan
    sign = -1.0 if criterion.at_least else 1.0
    if curve is None:
        if criterion.rule != "simple":
            return Decision("not_evaluated", f"the result has no interval of it, and rule: {criterion.rule} takes one")
        return Decision("pass" if sign * (limit - value) >= 0.0 else "fail", margin=sign * (limit - value))
    low, high = curve.bound(1.0 - criterion.confidence), curve.bound(criterion.confidence)
    # Bounds of a percentile may rest on a fitted Gaussian and leave out the one found: nothing passes with a value
    # beyond the limit, and nothing fails with one within it.
    low, high = None if low is None else min(low, value), None if high is None else max(high, value)
    adverse, kind = (low, high) if criterion.at_least else (high, low)
    error = _error(curve, criterion.confidence)
    outcome, held, why = _outcome(criterion, curve, value, adverse, kind)
    below = curve.below(limit)
    probability = None if below is None else 1.0 - below if criterion.at_least else below
    decided: tuple[int | None, int | None] = (None, None)
    if outcome == "inconclusive" and n is not None:
        decided = _poses_needed(criterion, curve, value, error, n)
    return Decision(
        outcome,
        why,
        low,
        high,
        None if held is None else sign * (limit - held),
        probability,
        curve.method,
        *decided,
        () if error is None else operating_curve(limit, curve, error, _passes(criterion)),
    )


def _outcome(
    criterion: GateCriterion, curve: BoundCurve, value: float, adverse: float | None, kind: float | None
) -> tuple[Outcome, float | None, str | None]:
    """Outcome, what the limit was held against, and the reason where one is needed.

    ``adverse`` is the bound on the limit's side, ``kind`` the one on the other.
    """
    limit = criterion.limit if criterion.limit is not None else math.nan

    def meets(found: float) -> bool:
        return found >= limit if criterion.at_least else found <= limit

    if criterion.rule == "simple":
        return "pass" if meets(value) else "fail", value, None
    if criterion.rule == "guarded_rejection":
        if kind is None:
            return "inconclusive", None, _lack(criterion, curve)
        return "pass" if meets(kind) else "fail", kind, None
    if adverse is not None and meets(adverse):
        return "pass", adverse, None
    if criterion.rule == "guard_band" and adverse is not None:
        inside = "the value meets the limit, but not the limit less its guard band" if meets(value) else None
        return "fail", adverse, inside
    if kind is not None and not meets(kind):
        return "fail", adverse if adverse is not None else kind, None
    return "inconclusive", adverse, None if adverse is not None else _lack(criterion, curve)


def _lack(criterion: GateCriterion, curve: BoundCurve) -> str:
    """Why there is no bound at the criterion's confidence."""
    if curve.has_upper or curve.has_lower:
        confidence = criterion.confidence
        beyond = (
            f"the result's interval does not reach {100 * confidence:g} %; make it with --confidence {confidence:g}"
        )
        return curve.why or beyond
    return curve.why or "the poses are too few for an interval"


def _error(curve: BoundCurve, confidence: float) -> float | None:
    """Standard error on the curve's scale, as it will be when poses are more."""
    error = curve.standard_error(confidence if confidence > 0.6 else 0.9)
    if error is not None and curve.method.startswith(_GAUSSIAN_P95):
        error *= math.sqrt(_ORDER_STATISTICS_COST)
    return error


def _passes(criterion: GateCriterion) -> _Passing:
    z = normal_quantile(criterion.confidence)
    shift = {"bound": z, "guard_band": z, "simple": 0.0, "guarded_rejection": -z}[criterion.rule]
    return _Passing(shift, -1.0 if criterion.at_least else 1.0)


@dataclass(frozen=True, slots=True)
class _Passing:
    """Probability to pass where the truth is so many standard errors above the limit."""

    shift: float
    sign: float

    def __call__(self, away: float) -> float:
        return normal_cdf(-self.sign * away - self.shift)


def _poses_needed(
    criterion: GateCriterion, curve: BoundCurve, value: float, error: float | None, n: int
) -> tuple[int | None, int | None]:
    """Poses that will decide: with the truth as uncertain as it is, and if the value found is the truth."""
    confidence = criterion.confidence
    fewest = n + 1
    if criterion.key.endswith(".p95"):
        # With fewer, no order statistic bounds a 95th percentile.
        fewest = max(fewest, math.ceil(math.log(1.0 - confidence) / math.log(0.95)))
    limit = criterion.limit if criterion.limit is not None else math.nan
    if error is None or error <= 0.0 or not math.isfinite(curve.scale(limit)) or not math.isfinite(curve.scale(value)):
        return None, None
    z = normal_quantile(confidence)
    away = abs(curve.scale(limit) - curve.scale(value)) / error
    sure = poses_to_decide(away, z, n)
    plain = None
    if away > 0.0:
        # The bound is the estimate and z standard errors, the estimate scatters by as much again.
        plain = math.ceil(min(n * ((z + normal_quantile(ASSURANCE)) / away) ** 2, MOST_POSES + 1.0))
    return (
        None if sure is None else max(sure, fewest),
        None if plain is None or plain > MOST_POSES else max(plain, fewest),
    )


def poses_to_decide(away: float, z: float, n: int) -> int | None:
    """The smallest number of poses, ``n`` measured ones among them, that decides with probability :data:`ASSURANCE`.

    The estimate from m n poses lies about the present one with the variance (1 - 1/m) of the present one's: what the
    poses still to be measured add, and the truth being as uncertain as the present interval says. It decides if it is
    more than z / sqrt(m) from the limit (all in present standard errors). The mean of the power over what is known of
    the truth is called assurance (A. O'Hagan, J. W. Stevens, M. J. Campbell, "Assurance in clinical trial design",
    Pharmaceutical Statistics 4, 2005).

    Args:
        away: From the estimate to the limit, in present standard errors.
        z: Normal quantile of the bounds' confidence.
        n: Poses measured.
    """

    def decides(poses: int) -> bool:
        ratio = poses / n
        spread, needed = math.sqrt(1.0 - 1.0 / ratio), z / math.sqrt(ratio)
        return normal_cdf((away - needed) / spread) + normal_cdf((-away - needed) / spread) >= ASSURANCE

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
