"""Visits: arrivals of the arm, each measured in a row per target."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.measurements import Measurements


def visit_numbers(data: Measurements) -> NDArray[np.int64]:
    """Return ``(N,)`` the number of the visit of each row, from 0.

    Rows with the same commanded pose and cycle are a visit. Without cycles, each repetition of a target at a pose is a
    separate visit.
    """
    if data.target is None:
        return np.arange(data.n)
    poses = data.groups()
    if data.cycle is not None:
        return _numbered(poses, data.cycle)
    return _numbered(poses, _rank_among_equals(_numbered(poses, data.target)))


def _numbered(*columns: NDArray[Any]) -> NDArray[np.int64]:
    """Return the number of each row's combination of values."""
    codes = np.stack([np.unique(column, return_inverse=True)[1] for column in columns])
    return np.unique(codes, axis=1, return_inverse=True)[1].ravel().astype(np.int64)


def _rank_among_equals(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how many rows before each row have the same number."""
    order = np.argsort(numbers, kind="stable")
    ordered = numbers[order]
    start = np.searchsorted(ordered, ordered)
    rank = np.empty(numbers.size, dtype=np.int64)
    rank[order] = np.arange(numbers.size) - start
    return rank
