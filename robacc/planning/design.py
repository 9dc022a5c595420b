"""Optimal choice of poses for a linear model, and the order of their visits.

The choice is greedy addition, then exchange, on a criterion of the information. The information of poses n with
whitened columns A_n ``(M, P)`` and prior information L is L + sum A_n^T A_n. The criterion states the cost of an
information matrix, and the cost with one more pose for all candidates at once.

Sources: V. V. Fedorov, "Theory of Optimal Experiments", 1972 (exchange); T. J. Mitchell, "An algorithm for the
construction of D-optimal experimental designs", Technometrics 16, 1974 (removal and addition); A. C. Atkinson,
A. N. Donev, R. D. Tobias, "Optimum Experimental Designs, with SAS", 2007 (criteria).

The planned poses are visited in a few passes. Every pass goes through the whole workspace, so that a drift over time,
such as a warm-up, is not confused with place; passes run to and fro along one short route, so that each joint is
approached from both directions. A check pose is visited at the start, after every k poses and at the end.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from robacc.fitting.levels import ACCEPTED
from robacc.geometry import Array, NDArray
from robacc.measurements import motion_between_rows

Criterion = Literal["I", "G", "D", "A"]

EXCHANGED = 1000
"""Candidates other than the chosen poses that exchange looks at."""


@dataclass(frozen=True, eq=False)
class FitCriterion:
    """Error that the coefficients' covariance C leaves after a fit.

    A pose with columns A reduces tr(W C) by tr((I + G)^-1 H) and raises log det of the information by log det(I + G),
    with G = A C A^T and H = A C W C A^T.
    """

    name: Criterion
    """Mean (I, A) or largest (G) variance over the region, or the determinant of C (D)."""
    region: Array
    """``(3, T, P)`` displacement of the target at T task poses, m; for A ``(1, T, P)`` coefficients of interest."""

    @cached_property
    def mean_weight(self) -> Array:
        """Matrix W ``(P, P)`` with tr(W C) the mean variance over the region."""
        return np.asarray(information_of(self.region) / self.region.shape[1])

    def cost(self, information: Array) -> float:
        """Return the variance, or log det C."""
        if self.name == "D":
            return -float(np.linalg.slogdet(information)[1])
        covariance = np.linalg.inv(information)
        if self.name == "G":
            return float(region_variance(self.region, covariance).max())
        return float(np.sum(self.mean_weight * covariance))

    def costs(self, information: Array, rows: Array) -> Array:
        """Return minus the gain of each pose; for G that of the mean with weights that follow the worst error."""
        covariance, weight = np.linalg.inv(information), self.mean_weight
        if self.name == "G":
            variance = region_variance(self.region, covariance)
            # Power of a task pose's error in its weight: the mean with such weights follows the worst error.
            share = np.power(variance / variance.max(), 8.0)
            weight = information_of(self.region * np.sqrt(share / share.sum())[:, None])
        # One product of all rows takes half the time of one product for each pose.
        flat, turned = rows.reshape(-1, rows.shape[2]), np.swapaxes(rows, 1, 2)
        spread = np.eye(rows.shape[1]) + (flat @ covariance).reshape(rows.shape) @ turned
        if self.name == "D":
            return np.asarray(-np.linalg.slogdet(spread)[1])
        gain = (flat @ (covariance @ weight @ covariance)).reshape(rows.shape) @ turned
        return np.asarray(-np.sum(np.linalg.inv(spread) * gain, axis=(1, 2)))


# Choice of poses on which a trace finds every effect at its usual size, and distinguishes it from its rivals.
#
# Given the free effects, a coefficient k of the usual size has the noncentrality v_k, the squared length of its
# whitened column orthogonal to theirs. A trace finds it with a probability near Phi(sqrt(v_k) - sqrt(c_k)), where c_k
# is the noncentrality at probability 1/2. Given its nearest rival r as well, v_k - c_kr^2 / v_r remains; from twice
# the evidence that makes a rival an alternative, the two are distinguishable. The design maximises the mean of the
# two probabilities.
#
# The information is that of the free coefficients, then the catalogue's. With x = C A^T b the regression of the
# catalogue's columns b on the free ones A, pose n adds r^T (I + A_n C A_n^T)^-1 r to the products of the columns,
# r = b_n - A_n x (Å. Björck, "Numerical Methods for Least Squares Problems", 1996, section 3.2).


@dataclass(frozen=True, slots=True)
class PowerCriterion:
    """Minus the mean of the probabilities to find a coefficient, and to find it and separate it from its rival."""

    even_chance: Array
    """``(K,)`` noncentrality at which the coefficient is found with probability 1/2."""
    rival: NDArray[np.int64]
    """``(K,)`` nearest rival of each coefficient; itself where it has none."""

    def powers(self, information: Array, rows: Array) -> Array:
        """Return ``(2, N)`` the probabilities to find, and to find and separate, with each pose of ``rows`` added."""
        from scipy.special import ndtr

        count = information.shape[0] - self.rival.size
        cross = information[:count, count:]
        covariance: Array = np.asarray(np.linalg.inv(information[:count, :count]), dtype=np.float64)
        solution = covariance @ cross
        # Products of the new part of each of the catalogue's columns with itself and with its rival's.
        new = information[count:, count:] - cross.T @ solution
        free, columns = np.split(rows, [count], axis=2)
        gain = free @ covariance @ np.swapaxes(free, 1, 2)
        white = np.linalg.inv(np.linalg.cholesky(np.eye(rows.shape[1]) + gain)) @ (columns - free @ solution)
        with_itself = np.diag(new) + np.sum(np.square(white), axis=1)
        own = np.arange(self.rival.size)
        with_rival = new[own, self.rival] + np.sum(white * white[:, :, self.rival], axis=1)
        detected = ndtr(np.sqrt(np.maximum(with_itself, 0.0)) - np.sqrt(self.even_chance))
        beside = np.maximum(with_itself - np.square(with_rival) / np.maximum(with_itself[:, self.rival], 1e-12), 0.0)
        separated = np.where(self.rival == own, 1.0, ndtr(np.sqrt(beside) - np.sqrt(2.0 * ACCEPTED)))
        return np.stack((detected.mean(axis=1), (detected * separated).mean(axis=1)))

    def cost(self, information: Array) -> float:
        """Return minus the mean of the two probabilities."""
        return float(self.costs(information, np.zeros((1, 1, information.shape[0])))[0])

    def costs(self, information: Array, rows: Array) -> Array:
        """Return ``(N,)`` the cost with each of the poses ``(N, M, P + K)`` added."""
        return np.asarray(-np.mean(self.powers(information, rows), axis=0))


@dataclass(frozen=True, slots=True)
class DesignProblem:
    """Candidates, what is known before the first pose, and what the poses are chosen for."""

    rows: Array
    """``(N, M, P)`` whitened columns of N candidates, in units of a common scale such as the prior's."""
    information: Array
    """``(P, P)`` information before the first pose: prior and poses measured already."""
    criterion: FitCriterion | PowerCriterion

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
    part = replace(problem, rows=problem.rows[pool])
    design = np.arange(chosen.size)
    start, cost = np.inf, part.cost(design)
    # Share of the cost that a pass of exchange must gain for another pass.
    while start - cost > 1e-3 * abs(cost):
        start = cost
        without = [part.cost(np.delete(design, place)) for place in range(design.size)]
        for place in np.argsort(without, kind="stable").tolist():
            trial = design.copy()
            trial[place] = np.argmin(part.costs_beside(np.delete(design, place)))
            if (trial_cost := part.cost(trial)) < cost:
                design, cost = trial, trial_cost
    return pool[design]


def random_designs(n: int, size: int, stream: int, seed: int, times: int = 10) -> list[NDArray[np.int64]]:
    """Return random sets of ``size`` different numbers below ``n``, or of all; ``stream`` keeps draws apart."""
    generator = np.random.default_rng([seed, stream])
    return [generator.choice(n, min(size, n), replace=False) for _ in range(times)]


def choose(problem: DesignProblem, start: NDArray[np.int64], seed: int, others: int = EXCHANGED) -> NDArray[np.int64]:
    """Return the best design that exchange reaches from ``start`` and from random designs of as many poses."""
    # Random designs that exchange starts from, beside the greedy one, as it ends in a local optimum.
    starts = (start, *random_designs(problem.rows.shape[0], start.size, 5, seed, 2))
    designs = [exchanged(problem, design, others) for design in starts]
    costs = np.array([problem.cost(design) for design in designs])
    # The first of equal designs: rounding makes a different one the best on different machines.
    return designs[int(np.argmax(costs <= costs.min() + 1e-9 * abs(costs.min())))]


def expected_power(
    problem: DesignProblem, criterion: PowerCriterion, chosen: NDArray[np.int64], seed: int
) -> Mapping[str, float]:
    """Return the mean probabilities over the catalogue at the usual sizes, with the keys of the result.

    They are those of the candidates ``chosen``, and the means over random sets of as many.
    """
    none = np.zeros((1, 1, problem.rows.shape[2]))
    planned, *random = (
        criterion.powers(problem.information_with(at), none)[:, 0]
        for at in (chosen, *random_designs(problem.rows.shape[0], chosen.size, chosen.size, seed))
    )
    (found, separated), (random_found, random_separated) = planned.tolist(), np.mean(random, axis=0).tolist()
    return {
        "found": found,
        "separated": separated,
        "random_found": random_found,
        "random_separated": random_separated,
    }


# Order of the visits.

LEAST_DIRECTION_SHARE = 0.3
"""Share of the approaches of each joint that each direction must have."""


@dataclass(frozen=True, slots=True)
class Route:
    """Sequence of visits."""

    visits: NDArray[np.int64]
    """``(V,)`` number of the pose at each visit."""
    roles: tuple[str, ...]
    """``pose``, ``repeat`` or ``check`` of each."""
    figures: Mapping[str, Any]
    """Figures of the order, with the keys of the result: passes; length, the sum over all moves of the largest joint
    move as a share of its range, and that in a random order; share of the rarer direction among each joint's
    approaches; standard deviation of each joint's relative last speed in size, 0 where all are equal; and the share of
    a drift linear in time that a linear function of the joints explains, 1 if fully confused."""


def route(q: Array, payload: Array | None, repeats: int, every: int, seed: int) -> Route:
    """Return the order of visits to poses ``(J, n)`` in which each payload ``(n,)`` is mounted once.

    Args:
        q: Joint variables, rad or m.
        payload: Payload of each pose, kg; None for no payload.
        repeats: Number of poses that are visited a second time, shared by the payloads.
        every: Visits from one check to the next; 0 for no check. Each payload has its own check pose.
        seed: Seed of the local search.
    """
    masses = np.zeros(q.shape[1]) if payload is None else payload
    groups = [np.flatnonzero(masses == mass) for mass in np.unique(masses)]
    parts, checks, passes = [], [], 0
    for number, at in enumerate(groups):
        scaled = _in_ranges(q[:, at])
        check = int(np.argmin(_from_middle(scaled))) if every and at.size > 2 else None
        share = repeats // len(groups) + (number < repeats % len(groups))
        order, own_passes = _ordered(scaled, share, check, max(every, 1), seed)
        checks += [] if check is None else [int(at[check])]
        parts.append(at[order])
        passes = max(passes, own_passes)
    visits = np.concatenate(parts)
    first = np.unique(visits, return_index=True)[1]
    roles = [
        "check" if node in checks else "pose" if place in first else "repeat"
        for place, node in enumerate(visits.tolist())
    ]
    scaled = _in_ranges(q)
    direction, speed = motion_between_rows(q[:, visits])
    return Route(
        visits,
        tuple(roles),
        {
            "passes": passes,
            "length": _length(scaled[:, visits]),
            "random_length": _length(scaled[:, np.random.default_rng([seed, 1]).permutation(visits)]),
            "rarer_direction_share": direction_shares(direction),
            "speed_std": np.array([float(np.std(np.abs(row[row != 0]))) if np.any(row) else 0.0 for row in speed]),
            "drift_share": _drift_share(scaled[:, visits]),
            "repeats": roles.count("repeat"),
            "checks": roles.count("check"),
        },
    )


def _in_ranges(q: Array) -> Array:
    """Return joint variables ``(J, n)`` in units of their ranges."""
    return np.asarray(q / np.maximum(np.ptp(q, axis=1), 1e-9)[:, None])


def _from_middle(scaled: Array) -> Array:
    """Return the squared distance ``(n,)`` of poses from the middle of all."""
    return np.asarray(np.sum(np.square(scaled - np.median(scaled, axis=1, keepdims=True)), axis=0))


def _ordered(scaled: Array, repeats: int, check: int | None, every: int, seed: int) -> tuple[NDArray[np.int64], int]:
    """Return the visits of poses ``(J, n)`` in units of their ranges, and the number of passes that is best."""
    nodes = np.array([i for i in range(scaled.shape[1]) if i != check], dtype=np.int64)
    among, gap = scaled[:, nodes], np.full(nodes.size, np.inf)

    def nearness(chosen: NDArray[np.int64]) -> Array:
        """Return minus the distance to the nearest of those chosen; the first is the middle pose."""
        if chosen.size == 0:
            return _from_middle(among)
        np.minimum(gap, np.sum(np.square(among - among[:, chosen[-1:]]), axis=0), out=gap)
        return -gap

    repeated = nodes[greedy(nearness, nodes.size, repeats)]
    tried = []
    for passes in range(1, min(4, max(nodes.size // 5, 1)) + 1):
        order = _balanced(scaled, _in_passes(scaled, nodes, repeated, passes), check, every, seed)
        visits = _with_checks(order, check, every)
        sequence = scaled[:, visits]
        tried.append((_cost(sequence) + 0.5 * order.size * max(_drift_share(sequence) - 0.3, 0.0), passes, visits))
    _, passes, visits = min(tried, key=lambda entry: entry[0])
    return visits, passes


def direction_shares(direction: Array) -> Array:
    """Return ``(J,)`` share of the rarer direction among the approaches of each joint; 0.5 is balanced."""
    up, down = np.count_nonzero(direction > 0, axis=1), np.count_nonzero(direction < 0, axis=1)
    return np.asarray(np.minimum(up, down) / np.maximum(up + down, 1))


def _length(scaled: Array) -> float:
    return float(np.sum(np.max(np.abs(np.diff(scaled, axis=1)), axis=0)))


def _missing_approaches(scaled: Array) -> float:
    shares = direction_shares(np.sign(np.diff(scaled, axis=1)))
    return float(np.sum(np.maximum(LEAST_DIRECTION_SHARE + 0.05 - shares, 0.0)) * scaled.shape[1])


def _cost(scaled: Array) -> float:
    """Return the length, plus the weight of approaches that are missing in a direction."""
    length = _length(scaled)
    # Weight of missing approaches against the length of the route, in mean moves.
    return float(length + 4.0 * length / max(scaled.shape[1], 1) * _missing_approaches(scaled))


def _tour(scaled: Array, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a short open route: the nearest neighbour next, then reversals of pieces (2-opt)."""
    if nodes.size < 3:
        return nodes
    points = scaled[:, nodes]
    distance = np.max(np.abs(points[:, :, None] - points[:, None, :]), axis=0)
    tour = greedy(lambda chosen: distance[chosen[-1] if chosen.size else 0].copy(), nodes.size, nodes.size)
    # The route is open at its end: a node of no distance comes after it.
    distance = np.pad(distance, (0, 1))
    improved = True
    while improved:
        improved = False
        for i in range(tour.size - 2):
            # Reversal of i + 1 … j replaces the moves (i, i + 1) and (j, j + 1).
            ends, after = tour[i + 2 :], np.append(tour[i + 3 :], tour.size)
            first, second = tour[i], tour[i + 1]
            change = distance[first, ends] + distance[second, after] - distance[first, second] - distance[ends, after]
            best = int(np.argmin(change))
            if change[best] < -1e-12:
                j = i + 2 + best
                tour[i + 1 : j + 1] = tour[i + 1 : j + 1][::-1]
                improved = True
    return np.asarray(nodes[tour])


def _in_passes(scaled: Array, nodes: NDArray[np.int64], repeated: NDArray[np.int64], passes: int) -> NDArray[np.int64]:
    """Return the visits: each pass takes every ``passes``-th pose of the route; repeats go into another pass."""
    tour = _tour(scaled, nodes)
    place = {node: (k + 1) % passes for k, node in enumerate(tour.tolist())}
    pieces: list[NDArray[np.int64]] = []
    for number in range(passes):
        again = np.array([node for node in repeated.tolist() if place[node] == number], dtype=np.int64)
        # With one pass, the second visits come after all first ones.
        parts = [tour, np.sort(again)] if passes == 1 else [np.concatenate((tour[number::passes], again))]
        piece = np.concatenate([_tour(scaled, part) for part in parts])
        if pieces:
            start, end, last = (scaled[:, node] for node in (piece[0], piece[-1], pieces[-1][-1]))
            piece = piece[::-1] if np.max(np.abs(end - last)) < np.max(np.abs(start - last)) else piece
        pieces.append(piece)
    return np.concatenate(pieces)


def _balanced(scaled: Array, order: NDArray[np.int64], check: int | None, every: int, seed: int) -> NDArray[np.int64]:
    """Improve the cost by reversals and moves of short pieces, until each joint has both directions or tries end."""
    generator = np.random.default_rng([seed, 2])
    n = order.size
    sequence = scaled[:, _with_checks(order, check, every)]
    cost = _cost(sequence)
    # Changes tried for both directions of approach.
    for _ in range(3000 if n > 3 else 0):
        if _missing_approaches(sequence) == 0.0:
            break
        first = int(generator.integers(0, n - 1))
        last = min(first + 1 + int(generator.integers(1, 6)), n)
        trial = order.copy()
        if generator.random() < 0.5:
            trial[first:last] = trial[first:last][::-1]
        else:
            other = int(generator.integers(0, n))
            trial[first], trial[other] = trial[other], trial[first]
        trial_sequence = scaled[:, _with_checks(trial, check, every)]
        trial_cost = _cost(trial_sequence)
        if trial_cost < cost and not np.any(trial[1:] == trial[:-1]):
            order, sequence, cost = trial, trial_sequence, trial_cost
    return order


def _with_checks(order: NDArray[np.int64], check: int | None, every: int) -> NDArray[np.int64]:
    """Return the visits with the check pose at the start, after every ``every`` visits, and at the end."""
    return order if check is None else np.append(np.insert(order, np.arange(0, order.size, every), check), check)


def _drift_share(scaled: Array) -> float:
    """Return R^2 of time regressed on the joints (adjusted for their number); 0 where there are too few visits."""
    joints, n = scaled.shape
    if n < joints + 3:
        return 0.0
    time, design = np.arange(n) - (n - 1) / 2, np.vstack((np.ones(n), scaled)).T
    residual = time - design @ np.linalg.lstsq(design, time, rcond=None)[0]
    return float(max(1.0 - residual @ residual / (time @ time) * (n - 1) / (n - 1 - joints), 0.0))
