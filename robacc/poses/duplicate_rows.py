"""Rows of a pose file that repeat an earlier row to the last digit."""

from __future__ import annotations

import math

import numpy as np

from robacc.errors import Counted
from robacc.poses.values import Values

_OF_VISIT = frozenset(("pose", "cycle", "visit"))
"""Columns that number the visits; a measurement is a copy whatever its visit is called."""
_FEW = 0.1
"""Largest share of rows that repeat the measurement of another visit for these to be called copies."""


def duplicate_row_warnings(values: Values, file: str, counted: Counted) -> list[str]:
    """Return a warning where rows repeat an earlier row in every column in use, which noise hardly ever does."""
    if values.lines.size < 2:
        return []
    # Equal rows have equal sums, term by term; only rows with equal sums are compared in full.
    sums = np.zeros(values.lines.size)
    for number, row in enumerate(values.numbers, 2):
        sums += math.sqrt(number) * row
    ordered = np.sort(sums)
    if not np.any(ordered[1:] == ordered[:-1]):
        return []
    order = np.argsort(sums, kind="stable")
    equal_sums = np.flatnonzero(sums[order][1:] == sums[order][:-1])
    first, second = order[equal_sums], order[equal_sums + 1]
    equal = (values.numbers[:, first] == values.numbers[:, second]).all(axis=0)
    same_visit = np.ones_like(equal)
    for name, text in values.texts.items():
        agrees = text[first] == text[second]
        if name in _OF_VISIT:
            same_visit &= agrees
        else:
            equal &= agrees
    duplicate = equal & same_visit
    where = "in every column"
    if not duplicate.any():
        # Rounded values of many visits repeat by chance; a few to the last digit are copies.
        if not 0 < np.count_nonzero(equal) <= _FEW * values.lines.size:
            return []
        duplicate, where = equal, "of another visit to the last digit"
    i = int(min(np.flatnonzero(duplicate), key=lambda pair: values.lines[second[pair]]))
    original, copy = int(values.lines[first[i]]), int(values.lines[second[i]])
    count = int(np.count_nonzero(duplicate))
    rows = f"{count} row{'s repeat' if count > 1 else ' repeats'} an earlier row {where}"
    example = f"{counted} {copy} repeats {counted} {original}"
    return [f"{file}: {rows} ({example}); every row counts as a measurement, so delete copies"]
