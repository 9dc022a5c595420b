"""Statistics of errors, their assumptions, structure and gain, against numpy, scipy and independent computations."""

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest
from arms import arm
from scipy import stats

from robacc.accuracy.error_statistics import (
    assumption_tests,
    error_statistics,
    paired_gain,
)
from robacc.errors import InputError
from robacc.fitting.fit_result import HoldOut
from robacc.simulation.simulate import Plan, simulate
from robacc.statistics.intervals import Interval
from robacc.tracing.calibrating import registered_residuals

COVARIANCE = 1e-8 * np.array([[1.0, 0.3, 0.0], [0.3, 2.0, -0.5], [0.0, -0.5, 4.0]])


def gaussian(n: int, seed: int = 0) -> np.ndarray:
    return np.linalg.cholesky(COVARIANCE) @ np.random.default_rng(seed).standard_normal((3, n))


def test_sample_figures_against_numpy() -> None:
    errors = gaussian(50) + 5e-5
    result = error_statistics(errors, "m")
    lengths = np.linalg.norm(errors, axis=0)
    assert result.covariance == pytest.approx(np.mean([np.outer(d, d) for d in errors.T], axis=0))
    assert result.centred_covariance == pytest.approx(np.cov(errors, bias=True))
    assert result.mean == pytest.approx(errors.mean(axis=1))
    assert result.rms == pytest.approx(np.sqrt(np.mean(lengths**2)))
    assert result.mean_error == pytest.approx(lengths.mean())
    assert result.p95 == pytest.approx(np.percentile(lengths, 95))
    assert result.max == lengths.max()
    assert (result.n, result.n_poses, result.unit, result.confidence) == (50, 50, "m", 0.95)
    values = np.linalg.eigvalsh(result.covariance)[::-1]
    assert result.ellipsoid.sd == pytest.approx(np.sqrt(values))
    axes = result.ellipsoid.axes
    assert axes @ np.diag(values) @ axes.T == pytest.approx(result.covariance)


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


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 9, 10, 71])
@pytest.mark.parametrize("kind", AWKWARD)
@pytest.mark.parametrize("repeated", [False, True])
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


def test_confidence_widens_intervals() -> None:
    wide, narrow = (error_statistics(gaussian(40), "m", confidence=c).intervals.rms for c in (0.99, 0.8))
    assert wide.lower < narrow.lower < narrow.upper < wide.upper


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
    why = "4 poses, of which the fitted frames leave 1: too few for an interval"
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
    rng = np.random.default_rng(9)
    sizes = np.array([1, 2, 3, 5, 8, 2, 2, 7])
    groups = np.repeat(np.arange(8), sizes)
    draws = (rng.normal(0, 1, (3, 8))[:, groups] * 2 + rng.normal(0, 1, (3, groups.size)) for _ in range(600))
    samples = [error_statistics(errors, "m", groups=groups).structure for errors in draws]
    # Between 3 * 2^2, within 3 * 1^2; three standard errors of 600 means are some 0.8 and 0.1.
    assert np.mean([structure.between for structure in samples]) == pytest.approx(12.0, abs=0.8)
    assert np.mean([structure.within for structure in samples]) == pytest.approx(3.0, abs=0.1)


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
