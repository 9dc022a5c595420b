"""Cross-validation: poses are held out in turn, so that each gets an error from a model fitted without it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.fit_result import Fit
from robacc.fitting.places import places
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.observation import residuals

LEAST_GROUPS = 6
"""Commanded poses that cross-validation needs at least."""


@dataclass(frozen=True, slots=True)
class HoldOut:
    """Poses that a fit is judged on: validation poses, or each fold of its own poses in turn."""

    validation: Measurements | None = None
    """Validation poses; None: cross-validation."""
    n_folds: int = 5
    seed: int = 0
    """Seed of the assignment of poses to folds."""

    def folds(self, data: Measurements) -> NDArray[np.int64] | None:
        """Return ``(N,)`` the number of the fold that holds each row out; None if there are too few poses."""
        return folds(data, self.n_folds, self.seed)


def folds(data: Measurements, count: int, seed: int) -> NDArray[np.int64] | None:
    """Return ``(N,)`` the number of the fold that holds each row out; None if there are too few poses.

    Repeats of one commanded pose stay together, and so do poses of one place (:mod:`robacc.fitting.places`). A pose's
    fold depends on the pose and the seed, not on the order of rows.
    """
    groups = places(data)
    total = int(groups.max(initial=-1)) + 1
    if total < LEAST_GROUPS or count < 2:
        return None
    order = np.random.default_rng(seed).permutation(total)
    assigned: NDArray[np.int64] = (order % min(count, total)).astype(np.int64)[groups]
    return assigned


def parts(assigned: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
    """Yield for each fold the rows to fit and the held-out rows."""
    for number in range(int(assigned.max()) + 1):
        yield assigned != number, assigned == number


def held_out(fit: Fit, data: Measurements) -> Array:
    """Return ``(M, N)`` residuals of held-out poses."""
    return residuals(data, fit.predict(data))
