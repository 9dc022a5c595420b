"""Columns and errors of a fit at some of its rows, whitened."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.fit_result import Fit
from robacc.geometry import Array
from robacc.measurements import Measurements


def whitened_rows(fit: Fit, data: Measurements, rows: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return whitened columns ``(M, K, n)`` of the identifiable coefficients, and errors ``(M, n)``, of n ``rows``."""
    _, jacobian = fit.model.bind(data.subset(rows)).linearise(
        fit.theta, fit.identifiability.columns, fit.residual.shape[0]
    )
    white = fit.whitening.subset(rows)
    columns = white.apply(np.moveaxis(jacobian, 1, 0))
    return np.moveaxis(columns, 0, 1), white.apply(fit.residual[:, rows])
