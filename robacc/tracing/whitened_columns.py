"""Whitened columns of a model and of its candidates, and those of their products that are needed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array


class Columns:
    """Whitened columns over rows (components x poses), the residual, and products of columns as they are needed."""

    def __init__(self, columns: Array, residual: Array) -> None:
        """Store ``columns`` ``(M, C, N)`` and ``residual`` ``(M, N)``."""
        self.residual = residual
        self.rows = residual.size
        self.lengths: Array = np.einsum("mcn,mcn->c", columns, columns)
        """``(C,)`` squared lengths."""
        self.rhs: Array = np.einsum("mcn,mn->c", columns, residual)
        self.cost = float(residual.ravel() @ residual.ravel())
        self.count = columns.shape[1]
        """Number C of columns."""
        # Arrays are larger than what they hold, so that few columns are appended without a copy of all.
        self._columns = columns
        self._gram, self._known = np.zeros((self.count, self.count)), np.zeros((self.count, self.count), dtype=bool)

    @property
    def columns(self) -> Array:
        """Return the ``(M, C, N)`` columns."""
        return self._columns[:, : self.count]

    def append(self, columns: Array) -> NDArray[np.int64]:
        """Add ``(M, Q, N)`` columns and return their numbers."""
        first, self.count = self.count, self.count + columns.shape[1]
        self.lengths = np.concatenate((self.lengths, np.einsum("mqn,mqn->q", columns, columns)))
        self.rhs = np.concatenate((self.rhs, np.einsum("mqn,mn->q", columns, self.residual)))
        room = self.count + self.count // 2 - first if self.count > self._columns.shape[1] else 0
        if room:
            self._columns = np.concatenate(
                (self._columns[:, :first], np.empty((len(columns), room, self.residual.shape[1]))), 1
            )
            self._gram, self._known = (
                np.pad(matrix[:first, :first], ((0, room), (0, room))) for matrix in (self._gram, self._known)
            )
        self._columns[:, first : self.count] = columns
        numbers = np.arange(first, self.count)
        # With these, rows of products that are known stay complete.
        self.products(numbers)
        return numbers

    def products(self, numbers: NDArray[np.int64]) -> Array:
        """Return ``(A, C)`` products of some columns with all columns."""
        known, gram = self._known[: self.count, : self.count], self._gram[: self.count, : self.count]
        missing = numbers[~known[numbers].all(axis=1)]
        if missing.size:
            products = np.sum([part[missing] @ part.T for part in self.columns], axis=0)
            gram[missing], gram[:, missing] = products, products.T
            known[missing] = known[:, missing] = True
        return gram[numbers]

    def blocks(self, columns: NDArray[np.int64]) -> Array:
        """Return ``(B, Q, Q)`` Gram matrices of B times Q columns."""
        missing = columns[~self._known[columns[:, :, None], columns[:, None, :]].all(axis=(1, 2))]
        if missing.size:
            count, size = missing.shape
            part = np.moveaxis(self._columns[:, missing], 0, 2).reshape(count, size, -1)
            pairs = missing[:, :, None], missing[:, None, :]
            self._gram[pairs], self._known[pairs] = part @ np.swapaxes(part, 1, 2), True
        return self._gram[columns[:, :, None], columns[:, None, :]]
