"""Statistics of Cartesian errors: Wu and Lee's covariances (13), (14), with intervals and tests of assumptions.

Equation (13) assumes that the errors are independent draws from a Gaussian with zero mean. Where the data do not
contradict it (Hotelling's and Mardia's tests at 1 %), intervals are chi-square intervals. Where they do, or where
commanded poses were repeated, intervals come from resampling poses. Each interval names its method.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from robacc.accuracy.error_sums import LENGTH, PAIRS, ErrorSums, features, weights
from robacc.errors import InputError, applying, refuse
from robacc.geometry import Array, NDArray, vector_lengths
from robacc.statistics.intervals import (
    FEWEST,
    EstimateOrReason,
    Interval,
    PercentileCurve,
    PoseSampling,
    chi2_interval,
    chi2_sf,
    covariance_element,
    f_sf,
    interpolated,
    normal_cdf,
    percentile_levels,
    quantiles,
    student_interval,
    student_quantile,
)
from robacc.statistics.lengths import ScaledPercentileCurve, length_quantile, squared_quantile_gradient

Unit = Literal["m", "rad"]
Statistic = Literal["rms", "mean_error", "p95", "max"]
Shape = tuple[Array, Array] | None
"""Mean and variances ``(3,)`` along principal axes of the Gaussian that the lengths' distribution comes from."""


# Second moments and principal axes of errors ``(3, N)``; tests of equation (13), which assumes Gaussian errors of
# zero mean.

_SQUARES = np.array([[4, 5, 6], [5, 7, 8], [6, 8, 9]])
"""Places of e e^T in z."""
NIL = 1e-12
"""Eigenvalues below this fraction of the largest are rounding: the axis is a million times thinner than the longest."""


class AssumptionTest(NamedTuple):
    """Result of a statistical test; statistic and p-value are None where ``why`` gives the reason."""

    method: str
    statistic: float | None
    p_value: float | None
    dimension: int
    """Number of directions in which the errors scatter: 3 unless they are coplanar or collinear."""
    why: str | None = None


class AssumptionTests(NamedTuple):
    """Tests of the assumptions of a zero-mean Gaussian."""

    zero_mean: AssumptionTest
    skewness: AssumptionTest
    kurtosis: AssumptionTest


def principal_axes(matrix: Array) -> tuple[Array, Array]:
    """Return eigenvalues ``(3,)``, descending and not negative, and unit eigenvectors ``(3, 3)`` as columns.

    The largest component of each axis is positive, so that every machine gives the same axes.
    """
    values, vectors = np.linalg.eigh(matrix)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    signs = np.sign(vectors[np.argmax(np.abs(vectors), axis=0), np.arange(3)])
    return np.where(values > NIL * values[0], values, 0.0), vectors * signs


def assumption_tests(errors: Array) -> AssumptionTests:
    """Apply Hotelling's and Mardia's tests to independent errors ``(3, N)``."""
    mean = np.mean(errors, axis=1)
    z = features(errors - mean[:, None], np.zeros(errors.shape[1]))
    return tests_of_sums(z @ z.T, mean, mean)


def tests_of_sums(products: Array, origin: Array, mean: Array) -> AssumptionTests:
    """Return the tests of :func:`assumption_tests` from the sum of z z^T; see :mod:`robacc.accuracy.error_sums`."""
    n = round(float(products[0, 0]))
    moments = products / n
    centred = _second(moments[0], origin - mean)
    about_zero, _ = principal_axes(centred + np.outer(mean, mean))
    values, axes = principal_axes(centred)
    scatter = int(np.count_nonzero(values > NIL * about_zero[0]))
    values, axes = values[:scatter], axes[:, :scatter]
    hotelling = _hotelling(mean, values, axes, int(np.count_nonzero(about_zero)), n)
    # Mean of the products of two linear combinations of z.
    scaled = (axes / np.sqrt(values)).T
    first = np.array([weights(origin, mean, linear=row) for row in scaled]).reshape(scatter, 11)
    pairs = [weights(origin, mean, quadratic=0.5 * (np.outer(a, b) + np.outer(b, a))) for a in scaled for b in scaled]
    # b1, the mean of (y_i . y_j)^3 over all pairs of scaled errors, is the squared norm of the mean of y (x) y (x) y.
    third = first @ moments @ np.array(pairs).reshape(scatter * scatter, 11).T
    square = weights(origin, mean, quadratic=scaled.T @ scaled)
    return AssumptionTests(
        hotelling, *_mardia(n, scatter, float(np.sum(np.square(third))), float(square @ moments @ square))
    )


def _second(means: Array, shift: Array) -> Array:
    """Return the mean of f f^T ``(3, 3)``, f = e + ``shift``, from the means of z."""
    across = np.outer(means[1:4], shift)
    return np.asarray(means[_SQUARES] + across + across.T + np.outer(shift, shift))


def _hotelling(mean: Array, values: Array, axes: Array, rank: int, n: int) -> AssumptionTest:
    """Test the mean by T^2 = n m' S^-1 m, S with divisor n - 1 (Hotelling 1931).

    (n - p) / (p (n - 1)) T^2 ~ F(p, n - p).
    """
    p, directions = values.size, "one direction" if rank == 1 else f"{rank or 3} directions"
    obstacles = applying(
        (n <= rank or n < 2, f"{_poses(n)}: too few for scatter in {directions}"),
        (p < rank, "the errors do not scatter along every direction of their mean"),
        (rank == 0, "every error is zero"),
    )
    name = "Hotelling's T-squared: the mean is zero"
    if obstacles:
        return AssumptionTest(name, None, None, p, obstacles[0])
    statistic = (n - 1) * float(np.sum(np.square(axes.T @ mean) / values))
    return AssumptionTest(name, statistic, f_sf((n - p) / (p * (n - 1)) * statistic, p, n - p), p)


def _mardia(n: int, p: int, b1: float, b2: float) -> tuple[AssumptionTest, AssumptionTest]:
    """Test by Mardia's b1 and b2, with his small-sample corrections.

    Sources: K. V. Mardia, "Measures of multivariate skewness and kurtosis with applications", Biometrika 57 (1970);
    "Applications of some measures of multivariate skewness and kurtosis in testing normality and robustness studies",
    Sankhya B 36 (1974): exact mean of b1 and exact mean and variance of b2 for Gaussian data.
    """
    too_few = f"{_poses(n)}: too few to test the shape of the distribution"
    reasons: list[str | None] = ["the errors do not scatter" if p == 0 and n > 1 else too_few] * 2
    skewness = p_skewness = kurtosis = p_kurtosis = None
    if p > 0 and n >= p + 2:
        reasons, skewness = [None, too_few], b1
        correction = (p + 1) * (n + 1) * (n + 3) / (n * ((n + 1) * (p + 1) - 6))
        p_skewness = chi2_sf(n * correction * skewness / 6.0, p * (p + 1) * (p + 2) / 6)
        variance = 8 * p * (p + 2) * (n - 3) / (n + 1) ** 2 * (n - p - 1) / (n + 3) * (n - p + 1) / (n + 5)
        if variance > 0.0:
            expected, kurtosis, reasons = p * (p + 2) * (n - 1) / (n + 1), b2, [None, None]
            p_kurtosis = 2.0 * normal_cdf(-abs(kurtosis - expected) / math.sqrt(variance))
    return (
        AssumptionTest("Mardia's skewness: the errors are Gaussian", skewness, p_skewness, p, reasons[0]),
        AssumptionTest("Mardia's kurtosis: the errors are Gaussian", kurtosis, p_kurtosis, p, reasons[1]),
    )


def _poses(n: int) -> str:
    return "one pose" if n == 1 else f"{n} poses"


# Variance between and within commanded poses: the dependence of errors that equation (13) ignores.
#
# Wu and Lee's equation (13) sums over errors as if they were independent draws. Errors of one robot come from one set
# of parameter errors, so they vary with the pose and not at random; only repetitions of a pose show the random part.

IN_PARTS = "commanded poses were repeated in a file that is read in parts"
SHARED = (
    "all poses share the parameter errors of one robot, so they are not independent draws: the intervals hold for "
    "other poses of this robot, chosen in the same manner, not for other robots"
)


class PoseStructure(NamedTuple):
    """Components of the errors' variance (sum over x, y, z) between and within commanded poses."""

    between: float | None
    """Variance over poses of a commanded pose's mean error, m^2 or rad^2."""
    within: float | None
    """Variance of one repetition about the mean error of its pose."""
    intraclass_correlation: float | None
    """between / (between + within)"""
    effective_poses: float | None
    """Independent poses with the same uncertainty of the mean: n / (1 + (k - 1) ICC), n errors, k of a pose."""
    text: str
    why: str | None = None


# Statistics of errors, and their intervals.


class MatrixInterval(NamedTuple):
    """Confidence intervals of a covariance matrix, element by element (not for all elements at once)."""

    lower: Array | None
    upper: Array | None
    """``(3, 3)`` each, m^2 or rad^2"""
    confidence: float
    method: str
    why: str | None = None


class Ellipsoid(NamedTuple):
    """Principal axes of the covariance about zero, longest first."""

    axes: Array
    """``(3, 3)``, unit vectors as columns, in the frame of the errors"""
    sd: Array
    """``(3,)`` principal standard deviations, m or rad"""
    intervals: tuple[Interval, ...]


class Intervals(NamedTuple):
    """Intervals of the numbers of the same name in :class:`ErrorStatistics`."""

    mean: tuple[Interval, ...]
    covariance: MatrixInterval
    centred_covariance: MatrixInterval
    rms: Interval
    mean_error: Interval
    p95: Interval


class ErrorStatistics(NamedTuple):
    """Statistics of N position or orientation errors, in m and m^2 or rad and rad^2."""

    unit: Unit
    n: int
    n_poses: int
    """Commanded poses: fewer than ``n`` where some were repeated."""
    n_independent: float
    """Poses that intervals count: commanded poses less the share of the frames that were fitted to them."""
    confidence: float
    mean: Array
    """``(3,)``"""
    covariance: Array
    """``(3, 3)`` maximum likelihood about zero, divisor N: equation (13) or (14) of Wu and Lee"""
    centred_covariance: Array
    """``(3, 3)`` about the mean, divisor N"""
    rms: float
    """RMS of the error's length: the root of the covariance's trace. The next three are of the length too."""
    mean_error: float
    p95: float
    """95th percentile of the sample, interpolated linearly at (N - 1) p: Hyndman and Fan's type 7, numpy's default."""
    max: float
    share_below_max: float
    """Share of all poses whose error is below ``max`` with ``confidence``; ``max`` itself has no interval."""
    intervals: Intervals
    ellipsoid: Ellipsoid
    radius95_zero_mean: EstimateOrReason
    """Radius of the sphere about zero that contains 95 % of N(0, covariance)."""
    radius95_fitted_mean: EstimateOrReason
    """Radius of the sphere about zero that contains 95 % of N(mean, centred_covariance)."""
    tests: AssumptionTests
    structure: PoseStructure
    assumption: str
    """Assumptions of the intervals, and the reasons."""

    def estimate(self, statistic: Statistic) -> tuple[float, Interval]:
        """Return the value and interval of the named statistic of the error's length."""
        if statistic == "max":
            why = (
                f"the largest error of all poses has no interval: with {100 * self.confidence:g} % confidence, "
                f"{100 * self.share_below_max:.3g} % of poses are below the largest of these {self.n_poses}"
            )
            return self.max, Interval.missing(self.confidence, why)
        return getattr(self, statistic), getattr(self.intervals, statistic)


SIGNIFICANCE = 0.01
"""Significance level: an assumption with a smaller p-value is rejected."""
PROBABILITY = 0.95
"""Share of poses within a radius, and level of the percentile."""


@dataclass(frozen=True)
class _ErrorSample(PoseSampling):
    """Errors, the resampling of their poses, their moments, and the assumptions that their intervals rely on."""

    origin: Array = field(kw_only=True)
    mean: Array = field(kw_only=True)
    """``(3,)``"""
    of_groups: Array = field(kw_only=True)
    """``(G, 11)`` sums of z over commanded poses, or over groups of them; see :mod:`robacc.accuracy.error_sums`."""
    lengths: Array = field(kw_only=True)
    """``(L,)`` lengths of the errors, or quantiles of them at equal steps of the probability from 0 to 1."""
    tests: AssumptionTests = field(kw_only=True)
    """Tests of the mean errors of the commanded poses."""
    n_commands: int = field(kw_only=True)
    is_repeated: bool = field(kw_only=True)

    @classmethod
    def of(cls, errors: Array, groups: NDArray[Any] | None, share: float, draws: int, seed: int) -> "_ErrorSample":
        """Return the errors with the numbers of their commanded poses."""
        refuse(((n := errors.shape[1]) == 0, "there are no poses; statistics need at least one"), error=InputError)
        if groups is not None:
            unique, index = np.unique(groups, return_inverse=True)
            # Without repetitions: the faster and exact case.
            groups = None if unique.size == n else index.astype(np.int64)
        mean, lengths = np.mean(errors, axis=1), vector_lengths(errors)
        # A component that is equal in all errors is exactly zero about their mean, without rounding.
        centred, low, high = errors - mean[:, None], np.min(errors, axis=1), np.max(errors, axis=1)
        centred[high - low <= 8 * np.finfo(float).eps * np.max(np.maximum(-low, high))] = 0.0
        z, means = features(centred, lengths), errors
        if groups is not None:
            z = np.stack([np.bincount(groups, weights=row) for row in z])
            means = np.stack([np.bincount(groups, weights=row) for row in errors]) / z[0]
        return cls(
            n,
            groups,
            draws,
            seed,
            share,
            origin=mean,
            mean=mean,
            of_groups=np.ascontiguousarray(z.T),
            lengths=lengths,
            tests=assumption_tests(means),
            n_commands=z.shape[1],
            is_repeated=groups is not None,
        )

    @classmethod
    def of_sums(cls, sums: ErrorSums, count: int) -> "_ErrorSample":
        """Return the errors of ``count`` commanded poses whose sums are known."""
        n = sums.n
        mean = sums.origin + sums.products[0, 1:4] / n
        tests = tests_of_sums(sums.products, sums.origin, mean)
        if count < n:
            tests = AssumptionTests(*(AssumptionTest(test.method, None, None, 3, IN_PARTS) for test in tests))
        return cls(
            n,
            None,
            origin=sums.origin,
            mean=mean,
            of_groups=sums.groups[sums.groups[:, 0] > 0.0],
            lengths=sums.lengths,
            tests=tests,
            n_commands=count,
            is_repeated=count < n,
        )

    @property
    def n_groups(self) -> int:
        """Number of commanded poses."""
        return self.n_commands

    @cached_property
    def sizes(self) -> Array:
        """Number of errors of each group, ``(G,)``."""
        return self.of_groups[:, 0]

    @cached_property
    def means(self) -> Array:
        """Mean of z ``(11,)``."""
        return np.asarray(self.of_groups.sum(axis=0) / self.n)

    def centre(self, about_zero: bool) -> Array:
        """Return zero or the mean."""
        return np.zeros(3) if about_zero else self.mean

    def covariance(self, about_zero: bool) -> Array:
        """Return the covariance about zero or about the mean."""
        return _second(self.means, self.origin - self.centre(about_zero))

    def of_mean(
        self, weights: Array, confidence: float, *, positive: bool = True, exact: Interval | None = None
    ) -> Interval:
        """Return the interval of the mean of ``weights`` ``(11,)`` times z by resampling; see :meth:`interval`.

        An ``exact`` interval of a Gaussian takes its place; if frames were fitted, the wider of both does: held-out
        errors grow with the leverage of the pose, so their squares scatter more than those of a Gaussian.
        """
        if exact is not None and self.share == 1.0:
            return exact
        mean, of_groups = float(weights @ self.means), self.of_groups @ weights
        # A sum of terms that cancel is rounding.
        largest = float(np.max(np.abs(self.of_groups) @ np.abs(weights) / self.sizes))
        resampled = self.interval(mean, of_groups - mean * self.sizes, largest, confidence, positive=positive)
        return resampled if exact is None else exact.wider(resampled)

    def of_square(self, matrix: Array, confidence: float, exact: Interval | None) -> Interval:
        """Return the interval of the mean of e^T ``matrix`` e, e the error."""
        return self.of_mean(weights(self.origin, np.zeros(3), quadratic=matrix), confidence, exact=exact)

    @property
    def shape(self) -> bool:
        """The errors of the commanded poses look Gaussian."""
        return all(p is None or p >= SIGNIFICANCE for p in (self.tests.skewness.p_value, self.tests.kurtosis.p_value))

    @property
    def zero_mean(self) -> bool:
        """Nothing speaks against a mean of zero."""
        p_value = self.tests.zero_mean.p_value
        # Errors without scatter along their mean have no p-value, but such a mean is not due to chance.
        return self.n_groups <= 3 if p_value is None else p_value >= SIGNIFICANCE

    def is_gaussian(self, about_zero: bool) -> bool:
        """Return whether the errors of the commanded poses look Gaussian about zero or the mean, and none repeat."""
        return self.shape and not self.is_repeated and (self.zero_mean or not about_zero)

    @property
    def structure(self) -> PoseStructure:
        """Analysis of the variance over commanded poses, one-way random effects.

        Source: S. R. Searle, G. Casella, C. E. McCulloch, Variance Components (1992), 3.6 (unequal numbers); effective
        number by L. Kish, Survey Sampling (1965), 5.4.
        """
        n, number, once = self.n, self.n_groups, "no commanded pose was repeated"
        together = "all rows are of one commanded pose"
        apart = f", so repeatability cannot be separated from errors that depend on the pose; {SHARED}"
        obstacles = applying(
            (self.is_repeated and self.groups is None, (IN_PARTS, f"; {SHARED}")),
            (number == 1 < n, (together, ": the scatter is repeatability and does not describe other poses")),
            (number == n, (once, apart)),
        )
        if obstacles:
            why, consequence = obstacles[0]
            return PoseStructure(None, None, None, None, why + consequence, why)
        of_pose = self.of_groups - self.sizes[:, None] * self.means
        explained = float(np.sum(np.square(of_pose[:, 1:4]) / self.sizes[:, None]))
        within = max(n * float(np.trace(self.covariance(False))) - explained, 0.0) / (n - number)
        # Kish's mean number of repetitions weights each pose by its number of rows.
        mean_size = float(np.sum(np.square(self.sizes))) / n
        between = max(0.0, (explained / (number - 1) - within) * (number - 1) / (n - mean_size))
        if between + within <= 0.0:
            why = "the errors do not scatter"
            return PoseStructure(between, within, None, None, f"{why}; {SHARED}", why)
        correlation = between / (between + within)
        effective = n / (1.0 + (mean_size - 1.0) * correlation)
        text = (
            f"{n} rows of {number} commanded poses: {100 * correlation:.1f} % of the variance is between poses and "
            f"{100 * (1 - correlation):.1f} % within, equivalent to {effective:.3g} independent poses; {SHARED}"
        )
        return PoseStructure(between, within, correlation, effective, text)

    @property
    def assumption(self) -> str:
        """Assumptions and rejections as a sentence, which names assumptions that cannot be tested."""
        rejections = applying(
            (not self.shape, "the errors are not Gaussian (Mardia)"),
            (not self.zero_mean, "their mean is not zero (Hotelling)"),
            (self.is_repeated, "commanded poses were repeated, and repetitions are not independent"),
        )
        if rejections:
            return f"{'; '.join(rejections)}: intervals come from resampling, not from a Gaussian model"
        is_tested = all(test.p_value is not None for test in self.tests)
        tested = f"no test rejects it at {100 * SIGNIFICANCE:g} %" if is_tested else "the poses are too few to test it"
        return f"errors assumed Gaussian with zero mean; {tested}"

    def mean_intervals(self, confidence: float) -> tuple[Interval, ...]:
        """Return intervals of the mean's components: Student's t for Gaussian errors (exact), else the bootstrap."""
        dof = self.n_independent - 1.0
        if self.too_few or not self.is_gaussian(about_zero=False):
            components = (weights(self.origin, np.zeros(3), linear=axis) for axis in np.eye(3))
            return tuple(self.of_mean(component, confidence, positive=False) for component in components)
        parts = zip(self.mean.tolist(), np.sqrt(np.diag(self.covariance(False)) / dof).tolist(), strict=True)
        return tuple(student_interval(value, error, dof, confidence) for value, error in parts)

    def matrix_interval(self, about_zero: bool, confidence: float) -> MatrixInterval:
        """Return intervals of the elements of the covariance about zero or about the mean."""
        if (why := self.too_few) is not None:
            return MatrixInterval(None, None, confidence, "none", why)
        # Gaussian errors have N degrees of freedom about their known mean and N - 1 about the estimated one.
        is_gaussian, dof = self.is_gaussian(about_zero), self.n_independent - (not about_zero)
        unbiased = self.covariance(about_zero) * (self.n_independent / dof)
        limits, method = np.empty((2, 3, 3)), "Wishart (chi-square)"
        for i, j in PAIRS:
            if is_gaussian and i != j:
                ends = covariance_element(unbiased[i, i], unbiased[j, j], unbiased[i, j], dof, confidence)
                interval = Interval(*ends, None, confidence, method)
            else:
                exact = chi2_interval(float(unbiased[i, i]), dof, confidence, method) if is_gaussian else None
                element = 0.5 * (np.outer(*np.eye(3)[[i, j]]) + np.outer(*np.eye(3)[[j, i]]))
                own = weights(self.origin, self.centre(about_zero), quadratic=element)
                interval = self.of_mean(own, confidence, positive=i == j, exact=exact)
            limits[:, i, j] = limits[:, j, i] = interval.lower, interval.upper
        return MatrixInterval(limits[0], limits[1], confidence, interval.method)

    def ellipsoid(self, confidence: float) -> Ellipsoid:
        """Return the principal axes of the covariance about zero and intervals of the standard deviations along them.

        Sampling separates the estimated variances of nearly equal axes, and no interval around either keeps its
        confidence. Such axes share an interval, from the lower limit of the smallest to the upper limit of the largest;
        it contains each with at least the confidence. The interval of a distinct axis is corrected for the bias of a
        sample's principal variances, of which the smallest are too small and the largest too large (D. N. Lawley,
        "Tests of significance for the latent roots of covariance and correlation matrices", Biometrika 43, 1956).
        """
        n = self.n_independent
        variances, axes = principal_axes(self.covariance(True))
        if (why := self.too_few) is not None:
            return Ellipsoid(axes, np.sqrt(variances), (Interval.missing(confidence, why),) * 3)
        # The logarithm of a variance estimated from n has a standard error of sqrt(2 / n); the logarithms of distinct
        # neighbours differ by 2.5 standard errors.
        run = np.cumsum([0, *(variances[:-1] > variances[1:] * math.exp(2.5 * math.sqrt(4.0 / n)))])
        single: list[Interval] = []
        for k, variance in enumerate(variances.tolist()):
            others, unbias, exact = np.delete(variances, k), 1.0, None
            # Below four poses the expansion in 1/n is useless, and its factor could have any sign.
            if np.count_nonzero(run == run[k]) == 1 and variance > 0.0 and n >= 4:
                unbias = 1.0 / (1.0 + float(np.sum(others / (variance - others))) / n)
            if self.is_gaussian(about_zero=True):
                exact = chi2_interval(unbias * variance, n, confidence, "chi-square along a principal axis")
            single.append(self.of_square(unbias * np.outer(axes[:, k], axes[:, k]), confidence, exact))

        def shared(axes_of_run: Sequence[int]) -> Interval:
            """Return the interval of axes that are not distinguishable, the longest first."""
            first, last, count = single[axes_of_run[0]], single[axes_of_run[-1]], len(axes_of_run)
            method = f"{first.method}, shared by {count} axes that are not distinguishable on these poses"
            ends = last.lower, first.upper, first.upper_bound
            common = Interval(*ends, confidence, f"{method}, with at least the confidence")
            return (first if count == 1 else common).root()

        intervals = tuple(shared(np.flatnonzero(run == number).tolist()) for number in run)
        return Ellipsoid(axes, np.sqrt(variances), intervals)

    def radius95(self, about_zero: bool, confidence: float) -> tuple[EstimateOrReason, Shape]:
        """Return the radius about zero that contains 95 % of the fitted Gaussian, and the shape of its lengths.

        The Gaussian is about zero or about the mean; the shape is None without scatter. Where the errors are not
        Gaussian, the interval comes from resampling the poses' first-order influence on the squared radius; if frames
        were fitted, it is the wider of both.
        """
        n, fewest = self.n_independent, 3 if about_zero else 4
        if n < fewest:
            why = f"{self.described}: scatter in three directions needs at least {fewest}"
            return EstimateOrReason.missing(confidence, why), None
        variances, axes = principal_axes(self.covariance(about_zero))
        along, exact = axes.T @ self.centre(about_zero), None
        variances = np.where(variances > NIL * (variances[0] + along @ along), variances, 0.0)
        radius = length_quantile(PROBABILITY, along, variances)
        if not np.any(variances):
            return EstimateOrReason(radius, Interval.exact(radius, confidence)), None
        shrunk = _shrunk_to_mean(variances, n)
        if self.is_gaussian(about_zero):
            # The first-order variance of the squared radius over mean and covariance.
            square = length_quantile(PROBABILITY, along, shrunk) ** 2
            by_mean, by_covariance = squared_quantile_gradient(math.sqrt(square), along, shrunk)
            weighted = by_covariance * shrunk
            variance = (2.0 * float(np.sum(weighted * weighted.T)) + float(by_mean**2 @ shrunk)) / n
            exact = chi2_interval(square, 2.0 * square**2 / variance, confidence, _METHOD)
        by_mean, by_covariance = squared_quantile_gradient(radius, along, variances)
        quadratic = axes @ (0.5 * (by_covariance + by_covariance.T)) @ axes.T
        influence = weights(self.origin, self.centre(about_zero), axes @ by_mean, quadratic)
        influence[0] += radius**2 - float(np.diag(by_covariance) @ variances)
        interval = self.of_mean(influence, confidence, exact=exact)
        return EstimateOrReason(radius, interval.root()), (along, shrunk)

    def length_intervals(
        self, radius: EstimateOrReason, shape: Shape, confidence: float
    ) -> tuple[Interval, Interval, Interval]:
        """Return the intervals of RMS, mean and 95th percentile of the length.

        ``radius`` and ``shape`` are those of the Gaussian about zero if its mean is assumed to be zero, else about the
        mean.
        """
        has_exact = self.is_gaussian(about_zero=True) and self.too_few is None
        exact = satterthwaite(self.covariance(True), self.n_independent, confidence) if has_exact else None
        return (
            self.of_square(np.eye(3), confidence, exact).root(),
            self.of_mean(LENGTH, confidence),
            self._p95_interval(radius, shape, confidence),
        )

    def _p95_interval(self, radius: EstimateOrReason, shape: Shape, confidence: float) -> Interval:
        """Return the interval of the 95th percentile: order statistics if there are enough poses, else by the shape.

        Both rest on the sample's own percentile. With few poses the Gaussian gives the shape of the distribution only,
        not its scale; see :mod:`robacc.statistics.lengths`.
        """
        lengths, n = self.lengths, int(self.n_independent)
        levels = percentile_levels(n, PROBABILITY, confidence)
        # Repetitions count as one pose, however equal they are: the levels are then wider than needed, never narrower.
        by_model = levels[1] is None and self.shape and n >= FEWEST
        if not by_model and (n < FEWEST or levels == (None, None, None)):
            return Interval.missing(confidence, f"{self.described}: too few for a 95th percentile")
        if by_model and shape is None:
            return radius.interval
        # Lengths beyond the sample: scaled to the fitted Gaussian, shaped like the sample's squares.
        variance = float(np.var(np.square(lengths)))
        dof = 2.0 * float(np.mean(np.square(lengths))) ** 2 / variance if variance > 0.0 else None
        curve = PercentileCurve(lengths, n, PROBABILITY, radius.interval.curve, radius.value, dof, by_model)
        if by_model and shape is not None:
            model = ScaledPercentileCurve(quantiles(lengths, [PROBABILITY])[0], n, PROBABILITY, *shape)
            method = (
                "the sample's percentile and the shape of the fitted Gaussian, valid only if the errors are Gaussian"
            )
            return replace(model.interval(confidence, method), curve=curve._replace(model=model))
        # The k-th of n is at k / (n + 1) in levels and at k - 1 in positions.
        step = (lengths.size - 1) / (self.n - 1)
        lower, upper, bound = (
            None if level is None else interpolated(lengths, [(level * (self.n + 1) - 1.0) * step])[0]
            for level in levels
        )
        too_few = f"{self.described}: too few for an upper limit without assuming a distribution"
        cautious = "; all repetitions of a pose count as one, so the confidence is at least the stated one"
        method = f"order statistics of {self.described}" + cautious * self.is_repeated
        return Interval(lower, upper, bound, confidence, method, too_few if upper is None else None, curve)


def error_statistics(
    errors: Array,
    unit: Unit,
    *,
    groups: NDArray[Any] | None = None,
    share: float = 1.0,
    confidence: float = 0.95,
    bootstrap: int = 2000,
    seed: int = 0,
) -> ErrorStatistics:
    """Return the statistics of errors, each with its interval.

    Args:
        errors: ``(3, N)`` position errors in m or orientation errors (rotation vectors) in rad, all in one frame.
        unit: ``"m"`` or ``"rad"``.
        groups: ``(N,)`` id of each error's commanded pose, of any type; equal ids are repetitions of one pose and
            do not count as independent. None: no pose was repeated.
        share: Degrees of freedom that a fit leaves, as a share of the measured components.
        confidence: Confidence of every interval.
        bootstrap: Number of resamples where an interval needs them.
        seed: Seed of the resampling; the same seed gives the same limits.

    Raises:
        InputError: There are no errors.
    """
    return _statistics(_ErrorSample.of(errors, groups, share, bootstrap, seed), unit, confidence)


def statistics_of_sums(sums: ErrorSums, n_commands: int, unit: Unit, confidence: float) -> ErrorStatistics:
    """Return the statistics of errors of different commands whose sums are known; see :func:`error_statistics`."""
    return _statistics(_ErrorSample.of_sums(sums, n_commands), unit, confidence)


def _statistics(sample: _ErrorSample, unit: Unit, confidence: float) -> ErrorStatistics:
    about_zero, about_mean = (sample.radius95(zero, confidence) for zero in (True, False))
    covariance = sample.covariance(True)
    return ErrorStatistics(
        unit=unit,
        n=sample.n,
        n_poses=sample.n_groups,
        n_independent=sample.n_independent,
        confidence=confidence,
        mean=sample.mean,
        covariance=covariance,
        centred_covariance=sample.covariance(False),
        rms=float(np.sqrt(np.trace(covariance))),
        mean_error=float(sample.means @ LENGTH),
        p95=quantiles(sample.lengths, [PROBABILITY])[0],
        max=float(np.max(sample.lengths)),
        share_below_max=(1.0 - confidence) ** (1.0 / sample.n_independent),  # Wilks, as for a gate's largest error
        intervals=Intervals(
            sample.mean_intervals(confidence),
            sample.matrix_interval(True, confidence),
            sample.matrix_interval(False, confidence),
            *sample.length_intervals(*(about_zero if sample.zero_mean else about_mean), confidence),
        ),
        ellipsoid=sample.ellipsoid(confidence),
        radius95_zero_mean=about_zero[0],
        radius95_fitted_mean=about_mean[0],
        tests=sample.tests,
        structure=sample.structure,
        assumption=sample.assumption,
    )


def length_intervals(
    errors: Array,
    confidences: Sequence[float],
    *,
    groups: NDArray[Any] | None = None,
    share: float = 1.0,
    bootstrap: int = 2000,
    seed: int = 0,
) -> tuple[Mapping[Statistic, Interval], ...]:
    """Return the intervals of the error's length alone, at each of ``confidences``.

    They are those of :func:`error_statistics`, whose arguments and errors these are.
    """
    sample = _ErrorSample.of(errors, groups, share, bootstrap, seed)
    names: tuple[Statistic, ...] = ("rms", "mean_error", "p95")
    return tuple(
        dict(zip(names, sample.length_intervals(*sample.radius95(sample.zero_mean, c), c), strict=True))
        for c in confidences
    )


# Fall of the RMS between errors of the same poses.


class Gain(NamedTuple):
    """Reduction of the position RMS on held-out poses, with an interval over poses."""

    value: float
    low: float
    high: float
    confidence: float


def paired_gain(before: Array, after: Array, groups: NDArray[np.int64], confidence: float = 0.95) -> Gain:
    """Return the fall of the position RMS from ``before`` to ``after`` ``(M, N)`` on the same poses.

    The interval is the delta method's over groups of repeats. Both errors of a pose stay together, so that what the
    stages share cancels.
    """
    squares = np.stack([np.sum(np.square(residual[:3]), axis=0) for residual in (before, after)])
    rms = np.sqrt(squares.mean(axis=1))
    value = float(rms[0] - rms[1])
    # Rows that are left out leave gaps in the numbers of the groups.
    sampling = PoseSampling(squares.shape[1], np.unique(groups, return_inverse=True)[1])
    if sampling.n_groups < 3 or rms.min() <= 0:
        return Gain(value, float("nan"), float("nan"), confidence)
    influence = squares / (2 * rms[:, None])
    gain_std = sampling.standard_error(influence[0] - influence[1])
    half_width = student_quantile(0.5 + confidence / 2, sampling.n_groups - 1.0) * gain_std
    return Gain(value, value - half_width, value + half_width, confidence)


# Effective degrees of freedom of a sum of variances.

_METHOD = "chi-square, effective degrees of freedom (Satterthwaite)"


def satterthwaite(covariance: Array, n: float, confidence: float) -> Interval:
    """Return the interval of the mean squared length of Gaussian errors with zero mean, of ``n`` independent poses.

    n rms^2 is a sum of chi-squares weighted by the principal variances; a chi-square with (tr V)^2 n / tr(V^2)
    degrees of freedom has its mean and variance. (tr V)^2 and tr(V^2) are estimated without the bias of a sample's
    traces, which at ten poses is a quarter of the second.

    Source: F. E. Satterthwaite, "An approximate distribution of estimates of variance components", Biometrics
    Bulletin 2, 1946; moments of the Wishart distribution as in R. J. Muirhead (1982), 3.2.
    """
    trace = float(np.trace(covariance))
    if trace == 0.0:
        return Interval.exact(0.0, confidence)
    dof = n / _concentration(float(np.sum(np.square(covariance))) / trace**2, n)
    return chi2_interval(trace, dof, confidence, _METHOD)


def _concentration(ratio: float, n: float) -> float:
    """Estimate tr(S^2) / (tr S)^2, from 1/3 (equal axes) to 1 (one direction), from the ``ratio`` of the sample.

    For nV ~ W(n, S): E[(tr V)^2] = t + 2 s / n and E[tr(V^2)] = (1 + 1/n) s + t / n, with t = (tr S)^2, s = tr(S^2).
    """
    s = (n * ratio - 1.0) / (n + 1.0 - 2.0 / n)
    return min(max(s / (1.0 - 2.0 * s / n), 1.0 / 3.0), 1.0)


def _shrunk_to_mean(variances: Array, n: float) -> Array:
    """Shrink principal variances towards their mean by the dispersion that sampling n poses adds; the sum stays.

    A radius grows as the same trace goes into fewer axes, so a sample's own radius is too large for equal axes.
    """
    mean = float(np.mean(variances))
    ratio = float(np.sum(np.square(variances))) / (3.0 * mean) ** 2
    dispersion = ratio - 1.0 / 3.0
    shrink = min((_concentration(ratio, n) - 1.0 / 3.0) / dispersion, 1.0) ** 0.5 if dispersion > 0.0 else 1.0
    return np.asarray(mean + shrink * (variances - mean))
