"""Second moments and principal axes of error vectors, tests of equation (13), and components of variance.

Wu and Lee's equation (13) assumes Gaussian errors of zero mean: Hotelling's and Mardia's tests.

Errors are ``(3, N)``, components first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.statistics.distributions import chi2_sf, f_sf, normal_cdf

BLOCK = 16384
NIL = 1e-12
"""Eigenvalues below this fraction of the largest are rounding: the axis is a million times thinner than the longest."""


@dataclass(frozen=True, slots=True)
class AssumptionTest:
    """Result of a statistical test; statistic and p-value are None where ``why`` gives the reason."""

    method: str
    statistic: float | None
    p_value: float | None
    dimension: int
    """Number of directions in which the errors scatter: 3 unless they are coplanar or collinear."""
    why: str | None = None


@dataclass(frozen=True, slots=True)
class AssumptionTests:
    """Tests of the assumptions of a zero-mean Gaussian."""

    zero_mean: AssumptionTest
    skewness: AssumptionTest
    kurtosis: AssumptionTest


def second_moment(errors: Array) -> Array:
    """Return the mean of d d^T ``(3, 3)`` over errors ``(3, N)``: equations (13) and (14) of Wu and Lee."""
    result: Array = errors @ errors.T / errors.shape[1]
    return result


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
    n = errors.shape[1]
    mean = np.mean(errors, axis=1)
    about_zero, _ = principal_axes(second_moment(errors))
    rank = int(np.count_nonzero(about_zero))
    values, axes = principal_axes(second_moment(errors - mean[:, None]))
    scatter = int(np.count_nonzero(values > NIL * about_zero[0]))
    return AssumptionTests(
        _hotelling(mean, values[:scatter], axes[:, :scatter], rank, n),
        *_mardia(errors, mean, values[:scatter], axes[:, :scatter]),
    )


def _hotelling(mean: Array, values: Array, axes: Array, rank: int, n: int) -> AssumptionTest:
    """Test the mean by T^2 = n m' S^-1 m, S with divisor n - 1 (Hotelling 1931).

    (n - p) / (p (n - 1)) T^2 ~ F(p, n - p).
    """
    method = "Hotelling's T-squared: the mean is zero"
    p = values.size
    directions = "one direction" if rank == 1 else f"{rank or 3} directions"
    if n <= rank or n < 2:
        return AssumptionTest(method, None, None, p, f"{_poses(n)}: too few for scatter in {directions}")
    if rank == 0:
        return AssumptionTest(method, None, None, 0, "every error is zero")
    if p < rank:
        return AssumptionTest(method, None, None, p, "the errors do not scatter along every direction of their mean")
    statistic = (n - 1) * float(np.sum(np.square(axes.T @ mean) / values))
    return AssumptionTest(method, statistic, f_sf((n - p) / (p * (n - 1)) * statistic, p, n - p), p)


def _mardia(errors: Array, mean: Array, values: Array, axes: Array) -> tuple[AssumptionTest, AssumptionTest]:
    """Test by Mardia's b1 and b2, with his small-sample corrections.

    Sources: K. V. Mardia, "Measures of multivariate skewness and kurtosis with applications", Biometrika 57 (1970);
    "Applications of some measures of multivariate skewness and kurtosis in testing normality and robustness studies",
    Sankhya B 36 (1974): exact mean of b1 and exact mean and variance of b2 for Gaussian data.
    """
    methods = "Mardia's skewness: the errors are Gaussian", "Mardia's kurtosis: the errors are Gaussian"
    n, p = errors.shape[1], values.size
    if p == 0 or n < p + 2:
        why = (
            "the errors do not scatter"
            if p == 0 and n > 1
            else f"{_poses(n)}: too few to test the shape of the distribution"
        )
        return AssumptionTest(methods[0], None, None, p, why), AssumptionTest(methods[1], None, None, p, why)
    skewness, kurtosis = _standardised_moments(errors, mean, axes / np.sqrt(values))
    correction = (p + 1) * (n + 1) * (n + 3) / (n * ((n + 1) * (p + 1) - 6))
    p_skewness = chi2_sf(n * correction * skewness / 6.0, p * (p + 1) * (p + 2) / 6)
    expected = p * (p + 2) * (n - 1) / (n + 1)
    variance = 8 * p * (p + 2) * (n - 3) / (n + 1) ** 2 * (n - p - 1) / (n + 3) * (n - p + 1) / (n + 5)
    if variance <= 0.0:
        why = f"{_poses(n)}: too few to test the shape of the distribution"
        return AssumptionTest(methods[0], skewness, p_skewness, p), AssumptionTest(methods[1], None, None, p, why)
    p_kurtosis = 2.0 * normal_cdf(-abs(kurtosis - expected) / math.sqrt(variance))
    return AssumptionTest(methods[0], skewness, p_skewness, p), AssumptionTest(methods[1], kurtosis, p_kurtosis, p)


def _standardised_moments(errors: Array, mean: Array, whiten: Array) -> tuple[float, float]:
    """Return Mardia's b1 and b2.

    b1, the mean of (z_i . z_j)^3 over all pairs, is the squared norm of the mean of z (x) z (x) z: a pass over the
    poses replaces a pass over their pairs.
    """
    p = whiten.shape[1]
    third = np.zeros((p, p * p))
    fourth = 0.0
    for start in range(0, errors.shape[1], BLOCK):
        z = whiten.T @ (errors[:, start : start + BLOCK] - mean[:, None])
        third += z @ (z[:, None] * z[None]).reshape(p * p, -1).T
        square = np.einsum("in,in->n", z, z)
        fourth += float(square @ square)
    n = errors.shape[1]
    return float(np.sum(np.square(third / n))), fourth / n


def _poses(n: int) -> str:
    return "one pose" if n == 1 else f"{n} poses"


# Variance between and within commanded poses: the dependence of errors that equation (13) ignores.
#
# Wu and Lee's equation (13) sums over errors as if they were independent draws. Errors of one robot come from one set
# of parameter errors, so they vary with the pose and not at random; only repetitions of a pose show the random part.

SHARED = (
    "all poses share the parameter errors of one robot, so they are not independent draws: the intervals hold for "
    "other poses of this robot, chosen in the same manner, not for other robots"
)


@dataclass(frozen=True, slots=True)
class PoseStructure:
    """Components of the errors' variance (sum over x, y, z) between and within commanded poses."""

    n: int
    n_poses: int
    """Commanded poses."""
    between: float | None
    """Variance over poses of a commanded pose's mean error, m^2 or rad^2."""
    within: float | None
    """Variance of one repetition about the mean error of its pose."""
    intraclass_correlation: float | None
    """between / (between + within)"""
    effective_poses: float | None
    """Independent poses with the same uncertainty of the mean: n / (1 + (k - 1) ICC), k repetitions a pose."""
    text: str
    why: str | None = None


def pose_structure(errors: Array, groups: NDArray[np.int64] | None) -> PoseStructure:
    """Analyse the variance of errors ``(3, N)`` over commanded poses ``groups`` ``(N,)``, one-way random effects.

    Source: S. R. Searle, G. Casella, C. E. McCulloch, Variance Components (1992), 3.6 (unequal numbers); effective
    number by L. Kish, Survey Sampling (1965), 5.4.
    """
    n = errors.shape[1]
    sizes = np.ones(n) if groups is None else np.bincount(groups).astype(float)
    number = int(sizes.size)
    if groups is None or number == n or number == 1:
        if number == 1 and n > 1:
            why = "all rows are of one commanded pose"
            text = f"{why}: the scatter is repeatability and does not describe other poses"
        else:
            why = "no commanded pose was repeated"
            text = f"{why}, so repeatability cannot be separated from errors that depend on the pose; {SHARED}"
        return PoseStructure(n, number, None, None, None, None, text, why)
    centred = errors - np.mean(errors, axis=1)[:, None]
    sums = np.stack([np.bincount(groups, weights=component) for component in centred])
    explained = float(np.sum(np.sum(np.square(sums), axis=0) / sizes))
    total = float(np.sum(np.square(centred)))
    within = max(total - explained, 0.0) / (n - number)
    typical_size = (n - float(np.sum(np.square(sizes))) / n) / (number - 1)
    between = max(0.0, (explained / (number - 1) - within) / typical_size)
    if between + within <= 0.0:
        why = "the errors do not scatter"
        return PoseStructure(n, number, between, within, None, None, f"{why}; {SHARED}", why)
    correlation = between / (between + within)
    # Kish's mean number of repetitions weights each pose by its number of rows.
    effective = n / (1.0 + (float(np.sum(np.square(sizes))) / n - 1.0) * correlation)
    text = (
        f"{n} rows of {number} commanded poses: {100 * correlation:.1f} % of the variance is between poses and "
        f"{100 * (1 - correlation):.1f} % within, equivalent to {effective:.3g} independent poses; {SHARED}"
    )
    return PoseStructure(n, number, between, within, correlation, effective, text)
