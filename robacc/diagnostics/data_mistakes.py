"""Mistakes in the data or the robot file, detected before any effect is fitted.

Mistakes are tried alone and in sets: every set of joint signs, signs with an interaction of two joints, and then the
best sets with further changes. Each hypothesis is judged by a sample of rows, with base and target registered.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.diagnostics.changes import (
    MIRRORED,
    MOST_SETS,
    READINGS,
    Change,
    Recorded,
    axis_change,
    convention_changes,
    interactions,
    joint_changes,
    measured_changes,
    permutations,
    sign_sets,
    units,
    zeros,
)
from robacc.diagnostics.mistakes import CLEAR, GROSS, MOST_ROWS, PLAUSIBLE, Mistake, registered_poses, spread
from robacc.diagnostics.row_mistakes import find_part_mistake, find_row_mistake
from robacc.errors import InputError, RobaccError
from robacc.fitting.closed_form import (
    arm_poses,
    orientation_errors,
    register_orientations,
    register_positions,
    rows_by_target,
)
from robacc.geometry import Array, Poses, log_between
from robacc.measurements import Measurements, even_rows
from robacc.robots.description import Robot

_LEAST_POSES = 8
"""Poses that the check needs at least: registration of base and tool fits fewer poses in spite of a mistake."""
_USUAL_ERROR = 3e-3
"""m; registered error up to which an arm is taken for the one that was measured."""
_IN_PART = 2.0 / 3.0
"""Share of the rows whose error has to be small: registration is robust against mistakes in the others."""
_SAMPLE = 60
"""Rows that hypotheses are judged by, and hypotheses of each group that are, by a rough fit: it bounds the time."""
_BEST = 8
"""Best hypotheses that are tried with other orientations and axes, or with further changes, which bounds it too."""
_MORE = 2
"""Mistakes that a set is extended by, and that an alternative has beyond those of the simplest, at most."""
_SAME = 1.5
"""Ratio of errors up to which two hypotheses are not distinguishable."""
_MOST_ALTERNATIVES = 3


def check_data(robot: Robot, data: Measurements) -> tuple[str, ...]:
    """Raise an error if the data contain a mistake; return warnings of mistakes in a few rows.

    Raises:
        InputError: the mistake, its errors and the fix.
    """
    if data.n < _LEAST_POSES or data.q is None:
        return ()
    poses = registered_poses(robot, data)
    found = find_row_mistake(robot, data, poses.translation)
    if _is_gross(data, poses) and not (found and found.refused):
        found = find_mistake(robot, data) or find_part_mistake(robot, data, find_mistake) or found
    if found is None:
        return other_arm(robot, data, poses.translation)
    text = f"{data.source}: {found.text}" if data.source else found.text
    if found.refused:
        raise InputError(text)
    return (*other_arm(robot, data, poses.translation), text)


def other_arm(robot: Robot, data: Measurements, predicted: Array) -> tuple[str, ...]:
    """Return a warning that names the arm of the package that fits the poses, where the robot does not.

    ``predicted`` ``(3, N)`` are positions by the robot, registered or not, m; where they agree, nothing is registered.
    """
    if data.n < _LEAST_POSES or data.q is None or _median_error(data, predicted) <= _USUAL_ERROR:
        return ()
    from robacc.modelling.robot_file import read_robot
    from robacc.robots.library import library

    def error(arm: Robot) -> float:
        try:
            return _median_error(data, registered_poses(arm, data).translation)
        except RobaccError:
            return np.inf

    data = data.subset(even_rows(data.n, MOST_ROWS))
    if (own := error(robot)) <= _USUAL_ERROR:
        return ()
    fits = {
        arm.key: error(dataclasses.replace(read_robot(arm.path), targets=robot.targets))
        for arm in library()
        if arm.axes == len(robot.variables)
    }
    best = min(fits, key=fits.__getitem__, default="")
    if fits.get(best, np.inf) * CLEAR > own:
        return ()
    return (
        f"{robot.name} leaves a median error of {1e3 * own:.3g} mm with base and tool registered, the package's {best} "
        f"{1e3 * fits[best]:.2g} mm: check that `robot` is the arm that was measured",
    )


def _median_error(data: Measurements, predicted: Array) -> float:
    """Return the median distance of the measured positions from ``predicted`` ``(3, N)``, m."""
    return float(np.median(np.linalg.norm(data.position - predicted, axis=0)))


def _is_gross(data: Measurements, poses: Poses) -> bool:
    """Return whether the registered error may come from a mistake, in a third of the rows at least."""
    error = float(np.quantile(np.linalg.norm(data.position - poses.translation, axis=0), _IN_PART))
    if data.rotation is None or error > GROSS * spread(data.position):
        return error > GROSS * spread(data.position)
    return float(np.median(np.linalg.norm(log_between(poses.rotation, data.rotation), axis=0))) > GROSS


def find_mistake(robot: Robot, data: Measurements) -> Mistake | None:
    """Return the mistake, or the set of mistakes, that explains a gross misfit; None if there is none."""
    if data.n < _LEAST_POSES or data.q is None or not _is_gross(data, registered_poses(robot, data)):
        return None
    data = data.subset(even_rows(data.n, _SAMPLE))
    pool = _judged(robot, data, [()])
    if not pool or (null := pool[0]).total <= GROSS:
        return None
    for groups in _stages(robot, data, pool):
        for sets in filter(None, groups):
            pool.extend(_judged(robot, data, sets))
        if min(item.total for item in pool) < min(2 * GROSS, null.total / CLEAR):
            break
    return _simplest(pool, null)


@dataclass(frozen=True, slots=True)
class _Hypothesis:
    """Mistakes that are undone together, and the registered error that remains."""

    changes: tuple[Change, ...]
    total: float
    """Position error over the spread of the positions, plus orientation error in rad."""
    rank: float
    """The same, tolerant of orientations that are wrong in themselves."""
    position: float
    """Median position error, m."""
    orientation: float | None
    """Median orientation error, rad."""
    axes: Change | None
    """Change of the axes of the positions that the orientations ask for."""

    @property
    def complexity(self) -> int:
        """Return the number of mistakes."""
        return sum(change.complexity for change in self.changes)

    @property
    def texts(self) -> tuple[str, ...]:
        """Return what is wrong, by mistake."""
        return tuple(change.text for change in self.changes)

    @property
    def signs(self) -> frozenset[str] | None:
        """Return the joints whose sign is reversed, if nothing else is wrong; else None."""
        return self.changes[0].signs if len(self.changes) == 1 and self.changes[0].signs else None


_Sets = Sequence[tuple[Change, ...]]


def _stages(robot: Robot, data: Measurements, pool: Sequence[_Hypothesis]) -> Iterator[list[_Sets]]:
    """Yield groups of sets of changes, the likely ones first; ``pool`` has what was judged before."""
    assert data.q is not None
    of_arm = spread(arm_poses(robot, data, data.q[None])[1][0].T)
    variants = [*measured_changes(data, max(of_arm, 1e-12)), *convention_changes(robot)]
    elementary = joint_changes(robot)
    signs = [(change,) for change in sign_sets(robot)]
    yield [*([variant] for variant in variants), [(change,) for change in elementary], signs]
    neighbours = [(i + 1, i) for i in range(len(robot.variables) - 1)]
    common = [*interactions(robot, neighbours), *units(robot)]
    yield [
        *([(*variant, *some) for some in signs] for variant in variants),
        [(*some, change) for some in signs for change in common],
    ]
    # Base and target take up the zeros of the first and the last joint.
    inner = zeros(robot, robot.variables[1:-1])
    yield [
        list(itertools.combinations(inner, 2)),
        [(*some, change) for some in signs for change in inner],
        [(change,) for change in permutations(robot)],
    ]
    for _ in range(_MORE):
        best = sorted(pool, key=lambda item: (item.rank, item.complexity))[:_BEST]
        yield [
            [
                (*item.changes, change)
                for change in elementary
                if not (change.signs and any(c.signs for c in item.changes))
            ]
            for item in best
        ]


def _judged(robot: Robot, data: Measurements, sets: _Sets) -> list[_Hypothesis]:
    """Return the best of the sets with their errors, some completed by changes of orientations and axes."""
    try:
        if len(sets) > _SAMPLE:
            half = data.subset(slice(None, None, 2))
            batches = (_undone(robot, half, sets[i : i + MOST_SETS]) for i in range(0, len(sets), MOST_SETS))
            rough = np.concatenate([register_positions(*batch[:4], passes=1).median for batch in batches])
            sets = [sets[i] for i in np.argsort(rough, kind="stable")[:_SAMPLE]]
        judged = _screened(robot, data, sets)
    except (RobaccError, np.linalg.LinAlgError):
        return []
    for item in judged[:_BEST]:
        if item.orientation is not None and item.total > 2 * GROSS and item.rank < 2 * PLAUSIBLE:
            judged.extend(_screened(robot, data, [(*item.changes, reading) for reading in READINGS]))
            if item.axes is not None:
                kept = (change for change in item.changes if change is not MIRRORED)
                judged.extend(_screened(robot, data, [(*kept, item.axes)]))
    return judged


def _undone(robot: Robot, data: Measurements, sets: _Sets) -> tuple[Array, Array, Array, Array, Array | None]:
    """Return the poses with each of H sets undone; the robot file has to be the same with all of them undone.

    Returns:
        The last link's orientations ``(H, N, 3, 3)`` and positions ``(H, N, 3)``, the measured positions ``(H, N, 3)``,
        the rows by target ``(T, N)``, and the measured orientations ``(H, N, 3, 3)`` or None.
    """
    assert data.q is not None
    undone = []
    for changes in sets:
        recorded = Recorded(robot, data.q, data.position, data.rotation)
        for change in changes:
            recorded = change.apply(recorded)
        undone.append(recorded)
    links = arm_poses(recorded.robot, data, np.array([each.q for each in undone]))
    position = np.array([each.position.T for each in undone])
    rotation = np.array([np.moveaxis(each.rotation, 2, 0) for each in undone if each.rotation is not None])
    return *links, position, rows_by_target(robot, data), rotation if len(rotation) else None


def _screened(robot: Robot, data: Measurements, sets: _Sets) -> list[_Hypothesis]:
    """Return the sets with the errors that remain, the best first."""
    rotation, translation, position, by_target, measured = _undone(robot, data, sets)
    free = register_positions(rotation, translation, position, by_target)
    size = np.array([spread(points.T) for points in position])
    share, nothing = free.median / size, [None] * len(sets)
    if measured is None:
        found = map(_Hypothesis, sets, share, share, free.median, nothing, nothing)
        return sorted(found, key=lambda item: item.rank)
    turn, turned, _ = register_orientations(rotation, measured)
    common = register_positions(rotation, translation, position, by_target, turn=turn).median
    # Orientations that hardly vary do not show the base, which the positions then show.
    other = orientation_errors(rotation, measured, free.rotation)
    by_positions = share + other < common / size + turned
    median = np.where(by_positions, free.median, common)
    orientation = np.where(by_positions, other, turned)
    rank = share + np.minimum(orientation, PLAUSIBLE)
    mirrored = np.diag([-1.0, 1.0, 1.0])
    axes = [
        axis_change(base @ mirrored if MIRRORED in changes else base, true)
        for changes, base, true in zip(sets, free.rotation, turn, strict=True)
    ]
    found = map(_Hypothesis, sets, median / size + orientation, rank, median, orientation, axes)
    return sorted(found, key=lambda item: item.rank)


def _simplest(pool: Sequence[_Hypothesis], null: _Hypothesis) -> Mistake | None:
    """Return the simplest of the hypotheses that explain the error; None if none does."""
    least = min(item.total for item in pool)
    if least * CLEAR >= null.total:
        return None
    limit = min(_SAME * least, null.total / CLEAR)
    equal = (item for item in pool if item.total <= limit and item.changes)
    best, *others = sorted(equal, key=lambda item: (item.complexity, item.total))
    alternatives, unseen = [], set[str]()
    for item in others:
        if item.signs and best.signs and item.signs > best.signs:
            unseen |= item.signs - best.signs
        elif item.complexity <= best.complexity + _MORE and not set(best.texts) <= set(item.texts):
            alternatives.append(" and ".join(item.texts))
    return Mistake(
        "; ".join(best.texts),
        "; ".join(dict.fromkeys(change.fix for change in best.changes)),
        null.position,
        best.position,
        null.orientation,
        best.orientation,
        tuple(dict.fromkeys(alternatives))[:_MOST_ALTERNATIVES],
        tuple(sorted(unseen)),
    )
