"""Whether residuals of poses next to each other are alike: structure that shows though nothing tried describes it.

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

from robacc.fitting.solver import Fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.statistics.distributions import normal_cdf

GROSS = 1e-4
"""Below this a similarity of neighbours is told: what is grossly left, since nothing says what it would be."""
_FEWEST = 30
"""Pairs from which the sum is near enough to Gaussian."""
_MOST = 4000
"""Rows among which neighbours are sought."""
_IN_TIME = "what is left of a pose is like that of the next one measured: something drifts, or jumped"
_IN_SPACE = "what is left is alike where targets are near each other: it depends on the place, as nothing tried does"


@dataclass(frozen=True, slots=True)
class ResidualCorrelation:
    """That what is left is alike at poses next to each other."""

    p_value: float
    text: str


def residual_correlations(found: Fit, data: Measurements) -> tuple[ResidualCorrelation, ...]:
    """What neighbours in time, and in space, have in common in the residual of the rows that took part.

    Rows of one commanded pose count as one, by their mean: its own repeatability is no similarity of neighbours.
    """
    rows = np.flatnonzero(found.inliers)[:_MOST]
    groups = np.unique(data.groups()[rows], return_inverse=True)[1]
    count = np.bincount(groups)

    def mean(values: Array) -> Array:
        return np.stack([np.bincount(groups, weights=row) / count for row in values])

    residual = mean(found.residual[:3, rows])
    size = np.sqrt(np.mean(np.square(residual), axis=1, keepdims=True))
    residual = residual / np.where(size > 0, size, 1.0)
    clock = mean((rows.astype(float) if data.time is None else data.time[rows])[None])[0]
    tests = ((_in_time(clock), _IN_TIME), (_in_space(mean(data.position[:, rows])), _IN_SPACE))
    judged = (ResidualCorrelation(_p_value(residual, pairs), text) for pairs, text in tests)
    return tuple(one for one in judged if one.p_value <= GROSS)


def _in_time(clock: Array) -> NDArray[np.int64]:
    """``(2, K)``: each pose with the next."""
    order = np.argsort(clock, kind="stable")
    return np.stack((order[:-1], order[1:]))


def _in_space(position: Array) -> NDArray[np.int64]:
    """``(2, K)``: each pose with the one whose target was nearest to its own, every pair once."""
    from scipy.spatial import cKDTree

    if position.shape[1] < _FEWEST:
        return np.empty((2, 0), dtype=np.int64)
    nearest = np.asarray(cKDTree(position.T).query(position.T, 2)[1], dtype=np.int64)
    # Of targets at the very same place either may come first.
    own = np.arange(position.shape[1])
    other = np.where(nearest[:, 0] == own, nearest[:, 1], nearest[:, 0])
    return np.unique(np.sort(np.stack((own, other)), axis=0), axis=1)


def _p_value(residual: Array, pairs: NDArray[np.int64]) -> float:
    """Chance that independent residuals ``(3, N)`` of these pairs are so much alike."""
    products = np.einsum("in,in->n", residual[:, pairs[0]], residual[:, pairs[1]])
    spread = float(np.sqrt(np.sum(np.square(products))))
    if products.size < _FEWEST or spread == 0.0:
        return 1.0
    return normal_cdf(-float(np.sum(products)) / spread)
