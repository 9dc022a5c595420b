"""Visits: arrivals of the arm, each measured in one row or several; and random parts of the poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robacc.measurements import Measurements
from robacc.poses.motion import numbered, rank_among_equals, visits_in_order


def visit_numbers(data: Measurements) -> NDArray[np.int64]:
    """Return ``(N,)`` the number of the visit of each row, from 0.

    The column ``visit`` decides. Without it, rows with the same commanded pose and cycle are a visit. Without cycles,
    each repetition of a target at a pose is a separate visit; where rows are in the order measured, only consecutive
    rows share a visit.
    """
    if data.visit is not None:
        return numbered(data.visit)
    if data.cycle is not None:
        return numbered(data.groups(), data.cycle)
    if data.target is None:
        return np.arange(data.n)
    poses = data.groups()
    if data.ordered:
        return visits_in_order(poses, None, None, data.target)
    return numbered(poses, rank_among_equals(numbered(poses, data.target)))


def random_rank(data: Measurements) -> NDArray[np.int64]:
    """Return ``(N,)`` a random rank of each row's commanded pose, whatever the order of the rows."""
    groups = data.groups()
    return np.random.default_rng(0).permutation(int(groups.max(initial=-1)) + 1)[groups]


def first_ranks(draw: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Return the numbers of the rows of the first ranks, at most ``most`` of them but all of one rank."""
    ranked = np.sort(draw)
    limit = ranked[max(most, 1) - 1] if most < ranked.size else ranked[-1] + 1
    chosen = np.flatnonzero(draw < limit)
    return chosen if chosen.size else np.flatnonzero(draw == ranked[0])


def random_rows(data: Measurements, most: int) -> NDArray[np.int64]:
    """Return the rows of random commanded poses, about ``most`` of them, in their order; all if there are no more."""
    return np.arange(data.n) if data.n <= most else first_ranks(random_rank(data), most)
