"""Optimal choice of poses for a linear model: greedy addition, then exchange, on a criterion of the information.

The information of poses n with whitened columns A_n ``(M, P)`` and prior information L is L + sum A_n^T A_n. The
criterion states the cost of an information matrix, and the cost with one more pose for all candidates at once.

Sources: V. V. Fedorov, "Theory of Optimal Experiments", 1972 (exchange); T. J. Mitchell, "An algorithm for the
construction of D-optimal experimental designs", Technometrics 16, 1974 (removal and addition); A. C. Atkinson,
A. N. Donev, R. D. Tobias, "Optimum Experimental Designs, with SAS", 2007 (criteria).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array

Criterion = Literal["I", "G", "D", "A"]

EXCHANGED = 1000
"""Candidates other than the chosen poses that exchange looks at."""
_RANDOM_STARTS = 2
"""Random designs that exchange starts from, beside the greedy one, as it ends in a local optimum."""
_RANDOM_DRAWS = 10
"""Random designs that a planned one is compared with."""
_LEAST_GAIN = 1e-3
"""Share of the cost that a pass of exchange must gain for another pass."""
_PEAKING = 8.0
"""Power of a task pose's error in its weight: the mean with such weights follows the worst error."""


class DesignCriterion(Protocol):
    """Cost of a design; less is better."""

    def cost(self, information: Array) -> float:
        """Return the cost of poses with this information ``(P, P)``."""

    def costs(self, information: Array, rows: Array) -> Array:
        """Return ``(N,)`` the cost with each of N poses ``(N, M, P)`` added, up to a constant."""


@dataclass(frozen=True, slots=True)
class DesignProblem:
    """Candidates, what is known before the first pose, and what the poses are chosen for."""

    rows: Array
    """``(N, M, P)`` whitened columns of N candidates, in units of a common scale such as the prior's."""
    information: Array
    """``(P, P)`` information before the first pose: prior and poses measured already."""
    criterion: DesignCriterion

    def information_with(self, chosen: NDArray[np.int64]) -> Array:
        """Return ``(P, P)`` the information with the candidates ``chosen``."""
        return self.information + information_of(self.rows[chosen])

    def cost(self, chosen: NDArray[np.int64]) -> float:
        """Return the cost of the candidates ``chosen``."""
        return self.criterion.cost(self.information_with(chosen))

    def costs_beside(self, chosen: NDArray[np.int64]) -> Array:
        """Return ``(N,)`` the cost of ``chosen`` with each candidate, up to a constant; infinite for those chosen."""
        costs = self.criterion.costs(self.information_with(chosen), self.rows)
        costs[chosen] = np.inf
        return costs

    def best(self, count: int) -> NDArray[np.int64]:
        """Return the greedy choice of ``count`` candidates; its beginnings are those of fewer."""
        return greedy(self.costs_beside, self.rows.shape[0], count)


@dataclass(frozen=True, slots=True)
class FitCriterion:
    """Error that the coefficients' covariance C leaves after a fit.

    A pose with columns A reduces tr(W C) by tr((I + G)^-1 H) and raises log det of the information by log det(I + G),
    with G = A C A^T and H = A C W C A^T.
    """

    name: Criterion
    """Mean (I, A) or largest (G) variance over the region, or the determinant of C (D)."""
    region: Array
    """``(3, T, P)`` displacement of the target at T task poses, m; for A ``(1, T, P)`` coefficients of interest."""

    def cost(self, information: Array) -> float:
        """Return the variance, or log det C."""
        if self.name == "D":
            return -float(np.linalg.slogdet(information)[1])
        variance = region_variance(self.region, np.linalg.inv(information))
        return float(variance.max() if self.name == "G" else variance.mean())

    def costs(self, information: Array, rows: Array) -> Array:
        """Return minus the gain of each pose; for G that of the mean with weights that follow the worst error."""
        covariance = np.linalg.inv(information)
        turned = rows @ covariance
        spread = np.eye(rows.shape[1]) + turned @ np.swapaxes(rows, 1, 2)
        if self.name == "D":
            return np.asarray(-np.linalg.slogdet(spread)[1])
        share = np.ones(self.region.shape[1])
        if self.name == "G":
            variance = region_variance(self.region, covariance)
            share = np.power(variance / variance.max(), _PEAKING)
        weight = information_of(self.region * np.sqrt(share / share.sum())[:, None])
        reach = turned @ weight @ np.swapaxes(turned, 1, 2)
        return np.asarray(-np.sum(np.linalg.inv(spread) * reach, axis=(1, 2)))


def region_variance(region: Array, covariance: NDArray[np.floating[Any]]) -> Array:
    """Return ``(T,)`` variance of the predicted position at each task pose, m^2, summed over x, y, z."""
    return np.asarray(np.sum((region @ covariance) * region, axis=(0, 2)))


def information_of(rows: Array) -> Array:
    """Return ``(P, P)`` information of rows ``(..., P)``."""
    flat = rows.reshape(-1, rows.shape[-1])
    return np.asarray(flat.T @ flat)


def greedy(costs: Callable[[NDArray[np.int64]], Array], n: int, count: int) -> NDArray[np.int64]:
    """Return ``count`` different numbers below ``n``, each of least cost beside those before it; all if ``n`` is less.

    ``costs`` gives the cost ``(n,)`` of each number beside those chosen. It is called once for each choice.
    """
    chosen = np.zeros(0, dtype=np.int64)
    while chosen.size < min(count, n):
        cost = costs(chosen)
        cost[chosen] = np.inf
        chosen = np.append(chosen, np.argmin(cost))
    return chosen


def exchanged(problem: DesignProblem, chosen: NDArray[np.int64], others: int = EXCHANGED) -> NDArray[np.int64]:
    """Return the design ``chosen``, improved: each pose in turn, the least useful first, gives way to a better one.

    It looks at the ``others`` candidates that are worth most beside the design.
    """
    ranked = np.argsort(problem.costs_beside(chosen), kind="stable")
    pool = np.concatenate((chosen, ranked[: min(others, ranked.size - chosen.size)]))
    part = dataclasses.replace(problem, rows=problem.rows[pool])
    design = np.arange(chosen.size)
    start, cost = np.inf, part.cost(design)
    while start - cost > _LEAST_GAIN * abs(cost):
        start = cost
        without = [part.cost(np.delete(design, place)) for place in range(design.size)]
        for place in np.argsort(without, kind="stable").tolist():
            trial = design.copy()
            trial[place] = np.argmin(part.costs_beside(np.delete(design, place)))
            if (trial_cost := part.cost(trial)) < cost:
                design, cost = trial, trial_cost
    return pool[design]


def random_designs(n: int, size: int, stream: int, seed: int, times: int = _RANDOM_DRAWS) -> list[NDArray[np.int64]]:
    """Return random sets of ``size`` different numbers below ``n``, or of all; ``stream`` keeps draws apart."""
    generator = np.random.default_rng([seed, stream])
    return [generator.choice(n, min(size, n), replace=False) for _ in range(times)]


def choose(problem: DesignProblem, start: NDArray[np.int64], seed: int, others: int = EXCHANGED) -> NDArray[np.int64]:
    """Return the best design that exchange reaches from ``start`` and from random designs of as many poses."""
    random = random_designs(problem.rows.shape[0], start.size, 5, seed, _RANDOM_STARTS)
    designs = [exchanged(problem, design, others) for design in (start, *random)]
    costs = np.array([problem.cost(design) for design in designs])
    # The first of equal designs: rounding makes a different one the best on different machines.
    return designs[int(np.argmax(costs <= costs.min() + 1e-9 * abs(costs.min())))]
