"""Mistakes in the data or the robot file, detected before any effect is fitted.

Mistakes are tried alone and in sets: every set of joint signs, signs with an interaction of two joints, and then the
best sets with further changes. Each hypothesis is judged by a sample of rows, with base and target registered.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.diagnostics.row_mistakes import (
    CLEAR,
    PLAUSIBLE,
    Mistake,
    find_part_mistake,
    find_row_mistake,
    registered_poses,
    spread,
)
from robacc.errors import InputError, RobaccError
from robacc.fitting.closed_form import (
    arm_poses,
    orientation_errors,
    register_orientations,
    register_positions,
    rows_by_target,
)
from robacc.fitting.levels import ENOUGH, EXAMPLES, GROSS, SAMPLE
from robacc.geometry import (
    Array,
    Poses,
    log_between,
    log_so3,
    quaternion_from_rotation,
    rotate_back,
    rotation_from_quaternion,
    rpy_from_rotation,
    transpose,
)
from robacc.measurements import Measurements, even_rows
from robacc.poses.reading import CONVENTIONS
from robacc.robots.description import Joint, Robot

# Changes that undo one mistake each: of joint columns, of measured poses, and of the robot file.


@dataclass(frozen=True, slots=True)
class Recorded:
    """What may hold a mistake: the robot file and the columns of the measured poses."""

    robot: Robot
    q: Array
    """``(J, N)`` joint variables, rad or m."""
    position: Array
    """``(3, N)``, m"""
    rotation: Array | None
    """``(3, 3, N)``"""


@dataclass(frozen=True, slots=True)
class Change:
    """Change that undoes one mistake, or several signs together."""

    text: str
    fix: str
    apply: Callable[[Recorded], Recorded]
    """Map of what was recorded to what is right."""
    complexity: int = 1
    """Number of mistakes; more for one that is unusual."""
    signs: frozenset[str] = frozenset()
    """Joints whose sign is reversed, if it undoes nothing else."""


def listing(names: Sequence[str]) -> str:
    """Return names as text: ``j1, j4 and j6``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


# Changes of the joint columns: all are a matrix and an offset.

MOST_SETS = 1000
"""Sets of signs, the small ones first, or orders of the columns that are tried, and hypotheses in memory at once: it
bounds the time, and has all sets of nine joints and all orders of six."""


def _of_joints(
    text: str, fix: str, matrix: Array, offset: Array | float = 0.0, complexity: int = 1, signs: Iterable[str] = ()
) -> Change:
    """Return the change of joints ``(J, N)`` to ``matrix`` ``(J, J)`` times the joints plus ``offset`` ``(J, 1)``."""
    return Change(text, fix, lambda r: dataclasses.replace(r, q=matrix @ r.q + offset), complexity, frozenset(signs))


def sign_sets(robot: Robot) -> list[Change]:
    """Return the reversals of sets of joint signs, small sets first."""
    names = robot.variable_names
    sets = (chosen for size in range(1, len(names) + 1) for chosen in itertools.combinations(names, size))
    return [_signs(names, chosen) for chosen in itertools.islice(sets, MOST_SETS)]


def _signs(names: Sequence[str], chosen: Sequence[str]) -> Change:
    subject, joint, column = f"the sign of joint {chosen[0]} seems", "the joint", "its column"
    if len(chosen) > 1:
        subject, joint, column = f"the signs of joints {listing(chosen)} seem", "the joints", "each column"
    fix = f"set sign: -1 for {joint} in the robot file, or reverse the sign of {column}"
    matrix = np.diag([-1.0 if name in chosen else 1.0 for name in names])
    return _of_joints(f"{subject} to be reversed", fix, matrix, complexity=len(chosen), signs=chosen)


_ANGLES = (
    ("degrees", "give the unit in their names, as in q1_deg", np.pi / 180.0),
    ("radians but marked as degrees", "give the unit in their names, as in q1_rad", 180.0 / np.pi),
    ("turns", "convert the columns to rad or degrees", 2.0 * np.pi),
)
"""Unit, fix, and factor to rad."""


_LENGTHS = (
    ("millimetres", "give its unit in the column's name, as in q1_mm", 1e-3),
    ("metres but marked as millimetres", "give its unit in the column's name, as in q1_mm", 1e3),
)
"""Unit, fix, and factor to m."""


def units(robot: Robot) -> Iterator[Change]:
    """Yield the changes of the unit of all angles, then those of the unit of one column."""
    revolute = np.array([joint.type == "revolute" for joint in robot.variables])
    for text, fix, factor in _ANGLES:
        matrix = np.diag(np.where(revolute, factor, 1.0))
        yield _of_joints(f"the joint columns seem to be in {text}", fix, matrix)
    for i, joint in enumerate(robot.variables):
        for text, fix, factor in _ANGLES if revolute[i] else _LENGTHS:
            one = fix.replace("their names", "the column's name").replace("the columns", "the column")
            matrix = np.diag(np.where(np.arange(revolute.size) == i, factor, 1.0))
            yield _of_joints(f"the column of joint {joint.name} seems to be in {text}", one, matrix)


def _orders(names: Sequence[str]) -> list[Change]:
    """Return the exchanges of two columns, the reverse order, and the orders that are shifted by one."""
    numbers = list(range(len(names)))
    exchanges = [
        [k if number == i else i if number == k else number for number in numbers]
        for i, k in itertools.combinations(numbers, 2)
    ]
    more = (numbers[::-1], numbers[1:] + numbers[:1], numbers[-1:] + numbers[:-1]) if len(names) > 2 else ()
    return [_ordered(names, order) for order in (*exchanges, *more)]


def _ordered(names: Sequence[str], order: Sequence[int], complexity: int = 1) -> Change:
    held = [names[place] for place in np.argsort(order)]
    moved = [name for name, content in zip(names, held, strict=True) if name != content]
    text = f"the joint columns seem to be in another order: they hold {listing(held)}"
    if len(moved) == 2:
        text = f"the columns of joints {moved[0]} and {moved[1]} seem to be exchanged"
    return _of_joints(text, "correct the names of the columns", np.eye(len(names))[list(order)], complexity=complexity)


def permutations(names: Sequence[str]) -> Iterator[Change]:
    """Yield the orders of the joint columns that move more than two, unless there are too many."""
    orders = itertools.permutations(range(len(names))) if math.factorial(len(names)) <= MOST_SETS else ()
    for order in orders:
        if (moved := sum(place != number for place, number in enumerate(order))) > 2:
            yield _ordered(names, order, moved - 1)


def interactions(robot: Robot, pairs: Iterable[tuple[int, int]]) -> Iterator[Change]:
    """Yield the changes that undo an interaction: the first column of a pair holds both joints' sum or difference.

    On an arm with a parallelogram, and on controllers whose third axis counts from the horizontal, column 3 holds
    ``q3 + q2`` or ``q3 - q2``.
    """
    names, kinds = robot.variable_names, [joint.type for joint in robot.variables]
    for i, k in pairs:
        if kinds[i] != kinds[k]:
            continue
        for sign, held, fix, to in ((1, "-", "add", "to"), (-1, "+", "subtract", "from")):
            matrix = np.eye(len(names))
            matrix[i, k] = sign
            yield _of_joints(
                f"the column of joint {names[i]} seems to hold {names[i]} {held} {names[k]} (interaction not removed)",
                f"{fix} the column of {names[k]} {to} that of {names[i]}, or give joint {names[i]} "
                f"`coupling: {{{names[k]}: {sign}}}` in the robot file",
                matrix,
            )


def zeros(robot: Robot, joints: Sequence[Joint]) -> list[Change]:
    """Return the changes of the zeros of some joints."""
    names = robot.variable_names
    return [
        _of_joints(
            f"joint {joint.name} seems to count from a zero {abs(angle)} degrees away",
            f"add {angle} degrees to its column, or to its theta in the robot file",
            np.eye(len(names)),
            np.where(np.array(names) == joint.name, np.deg2rad(angle), 0.0)[:, None],
            2,
        )
        for joint in joints
        if joint.type == "revolute"
        for angle in (90, -90, 180)
    ]


# Changes of the measured poses: units, axes, inverse poses, conventions of orientation.

_UNITS = (
    (1e-3, "millimetres", "give the unit in their names, as in x_mm"),
    (1e-6, "micrometres", "give the unit in their names, as in x_um"),
    (1e3, "metres but marked as millimetres", "give the unit in their names, as in x_m"),
    (0.0254, "inches", "convert them, or give their unit"),
    (25.4, "inches but marked as millimetres", "convert them, or give their unit"),
)
"""Factor to metres, the unit, and the fix."""
_WRITTEN_AS = {
    "rotvec": "rotation vectors",
    "fixed-xyz": "angles about the fixed axes x, y, z",
    "moving-xyz": "angles about the moving axes x, y, z",
    "kuka-abc": "angles A, B, C about z, y, x",
    "zyz": "angles about the moving axes z, y, z",
}


def _of_positions(text: str, fix: str, matrix: Array, complexity: int = 1) -> Change:
    """Return the change of positions to ``matrix`` ``(3, 3)`` times the positions."""
    return Change(text, fix, lambda r: dataclasses.replace(r, position=matrix @ r.position), complexity)


def _of_orientations(text: str, fix: str, read: Callable[[Array], Array]) -> Change:
    """Return the change of orientations ``(3, 3, N)`` to ``read`` of them."""
    return Change(text, fix, lambda r: dataclasses.replace(r, rotation=read(r.rotation)))  # type: ignore[arg-type]


def _inverse(recorded: Recorded) -> Recorded:
    assert recorded.rotation is not None
    return dataclasses.replace(
        recorded,
        position=-rotate_back(recorded.rotation, recorded.position),
        rotation=transpose(recorded.rotation),
    )


MIRRORED = _of_positions(
    "the positions seem to be in a left-handed frame",
    "look for a column with a reversed sign, or for two exchanged columns",
    np.diag([-1.0, 1.0, 1.0]),
)
"""Change by which a left-handed frame becomes right-handed: the first axis is reversed."""
_INVERTED = Change(
    "the measured poses seem to be inverted: the instrument's pose in the target's frame",
    "invert each measured pose",
    _inverse,
)


def measured_changes(data: Measurements, expected_spread: float) -> list[tuple[Change, ...]]:
    """Return the sets of changes of measured poses that are tried with every set of joint signs.

    Args:
        data: Measured poses.
        expected_spread: Standard deviation of the arm's own positions, m.
    """
    ratio = spread(data.position) / expected_spread
    # Changes of the unit are tried if the positions spread thrice too far or too little.
    variants = [
        (_of_positions(f"the positions seem to be in {unit}", fix, factor * np.eye(3)),)
        for factor, unit, fix in _UNITS
        if abs(math.log(factor * ratio)) < math.log(3.0) <= abs(math.log(ratio))
    ]
    if data.rotation is not None:
        variants.append((_INVERTED,))
    return [*variants, *((*some, MIRRORED) for some in ((), *variants))]


def convention_changes(robot: Robot) -> list[tuple[Change]]:
    """Return the change of a Denavit-Hartenberg table to the other convention; none for other descriptions."""
    other = {"standard": "modified", "modified": "standard"}.get(robot.convention)
    if other is None:
        return []
    changed = dataclasses.replace(robot, convention=other)  # type: ignore[arg-type]
    text = f"the table seems to be of the {other} Denavit-Hartenberg convention"
    return [(Change(text, f"set convention: {other}", lambda r: dataclasses.replace(r, robot=changed)),)]


def _readings_of_angles(convention: str, read_as: str, angles: Callable[[Array], Array]) -> list[Change]:
    """Return the readings of three columns that were read in a convention and have another, order or unit."""
    same, seem = CONVENTIONS[convention], "the orientations seem to be"
    others = [
        _of_orientations(
            f"{seem} {text}, read as {read_as}",
            f"give `angles`: {written_as}, or convert the columns",
            lambda rotation, other=CONVENTIONS[written_as]: other(angles(rotation)),  # type: ignore[misc]
        )
        for written_as, text in _WRITTEN_AS.items()
        if written_as != convention
    ]
    in_reverse = _of_orientations(
        f"{seem} {read_as} with the columns in the reverse order",
        "correct the names of the columns",
        lambda rotation: same(angles(rotation)[::-1]),
    )
    in_degrees = _of_orientations(
        f"the orientations, read as {read_as}, seem to be in degrees",
        "give the unit in the names of the columns, as in rx_deg",
        lambda rotation: same(np.deg2rad(angles(rotation))),
    )
    return [*others, in_reverse, in_degrees]


READINGS = (
    _of_orientations(
        "the quaternions seem to be in the order x, y, z, w",
        "correct the names of the columns: qw is the scalar part",
        lambda rotation: rotation_from_quaternion(np.roll(quaternion_from_rotation(rotation), 1, axis=0)),
    ),
    _of_orientations(
        "the orientations seem to be inverted: of the measuring frame in the target's",
        "invert each orientation (for quaternions, reverse the signs of qx, qy, qz)",
        transpose,
    ),
    *_readings_of_angles("fixed-xyz", "roll, pitch, yaw", rpy_from_rotation),
    *_readings_of_angles("rotvec", "a rotation vector", log_so3),
)
"""Changes of the reading of the orientations."""


def axis_change(of_positions: Array, of_orientations: Array) -> Change | None:
    """Return the change of wrong axes of the positions; None if the frames agree.

    Args:
        of_positions: ``(3, 3)`` matrix from the measuring frame to the base, of the positions, perhaps left-handed.
        of_orientations: ``(3, 3)`` rotation, the same of the orientations.
    """
    matrix = of_orientations.T @ of_positions
    signed = np.round(matrix)
    # Elements of an exchange or a reversal are -1, 0 and 1; a turned frame is off by 0.3 from 17 degrees.
    if np.abs(matrix - signed).max() > 0.3 or np.abs(np.linalg.det(signed)) != 1.0 or np.all(signed == np.eye(3)):
        return None
    signs = signed.sum(axis=1)
    held = ["xyz"[i] for i in np.argmax(np.abs(signed), axis=1)]
    moved = [name for name, content in zip("xyz", held, strict=True) if name != content]
    reversed_axes = [name for name, sign in zip("xyz", signs, strict=True) if sign < 0]
    fix = "correct the names of the columns"
    if not moved:
        text = f"the columns {', '.join(reversed_axes)} seem to have reversed signs"
        if len(reversed_axes) == 1:
            text = f"the column {reversed_axes[0]} seems to have a reversed sign"
        fix = "measure in a right-handed frame, or reverse the sign of the column"
    elif len(moved) == 2 and not reversed_axes:
        text = f"the columns {moved[0]} and {moved[1]} seem to be exchanged"
    else:
        contents = ", ".join(("-" if sign < 0 else "") + name for sign, name in zip(signs, held, strict=True))
        text = f"the columns of the positions seem to be exchanged: x, y, z are {contents} of the file"
    # A column reversed or an exchange is usual, all columns reversed is not.
    return _of_positions(text, fix, signed, 1 + max(len(reversed_axes) - 1, 0) ** 2)


# Hypotheses: sets of changes.

_USUAL_ERROR = 3e-3
"""m; registered error up to which an arm is taken for the one that was measured."""
_SAMPLE = 60
"""Rows that hypotheses are judged by, and hypotheses of each group that are, by a rough fit: it bounds the time."""
_BEST = 8
"""Best hypotheses that are tried with other orientations and axes, or with further changes, which bounds it too."""
_MORE = 2
"""Mistakes that a set is extended by, and that an alternative has beyond those of the simplest, at most."""
_SAME = 1.5
"""Ratio of errors up to which two hypotheses are not distinguishable."""


def check_data(robot: Robot, data: Measurements) -> tuple[str, ...]:
    """Raise an error if the data contain a mistake; return warnings of mistakes in a few rows.

    Other kinds of measurement than positions are not checked.

    Raises:
        InputError: the mistake, its errors and the fix.
    """
    if data.n < ENOUGH or data.q is None or data.kind is not None:
        return ()
    poses = registered_poses(robot, data)
    found = find_row_mistake(robot, data, poses.translation)
    if _is_gross(data, poses) and not (found and found.refused):
        found = find_mistake(robot, data) or find_part_mistake(robot, data, find_mistake) or found
    texts = [f"{data.source}: {found.text}" if data.source else found.text] if found else []
    if found and found.refused:
        raise InputError(texts[0])
    return (*other_arm(robot, data, poses.translation), *texts)


def other_arm(robot: Robot, data: Measurements, predicted: Array) -> tuple[str, ...]:
    """Return a warning that names the arm of the package that fits the poses, where the robot does not.

    ``predicted`` ``(3, N)`` are positions by the robot, registered or not, m; where they agree, nothing is registered.
    """
    if data.n < ENOUGH or data.q is None or _median_error(data, predicted) <= _USUAL_ERROR:
        return ()
    from robacc.modelling.robot_file import read_robot
    from robacc.robots.library import library

    def error(arm: Robot) -> float:
        try:
            return _median_error(data, registered_poses(arm, data).translation)
        except RobaccError:
            return np.inf

    data = data.subset(even_rows(data.n, SAMPLE))
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
    """Return whether the registered error may come from a mistake."""
    if data.rotation is None or _median_error(data, poses.translation) > GROSS * spread(data.position):
        return _median_error(data, poses.translation) > GROSS * spread(data.position)
    return float(np.median(np.linalg.norm(log_between(poses.rotation, data.rotation), axis=0))) > GROSS


def find_mistake(robot: Robot, data: Measurements) -> Mistake | None:
    """Return the mistake, or the set of mistakes, that explains a gross misfit; None if there is none."""
    if data.n < ENOUGH or data.q is None or not _is_gross(data, registered_poses(robot, data)):
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
    of_arm = arm_poses(robot, data, data.q[None])[1][0].T
    variants = [*measured_changes(data, spread(of_arm)), *convention_changes(robot)]
    signs, names = sign_sets(robot), robot.variable_names
    elementary = [
        *signs[: len(names)],
        *units(robot),
        *_orders(names),
        *interactions(robot, itertools.permutations(range(len(names)), 2)),
        *zeros(robot, robot.variables),
    ]
    yield [*([variant] for variant in variants), [(change,) for change in elementary], [(change,) for change in signs]]
    neighbours = ((i + 1, i) for i in range(len(names) - 1))
    common = [*interactions(robot, neighbours), *itertools.islice(units(robot), len(_ANGLES))]
    yield [*([(*variant, some) for some in signs] for variant in variants), list(itertools.product(signs, common))]
    # Base and target take up the zeros of the first and the last joint.
    inner = zeros(robot, robot.variables[1:-1])
    yield [
        list(itertools.combinations(inner, 2)),
        list(itertools.product(signs, inner)),
        [(change,) for change in permutations(names)],
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
        return sorted(map(_Hypothesis, sets, share, share, free.median, nothing, nothing), key=lambda item: item.rank)
    turn, turned, _ = register_orientations(rotation, measured)
    common = register_positions(rotation, translation, position, by_target, turn=turn).median
    # Orientations that hardly vary do not show the base, which the positions then show.
    other = orientation_errors(rotation, measured, free.rotation)
    by_positions = share + other < common / size + turned
    median = np.where(by_positions, free.median, common)
    orientation = np.where(by_positions, other, turned)
    axes = [
        axis_change(base @ np.diag([-1.0, 1.0, 1.0]) if MIRRORED in changes else base, true)
        for changes, base, true in zip(sets, free.rotation, turn, strict=True)
    ]
    rank = share + np.minimum(orientation, PLAUSIBLE)
    found = map(_Hypothesis, sets, median / size + orientation, rank, median, orientation, axes)
    return sorted(found, key=lambda item: item.rank)


def _simplest(pool: Sequence[_Hypothesis], null: _Hypothesis) -> Mistake | None:
    """Return the simplest of the hypotheses that explain the error; None if none does."""
    least = min(item.total for item in pool)
    if least * CLEAR >= null.total:
        return None
    equal = (item for item in pool if item.total <= min(_SAME * least, null.total / CLEAR) and item.changes)
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
        tuple(dict.fromkeys(alternatives))[:EXAMPLES],
        tuple(sorted(unseen)),
    )
