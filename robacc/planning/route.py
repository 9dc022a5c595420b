"""Order of the visits: a short route in joint space, both directions of approach, repeats, drift checks.

The planned poses are visited in a few passes. Every pass goes through the whole workspace, so that a drift over time,
such as a warm-up, is not confused with place; passes run to and fro along one short route, so that each joint is
approached from both directions. A check pose is visited at the start, after every k poses and at the end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.measurements import motion_between_rows
from robacc.planning.design import greedy

Role = Literal["pose", "repeat", "check"]

LEAST_DIRECTION_SHARE = 0.3
"""Share of the approaches of each joint that each direction must have."""
_MOST_PASSES = 4
_TRIES = 3000
"""Changes tried for both directions of approach."""
_BALANCE = 4.0
"""Weight of missing approaches against the length of the route, in mean moves."""


@dataclass(frozen=True, slots=True)
class Route:
    """Sequence of visits."""

    visits: NDArray[np.int64]
    """``(V,)`` number of the pose at each visit."""
    roles: tuple[Role, ...]
    passes: int
    length: float
    """Sum over all moves of the largest joint move, as a share of its range."""
    random_length: float
    """The same in a random order."""
    direction_share: Array
    """``(J,)`` share of the rarer direction among a joint's approaches."""
    speed_std: Array
    """``(J,)`` standard deviation of a joint's relative last speed in size, 0 where all are equal."""
    drift_share: float
    """Share of a drift linear in time that a linear function of the joints explains: 1 if fully confused."""


def route(q: Array, payload: Array | None, repeats: int, every: int, seed: int) -> Route:
    """Return the order of visits to poses ``(J, n)`` in which each payload ``(n,)`` is mounted once.

    Args:
        q: Joint variables, rad or m.
        payload: Payload of each pose, kg; None for no payload.
        repeats: Number of poses that are visited a second time, shared by the payloads.
        every: Visits from one check to the next; 0 for no check. Each payload has its own check pose.
        seed: Seed of the local search.
    """
    levels, group = np.unique(np.zeros(q.shape[1]) if payload is None else payload, return_inverse=True)
    parts: list[NDArray[np.int64]] = []
    checks: list[int] = []
    most_passes = 0
    for number in range(levels.size):
        at = np.flatnonzero(group == number)
        share = repeats // levels.size + (number < repeats % levels.size)
        scaled = q[:, at] / np.maximum(np.ptp(q[:, at], axis=1), 1e-9)[:, None]
        check = int(np.argmin(_from_middle(scaled))) if every and at.size > 2 else None
        visits, passes = _ordered(scaled, share, check, max(every, 1), seed)
        checks += [] if check is None else [int(at[check])]
        parts.append(at[visits])
        most_passes = max(most_passes, passes)
    visits = np.concatenate(parts)
    first = np.isin(np.arange(visits.size), np.unique(visits, return_index=True)[1])
    roles: list[Role] = [
        "check" if node in checks else "pose" if is_first else "repeat"
        for node, is_first in zip(visits.tolist(), first, strict=True)
    ]
    scaled = q / np.maximum(np.ptp(q, axis=1), 1e-9)[:, None]
    direction, speed = motion_between_rows(q[:, visits])
    return Route(
        visits,
        tuple(roles),
        most_passes,
        _length(scaled[:, visits]),
        _length(scaled[:, np.random.default_rng([seed, 1]).permutation(visits)]),
        direction_shares(direction),
        np.array([float(np.std(np.abs(row[row != 0]))) if np.any(row) else 0.0 for row in speed]),
        _drift_share(scaled[:, visits]),
    )


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
    for passes in range(1, min(_MOST_PASSES, max(nodes.size // 5, 1)) + 1):
        order = _balanced(scaled, _in_passes(scaled, nodes, repeated, passes), check, every, seed)
        visits = _with_checks(order, check, every)
        sequence = scaled[:, visits]
        tried.append((_cost(sequence) + 0.5 * order.size * max(_drift_share(sequence) - 0.3, 0.0), passes, visits))
    _, passes, visits = min(tried, key=lambda entry: entry[0])
    return visits, passes


def direction_shares(direction: Array) -> Array:
    """Return ``(J,)`` share of the rarer direction among the approaches of each joint; 0.5 is balanced."""
    up = np.count_nonzero(direction > 0, axis=1)
    down = np.count_nonzero(direction < 0, axis=1)
    return np.asarray(np.minimum(up, down) / np.maximum(up + down, 1))


def _length(scaled: Array) -> float:
    return float(np.sum(np.max(np.abs(np.diff(scaled, axis=1)), axis=0)))


def _missing_approaches(scaled: Array) -> float:
    missing = LEAST_DIRECTION_SHARE + 0.05 - direction_shares(np.sign(np.diff(scaled, axis=1)))
    return float(np.sum(np.maximum(missing, 0.0)) * scaled.shape[1])


def _cost(scaled: Array) -> float:
    """Return the length, plus the weight of approaches that are missing in a direction."""
    length = _length(scaled)
    return float(length + _BALANCE * length / max(scaled.shape[1], 1) * _missing_approaches(scaled))


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
        parts = (tour[number::passes], again)
        # With one pass, the second visits come after all first ones.
        parts = (parts[0], np.sort(again)) if passes == 1 else (np.concatenate(parts), again[:0])
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
    if n < 4:
        return order
    sequence = scaled[:, _with_checks(order, check, every)]
    cost = _cost(sequence)
    for _ in range(_TRIES):
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
    if check is None:
        return order
    visits: list[int] = []
    for start in range(0, order.size, every):
        visits += [check, *order[start : start + every].tolist()]
    return np.array([*visits, check], dtype=np.int64)


def _drift_share(scaled: Array) -> float:
    """Return R^2 of time regressed on the joints (adjusted for their number); 0 where there are too few visits."""
    joints, n = scaled.shape
    if n < joints + 3:
        return 0.0
    time = np.arange(n) - (n - 1) / 2
    design = np.vstack((np.ones(n), scaled)).T
    residual = time - design @ np.linalg.lstsq(design, time, rcond=None)[0]
    share = float(residual @ residual / (time @ time))
    return float(max(1.0 - share * (n - 1) / (n - 1 - joints), 0.0))
