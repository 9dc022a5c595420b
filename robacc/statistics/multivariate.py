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
    return np.asarray(errors @ errors.T / errors.shape[1])


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
    about_zero, _ = principal_axes(second_moment(errors))
    values, axes = principal_axes(second_moment(errors - mean[:, None]))
    scatter = int(np.count_nonzero(values > NIL * about_zero[0]))
    values, axes = values[:scatter], axes[:, :scatter]
    hotelling = _hotelling(mean, values, axes, int(np.count_nonzero(about_zero)), errors.shape[1])
    return AssumptionTests(hotelling, *_mardia(errors, mean, values, axes))


def _hotelling(mean: Array, values: Array, axes: Array, rank: int, n: int) -> AssumptionTest:
    """Test the mean by T^2 = n m' S^-1 m, S with divisor n - 1 (Hotelling 1931).

    (n - p) / (p (n - 1)) T^2 ~ F(p, n - p).
    """
    p, why = values.size, None
    if n <= rank or n < 2:
        directions = "one direction" if rank == 1 else f"{rank or 3} directions"
        why = f"{_poses(n)}: too few for scatter in {directions}"
    elif p < rank:
        why = "the errors do not scatter along every direction of their mean"
    elif rank == 0:
        why = "every error is zero"
    statistic = p_value = None
    if why is None:
        statistic = (n - 1) * float(np.sum(np.square(axes.T @ mean) / values))
        p_value = f_sf((n - p) / (p * (n - 1)) * statistic, p, n - p)
    return AssumptionTest("Hotelling's T-squared: the mean is zero", statistic, p_value, p, why)


def _mardia(errors: Array, mean: Array, values: Array, axes: Array) -> tuple[AssumptionTest, AssumptionTest]:
    """Test by Mardia's b1 and b2, with his small-sample corrections.

    Sources: K. V. Mardia, "Measures of multivariate skewness and kurtosis with applications", Biometrika 57 (1970);
    "Applications of some measures of multivariate skewness and kurtosis in testing normality and robustness studies",
    Sankhya B 36 (1974): exact mean of b1 and exact mean and variance of b2 for Gaussian data.
    """
    n, p = errors.shape[1], values.size
    too_few = f"{_poses(n)}: too few to test the shape of the distribution"
    reasons: list[str | None] = ["the errors do not scatter" if p == 0 and n > 1 else too_few] * 2
    skewness = p_skewness = kurtosis = p_kurtosis = None
    if p > 0 and n >= p + 2:
        reasons = [None, too_few]
        skewness, b2 = _standardised_moments(errors, mean, axes / np.sqrt(values))
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


def _standardised_moments(errors: Array, mean: Array, whiten: Array) -> tuple[float, float]:
    """Return Mardia's b1 and b2.

    b1, the mean of (z_i . z_j)^3 over all pairs, is the squared norm of the mean of z (x) z (x) z: a pass over the
    poses replaces a pass over their pairs.
    """
    n, p = errors.shape[1], whiten.shape[1]
    third, fourth = np.zeros((p, p * p)), 0.0
    for start in range(0, n, BLOCK):
        z = whiten.T @ (errors[:, start : start + BLOCK] - mean[:, None])
        third += z @ (z[:, None] * z[None]).reshape(p * p, -1).T
        square = np.einsum("in,in->n", z, z)
        fourth += float(square @ square)
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
    number = sizes.size
    if groups is None or number in (1, n):
        why = "no commanded pose was repeated"
        text = f"{why}, so repeatability cannot be separated from errors that depend on the pose; {SHARED}"
        if number == 1 and n > 1:
            why = "all rows are of one commanded pose"
            text = f"{why}: the scatter is repeatability and does not describe other poses"
        return PoseStructure(n, number, None, None, None, None, text, why)
    centred = errors - np.mean(errors, axis=1)[:, None]
    sums = np.stack([np.bincount(groups, weights=component) for component in centred])
    explained = float(np.sum(np.sum(np.square(sums), axis=0) / sizes))
    within = max(float(np.sum(np.square(centred))) - explained, 0.0) / (n - number)
    # Kish's mean number of repetitions weights each pose by its number of rows.
    mean_size = float(np.sum(np.square(sizes))) / n
    between = max(0.0, (explained / (number - 1) - within) * (number - 1) / (n - mean_size))
    if between + within <= 0.0:
        why = "the errors do not scatter"
        return PoseStructure(n, number, between, within, None, None, f"{why}; {SHARED}", why)
    correlation = between / (between + within)
    effective = n / (1.0 + (mean_size - 1.0) * correlation)
    text = (
        f"{n} rows of {number} commanded poses: {100 * correlation:.1f} % of the variance is between poses and "
        f"{100 * (1 - correlation):.1f} % within, equivalent to {effective:.3g} independent poses; {SHARED}"
    )
    return PoseStructure(n, number, between, within, correlation, effective, text)
