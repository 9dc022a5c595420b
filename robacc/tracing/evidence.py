"""Evidence and significance of candidate columns for a residual, by linear algebra on one linearisation.

The system holds whitened columns of the present model and of all candidates, and those of their products that are
needed. A candidate is scored by the part of its columns that the model cannot reproduce (orthogonalised by a Schur
complement). Its evidence is the marginal likelihood with a Gaussian prior of zero mean, maximised over the prior
variance and the unknown noise variance: a single term and a rich block have the same measure, and directions that the
data do not determine cost nothing. Significance is by the F test, or for a block by the likelihood-ratio test of its
prior variance (a mixture of chi-squares of 0 and 1 degree; Self and Liang 1987).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.statistics.distributions import chi2_sf, f_sf

_PRIOR_VARS = np.exp(np.linspace(math.log(1e-3), math.log(1e10), 66))
_LARGEST_PRIOR_STD = 300.0
"""Largest standard deviation of a coefficient's prior, in multiples of its usual size: absurd values explain
nothing."""
_FIRST_SCORED = 8
"""Candidates scored first if only the best is required."""
_LEAST_NEW = 1e-10
"""Share of its squared length below which the new part of a candidate's direction counts as none."""
_LEAST_COST = 1e-280
"""Least remaining cost that divides: poses without any scatter leave a residual whose square underflows."""


@dataclass(frozen=True, slots=True)
class Scores:
    """Scores of B candidates for the remaining residual."""

    evidence: Array
    """``(B,)`` evidence (log Bayes factor); 0 without new directions."""
    gain: Array
    """``(B,)`` whitened sum of squares explained by least squares."""
    rank: NDArray[np.int64]
    """``(B,)`` new directions."""
    prior_var: Array
    """``(B,)`` prior variance (in units of the candidate's weights, whitened) of largest evidence."""
    cost: float
    dof: float
    shrunk: NDArray[np.bool_]

    def p_value(self, i: int) -> float:
        """Return the significance of candidate ``i`` alone, not corrected for the number of candidates."""
        if self.rank[i] == 0:
            return 1.0
        if self.shrunk[i]:
            return 0.5 * chi2_sf(2 * float(self.evidence[i]), 1.0)
        residual_dof = self.dof - float(self.rank[i])
        if residual_dof <= 0:
            return 1.0
        # A fit to the last digit leaves a rounding error of either sign.
        remaining = max(self.cost - float(self.gain[i]), 1e-15 * self.cost)
        ratio = (float(self.gain[i]) / float(self.rank[i])) / (remaining / residual_dof)
        return f_sf(ratio, float(self.rank[i]), residual_dof)


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
    """All columns and the residual, orthogonalised to a model's columns."""

    def __init__(
        self,
        system: Columns,
        active: NDArray[np.int64],
        precision: Array,
        root: Array,
        reduced: Array,
        explained: Array,
        rank: int,
        removed: tuple[Conditioned, Array] | None = None,
    ) -> None:
        """Store the parts; :meth:`on` computes them.

        Args:
            system: All columns.
            active: ``(A,)`` numbers of the model's columns.
            precision: ``(A,)`` precision of their priors, whitened, 0 for none.
            root: ``(A, R)``: root @ root.T is the inverse of the active columns' Gram matrix.
            reduced: ``(R, C)`` orthonormal coordinates of the model times every column.
            explained: ``(R,)`` the same coordinates of the residual.
            rank: Independent columns of the model.
            removed: The larger model and the directions of it that this model lacks.
        """
        self.system, self.active, self.precision = system, active, precision
        self.root, self.reduced, self.rank = root, reduced, rank
        self._removed, self._crossed = removed, dict[Family, Array]()
        self._explain(explained)

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
        reduced = root.T @ products
        return cls(system, numbers, precision, root, reduced, root.T @ system.rhs[numbers], int(independent.sum()))

    def _explain(self, explained: Array) -> None:
        system = self.system
        self.explained = explained
        self.rhs: Array = system.rhs[: self.reduced.shape[1]] - self.reduced.T @ explained
        self.cost = max(system.cost - float(explained @ explained), 1e-300)
        effective = float(self.rank)
        if self.precision.any():
            effective -= float(np.sum(np.square(self.root) * self.precision[:, None]))
        self.dof = max(system.rows - effective, 1.0)

    def without(self, columns: NDArray[np.int64]) -> Conditioned:
        """Return the same for a model without some of the active columns, with no decomposition of its size.

        The rows of these columns in the root span the model directions that only these columns contain. Those
        directions are removed from every coordinate.
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
            self.reduced - directions.T @ (directions @ self.reduced),
            self.explained - directions.T @ (directions @ self.explained),
            self.rank - len(directions),
            (self, directions),
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

    def blocks(self, columns: NDArray[np.int64]) -> Array:
        """Return ``(B, Q, Q)`` Gram matrices of the new parts of B times Q columns."""
        reduced = np.moveaxis(self.reduced[:, columns], 0, 2)
        result: Array = self.system.blocks(columns) - reduced @ np.swapaxes(reduced, 1, 2)
        return result

    def block(self, columns: NDArray[np.int64]) -> Array:
        """Return the ``(Q, Q)`` Gram matrix of the new parts of the given columns."""
        result: Array = self.blocks(columns[None])[0]
        return result

    def least_squares(self, columns: NDArray[np.int64]) -> Array:
        """Return ``(Q,)`` least-squares coefficients of new parts of columns; minimum norm if these overlap."""
        solution = np.linalg.lstsq(self.block(columns), self.rhs[columns], rcond=_LEAST_NEW)[0]
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
        self._products = np.zeros((0, basis.shape[0] * basis.shape[1]))
        self._places: dict[int, int] = {}

    def products(self, system: Columns, numbers: NDArray[np.int64]) -> Array:
        """Return ``(A, B Q)`` products of some columns of the system with every column of the family."""
        missing = [number for number in numbers.tolist() if number not in self._places]
        if missing:
            self._places |= {number: len(self._places) + i for i, number in enumerate(missing)}
            added = self.new_products(system.columns[:, missing])
            self._products = np.concatenate((self._products, added))
        return self._products[[self._places[number] for number in numbers.tolist()]]

    def new_products(self, columns: Array) -> Array:
        """Return ``(A, B Q)`` products of ``columns`` ``(M, A, N)`` with every column of the family."""
        shared = np.einsum("mcn,mn->cn", columns, self.column)
        return np.asarray(shared @ self.basis.reshape(-1, self.basis.shape[2]).T)

    def coordinates(self, conditioned: Conditioned) -> Array:
        """Return ``(R, B Q)`` orthonormal coordinates of a model times every column of the family."""
        return np.asarray(conditioned.root.T @ self.products(conditioned.system, conditioned.active))

    def judge(self, conditioned: Conditioned, best_only: bool = False) -> Scores:
        """Return the scores of all candidates beside a model; with ``best_only`` of those that can be the best."""
        count, size = self.rhs.shape
        reduced = conditioned.crossed(self)
        parts = np.moveaxis(reduced.reshape(-1, count, size), 0, 2)
        return judge(
            self.gram - parts @ np.swapaxes(parts, 1, 2),
            self.rhs - (reduced.T @ conditioned.explained).reshape(count, size),
            np.diagonal(self.gram, axis1=1, axis2=2),
            conditioned.cost,
            conditioned.dof,
            np.full(count, self.shrunk),
            best_only,
        )


def judge(
    blocks: Array,
    rhs: Array,
    lengths: Array,
    cost: float,
    dof: float,
    shrunk: NDArray[np.bool_],
    best_only: bool = False,
) -> Scores:
    """Return the scores of B candidates of Q columns each.

    Args:
        blocks: ``(B, Q, Q)`` Gram matrices of the new parts of the columns, scaled by the candidates' weights, that is
            in units of their coefficients' usual sizes.
        rhs: ``(B, Q)`` products of the new parts with the residual, scaled likewise.
        lengths: ``(B, Q)`` squared lengths of the complete columns.
        cost: whitened sum of squares of the remaining residual.
        dof: its degrees of freedom.
        shrunk: ``(B,)`` whether a candidate is a block.
        best_only: leave the evidence of candidates that cannot be the best at zero.
    """
    values, coordinates = _decomposed(blocks, rhs)
    new = values > _LEAST_NEW * np.maximum(lengths.max(axis=1), 1e-300)[:, None]
    values = np.where(new, values, 0.0)
    projected = np.square(np.where(new, coordinates, 0.0))
    gains = np.minimum((projected / np.where(new, values, 1.0)).sum(axis=1), 0.999999999 * cost)
    count = blocks.shape[0]
    evidence, prior_var = np.zeros(count), np.ones(count)

    def evaluate(at: NDArray[np.int64]) -> None:
        evidence[at], prior_var[at] = _evidence(values[at], projected[at], cost, dof, gains[at])

    if not best_only or count <= _FIRST_SCORED:
        evaluate(np.arange(count))
    else:
        order = np.argsort(-gains, kind="stable")
        evaluate(order[:_FIRST_SCORED])
        # No prior variance can do better than least squares without any prior.
        bound = -0.5 * dof * np.log1p(-gains[order[_FIRST_SCORED:]] / cost)
        evaluate(order[_FIRST_SCORED:][bound > evidence.max()])
    return Scores(evidence, gains, new.sum(axis=1), prior_var, cost, dof, shrunk)


def _decomposed(blocks: Array, rhs: Array) -> tuple[Array, Array]:
    """Return eigenvalues ``(B, Q)`` of symmetric matrices, and ``rhs`` in their eigenvectors; pairs by one rotation."""
    size = blocks.shape[1]
    if size == 1:
        return blocks[:, 0], rhs
    if size == 2:
        (a, b), c = blocks[:, 0].T, blocks[:, 1, 1]
        angle = 0.5 * np.arctan2(2 * b, a - c)
        cosine, sine = np.cos(angle), np.sin(angle)
        middle, half = 0.5 * (a + c), np.hypot(0.5 * (a - c), b)
        x, y = rhs.T
        values = np.stack((middle + half, middle - half), axis=1)
        return values, np.stack((cosine * x + sine * y, cosine * y - sine * x), axis=1)
    values, vectors = np.linalg.eigh(blocks)
    return values, (rhs[:, None, :] @ vectors)[:, 0]


def _evidence(values: Array, projected: Array, cost: float, dof: float, gains: Array) -> tuple[Array, Array]:
    """Return ``(B,)`` evidence at the best prior variance, and that variance, from eigenvalues ``(B, Q)``.

    The largest prior variance is relative to the noise that remains with the candidate: an effect of a hundred times
    the noise is part of the residual without it.
    """
    if values.shape[0] == 0:
        return np.zeros(0), np.zeros(0)
    top = values.max(axis=1)
    largest = _LARGEST_PRIOR_STD**2 * dof / np.maximum(cost - gains, _LEAST_COST)
    prior_vars = np.minimum(_PRIOR_VARS / np.where(top > 0, top, 1.0)[:, None], largest[:, None])
    inflation = 1.0 + prior_vars[:, :, None] * values[:, None, :]
    remaining = cost - prior_vars * ((1.0 / inflation) @ projected[:, :, None])[:, :, 0]
    likelihood = -0.5 * dof * np.log(np.maximum(remaining, 1e-9 * cost) / cost)
    likelihood -= 0.5 * np.log(inflation).sum(axis=2)
    best = np.argmax(likelihood, axis=1)
    rows = np.arange(best.size)
    return np.where(top > 0, np.maximum(likelihood[rows, best], 0.0), 0.0), prior_vars[rows, best]
