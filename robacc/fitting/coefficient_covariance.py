"""Covariance of a fit's coefficients under errors that are not independent and equal."""

from __future__ import annotations

import dataclasses

import numpy as np

from robacc.fitting.fit_result import Fit
from robacc.fitting.linear_algebra import posterior
from robacc.geometry import Array


def sandwich(gram: Array, meat: Array, precision: Array) -> Array:
    """Return ``(K, K)`` covariance G^-1 (M + P) G^-1, G = X^T X + P.

    Args:
        gram: ``(K, K)`` X^T X of the whitened columns.
        meat: ``(K, K)`` M = X^T R X, R the covariance of the whitened errors.
        precision: ``(K,)`` diagonal of the priors' precision P.
    """
    inverse = posterior(gram, precision)
    result: Array = inverse @ (meat + np.diag(precision)) @ inverse
    return result


def with_covariance(fit: Fit, covariance: Array) -> Fit:
    """Return the fit with the correlations of ``covariance`` ``(K, K)``, and the larger of both variances of each.

    K coefficients are identifiable. Neither estimate of a variance claims more than the other.
    """
    usual = np.diag(fit.covariance)[fit.identifiability.columns]
    factor = np.sqrt(np.maximum(usual / np.maximum(np.diag(covariance), 1e-300), 1.0))
    return _replaced(fit, covariance * factor[:, None] * factor)


def with_variances(fit: Fit, variance: Array) -> Fit:
    """Return the fit with the larger of its own variances and ``variance`` ``(K,)``; correlations stay as they are."""
    usual = np.diag(fit.covariance)[fit.identifiability.columns]
    return with_factors(fit, np.sqrt(np.maximum(variance / np.maximum(usual, 1e-300), 1.0)))


def with_factors(fit: Fit, factor: Array) -> Fit:
    """Return the fit with standard errors times ``factor`` ``(K,)``; correlations stay as they are."""
    columns = fit.identifiability.columns
    return _replaced(fit, fit.covariance[np.ix_(columns, columns)] * factor[:, None] * factor)


def with_added_covariance(fit: Fit, added: Array) -> Fit:
    """Return the fit with ``added`` ``(K, K)`` in its covariance, of a further, independent source."""
    columns = fit.identifiability.columns
    return _replaced(fit, fit.covariance[np.ix_(columns, columns)] + added)


def _replaced(fit: Fit, identifiable: Array) -> Fit:
    columns = fit.identifiability.columns
    covariance = fit.covariance.copy()
    covariance[np.ix_(columns, columns)] = identifiable
    return dataclasses.replace(fit, covariance=covariance)
