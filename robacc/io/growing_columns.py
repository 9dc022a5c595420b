"""Columns of numbers that grow while a file is read."""

from __future__ import annotations

import numpy as np

from robacc.geometry import Array


class GrowingColumns:
    """``(C, N)`` numbers in one array, where N is known only at the end of the file.

    The array grows to the size that the share of the file read so far suggests. Pages that are never written cost
    nothing, while joining parts at the end would touch all of the memory twice.
    """

    def __init__(self, n_columns: int) -> None:
        """Begin with no rows of ``n_columns`` numbers."""
        self._numbers = np.empty((n_columns, 0))
        self._size = 0

    def append(self, part: Array, share: float) -> None:
        """Add rows; ``share`` is the share of the file (0 to 1) read so far."""
        end = self._size + part.shape[1]
        if end > self._numbers.shape[1]:
            larger = np.empty((len(part), max(int(end / share * 1.02), end)))
            larger[:, : self._size] = self._numbers[:, : self._size]
            self._numbers = larger
        self._numbers[:, self._size : end] = part
        self._size = end

    def columns(self) -> Array:
        """Return the numbers; each column is contiguous."""
        return self._numbers[:, : self._size]
