"""Variance between and within commanded poses: the dependence of errors that equation (13) ignores.

Wu and Lee's equation (13) sums over errors as if they were independent draws. Errors of one robot come from one set of
parameter errors, so they vary with the pose and not at random; only repetitions of a pose show the random part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array

SHARED = (
    "all poses share the parameter errors of one robot, so they are not independent draws: the intervals hold for "
    "other poses of this robot, chosen in the same manner, not for other robots"
)


@dataclass(frozen=True, slots=True)
class PoseStructure:
    """Components of the errors' variance (sum over x, y, z) between and within commanded poses."""

    n: int
    n_poses: int
    """Commanded poses."""
    between: float | None
    """Variance over poses of a commanded pose's mean error, m^2 or rad^2."""
    within: float | None
    """Variance of one repetition about the mean error of its pose."""
    intraclass_correlation: float | None
    """between / (between + within)"""
    effective_poses: float | None
    """Independent poses with the same uncertainty of the mean: n / (1 + (k - 1) ICC), k repetitions a pose."""
    text: str
    why: str | None = None


def pose_structure(errors: Array, groups: NDArray[np.int64] | None) -> PoseStructure:
    """Analyse the variance of errors ``(3, N)`` over commanded poses ``groups`` ``(N,)``, one-way random effects.

    Source: S. R. Searle, G. Casella, C. E. McCulloch, Variance Components (1992), 3.6 (unequal numbers); effective
    number by L. Kish, Survey Sampling (1965), 5.4.
    """
    n = errors.shape[1]
    sizes = np.ones(n) if groups is None else np.bincount(groups).astype(float)
    number = int(sizes.size)
    if groups is None or number == n or number == 1:
        if number == 1 and n > 1:
            why = "all rows are of one commanded pose"
            text = f"{why}: the scatter is repeatability and does not describe other poses"
        else:
            why = "no commanded pose was repeated"
            text = f"{why}, so repeatability cannot be separated from errors that depend on the pose; {SHARED}"
        return PoseStructure(n, number, None, None, None, None, text, why)
    centred = errors - np.mean(errors, axis=1)[:, None]
    sums = np.stack([np.bincount(groups, weights=component) for component in centred])
    explained = float(np.sum(np.sum(np.square(sums), axis=0) / sizes))
    total = float(np.sum(np.square(centred)))
    within = max(total - explained, 0.0) / (n - number)
    typical_size = (n - float(np.sum(np.square(sizes))) / n) / (number - 1)
    between = max(0.0, (explained / (number - 1) - within) / typical_size)
    if between + within <= 0.0:
        why = "the errors do not scatter"
        return PoseStructure(n, number, between, within, None, None, f"{why}; {SHARED}", why)
    correlation = between / (between + within)
    # Kish's mean number of repetitions weights each pose by its number of rows.
    effective = n / (1.0 + (float(np.sum(np.square(sizes))) / n - 1.0) * correlation)
    text = (
        f"{n} rows of {number} commanded poses: {100 * correlation:.1f} % of the variance is between poses and "
        f"{100 * (1 - correlation):.1f} % within, equivalent to {effective:.3g} independent poses; {SHARED}"
    )
    return PoseStructure(n, number, between, within, correlation, effective, text)
