"""Intervals of ISO 9283's criteria: against exact distributions, and how often they hold the truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from robacc.iso_9283 import criteria as estimates
from robacc.iso_9283.criteria import DELTA, IntervalEstimate, distance, position_repeatability

TURN = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()


def test_mean_is_students() -> None:
    x = np.array([1.0, 2.0, 4.0, 4.5])
    interval = estimates.mean(x, 1.0).interval_at(0.9)
    low, high = stats.t.interval(0.9, 3, loc=x.mean() - 1.0, scale=x.std(ddof=1) / 2)
    assert (interval.lower, interval.upper) == pytest.approx((low, high), rel=1e-9)
    assert interval.upper_bound == pytest.approx(x.mean() - 1.0 + stats.t.ppf(0.9, 3) * x.std(ddof=1) / 2, rel=1e-9)


def test_threefold_standard_deviation_is_chi_square() -> None:
    x = np.array([1.0, 2.0, 4.0, 4.5])
    estimate = estimates.threefold_std(x)
    assert estimate.value == pytest.approx(3 * x.std(ddof=1))
    bounds = [3 * x.std(ddof=1) * math.sqrt(3 / stats.chi2.ppf(p, 3)) for p in (0.975, 0.025, 0.05)]
    interval = estimate.interval_at(0.95)
    assert [interval.lower, interval.upper, interval.upper_bound] == pytest.approx(bounds, rel=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_size_of_a_signed_number(sign: float) -> None:
    clear = estimates.magnitude(estimates.student(sign * 5.0, 1.0, 30)).interval_at(0.95)
    t = stats.t.ppf(0.975, 30)
    assert (clear.lower, clear.upper) == pytest.approx((5 - t, 5 + t))
    assert clear.upper_bound == pytest.approx(5 + stats.t.ppf(0.95, 30))
    across = estimates.magnitude(estimates.student(sign * 0.5, 1.0, 30)).interval_at(0.95)
    assert (across.lower, across.upper) == pytest.approx((0.0, 0.5 + t))


def test_distance_with_scatter_alike_in_all_directions_is_noncentral_chi_square() -> None:
    """The limits are the noncentralities under which the distance found has the tail's probability."""
    variance, value, dof = 0.04, 1.0, 10_000_000.0
    estimate = distance(np.array([0.6, 0.0, 0.8]), variance * np.eye(3), dof).interval_at(0.95)
    for limit, tail in ((estimate.lower, 0.975), (estimate.upper, 0.025), (estimate.upper_bound, 0.05)):
        assert limit is not None
        reached = stats.ncx2.cdf(value**2 / variance, 3, limit**2 / variance)
        assert reached == pytest.approx(tail, abs=1e-4)


def test_distance_far_from_zero_is_students_along_itself() -> None:
    covariance = TURN @ np.diag([1.0, 0.25, 0.04]) @ TURN.T
    difference = 100.0 * TURN[:, 1]
    estimate = distance(difference, covariance, 9).interval_at(0.95)
    assert (estimate.lower, estimate.upper) == pytest.approx(tuple(stats.t.interval(0.95, 9, loc=100.0, scale=0.5)))


def test_distance_that_is_all_scatter_may_be_zero() -> None:
    estimate = distance(np.array([0.01, 0.0, 0.0]), np.eye(3) * 0.01, 29).interval_at(0.95)
    assert estimate.lower == 0.0
    assert estimate.upper > 0.1
    none = distance(np.zeros(3), np.eye(3) * 0.01, 29).interval_at(0.95)
    assert (none.lower, none.upper) == (0.0, estimate.upper)


def test_repeatability_does_not_depend_on_unit_or_axes_and_repeats_with_its_seed() -> None:
    x = np.random.default_rng(3).normal(size=(3, 20)) * np.array([[1.0], [0.5], [0.2]])
    x -= x.mean(axis=1, keepdims=True)
    original, transformed = (position_repeatability(y, (1, 2)) for y in (x, 1e-3 * TURN @ x))
    assert transformed.value == pytest.approx(1e-3 * original.value)
    assert transformed.interval_at(0.95).upper == pytest.approx(1e-3 * (original.interval_at(0.95).upper or 0.0))
    assert position_repeatability(x, (1, 3)).interval_at(0.95) != original.interval_at(0.95)


def test_repeatability_of_many_visits_goes_over_into_the_delta_method() -> None:
    x = np.random.default_rng(3).normal(size=(3, 300))
    x -= x.mean(axis=1, keepdims=True)
    bootstrap = position_repeatability(x, (1,)).interval_at(0.95)
    twice = position_repeatability(np.hstack((x, x)), (1,)).interval_at(0.95)
    widths = [(interval.upper or 0.0) - (interval.lower or 0.0) for interval in (bootstrap, twice)]
    assert twice.method == DELTA
    assert widths[0] / widths[1] == pytest.approx(math.sqrt(2), rel=0.15)


def test_repeatability_of_two_visits_and_of_none_that_scatter() -> None:
    assert position_repeatability(np.array([[1.0, -1.0], [0, 0], [0, 0]]), (0,)).interval_at(0.95).upper is None
    still = position_repeatability(np.zeros((3, 5)), (0,))
    assert (still.value, still.interval_at(0.95).upper) == (0.0, 0.0)


def test_change_of_two_estimates_is_theirs_in_quadrature() -> None:
    after, before = estimates.student(5.0, 3.0, math.inf), estimates.student(1.0, 4.0, math.inf)
    estimate = estimates.change(after, before).interval_at(0.95)
    assert (estimate.lower, estimate.upper) == pytest.approx(
        tuple(stats.norm.interval(0.95, loc=4.0, scale=5.0)), rel=1e-6
    )
    assert estimate.upper_bound == pytest.approx(4.0 + 5.0 * stats.norm.ppf(0.95), rel=1e-6)
    missing = estimates.change(after, estimates.without_interval(1.0, "because")).interval_at(0.95)
    assert (missing.upper, missing.why) == (None, "because")


def test_largest_has_the_greatest_upper_limit_and_a_corrected_lower_one() -> None:
    three = [estimates.student(value, 1.0, math.inf) for value in (5.0, 4.9, -8.0)]
    best, figure = estimates.largest_figure([estimates.magnitude(estimate) for estimate in three], 0.95)
    assert (best, figure.value) == (2, 8.0)
    assert figure.interval.upper == pytest.approx(8.0 + stats.norm.ppf(0.975))
    assert figure.interval.lower == pytest.approx(8.0 - stats.norm.ppf(1 - 0.025 / 3))
    assert figure.interval.method.endswith("; largest of 3")


def visits(rng: np.random.Generator, scale: tuple[float, float, float], n: int, mean: np.ndarray) -> np.ndarray:
    return mean[:, None] + TURN @ (np.array(scale)[:, None] * rng.normal(size=(3, n)))


def coverage(distances: list[IntervalEstimate], truth: float) -> tuple[float, float]:
    intervals = [estimate.interval_at(0.95) for estimate in distances]
    # 1e-9: a truth of zero is held by a lower limit of zero.
    inside = np.mean([i.lower - 1e-9 <= truth <= i.upper for i in intervals])  # type: ignore[operator]
    return float(inside), float(np.mean([truth <= i.upper_bound for i in intervals]))  # type: ignore[operator]


@pytest.mark.slow
@pytest.mark.parametrize("away", [0.0, 2.0, 10.0, 100.0], ids=lambda away: f"{away:g} standard errors")
@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (1.0, 0.3, 0.1)], ids=["round", "long"])
def test_coverage_of_a_distance(scale: tuple[float, float, float], away: float) -> None:
    """AP: 95 % within the binomial scatter of 400 runs (± 2.2 %, two of it), or more where it is all scatter."""
    rng = np.random.default_rng(9283)
    truth = away * float(np.linalg.norm(scale)) / math.sqrt(30)
    mean = truth * TURN @ np.array([1.0, 2.0, 2.0]) / 3.0
    runs = [visits(rng, scale, 30, mean) for _ in range(400)]
    distances = [distance(x.mean(axis=1), np.cov(x) / 30, 29) for x in runs]
    interval_coverage, bound_coverage = coverage(distances, truth)
    assert interval_coverage > 0.925
    assert bound_coverage > 0.925
    assert interval_coverage < 0.975 or away < 5.0


@pytest.mark.slow
@pytest.mark.parametrize("n", [10, 30])
@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (1.0, 0.5, 0.2), (1.0, 0.05, 0.01)], ids=["round", "long", "line"])
def test_coverage_of_repeatability(scale: tuple[float, float, float], n: int) -> None:
    rng = np.random.default_rng(9283)
    length = np.linalg.norm(rng.normal(size=(2_000_000, 3)) * scale, axis=1)
    truth = float(length.mean() + 3 * length.std())
    repeatabilities = []
    for run in range(400):
        x = visits(rng, scale, n, np.zeros(3))
        repeatabilities.append(position_repeatability(x - x.mean(axis=1, keepdims=True), (run,)))
    interval_coverage, bound_coverage = coverage(repeatabilities, truth)
    assert 0.925 < interval_coverage < 0.995
    assert bound_coverage > 0.92
