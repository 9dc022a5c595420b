"""Evidence for candidates: the log Bayes factor of adding each to a model, sizes integrated out, and its rivals.

A candidate with columns Z (times the usual sizes) and coefficients u ~ N(0, t^2 I) adds to y'P y a term that depends on
G = Z'P Z and b = Z'P y alone. With the noise's scale integrated out over v degrees of freedom the log Bayes factor is

    -v/2 log(1 - b'(G + I s^2/t^2)^-1 b / y'P y) - 1/2 log|I + G t^2/s^2|,

averaged over a grid of t (:attr:`Candidate.scales`); for one column it depends on one t statistic.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import log_ndtr, logsumexp

from robacc.error_model.covariance import Whitened
from robacc.geometry import Array
from robacc.tracing.candidates import Candidate

_NEW = 1e-6
"""Share of a column's square below which its new part is rounding: the model has the column already."""
_SCALE_ROUNDS = 3
"""Rounds in which the noise's scale follows the candidate; each changes the evidence less than the one before."""


@dataclass(frozen=True)
class Scores:
    """Candidates beside a model."""

    log_odds: Array
    """``(C,)`` log Bayes factor plus log prior odds; -inf for candidates that the model contains already."""
    log_bayes: Array
    """``(C,)``"""
    scale: Array
    """``(C,)`` multiple of the usual size with the largest evidence."""
    gain: Array
    """``(C,)`` share of y'P y that the candidate explains at that size."""
    fitted: Callable[[int], Array]
    """Returns the least-squares coefficients of a candidate beside the model, in units of the usual sizes."""

    def spread(self, numbers: NDArray[np.int64], count: int) -> Scores:
        """Return the scores of ``count`` candidates, of which these are ``numbers``; the others have no odds."""

        def placed(values: Array, otherwise: float) -> Array:
            result = np.full(count, otherwise)
            result[numbers] = values
            return result

        return Scores(
            placed(self.log_odds, -np.inf),
            placed(self.log_bayes, -np.inf),
            placed(self.scale, 1.0),
            placed(self.gain, 0.0),
            lambda number: self.fitted(int(np.searchsorted(numbers, number))),
        )

    def ranking(self) -> NDArray[np.int64]:
        """Return candidates, best first; equals, which rounding must not order, by number."""
        return np.argsort(-np.round(np.nan_to_num(self.log_odds, neginf=-1e9), 6), kind="stable")


@dataclass(frozen=True)
class _SameSize:
    """Candidates of the same number of coefficients."""

    numbers: NDArray[np.int64]
    columns: NDArray[np.int64]
    """``(C, q)``"""
    gram: Array
    """``(C, q, q)`` whitened products of each candidate's columns."""
    scales: Array
    log_prior: Array
    """``(C, T)`` multiples of the usual size, and the log prior of each."""


class Evidence:
    """Scores of candidates beside the effects of a whitened model, and beside all but some of them."""

    def __init__(self, white: Whitened, columns: Array, candidates: Sequence[Candidate]) -> None:
        """Take the products of the candidates' whitened ``columns`` ``(n, K)`` with the model's."""
        self._white, self._candidates = white, candidates
        self._gram, self._rhs = white.columns.T @ white.columns, white.columns.T @ white.y
        self.cross = white.columns.T @ columns
        self.products = columns.T @ white.y
        self.columns = columns
        self._log_prior = np.array([candidate.log_prior for candidate in candidates])
        self._positive = np.array([candidate.effect.traits.is_nonnegative for candidate in candidates], dtype=bool)
        self.places = list(column_places(candidates))
        self._groups = list(self._grouped(columns))

    def _grouped(self, columns: Array) -> Iterator[_SameSize]:
        for size in sorted({len(candidate.terms) for candidate in self._candidates}):
            numbers = np.array([i for i, c in enumerate(self._candidates) if len(c.terms) == size], dtype=np.int64)
            at = np.array([self.places[i] for i in numbers])
            if size == 1:
                gram = np.einsum("nc,nc->c", columns[:, at[:, 0]], columns[:, at[:, 0]])[:, None, None]
            else:
                part = columns[:, at]
                gram = np.matmul(part.transpose(1, 2, 0), part.transpose(1, 0, 2))
            scales = [self._candidates[i].scales for i in numbers]
            yield _SameSize(numbers, at, gram, np.array([s for s, _ in scales]), np.array([p for _, p in scales]))

    def conditioned(self, kept: NDArray[np.int64]) -> tuple[Array, Array, float]:
        """Return reduced products ``(P', K)`` with the candidates, ``(K,)`` Z'P y and y'P y, given columns ``kept``."""
        system = self._gram[np.ix_(kept, kept)] + np.eye(kept.size)
        triangle = np.linalg.cholesky(system)
        right = solve_triangular(triangle, np.column_stack((self._rhs[kept], self.cross[kept])), lower=True)
        reduced, square = right[:, 1:], float(self._white.y @ self._white.y - right[:, 0] @ right[:, 0])
        return reduced, self.products - reduced.T @ right[:, 0], square

    def effective(self, chosen: NDArray[np.bool_]) -> float:
        """Return how many of the ``chosen`` coefficients ``(P,)`` of the model the data decide, not the prior."""
        inverse = solve_triangular(self._white.triangle, np.eye(chosen.size), lower=True)
        return float(np.sum((1.0 - np.sum(np.square(inverse), axis=0))[chosen]))

    def scores(self, kept: NDArray[np.int64], flat: float) -> Scores:
        """Return the scores beside the columns ``kept`` of the model; the data decide ``flat`` broad coefficients."""
        reduced, products, square = self.conditioned(kept)
        dof = max(float(self._white.y.size - flat), 1.0)
        count = len(self._candidates)
        log_bayes, scale, gain = np.full(count, -np.inf), np.ones(count), np.zeros(count)
        for group in self._groups:
            part = reduced[:, group.columns]
            new = group.gram - np.matmul(part.transpose(1, 2, 0), part.transpose(1, 0, 2))
            values, vectors = np.linalg.eigh(new)
            along = np.einsum("cqr,cq->cr", vectors, products[group.columns])
            seen = values > _NEW * np.trace(group.gram, axis1=1, axis2=2)[:, None]
            values, along = np.where(seen, values, 0.0)[:, None, :], np.where(seen, along, 0.0)[:, None, :]
            noise = np.full(group.scales.shape, square / dof)
            for _ in range(_SCALE_ROUNDS):
                precision = (noise / np.square(group.scales))[:, :, None]
                explained = np.sum(np.square(along) / (values + precision), axis=2)
                noise = np.maximum(square - explained, 1e-9 * square) / dof
            log_ratio = np.log(noise * dof / square)
            log_scales = -0.5 * dof * log_ratio - 0.5 * np.sum(np.log1p(values / precision), axis=2)
            if group.columns.shape[1] == 1:
                sign = along[:, :, 0] / np.sqrt((values[:, :, 0] + precision[:, :, 0]) * noise)
                half = math.log(2.0) + log_ndtr(sign)
                log_scales += np.where(self._positive[group.numbers][:, None], half, 0.0)
            log_scales += group.log_prior
            best = np.argmax(log_scales, axis=1)
            each = np.arange(best.size)
            log_bayes[group.numbers] = np.where(seen.any(axis=1), logsumexp(log_scales, axis=1), -np.inf)
            scale[group.numbers] = group.scales[each, best]
            gain[group.numbers] = explained[each, best] / square

        def fitted(number: int) -> Array:
            at = self.places[number]
            new = self.columns[:, at].T @ self.columns[:, at] - reduced[:, at].T @ reduced[:, at]
            return np.asarray(np.linalg.pinv(new, rcond=_NEW, hermitian=True) @ products[at])

        return Scores(log_bayes + self._log_prior, log_bayes, scale, gain, fitted)

    def similarity(self, kept: NDArray[np.int64], first: int, second: int) -> float:
        """Return the cosine between the least-squares fits of two candidates to the residual beside ``kept``."""
        reduced, products, _ = self.conditioned(kept)
        at = (self.places[first], self.places[second])

        def new(a: NDArray[np.int64], b: NDArray[np.int64]) -> Array:
            result: Array = self.columns[:, a].T @ self.columns[:, b] - reduced[:, a].T @ reduced[:, b]
            return result

        fits = [np.linalg.pinv(new(a, a), rcond=_NEW, hermitian=True) @ products[a] for a in at]
        lengths = [float(fit @ new(a, a) @ fit) for fit, a in zip(fits, at, strict=True)]
        if min(lengths) <= 0.0:
            return 0.0
        cosine = float(fits[0] @ new(*at) @ fits[1]) / math.sqrt(lengths[0] * lengths[1])
        return min(max(cosine, -1.0), 1.0)


def column_places(candidates: Sequence[Candidate]) -> Iterator[NDArray[np.int64]]:
    """Yield the numbers of each candidate's columns."""
    start = 0
    for candidate in candidates:
        yield np.arange(start, start + len(candidate.terms))
        start += len(candidate.terms)
