"""Standard errors of coefficients beside errors as they are: correlated, unequal, with a scatter that is estimated."""

from __future__ import annotations

from robacc.fitting.correlated_errors import correlated_errors, with_correlated_errors
from robacc.fitting.fit_result import Fit
from robacc.fitting.uncertain_scatter import with_uncertain_scatter
from robacc.fitting.unequal_errors import with_unequal_errors
from robacc.measurements import Measurements


def with_error_structure(fit: Fit, data: Measurements) -> tuple[Fit, tuple[str, ...]]:
    """Return the fit with standard errors that allow for the structure of its errors, and a warning of correlated ones.

    Correlated and unequal errors give the larger of two variances; both are there without the uncertainty of the
    scatter, which multiplies them.
    """
    correlated = correlated_errors(fit, data)
    allowed = with_unequal_errors(with_correlated_errors(fit, correlated), data)
    return with_uncertain_scatter(allowed, data), () if correlated is None else (correlated.warning,)
