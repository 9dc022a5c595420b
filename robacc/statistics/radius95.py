"""Radius of the sphere that contains 95 % of poses under a fitted Gaussian, and its interval."""

from __future__ import annotations

import numpy as np

from robacc.geometry import Array
from robacc.statistics.intervals import Interval, PoseSampling, chi2_interval
from robacc.statistics.multivariate import BLOCK, NIL, principal_axes
from robacc.statistics.quadratic_form import length_quantile, squared_quantile_gradient
from robacc.statistics.records import Radius
from robacc.statistics.scaled_percentile import shape_of

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
        return Interval(0.0, 0.0, 0.0, confidence, "no scatter")
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
) -> Radius:
    """Return the radius about zero that contains 95 % of N(``mean``, ``covariance``).

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
        return Radius(None, Interval.missing(confidence, why), why)
    variances, axes = principal_axes(covariance)
    along = axes.T @ mean
    variances = np.where(variances > NIL * (variances[0] + along @ along), variances, 0.0)
    radius = length_quantile(PROBABILITY, along, variances)
    if not np.any(variances):
        return Radius(radius, Interval(radius, radius, radius, confidence, "no scatter"))
    shrunk = _shrunk_to_mean(variances, n)
    squared = _gaussian_interval(along, shrunk, n, confidence) if gaussian else None
    if squared is not None and sampling.share == 1.0:
        return Radius(radius, squared.root(), shape=shape_of(along, shrunk))
    by_mean, by_covariance = squared_quantile_gradient(radius, along, variances)
    influence = np.empty(errors.shape[1])
    for start in range(0, influence.size, BLOCK):
        block = slice(start, start + BLOCK)
        principal = axes.T @ errors[:, block] - along[:, None]
        influence[block] = np.einsum("in,in->n", principal, by_covariance @ principal) + by_mean @ principal
    influence += radius**2 - float(np.diag(by_covariance) @ variances)
    resampled = sampling.mean_interval(influence, confidence, positive=True)
    interval = resampled if squared is None else squared.wider(resampled)
    return Radius(radius, interval.root(), shape=shape_of(along, shrunk))


def _gaussian_interval(along: Array, variances: Array, n: float, confidence: float) -> Interval:
    """Return the interval of the squared radius from its first-order variance, over mean and covariance."""
    radius = length_quantile(PROBABILITY, along, variances)
    by_mean, by_covariance = squared_quantile_gradient(radius, along, variances)
    weighted = by_covariance * variances
    variance = (2.0 * float(np.sum(weighted * weighted.T)) + float(by_mean**2 @ variances)) / n
    return chi2_interval(radius**2, 2.0 * radius**4 / variance, confidence, _METHOD)
