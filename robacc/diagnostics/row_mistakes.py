"""Rows that belong to the joints of other rows, and stretches of rows in other conventions.

Base and target are registered on windows of rows under every shift. Of the registration that fits most rows, each row
then has an error under each shift; the path of shifts with the least cost (dynamic programming, Viterbi 1967) gives the
shifted stretches. Rows that fit under no shift are matched with each other (assignment, Kuhn 1955).
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.diagnostics.mistakes import Mistake, arm_poses, register_positions, target_numbers
from robacc.fitting.closed_form import register_frames
from robacc.geometry import Array, rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.robots.description import Robot

_MOST_ROWS = 20_000
"""Rows beyond which the search is left out."""
_SHIFTS = 3
"""Rows that a stretch is shifted by at most."""
_WINDOWS = 6
_FEWEST_ROWS = 12
"""Rows that the search, and a window, need at least."""
_MOST_IN_WINDOW = 40
_REGISTERED = 3
"""Best windows that are judged by all rows."""
_CLEAR_FIT = 0.002
"""Median error, as a share of the standard deviation of the positions, up to which all rows were registered."""
_GROSS = 0.02
"""The same of a single row, from which it does not fit."""
_MOST_TYPICAL = 0.05
"""The same of the median of all rows in their best place, beyond which something else is wrong."""
_CLEAR = 8.0
"""Factor by which a wrong row exceeds the error of good rows, and by which its own place is better."""
_CAP = 9.0
"""Largest cost of a row, in squares of three times the typical error."""
_SWITCH = 9.0
"""Cost of a change of the shift."""
_ANY_SHIFT = 0.01
"""Cost per row of a shift other than zero, which decides where the arm stood still."""
_LEAST_STRETCH = 3
"""Rows of a shifted stretch."""
_FEW = 0.05
"""Share of exchanged rows up to which the others can be used."""
_MOST_MATCHED = 400
"""Rows that are matched with each other at most."""
_SAME_POINTS = 0.12
"""Largest difference of sorted distances, as a share of the difference row by row over the root of the number of rows,
of the same points in another order: 0.05 for an arm with 1 mm of error, 0.4 and more for other poses of the arm."""
_SAME_JOINTS = 1e-6
"""Largest difference of a joint's values within a visit, rad or m."""
_LISTED = 8
"""Row numbers that a message lists."""


@dataclass(frozen=True, slots=True)
class RowMistake:
    """Rows whose measured pose belongs to other joints."""

    text: str
    refused: bool
    """Whether the data cannot be used as they are."""
    rows: tuple[int, ...]
    """Indices of the rows."""


def find_row_mistakes(robot: Robot, data: Measurements, predicted: Array) -> RowMistake | None:
    """Return shifted or exchanged rows; None if all rows are in place or nothing can be said.

    Args:
        robot: Robot, whose base and targets are registered.
        data: Measured poses.
        predicted: ``(3, N)`` positions with base and targets registered on all rows, m.
    """
    if data.q is None or not _FEWEST_ROWS <= data.n <= _MOST_ROWS:
        return None
    spread = max(float(np.sqrt(np.var(data.position, axis=1).sum())), 1e-12)
    errors = np.linalg.norm(data.position - predicted, axis=0)
    middle = float(np.median(errors))
    if errors.max() <= _GROSS * spread or (middle <= _GROSS * spread and errors.max() <= _CLEAR * middle):
        return None
    if middle > _CLEAR_FIT * spread:
        predicted = _best_predicted(robot, data)
    costs = _errors_by_shift(predicted, data.position)
    typical = float(np.median(costs.min(axis=0)))
    if typical > _MOST_TYPICAL * spread:
        return _permuted(robot, data, spread)
    shifts = _path(costs, 3.0 * max(typical, 1e-6))
    return _stretches(data, costs, shifts, spread) or _exchanged(data, predicted, spread)


def _permuted(robot: Robot, data: Measurements, spread: float) -> RowMistake | None:
    """Return all rows if the measured positions are those of the commands in another order.

    Distances from the centre of all positions do not depend on the base. Sorted, they agree then, with the tool that
    fits best, far better than those of other poses of the arm; row by row they do not.
    """
    from scipy.optimize import least_squares

    poses = predict(robot, data)
    measured = _from_centre(data.position)

    def distances(tool: Array) -> Array:
        return _from_centre(poses.translation + np.einsum("ijn,j->in", poses.rotation, tool))

    def differences(tool: Array) -> Array:
        return np.sort(distances(tool)) - np.sort(measured)

    tool = least_squares(differences, np.zeros(3), x_scale=0.1).x
    in_order, by_row = rms_length(differences(tool)[None]), rms_length((distances(tool) - measured)[None])
    if by_row <= _MOST_TYPICAL * spread or in_order * np.sqrt(data.n) > _SAME_POINTS * by_row:
        return None
    return RowMistake(
        "the measured poses seem to be in another order than the joints: sorted by their distance from the "
        f"middle of all they agree to {1e3 * in_order:.2g} mm rms, row by row only to {1e3 * by_row:.3g} mm; pair each "
        "measured pose with its own joint values, by a name or by the time",
        True,
        tuple(range(data.n)),
    )


def _from_centre(position: Array) -> Array:
    """Return the distances ``(N,)`` of positions ``(3, N)`` from their middle."""
    return np.asarray(np.linalg.norm(position - position.mean(axis=1, keepdims=True), axis=0))


def _predicted(robot: Robot, data: Measurements, rows: NDArray[np.int64], measured: NDArray[np.int64]) -> Array:
    """Return the positions ``(3, N)`` of all rows with frames registered on ``rows`` and ``measured`` poses."""
    subset = data.subset(rows)
    rotation = None if data.rotation is None else data.rotation[..., measured]
    subset = dataclasses.replace(subset, position=data.position[:, measured], rotation=rotation)
    return predict(register_frames(robot, subset, True, True), data).translation


def _best_predicted(robot: Robot, data: Measurements) -> Array:
    """Return the positions ``(3, N)`` of all rows by the window and the shift after which most rows fit."""
    assert data.q is not None
    length = min(max(data.n // _WINDOWS, _FEWEST_ROWS), _MOST_IN_WINDOW, data.n - 2 * _SHIFTS)
    starts = np.unique(np.linspace(_SHIFTS, data.n - length - _SHIFTS, _WINDOWS).astype(int))
    windows = starts[:, None] + np.arange(length)
    rotation, position = arm_poses(robot, data.subset(np.arange(length)), data.q[:, windows].transpose(1, 0, 2))
    target, n_targets = target_numbers(robot, data)
    shifts = np.arange(-_SHIFTS, _SHIFTS + 1)
    candidates: list[tuple[float, int, int, int]] = []
    for w, rows in enumerate(windows):
        turned = np.broadcast_to(rotation[w], (shifts.size, *rotation.shape[1:]))
        moved = np.broadcast_to(position[w], (shifts.size, *position.shape[1:]))
        point = data.position.T[rows + shifts[:, None]]
        medians = register_positions(turned, moved, point, target[rows], n_targets).median
        candidates.extend((float(median), abs(int(k)), w, int(k)) for median, k in zip(medians, shifts, strict=True))
    best: tuple[float, Array] | None = None
    for _, _, w, shift in sorted(candidates)[:_REGISTERED]:
        predicted = _predicted(robot, data, windows[w], windows[w] + shift)
        typical = float(np.median(_errors_by_shift(predicted, data.position).min(axis=0)))
        if best is None or typical < best[0]:
            best = typical, predicted
    assert best is not None
    return best[1]


def _errors_by_shift(predicted: Array, measured: Array) -> Array:
    """Return the distance ``(K, N)`` of each row's prediction from the measured position some rows below it."""
    n = predicted.shape[1]
    errors = np.full((2 * _SHIFTS + 1, n), np.inf)
    for k in range(-_SHIFTS, _SHIFTS + 1):
        rows = np.arange(max(0, -k), min(n, n - k))
        errors[k + _SHIFTS, rows] = np.linalg.norm(predicted[:, rows] - measured[:, rows + k], axis=0)
    return errors


def _path(errors: Array, scale: float) -> NDArray[np.int64]:
    """Return the shift of each row on the path with the least cost."""
    costs = np.minimum(np.square(errors / scale), _CAP)
    states, n = costs.shape
    costs[np.arange(states) != _SHIFTS] += _ANY_SHIFT
    total = np.empty((states, n))
    previous = np.empty((states, n), dtype=np.int64)
    change = _SWITCH * (1.0 - np.eye(states))
    total[:, 0] = costs[:, 0]
    for i in range(1, n):
        reached = total[:, i - 1][None, :] + change
        previous[:, i] = np.argmin(reached, axis=1)
        total[:, i] = costs[:, i] + reached[np.arange(states), previous[:, i]]
    path = np.empty(n, dtype=np.int64)
    path[-1] = int(np.argmin(total[:, -1]))
    for i in range(n - 1, 0, -1):
        path[i - 1] = previous[path[i], i]
    return path - _SHIFTS


def _stretches(data: Measurements, errors: Array, shifts: NDArray[np.int64], spread: float) -> RowMistake | None:
    """Return the stretches whose shift is not zero and clearly better than zero."""
    ends = np.flatnonzero(np.diff(shifts, prepend=shifts[0] + 1, append=shifts[-1] + 1))
    texts, moved = [], []
    before, after = [], []
    for first, end in itertools.pairwise(ends):
        shift, rows = int(shifts[first]), np.arange(first, end)
        here, there = errors[_SHIFTS, rows], errors[shift + _SHIFTS, rows]
        inside = np.isfinite(there)
        if shift == 0 or np.count_nonzero(inside) < _LEAST_STRETCH:
            continue
        typical = float(np.median(there[inside]))
        if np.median(here) < max(_CLEAR * typical, _GROSS * spread):
            continue
        count = "one row" if abs(shift) == 1 else f"{abs(shift)} rows"
        place = "" if rows.size >= data.n - 2 * _SHIFTS else f"{data.counted}s {_span(data, rows)}: "
        direction = "down" if shift > 0 else "up"
        texts.append(f"{place}the measured poses seem to be shifted by {count} {direction} against the joints")
        moved.extend(rows.tolist())
        before.append(here)
        after.append(there[inside])
    if not texts:
        return None
    return RowMistake(
        f"{'; '.join(texts)}: with base and tool registered, {_change(before, after)}; pair each measured pose "
        "with its own joint values (look for a row that is missing or doubled where a stretch begins)",
        True,
        tuple(moved),
    )


def _exchanged(data: Measurements, predicted: Array, spread: float) -> RowMistake | None:
    """Return the rows that fit nowhere but at each other's joints."""
    from scipy.optimize import linear_sum_assignment

    errors = np.linalg.norm(data.position - predicted, axis=0)
    typical = float(np.median(errors))
    limit = max(_CLEAR * typical, _GROSS * spread)
    wrong = np.flatnonzero(errors > limit)
    if not 2 <= wrong.size <= _MOST_MATCHED:
        return None
    distance = np.linalg.norm(predicted[:, wrong, None] - data.position[:, None, wrong], axis=0)
    place, match = linear_sum_assignment(np.minimum(distance, limit))
    good = distance[place, match] * _CLEAR < errors[wrong]
    good &= distance[place, match] < max(4.0 * typical, _GROSS * spread / _CLEAR)
    sets = _cycles(np.where(good, match, -1))
    if not sets:
        return None
    texts = []
    for members in sets:
        lines = ", ".join(str(data.line(int(wrong[i]))) for i in sorted(members)[:_LISTED])
        texts.append(f"{lines}{'' if len(members) <= _LISTED else ', …'}")
    rows = [int(wrong[i]) for members in sets for i in members]
    after = [distance[i, match[i]] for members in sets for i in members]
    what, fix = "the measured poses", "pair each measured pose with its own joint values"
    if all(_is_one_visit(data, wrong[members]) for members in sets):
        what, fix = "the names of the targets", "give each row the name of the target that was measured"
    verb = "exchanged" if max(len(members) for members in sets) == 2 else "in another order than the joints"
    refused = len(rows) > _FEW * data.n
    consequence = "" if refused else ", and these rows are left out of the fit as outliers until then"
    change = _change([errors[rows]], [np.array(after)])
    return RowMistake(
        f"{data.counted}s {'; '.join(texts[:_LISTED])}{'; …' if len(texts) > _LISTED else ''}: {what} seem to be "
        f"{verb}: with base and tool registered, {change}; {fix}{consequence}",
        refused,
        tuple(sorted(rows)),
    )


def _is_one_visit(data: Measurements, rows: NDArray[np.int64]) -> bool:
    """Return whether rows have the same joints and different targets, so that only their names can be wrong."""
    if data.target is None or data.q is None:
        return False
    same = float(np.max(np.ptp(data.q[:, rows], axis=1))) <= _SAME_JOINTS
    return same and np.unique(data.target[rows]).size == rows.size


def _cycles(match: NDArray[np.int64]) -> list[list[int]]:
    """Return the closed cycles of a partial permutation, -1 for no match, of at least two members."""
    sets, visited = [], set()
    for start in range(match.size):
        members, i = [], start
        while i >= 0 and i not in visited:
            visited.add(i)
            members.append(i)
            i = int(match[i])
        if i == start and len(members) > 1:
            sets.append(members)
    return sets


def _change(before: list[Array], after: list[Array]) -> str:
    first, second = (1e3 * float(np.median(np.concatenate(parts))) for parts in (before, after))
    return f"their median error is {first:.3g} mm, and {second:.3g} mm after this correction"


def _span(data: Measurements, rows: NDArray[np.int64]) -> str:
    return f"{data.line(int(rows[0]))} to {data.line(int(rows[-1]))}"


# Mistakes in a stretch of the rows: a session appended with another order of the joints, other signs or other axes.
#
# Base and targets are registered on a part of the rows that agree with the robot file. Rows that then miss by far, and
# lie together in the file, are examined by themselves.

_PARTS = 4
"""Parts of the file of which one has to agree with the robot file."""
_FEWEST_IN_PART = 10
"""Rows of a part, and of a stretch, at least."""
_AGREES = 0.01
"""Median error of a part that agrees, as a share of the standard deviation of the positions."""
_GROSS_IN_PART = 0.03
"""The same of a single row that does not agree."""
_MOST_MIXED = 0.1
"""Share of rows within a stretch that may agree, and of rows outside that may not."""


@dataclass(frozen=True, slots=True)
class PartMistake:
    """Stretch of rows that does not agree with the others."""

    rows: NDArray[np.int64]
    """Indices of the rows of the stretch."""
    mistake: Mistake | None
    """Mistake in these rows; None if no tested hypothesis explains it."""
    text: str


def find_part_mistake(
    robot: Robot, data: Measurements, find: Callable[[Robot, Measurements], Mistake | None]
) -> PartMistake | None:
    """Return the stretch of rows that has a mistake; None if there is none, or only base or target moved.

    ``find`` returns the mistake of all rows of some poses, with base and target registered on these.
    """
    spread = max(float(np.sqrt(np.var(data.position, axis=1).sum())), 1e-12)
    best: tuple[float, Array] | None = None
    for rows in np.array_split(np.arange(data.n), _PARTS):
        if rows.size < _FEWEST_IN_PART:
            return None
        errors = _errors(robot, data.subset(rows), data)
        median = float(np.median(errors[rows]))
        if median <= _AGREES * spread and (best is None or median < best[0]):
            best = median, errors
    if best is None:
        return None
    wrong = best[1] > max(_GROSS_IN_PART * spread, _CLEAR * best[0])
    stretch = _stretch(wrong)
    if stretch is None:
        return None
    part = data.subset(stretch)
    size = float(np.median(best[1][stretch]))
    alone = float(np.median(_errors(robot, part, part)))
    if alone <= max(_AGREES * spread, size / _CLEAR):
        # Only base or target moved: a step, which a trace finds.
        return None
    mistake = find(robot, part)
    where = f"{data.counted}s {data.line(int(stretch[0]))} to {data.line(int(stretch[-1]))}"
    if mistake is not None:
        # Its usual fix, in the robot file or of a whole column, would spoil the other rows.
        fix = "correct these rows only: the others agree with the robot file"
        text = f"{where}, unlike the other rows: {dataclasses.replace(mistake, fix=fix).text}"
    else:
        text = (
            f"{where} do not agree with the other rows: with base and tool registered on those, their median error "
            f"is {1e3 * size:.3g} mm, and {1e3 * alone:.3g} mm with base and tool of their own; check the order, "
            "signs and units of the joints and the axes of the positions there, or leave the rows out"
        )
    return PartMistake(stretch, mistake, text)


def _errors(robot: Robot, registered: Measurements, data: Measurements) -> Array:
    """Return the errors ``(N,)`` of positions with base and targets registered on some poses, m."""
    poses = predict(register_frames(robot, registered, True, True), data)
    return np.asarray(np.linalg.norm(data.position - poses.translation, axis=0))


def _stretch(wrong: NDArray[np.bool_]) -> NDArray[np.int64] | None:
    """Return the rows between which nearly all are wrong and beyond which nearly none is; None if there are no such."""
    # The stretch with most wrong rows above as many right ones: the largest sum of +1 and -1 (Kadane).
    sums = np.concatenate(([0], np.cumsum(np.where(wrong, 1, -1))))
    lowest = np.minimum.accumulate(sums[:-1])
    end = int(np.argmax(sums[1:] - lowest)) + 1
    start = int(np.argmin(sums[:end]))
    inside = np.zeros(wrong.size, dtype=bool)
    inside[start:end] = True
    if end - start < _FEWEST_IN_PART or inside.all():
        return None
    if np.mean(~wrong[inside]) > _MOST_MIXED or np.mean(wrong[~inside]) > _MOST_MIXED:
        return None
    return np.arange(start, end)
