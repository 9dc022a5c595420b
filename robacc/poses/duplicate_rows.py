"""Rows of a pose file that repeat an earlier one to the last digit."""

from __future__ import annotations

import math

import numpy as np

from robacc.poses.checks import Values


def copies(values: Values, file: str) -> list[str]:
    """A warning where rows repeat an earlier one in every column in use, as noise hardly ever does."""
    if values.lines.size < 2:
        return []
    # Equal rows have equal sums, term by term: of the others, which are nearly all, nothing more is compared.
    sums = np.zeros(values.lines.size)
    for number, row in enumerate(values.numbers, 2):
        sums += math.sqrt(number) * row
    ordered = np.sort(sums)
    if not np.any(ordered[1:] == ordered[:-1]):
        return []
    order = np.argsort(sums, kind="stable")
    alike = np.flatnonzero(sums[order][1:] == sums[order][:-1])
    first, second = order[alike], order[alike + 1]
    same = (values.numbers[:, first] == values.numbers[:, second]).all(axis=0)
    for text in values.texts.values():
        same &= text[first] == text[second]
    if not same.any():
        return []
    i = int(np.argmax(same))
    one, other = int(values.lines[first[i]]), int(values.lines[second[i]])
    count = int(np.count_nonzero(same))
    rows = f"{count} row{'s repeat' if count > 1 else ' repeats'} an earlier one in every column"
    return [
        f"{file}: {rows}, as line {other} does line {one}; a copy counts as a measurement, so delete it if it is one"
    ]
