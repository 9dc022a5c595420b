"""Confidence curves, rules, and the number of poses that decides: against exact distributions and simulation."""

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from robacc.accuracy.error_statistics import length_intervals, satterthwaite
from robacc.gates import (
    LEVELS,
    BoundCurve,
    Evaluation,
    GateCriterion,
    Rule,
    decide,
    decide_largest,
    difference_curve,
    poses_to_decide,
)
from robacc.geometry import Array
from robacc.statistics.intervals import ASSURANCE, Interval

SD = np.array([1.0, 0.6, 0.3])[:, None]
RMS = float(np.sqrt(np.sum(SD**2)))


def criterion(limit: float, rule: Rule = "bound", confidence: float = 0.95, **more: Any) -> GateCriterion:
    given: dict[str, Any] = {"at_least": False, "share": 0.95, "key": "position.rms", **more}
    given |= {"name": "c", "kind": "length", "accepted": (), "baseline": None, "paired": None, "reason": "r"}
    return GateCriterion(limit=limit, rule=rule, confidence=confidence, **given)


def normal(value: float, error: float, confidence: float = 0.95) -> BoundCurve:
    """Return the curve of a figure with a Gaussian error, as the interval of a result gives it."""
    z, bound = stats.norm.ppf(0.5 + confidence / 2), stats.norm.ppf(confidence)
    interval = Interval(value - z * error, value + z * error, value + bound * error, confidence, "normal")
    return BoundCurve.through([interval], value)


def rms_curve(errors: Array, confidence: float = 0.95) -> tuple[float, BoundCurve]:
    n = errors.shape[1]
    covariance = errors @ errors.T / n
    levels = sorted({*LEVELS, confidence, 2 * confidence - 1})
    curve = BoundCurve.through([satterthwaite(covariance, n, level).root() for level in levels])
    return float(np.sqrt(np.trace(covariance))), curve


def test_a_curve_goes_through_its_interval_and_is_the_distribution_between() -> None:
    curve = normal(-1.0, 0.5)
    assert curve.bound(0.95) == pytest.approx(-1.0 + 0.5 * stats.norm.ppf(0.95), abs=1e-12)
    assert curve.bound(0.05) == pytest.approx(-1.0 - 0.5 * stats.norm.ppf(0.95), abs=1e-9)
    for limit in (-3.0, -1.9, -1.0, -0.4, 0.5):
        assert curve.below(limit) == pytest.approx(stats.norm.cdf(limit, -1.0, 0.5), abs=1e-9)
    assert curve.bound(0.99) is None
    assert curve.standard_error(0.95) == pytest.approx(0.5)


def test_a_curve_knows_where_it_ends() -> None:
    lower = BoundCurve.through([Interval(1.0, None, None, 0.95, "order statistics", "30 poses: too few")], 2.0)
    assert lower.below(0.9) is not None
    assert (lower.below(2.5), lower.reaches) == (None, (True, False))
    assert lower.standard_error(0.95) == pytest.approx(math.log(2.0) / stats.norm.ppf(0.975), rel=1e-6)
    empty = BoundCurve.through([Interval.missing(0.95, "one pose")], 1.0)
    assert (empty.z, empty.below(3.0), empty.bound(0.95), empty.why) == ((), None, None, "one pose")
    same = BoundCurve.through([Interval(2.0, 2.0, 2.0, 0.95, "no scatter")], 2.0)
    assert (same.below(2.0), same.below(1.999)) == (1.0, 0.0)


RULED: list[tuple[Rule, float, bool, str]] = [
    # The value is 1.0 with a standard error of 0.1; the bounds at 95 % are 0.836 and 1.164.
    ("bound", 1.17, False, "pass"),
    ("bound", 1.16, False, "inconclusive"),
    ("bound", 0.84, False, "inconclusive"),
    ("bound", 0.83, False, "fail"),
    ("bound", 0.83, True, "pass"),
    ("bound", 1.16, True, "inconclusive"),
    ("bound", 1.17, True, "fail"),
    ("simple", 1.0, False, "pass"),
    ("simple", 0.999, False, "fail"),
    ("simple", 1.001, True, "fail"),
    ("guard_band", 1.17, False, "pass"),
    ("guard_band", 1.16, False, "fail"),
    ("guard_band", 0.83, True, "pass"),
    ("guarded_rejection", 0.84, False, "pass"),
    ("guarded_rejection", 0.83, False, "fail"),
    ("guarded_rejection", 1.16, True, "pass"),
    ("guarded_rejection", 1.17, True, "fail"),
]


@pytest.mark.parametrize(("rule", "limit", "at_least", "outcome"), RULED)
def test_each_rule_on_either_side_of_each_bound(rule: Rule, limit: float, at_least: bool, outcome: str) -> None:
    decision = decide(criterion(limit, rule, at_least=at_least), 1.0, normal(1.0, 0.1), 50)
    assert decision["outcome"] == outcome
    below = stats.norm.cdf(math.log(limit), 0.0, 0.1)  # roughly: the curve is on the logarithm
    assert decision["conformity_probability"] == pytest.approx(1 - below if at_least else below, abs=0.02)
    assert (decision["margin"] >= 0.0) == (outcome == "pass")
    assert (decision["poses_to_decide"] is not None) == (outcome == "inconclusive")


CURVE = normal(1.0, 0.1)
BOUND = CURVE.bound(0.95)
NO_INTERVAL = "the result has no interval for position.rms, which rule: bound needs"
TOO_SURE = "the result's interval does not reach 99 %; compute the result again at 99 % confidence"
GUARDED = "the value meets the limit but lies within the guard band"


@pytest.mark.parametrize(
    ("condition", "value", "curve", "outcome", "why"),
    [
        # A bound decides as the interval does at the limit itself.
        (criterion(BOUND), 1.0, CURVE, "pass", None),
        (criterion(np.nextafter(BOUND, 0.0)), 1.0, CURVE, "inconclusive", None),
        (criterion(1.0), 0.1, None, "not_evaluated", NO_INTERVAL),
        (criterion(1.0, "simple"), 0.1, None, "pass", None),
        (criterion(2.0, confidence=0.99), 1.0, CURVE, "inconclusive", TOO_SURE),
        (criterion(1.05, "guard_band"), 1.0, CURVE, "fail", GUARDED),
        (criterion(0.9, "guard_band"), 1.0, CURVE, "fail", None),
        # Nothing fails with a value within the limit nor passes with one beyond: bounds of a percentile by a fitted
        # Gaussian may leave out the percentile found.
        (criterion(1.05), 1.0, normal(1.2, 0.05), "inconclusive", None),
        (criterion(0.95), 1.0, normal(0.8, 0.05), "inconclusive", None),
    ],
)
def test_rules_at_their_borders(
    condition: GateCriterion, value: float, curve: BoundCurve | None, outcome: str, why: str | None
) -> None:
    decision = decide(condition, value, curve, 50)
    assert (decision["outcome"], decision["why"]) == (outcome, why)


def test_operating_curves_are_those_of_a_gaussian_figure() -> None:
    """A figure far from zero, where its logarithm is as good as linear: P(pass) by hand."""
    for rule, shift in (("bound", 1.645), ("simple", 0.0), ("guard_band", 1.645), ("guarded_rejection", -1.645)):
        decision = decide(criterion(100.0, rule), 100.0, normal(100.0, 0.1), 50)  # type: ignore[arg-type]
        for truth, passes in decision["operating_curve"]:
            assert passes == pytest.approx(stats.norm.cdf((100.0 - truth) / 0.1 - shift), abs=2e-3)
        assert len(decision["operating_curve"]) == 21


def test_difference_of_two_samples_is_the_gaussian_one() -> None:
    curve = difference_curve(3.0, normal(3.0, 0.03), 1.0, normal(1.0, 0.04))
    for level in (0.05, 0.5, 0.9, 0.95):
        assert curve.bound(level) == pytest.approx(2.0 + 0.05 * stats.norm.ppf(level), abs=0.003)
    assert difference_curve(1.0, normal(1.0, 0.1), 1.0, BoundCurve((), (), "none", "one pose")).why == "one pose"


@pytest.mark.parametrize(
    ("value", "n", "rule", "share", "outcome"),
    [
        (0.9, 59, "bound", 0.95, "pass"),  # 1 - 0.95^59 = 0.9515, the published sample size
        (0.9, 58, "bound", 0.95, "inconclusive"),
        (0.9, 299, "bound", 0.99, "pass"),
        (0.9, 298, "bound", 0.99, "inconclusive"),
        (1.1, 1000, "bound", 0.95, "fail"),
        (0.9, 58, "guard_band", 0.95, "fail"),
        (0.9, 2, "guarded_rejection", 0.95, "pass"),
    ],
)
def test_the_largest_error_by_wilks(value: float, n: int, rule: Rule, share: float, outcome: str) -> None:
    found = decide_largest(criterion(1.0, rule, share=share, key="position.max"), value, n)
    assert found["outcome"] == outcome
    if n == 59:
        assert dict(found["operating_curve"])[0.95] == pytest.approx(0.95**59)
    if outcome == "inconclusive" and n == 58:
        assert (found["poses_to_decide"], found["conformity_probability"]) == (59, pytest.approx(1 - 0.95**58))
        assert found["why"] == (
            "58 poses within the limit show that 95 % of all poses are within the limit "
            "with a confidence of only 94.9 %"
        )


def test_poses_to_decide_by_simulation_of_the_figure_alone() -> None:
    """Known standard error: draw a truth from what the interval says, measure on, and see whether it decides."""
    rng, z, draws, n = np.random.default_rng(3), 1.645, 200_000, 50
    for distance in (0.0, 0.7, 1.5):
        n_needed = poses_to_decide(distance, z, n)
        added = rng.normal(rng.normal(size=draws), math.sqrt(n / (n_needed - n)))
        pooled = (added * (n_needed - n)) / n_needed
        decided = np.mean(np.abs(pooled - distance) > z / math.sqrt(n_needed / n))
        assert decided == pytest.approx(ASSURANCE, abs=0.005)
        fewer = rng.normal(size=draws) * math.sqrt(1 - n / (0.5 * n_needed))
        assert np.mean(np.abs(fewer - distance) > z / math.sqrt(0.5 * n_needed / n)) < ASSURANCE - 0.02
    assert poses_to_decide(0.0, z, 10_000_000) is None


def undecided(rng: np.random.Generator, n: int) -> tuple[Array, float, Evaluation]:
    """Errors of n poses and a limit that they cannot decide."""
    while True:
        limit = RMS * math.exp(rng.uniform(-0.4, 0.4) * math.sqrt(30 / n))
        errors = SD * rng.normal(size=(3, n))
        decision = decide(criterion(limit), *rms_curve(errors), n)
        if decision["outcome"] == "inconclusive":
            return errors, limit, decision


@pytest.mark.parametrize("n", [30, pytest.param(120, marks=pytest.mark.slow)])
def test_the_promised_poses_decide_in_nine_of_ten_cases(n: int) -> None:
    rng = np.random.default_rng(n)
    decided = []
    for _ in range(300):
        errors, limit, decision = undecided(rng, n)
        all_errors = np.hstack((errors, SD * rng.normal(size=(3, decision["poses_to_decide"] - n))))
        decided.append(
            decide(criterion(limit), *rms_curve(all_errors), all_errors.shape[1])["outcome"] != "inconclusive"
        )
    # Three standard deviations of a share of 0.9 in 300 are 0.052.
    assert np.mean(decided) > ASSURANCE - 0.052


def test_poses_for_a_p95_are_never_fewer_than_order_statistics_need() -> None:
    decision = decide(criterion(1.3, key="position.p95"), 1.0, normal(1.0, 0.19), 12)
    assert decision["outcome"] == "inconclusive"
    assert decision["poses_to_decide_if_value_is_true"] >= 59


@pytest.mark.slow
@pytest.mark.parametrize("statistic", ["rms", "mean_error", "p95"])
def test_conformity_probabilities_are_calibrated(statistic: Any) -> None:
    """Where the truth is the limit, the probability of conformity is uniform: below a in a share a of the cases."""
    rng = np.random.default_rng(7)
    lengths = np.sqrt(np.sum((SD * rng.normal(size=(3, 1_000_000))) ** 2, axis=0))
    truth = {"rms": RMS, "mean_error": np.mean(lengths), "p95": np.quantile(lengths, 0.95)}[statistic]
    for n in (30, 100):
        probabilities, outcomes = [], []
        for seed in range(300):
            errors = SD * rng.normal(size=(3, n))
            intervals = length_intervals(errors, (0.9, 0.95), bootstrap=500, seed=seed)
            curve = BoundCurve.through([by_name[statistic] for by_name in intervals])
            probabilities.append(curve.below(float(truth)))
            outcomes.append(decide(criterion(float(truth)), 1.0, curve, n)["outcome"])
        for level in (0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95):
            share = np.mean(np.array(probabilities, dtype=float) <= level)
            assert share == pytest.approx(level, abs=3.5 * math.sqrt(level * (1 - level) / 300) + 0.01)
        # False accepts and false rejects of rule bound at the limit itself: 5 % each.
        assert np.mean(np.array(outcomes) == "pass") < 0.05 + 0.045
        assert np.mean(np.array(outcomes) == "fail") < 0.05 + 0.045
