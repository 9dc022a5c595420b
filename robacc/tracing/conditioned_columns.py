"""Whitened columns of a model and of its candidates, orthogonalised to the model's.

The system holds whitened columns of the present model and of all candidates, and those of their products that are
needed. The new part of a candidate's columns is what the model cannot reproduce (a Schur complement).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.tracing.evidence import LEAST_NEW, Scores, judge


class Columns:
    """Whitened columns over rows (components x poses), the residual, and products of columns as they are needed."""

    def __init__(self, columns: Array, residual: Array) -> None:
        """Store ``columns`` ``(M, C, N)`` and ``residual`` ``(M, N)``."""
        self.columns = columns
        self.residual = residual
        self.rows = residual.size
        self.lengths: Array = np.einsum("mcn,mcn->c", columns, columns)
        """``(C,)`` squared lengths."""
        self.rhs: Array = np.einsum("mcn,mn->c", columns, residual)
        self.cost = float(residual.ravel() @ residual.ravel())
        count = columns.shape[1]
        self._gram, self._known = np.zeros((count, count)), np.zeros((count, count), dtype=bool)

    def append(self, columns: Array) -> NDArray[np.int64]:
        """Add ``(M, Q, N)`` columns and return their numbers."""
        first, count = self.columns.shape[1], columns.shape[1]
        self.lengths = np.concatenate((self.lengths, np.einsum("mqn,mqn->q", columns, columns)))
        self.rhs = np.concatenate((self.rhs, np.einsum("mqn,mn->q", columns, self.residual)))
        self.columns = np.concatenate((self.columns, columns), axis=1)
        self._gram, self._known = (np.pad(matrix, ((0, count), (0, count))) for matrix in (self._gram, self._known))
        numbers = np.arange(first, first + count)
        # With these, rows of products that are known stay complete.
        self.products(numbers)
        return numbers

    def products(self, numbers: NDArray[np.int64]) -> Array:
        """Return ``(A, C)`` products of some columns with all columns."""
        missing = numbers[~self._known[numbers].all(axis=1)]
        if missing.size:
            products = np.sum([part[missing] @ part.T for part in self.columns], axis=0)
            self._gram[missing], self._gram[:, missing] = products, products.T
            self._known[missing] = self._known[:, missing] = True
        return self._gram[numbers]

    def blocks(self, columns: NDArray[np.int64]) -> Array:
        """Return ``(B, Q, Q)`` Gram matrices of B times Q columns."""
        missing = columns[~self._known[columns[:, :, None], columns[:, None, :]].all(axis=(1, 2))]
        if missing.size:
            count, size = missing.shape
            part = np.moveaxis(self.columns[:, missing], 0, 2).reshape(count, size, -1)
            pairs = missing[:, :, None], missing[:, None, :]
            self._gram[pairs], self._known[pairs] = part @ np.swapaxes(part, 1, 2), True
        return self._gram[columns[:, :, None], columns[:, None, :]]


class Conditioned:
    """All columns and the residual, orthogonalised to a model's columns.

    A model that lacks some columns of a larger one (:meth:`without`) is described by the directions of the larger model
    that it lacks: what these explain goes back to the columns and to the residual, which costs little for each column.
    """

    def __init__(
        self,
        system: Columns,
        active: NDArray[np.int64],
        precision: Array,
        root: Array,
        explained: Array,
        rank: int,
        reduced: Array | None = None,
        removed: tuple[Conditioned, Array] | None = None,
    ) -> None:
        """Store the parts; :meth:`on` computes them.

        Args:
            system: All columns.
            active: ``(A,)`` numbers of the model's columns.
            precision: ``(A,)`` precision of their priors, whitened, 0 for none.
            root: ``(A, R)``: root @ root.T is the inverse of the active columns' Gram matrix.
            explained: ``(R,)`` orthonormal coordinates of the model times the residual.
            rank: Independent columns of the model.
            reduced: ``(R, C)`` orthonormal coordinates of the model times every column; None with ``removed``.
            removed: The larger model and the directions ``(D, R)`` of it that this model lacks.
        """
        self.system, self.active, self.precision = system, active, precision
        self.root, self.explained, self.rank = root, explained, rank
        self._crossed = dict[Family, Array]()
        self._remaining = dict[Family, tuple[Array, Array]]()
        self._blocks = dict[bytes, Array]()
        self._reduced, self._removed = reduced, removed
        self.rhs: Array
        """``(C,)`` products of the new parts of all columns with the residual."""
        if removed is None:
            assert reduced is not None
            self.rhs = system.rhs[: reduced.shape[1]] - reduced.T @ explained
        else:
            full, directions = removed
            self._restored = directions @ full.reduced
            self._restored_residual = directions @ full.explained
            self.rhs = full.rhs + self._restored.T @ self._restored_residual
        self.cost = max(system.cost - float(explained @ explained), 1e-300)
        effective = float(rank)
        if precision.any():
            effective -= float(np.sum(np.square(root) * precision[:, None]))
        self.dof = max(system.rows - effective, 1.0)

    @classmethod
    def on(cls, system: Columns, active: Sequence[int], precision: Array) -> Conditioned:
        """Condition on the columns ``active``; ``precision`` ``(A,)`` of their priors, whitened, 0 for none."""
        numbers = np.array(active, dtype=np.int64)
        products = system.products(numbers)
        gram = products[:, numbers] + np.diag(precision)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
        values, vectors = np.linalg.eigh(gram * scale[:, None] * scale)
        independent = values > 1e-12 * max(values.max(initial=0.0), 1e-300)
        root = (scale[:, None] * vectors[:, independent]) / np.sqrt(values[independent])
        rank = int(independent.sum())
        return cls(system, numbers, precision, root, root.T @ system.rhs[numbers], rank, root.T @ products)

    @property
    def n_columns(self) -> int:
        """Return the number of columns of the system when this was computed."""
        return int(self.rhs.size)

    @property
    def reduced(self) -> Array:
        """Return ``(R, C)`` orthonormal coordinates of the model times every column."""
        if self._reduced is None:
            assert self._removed is not None
            full, directions = self._removed
            self._reduced = full.reduced - directions.T @ self._restored
        return self._reduced

    def without(self, columns: NDArray[np.int64]) -> Conditioned:
        """Return the same for a model without some of the active columns, with no decomposition of its size.

        The rows of these columns in the root span the model directions that only these columns contain.
        """
        rows = np.isin(self.active, columns)
        removed_root = self.root[rows]
        _, sizes, directions = np.linalg.svd(removed_root, full_matrices=False)
        directions = directions[sizes > 1e-9 * max(sizes.max(initial=0.0), 1e-300)]
        root = self.root - (self.root @ directions.T) @ directions
        root[rows] = 0.0
        return Conditioned(
            self.system,
            self.active,
            np.where(rows, 0.0, self.precision),
            root,
            self.explained - directions.T @ (directions @ self.explained),
            self.rank - len(directions),
            removed=(self, directions),
        )

    def crossed(self, family: Family) -> Array:
        """Return ``(R, B Q)`` orthonormal coordinates of the model times every column of a family."""
        coordinates_of_family = self._crossed.get(family)
        if coordinates_of_family is None:
            if self._removed is None:
                coordinates_of_family = family.coordinates(self)
            else:
                full, directions = self._removed
                above = full.crossed(family)
                coordinates_of_family = above - directions.T @ (directions @ above)
            self._crossed[family] = coordinates_of_family
        return coordinates_of_family

    def remaining(self, family: Family) -> tuple[Array, Array]:
        """Return ``(B, Q, Q)`` Gram matrices of a family's new parts and ``(B, Q)`` products with the residual."""
        result = self._remaining.get(family)
        if result is None:
            count, size = family.rhs.shape
            if self._removed is None:
                parts = self.crossed(family)
                rhs = family.rhs - (parts.T @ self.explained).reshape(count, size)
                result = family.gram - _squares(parts.reshape(-1, count, size)), rhs
            else:
                full, directions = self._removed
                gram, rhs = full.remaining(family)
                restored = directions @ full.crossed(family)
                rhs = rhs + (restored.T @ self._restored_residual).reshape(count, size)
                result = gram + _squares(restored.reshape(-1, count, size)), rhs
            self._remaining[family] = result
        return result

    def blocks(self, columns: NDArray[np.int64]) -> Array:
        """Return ``(B, Q, Q)`` Gram matrices of the new parts of B times Q columns."""
        key = columns.shape[1].to_bytes(4, "little") + columns.tobytes()
        result = self._blocks.get(key)
        if result is None:
            if self._removed is None:
                result = self.system.blocks(columns) - _squares(self.reduced[:, columns])
            else:
                result = self._removed[0].blocks(columns) + _squares(self._restored[:, columns])
            self._blocks[key] = result
        return result

    def block(self, columns: NDArray[np.int64]) -> Array:
        """Return the ``(Q, Q)`` Gram matrix of the new parts of the given columns."""
        result: Array = self.blocks(columns[None])[0]
        return result

    def least_squares(self, columns: NDArray[np.int64]) -> Array:
        """Return ``(Q,)`` least-squares coefficients of new parts of columns; minimum norm if these overlap."""
        solution = np.linalg.lstsq(self.block(columns), self.rhs[columns], rcond=LEAST_NEW)[0]
        return np.asarray(solution, dtype=np.float64)


class Family:
    """B candidates of Q columns each that are a common column times regressors; their columns are never built.

    ``gram`` ``(B, Q, Q)`` is their Gram matrix and ``rhs`` ``(B, Q)`` their product with the residual.
    """

    def __init__(self, system: Columns, column: Array, basis: Array, shrunk: bool) -> None:
        """Store the common ``column`` ``(M, N)`` and the regressors ``basis`` ``(B, Q, N)``."""
        self.column, self.basis, self.shrunk = column, basis, shrunk
        square = np.einsum("mn,mn->n", column, column)
        self.gram: Array = (basis * square) @ np.swapaxes(basis, 1, 2)
        self.rhs: Array = basis @ np.einsum("mn,mn->n", column, system.residual)
        self._store_none(basis.shape[0] * basis.shape[1])

    def _store_none(self, n_columns: int) -> None:
        """Start without products; the family has ``n_columns`` columns."""
        self._products, self._count = np.empty((0, n_columns)), 0
        self._places = np.zeros(0, dtype=np.int64)

    def _add_products(self, system: Columns, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """Store the products with columns ``numbers`` ``(A,)`` of the system, and return the rows where they stand."""
        grown = system.columns.shape[1] - self._places.size
        if grown > 0:
            self._places = np.concatenate((self._places, np.full(grown, -1)))
        missing = np.unique(numbers[self._places[numbers] < 0])
        if missing.size:
            first, self._count = self._count, self._count + missing.size
            self._places[missing] = np.arange(first, self._count)
            if self._count > self._products.shape[0]:
                larger = np.empty((2 * self._count, self._products.shape[1]))
                larger[:first] = self._products[:first]
                self._products = larger
            self._products[first : self._count] = self.new_products(system.columns[:, missing])
        return self._places[numbers]

    def new_products(self, columns: Array) -> Array:
        """Return ``(A, B Q)`` products of ``columns`` ``(M, A, N)`` with every column of the family."""
        shared = np.einsum("mcn,mn->cn", columns, self.column)
        return np.asarray(shared @ self.basis.reshape(-1, self.basis.shape[2]).T)

    def coordinates(self, conditioned: Conditioned) -> Array:
        """Return ``(R, B Q)`` orthonormal coordinates of a model times every column of the family."""
        rows = self._add_products(conditioned.system, conditioned.active)
        # Rows of zeros for columns outside the model cost less than a copy of the products of those in it.
        root = np.zeros((self._count, conditioned.root.shape[1]))
        # Forms of an effect share columns, so that a model may have a column twice.
        np.add.at(root, rows, conditioned.root)
        return np.asarray(root.T @ self._products[: self._count])

    def judge(self, conditioned: Conditioned, best_only: bool = False) -> Scores:
        """Return the scores of all candidates beside a model; with ``best_only`` of those that can be the best."""
        gram, rhs = conditioned.remaining(self)
        count = rhs.shape[0]
        return judge(
            gram,
            rhs,
            np.diagonal(self.gram, axis1=1, axis2=2),
            conditioned.cost,
            conditioned.dof,
            np.full(count, self.shrunk),
            best_only,
        )


def _squares(parts: Array) -> Array:
    """Return ``(B, Q, Q)`` the sum over the first axis of products of ``parts`` ``(R, B, Q)`` with themselves."""
    ordered = np.moveaxis(parts, 0, 2)
    return np.asarray(ordered @ np.swapaxes(ordered, 1, 2))
