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
    """Return the fit with ``covariance`` ``(K, K)`` of its K identifiable coefficients."""
    columns = fit.identifiability.columns
    whole = fit.covariance.copy()
    whole[np.ix_(columns, columns)] = covariance
    return dataclasses.replace(fit, covariance=whole)


def with_added_covariance(fit: Fit, added: Array) -> Fit:
    """Return the fit with ``added`` ``(K, K)`` in its covariance, of a further, independent source."""
    columns = fit.identifiability.columns
    return with_covariance(fit, fit.covariance[np.ix_(columns, columns)] + added)
