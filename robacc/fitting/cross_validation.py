"""Poses held out in turn, so that every pose gets an error from a model it had no part in."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.solver import Fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.observation import residuals

LEAST_GROUPS = 6
"""Commanded poses below which nothing is held out: a fifth of them says nothing."""


def folds(data: Measurements, count: int, seed: int) -> NDArray[np.int64] | None:
    """``(N,)`` number of the fold that holds each row out; None where there are too few poses.

    Repeats of one commanded pose stay together. A pose's fold depends on the pose and the seed, not on the order of
    rows.
    """
    groups = data.groups()
    total = int(groups.max(initial=-1)) + 1
    if total < LEAST_GROUPS or count < 2:
        return None
    order = np.random.default_rng(seed).permutation(total)
    assigned: NDArray[np.int64] = (order % min(count, total)).astype(np.int64)[groups]
    return assigned


def parts(assigned: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
    """For each fold the rows to learn from and the rows held out."""
    for number in range(int(assigned.max()) + 1):
        yield assigned != number, assigned == number


def held_out(found: Fit, data: Measurements) -> Array:
    """``(M, N)`` residuals of poses that the fit has not seen."""
    return residuals(data, found.model.bind(data).poses(found.theta))
