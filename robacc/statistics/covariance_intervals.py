"""Intervals of a covariance's elements and of its principal standard deviations."""

from __future__ import annotations

import math

import numpy as np

from robacc.geometry import Array
from robacc.statistics.intervals import Interval, PoseSampling, chi2_interval, covariance_element
from robacc.statistics.multivariate import principal_axes
from robacc.statistics.records import Ellipsoid, MatrixInterval

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
    method = "Wishart (chi-square)"
    for i in range(3):
        for j in range(i, 3):
            if dof is None:
                interval = sampling.mean_interval(errors[i] * errors[j], confidence, positive=i == j)
                method, limits = interval.method, (interval.lower, interval.upper)
            elif i == j:
                variance = _unbiased(covariance[i, i], sampling, dof)
                interval = chi2_interval(variance, dof, confidence, "Wishart (chi-square)")
                interval = sampling.cautious(interval, np.square(errors[i]), confidence)
                method = interval.method
                limits = (interval.lower, interval.upper)
            else:
                first, second, cross = (_unbiased(covariance[k], sampling, dof) for k in ((i, i), (j, j), (i, j)))
                limits = covariance_element(first, second, cross, dof, confidence)
            lower[i, j], upper[i, j] = lower[j, i], upper[j, i] = limits
    return MatrixInterval(lower, upper, confidence, method)


def _unbiased(value: float, sampling: PoseSampling, dof: float) -> float:
    return float(value) * sampling.n_independent / dof


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
