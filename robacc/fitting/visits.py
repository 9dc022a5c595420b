"""Visits: arrivals of the arm, each measured in one row or several."""

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
