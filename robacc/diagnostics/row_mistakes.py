"""A mistake as it is reported; rows that belong to the joints of other rows, and stretches in other conventions.

Base and targets are registered on windows of rows under every shift. Of the registration that fits most rows, each row
then has an error under each shift. A stretch in which another shift fits better by far is shifted. Rows that fit under
no shift are matched with each other (assignment, Kuhn 1955). A stretch that fits nowhere is examined by itself.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.closed_form import arm_poses, register_frames, register_positions, rows_by_target
from robacc.fitting.levels import ENOUGH, FEW, GROSS, LISTED, MANY, SAMPLE
from robacc.geometry import Array, Poses, rms_length
from robacc.measurements import Measurements, even_rows
from robacc.modelling.model import predict
from robacc.robots.description import Robot

# A mistake in the data or the robot file, and the misfit from which there may be one.

PLAUSIBLE = 10.0 * GROSS
"""Median registered error, as :data:`GROSS`, of positions that are right in the main: registered on few rows, or on an
arm with a further mistake."""
CLEAR = 8.0
"""Factor by which the correction of a mistake has to reduce the error. Registration of base and target explains at most
a factor of three of a mistake in a few rows."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """Mistake, or several together, in the data or the robot file, or in some rows."""

    name: str
    fix: str
    before: float | None = None
    """Median position error of the registered nominal model, m; None if the name has the figures."""
    after: float | None = None
    """The same with the mistake corrected, m."""
    turned_before: float | None = None
    """Median orientation error of the registered nominal model, rad."""
    turned_after: float | None = None
    alternatives: tuple[str, ...] = ()
    """Other mistakes that explain these poses as well."""
    unseen: tuple[str, ...] = ()
    """Joints whose sign these poses do not show."""
    of_rows: bool = False
    """Whether the errors are those of the rows in the name."""
    refused: bool = True
    """Whether the data cannot be used as they are."""

    @property
    def text(self) -> str:
        """Return the message."""
        text = self.name
        if self.before is not None and self.after is not None:
            errors = f"error is {1e3 * self.before:.3g} mm, and {1e3 * self.after:.3g} mm"
            if self.turned_before is not None and self.turned_after is not None and self.after > self.before / 2:
                before, after = math.degrees(self.turned_before), math.degrees(self.turned_after)
                errors = f"orientation error is {before:.3g} degrees, and {after:.2g} degrees"
            whose = "their" if self.of_rows else "the"
            text += f": with base and tool registered, {whose} median {errors} after this correction"
        text += f"; {self.fix}"
        if self.alternatives:
            text += f". Not distinguishable on these poses: {'; or '.join(self.alternatives)}"
        if self.unseen:
            text += f". These poses do not show the sign of {', '.join(self.unseen)}"
        return text


def spread(position: Array) -> float:
    """Return the standard deviation of positions ``(3, N)`` about their centre, m."""
    return max(float(np.sqrt(np.var(position, axis=1).sum())), 1e-12)


def registered_poses(robot: Robot, data: Measurements) -> Poses:
    """Return the poses of the nominal model with base and targets registered, on an even share of the poses."""
    return predict(register_frames(robot, data.subset(even_rows(data.n, SAMPLE)), True, True), data)


# Rows that belong to the joints of other rows, and stretches of rows.

_SHIFTS = np.array([0, 1, -1, 2, -2, 3, -3])
"""Rows that a stretch is shifted by."""
_WINDOWS, _MOST_IN_WINDOW = 6, 40
"""Windows, and best of them that are judged by all rows; and most rows of a window: one has to have good rows only."""
_MOST_COST = 9.0
"""Largest cost of a row, in squares of three times the typical error. Each end of a stretch costs as much."""
_MIXED = 0.1
"""Share of rows within such a stretch that may agree, and of rows outside that may not."""
_SAME_POINTS = 0.12
"""Largest difference of sorted distances, as a share of the difference row by row over the root of the number of rows,
of the same points in another order: 0.05 for an arm with 1 mm of error, 0.4 and more for other poses of the arm."""


def find_row_mistake(robot: Robot, data: Measurements, predicted: Array) -> Mistake | None:
    """Return shifted or exchanged rows; None if all rows are in place or nothing can be said.

    Args:
        robot: Robot, whose base and targets are registered.
        data: Measured poses.
        predicted: ``(3, N)`` positions with base and targets registered on all rows, m.
    """
    errors, gross = _lengths(data.position - predicted), 2 * GROSS * spread(data.position)
    middle = float(np.median(errors))
    if not ENOUGH <= data.n <= MANY or (middle <= gross and errors.max() <= max(gross, CLEAR * middle)):
        return None
    predicted = _best_predicted(robot, data, predicted)
    by_shift = _errors_by_shift(predicted, data.position)
    if np.median(by_shift.min(axis=0)) > PLAUSIBLE * spread(data.position):
        return _permuted(robot, data)
    return _shifted(data, by_shift, gross) or _exchanged(data, predicted, gross)


def find_part_mistake(
    robot: Robot, data: Measurements, find: Callable[[Robot, Measurements], Mistake | None]
) -> Mistake | None:
    """Return the stretch of rows that has a mistake; None if there is none, or only base or target moved.

    ``find`` returns the mistake of all rows of some poses, with base and target registered on these.
    """
    if data.n < ENOUGH:
        return None
    errors = _lengths(data.position - _best_predicted(robot, data, registered_poses(robot, data).translation))
    gross, typical = 2 * GROSS * spread(data.position), float(np.quantile(errors, 0.25))
    wrong = errors > max(gross, CLEAR * typical)
    rows = next(_runs(np.where(wrong, 1.0, -1.0), ENOUGH), np.arange(0))
    outside = np.delete(wrong, rows)
    if typical > gross or not rows.size or not outside.size or max(1 - wrong[rows].mean(), outside.mean()) > _MIXED:
        return None
    part = data.subset(rows)
    size = float(np.median(errors[rows]))
    alone = float(np.median(_lengths(part.position - registered_poses(robot, part).translation)))
    if alone <= max(gross / 2, size / CLEAR):
        # Only base or target moved: a step, which a trace finds.
        return None
    where = _stretch(data, rows)
    if (mistake := find(robot, part)) is not None:
        # Its usual fix, in the robot file or of a whole column, would spoil the other rows.
        fix = "correct these rows only: the others agree with the robot file"
        return dataclasses.replace(mistake, name=f"{where}, unlike the other rows: {mistake.name}", fix=fix)
    return Mistake(
        f"{where} do not agree with the other rows: with base and tool registered on those, their median error is "
        f"{1e3 * size:.3g} mm, and {1e3 * alone:.3g} mm with base and tool of their own",
        "check the order, signs and units of the joints and the axes of the positions there, or leave the rows out",
        refused=False,
    )


def _best_predicted(robot: Robot, data: Measurements, predicted: Array) -> Array:
    """Return positions ``(3, N)`` of all rows: as predicted, or by the window and shift after which more rows fit."""
    assert data.q is not None
    margin = int(_SHIFTS.max())
    length = min(max(data.n // _WINDOWS, ENOUGH), _MOST_IN_WINDOW, data.n - 2 * margin)
    by_target, (rotation, translation) = rows_by_target(robot, data), arm_poses(robot, data, data.q[None])
    tried: list[tuple[float, Array, Array, Array]] = []
    for start in np.linspace(margin, data.n - length - margin, _WINDOWS).astype(int).tolist():
        rows = np.arange(start, start + length)
        turns, links = (np.repeat(each[:, rows], _SHIFTS.size, axis=0) for each in (rotation, translation))
        found = register_positions(turns, links, data.position.T[rows + _SHIFTS[:, None]], by_target[:, rows])
        tried.extend(zip(found.median.tolist(), found.rotation, found.shift, found.targets, strict=True))
    candidates = [predicted]
    for _, turn, shift, targets in sorted(tried, key=lambda item: item[0])[:_WINDOWS]:
        on_link = np.einsum("nij,tj,tn->ni", rotation[0], targets, by_target)
        candidates.append(((translation[0] + on_link + shift) @ turn).T)
    # Rows that do not fit count alike: they may be the most.
    gross = 2 * GROSS * spread(data.position)
    scores = [np.minimum(_errors_by_shift(each, data.position).min(axis=0), gross).sum() for each in candidates]
    return candidates[int(np.argmin(scores))]


def _errors_by_shift(predicted: Array, measured: Array) -> Array:
    """Return the distance ``(K, N)`` of each row's prediction from the measured position some rows below it."""
    errors = np.full((_SHIFTS.size, predicted.shape[1]), np.inf)
    for number, shift in enumerate(_SHIFTS):
        rows = np.arange(max(0, -shift), predicted.shape[1] - max(0, shift))
        errors[number, rows] = _lengths(predicted[:, rows] - measured[:, rows + shift])
    return errors


def _runs(score: Array, least: float) -> Iterator[NDArray[np.int64]]:
    """Yield the runs of rows whose sum of ``score`` ``(N,)`` is largest, down to a least sum (J. Kadane)."""
    score = score.copy()
    while True:
        sums = np.concatenate(([0.0], np.cumsum(score)))
        end = int(np.argmax(sums[1:] - np.minimum.accumulate(sums[:-1]))) + 1
        start = int(np.flatnonzero(sums[:end] == sums[:end].min())[-1])
        if sums[end] - sums[start] < least:
            return
        yield np.arange(start, end)
        score[start:end] = -np.abs(score).sum()


def _shifted(data: Measurements, errors: Array, gross: float) -> Mistake | None:
    """Return the stretches that another shift than zero fits clearly better."""
    typical = max(float(np.median(errors.min(axis=0))), 1e-6)
    cost = np.minimum(np.square(errors / (3.0 * typical)), _MOST_COST)
    found = []
    for number, shift in enumerate(_SHIFTS.tolist()):
        others = np.delete(cost, number, axis=0).min(axis=0)
        for rows in _runs(others - cost[number], 2 * _MOST_COST):
            here, there = errors[0, rows], errors[number, rows][np.isfinite(errors[number, rows])]
            if shift and np.median(here) > max(CLEAR * np.median(there), gross):
                place = "" if rows.size >= data.n - 2 * _SHIFTS.max() else f"{_stretch(data, rows)}: "
                by = f"{'one row' if abs(shift) == 1 else f'{abs(shift)} rows'} {'down' if shift > 0 else 'up'}"
                text = f"{place}the measured poses seem to be shifted by {by} against the joints"
                found.append((int(rows[0]), text, here, there))
    if not found:
        return None
    _, texts, before, after = zip(*sorted(found, key=lambda item: item[0]), strict=True)
    return Mistake(
        "; ".join(texts),
        "pair each measured pose with its own joint values (look for a row that is missing or doubled where a stretch "
        "begins)",
        float(np.median(np.concatenate(before))),
        float(np.median(np.concatenate(after))),
        of_rows=True,
    )


def _exchanged(data: Measurements, predicted: Array, gross: float) -> Mistake | None:
    """Return the rows that fit nowhere but at each other's joints."""
    from scipy.optimize import linear_sum_assignment
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    errors = _lengths(data.position - predicted)
    limit = max(CLEAR * float(np.median(errors)), gross)
    wrong = np.flatnonzero(errors > limit)
    if not 2 <= wrong.size <= SAMPLE:
        return None
    distance = np.linalg.norm(predicted[:, wrong, None] - data.position[:, None, wrong], axis=0)
    place, match = linear_sum_assignment(np.minimum(distance, limit))
    after = distance[place, match]
    good = (after * CLEAR < errors[wrong]) & (after < limit / 2)
    # A pose has one match at most, so that a group in which each has one is a cycle.
    _, group = connected_components(coo_array((good[good], (place[good], match[good])), shape=distance.shape))
    groups = [np.flatnonzero(group == number) for number in range(wrong.size)]
    cycles = [members for members in groups if members.size > 1 and good[members].all()]
    if not cycles:
        return None
    rows = np.concatenate(cycles)
    texts = [
        ", ".join(str(data.line(int(row))) for row in wrong[members[:LISTED]]) + ", …" * (members.size > LISTED)
        for members in cycles
    ]
    what, fix = "the measured poses", "pair each measured pose with its own joint values"
    if all(_is_one_visit(data, wrong[members]) for members in cycles):
        what, fix = "the names of the targets", "give each row the name of the target that was measured"
    verb = "exchanged" if max(members.size for members in cycles) == 2 else "in another order than the joints"
    refused = rows.size > FEW * data.n
    return Mistake(
        f"{data.counted}s {'; '.join(texts[:LISTED])}{'; …' * (len(texts) > LISTED)}: {what} seem to be {verb}",
        fix if refused else f"{fix}, and these rows are left out of the fit as outliers until then",
        float(np.median(errors[wrong[rows]])),
        float(np.median(after[rows])),
        of_rows=True,
        refused=refused,
    )


def _is_one_visit(data: Measurements, rows: NDArray[np.int64]) -> bool:
    """Return whether rows have the same joints and different targets, so that only their names can be wrong."""
    if data.target is None or data.q is None:
        return False
    return bool(np.allclose(data.q[:, rows], data.q[:, rows[:1]])) and np.unique(data.target[rows]).size == rows.size


def _permuted(robot: Robot, data: Measurements) -> Mistake | None:
    """Return all rows if the measured positions are those of the commands in another order.

    Distances from the centre of all positions do not depend on the base. Sorted, they agree then, with the tool that
    fits best, far better than those of other poses of the arm; row by row they do not.
    """
    from scipy.optimize import least_squares

    poses = predict(robot, data)

    def distances(position: Array) -> Array:
        return _lengths(position - position.mean(axis=1, keepdims=True))

    def differences(tool: Array) -> Array:
        return np.asarray(np.sort(of_arm(tool)) - np.sort(measured))

    def of_arm(tool: Array) -> Array:
        return distances(poses.translation + np.einsum("ijn,j->in", poses.rotation, tool))

    measured = distances(data.position)
    tool = least_squares(differences, np.zeros(3), x_scale=0.1).x
    in_order, by_row = rms_length(differences(tool)[None]), rms_length((of_arm(tool) - measured)[None])
    if by_row <= PLAUSIBLE * spread(data.position) or in_order * np.sqrt(data.n) > _SAME_POINTS * by_row:
        return None
    return Mistake(
        "the measured poses seem to be in another order than the joints: sorted by their distance from the middle of "
        f"all they agree to {1e3 * in_order:.2g} mm rms, row by row only to {1e3 * by_row:.3g} mm",
        "pair each measured pose with its own joint values, by a name or by the time",
    )


def _stretch(data: Measurements, rows: NDArray[np.int64]) -> str:
    return f"{data.counted}s {data.line(int(rows[0]))} to {data.line(int(rows[-1]))}"


def _lengths(vectors: Array) -> Array:
    """Return the lengths ``(N,)`` of vectors ``(3, N)``."""
    return np.asarray(np.linalg.norm(vectors, axis=0))
