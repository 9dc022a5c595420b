"""The interval of a percentile by the shape of a Gaussian: its coverage, by simulation, and its limits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from robacc.accuracy.error_statistics import error_statistics
from robacc.statistics.quadratic_form import LengthShape, ScaledPercentileCurve, length_quantile


@pytest.mark.parametrize(
    ("std", "mean"),
    [
        pytest.param((1.0, 1.0, 1.0), (0.0, 0.0, 0.0), marks=pytest.mark.slow),
        pytest.param((1.0, 0.5, 0.1), (0.0, 0.0, 0.0), marks=pytest.mark.slow),
        pytest.param((1.0, 0.5, 0.3), (2.0, 0.0, 0.0), marks=pytest.mark.slow),
    ],
)
def test_the_interval_has_its_confidence(std: tuple[float, ...], mean: tuple[float, ...]) -> None:
    """Simulated sets of 20 poses; the truth from a million draws."""
    rng = np.random.default_rng(5)
    draws = rng.normal(size=(3, 1_000_000)) * np.array(std)[:, None] + np.array(mean)[:, None]
    truth = float(np.quantile(np.linalg.norm(draws, axis=0), 0.95))
    inside, below_bound, used = 0, 0, 0
    for _ in range(300):
        errors = rng.normal(size=(3, 20)) * np.array(std)[:, None] + np.array(mean)[:, None]
        interval = error_statistics(errors, "m", bootstrap=100).intervals.p95
        if interval.upper is None or interval.upper_bound is None or interval.lower is None:
            continue  # a test rejected the Gaussian
        used += 1
        inside += interval.lower <= truth <= interval.upper
        below_bound += truth <= interval.upper_bound
    assert used > 280
    # 95 %, with 1.3 % of standard error from 300 sets.
    assert 0.91 < inside / used < 0.99
    assert 0.91 < below_bound / used < 0.99


def test_a_known_shape_is_exact_at_whole_ranks() -> None:
    """With one axis the length is half-normal, and 21 lengths have their percentile at the rank 20 exactly."""
    shape = LengthShape(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    curve = ScaledPercentileCurve.of(1.7, 21, 0.95, shape)
    interval = curve.interval(0.9, "m")
    quantile = stats.halfnorm.ppf(stats.beta.ppf([0.95, 0.05], 20, 2))
    expected = 1.7 * stats.halfnorm.ppf(0.95) / quantile
    np.testing.assert_allclose([interval.lower, interval.upper], expected, rtol=1e-5)


def test_the_promised_number_of_poses_suffices() -> None:
    shape = LengthShape(np.zeros(3), np.ones(3))
    curve = ScaledPercentileCurve.of(1.0, 20, 0.95, shape)
    needed = curve.poses_for(1.3, 0.95, 20)
    assert needed is not None
    assert curve.poses_for(0.9, 0.95, 20) is None
    rng = np.random.default_rng(2)
    true = curve.true
    percentiles = np.percentile(np.linalg.norm(rng.normal(size=(4000, needed, 3)), axis=2), 95.0, axis=1) / true
    ratio = ScaledPercentileCurve.of(1.0, needed, 0.95, shape).interval(0.95, "m").upper_bound
    # Assured in nine of ten sets, 0.5 % of standard error.
    assert np.mean(percentiles * ratio <= 1.3) == pytest.approx(0.9, abs=0.03)


@pytest.mark.parametrize("n", [10, 20, 30, 47])
def test_between_two_ranks_the_interval_is_no_wider_than_needed(n: int) -> None:
    """A shape known exactly: the bound of 95 % holds in 95 % of 40,000 sets, 0.11 % of standard error."""
    shape = LengthShape(np.zeros(3), np.ones(3))
    rng = np.random.default_rng(n)
    percentiles = np.percentile(np.linalg.norm(rng.normal(size=(40_000, n, 3)), axis=2), 95.0, axis=1)
    interval = ScaledPercentileCurve.of(1.0, n, 0.95, shape).interval(0.95, "m")
    truth = length_quantile(0.95, *shape)
    inside = np.mean((percentiles * interval.lower <= truth) & (truth <= percentiles * interval.upper))
    assert inside == pytest.approx(0.95, abs=0.005)
    assert np.mean(truth <= percentiles * interval.upper_bound) == pytest.approx(0.95, abs=0.005)
