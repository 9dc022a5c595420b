"""scipy's answer to the problem that a fit has solved."""

from typing import Any

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from robacc.fitting.fit_result import Fit
from robacc.fitting.outliers import row_weights
from robacc.measurements import Measurements
from robacc.modelling.model import observed_jacobian, residuals


def by_scipy(found: Fit, data: Measurements, noise: float, **options: Any) -> tuple[OptimizeResult, np.ndarray]:
    """The coefficients that the poses tell apart, from the registered start with the exact Jacobian, and their units.

    The fit's priors are rows of their own.

    scipy judges its steps in units of the coefficients, which differ by 1e5: each gets its standard error for one.
    """
    kept, bound, weight = found.identifiability.columns, found.model.bind(data), row_weights(data, (noise, noise))
    size = np.sqrt(np.diag(found.covariance))[kept]

    prior = np.sqrt(found.precision) * size

    def whole(x: np.ndarray) -> np.ndarray:
        theta = np.zeros(len(bound.terms))
        theta[kept] = x * size
        return theta

    def residual(x: np.ndarray) -> np.ndarray:
        return np.append((residuals(data, bound.poses(whole(x))) * weight).ravel(), prior * x)

    def jacobian(x: np.ndarray) -> np.ndarray:
        poses, columns = bound.linearise(whole(x))
        seen = observed_jacobian(columns, residuals(data, poses))[:, kept] * weight[:, None, :]
        return np.vstack((-np.moveaxis(seen, 1, 2).reshape(-1, kept.size) * size, np.diag(prior)))

    return least_squares(residual, np.zeros(kept.size), jacobian, **options), size
