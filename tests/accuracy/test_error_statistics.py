"""Statistics of errors and grades, against numpy, scipy and independent computations."""

import dataclasses
import math
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from arms import arm
from refusals import problems_of
from scipy import stats
from scipy.stats import chi2
from slow_parameters import some_fast

from robacc.accuracy.error_statistics import (
    ErrorStatistics,
    assumption_tests,
    error_statistics,
    paired_gain,
)
from robacc.accuracy.grade import Grade, GradeStep, Scale, default_scale, grade, load_scale
from robacc.errors import InputError, UsageError
from robacc.fitting.fit_result import HoldOut
from robacc.simulation.simulate import Plan, simulate
from robacc.statistics.intervals import ChiSquareCurve, Interval
from robacc.tracing.calibrating import registered_residuals

COVARIANCE = 1e-8 * np.array([[1.0, 0.3, 0.0], [0.3, 2.0, -0.5], [0.0, -0.5, 4.0]])


def gaussian(n: int, seed: int = 0) -> np.ndarray:
    return np.linalg.cholesky(COVARIANCE) @ np.random.default_rng(seed).standard_normal((3, n))


def test_intervals_of_gaussian_errors_are_the_chi_square_ones() -> None:
    errors = gaussian(40)
    result = error_statistics(errors, "m")
    assert "no test rejects it" in result.assumption
    covariance, centred = result.intervals.covariance, result.intervals.centred_covariance
    assert covariance.method == centred.method == "Wishart (chi-square)"
    for i in range(3):
        assert covariance.lower[i, i] == pytest.approx(np.sum(errors[i] ** 2) / stats.chi2.ppf(0.975, 40))
        assert covariance.upper[i, i] == pytest.approx(np.sum(errors[i] ** 2) / stats.chi2.ppf(0.025, 40))
        assert centred.upper[i, i] == pytest.approx(39 * np.var(errors[i], ddof=1) / stats.chi2.ppf(0.025, 39))
        expected = stats.t.interval(0.95, 39, errors[i].mean(), stats.sem(errors[i]))
        assert (result.intervals.mean[i].lower, result.intervals.mean[i].upper) == pytest.approx(expected)
    assert np.all(covariance.lower <= result.covariance)
    assert np.all(result.covariance <= covariance.upper)
    assert np.array_equal(covariance.lower, covariance.lower.T)


def test_radius_against_simulation() -> None:
    result = error_statistics(gaussian(60) + np.array([[2e-4], [1e-4], [0]]), "m")
    rng = np.random.default_rng(1)
    for radius, mean, covariance in (
        (result.radius95_zero_mean, np.zeros(3), result.covariance),
        (result.radius95_fitted_mean, result.mean, result.centred_covariance),
    ):
        draws = rng.multivariate_normal(mean, covariance, 400_000, method="cholesky")
        # Four standard errors of the simulated share.
        assert np.mean(np.linalg.norm(draws, axis=1) <= radius.value) == pytest.approx(0.95, abs=0.0014)
        assert radius.interval.lower < radius.value < radius.interval.upper


T2 = 1e-4 * np.random.default_rng(0).standard_t(2, size=(3, 100))


@pytest.mark.parametrize(
    ("errors", "rejection", "bootstrapped", "method", "of"),
    [
        (
            gaussian(60) + 2e-4,
            "their mean is not zero (Hotelling)",
            "covariance",
            "Wishart (chi-square)",
            "centred_covariance",
        ),
        (T2, "the errors are not Gaussian (Mardia)", "centred_covariance", "order statistics of 100 poses", "p95"),
    ],
)
def test_a_rejected_assumption_is_named_and_intervals_rest_on_resampling(
    errors: np.ndarray, rejection: str, bootstrapped: str, method: str, of: str
) -> None:
    result = error_statistics(errors, "m")
    assert rejection in result.assumption
    for name in ("rms", bootstrapped):
        assert "studentised bootstrap" in getattr(result.intervals, name).method
    assert getattr(result.intervals, of).method == method


@pytest.mark.parametrize("unit", ["m", "rad"])
def test_the_scale_of_errors_does_not_matter(unit: str) -> None:
    plain = error_statistics(gaussian(30), unit)
    scaled = error_statistics(gaussian(30) * 1e-6, unit)
    assert scaled.intervals.p95.upper == pytest.approx(1e-6 * plain.intervals.p95.upper)
    assert scaled.intervals.mean_error.lower == pytest.approx(1e-6 * plain.intervals.mean_error.lower)
    assert scaled.tests.skewness.p_value == pytest.approx(plain.tests.skewness.p_value)
    assert scaled.radius95_fitted_mean.value == pytest.approx(1e-6 * plain.radius95_fitted_mean.value)


def test_p95_by_poses() -> None:
    """A Gaussian's shape with few poses, order statistics with enough, and nothing where neither can be."""
    for errors in (gaussian(30), gaussian(30) + 3e-4):
        few = error_statistics(errors, "m")
        interval = few.intervals.p95
        assert interval.method.startswith("the sample's percentile and the shape of the fitted Gaussian")
        # The interval is that of the sample's percentile, so it is about it; no bound is moved to contain it.
        assert interval.lower < few.p95 < interval.upper
        assert interval.lower != few.p95
        for level, end in ((0.025, interval.lower), (0.975, interval.upper), (0.95, interval.upper_bound)):
            assert interval.curve.below(end) == pytest.approx(level, abs=1e-9)
    lengths = np.sort(np.linalg.norm(gaussian(100), axis=0))
    many = error_statistics(gaussian(100), "m").intervals.p95
    assert many.method == "order statistics of 100 poses"
    # At 100 poses the exact binomial interval has ranks 91 to 99 or 100.
    assert lengths[88] <= many.lower <= lengths[91]
    assert lengths[97] <= many.upper <= lengths[99]
    tailed = 1e-4 * np.random.default_rng(0).standard_t(1.5, size=(3, 65))
    between = error_statistics(tailed, "m").intervals.p95
    assert between.upper is None
    assert between.upper_bound is not None
    assert between.why == "65 poses: too few for an upper limit without assuming a distribution"
    assert error_statistics(gaussian(9), "m").intervals.p95.why == "9 poses: too few for a 95th percentile"


def test_the_maximum_has_a_statement_and_no_interval() -> None:
    value, interval = error_statistics(gaussian(100), "m").estimate("max")
    assert value == np.linalg.norm(gaussian(100), axis=0).max()
    assert interval.upper_bound is None
    assert interval.why == (
        "the largest error of all poses has no interval: with 95 % confidence, 97 % of poses are below the largest "
        "of these 100"
    )


def test_indistinguishable_axes_share_an_interval() -> None:
    rng = np.random.default_rng(2)
    equal = error_statistics(rng.standard_normal((3, 50)), "m").ellipsoid
    assert len({(interval.lower, interval.upper) for interval in equal.intervals}) == 1
    assert "3 axes that are not distinguishable on these poses" in equal.intervals[0].method
    distinct = error_statistics(np.array([[9.0], [3.0], [1.0]]) * rng.standard_normal((3, 50)), "m").ellipsoid
    assert len({interval.lower for interval in distinct.intervals}) == 3
    for sd, interval in zip(distinct.sd, distinct.intervals, strict=True):
        assert interval.lower < sd < interval.upper


def test_repeated_poses_count_once() -> None:
    once = gaussian(30)
    ids = np.array([f"p{i}" for i in range(30)])
    repeated = error_statistics(np.tile(once, 10), "m", groups=np.tile(ids, 10))
    alone = error_statistics(np.tile(once, 10), "m")
    single = error_statistics(once + 0.0, "m", groups=ids)
    assert (repeated.n, repeated.n_poses) == (300, 30)
    assert "commanded poses were repeated" in repeated.assumption
    assert repeated.structure.effective_poses == pytest.approx(30, rel=0.02)
    # As wide as thirty poses allow, where three hundred independent ones would give a third of that.
    assert width(repeated.intervals.rms) == pytest.approx(width(single.intervals.rms), rel=0.25)
    assert width(alone.intervals.rms) < 0.5 * width(repeated.intervals.rms)
    assert repeated.tests.zero_mean.p_value == pytest.approx(single.tests.zero_mean.p_value)
    assert single.structure.why == "no commanded pose was repeated"


def test_percentile_of_repeated_poses_is_of_the_poses() -> None:
    result = error_statistics(np.repeat(gaussian(80), 3, axis=1), "m", groups=np.repeat(np.arange(80), 3))
    assert result.intervals.p95.method == (
        "order statistics of 80 poses; all repetitions of a pose count as one, "
        "so the confidence is at least the stated one"
    )


def width(interval: Interval) -> float:
    return interval.upper - interval.lower


AWKWARD = {
    "gaussian": gaussian,
    "constant": lambda n: np.full((3, n), 1e-4),
    "zero": lambda n: np.zeros((3, n)),
    "collinear": lambda n: np.array([[1.0], [2.0], [3.0]]) * gaussian(n)[:1],
    "collinear beside zero": lambda n: np.array([[1.0], [2.0], [3.0]]) * gaussian(n)[:1] + np.array([[1e-3], [0], [0]]),
    "flat": lambda n: np.where(np.arange(3)[:, None] == 2, 0.0, gaussian(n)),
    "far off": lambda n: gaussian(n) + 1.0,
    "one wild": lambda n: gaussian(n) * np.where(np.arange(n) == 0, 1e4, 1.0),
    "tiny": lambda n: gaussian(n) * 1e-9,
}


def numbers(record: object) -> Iterator[float]:
    """Every float of a record, however deep."""
    if dataclasses.is_dataclass(record):
        for field in dataclasses.fields(record):
            yield from numbers(getattr(record, field.name))
    elif isinstance(record, tuple):
        for item in record:
            yield from numbers(item)
    elif isinstance(record, np.ndarray):
        yield from record.ravel().tolist()
    elif isinstance(record, float):
        yield record


@pytest.mark.parametrize(
    ("kind", "n", "repeated"), some_fast(product(AWKWARD, [1, 2, 3, 4, 5, 9, 10, 71], [False, True]), 3)
)
def test_awkward_errors_are_handled_and_said(kind: str, n: int, repeated: bool) -> None:
    """No warning (they are errors here), no NaN; what is missing has its reason."""
    errors = AWKWARD[kind](n)
    result = error_statistics(errors, "m", groups=np.arange(n) // 3 if repeated else None, bootstrap=200)
    assert all(np.isfinite(value) for value in numbers(result))
    stated = result.intervals
    intervals = [stated.rms, stated.mean_error, stated.p95, stated.covariance, stated.centred_covariance, *stated.mean]
    intervals += [result.radius95_zero_mean.interval, result.radius95_fitted_mean.interval, *result.ellipsoid.intervals]
    assert [interval for interval in intervals if interval.upper is None and not interval.why] == []
    assert result.rms == pytest.approx(np.sqrt(np.mean(np.sum(errors**2, axis=0))))


def test_one_pose() -> None:
    result = error_statistics(np.array([[3e-4], [0.0], [4e-4]]), "m")
    assert (result.rms, result.mean_error, result.p95, result.max) == pytest.approx((5e-4,) * 4)
    for interval in (result.intervals.rms, result.intervals.covariance, result.ellipsoid.intervals[0]):
        assert interval.why == "one commanded pose: no scatter between poses to estimate from"
    assert result.intervals.p95.why == "1 pose: too few for a 95th percentile"
    assert result.radius95_zero_mean.value is None
    assert result.radius95_zero_mean.why == "1 pose: scatter in three directions needs at least 3"
    assert result.assumption == "errors assumed Gaussian with zero mean; the poses are too few to test it"


def test_no_poses_have_no_statistics() -> None:
    with pytest.raises(InputError, match="there are no poses; statistics need at least one"):
        error_statistics(np.zeros((3, 0)), "m")


def test_fitted_parameters_count_as_poses() -> None:
    """Frames that leave 3 of 4 components leave the degrees of freedom of 30 of 40 poses."""
    errors = gaussian(40)
    free, fitted = error_statistics(errors, "m"), error_statistics(errors, "m", share=0.75)
    assert (free.n_independent, fitted.n_independent, fitted.n_poses) == (40, 30, 40)
    for before, after in zip(free.ellipsoid.intervals, fitted.ellipsoid.intervals, strict=True):
        assert after.lower < before.lower < before.upper < after.upper
    for name in ("rms", "mean_error", "p95"):
        before, after = getattr(free.intervals, name), getattr(fitted.intervals, name)
        assert after.lower < before.lower < before.upper < after.upper
        assert after.curve.below(after.upper_bound) == pytest.approx(0.95, abs=1e-3)
    upper = 0.75 * 40 * np.diag(fitted.covariance) / stats.chi2.ppf(0.025, 30)
    assert np.all(np.diag(fitted.intervals.covariance.upper) >= upper * (1 - 1e-12))
    assert fitted.share_below_max == pytest.approx(0.05 ** (1 / 30))
    few = error_statistics(gaussian(4), "m", share=0.25)
    why = "4 poses, of which the fit leaves 1: too few for an interval"
    assert few.intervals.rms.why == few.intervals.mean[0].why == few.intervals.covariance.why == why


FRAME = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]


def skewed(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return 1e-4 * FRAME @ (rng.gamma(3.0, size=(3, n)) * np.array([[1.0], [2.0], [3.0]]))


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_hotelling_within_the_directions_of_the_errors_by_its_definition(dimension: int) -> None:
    within = np.random.default_rng(3).gamma(3.0, 1e-4, (dimension, 40)) - 2e-4
    test, mean = assumption_tests(FRAME[:, :dimension] @ within).zero_mean, within.mean(axis=1)
    t_squared = 40 * mean @ np.linalg.solve(np.atleast_2d(np.cov(within)), mean)
    degrees = 40 - dimension
    p_value = stats.f.sf(t_squared * degrees / (dimension * 39), dimension, degrees)
    assert (test.dimension, test.statistic, test.p_value) == (
        dimension,
        pytest.approx(t_squared),
        pytest.approx(p_value),
    )
    if dimension == 1:
        assert test.p_value == pytest.approx(stats.ttest_1samp(within[0], 0.0).pvalue, rel=1e-9)


def test_mardia_by_its_definition_over_all_pairs() -> None:
    n = 50
    errors = skewed(n)
    tests = assumption_tests(errors)
    centred = errors - errors.mean(axis=1)[:, None]
    products = centred.T @ np.linalg.inv(centred @ centred.T / n) @ centred
    b1, b2 = np.mean(products**3), np.mean(np.diag(products) ** 2)
    assert (tests.skewness.statistic, tests.kurtosis.statistic) == (pytest.approx(b1), pytest.approx(b2))
    k = 4 * (n + 1) * (n + 3) / (n * ((n + 1) * 4 - 6))
    assert tests.skewness.p_value == pytest.approx(stats.chi2.sf(n * k * b1 / 6, 10), rel=1e-9)
    variance = 8 * 15 * (n - 3) * (n - 4) * (n - 2) / ((n + 1) ** 2 * (n + 3) * (n + 5))
    z = (b2 - 15 * (n - 1) / (n + 1)) / np.sqrt(variance)
    assert tests.kurtosis.p_value == pytest.approx(2 * stats.norm.sf(abs(z)), rel=1e-9)
    assert tests.skewness.p_value < 0.01


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


def test_pose_structure_of_balanced_data_is_the_textbook_anova() -> None:
    rng = np.random.default_rng(8)
    between, within = rng.normal(0, 2e-4, (3, 15)), rng.normal(0, 1e-4, (3, 15, 4))
    errors = (between[:, :, None] + within).reshape(3, 60)
    structure = error_statistics(errors, "m", groups=np.repeat(np.arange(15), 4)).structure
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
    """Against means of draws for the variances of Searle et al., and against these for the package."""
    rng, sizes = np.random.default_rng(9), np.array([1, 2, 3, 5, 8, 2, 2, 7])
    n, groups = sizes.sum(), np.repeat(np.arange(8), sizes)
    errors = rng.normal(0, 1, (600, 3, 8))[..., groups] * 2 + rng.normal(0, 1, (600, 3, n))
    sums = errors @ (groups[:, None] == np.arange(8))
    of_pose = np.sum(sums**2 / sizes, axis=(1, 2))
    within = (np.sum(errors**2, axis=(1, 2)) - of_pose) / (n - 8)
    ms_between = (of_pose - np.sum(errors.sum(axis=2) ** 2, axis=1) / n) / 7
    between = (ms_between - within) / ((n - np.sum(sizes**2) / n) / 7)
    # Between 3 * 2^2, within 3 * 1^2; three standard errors of 600 means are some 0.8 and 0.1.
    assert between.mean() == pytest.approx(12.0, abs=0.8)
    assert within.mean() == pytest.approx(3.0, abs=0.1)
    for i in range(5):
        structure = error_statistics(errors[i], "m", groups=groups, bootstrap=20).structure
        assert (structure.between, structure.within) == pytest.approx((between[i], within[i]))


def test_pose_structure_without_repetitions() -> None:
    errors = np.random.default_rng(0).normal(size=(3, 6))
    alone = error_statistics(errors, "m").structure
    assert alone.why == "no commanded pose was repeated"
    assert "not independent draws" in alone.text
    one_pose = error_statistics(errors, "m", groups=np.zeros(6, dtype=np.int64)).structure
    assert one_pose.why == "all rows are of one commanded pose"
    assert "repeatability" in one_pose.text
    still = error_statistics(np.ones((3, 6)), "m", groups=np.arange(6) // 2).structure
    assert (still.why, still.intraclass_correlation) == ("the errors do not scatter", None)


T = {3: 4.302652729911275, 5: 2.7764451051977987, 40: 2.0226909200367604}
"""Student's quantile of 0.975 with n - 1 degrees of freedom, from tables."""


def gain_per_pose(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """First-order influence of each pose on the fall of the RMS, ``(N,)``."""
    squares = [np.sum(residual[:3] ** 2, axis=0) for residual in (before, after)]
    rms = [np.sqrt(square.mean()) for square in squares]
    return squares[0] / (2 * rms[0]) - squares[1] / (2 * rms[1])


@pytest.mark.parametrize("n", [3, 5, 40])
def test_half_width_is_the_sample_standard_error(n: int) -> None:
    rng = np.random.default_rng(n)
    before, after = 1e-3 * rng.standard_normal((6, n)), 2e-4 * rng.standard_normal((6, n))
    gain = paired_gain(before, after, np.arange(n))
    standard_error = np.std(gain_per_pose(before, after), ddof=1) / np.sqrt(n)
    assert gain.value == pytest.approx(
        np.sqrt(np.mean(np.sum(before[:3] ** 2, axis=0))) - np.sqrt(np.mean(np.sum(after[:3] ** 2, axis=0)))
    )
    # Both are sums of the same n numbers: rounding only.
    assert gain.high - gain.value == pytest.approx(T[n] * standard_error, rel=1e-9)
    assert gain.value - gain.low == pytest.approx(T[n] * standard_error, rel=1e-9)


@pytest.mark.parametrize("numbers", [np.arange(8), 3 * np.arange(8)], ids=["all", "with gaps"])
def test_repeats_of_a_pose_count_once_and_absent_poses_not_at_all(numbers: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    before, after = 1e-3 * rng.standard_normal((3, 8)), 2e-4 * rng.standard_normal((3, 8))
    single = paired_gain(before, after, np.arange(8))
    repeated = paired_gain(np.repeat(before, 3, axis=1), np.repeat(after, 3, axis=1), np.repeat(numbers, 3))
    assert (repeated.value, repeated.low, repeated.high) == pytest.approx((single.value, single.low, single.high))


def test_two_poses_have_a_gain_without_interval() -> None:
    gain = paired_gain(np.full((3, 2), 1e-3), np.full((3, 2), 1e-4), np.arange(2))
    assert gain.value == pytest.approx(np.sqrt(3) * 9e-4)
    assert np.isnan(gain.low)
    assert np.isnan(gain.high)


def test_folds_that_cannot_be_fitted_do_not_undo_the_registration() -> None:
    robot = dataclasses.replace(arm("irb1600").robot, effects=())
    data = simulate(robot, Plan(6, seed=1, noise_position=1e-5, orientation=False)).data
    data = dataclasses.replace(data, position=data.position + np.array([[0.3], [-0.2], [0.1]]))
    rms = [
        float(
            np.sqrt(
                np.mean(np.sum(registered_residuals(robot, data, HoldOut.of(data, None, folds, 0))[0] ** 2, axis=0))
            )
        )
        for folds in (2, 6)
    ]
    assert rms[0] == pytest.approx(rms[1], rel=1e-6)
    assert rms[0] < 1e-3


CONFIGS = Path(__file__).resolve().parents[2] / "configs" / "grades"
SCALE = Scale(
    "test",
    "rms",
    0.95,
    (GradeStep("A", 1e-4, 1e-3), GradeStep("B", 2e-4, 2e-3), GradeStep("C", 5e-4, 5e-3)),
    "D",
)
GOOD = """\
robacc: 1
name: mine
statistic: rms
confidence: 0.9
units: {length: m, angle: rad}
steps:
  - {grade: A, position: 1e-4, orientation: 2e-3}
  - {grade: B, position: 3e-4}
otherwise: C
"""


def errors_of(value: float, bound: float | None, unit: str = "m", why: str | None = "few") -> ErrorStatistics:
    """Statistics whose RMS and its upper bound are as given, or why there is no bound."""
    result = error_statistics(np.random.default_rng(0).normal(size=(3, 30)), unit)
    interval = Interval(None, None, bound, 0.95, "given", why if bound is None else None)
    return result._replace(rms=value, intervals=result.intervals._replace(rms=interval))


def graded(
    value: float, bound: float | None, angle: float | None = None, angle_bound: float | None = None, why: str = "few"
) -> Grade:
    orientation = None if angle is None else errors_of(angle, angle_bound, "rad", why)
    return grade(errors_of(value, bound, why=why), orientation, SCALE)


@pytest.mark.parametrize(
    ("value", "letter"), [(0.0, "A"), (1e-4, "A"), (1.0001e-4, "B"), (2e-4, "B"), (5e-4, "C"), (5.1e-4, "D")]
)
def test_grade_by_the_estimate(value: float, letter: str) -> None:
    assert graded(value, value).grade == letter


@pytest.mark.parametrize(
    ("value", "bound", "demonstrated", "confirmed"),
    [
        (0.9e-4, 1e-4, True, "A"),
        (0.9e-4, 1.1e-4, False, "B"),
        (0.9e-4, 4e-4, False, "C"),
        (0.9e-4, 6e-4, False, None),
        (1.5e-4, 1.9e-4, True, "B"),
        (1.5e-4, None, False, None),
        (9e-4, 1e-3, False, None),
    ],
)
def test_confirmed_only_where_the_upper_bound_meets_the_limit(
    value: float, bound: float | None, demonstrated: bool, confirmed: str | None
) -> None:
    result = graded(value, bound)
    assert result.demonstrated is demonstrated
    assert result.demonstrated_grade == confirmed


def test_the_worse_of_position_and_orientation_decides() -> None:
    result = graded(0.5e-4, 0.9e-4, 3e-3, 6e-3)
    assert (result.grade, result.limited_by, result.demonstrated) == ("C", ("orientation",), False)
    assert (result.position.grade, result.position.demonstrated_grade, result.position.limit) == ("A", "A", 5e-4)
    assert (result.orientation.grade, result.orientation.demonstrated_grade) == ("C", None)
    assert [*result.next.values()] == ["B", 0.0, pytest.approx(1e-3)]
    assert graded(1.5e-4, 1.6e-4, 1.5e-3, 1.6e-3).limited_by == ("position", "orientation")


def test_the_best_grade_and_beyond_the_last_step() -> None:
    best = graded(0.5e-4, 0.9e-4, 0.5e-3, 0.6e-3)
    assert (best.grade, best.limited_by, best.next, best.demonstrated) == ("A", (), None, True)
    worst = graded(9e-4, 1e-3)
    assert (worst.grade, worst.demonstrated, worst.position.limit) == ("D", False, None)
    assert [*worst.next.values()][:2] == ["C", pytest.approx(4e-4)]


def test_reasons_in_words() -> None:
    assert graded(1.234e-4, 1.5e-4).reason == (
        "position: rms error 0.123 mm, within 0.2 mm. "
        "orientation was not measured, so the grade covers position only. "
        "limited by position: grade A needs 0.0234 mm less in position. "
        "confirmed at 95 % confidence: the upper bound is within the limit (position 0.15 mm)"
    )
    assert graded(0.9e-4, 1.5e-4, 0.5e-3, 0.6e-3).reason == (
        "position: rms error 0.09 mm, within 0.1 mm; orientation: rms error 0.0286°, within 0.0573°. "
        "not confirmed at 95 % confidence: the upper bound is beyond a limit (position 0.15 mm, orientation 0.0344°); "
        "grade B is confirmed"
    )
    # 0.1002 mm is not within 0.1 mm, and the text must not read as if it were.
    assert graded(1.002e-4, 1.5e-4).reason.startswith("position: rms error 0.1002 mm, within 0.2 mm. ")
    assert graded(1e-4, 1.5e-4).reason.startswith("position: rms error 0.1 mm, within 0.1 mm. ")
    assert graded(0.9e-4, 9e-4).reason.endswith("(position 0.9 mm); no grade is confirmed")
    assert graded(0.9e-4, None, why="one pose").reason.endswith(
        "not confirmed at 95 % confidence: position has no upper bound (one pose)"
    )
    assert "beyond the limit of C, 0.5 mm" in graded(9e-4, 1e-3).reason
    assert graded(9e-4, 1e-3).reason.endswith("no step of the scale is met, so no grade can be confirmed")


def test_confidence_must_agree() -> None:
    statistics = error_statistics(np.random.default_rng(0).normal(size=(3, 20)), "m", confidence=0.9)
    with pytest.raises(
        UsageError, match=r"the position statistics have a confidence of 0.9, but the scale test requires"
    ):
        grade(statistics, None, SCALE)


def test_default_scale_is_the_papers_requirement() -> None:
    scale = default_scale()
    assert (scale.statistic, scale.confidence, scale.otherwise) == ("p95", 0.95, "F")
    assert [step.grade for step in scale.steps] == ["A", "B", "C", "D", "E"]
    assert scale.steps[0].position == pytest.approx(1e-4)
    assert scale.steps[0].orientation == pytest.approx(math.radians(0.1))


def test_the_example_beside_the_package_is_the_packages_own() -> None:
    assert load_scale((CONFIGS / "default.yaml").read_text(encoding="utf-8"), "default.yaml") == default_scale()


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.name)
def test_every_example_scale_loads(path: Path) -> None:
    assert load_scale(path.read_text(encoding="utf-8"), path.name).steps


def test_a_free_orientation_limits_nothing() -> None:
    scale = load_scale(GOOD, "mine.yaml")._replace(confidence=0.95)
    result = grade(errors_of(2e-4, 2.5e-4), errors_of(0.5, None, "rad", "few"), scale)
    assert (result.grade, result.demonstrated, result.demonstrated_grade) == ("B", True, "B")
    assert result.orientation.limit is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("robacc: 1", "robacc: 2", "s.yaml:1, robacc: expected 1, found '2'"),
        ("name: mine\n", "", "s.yaml:1, name: is missing"),
        ("name: mine", "name:", "s.yaml:2, name: is missing"),
        ("name: mine", "name: [a]", "s.yaml:2, name: expected a name, found a list of 1"),
        (
            "statistic: rms",
            "statistic: p99",
            "s.yaml:3, statistic: expected rms or mean_error or p95 or max, found 'p99'; did you mean 'p95'?",
        ),
        ("0.9", "95", "s.yaml:4, confidence: found 95, expected at least 0.5 and less than 1"),
        ("0.9", "high", "s.yaml:4, confidence: expected a number, found 'high'"),
        (
            "units: {length: m, angle: rad}\n",
            "",
            "s.yaml:1, units: is missing; add it, for example units: {length: mm, angle: deg}",
        ),
        ("length: m,", "length: inch,", "s.yaml:5, units.length: expected m or mm or um, found 'inch'"),
        (", angle: rad", "", "s.yaml:5, units.angle: is missing"),
        ("position: 3e-4", "position: -3e-4", "s.yaml:8, steps[1].position: found -0.0003, expected a number greater"),
        ("position: 3e-4", "position: .inf", "s.yaml:8, steps[1].position: expected a finite number, found .inf"),
        ("position: 3e-4", "postion: 3e-4", "s.yaml:8, steps[1].postion: unknown key; did you mean 'position'?"),
        (
            "position: 3e-4",
            "position: 1e-4",
            "s.yaml:8, steps[1].position: the limit is not wider than that of grade A",
        ),
        ("{grade: B,", "{grade: A,", "s.yaml:8, steps[1].grade: the grade 'A' is listed twice"),
        ("{grade: B,", "{", "s.yaml:8, steps[1].grade: is missing"),
        (
            "3e-4}",
            "3e-4, orientation: 1e-3}",
            "s.yaml:8, steps[1].orientation: the limit is narrower than that of grade A",
        ),
        (", orientation: 2e-3}", "}", None),
        ("otherwise: C", "otherwise: A", "s.yaml:9, otherwise: 'A' is also the grade of a step; choose another name"),
        (
            "otherwise: C",
            "otherwise: C\nname: twice",
            "s.yaml:10, name: is given twice, first in line 2",
        ),
        (
            "otherwise: C",
            "otherwise: C\nxyzzy: 1",
            "s.yaml:10, xyzzy: unknown key; known keys: robacc, name",
        ),
        (
            "  - {grade: B, position: 3e-4}",
            "  - B",
            "s.yaml:8, steps[1]: expected keys with values (grade, position, orientation), found 'B'",
        ),
        ("name: mine", "name: [", "s.yaml:4: cannot be read as YAML: "),
        ("name: mine", "name: \x07", "s.yaml:2: cannot be read as YAML: "),
    ],
)
def test_every_message_of_a_scale(old: str, new: str, message: str | None) -> None:
    assert old in GOOD
    text = GOOD.replace(old, new, 1)
    if message is None:
        assert load_scale(text, "s.yaml").steps[0].orientation is None
    else:
        problems = problems_of(load_scale, text, "s.yaml")
        assert any(problem.startswith(message) for problem in problems), problems


HEAD, TAIL = GOOD.split("steps:")[0], "\notherwise" + GOOD.split("otherwise")[1]


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        (
            GOOD.replace(", orientation: 2e-3}", "}").replace("3e-4}", "3e-4, orientation: 1e-3}"),
            ["s.yaml:8, steps[1].orientation: the better grade A has no limit of orientation"],
        ),
        ("- a\n", ["s.yaml:1: expected keys with values (robacc, name, statistic"]),
        ("", ["s.yaml: the file is empty"]),
        ("# nothing\n", ["s.yaml: the file is empty"]),
        # Read as carefully as a robot file; libyaml ends the process here, without a word.
        ("[" * 200_000, ["s.yaml:1: cannot be read as YAML: nested deeper than 32"]),
        (
            GOOD.replace("3e-4", "&a 3e-4"),
            ["s.yaml:8: cannot be read as YAML: anchors (&) and aliases (*) are not supported"],
        ),
        (GOOD.replace("3e-4", "3_00"), ["s.yaml:8, steps[1].position: expected a number, found '3_00'"]),
        (GOOD.replace("mine", '"\\e[2J"'), ["s.yaml:2, name: expected a name, found "]),
        (f"{HEAD}steps: []{TAIL}", ["s.yaml:6, steps: a scale needs at least one step"]),
        (f"{HEAD}steps: A{TAIL}", ["s.yaml:6, steps: expected a list of steps, found 'A'"]),
        (f"{HEAD}{TAIL}", ["s.yaml:1, steps: is missing"]),
        (
            GOOD.replace("statistic: rms", "statistic: p99").replace("position: 3e-4", "position: x"),
            ["s.yaml:3, statistic: expected rms", "s.yaml:8, steps[1].position: expected a number, found 'x'"],
        ),
    ],
    ids=range(12),
)
def test_every_problem_of_a_whole_scale(text: str, messages: list[str]) -> None:
    found = problems_of(load_scale, text, "s.yaml")
    assert [part[: len(message)] for part, message in zip(found, messages, strict=True)] == messages


def test_probability_is_the_confidence_between_the_limits() -> None:
    """Of Gaussian errors of zero mean along one axis: the RMS's chi-square, read by scipy."""
    errors = np.zeros((3, 40))
    errors[0] = 1.9e-4 * np.random.default_rng(3).standard_normal(40)
    statistics = error_statistics(errors, "m")
    result = grade(statistics, None, SCALE)
    dof = 40.0
    within = [chi2.sf(dof * (statistics.rms / step.position) ** 2, dof) for step in SCALE.steps]
    shares = dict(result.probabilities)
    assert [*shares] == ["A", "B", "C", "D"]
    # Satterthwaite's degrees of freedom are estimated, and are 40 to within rounding where there is one direction.
    assert [shares["A"], shares["B"], shares["C"], shares["D"]] == pytest.approx(
        [within[0], within[1] - within[0], within[2] - within[1], 1.0 - within[2]], abs=1e-9
    )
    assert result.probability == shares[result.grade]
    assert result.probability_within(2) == pytest.approx(within[2])


@pytest.mark.parametrize(
    ("n", "kind", "statistic"),
    some_fast(product([15, 40, 200], ["gauss", "mean", "repeated", "uniform"], ["rms", "mean_error", "p95"]), 2),
)
def test_a_confirmed_grade_has_the_scales_confidence(statistic: str, n: int, kind: str) -> None:
    """The curve at the one-sided bound is the bound's confidence, whatever the method; to 2000 draws' own step."""
    rng = np.random.default_rng(n)
    vectors = {
        "gauss": rng.standard_normal((3, n)),
        "mean": rng.standard_normal((3, n)) + 2.0,
        "repeated": np.repeat(rng.standard_normal((3, n)), 3, axis=1) + 1e-3 * rng.standard_normal((3, 3 * n)),
        "uniform": rng.uniform(-1.0, 1.0, (3, n)) ** 5,
    }[kind]
    groups = np.repeat(np.arange(n), 3) if kind == "repeated" else None
    for confidence in (0.8, 0.95):
        interval = error_statistics(1e-4 * vectors, "m", groups=groups, confidence=confidence).estimate(statistic)[1]
        if interval.upper_bound is None:
            continue
        assert interval.curve.below(interval.upper_bound) == pytest.approx(confidence, abs=2e-3)
        assert interval.curve.below(interval.lower) == pytest.approx(0.5 - 0.5 * confidence, abs=2e-3)
        values = [interval.curve.below(x * interval.upper_bound) for x in np.linspace(0.0, 3.0, 61)]
        assert values == sorted(values)
        assert 0.0 <= values[0] < 0.01
        assert values[-1] <= 1.0


def test_one_pose_gives_a_grade_of_unknown_probability_and_confirms_nothing() -> None:
    result = grade(error_statistics(np.full((3, 1), 1e-5), "m"), None, default_scale())
    assert (result.grade, result.demonstrated, result.demonstrated_grade) == ("A", False, None)
    assert result.position.interval.why == "1 pose: too few for a 95th percentile"
    assert "1 pose: too few for a 95th percentile" in result.reason
    assert (result.probability, result.probabilities, result.poses_to_demonstrate) == (None, (), None)


def test_errors_that_do_not_scatter_have_a_grade_for_certain() -> None:
    still = grade(error_statistics(np.full((3, 20), 1e-5), "m"), None, SCALE)
    assert (still.probability, still.demonstrated) == (1.0, True)


def errors_like(n: int, size: float = 1e-4, seed: int = 0) -> np.ndarray:
    return size / math.sqrt(3.0) * np.random.default_rng(seed).standard_normal((3, n))


def test_position_and_orientation_together() -> None:
    position, orientation = error_statistics(errors_like(30), "m"), error_statistics(errors_like(30, 1e-3, 1), "rad")
    combined, by_position, by_orientation = (
        grade(position, orientation, SCALE),
        grade(position, None, SCALE),
        grade(error_statistics(errors_like(500, 1e-6), "m"), orientation, SCALE),
    )
    first, second, joint = (result.probability_within(0) for result in (by_position, by_orientation, combined))
    assert joint == pytest.approx(first * second, rel=1e-6)


@pytest.mark.parametrize("share", [0.7, 0.9])
def test_number_of_poses_for_a_variance_is_the_fewest(share: float) -> None:
    """Chi-square: the bound meets the limit with probability 0.9 at the number given, and with less at one fewer."""
    curve, limit = ChiSquareCurve(1.0, 50.0), 1.0 / share
    poses = curve.poses_for(limit, 0.95, 50)

    def chance(n: int) -> float:
        return float(chi2.cdf(chi2.ppf(0.05, n) * limit, n))

    assert chance(poses) >= 0.9 > chance(poses - 1)
    assert curve.poses_for(1.0, 0.95, 50) is None
    assert curve.poses_for(1.0 + 1e-6, 0.95, 50) is None
