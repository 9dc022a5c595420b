"""Which columns explain a residual, and how strong the evidence is, by linear algebra on one linearisation.

The system holds whitened columns of the present model and of everything that competes, and their Gram matrix. A
candidate is judged by the part of its columns that the model cannot mimic (orthogonalised by a Schur complement). Its
evidence is the marginal likelihood with a Gaussian prior of zero mean whose width is the best one, and the unknown
noise at its best value too: a single term and a rich block compete by the same measure, and what the data do not
decide costs nothing. Significance is by the F test, or for a block by the likelihood-ratio test of its width
(a mixture of chi-squares of 0 and 1 degree; Self and Liang 1987).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.statistics.distributions import chi2_sf, f_sf

_WIDTHS = np.exp(np.linspace(math.log(1e-3), math.log(1e10), 66))
_PLAUSIBLE = 300.0
"""A coefficient's prior is at most this many times its usual size: what only an absurd value would explain is not."""
_FEW = 8
"""Candidates looked at first where only the best one is asked for."""
_NEW = 1e-10
"""A candidate's direction whose new part has less than this share of its squared length is no new direction."""


@dataclass(frozen=True, slots=True)
class Scores:
    """How well each of B candidates explains what is left."""

    evidence: Array
    """``(B,)`` log marginal likelihood ratio, nats; 0 where there is nothing new."""
    gain: Array
    """``(B,)`` whitened sum of squares explained by least squares."""
    rank: NDArray[np.int64]
    """``(B,)`` new directions."""
    width: Array
    """``(B,)`` prior width (in units of the candidate's weights, whitened) of largest evidence."""
    energy: float
    freedom: float
    shrunk: NDArray[np.bool_]

    def p_value(self, i: int) -> float:
        """Significance of candidate ``i`` alone, not corrected for how many compete."""
        if self.rank[i] == 0:
            return 1.0
        if self.shrunk[i]:
            return 0.5 * chi2_sf(2 * float(self.evidence[i]), 1.0)
        rest = self.freedom - float(self.rank[i])
        if rest <= 0:
            return 1.0
        # What is explained to the last digit leaves rounding, of either sign.
        left = max(self.energy - float(self.gain[i]), 1e-15 * self.energy)
        ratio = (float(self.gain[i]) / float(self.rank[i])) / (left / rest)
        return f_sf(ratio, float(self.rank[i]), rest)


class Columns:
    """Whitened columns over rows (components x poses), their Gram matrix, and the residual."""

    def __init__(self, columns: Array, residual: Array) -> None:
        """``columns`` ``(M, C, N)``, ``residual`` ``(M, N)``."""
        self.columns = columns
        self.residual = residual
        self.rows = residual.size
        stacked = np.moveaxis(columns, 1, 2).reshape(-1, columns.shape[1])
        self.gram: Array = stacked.T @ stacked
        self.moment: Array = stacked.T @ residual.ravel()
        self.energy = float(residual.ravel() @ residual.ravel())

    def append(self, columns: Array) -> NDArray[np.int64]:
        """Add ``(M, Q, N)`` columns; their numbers."""
        first = self.columns.shape[1]
        turned = np.swapaxes(columns, 1, 2)
        cross, own = (self.columns @ turned).sum(axis=0), (columns @ turned).sum(axis=0)
        self.gram = np.block([[self.gram, cross], [cross.T, own]])
        self.moment = np.concatenate((self.moment, np.einsum("mqn,mn->q", columns, self.residual)))
        self.columns = np.concatenate((self.columns, columns), axis=1)
        return np.arange(first, first + columns.shape[1])


class Conditioned:
    """What is left of all columns and of the residual once a model's columns have explained what they can."""

    def __init__(self, system: Columns, active: Sequence[int], precision: Array) -> None:
        """``precision`` ``(len(active),)``: of the Gaussian prior of each active coefficient, whitened; 0 for none."""
        self.system = system
        self.active = np.array(active, dtype=np.int64)
        self.precision = precision
        gram = system.gram[np.ix_(self.active, self.active)] + np.diag(precision)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
        values, vectors = np.linalg.eigh(gram * scale[:, None] * scale)
        good = values > 1e-12 * max(values.max(initial=0.0), 1e-300)
        self.root: Array = (scale[:, None] * vectors[:, good]) / np.sqrt(values[good])
        """``(A, R)``: root @ root.T is the inverse of the active columns' Gram matrix."""
        self.rank = int(good.sum())
        self._removed: tuple[Conditioned, Array] | None = None
        self._crossed: dict[Family, Array] = {}
        self.reduced: Array = self.root.T @ system.gram[self.active]
        """``(R, C)``: orthonormal coordinates of the model times every column."""
        self._explain(self.root.T @ system.moment[self.active])

    def _explain(self, explained: Array) -> None:
        system = self.system
        self.explained = explained
        self.moment: Array = system.moment[: self.reduced.shape[1]] - self.reduced.T @ explained
        self.energy = max(system.energy - float(explained @ explained), 1e-300)
        effective = float(self.rank)
        if self.precision.any():
            effective -= float(np.sum(np.square(self.root) * self.precision[:, None]))
        self.freedom = max(system.rows - effective, 1.0)

    def without(self, columns: NDArray[np.int64]) -> Conditioned:
        """The same for a model that lacks some of the active columns, without decomposing anything of its size.

        The rows that they have in the root span the directions of the model that only they hold; those are taken out
        of every coordinate.
        """
        rows = np.isin(self.active, columns)
        own = self.root[rows]
        _, sizes, directions = np.linalg.svd(own, full_matrices=False)
        directions = directions[sizes > 1e-9 * max(sizes.max(initial=0.0), 1e-300)]
        rest = object.__new__(Conditioned)
        rest.system, rest.active = self.system, self.active
        rest.precision = np.where(rows, 0.0, self.precision)
        rest.root = self.root - (self.root @ directions.T) @ directions
        rest.root[rows] = 0.0
        rest.rank = self.rank - len(directions)
        rest._removed, rest._crossed = (self, directions), {}
        rest.reduced = self.reduced - directions.T @ (directions @ self.reduced)
        rest._explain(self.explained - directions.T @ (directions @ self.explained))
        return rest

    def crossed(self, family: Family) -> Array:
        """``(R, B Q)`` orthonormal coordinates of the model times every column of a family."""
        known = self._crossed.get(family)
        if known is None:
            if self._removed is None:
                known = self.root.T @ family.cross(self.system)[self.active]
            else:
                whole, directions = self._removed
                above = whole.crossed(family)
                known = above - directions.T @ (directions @ above)
            self._crossed[family] = known
        return known

    def blocks(self, columns: NDArray[np.int64]) -> Array:
        """``(B, Q, Q)`` Gram matrices of the new parts of B times Q columns."""
        reduced = np.moveaxis(self.reduced[:, columns], 0, 2)
        whole = self.system.gram[columns[:, :, None], columns[:, None, :]]
        result: Array = whole - reduced @ np.swapaxes(reduced, 1, 2)
        return result

    def block(self, columns: NDArray[np.int64]) -> Array:
        """``(Q, Q)`` Gram matrix of some columns' new parts."""
        result: Array = self.blocks(columns[None])[0]
        return result

    def least_squares(self, columns: NDArray[np.int64]) -> Array:
        """``(Q,)`` coefficients of some columns' new parts for what is left; of least length where these overlap."""
        found = np.linalg.lstsq(self.block(columns), self.moment[columns], rcond=_NEW)[0]
        return np.asarray(found, dtype=np.float64)


class Family:
    """B candidates of Q columns each that are one column times a regressor; no column of theirs is ever built.

    ``own`` ``(B, Q, Q)`` is their Gram matrix and ``moment`` ``(B, Q)`` what they have in common with the residual.
    """

    def __init__(self, system: Columns, column: Array, basis: Array, shrunk: bool) -> None:
        """``column`` ``(M, N)`` is what all of them share, ``basis`` ``(B, Q, N)`` the regressors."""
        self.column, self.basis, self.shrunk = column, basis, shrunk
        square = np.einsum("mn,mn->n", column, column)
        self.own: Array = (basis * square) @ np.swapaxes(basis, 1, 2)
        self.moment: Array = basis @ np.einsum("mn,mn->n", column, system.residual)
        self._cross = np.zeros((0, basis.shape[0] * basis.shape[1]))

    def cross(self, system: Columns) -> Array:
        """``(C, B Q)`` what every column of the system has in common with every one of these."""
        done = self._cross.shape[0]
        if done < system.columns.shape[1]:
            shared = np.einsum("mcn,mn->cn", system.columns[:, done:], self.column)
            flat = self.basis.reshape(-1, self.basis.shape[2])
            self._cross = np.concatenate((self._cross, shared @ flat.T))
        return self._cross

    def judge(self, conditioned: Conditioned, best_only: bool = False) -> Scores:
        """Scores of all of them beside a model, or of those that can be the best."""
        count, size = self.moment.shape
        reduced = conditioned.crossed(self)
        parts = np.moveaxis(reduced.reshape(-1, count, size), 0, 2)
        return judge(
            self.own - parts @ np.swapaxes(parts, 1, 2),
            self.moment - (reduced.T @ conditioned.explained).reshape(count, size),
            np.diagonal(self.own, axis1=1, axis2=2),
            conditioned.energy,
            conditioned.freedom,
            np.full(count, self.shrunk),
            best_only,
        )


def judge(
    blocks: Array,
    moments: Array,
    lengths: Array,
    energy: float,
    freedom: float,
    shrunk: NDArray[np.bool_],
    best_only: bool = False,
) -> Scores:
    """Scores of B candidates of Q columns each.

    Args:
        blocks: ``(B, Q, Q)`` Gram matrices of the new parts of the columns, scaled by the candidates' weights, that is
            in units of their coefficients' usual sizes.
        moments: ``(B, Q)`` the same times the residual.
        lengths: ``(B, Q)`` squared lengths of the whole columns.
        energy: whitened sum of squares of what is left.
        freedom: its degrees of freedom.
        shrunk: ``(B,)`` whether a candidate is a block.
        best_only: leave the evidence of candidates that cannot be the best at zero.
    """
    values, coordinates = _decomposed(blocks, moments)
    new = values > _NEW * np.maximum(lengths.max(axis=1), 1e-300)[:, None]
    values = np.where(new, values, 0.0)
    projected = np.square(np.where(new, coordinates, 0.0))
    gains = np.minimum((projected / np.where(new, values, 1.0)).sum(axis=1), 0.999999999 * energy)
    count = blocks.shape[0]
    evidence, width = np.zeros(count), np.ones(count)

    def evaluate(at: NDArray[np.int64]) -> None:
        evidence[at], width[at] = _evidence(values[at], projected[at], energy, freedom, gains[at])

    if not best_only or count <= _FEW:
        evaluate(np.arange(count))
    else:
        order = np.argsort(-gains, kind="stable")
        evaluate(order[:_FEW])
        # No width can do better than least squares without any prior.
        bound = -0.5 * freedom * np.log1p(-gains[order[_FEW:]] / energy)
        evaluate(order[_FEW:][bound > evidence.max()])
    return Scores(evidence, gains, new.sum(axis=1), width, energy, freedom, shrunk)


def _decomposed(blocks: Array, moments: Array) -> tuple[Array, Array]:
    """Eigenvalues ``(B, Q)`` of symmetric matrices, and the moments along the eigenvectors; pairs by one rotation."""
    size = blocks.shape[1]
    if size == 1:
        return blocks[:, 0], moments
    if size == 2:
        (a, b), c = blocks[:, 0].T, blocks[:, 1, 1]
        angle = 0.5 * np.arctan2(2 * b, a - c)
        cosine, sine = np.cos(angle), np.sin(angle)
        middle, half = 0.5 * (a + c), np.hypot(0.5 * (a - c), b)
        x, y = moments.T
        values = np.stack((middle + half, middle - half), axis=1)
        return values, np.stack((cosine * x + sine * y, cosine * y - sine * x), axis=1)
    values, vectors = np.linalg.eigh(blocks)
    return values, (moments[:, None, :] @ vectors)[:, 0]


def _evidence(values: Array, projected: Array, energy: float, freedom: float, gains: Array) -> tuple[Array, Array]:
    """``(B,)`` log marginal likelihood ratio at its best prior width, and that width, from eigenvalues ``(B, Q)``.

    What is plausible is measured by the noise that a candidate leaves: an effect that is a hundred times the noise is
    in the noise as it stands without it.
    """
    if values.shape[0] == 0:
        return np.zeros(0), np.zeros(0)
    top = values.max(axis=1)
    largest = _PLAUSIBLE**2 * freedom / (energy - gains)
    widths = np.minimum(_WIDTHS / np.where(top > 0, top, 1.0)[:, None], largest[:, None])
    spread = 1.0 + widths[:, :, None] * values[:, None, :]
    left = energy - widths * ((1.0 / spread) @ projected[:, :, None])[:, :, 0]
    likelihood = -0.5 * freedom * np.log(np.maximum(left, 1e-9 * energy) / energy)
    likelihood -= 0.5 * np.log(spread).sum(axis=2)
    best = np.argmax(likelihood, axis=1)
    rows = np.arange(best.size)
    return np.where(top > 0, np.maximum(likelihood[rows, best], 0.0), 0.0), widths[rows, best]
