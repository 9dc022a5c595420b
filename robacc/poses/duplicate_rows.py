"""Rows of a pose file that repeat an earlier row to the last digit."""

from __future__ import annotations

import math

import numpy as np

from robacc.errors import Counted
from robacc.poses.values import Values


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
    duplicate = (values.numbers[:, first] == values.numbers[:, second]).all(axis=0)
    for text in values.texts.values():
        duplicate &= text[first] == text[second]
    if not duplicate.any():
        return []
    i = int(np.argmax(duplicate))
    original, copy = int(values.lines[first[i]]), int(values.lines[second[i]])
    count = int(np.count_nonzero(duplicate))
    rows = f"{count} row{'s repeat' if count > 1 else ' repeats'} an earlier row in every column"
    example = f"{counted} {copy} repeats {counted} {original}"
    return [f"{file}: {rows} ({example}); every row counts as a measurement, so delete copies"]
