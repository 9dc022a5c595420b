"""Correlation of the residuals of neighbouring poses: structure that no candidate describes.

Independent errors have products of zero mean. The sum of the products of neighbours, over the root of the sum of their
squares, is then a standard Gaussian to good accuracy from some tens of pairs, whatever the errors' own distribution (a
self-normalised sum; V. H. de la Peña, T. L. Lai, Q.-M. Shao, Self-Normalized Processes, 2009). In the order of time
that is the test of J. von Neumann, "Distribution of the ratio of the mean square successive difference to the
variance" (1941); between neighbours in space it is P. A. P. Moran's ("Notes on continuous stochastic phenomena", 1950).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.fit_result import Fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.statistics.distributions import normal_cdf

SIGNIFICANCE = 1e-4
"""Largest p-value of a correlation that is reported; small, since its cause is unknown."""
_LEAST_PAIRS = 30
"""Pairs from which the sum is close to Gaussian."""
_MOST_ROWS = 4000
"""Rows that are searched for neighbours at most."""
_BLOCK = 256
"""Rows whose distances to all others are held in memory at a time."""
_IN_TIME = "the remaining errors of successive poses are correlated: there is a drift or a step change"
_IN_SPACE = (
    "the remaining errors of neighbouring targets are correlated: they depend on position, and no candidate explains it"
)


@dataclass(frozen=True, slots=True)
class ResidualCorrelation:
    """Correlation of the remaining errors of neighbouring poses."""

    p_value: float
    text: str


def residual_correlations(fit: Fit, data: Measurements) -> tuple[ResidualCorrelation, ...]:
    """Return the significant correlations of neighbours in time and in space in the residual of the inliers.

    Rows of one commanded pose are averaged, since its repeatability is no correlation of neighbours.
    """
    rows = np.flatnonzero(fit.inliers)[:_MOST_ROWS]
    groups = np.unique(data.groups()[rows], return_inverse=True)[1]
    count = np.bincount(groups)

    def mean(values: Array) -> Array:
        return np.stack([np.bincount(groups, weights=row) / count for row in values])

    residual = mean(fit.residual[:3, rows])
    size = np.sqrt(np.mean(np.square(residual), axis=1, keepdims=True))
    residual = residual / np.where(size > 0, size, 1.0)
    time = mean((rows.astype(float) if data.time is None else data.time[rows])[None])[0]
    tests = ((time_neighbours(time), _IN_TIME), (space_neighbours(mean(data.position[:, rows])), _IN_SPACE))
    correlations = (ResidualCorrelation(correlation_p_value(residual, pairs), text) for pairs, text in tests)
    return tuple(correlation for correlation in correlations if correlation.p_value <= SIGNIFICANCE)


def time_neighbours(time: Array) -> NDArray[np.int64]:
    """Return ``(2, K)`` pairs: each pose with the next."""
    order = np.argsort(time, kind="stable")
    return np.stack((order[:-1], order[1:]))


def space_neighbours(position: Array) -> NDArray[np.int64]:
    """Return ``(2, K)`` pairs: each pose with that of the nearest target, every pair once.

    All distances are compared: for :data:`_MOST_ROWS` poses that is faster than the import of a spatial tree.
    """
    n = position.shape[1]
    if n < _LEAST_PAIRS:
        return np.empty((2, 0), dtype=np.int64)
    index, nearest = np.arange(n), np.empty(n, dtype=np.int64)
    for start in range(0, n, _BLOCK):
        rows = index[start : start + _BLOCK]
        square = np.sum(np.square(position[:, rows, None] - position[:, None]), axis=0)
        square[rows - start, rows] = np.inf
        nearest[rows] = np.argmin(square, axis=1)
    return np.unique(np.sort(np.stack((index, nearest)), axis=0), axis=1)


def correlation_p_value(residual: Array, pairs: NDArray[np.int64]) -> float:
    """Return the probability of a correlation this large for independent residuals ``(3, N)`` of these pairs."""
    products = np.einsum("in,in->n", residual[:, pairs[0]], residual[:, pairs[1]])
    root_sum_square = float(np.sqrt(np.sum(np.square(products))))
    if products.size < _LEAST_PAIRS or root_sum_square == 0.0:
        return 1.0
    return normal_cdf(-float(np.sum(products)) / root_sum_square)
