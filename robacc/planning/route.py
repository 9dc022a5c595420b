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


def route(q: Array, repeats: int, check: int | None, every: int, seed: int) -> Route:
    """Return the order of visits to poses ``(J, n)``.

    Args:
        q: Joint variables, rad or m.
        repeats: Number of poses that are visited a second time.
        check: Pose for the drift check; None for no check.
        every: Visits from one check to the next.
        seed: Seed of the local search.
    """
    scaled = q / np.maximum(np.ptp(q, axis=1), 1e-9)[:, None]
    visited_once = np.array([i for i in range(q.shape[1]) if i != check], dtype=np.int64)
    if check is not None and visited_once.size == 0:
        visited_once = np.array([check], dtype=np.int64)
    repeated = visited_once[_spread(scaled[:, visited_once], repeats)]
    tried = []
    for passes in range(1, min(_MOST_PASSES, max(visited_once.size // 5, 1)) + 1):
        order = _balanced(scaled, _in_passes(scaled, visited_once, repeated, passes), check, every, seed)
        visits = _with_checks(order, check, every)
        sequence = scaled[:, visits]
        tried.append((_cost(sequence) + 0.5 * order.size * max(_drift_share(sequence) - 0.3, 0.0), passes, visits))
    _, passes, visits = min(tried, key=lambda entry: entry[0])
    visited: set[int] = set()
    roles: list[Role] = []
    for node in visits.tolist():
        roles.append("check" if node == check else "repeat" if node in visited else "pose")
        visited.add(node)
    return _described(q, visits, tuple(roles), passes, seed)


def route_by_payload(q: Array, payload: Array | None, repeats: int, every: int, seed: int) -> Route:
    """Return the order of visits to poses ``(J, n)`` in which each payload ``(n,)`` is mounted once.

    Args:
        q: Joint variables, rad or m.
        payload: Payload of each pose, kg; None for no payload.
        repeats: Number of poses that are visited a second time, shared by the payloads.
        every: Visits from one check to the next; 0 for no check. Each payload has its own check pose.
        seed: Seed of the local search.
    """
    levels, group = np.unique(np.zeros(q.shape[1]) if payload is None else payload, return_inverse=True)
    visits: list[NDArray[np.int64]] = []
    roles: list[Role] = []
    passes = 0
    for number in range(levels.size):
        at = np.flatnonzero(group == number)
        share = repeats // levels.size + (number < repeats % levels.size)
        check = middle_pose(q[:, at]) if every and at.size > 2 else None
        part = route(q[:, at], share, check, max(every, 1), seed)
        visits.append(at[part.visits])
        roles += part.roles
        passes = max(passes, part.passes)
    return _described(q, np.concatenate(visits), tuple(roles), passes, seed)


def middle_pose(q: Array) -> int:
    """Return the pose ``(J, n)`` nearest to the middle of all, each joint scaled by its range."""
    middle = np.median(q, axis=1, keepdims=True)
    span = np.maximum(np.ptp(q, axis=1, keepdims=True), 1e-9)
    return int(np.argmin(np.sum(np.square((q - middle) / span), axis=0)))


def _described(q: Array, visits: NDArray[np.int64], roles: tuple[Role, ...], passes: int, seed: int) -> Route:
    """Return the route with its figures."""
    scaled = q / np.maximum(np.ptp(q, axis=1), 1e-9)[:, None]
    direction, speed = motion_between_rows(q[:, visits])
    generator = np.random.default_rng([seed, 1])
    return Route(
        visits,
        roles,
        passes,
        _length(scaled[:, visits]),
        _length(scaled[:, generator.permutation(visits)]),
        direction_shares(direction),
        np.array([float(np.std(np.abs(row[row != 0]))) if np.any(row) else 0.0 for row in speed]),
        _drift_share(scaled[:, visits]),
    )


def direction_shares(direction: Array) -> Array:
    """Return ``(J,)`` share of the rarer direction among the approaches of each joint; 0.5 is balanced."""
    up = np.count_nonzero(direction > 0, axis=1)
    down = np.count_nonzero(direction < 0, axis=1)
    share: Array = np.minimum(up, down) / np.maximum(up + down, 1)
    return share


def _length(scaled: Array) -> float:
    return float(np.sum(np.max(np.abs(np.diff(scaled, axis=1)), axis=0)))


def _missing_approaches(scaled: Array) -> float:
    shares = direction_shares(np.sign(np.diff(scaled, axis=1)))
    return float(np.sum(np.maximum(LEAST_DIRECTION_SHARE + 0.05 - shares, 0.0)) * scaled.shape[1])


def _cost(scaled: Array) -> float:
    """Return the length, plus the weight of approaches that are missing in a direction."""
    length = _length(scaled)
    return float(length + _BALANCE * length / max(scaled.shape[1], 1) * _missing_approaches(scaled))


def _spread(scaled: Array, count: int) -> NDArray[np.int64]:
    """Return ``count`` poses far from each other, the first nearest to the middle."""
    n = scaled.shape[1]
    count = min(count, n)
    if count == 0:
        return np.zeros(0, dtype=np.int64)
    chosen = [int(np.argmin(np.sum(np.square(scaled - np.median(scaled, axis=1, keepdims=True)), axis=0)))]
    gap = np.full(n, np.inf)
    while len(chosen) < count:
        gap = np.minimum(gap, np.sum(np.square(scaled - scaled[:, chosen[-1:]]), axis=0))
        chosen.append(int(np.argmax(np.where(np.isin(np.arange(n), chosen), -1.0, gap))))
    return np.array(chosen, dtype=np.int64)


def _tour(scaled: Array, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a short open route: the nearest neighbour next, then reversals of pieces (2-opt)."""
    if nodes.size < 3:
        return nodes
    points = scaled[:, nodes]
    distance = np.max(np.abs(points[:, :, None] - points[:, None, :]), axis=0)
    order, free = [0], np.ones(nodes.size, dtype=bool)
    free[0] = False
    while len(order) < nodes.size:
        step = np.where(free, distance[order[-1]], np.inf)
        order.append(int(np.argmin(step)))
        free[order[-1]] = False
    tour = np.array(order)
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
    result: NDArray[np.int64] = nodes[tour]
    return result


def _in_passes(scaled: Array, nodes: NDArray[np.int64], repeated: NDArray[np.int64], passes: int) -> NDArray[np.int64]:
    """Return the visits: each pass takes every ``passes``-th pose of the route; repeats go into another pass."""
    tour = _tour(scaled, nodes)
    parts = [tour[start::passes].tolist() for start in range(passes)]
    place = {int(node): k % passes for k, node in enumerate(tour)}
    for node in repeated.tolist():
        parts[(place[node] + 1) % passes].append(node)
    pieces: list[NDArray[np.int64]] = []
    for number, part in enumerate(parts):
        unique = np.array(list(dict.fromkeys(part)), dtype=np.int64)
        piece = _tour(scaled, unique)
        # With one pass, the second visits come after all first ones.
        extra = np.array([node for node in set(part) if part.count(node) > 1], dtype=np.int64)
        piece = np.concatenate((piece, _tour(scaled, np.sort(extra)))) if extra.size else piece
        start, end = scaled[:, piece[0]], scaled[:, piece[-1]]
        if pieces:
            last = scaled[:, pieces[-1][-1]]
            is_reversed = np.max(np.abs(end - last)) < np.max(np.abs(start - last))
        else:
            is_reversed = number % 2 == 1
        pieces.append(piece[::-1] if is_reversed else piece)
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
