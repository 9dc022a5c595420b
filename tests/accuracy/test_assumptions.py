"""Hotelling's and Mardia's tests and the pose structure against independent computations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from robacc.accuracy.error_statistics import assumption_tests, pose_structure, principal_axes

FRAME = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]


def skewed(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return 1e-4 * FRAME @ (rng.gamma(3.0, size=(3, n)) * np.array([[1.0], [2.0], [3.0]]))


def test_hotelling_of_one_direction_is_students_t() -> None:
    line = np.random.default_rng(2).normal(0.3, 1.0, 25)
    test = assumption_tests(np.array([[1.0], [-2.0], [0.5]]) * line).zero_mean
    expected = stats.ttest_1samp(line, 0.0)
    assert test.dimension == 1
    assert test.statistic == pytest.approx(expected.statistic**2)
    assert test.p_value == pytest.approx(expected.pvalue, rel=1e-9)


def test_hotelling_by_its_definition() -> None:
    errors = skewed(40) - 2e-4
    test = assumption_tests(errors).zero_mean
    mean, covariance = errors.mean(axis=1), np.cov(errors)
    t_squared = 40 * mean @ np.linalg.solve(covariance, mean)
    assert test.statistic == pytest.approx(t_squared)
    assert test.p_value == pytest.approx(stats.f.sf(t_squared * 37 / (3 * 39), 3, 37), rel=1e-9)


def test_hotelling_of_flat_errors_is_that_of_their_plane() -> None:
    plane = np.random.default_rng(3).normal(0.2, 1.0, (2, 20))
    errors = FRAME[:, :2] @ plane
    mean = plane.mean(axis=1)
    test = assumption_tests(errors).zero_mean
    assert test.dimension == 2
    assert test.statistic == pytest.approx(20 * mean @ np.linalg.solve(np.cov(plane), mean))


def test_mardia_by_its_definition_over_all_pairs() -> None:
    n = 50
    errors = skewed(n)
    tests = assumption_tests(errors)
    centred = errors - errors.mean(axis=1)[:, None]
    products = centred.T @ np.linalg.inv(centred @ centred.T / n) @ centred
    b1, b2 = np.mean(products**3), np.mean(np.diag(products) ** 2)
    assert tests.skewness.statistic == pytest.approx(b1)
    assert tests.kurtosis.statistic == pytest.approx(b2)
    k = 4 * (n + 1) * (n + 3) / (n * ((n + 1) * 4 - 6))
    assert tests.skewness.p_value == pytest.approx(stats.chi2.sf(n * k * b1 / 6, 10), rel=1e-9)
    variance = 8 * 15 * (n - 3) * (n - 4) * (n - 2) / ((n + 1) ** 2 * (n + 3) * (n + 5))
    z = (b2 - 15 * (n - 1) / (n + 1)) / np.sqrt(variance)
    assert tests.kurtosis.p_value == pytest.approx(2 * stats.norm.sf(abs(z)), rel=1e-9)
    assert tests.skewness.p_value < 0.01


def test_mardia_over_several_blocks_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    errors = skewed(1000)
    whole = assumption_tests(errors)
    monkeypatch.setattr("robacc.accuracy.error_statistics.BLOCK", 7)
    assert assumption_tests(errors).skewness.statistic == pytest.approx(whole.skewness.statistic)
    assert assumption_tests(errors).kurtosis.statistic == pytest.approx(whole.kurtosis.statistic)


def test_mardias_moments_under_a_gaussian() -> None:
    """Mean and variance of the kurtosis, mean of the skewness: exact for Gaussian data, so simulation must agree."""
    n, sets = 12, 4000
    rng = np.random.default_rng(6)
    samples = [assumption_tests(rng.standard_normal((3, n))) for _ in range(sets)]
    kurtosis = np.array([tests.kurtosis.statistic for tests in samples])
    skewness = np.array([tests.skewness.statistic for tests in samples])
    expected_variance = 8 * 15 * (n - 3) * (n - 4) * (n - 2) / ((n + 1) ** 2 * (n + 3) * (n + 5))
    assert kurtosis.mean() == pytest.approx(15 * (n - 1) / (n + 1), abs=4 * kurtosis.std() / np.sqrt(sets))
    assert kurtosis.var() == pytest.approx(expected_variance, rel=0.12)
    expected_skewness = 3 * 5 / ((n + 1) * (n + 3)) * ((n + 1) * 4 - 6)
    assert skewness.mean() == pytest.approx(expected_skewness, abs=4 * skewness.std() / np.sqrt(sets))


@pytest.mark.parametrize(
    ("errors", "which", "why"),
    [
        (np.ones((3, 1)), "zero_mean", "one pose: too few for scatter in one direction"),
        (np.eye(3), "zero_mean", "3 poses: too few for scatter in 3 directions"),
        (np.zeros((3, 9)), "zero_mean", "every error is zero"),
        (np.ones((3, 9)), "zero_mean", "the errors do not scatter along every direction of their mean"),
        (np.eye(3), "skewness", "3 poses: too few to test the shape of the distribution"),
        (np.ones((3, 9)), "kurtosis", "the errors do not scatter"),
        (np.ones((3, 1)), "kurtosis", "one pose: too few to test the shape of the distribution"),
        (np.arange(3.0)[None] * np.ones((3, 1)), "kurtosis", "3 poses: too few to test the shape of the distribution"),
    ],
)
def test_a_test_without_a_result_has_a_reason(errors: np.ndarray, which: str, why: str) -> None:
    test = getattr(assumption_tests(errors), which)
    assert test.p_value is None
    assert test.why == why


def test_principal_axes() -> None:
    values, axes = principal_axes(FRAME @ np.diag([1.0, 9.0, 4.0]) @ FRAME.T)
    assert values == pytest.approx([9.0, 4.0, 1.0])
    assert np.abs(axes.T @ FRAME[:, [1, 2, 0]]) == pytest.approx(np.eye(3), abs=1e-12)
    assert all(axes[np.argmax(np.abs(axes[:, k])), k] > 0 for k in range(3))
    assert principal_axes(np.outer([1, 2, 2], [1, 2, 2]))[0].tolist() == pytest.approx([9.0, 0.0, 0.0])


def test_pose_structure_of_balanced_data_is_the_textbook_anova() -> None:
    rng = np.random.default_rng(8)
    between, within = rng.normal(0, 2e-4, (3, 15)), rng.normal(0, 1e-4, (3, 15, 4))
    errors = (between[:, :, None] + within).reshape(3, 60)
    structure = pose_structure(errors, np.repeat(np.arange(15), 4))
    table = errors.reshape(3, 15, 4)
    ms_within = table.var(axis=2, ddof=1).mean(axis=1).sum()
    ms_between = 4 * table.mean(axis=2).var(axis=1, ddof=1).sum()
    assert structure.within == pytest.approx(ms_within)
    assert structure.between == pytest.approx((ms_between - ms_within) / 4)
    correlation = (ms_between - ms_within) / (ms_between + 3 * ms_within)
    assert structure.intraclass_correlation == pytest.approx(correlation)
    assert structure.effective_poses == pytest.approx(60 / (1 + 3 * correlation))
    assert structure.text.startswith("60 rows of 15 commanded poses: ")
    assert "all poses share the parameter errors of one robot" in structure.text


def test_pose_structure_of_unequal_numbers_is_unbiased() -> None:
    rng = np.random.default_rng(9)
    sizes = np.array([1, 2, 3, 5, 8, 2, 2, 7])
    groups = np.repeat(np.arange(8), sizes)
    samples = [
        pose_structure(rng.normal(0, 1, (3, 8))[:, groups] * 2 + rng.normal(0, 1, (3, groups.size)), groups)
        for _ in range(600)
    ]
    # Between 3 * 2^2, within 3 * 1^2; three standard errors of 600 means are some 0.8 and 0.1.
    assert np.mean([structure.between for structure in samples]) == pytest.approx(12.0, abs=0.8)
    assert np.mean([structure.within for structure in samples]) == pytest.approx(3.0, abs=0.1)


def test_pose_structure_without_repetitions() -> None:
    errors = np.random.default_rng(0).normal(size=(3, 6))
    alone = pose_structure(errors, None)
    assert alone.why == "no commanded pose was repeated"
    assert "not independent draws" in alone.text
    one_pose = pose_structure(errors, np.zeros(6, dtype=np.int64))
    assert one_pose.why == "all rows are of one commanded pose"
    assert "repeatability" in one_pose.text
    still = pose_structure(np.ones((3, 6)), np.arange(6) // 2)
    assert (still.why, still.intraclass_correlation) == ("the errors do not scatter", None)
