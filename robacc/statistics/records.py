"""Records of error statistics and their intervals: covariances, the 95 % radius."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.geometry import Array
from robacc.statistics.intervals import (
    EstimateOrReason,
    Interval,
    PoseSampling,
    chi2_interval,
    covariance_element,
)
from robacc.statistics.multivariate import BLOCK, NIL, AssumptionTests, PoseStructure, principal_axes
from robacc.statistics.quadratic_form import LengthShape, length_quantile, squared_quantile_gradient

Unit = Literal["m", "rad"]
Statistic = Literal["rms", "mean_error", "p95", "max"]


@dataclass(frozen=True, slots=True)
class MatrixInterval:
    """Confidence intervals of a covariance matrix, element by element (not for all elements at once)."""

    lower: Array | None
    upper: Array | None
    """``(3, 3)`` each, m^2 or rad^2"""
    confidence: float
    method: str
    why: str | None = None


@dataclass(frozen=True, slots=True)
class Ellipsoid:
    """Principal axes of the covariance about zero, longest first."""

    axes: Array
    """``(3, 3)``, unit vectors as columns, in the frame of the errors"""
    sd: Array
    """``(3,)`` principal standard deviations, m or rad"""
    intervals: tuple[Interval, Interval, Interval]


@dataclass(frozen=True, slots=True)
class Intervals:
    """Intervals of the numbers of the same name in :class:`ErrorStatistics`."""

    mean: tuple[Interval, Interval, Interval]
    covariance: MatrixInterval
    centred_covariance: MatrixInterval
    rms: Interval
    mean_error: Interval
    p95: Interval


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
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


# Intervals of a covariance's elements and of its principal standard deviations.

_DISTINCT = 2.5
"""Standard errors by which the logarithms of two neighbouring principal variances must differ to count as distinct."""


def matrix_interval(
    errors: Array, covariance: Array, dof: float | None, sampling: PoseSampling, confidence: float
) -> MatrixInterval:
    """Return intervals of the elements of ``covariance``, the mean of d d^T over ``errors`` ``(3, N)``.

    Args:
        errors: About zero or about their mean, as the covariance was.
        covariance: ``(3, 3)``, divisor N.
        dof: Degrees of freedom of Gaussian errors: N about their known mean, N - 1 about the estimated mean, less
            where frames were fitted; None where the errors are not Gaussian or poses were repeated.
        sampling: Groups and resampling of the poses.
        confidence: Confidence of each interval.
    """
    if (why := sampling.too_few) is not None:
        return MatrixInterval(None, None, confidence, "none", why)
    lower, upper = np.empty((3, 3)), np.empty((3, 3))
    method, unbiased = "Wishart (chi-square)", covariance * (1.0 if dof is None else sampling.n_independent / dof)
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        if dof is None:
            interval = sampling.mean_interval(errors[i] * errors[j], confidence, positive=i == j)
        elif i == j:
            interval = chi2_interval(float(unbiased[i, i]), dof, confidence, method)
            interval = sampling.cautious(interval, np.square(errors[i]), confidence)
        else:
            limits = covariance_element(unbiased[i, i], unbiased[j, j], unbiased[i, j], dof, confidence)
            interval = Interval(*limits, None, confidence, method)
        lower[i, j] = lower[j, i] = interval.lower
        upper[i, j] = upper[j, i] = interval.upper
    return MatrixInterval(lower, upper, confidence, interval.method)


def ellipsoid(errors: Array, covariance: Array, gaussian: bool, sampling: PoseSampling, confidence: float) -> Ellipsoid:
    """Return the principal axes of ``covariance`` about zero and intervals of the standard deviations along them.

    Sampling separates the estimated variances of nearly equal axes, and no interval around either keeps its
    confidence. Such axes share an interval, from the lower limit of the smallest to the upper limit of the largest;
    it contains each with at least the confidence. The interval of a distinct axis is corrected for the bias of a
    sample's principal variances, of which the smallest are too small and the largest too large (D. N.
    Lawley, "Tests of significance for the latent roots of covariance and correlation matrices", Biometrika 43, 1956).
    """
    variances, axes = principal_axes(covariance)
    n = sampling.n_independent
    if (why := sampling.too_few) is not None:
        missing = Interval.missing(confidence, why)
        return Ellipsoid(axes, np.sqrt(variances), (missing, missing, missing))
    single, runs = [], _indistinct_runs(variances, n)
    for k in range(3):
        unbias = _without_bias(variances, k, n) if [k] in runs else 1.0
        squares = unbias * np.square(axes[:, k] @ errors)
        if gaussian:
            value = unbias * float(variances[k])
            interval = chi2_interval(value, n, confidence, "chi-square along a principal axis")
            single.append(sampling.cautious(interval, squares, confidence))
        else:
            single.append(sampling.mean_interval(squares, confidence, positive=True))
    intervals = [_shared([single[i] for i in run]).root() for run in runs for _ in run]
    return Ellipsoid(axes, np.sqrt(variances), (intervals[0], intervals[1], intervals[2]))


def _indistinct_runs(variances: Array, n: float) -> list[list[int]]:
    """Return runs of neighbouring axes whose variances the sample does not distinguish."""
    runs = [[0]]
    for k in (1, 2):
        large, small = float(variances[k - 1]), float(variances[k])
        # The logarithm of a variance estimated from n has a standard error of sqrt(2 / n).
        distinct = small <= 0.0 < large or (small > 0.0 and math.log(large / small) > _DISTINCT * math.sqrt(4.0 / n))
        if distinct:
            runs.append([k])
        else:
            runs[-1].append(k)
    return runs


def _without_bias(variances: Array, k: int, n: float) -> float:
    """Return the factor that corrects a distinct, k-th principal variance for its bias of order 1/n."""
    # Below four poses the expansion in 1/n is useless, and its factor could have any sign.
    if variances[k] == 0.0 or n < 4:
        return 1.0
    others = np.delete(variances, k)
    return 1.0 / (1.0 + float(np.sum(others / (variances[k] - others))) / n)


def _shared(intervals: list[Interval]) -> Interval:
    """Combine the intervals of a run of axes, in falling order, that are not distinguishable."""
    first, last = intervals[0], intervals[-1]
    if len(intervals) == 1:
        return first
    method = (
        f"{first.method}, shared by {len(intervals)} axes that are not distinguishable on these poses, "
        "with at least the confidence"
    )
    return Interval(last.lower, first.upper, first.upper_bound, first.confidence, method)


# Radius of the sphere that contains 95 % of poses under a fitted Gaussian, and its interval.

PROBABILITY = 0.95
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
    t = 1.0 - 2.0 * s / n
    return min(max(s / t, 1.0 / 3.0), 1.0)


def _shrunk_to_mean(variances: Array, n: float) -> Array:
    """Shrink principal variances towards their mean by the dispersion that sampling n poses adds; the sum stays.

    A radius grows as the same trace goes into fewer axes, so a sample's own radius is too large for equal axes.
    """
    mean = float(np.mean(variances))
    ratio = float(np.sum(np.square(variances))) / (3.0 * mean) ** 2
    dispersion = ratio - 1.0 / 3.0
    if dispersion <= 0.0:
        return variances
    shrink = min((_concentration(ratio, n) - 1.0 / 3.0) / dispersion, 1.0) ** 0.5
    shrunk: Array = mean + shrink * (variances - mean)
    return shrunk


def radius95(
    errors: Array, mean: Array, covariance: Array, gaussian: bool, sampling: PoseSampling, confidence: float
) -> tuple[EstimateOrReason, LengthShape | None]:
    """Return the radius about zero that contains 95 % of N(``mean``, ``covariance``), and the shape of the lengths.

    The shape is None without scatter.

    Args:
        errors: ``(3, N)``.
        mean: ``(3,)``, zero for the fit about zero.
        covariance: ``(3, 3)`` of the errors about ``mean``.
        gaussian: Whether the errors are Gaussian and independent. If not, the interval comes from resampling the
            poses' first-order influence on the squared radius; if frames were fitted, it is the wider of both.
        sampling: Groups and resampling of the poses.
        confidence: Confidence of the interval.
    """
    n, about_zero = sampling.n_independent, not np.any(mean)
    fewest = 3 if about_zero else 4
    if n < fewest:
        why = f"{sampling.described}: scatter in three directions needs at least {fewest}"
        return EstimateOrReason.missing(confidence, why), None
    variances, axes = principal_axes(covariance)
    along = axes.T @ mean
    variances = np.where(variances > NIL * (variances[0] + along @ along), variances, 0.0)
    radius = length_quantile(PROBABILITY, along, variances)
    if not np.any(variances):
        return EstimateOrReason(radius, Interval.exact(radius, confidence)), None
    shrunk = _shrunk_to_mean(variances, n)
    shape = LengthShape(along, shrunk)
    squared = _gaussian_interval(along, shrunk, n, confidence) if gaussian else None
    if squared is not None and sampling.share == 1.0:
        return EstimateOrReason(radius, squared.root()), shape
    by_mean, by_covariance = squared_quantile_gradient(radius, along, variances)
    influence = np.empty(errors.shape[1])
    for start in range(0, influence.size, BLOCK):
        block = slice(start, start + BLOCK)
        principal = axes.T @ errors[:, block] - along[:, None]
        influence[block] = np.einsum("in,in->n", principal, by_covariance @ principal) + by_mean @ principal
    influence += radius**2 - float(np.diag(by_covariance) @ variances)
    resampled = sampling.mean_interval(influence, confidence, positive=True)
    interval = resampled if squared is None else squared.wider(resampled)
    return EstimateOrReason(radius, interval.root()), shape


def _gaussian_interval(along: Array, variances: Array, n: float, confidence: float) -> Interval:
    """Return the interval of the squared radius from its first-order variance, over mean and covariance."""
    radius = length_quantile(PROBABILITY, along, variances)
    by_mean, by_covariance = squared_quantile_gradient(radius, along, variances)
    weighted = by_covariance * variances
    variance = (2.0 * float(np.sum(weighted * weighted.T)) + float(by_mean**2 @ variances)) / n
    return chi2_interval(radius**2, 2.0 * radius**4 / variance, confidence, _METHOD)
