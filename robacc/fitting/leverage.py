"""Leverage: the share of a row in its own prediction."""

from __future__ import annotations

import numpy as np

from robacc.chain import BLOCK
from robacc.fitting.fit_result import Fit
from robacc.fitting.linear_algebra import posterior
from robacc.measurements import Measurements

_HIGH_LEVERAGE = 0.5
"""Share of a row in its own prediction above which the row is reported."""


def high_leverage(fit: Fit, data: Measurements) -> tuple[tuple[int, float], ...]:
    """Return the rows with high leverage: index and mean diagonal of the hat matrix over the components."""
    identifiable = fit.identifiability.columns
    if identifiable.size == 0:
        return ()
    inverse = posterior(fit.gram, fit.precision)
    share = np.empty(data.n)
    for start in range(0, data.n, BLOCK):
        block = slice(start, start + BLOCK)
        _, jacobian = fit.model.bind(data.subset(block)).linearise(fit.theta, identifiable, fit.residual.shape[0])
        columns = jacobian * fit.weight[:, None, block]
        share[block] = np.einsum("mpn,pq,mqn->n", columns, inverse, columns) / fit.residual.shape[0]
    high = np.flatnonzero((share > _HIGH_LEVERAGE) & fit.inliers)
    return tuple((int(row), float(share[row])) for row in high[np.argsort(-share[high])])
