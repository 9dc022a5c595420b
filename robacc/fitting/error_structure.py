"""Fit and standard errors that allow for shared, correlated and unequal errors, and for uncertain scatter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from robacc.fitting.coefficient_covariance import with_variances
from robacc.fitting.correlated_errors import correlated_errors, with_correlated_errors
from robacc.fitting.fit_result import AddedVariance, Fit
from robacc.fitting.shared_errors import with_shared_errors
from robacc.fitting.uncertain_scatter import with_uncertain_scatter
from robacc.fitting.unequal_errors import with_unequal_errors
from robacc.geometry import Array
from robacc.measurements import Measurements


@dataclass(frozen=True, slots=True)
class StructuredFit:
    """Fit that allows for the structure of its errors."""

    fit: Fit
    added: AddedVariance | None
    """Variance that was added in its weights for errors that poses share; None if it is as fitted before."""
    predicting: Fit
    """The same fit with the covariance for predictions, without errors that poses share: held-out poses show these."""
    inflation: Array
    """``(P,)`` variance of each coefficient over that for independent, equal errors, at least 1."""
    shared: tuple[str, ...]
    """Sentence on errors that poses share where that is evident: an effect remains that the model lacks."""
    warnings: tuple[str, ...]
    """Other sentences for readers of the result."""


def with_error_structure(fit: Fit, data: Measurements, priors: Array | None = None) -> StructuredFit:
    """Return the fit with weights and standard errors that allow for the structure of its errors.

    Correlated and unequal errors give the larger of two variances; both are there without the uncertainty of the
    scatter, which multiplies them. Errors that poses share lower the weights, and no variance becomes smaller.

    ``priors`` ``(P,)`` are the given prior standard deviations of the fit, as in its options.
    """
    correlated = correlated_errors(fit, data)
    allowed = with_uncertain_scatter(with_unequal_errors(with_correlated_errors(fit, correlated), data), data)
    warnings = () if correlated is None else (correlated.warning,)
    beside = with_shared_errors(fit, data, priors)
    if beside is None:
        return StructuredFit(allowed, None, allowed, _inflation(fit, allowed), (), warnings)
    columns = beside.fit.identifiability.columns
    usual = np.nan_to_num(np.diag(allowed.covariance)[columns])
    structured = predicting = with_variances(beside.fit, usual)
    if np.array_equal(columns, fit.identifiability.columns):
        predicting = replace(structured, covariance=allowed.covariance)
    inflation = _inflation(fit, structured)
    return StructuredFit(structured, beside.added, predicting, inflation, beside.warnings, warnings)


def _inflation(before: Fit, after: Fit) -> Array:
    """Return ``(P,)`` the variances after over those before, at least 1; 1 where one of them is not known."""
    old, new = np.diag(before.covariance), np.diag(after.covariance)
    known = np.isfinite(old) & np.isfinite(new) & (old > 0.0)
    return np.maximum(np.where(known, new / np.where(known, old, 1.0), 1.0), 1.0)
