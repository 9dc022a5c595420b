"""The pool's candidates in batches of like size, which are scored together."""

from __future__ import annotations

import bisect
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.tracing.candidates import Candidate
from robacc.tracing.conditioned_columns import Conditioned
from robacc.tracing.evidence import Scores, judge

_SIZES = (1, 2, 3, 4, 9)
"""Numbers of columns up to which candidates are scored together; those with more are scored together too."""


@dataclass(frozen=True, eq=False, slots=True)
class PoolBatch:
    """Candidates of the pool that are scored together; smaller candidates have additional columns of weight zero."""

    members: tuple[int, ...]
    """Numbers of B candidates."""
    columns: NDArray[np.int64]
    """``(B, Q)`` columns of each."""
    weights: Array
    """``(B, Q)``"""
    products: Array
    """``(B, Q, Q)`` products of the weights."""
    shrunk: NDArray[np.bool_]

    @classmethod
    def of(cls, pool: Sequence[Candidate], places: Sequence[NDArray[np.int64]], members: Sequence[int]) -> PoolBatch:
        """Join candidates ``members`` of the pool."""
        size = max(places[i].size for i in members)
        columns = np.empty((len(members), size), dtype=np.int64)
        weights = np.zeros((len(members), size))
        for row, i in enumerate(members):
            count = places[i].size
            columns[row, :count], columns[row, count:] = places[i], places[i][-1]
            weights[row, :count] = pool[i].weights
        products = weights[:, :, None] * weights[:, None, :]
        return cls(tuple(members), columns, weights, products, np.array([pool[i].is_block for i in members]))

    def judge(self, conditioned: Conditioned) -> Scores:
        """Return the scores of the candidates given a model."""
        return judge(
            conditioned.blocks(self.columns) * self.products,
            conditioned.rhs[self.columns] * self.weights,
            conditioned.system.lengths[self.columns] * np.square(self.weights),
            conditioned.cost,
            conditioned.dof,
            self.shrunk,
        )


def pool_batches(
    pool: Sequence[Candidate], places: Sequence[NDArray[np.int64]], members: Iterable[int]
) -> list[PoolBatch]:
    """Return ``members`` of the pool in batches; ``places`` are the columns of each candidate in the system."""
    sizes: dict[int, list[int]] = {}
    for i in members:
        sizes.setdefault(bisect.bisect_left(_SIZES, places[i].size), []).append(i)
    return [PoolBatch.of(pool, places, batch) for batch in sizes.values()]
