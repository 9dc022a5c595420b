"""Operating characteristic of each rule: how often it passes an arm, over how good the arm is. Run with ``-m slow -s``.

Simulated arms whose true RMS error is a multiple of the limit, each measured at 60 poses; beside the simulated share
the probability that a gate's own operating curve gives.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from robacc.accuracy.error_statistics import satterthwaite, second_moment
from robacc.gates import LEVELS, RULES, BoundCurve, Evaluation, GateCriterion, Rule, decide, decide_largest

LIMIT, POSES, ARMS = 1.0, 60, 1000
SD = np.array([1.0, 0.6, 0.3])[:, None] / math.sqrt(1.45)


def criterion(rule: Rule, key: str = "position.rms") -> GateCriterion:
    return GateCriterion("c", key, "length", LIMIT, (), False, rule, 0.95, 0.95, None, None, "r")


def measured(rng: np.random.Generator, truth: float) -> tuple[float, BoundCurve]:
    covariance = second_moment(truth * SD * rng.normal(size=(3, POSES)))
    curve = BoundCurve.through([satterthwaite(covariance, POSES, level).root() for level in LEVELS])
    return float(np.sqrt(np.trace(covariance))), curve


def outcomes(truth: float) -> dict[Rule, list[Evaluation]]:
    rng = np.random.default_rng(int(1000 * truth))
    arms = [measured(rng, truth) for _ in range(ARMS)]
    return {rule: [decide(criterion(rule), *arm, POSES) for arm in arms] for rule in RULES}


def predicted(decisions: list[Evaluation], truth: float) -> float:
    """Of the operating curve of a gate on an arm that is just at the limit."""
    curves = [np.array(one["operating_curve"]) for one in decisions[:50]]
    return float(np.mean([np.interp(truth, curve[:, 0], curve[:, 1]) for curve in curves]))


@pytest.mark.slow
def test_operating_characteristic_of_each_rule() -> None:
    truths = (0.7, 0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.3)
    at_limit = outcomes(1.0)
    print(f"\nShare that passes of {ARMS} arms at {POSES} poses, rms over its limit; in brackets the operating curve")
    print("true/limit" + "".join(f"{rule:>22}" for rule in RULES) + f"{'undecided (bound)':>20}")
    for truth in truths:
        found = outcomes(truth)
        row = ""
        for rule, decisions in found.items():
            share = float(np.mean([one["outcome"] == "pass" for one in decisions]))
            curve = predicted(at_limit[rule], truth)
            row += f"{share:>14.3f} ({curve:.3f})"
            # What the normal curve and its standard error, taken from a sample, leave of the exact distribution.
            assert share == pytest.approx(curve, abs=0.07)
        undecided = np.mean([one["outcome"] == "inconclusive" for one in found["bound"]])
        print(f"{truth:>10.2f}{row}{undecided:>20.3f}")
    for rule, most in (("bound", 0.05), ("guard_band", 0.05)):
        false_accepts = np.mean([one["outcome"] == "pass" for one in at_limit[rule]])  # type: ignore[index]
        assert false_accepts < most + 3 * math.sqrt(0.05 * 0.95 / ARMS)
    false_rejects = np.mean([one["outcome"] == "fail" for one in at_limit["guarded_rejection"]])
    assert false_rejects < 0.05 + 3 * math.sqrt(0.05 * 0.95 / ARMS)


@pytest.mark.slow
def test_operating_characteristic_of_a_largest_error() -> None:
    """Over the true share of poses within the limit: 59 poses pass one arm in twenty that holds 95 %."""
    rng = np.random.default_rng(0)
    asked = criterion("bound", "position.max")
    print(f"\nShare that passes of {ARMS * 10} arms at 59 poses, largest error, over the true share within the limit")
    for share in (0.9, 0.95, 0.98, 0.99, 0.999, 1.0):
        largest = rng.random((ARMS * 10, 59)).max(axis=1) > share
        passes = np.mean([decide_largest(asked, 2.0 if over else 0.5, 59)["outcome"] == "pass" for over in largest])
        curve = dict(decide_largest(asked, 0.5, 59)["operating_curve"])
        print(f"{share:>10.3f}{passes:>10.3f} ({share**59:.3f})")
        assert passes == pytest.approx(share**59, abs=0.016)
        assert curve.get(share, share**59) == pytest.approx(share**59)
