"""Optimal choice of poses for a linear model: greedy addition and exchange, with updates of small rank.

The information of poses n with whitened columns A_n ``(M, P)`` and prior information L is L + sum A_n^T A_n; its
inverse C is the covariance of the coefficients. With G_n = A_n C A_n^T and H_n = A_n C W C A_n^T, a pose reduces
tr(W C) by tr((I + G_n)^-1 H_n) and raises log det of the information by log det(I + G_n). One chosen pose changes C by
rank M, and every G_n and H_n by one product of matrices, so the work of a step is linear in the candidates.

Sources: V. V. Fedorov, "Theory of Optimal Experiments", 1972 (exchange); T. J. Mitchell, "An algorithm for the
construction of D-optimal experimental designs", Technometrics 16, 1974 (removal and addition); A. C. Atkinson,
A. N. Donev, R. D. Tobias, "Optimum Experimental Designs, with SAS", 2007 (criteria).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array

Criterion = Literal["I", "G", "D", "A"]
CRITERIA: tuple[Criterion, ...] = ("I", "G", "D", "A")

_REFRESHED = 15
"""Updates after which the products are computed again, so that rounding does not accumulate."""
_REFRESHED_WORST = 4
"""The same for the worst error, whose weights change."""
EXCHANGED = 1000
"""Candidates other than the chosen poses that exchange looks at."""
_LEAST_PIVOT = 1e-12
PASSES = 3
"""Most passes of exchange over the chosen poses."""
_LEAST_GAIN = 1e-3
"""Share of the criterion that a pass of exchange must gain for another pass."""
_PEAKING = 8.0
"""Power of a task pose's error in its weight: the mean with such weights follows the worst error."""


@dataclass(frozen=True, slots=True)
class DesignProblem:
    """Candidates, prior information, and the region where the model must predict well.

    Coefficients are in units of a common scale, usually their prior standard deviations.
    """

    rows: Array
    """``(M, N, P)`` whitened columns of N candidates."""
    information: Array
    """``(P, P)`` information before the first pose: prior and poses measured already; positive definite."""
    region: Array
    """``(3, T, P)`` displacement of the target by each coefficient at T task poses, m."""
    criterion: Criterion = "I"
    interest: Array | None = None
    """``(P,)`` weights of the coefficients' variances for A; all 1 if None."""

    def weight(self, covariance: Array) -> Array:
        """Return ``(P, P)`` the matrix W of the criterion tr(W C); for G, of the worst errors at ``covariance``."""
        if self.criterion == "A":
            return np.diag(np.ones(self.information.shape[0]) if self.interest is None else self.interest)
        if self.criterion == "G":
            variance = region_variance(self.region, covariance)
            share = np.power(variance / variance.max(), _PEAKING)
            flat = (self.region * np.sqrt(share / share.sum())[:, None]).reshape(-1, self.region.shape[2])
        else:
            flat = self.region.reshape(-1, self.region.shape[2]) / np.sqrt(self.region.shape[1])
        result: Array = flat.T @ flat
        return result

    def value(self, information: Array) -> float:
        """Return the criterion, smaller is better: mean (I) or largest (G) variance, m^2; tr(W C) (A); -log det (D)."""
        if self.criterion == "D":
            return -float(np.linalg.slogdet(information)[1])
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        if self.criterion == "G":
            return float(region_variance(self.region, covariance).max())
        return float(np.sum(self.weight(covariance) * covariance))


def region_variance(region: Array, covariance: Array) -> Array:
    """Return ``(T,)`` variance of the predicted position at each task pose, m^2, summed over x, y, z."""
    flat = region.reshape(-1, region.shape[2])
    result: Array = np.sum((flat @ covariance) * flat, axis=1).reshape(region.shape[:2]).sum(axis=0)
    return result


def information_of(rows: Array) -> Array:
    """Return ``(P, P)`` information of poses ``(M, n, P)``."""
    flat = rows.reshape(-1, rows.shape[2])
    result: Array = flat.T @ flat
    return result


def choose(
    problem: DesignProblem,
    count: int,
    allowed: NDArray[np.bool_] | None = None,
    *,
    exchanged: int = EXCHANGED,
    passes: int = PASSES,
) -> NDArray[np.int64]:
    """Return ``count`` different candidates: greedy, then improved by exchange.

    Args:
        problem: Candidates and criterion.
        count: Number of candidates to choose.
        allowed: ``(N,)`` candidates that may be chosen; all if None.
        exchanged: Candidates other than the chosen poses that exchange looks at; 0 for no exchange.
        passes: Most passes of exchange over the chosen poses.
    """
    free = np.ones(problem.rows.shape[1], dtype=bool) if allowed is None else allowed.copy()
    search = _DesignSearch(problem, free)
    chosen = np.array([search.add_best() for _ in range(min(count, int(np.count_nonzero(free))))], dtype=np.int64)
    if exchanged == 0 or chosen.size == 0:
        return chosen
    # Exchange looks at the candidates that are worth most beside the greedy design, so its work is limited.
    score = np.where(search.free, search.improvement(np.arange(free.size), 1.0), -np.inf)
    others = np.argsort(-score, kind="stable")[: min(exchanged, int(np.count_nonzero(search.free)))]
    pool = np.concatenate((chosen, others))
    part = dataclasses.replace(problem, rows=problem.rows[:, pool])
    return pool[_exchange(part, chosen.size, passes)]


def _exchange(problem: DesignProblem, count: int, passes: int) -> NDArray[np.int64]:
    """Improve the design of the first ``count`` candidates.

    Each pose in turn, the least useful first, gives way to the best candidate, as long as the criterion falls.
    """
    chosen = np.arange(count)
    start_information = problem.information + information_of(problem.rows[:, :count])
    search = _DesignSearch(problem, np.arange(problem.rows.shape[1]) >= count, start_information)
    value = problem.value(search.information)
    for _ in range(passes):
        start = value
        search.refresh()
        for place in np.argsort(search.improvement(chosen, -1.0), kind="stable").tolist():
            before = search.state()
            removed = int(chosen[place])
            search.change(removed, -1.0)
            search.free[removed] = True
            added = search.add_best()
            after = problem.value(search.information) if added != removed else value
            if after < value:
                chosen[place], value = added, after
            else:
                search.free[added], search.free[removed] = True, False
                search.restore(before)
        if abs(start - value) <= _LEAST_GAIN * abs(start):
            break
    return chosen


class _DesignSearch:
    """State of a search: the information, and G and H of every candidate."""

    def __init__(self, problem: DesignProblem, free: NDArray[np.bool_], information: Array | None = None) -> None:
        self.problem = problem
        self.free = free
        self.information = problem.information if information is None else information
        components, count, size = problem.rows.shape
        # Coefficients first, so that every operation runs over long rows.
        self.columns = np.ascontiguousarray(problem.rows.reshape(-1, size).T).reshape(size, components, count)
        self.refresh()

    def refresh(self) -> None:
        """Compute the covariance and every G and H anew."""
        self.covariance = np.asarray(np.linalg.inv(self.information), dtype=np.float64)
        self.weight = self.problem.weight(self.covariance)
        self.gain = self._products(self.covariance)
        self.reach: Array | None = None
        if self.problem.criterion != "D":
            self.reach = self._products(self.covariance @ self.weight @ self.covariance)
        self.changes = 0

    def state(self) -> tuple[Array, Array, Array, Array, Array | None, int]:
        """Return the state without the free candidates."""
        return self.information, self.covariance, self.weight, self.gain, self.reach, self.changes

    def restore(self, state: tuple[Array, Array, Array, Array, Array | None, int]) -> None:
        """Return to a state."""
        self.information, self.covariance, self.weight, self.gain, self.reach, self.changes = state

    def _products(self, matrix: Array) -> Array:
        """Return ``(M, M, N)`` A_n X A_n^T of a symmetric matrix X ``(P, P)``."""
        _, components, count = self.columns.shape
        result = np.empty((components, components, count))
        for i in range(components):
            turned = matrix @ self.columns[:, i]
            for j in range(i + 1):
                result[i, j] = result[j, i] = np.einsum("pn,pn->n", turned, self.columns[:, j])
        return result

    def change(self, index: int, sign: float) -> None:
        """Add (``sign`` 1) or remove (-1) a pose."""
        rows = self.problem.rows[:, index]
        self.information = self.information + sign * rows.T @ rows
        if self.changes + 1 >= (_REFRESHED_WORST if self.problem.criterion == "G" else _REFRESHED):
            self.refresh()
            return
        self.changes += 1
        size = rows.shape[0]
        span = self.covariance @ rows.T
        scaled = span @ (sign * np.linalg.inv(np.eye(size) + sign * rows @ span))
        directions = [span, scaled]
        if self.reach is not None:
            weighted = self.weight @ span
            directions.append(self.covariance @ weighted - 0.5 * scaled @ (span.T @ weighted))
        stacked = np.concatenate(directions, axis=1).T @ self.columns.reshape(self.columns.shape[0], -1)
        parts = stacked.reshape(len(directions), size, size, -1)
        self.gain = self.gain - _outer(parts[1], parts[0])
        if self.reach is not None:
            cross = _outer(parts[1], parts[2])
            self.reach = self.reach - cross - np.swapaxes(cross, 0, 1)
        self.covariance = self.covariance - scaled @ span.T

    def add_best(self) -> int:
        """Add the best free candidate and return its number."""
        score = np.where(self.free, self.improvement(slice(None), 1.0), -np.inf)
        best = int(np.argmax(score))
        self.free[best] = False
        self.change(best, 1.0)
        return best

    def improvement(self, at: slice | NDArray[np.int64], sign: float) -> Array:
        """Return what addition gains (``sign`` 1) or removal loses (-1), for the candidates ``at``."""
        size = self.gain.shape[0]
        matrix = np.eye(size)[:, :, None] + sign * self.gain[:, :, at]
        other = None if self.reach is None else self.reach[:, :, at].copy()
        log_det, trace = np.zeros(matrix.shape[2]), np.zeros(matrix.shape[2])
        for k in range(size):
            # Elimination of a symmetric matrix S and, on both sides, of H: tr(S^-1 H) is the sum of H_kk over pivots.
            pivot = np.maximum(matrix[k, k], _LEAST_PIVOT)
            for i in range(k + 1, size):
                factor = matrix[i, k] / pivot
                matrix[i, k + 1 :] -= factor * matrix[k, k + 1 :]
                if other is not None:
                    other[i] -= factor * other[k]
                    other[:, i] -= factor * other[:, k]
            log_det += np.log(pivot)
            if other is not None:
                trace += other[k, k] / pivot
        return sign * log_det if other is None else trace


def _outer(first: Array, second: Array) -> Array:
    """Return ``(M, M, N)`` the sum over m of first[m, i] second[m, j], of arrays ``(M, M, N)``."""
    result = np.zeros((first.shape[1], second.shape[1], first.shape[2]))
    for first_row, second_row in zip(first, second, strict=True):
        result += first_row[:, None] * second_row[None]
    return result
