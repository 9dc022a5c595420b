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
        ratio = (float(self.gain[i]) / float(self.rank[i])) / ((self.energy - float(self.gain[i])) / rest)
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
        cross = np.einsum("mcn,mqn->cq", self.columns, columns)
        own = np.einsum("mcn,mqn->cq", columns, columns)
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
        gram = system.gram[np.ix_(self.active, self.active)] + np.diag(precision)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
        values, vectors = np.linalg.eigh(gram * scale[:, None] * scale)
        good = values > 1e-12 * max(values.max(initial=0.0), 1e-300)
        self.root: Array = (scale[:, None] * vectors[:, good]) / np.sqrt(values[good])
        self.reduced: Array = self.root.T @ system.gram[self.active]
        """``(R, C)``: orthonormal coordinates of the model times every column."""
        explained = self.root.T @ system.moment[self.active]
        self.explained = explained
        self.moment: Array = system.moment - self.reduced.T @ explained
        self.energy = max(system.energy - float(explained @ explained), 1e-300)
        effective = float(good.sum())
        if precision.any():
            effective -= float(np.sum(np.square(self.root) * precision[:, None]))
        self.freedom = max(system.rows - effective, 1.0)

    def block(self, columns: NDArray[np.int64]) -> Array:
        """``(Q, Q)`` Gram matrix of some columns' new parts."""
        reduced = self.reduced[:, columns]
        result: Array = self.system.gram[np.ix_(columns, columns)] - reduced.T @ reduced
        return result

    def full(self) -> Array:
        """``(C, C)`` Gram matrix of every column's new part."""
        result: Array = self.system.gram - self.reduced.T @ self.reduced
        return result


def judge(
    blocks: Array, moments: Array, lengths: Array, energy: float, freedom: float, shrunk: NDArray[np.bool_]
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
    """
    values, vectors = np.linalg.eigh(blocks)
    new = values > _NEW * np.maximum(lengths.max(axis=1), 1e-300)[:, None]
    values = np.where(new, values, 0.0)
    projected = np.where(new, np.einsum("bqr,bq->br", vectors, moments), 0.0)
    safe = np.where(new, values, 1.0)
    gains = np.minimum(np.sum(np.square(projected) / safe, axis=1), 0.999999999 * energy)
    top = np.where(values.max(axis=1) > 0, values.max(axis=1), 1.0)
    widths = np.minimum(_WIDTHS[None, :] / top[:, None], _PLAUSIBLE**2 * freedom / energy)
    share = widths[:, :, None] / (1.0 + widths[:, :, None] * values[:, None, :])
    left = energy - np.sum(np.square(projected)[:, None, :] * share, axis=2)
    left = np.maximum(left, 1e-9 * energy)
    log_likelihood = -0.5 * freedom * np.log(left / energy)
    log_likelihood -= 0.5 * np.sum(np.log1p(widths[:, :, None] * values[:, None, :]), axis=2)
    best = np.argmax(log_likelihood, axis=1)
    rows = np.arange(best.size)
    rank = new.sum(axis=1)
    evidence = np.where(rank > 0, np.maximum(log_likelihood[rows, best], 0.0), 0.0)
    return Scores(evidence, gains, rank, widths[rows, best], energy, freedom, shrunk)
