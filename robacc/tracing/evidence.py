"""Evidence and significance of candidates for a residual, by linear algebra on one linearisation.

A candidate is scored by the part of its columns that the model cannot reproduce. Its evidence is the marginal
likelihood with a Gaussian prior of zero mean, maximised over the prior variance and the unknown noise variance: a
single term and a rich block have the same measure, and directions that the data do not determine cost nothing.
Significance is by the F test, or for a block by the likelihood-ratio test of its prior variance (a mixture of
chi-squares of 0 and 1 degree; Self and Liang 1987).
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
"""Candidates of a group scored first if only the best is required."""
_NEGLIGIBLE = 1.0
"""Evidence that a candidate among many must be able to reach to be scored; that of the others counts as zero."""
LEAST_NEW = 1e-10
"""Share of its squared length below which the new part of a candidate's direction counts as none."""
_MOST_EXPLAINED = 0.999999999
"""Largest share of the remaining cost that counts as explained."""
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

    def p_value(self, i: int, inflation: float = 1.0) -> float:
        """Return the significance of candidate ``i`` alone, not corrected for the number of candidates.

        ``inflation`` is the variance of its coefficients over that for independent errors.
        """
        if self.rank[i] == 0:
            return 1.0
        if self.shrunk[i]:
            return 0.5 * chi2_sf(2 * float(self.evidence[i]) / inflation, 1.0)
        residual_dof = self.dof - float(self.rank[i])
        if residual_dof <= 0:
            return 1.0
        # A fit to the last digit leaves a rounding error of either sign.
        remaining = max(self.cost - float(self.gain[i]), 1e-15 * self.cost)
        ratio = (float(self.gain[i]) / float(self.rank[i])) / (remaining / residual_dof)
        return f_sf(ratio / inflation, float(self.rank[i]), residual_dof)


def judge(
    blocks: Array,
    rhs: Array,
    lengths: Array,
    cost: float,
    dof: float,
    shrunk: NDArray[np.bool_],
    best_of: Sequence[slice] | None = None,
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
        best_of: groups of candidates of which only the best is sought; the evidence of others may be left at zero.
    """
    if best_of is not None and rhs.shape[1] > 2:
        return _judge_best(blocks, rhs, lengths, cost, dof, shrunk, best_of)
    values, coordinates = _decomposed(blocks, rhs)
    new = values > LEAST_NEW * np.maximum(lengths.max(axis=1), 1e-300)[:, None]
    values = np.where(new, values, 0.0)
    projected = np.square(np.where(new, coordinates, 0.0))
    gains = np.minimum((projected / np.where(new, values, 1.0)).sum(axis=1), _MOST_EXPLAINED * cost)
    count = blocks.shape[0]
    evidence, prior_var = np.zeros(count), np.ones(count)

    def evaluate(at: NDArray[np.int64]) -> None:
        evidence[at], prior_var[at] = _evidence(values[at], projected[at], cost, dof, gains[at])

    bound = _largest_evidence(gains, cost, dof)
    if best_of is None:
        evaluate(np.flatnonzero(bound > (_NEGLIGIBLE if count > _FIRST_SCORED else 0.0)))
    else:
        orders = [group.start + np.argsort(-gains[group], kind="stable") for group in best_of]
        evaluate(np.concatenate([order[:_FIRST_SCORED] for order in orders]))
        others = [
            order[_FIRST_SCORED:][bound[order[_FIRST_SCORED:]] > evidence[group].max()]
            for group, order in zip(best_of, orders, strict=True)
        ]
        evaluate(np.concatenate(others))
    return Scores(evidence, gains, new.sum(axis=1), prior_var, cost, dof, shrunk)


def _judge_best(
    blocks: Array,
    rhs: Array,
    lengths: Array,
    cost: float,
    dof: float,
    shrunk: NDArray[np.bool_],
    best_of: Sequence[slice],
) -> Scores:
    """Return the scores of candidates that can be the best of a group; those of others are zero but for the gain.

    Gains by least squares cost a tenth of a decomposition. They are found with a small ridge, so that columns may
    depend on each other, and are slightly raised for it.
    """
    ridge = LEAST_NEW * np.maximum(lengths.max(axis=1), 1e-300)
    solution = np.linalg.solve(blocks + ridge[:, None, None] * np.eye(rhs.shape[1]), rhs[:, :, None])[:, :, 0]
    gains = np.clip(1.01 * np.einsum("bq,bq->b", solution, rhs), 0.0, _MOST_EXPLAINED * cost)
    bound = _largest_evidence(gains, cost, dof)
    evidence, prior_var, rank = np.zeros(gains.size), np.ones(gains.size), np.zeros(gains.size, dtype=np.int64)

    def evaluate(at: NDArray[np.int64]) -> None:
        scores = judge(blocks[at], rhs[at], lengths[at], cost, dof, shrunk[at])
        evidence[at], gains[at], rank[at], prior_var[at] = scores.evidence, scores.gain, scores.rank, scores.prior_var

    orders = [group.start + np.argsort(-gains[group], kind="stable") for group in best_of]
    evaluate(np.concatenate([order[:_FIRST_SCORED] for order in orders]))
    others = [
        order[_FIRST_SCORED:][bound[order[_FIRST_SCORED:]] > evidence[group].max()]
        for group, order in zip(best_of, orders, strict=True)
    ]
    evaluate(np.concatenate(others))
    return Scores(evidence, gains, rank, prior_var, cost, dof, shrunk)


def _largest_evidence(gains: Array, cost: float, dof: float) -> Array:
    """Return an upper bound of the evidence: no prior variance can do better than least squares without any prior."""
    bound: Array = -0.5 * dof * np.log1p(-gains / cost)
    return bound


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
