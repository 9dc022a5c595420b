"""Whitened columns of a model and of its candidates, orthogonalised to the model's.

The new part of a candidate's columns is what the model cannot reproduce (a Schur complement).
"""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.tracing.evidence import LEAST_NEW, Scores, judge
from robacc.tracing.whitened_columns import Columns

_LEAST_INDEPENDENT = 1e-12
"""Share of the largest eigenvalue of the declared effects' Gram matrix below which a direction counts as none."""


class Conditioned:
    """All columns and the residual, orthogonalised to a model's columns.

    A model with more columns (:meth:`extended`), or without some (:meth:`without`), is described by the directions in
    which it differs: what these explain is taken from the columns and the residual, or goes back to them. So a change
    of the model costs as much as the change is large.
    """

    def __init__(
        self, system: Columns, active: NDArray[np.int64], precision: Array, root: Array, explained: Array, rank: int
    ) -> None:
        """Store the parts; :meth:`on` computes them.

        Args:
            system: All columns.
            active: ``(A,)`` numbers of the model's columns.
            precision: ``(A,)`` precision of their priors, whitened, 0 for none.
            root: ``(A, R)``: root @ root.T is the inverse of the active columns' Gram matrix.
            explained: ``(R,)`` orthonormal coordinates of the model times the residual.
            rank: Independent columns of the model.
        """
        self.system, self.active, self.precision = system, active, precision
        self.root, self.explained, self.rank = root, explained, rank
        self.cost = max(system.cost - float(explained @ explained), 1e-300)
        effective = float(rank)
        if precision.any():
            effective -= float(np.sum(np.square(root) * precision[:, None]))
        self.dof = max(system.rows - effective, 1.0)
        # Families of one refinement are forgotten with it.
        self._crossed = WeakKeyDictionary[Family, Array]()
        self._remaining = WeakKeyDictionary[Family, tuple[Array, Array]]()
        self._blocks = dict[bytes, Array]()
        self._reduced, self._rhs = np.zeros((root.shape[1], 0)), np.zeros(0)

    @classmethod
    def on(cls, system: Columns, active: Sequence[int], precision: Array) -> Conditioned:
        """Condition on the columns ``active``; ``precision`` ``(A,)`` of their priors, whitened, 0 for none."""
        numbers = np.array(active, dtype=np.int64)
        gram = system.products(numbers)[:, numbers] + np.diag(precision)
        root = _inverse_root(gram, np.diag(gram), _LEAST_INDEPENDENT)
        return cls(system, numbers, precision, root, root.T @ system.rhs[numbers], root.shape[1])

    def extended(self, columns: NDArray[np.int64], precision: Array) -> Conditioned:
        """Return the same for a model with more columns ``(Q,)``; directions that it has already add nothing."""
        return _Extended(self, columns, precision)

    def without(self, rows: slice) -> Conditioned:
        """Return the same for a model without some of its columns, ``rows`` of :attr:`active`.

        These rows of the root span the model directions that only these columns contain, if the columns are
        independent of all others (:attr:`is_independent`).
        """
        return _Without(self, rows)

    @property
    def is_independent(self) -> bool:
        """Return whether all columns that the model was extended by are independent."""
        return True

    @property
    def reduced(self) -> Array:
        """Return ``(R, C)`` orthonormal coordinates of the model times every column."""
        first = self._reduced.shape[1]
        if first < self.system.count:
            self._reduced = np.concatenate((self._reduced, self._new_reduced(first)), axis=1)
        return self._reduced

    @property
    def rhs(self) -> Array:
        """Return ``(C,)`` products of the new parts of all columns with the residual."""
        if self._rhs.size < self.system.count:
            self._rhs = self.system.rhs - self.reduced.T @ self.explained
        return self._rhs

    def _new_reduced(self, first: int) -> Array:
        """Return the coordinates times the columns from number ``first`` on."""
        return np.asarray(self.root.T @ self.system.products(self.active)[:, first:])

    def crossed(self, family: Family) -> Array:
        """Return ``(R, B Q)`` orthonormal coordinates of the model times every column of a family."""
        result = self._crossed.get(family)
        if result is None:
            result = self._crossed[family] = self._cross(family)
        return result

    def _cross(self, family: Family) -> Array:
        return np.asarray(self.root.T @ family.products(self.system, self.active))

    def remaining(self, family: Family) -> tuple[Array, Array]:
        """Return ``(B, Q, Q)`` Gram matrices of a family's new parts and ``(B, Q)`` products with the residual."""
        result = self._remaining.get(family)
        if result is None:
            result = self._remaining[family] = self._remain(family)
        return result

    def _remain(self, family: Family) -> tuple[Array, Array]:
        parts, shape = self.crossed(family), family.rhs.shape
        return family.gram - _squares(parts, *shape), family.rhs - (parts.T @ self.explained).reshape(shape)

    def blocks(self, columns: NDArray[np.int64]) -> Array:
        """Return ``(B, Q, Q)`` Gram matrices of the new parts of B times Q columns."""
        key = columns.shape[1].to_bytes(4, "little") + columns.tobytes()
        result = self._blocks.get(key)
        if result is None:
            result = self._blocks[key] = self._block(columns)
        return result

    def _block(self, columns: NDArray[np.int64]) -> Array:
        return self.system.blocks(columns) - _squares(self.reduced[:, columns.ravel()], *columns.shape)

    def block(self, columns: NDArray[np.int64]) -> Array:
        """Return the ``(Q, Q)`` Gram matrix of the new parts of the given columns."""
        result: Array = self.blocks(columns[None])[0]
        return result

    def least_squares(self, columns: NDArray[np.int64], precision: Array | None = None) -> Array:
        """Return ``(Q,)`` least-squares coefficients of new parts of columns; minimum norm if these overlap.

        ``precision`` ``(Q,)`` is that of their priors, whitened, 0 for none.
        """
        block = self.block(columns)
        if precision is not None:
            block = block + np.diag(precision)
        if columns.size == 1 and block[0, 0] > 0.0:
            return np.asarray(self.rhs[columns] / block[0])
        solution = np.linalg.lstsq(block, self.rhs[columns], rcond=LEAST_NEW)[0]
        return np.asarray(solution, dtype=np.float64)


class _Extended(Conditioned):
    """A model with more columns than ``smaller``; its last rows of coordinates are the new directions."""

    def __init__(self, smaller: Conditioned, columns: NDArray[np.int64], precision: Array) -> None:
        system = smaller.system
        self._smaller, self._columns = smaller, columns
        self._mimicked = smaller.reduced[:, columns]
        gram = system.products(columns)[:, columns] + np.diag(precision)
        self._new = _inverse_root(gram - self._mimicked.T @ self._mimicked, np.diag(gram), LEAST_NEW)
        n_rows, n_directions = smaller.root.shape
        root = np.zeros((n_rows + columns.size, n_directions + self._new.shape[1]))
        root[:n_rows, :n_directions] = smaller.root
        root[:n_rows, n_directions:] = -smaller.root @ self._mimicked @ self._new
        root[n_rows:, n_directions:] = self._new
        self._new_explained = self._new.T @ smaller.rhs[columns]
        super().__init__(
            system,
            np.concatenate((smaller.active, columns)),
            np.concatenate((smaller.precision, precision)),
            root,
            np.concatenate((smaller.explained, self._new_explained)),
            smaller.rank + self._new.shape[1],
        )

    @property
    def is_independent(self) -> bool:
        return self._smaller.is_independent and self._new.shape[1] == self._columns.size

    def _new_reduced(self, first: int) -> Array:
        above = self._smaller.reduced[:, first:]
        products = self.system.products(self._columns)[:, first:]
        return np.concatenate((above, self._new.T @ (products - self._mimicked.T @ above)))

    def _cross(self, family: Family) -> Array:
        above = self._smaller.crossed(family)
        products = family.products(self.system, self._columns)
        return np.concatenate((above, self._new.T @ products - (self._mimicked @ self._new).T @ above))

    def _remain(self, family: Family) -> tuple[Array, Array]:
        gram, rhs = self._smaller.remaining(family)
        parts = self.crossed(family)[self._smaller.explained.size :]
        return gram - _squares(parts, *rhs.shape), rhs - (parts.T @ self._new_explained).reshape(rhs.shape)

    def _block(self, columns: NDArray[np.int64]) -> Array:
        parts = self.reduced[self._smaller.explained.size :, columns.ravel()]
        return self._smaller.blocks(columns) - _squares(parts, *columns.shape)


class _Without(Conditioned):
    """A model without some columns of ``larger``, described by the directions that it lacks."""

    def __init__(self, larger: Conditioned, rows: slice) -> None:
        # Orthogonal factorisation always ends; LAPACK's divide-and-conquer SVD did not on some blocks of 72 columns.
        directions, triangle = np.linalg.qr(larger.root[rows].T)
        sizes = np.abs(np.diag(triangle))
        self._larger = larger
        self._lacking = directions.T[sizes > 1e-9 * max(sizes.max(initial=0.0), 1e-300)]
        self._restored_residual = self._lacking @ larger.explained
        root = larger.root - (larger.root @ self._lacking.T) @ self._lacking
        root[rows] = 0.0
        precision = larger.precision.copy()
        precision[rows] = 0.0
        super().__init__(
            larger.system,
            larger.active,
            precision,
            root,
            larger.explained - self._lacking.T @ self._restored_residual,
            larger.rank - len(self._lacking),
        )

    def _new_reduced(self, first: int) -> Array:
        above = self._larger.reduced[:, first:]
        return np.asarray(above - self._lacking.T @ (self._lacking @ above))

    def _cross(self, family: Family) -> Array:
        above = self._larger.crossed(family)
        return np.asarray(above - self._lacking.T @ (self._lacking @ above))

    def _remain(self, family: Family) -> tuple[Array, Array]:
        gram, rhs = self._larger.remaining(family)
        restored = self._lacking @ self._larger.crossed(family)
        return gram + _squares(restored, *rhs.shape), rhs + (restored.T @ self._restored_residual).reshape(rhs.shape)

    def _block(self, columns: NDArray[np.int64]) -> Array:
        restored = self._lacking @ self._larger.reduced[:, columns.ravel()]
        return self._larger.blocks(columns) + _squares(restored, *columns.shape)


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
        self._products = dict[int, Array]()
        self._none = np.zeros((0, n_columns))

    def products(self, system: Columns, numbers: NDArray[np.int64]) -> Array:
        """Return ``(A, B Q)`` products of columns ``numbers`` ``(A,)`` of the system with all of the family."""
        missing = np.array([number for number in numbers.tolist() if number not in self._products], dtype=np.int64)
        if missing.size:
            self._products.update(zip(missing.tolist(), self.new_products(system.columns[:, missing]), strict=True))
        return np.stack([self._products[number] for number in numbers.tolist()]) if numbers.size else self._none

    def best(self, conditioned: Conditioned) -> tuple[int, Scores]:
        """Return the number of the best candidate given a model, and the scores."""
        scores = self.judge(conditioned, (slice(0, len(self.rhs)),))
        return int(np.argmax(scores.evidence)), scores

    def new_products(self, columns: Array) -> Array:
        """Return ``(A, B Q)`` products of ``columns`` ``(M, A, N)`` with every column of the family."""
        shared = np.einsum("mcn,mn->cn", columns, self.column)
        return np.asarray(shared @ self.basis.reshape(-1, self.basis.shape[2]).T)

    def judge(self, conditioned: Conditioned, best_of: Sequence[slice] | None = None) -> Scores:
        """Return the scores of all candidates given a model; with ``best_of`` of those that can be a group's best."""
        gram, rhs = conditioned.remaining(self)
        count = rhs.shape[0]
        return judge(
            gram,
            rhs,
            np.diagonal(self.gram, axis1=1, axis2=2),
            conditioned.cost,
            conditioned.dof,
            np.full(count, self.shrunk),
            best_of,
        )


def _inverse_root(gram: Array, squared_lengths: Array, least: float) -> Array:
    """Return ``(A, R)`` the root of the inverse of a Gram matrix, without directions of less than ``least``."""
    scale = 1.0 / np.sqrt(np.maximum(squared_lengths, 1e-300))
    values, vectors = np.linalg.eigh(gram * scale[:, None] * scale)
    independent = values > least * max(values.max(initial=0.0), 1.0)
    return np.asarray((scale[:, None] * vectors[:, independent]) / np.sqrt(values[independent]))


def _squares(parts: Array, count: int, size: int) -> Array:
    """Return ``(B, Q, Q)`` the sum over the rows of products of ``parts`` ``(R, B Q)`` with themselves."""
    ordered = parts.reshape(-1, count, size)
    if size > 2:
        ordered = np.moveaxis(ordered, 0, 2)
        return np.asarray(ordered @ np.swapaxes(ordered, 1, 2))
    # Small matrices are faster pair by pair than as a stack of products.
    result = np.empty((count, size, size))
    for i in range(size):
        for j in range(i + 1):
            result[:, i, j] = result[:, j, i] = np.einsum("rb,rb->b", ordered[:, :, i], ordered[:, :, j])
    return result
