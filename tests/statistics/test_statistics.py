"""Distributions, intervals, resamples and lengths of vectors against scipy, closed forms and draws."""

import subprocess
import sys
from collections.abc import Callable, Iterable
from itertools import product

import numpy as np
import pytest
from scipy import special, stats

from robacc.statistics import intervals as own
from robacc.statistics.intervals import (
    Interval,
    PoseSampling,
    chi2_interval,
    covariance_element,
    f_critical,
    interpolated,
    needed_noncentrality,
    noncentral_f_sf,
    percentile_levels,
    resampled_counts,
)
from robacc.statistics.lengths import (
    ScaledPercentileCurve,
    _cdf_and_density,
    length_probability,
    length_quantile,
    length_quantiles,
    mean_lengths,
    mixture_quantile,
    principal_variances,
)

PROBABILITIES = (1e-6, 0.001, 0.025, 0.05, 0.3, 0.5, 0.7, 0.95, 0.975, 0.999)
DEGREES = (1, 2, 3, 4.5, 10, 30, 57.3, 100, 999, 5e3, 1e5)


def grid(*parts: Iterable[float]) -> list[tuple[float, ...]]:
    return [*product(*parts)]


TINY = 1e-100
"""Below it the exponent itself, of some hundreds, has lost the digits."""
QUANTILES = tuple(stats.norm.ppf((1e-12, *PROBABILITIES)))
OF_CHI2 = [(stats.chi2.ppf(p, dof), dof) for p in PROBABILITIES for dof in DEGREES]


@pytest.mark.parametrize(
    ("function", "expected", "arguments", "tolerance"),
    [
        (own.normal_quantile, stats.norm.ppf, grid((1e-12, *PROBABILITIES)), (1e-12, 1e-14)),
        (own.normal_cdf, stats.norm.cdf, grid(QUANTILES), (1e-12, 0.0)),
        (own.chi2_quantile, stats.chi2.ppf, grid(PROBABILITIES, DEGREES), (1e-10, 0.0)),
        (own.chi2_cdf, stats.chi2.cdf, OF_CHI2, (1e-10, 0.0)),
        # The last are far in the tail.
        (own.chi2_sf, stats.chi2.sf, [*OF_CHI2, *((5 * dof + 50, dof) for dof in (1, 3, 10, 100))], (1e-10, 0.0)),
        (
            own.f_sf,
            stats.f.sf,
            grid((0.01, 0.5, 1.0, 2.7, 10.0, 100.0), (1, 2, 3), (1, 2, 5, 27, 97, 1000, 1e5, 1e6)),
            (1e-10, TINY),
        ),
        (
            lambda share, x, n: own.beta_cdf(x, share * n, n + 1 - share * n),
            lambda share, x, n: stats.beta.cdf(x, share * n, n + 1 - share * n),
            grid((0.5, 0.9, 0.95, 0.97, 1.0), (0.5, 0.9, 0.95, 0.99), (10, 59, 72, 500, 5000))
            + [(0.4, x, 5) for x in (0.0, 1.0)],
            (0.0, 1e-10),
        ),
        (
            own.student_quantile,
            stats.t.ppf,
            grid((0.025, 0.05, 0.5, 0.6, 0.95, 0.975, 0.9999), (1, 2, 3, 10, 57.3, 99, 1e4, 1e6)),
            (1e-10, 1e-12),
        ),
        (f_critical, stats.f.isf, grid((0.5, 0.01, 2.5e-5, 1e-9), (2.0,), (300.0,)), (1e-8, 0.0)),
    ],
)
def test_a_function_of_a_distribution_is_scipys(
    function: Callable[..., float],
    expected: Callable[..., float],
    arguments: Iterable[tuple[float, ...]],
    tolerance: tuple[float, float],
) -> None:
    relative, absolute = tolerance
    for each in arguments:
        assert function(*each) == pytest.approx(expected(*each), rel=relative, abs=absolute), each


def test_chi_square_of_millions_of_degrees_of_freedom() -> None:
    for p in (0.001, 0.025, 0.5, 0.975, 0.999):
        assert own.chi2_quantile(p, 3e6) == pytest.approx(stats.chi2.ppf(p, 3e6), rel=1e-12)
    # By the power series in 40 decimal digits. scipy 1.17 says 1.00000000e-06 here, and is 8e-5 off.
    assert own.chi2_cdf(2988370.9707552614, 3e6) == pytest.approx(1.000084083408535e-06, rel=1e-8)


def test_chi_square_and_f_of_nothing() -> None:
    assert (own.chi2_cdf(0.0, 3), own.chi2_sf(0.0, 3), own.f_sf(0.0, 3, 5)) == (0.0, 1.0, 1.0)


def test_statistics_load_nothing_heavy() -> None:
    """The reason for these functions: an estimate imports neither scipy, the YAML reader nor numpy.ma."""
    program = (
        "import sys, numpy as np\n"
        "from robacc.accuracy.error_statistics import error_statistics\n"
        "error_statistics(np.random.default_rng(0).normal(size=(3, 40)), 'm')\n"
        "sys.exit(any(name in sys.modules for name in ('scipy', 'yaml', 'numpy.ma')))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_a_large_noncentrality_neither_overflows_nor_vanishes() -> None:
    # F is then nearly normal about (dof1 + noncentrality) / dof1; Poisson weights begin at exp(-2500).
    assert noncentral_f_sf(2501.0, 2.0, 1e6, 5000.0) == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("power", [0.1, 0.5, 0.99])
def test_the_needed_noncentrality_gives_the_power(power: float) -> None:
    level, dof1, dof2 = 2.5e-5, 2.0, 300.0
    needed = needed_noncentrality(power, level, dof1, dof2)
    assert stats.ncf.sf(stats.f.isf(level, dof1, dof2), dof1, dof2, needed) == pytest.approx(power, abs=1e-7)


@pytest.mark.parametrize("dof2", [1.0, 2.0, 8.0, 100.0])
def test_beyond_the_summed_mixture_the_tail_is_that_of_draws(dof2: float) -> None:
    noncentrality = 3e4
    generator = np.random.default_rng(1)
    numerator = generator.noncentral_chisquare(2.0, noncentrality, 400_000) / 2.0
    ratios = numerator / (generator.chisquare(dof2, 400_000) / dof2)
    for x in np.quantile(ratios, (0.1, 0.5, 0.9)):
        share = float(np.mean(ratios > x))
        assert noncentral_f_sf(float(x), 2.0, dof2, noncentrality) == pytest.approx(share, abs=0.003)


def test_few_degrees_of_freedom_need_no_long_sum() -> None:
    """With one or two left, a small level needs noncentralities of 1e10: summed, this took hours."""
    for dof2 in (1.0, 2.0):
        needed = needed_noncentrality(0.5, 1e-8, 1.0, dof2)
        critical = f_critical(1e-8, 1.0, dof2)
        assert noncentral_f_sf(critical, 1.0, dof2, needed) == pytest.approx(0.5, abs=1e-6)


def test_chi_square_interval_is_the_textbook_one() -> None:
    interval = chi2_interval(4.0, 12.0, 0.9, "x")
    limits = interval.lower, interval.upper, interval.upper_bound, interval.root().upper ** 2
    assert limits == pytest.approx(48 / stats.chi2.ppf([0.95, 0.05, 0.1, 0.05], 12))


@pytest.mark.parametrize(
    ("n", "known"),
    [
        (1, (False,) * 3),
        (58, (True, False, False)),
        (59, (True, False, True)),
        (71, (True, False, True)),
        (72, (True,) * 3),
    ],
)
def test_percentile_levels_where_poses_are_few(n: int, known: tuple[bool, ...]) -> None:
    assert tuple(level is not None for level in percentile_levels(n, 0.95, 0.95)) == known


def test_covariance_of_proportional_variables_is_a_variance() -> None:
    """With perfect correlation the covariance is a multiple of the variance, and so is its interval."""
    interval = chi2_interval(2.0, 30.0, 0.95, "x")
    low, high = covariance_element(2.0, 18.0, 6.0, 30.0, 0.95)
    assert (low, high) == pytest.approx((3 * interval.lower, 3 * interval.upper))
    assert covariance_element(2.0, 18.0, -6.0, 30.0, 0.95) == pytest.approx((-high, -low))
    assert covariance_element(0.0, 18.0, 0.0, 30.0, 0.95) == (0.0, 0.0)


@pytest.mark.parametrize("n", [1, 2, 3, 20, 101])
def test_interpolated_is_numpys_quantile(n: int) -> None:
    values = np.random.default_rng(n).normal(size=n)
    levels = np.array([0.0, 0.03, 0.5, 0.95, 0.999, 1.0])
    assert interpolated(values, (levels * (n - 1)).tolist()) == pytest.approx(np.quantile(values, levels).tolist())
    weibull = np.quantile(values, levels, method="weibull")
    assert interpolated(values, (levels * (n + 1) - 1).tolist()) == pytest.approx(weibull.tolist())


@pytest.mark.parametrize("n", [72, 100, 999])
def test_percentile_levels_lie_between_the_binomial_ranks(n: int) -> None:
    for level, below in zip(percentile_levels(n, 0.95, 0.95), (0.975, 0.025, 0.05), strict=True):
        k = int(level * (n + 1) + 1e-9)
        # At whole ranks: the binomial probability that at least that many lie below the percentile.
        assert stats.binom.sf(k - 1, n, 0.95) >= below >= stats.binom.sf(k, n, 0.95)


def test_interpolation_for_the_median_is_that_of_hettmansperger_and_sheather() -> None:
    n = 23
    lower, _, _ = percentile_levels(n, 0.5, 0.95)
    rank = lower * (n + 1)
    r = int(rank)
    share = (stats.binom.sf(r - 1, n, 0.5) - 0.975) / stats.binom.pmf(r, n, 0.5)
    assert rank - r == pytest.approx((n - r) * share / (r + (n - 2 * r) * share))


def test_percentile_levels_of_many_poses_join_smoothly() -> None:
    for few, many in zip(percentile_levels(5000, 0.95, 0.95), percentile_levels(5001, 0.95, 0.95), strict=True):
        assert few == pytest.approx(many, abs=2e-4)


def mean_interval(sampling: PoseSampling, values: np.ndarray, confidence: float, *, positive: bool) -> Interval:
    groups = np.arange(values.size) if sampling.groups is None else sampling.groups
    deviations = np.bincount(groups, weights=values - values.mean())
    return sampling.interval(values.mean(), deviations, np.abs(values).max(), confidence, positive=positive)


@pytest.mark.parametrize("n", [3, 3000])
def test_mean_interval_of_very_few_and_of_many_poses_is_students(n: int) -> None:
    values = np.random.default_rng(0).normal(2.0, 1.0, n)
    interval = mean_interval(PoseSampling(n, None), values, 0.95, positive=False)
    expected = stats.t.interval(0.95, n - 1, values.mean(), stats.sem(values))
    assert (interval.lower, interval.upper) == pytest.approx(expected)
    assert interval.method == f"Student's t over {n} poses"


def test_repetitions_of_one_pose_bring_nothing_new() -> None:
    """Each pose written down four times over: the same interval as once."""
    values = np.random.default_rng(4).chisquare(3, 40)
    once = mean_interval(PoseSampling(40, None), values, 0.95, positive=True)
    groups = np.tile(np.arange(40), 4)
    repeated = mean_interval(PoseSampling(160, groups), np.tile(values, 4), 0.95, positive=True)
    assert (repeated.lower, repeated.upper) == pytest.approx((once.lower, once.upper))


def test_repeated_poses_standard_error_is_the_sandwich() -> None:
    rng = np.random.default_rng(5)
    groups = rng.integers(12, size=60)
    groups[:12] = np.arange(12)
    values = rng.normal(size=60)
    sums = [np.sum(values[groups == g] - values.mean()) for g in range(12)]
    expected = np.sqrt(12 / 11 * np.sum(np.square(sums))) / 60
    assert PoseSampling(60, groups).standard_error(values) == pytest.approx(expected)


def test_a_positive_quantity_keeps_positive_limits() -> None:
    interval = mean_interval(PoseSampling(3, None), np.array([0.0, 0.0, 1.0]), 0.95, positive=True)
    assert interval.lower >= 0.0


def test_an_interval_without_limits_has_none_of_its_root() -> None:
    alone = mean_interval(PoseSampling(4, np.zeros(4, dtype=np.int64)), np.arange(4.0), 0.95, positive=True)
    assert (alone.lower, alone.upper, alone.upper_bound, alone.root()) == (None, None, None, alone)


def test_each_resample_has_as_many_poses_as_the_sample_and_each_pose_once_on_average() -> None:
    counts = resampled_counts(20, 4000, 3)
    assert counts.shape == (4000, 20)
    assert np.all(counts.sum(axis=1) == 20)
    # Five standard errors of a mean of 4,000 binomial counts of variance 0.95.
    assert counts.mean(axis=0) == pytest.approx(np.ones(20), abs=5 * np.sqrt(0.95 / 4000))


SHAPES = np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0.1, 1e-3], [4e-8, 1e-8, 1e-12], [1, 1e-9, 1e-9]])[:, ::-1].T


def length_probabilities(radius: float, variances: np.ndarray) -> np.ndarray:
    """Return P(|Z| <= radius) ``(N,)`` for variances ``(3, N)``."""
    return _cdf_and_density(np.full(variances.shape[1], radius * radius), variances)[0]


@pytest.mark.parametrize("probability", [0.5, 0.95, 0.999])
def test_quantiles_agree_with_the_exact_integral(probability: float) -> None:
    quantiles = length_quantiles(probability, SHAPES)
    exact = [length_quantile(probability, np.zeros(3), v) for v in SHAPES.T]
    # What the path's twelve nodes are good for; in a far tail a probability of 1e-10 counts for more.
    np.testing.assert_allclose(quantiles, exact, rtol=1e-8)
    chi = [np.sqrt(stats.chi2.ppf(probability, k)) for k in (1, 2, 3)]
    np.testing.assert_allclose(quantiles[:3], chi, rtol=1e-8)


def test_no_scatter_has_no_length() -> None:
    variances = np.array([[0.0, 1.0], [0.0, 1.0], [0.0, 1.0]])
    assert (length_quantiles(0.95, variances)[0], mean_lengths(variances)[0]) == (0.0, 0.0)
    assert mixture_quantile(0.95, np.zeros((3, 4))) == 0.0
    # Half of the poses err not at all: 95 % of all is 90 % of the others.
    assert mixture_quantile(0.95, variances) == pytest.approx(np.sqrt(stats.chi2.ppf(0.9, 3)), rel=1e-8)


def test_mixture_quantile_solves_the_mixture() -> None:
    variances = np.random.default_rng(0).exponential(1e-8, (3, 6000)) + 1e-12
    radius = mixture_quantile(0.95, variances)
    subset = variances[:, ::100]
    exact = [length_probability(mixture_quantile(0.95, subset), np.zeros(3), v) for v in subset.T]
    assert np.mean(exact) == pytest.approx(0.95, abs=1e-9)
    assert np.mean(length_probabilities(radius, variances)) == pytest.approx(0.95, abs=1e-9)


def test_principal_variances_are_those_of_the_axes() -> None:
    rng = np.random.default_rng(2)
    axes = np.linalg.qr(rng.normal(size=(400, 3, 3)))[0]
    values = np.sort(rng.uniform(0.0, 1.0, (400, 3)) ** 6, axis=1)
    found = principal_variances(np.einsum("nij,nj,nkj->ikn", axes, values, axes))
    np.testing.assert_allclose(found, values.T, atol=1e-14)
    assert principal_variances(np.zeros((3, 3, 0))).shape == (3, 0)


def test_mean_length_is_an_elliptic_integral() -> None:
    variances = np.hstack((SHAPES, np.sort(10.0 ** np.random.default_rng(3).uniform(-14, 1, (3, 500)), axis=0)))
    exact = np.sqrt(8.0 / np.pi) * special.elliprg(*variances)
    np.testing.assert_allclose(mean_lengths(variances), exact, rtol=1e-13)
    assert mean_lengths(np.full((3, 1), 2.5))[0] == pytest.approx(2.0 * np.sqrt(5.0 / np.pi), rel=1e-14)
    assert mean_lengths(np.zeros((3, 0))).shape == (0,)


def test_principal_variances_are_never_negative() -> None:
    vector = np.array([1.0, 2.0, 3.0])
    values = principal_variances(np.outer(vector, vector)[:, :, None])
    assert np.all(values >= 0)
    assert values[2, 0] == pytest.approx(14.0)


ZERO = np.zeros(3)


@pytest.mark.parametrize("rank", [1, 2, 3])
@pytest.mark.parametrize("radius", [0.01, 0.1, 1.0, 2.0, 3.0, 6.0])
def test_equal_weights_are_a_chi_square(rank: int, radius: float) -> None:
    variance = np.where(np.arange(3) < rank, 1.0, 0.0)
    expected = stats.chi2.cdf(radius**2, rank)
    assert length_probability(radius, ZERO, variance) == pytest.approx(expected, abs=1e-13, rel=1e-9)


@pytest.mark.parametrize("noncentrality", [1e-3, 0.5, 5.0, 100.0, 1e4])
def test_equal_weights_with_a_mean_are_a_noncentral_chi_square(noncentrality: float) -> None:
    mean = np.full(3, np.sqrt(noncentrality / 3))
    for p in (1e-4, 0.01, 0.3, 0.5, 0.7, 0.95, 0.9999):
        x = stats.ncx2.ppf(p, 3, noncentrality)
        expected = stats.ncx2.cdf(x, 3, noncentrality)
        assert length_probability(np.sqrt(x), mean, np.ones(3)) == pytest.approx(expected, abs=1e-11)


def by_quadrature(radius: float, mean: np.ndarray, variance: np.ndarray) -> float:
    """The density integrated over the ball: Gauss and Legendre in two angles, the third axis in closed form."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    angle, weight = 0.5 * np.pi * nodes, 0.5 * np.pi * weights
    sd = np.sqrt(variance)
    first, disc = radius * np.sin(angle), radius * np.cos(angle)
    second, rest = disc[:, None] * np.sin(angle), disc[:, None] * np.cos(angle)
    third = stats.norm.cdf(rest, mean[2], sd[2]) - stats.norm.cdf(-rest, mean[2], sd[2])
    density = stats.norm.pdf(first, mean[0], sd[0])[:, None] * stats.norm.pdf(second, mean[1], sd[1]) * third
    return float(np.sum((weight * disc)[:, None] * weight * rest * density))


def test_agrees_with_quadrature_over_the_ball() -> None:
    rng = np.random.default_rng(5)
    for _ in range(25):
        mean = rng.normal(size=3) * rng.choice([0.0, 0.5, 2.0, 5.0])
        variance = 10 ** rng.uniform(-1, 1, 3)
        p = float(rng.choice([0.01, 0.5, 0.95, 0.999]))
        radius = length_quantile(p, mean, variance)
        # 200 nodes hold the reference to 1e-9 for these.
        assert by_quadrature(radius, mean, variance) == pytest.approx(p, abs=1e-9)
        assert length_probability(radius, mean, variance) == pytest.approx(p, abs=1e-13)


def test_a_mean_across_much_longer_axes() -> None:
    """Newton's steps are short near a singularity, which must not end the search for the saddle point."""
    mean, variance = np.array([-0.0937517, 0.03535186, 0.17628815]), np.array([0.86761577, 0.06954535, 0.02172223])
    for radius in np.sqrt([0.5, 1.2, 3.707832470433467, 9.0]):
        assert length_probability(radius, mean, variance) == pytest.approx(
            by_quadrature(radius, mean, variance), abs=1e-9
        )


def test_degenerate_covariances() -> None:
    assert length_quantile(0.95, ZERO, ZERO) == 0.0
    assert length_quantile(0.95, np.array([3.0, 0, 4.0]), ZERO) == 5.0
    normal = stats.norm.ppf(0.975)
    assert length_quantile(0.95, ZERO, np.array([4.0, 0, 0])) == pytest.approx(2 * normal, rel=1e-10)
    off_axis = np.array([0, 0, 3.0])
    assert length_quantile(0.95, off_axis, np.array([1.0, 0, 0])) == pytest.approx(np.hypot(3.0, normal), rel=1e-10)
    assert length_probability(2.9, off_axis, np.array([1.0, 0, 0])) == 0.0
    # Next to no scatter along the mean: one-sided in effect.
    thin = length_quantile(0.95, np.array([3.0, 0, 0]), np.array([1e-12, 0, 0]))
    assert thin - 3.0 == pytest.approx(1e-6 * stats.norm.ppf(0.95), rel=1e-6)


def test_a_known_shape_is_exact_at_whole_ranks() -> None:
    """With one axis the length is half-normal, and 21 lengths have their percentile at the rank 20 exactly."""
    shape = (np.zeros(3), np.array([1.0, 0.0, 0.0]))
    interval = ScaledPercentileCurve(1.7, 21, 0.95, *shape).interval(0.9, "m")
    quantile = stats.halfnorm.ppf(stats.beta.ppf([0.95, 0.05], 20, 2))
    expected = 1.7 * stats.halfnorm.ppf(0.95) / quantile
    np.testing.assert_allclose([interval.lower, interval.upper], expected, rtol=1e-5)


def test_the_promised_number_of_poses_suffices() -> None:
    shape = (np.zeros(3), np.ones(3))
    curve = ScaledPercentileCurve(1.0, 20, 0.95, *shape)
    needed = curve.poses_for(1.3, 0.95, 20)
    assert needed is not None
    assert curve.poses_for(0.9, 0.95, 20) is None
    rng = np.random.default_rng(2)
    true = curve.true
    percentiles = np.percentile(np.linalg.norm(rng.normal(size=(4000, needed, 3)), axis=2), 95.0, axis=1) / true
    ratio = ScaledPercentileCurve(1.0, needed, 0.95, *shape).interval(0.95, "m").upper_bound
    # Assured in nine of ten sets, 0.5 % of standard error.
    assert np.mean(percentiles * ratio <= 1.3) == pytest.approx(0.9, abs=0.03)


@pytest.mark.parametrize("n", [10, 20, 30, 47])
def test_between_two_ranks_the_interval_is_no_wider_than_needed(n: int) -> None:
    """A shape known exactly: the bound of 95 % holds in 95 % of 40,000 sets, 0.11 % of standard error."""
    shape = (np.zeros(3), np.ones(3))
    rng = np.random.default_rng(n)
    percentiles = np.percentile(np.linalg.norm(rng.normal(size=(40_000, n, 3)), axis=2), 95.0, axis=1)
    interval = ScaledPercentileCurve(1.0, n, 0.95, *shape).interval(0.95, "m")
    truth = length_quantile(0.95, *shape)
    inside = np.mean((percentiles * interval.lower <= truth) & (truth <= percentiles * interval.upper))
    assert inside == pytest.approx(0.95, abs=0.005)
    assert np.mean(truth <= percentiles * interval.upper_bound) == pytest.approx(0.95, abs=0.005)
