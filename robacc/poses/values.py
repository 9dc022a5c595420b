"""Values of the columns of a pose file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.poses.columns import AXES, QUATERNION
from robacc.poses.layout import Layout

COMMANDED_QUATERNION = tuple(f"cmd_{name}" for name in QUATERNION)
COMMANDED_AXES = tuple(f"cmd_{axis}" for axis in AXES)


@dataclass(frozen=True, slots=True)
class Values:
    """Values of the columns in use, SI."""

    layout: Layout
    numbers: Array
    """``(C, N)``; NaN where a value could not be read."""
    row_index: Mapping[str, int]
    """Row of ``numbers`` by key; the keys of a set are adjacent."""
    texts: Mapping[str, NDArray[np.str_]]
    lines: NDArray[np.int64]
    """``(N,)`` line of the file, from 1."""

    def column(self, key: str) -> Array | None:
        """Return one column ``(N,)``; None where the file does not have it."""
        return self.numbers[self.row_index[key]] if key in self.row_index else None

    def column_set(self, keys: Sequence[str]) -> Array | None:
        """Return a set of columns ``(len(keys), N)`` without copying; None where one of them is missing."""
        if not keys or any(key not in self.row_index for key in keys):
            return None
        start = self.row_index[keys[0]]
        return self.numbers[start : start + len(keys)]

    def complete(self) -> Values:
        """Return the rows in which every number could be read."""
        complete = np.isfinite(self.numbers).all(axis=0)
        texts = {key: text[complete] for key, text in self.texts.items()}
        return Values(self.layout, self.numbers[:, complete], self.row_index, texts, self.lines[complete])
