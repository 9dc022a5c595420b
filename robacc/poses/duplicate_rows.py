"""Rows of a pose file that repeat an earlier row to the last digit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.errors import Counted
from robacc.geometry import Array
from robacc.poses.columns import AXES, QUATERNION, ROTATION_VECTOR, RPY
from robacc.poses.values import Values

_OF_VISIT = frozenset(("pose", "cycle", "visit"))
"""Columns that number the visits; a measurement is a copy whatever its visit is called."""
_FEW = 0.1
"""Largest share of rows that repeat the measurement of another visit for these to be called copies."""


_MEASURED = (*AXES, *QUATERNION, *ROTATION_VECTOR, *RPY)
_COARSE = 1e-5
"""m; positions rounded to this repeat by chance, since arms repeat within it."""
_CELL = 5e-6
"""m; size of the cells in which positions that nearly agree are counted."""
_NEAR_PER_EQUAL = 25.0
"""Pairs of a cell that differ, for each that is equal, from which equal ones are chance: five times fewer than noise
gives, at a resolution of 1 um."""


@dataclass(frozen=True, slots=True)
class DuplicateRows:
    """Rows that repeat an earlier row, or its measured values alone, which noise hardly ever does."""

    warnings: tuple[str, ...] = ()
    copies: NDArray[np.bool_] | None = None
    """``(N,)`` the later rows; None without any."""


def duplicate_rows(values: Values, file: str, counted: Counted) -> DuplicateRows:
    """Return the rows that repeat an earlier row, with a warning."""
    if values.lines.size < 2:
        return DuplicateRows()
    measured = values.numbers[[values.row_index[key] for key in _MEASURED if key in values.row_index]]
    same_measured = _equal_pairs(measured if len(measured) else values.numbers)
    if not same_measured[0].size:
        return DuplicateRows()
    first, second = _equal_pairs(values.numbers)
    equal = np.ones(first.size, dtype=bool)
    same_visit = equal.copy()
    for name, text in values.texts.items():
        agrees = text[first] == text[second]
        if name in _OF_VISIT:
            same_visit &= agrees
        else:
            equal &= agrees
    duplicate = equal & same_visit
    if duplicate.any():
        return _found(values, (first[duplicate], second[duplicate]), "an earlier row in every column", file, counted)
    # Rounded values of many visits repeat by chance; a few to the last digit are copies.
    if 0 < np.count_nonzero(equal) <= _FEW * values.lines.size:
        where = "an earlier row of another visit to the last digit"
        return _found(values, (first[equal], second[equal]), where, file, counted)
    if "x" in values.row_index and _are_copies(measured[:3], same_measured[0].size):
        return _found(values, same_measured, "the measured values of an earlier row to the last digit", file, counted)
    return DuplicateRows()


def _equal_pairs(numbers: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the numbers of pairs of rows with equal columns of ``numbers`` ``(C, N)``, the earlier row first."""
    # Equal rows have equal sums, term by term; only rows with equal sums are compared in full.
    sums = np.zeros(numbers.shape[1])
    for number, row in enumerate(numbers, 2):
        sums += math.sqrt(number) * row
    ordered = np.sort(sums)
    if not np.any(ordered[1:] == ordered[:-1]):
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    order = np.argsort(sums, kind="stable")
    equal_sums = np.flatnonzero(sums[order][1:] == sums[order][:-1])
    first, second = order[equal_sums], order[equal_sums + 1]
    equal = (numbers[:, first] == numbers[:, second]).all(axis=0)
    return first[equal], second[equal]


def _are_copies(position: Array, equal: int) -> bool:
    """Return whether ``equal`` pairs of equal positions ``(3, N)`` are too many for chance.

    By chance, many more pairs differ in the last digits than agree in all of them.
    """
    steps = position / _COARSE
    if np.count_nonzero(np.abs(steps - np.round(steps)) > 1e-4) < 0.5 * position.size:
        return False
    distinct = np.unique(position, axis=1)
    cells = np.unique(np.floor(distinct / _CELL), axis=1, return_counts=True)[1]
    near = float(np.sum(cells * (cells - 1)) / 2)
    return near < _NEAR_PER_EQUAL * equal


def _found(
    values: Values, pairs: tuple[NDArray[np.int64], NDArray[np.int64]], where: str, file: str, counted: Counted
) -> DuplicateRows:
    """Return the later rows of the pairs, and a warning with that whose copy comes first as the example."""
    first, second = pairs
    i = int(np.argmin(values.lines[second]))
    count = first.size
    rows = f"{count} row{'s repeat' if count > 1 else ' repeats'} {where}"
    example = f"{counted} {int(values.lines[second[i]])} repeats {counted} {int(values.lines[first[i]])}"
    copies = np.zeros(values.lines.size, dtype=bool)
    copies[second] = True
    warning = f"{file}: {rows} ({example}); every row counts as a measurement, so delete copies"
    return DuplicateRows((warning,), copies)
