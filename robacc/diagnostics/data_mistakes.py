"""Mistakes in the data or the robot file, detected before any effect is fitted.

Mistakes are tried alone and in sets: every set of joint signs, signs with an interaction of two joints, and then the
best sets with further changes. Each hypothesis is judged by a sample of rows, with base and target registered.

Rows may belong to the joints of other rows. Base and targets are registered on windows of rows under every shift. Of
the registration that fits most rows, each row then has an error under each shift. A stretch in which another shift fits
better by far is shifted. Rows that fit under no shift are matched with each other (assignment, Kuhn 1955). A stretch
that fits nowhere is examined by itself.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from robacc.errors import LISTED, InputError, RobaccError, refuse
from robacc.fitting.closed_form import (
    PASSES,
    Registration,
    arm_poses,
    orientation_errors,
    register_frames,
    register_orientations,
    register_positions,
    rows_by_target,
)
from robacc.fitting.levels import ALIKE, BEST, ENOUGH, EXAMPLES, FEW, GROSS, MANY, SAMPLE, SHORTLIST
from robacc.geometry import (
    Array,
    NDArray,
    Poses,
    log_between,
    log_so3,
    quaternion_from_rotation,
    rms_length,
    rotate_back,
    rotation_from_quaternion,
    rpy_from_rotation,
    transpose,
)
from robacc.measurements import Measurements, even_rows
from robacc.modelling.model import predict
from robacc.poses.reading import CONVENTIONS
from robacc.robots.description import Joint, Robot
from robacc.statistics.intervals import quantiles

# A mistake in the data or the robot file, and the misfit from which there may be one.

PLAUSIBLE = 10.0 * GROSS
"""Median registered error, as :data:`GROSS`, of positions that are right in the main: registered on few rows, or on an
arm with a further mistake."""
CLEAR = 8.0
"""Factor by which the correction of a mistake has to reduce the error. Registration of base and target explains at most
a factor of three of a mistake in a few rows."""


class Mistake(NamedTuple):
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


# Changes that undo one mistake each: of joint columns, of measured poses, and of the robot file.


class Recorded(NamedTuple):
    """What may hold a mistake: the robot file and the columns of the measured poses."""

    robot: Robot
    q: Array
    """``(J, N)`` joint variables, rad or m."""
    position: Array
    """``(3, N)``, m"""
    rotation: Array | None
    """``(3, 3, N)``"""


class Change(NamedTuple):
    """Change that undoes one mistake, or several signs together."""

    text: str
    fix: str
    apply: Callable[[Recorded], Recorded]
    """Map of what was recorded to what is right."""
    complexity: int = 1
    """Number of mistakes; more for one that is unusual."""
    signs: frozenset[str] = frozenset()
    """Joints whose sign is reversed, if it undoes nothing else."""


def _enumerated(names: Sequence[str]) -> str:
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
    return Change(text, fix, lambda r: r._replace(q=matrix @ r.q + offset), complexity, frozenset(signs))


def sign_sets(robot: Robot) -> list[Change]:
    """Return the reversals of sets of joint signs, small sets first."""
    names = robot.variable_names
    sets = (chosen for size in range(1, len(names) + 1) for chosen in itertools.combinations(names, size))
    changes = []
    for chosen in itertools.islice(sets, MOST_SETS):
        subject, joint, column = f"the sign of joint {chosen[0]} seems", "the joint", "its column"
        if len(chosen) > 1:
            subject, joint, column = f"the signs of joints {_enumerated(chosen)} seem", "the joints", "each column"
        fix = f"set sign: -1 for {joint} in the robot file, or reverse the sign of {column}"
        matrix = np.diag([-1.0 if name in chosen else 1.0 for name in names])
        changes.append(_of_joints(f"{subject} to be reversed", fix, matrix, complexity=len(chosen), signs=chosen))
    return changes


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
            of_column = fix.replace("their names", "the column's name").replace("the columns", "the column")
            matrix = np.diag(np.where(np.arange(revolute.size) == i, factor, 1.0))
            yield _of_joints(f"the column of joint {joint.name} seems to be in {text}", of_column, matrix)


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
    text = (
        f"the columns of joints {moved[0]} and {moved[1]} seem to be exchanged"
        if len(moved) == 2
        else f"the joint columns seem to be in another order: they hold {_enumerated(held)}"
    )
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
    for i, k in ((i, k) for i, k in pairs if kinds[i] == kinds[k]):
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
    return Change(text, fix, lambda r: r._replace(position=matrix @ r.position), complexity)


def _of_orientations(text: str, fix: str, read: Callable[[Array], Array]) -> Change:
    """Return the change of orientations ``(3, 3, N)`` to ``read`` of them."""
    return Change(text, fix, lambda r: r._replace(rotation=read(r.rotation)))  # type: ignore[arg-type]


def _inverse(recorded: Recorded) -> Recorded:
    assert recorded.rotation is not None
    return recorded._replace(
        position=-rotate_back(recorded.rotation, recorded.position),
        rotation=transpose(recorded.rotation),
    )


MIRRORED = _of_positions(
    "the positions seem to be in a left-handed frame",
    "look for a column with a reversed sign, for two exchanged columns, or for a wrong sign in the robot file",
    np.diag([-1.0, 1.0, 1.0]),
)
"""Change by which a left-handed frame becomes right-handed: the first axis is reversed."""
_INVERTED = Change(
    "the measured poses seem to be inverted: the instrument's pose in the target's frame",
    "invert each measured pose; of a board that a camera on the hand sees, state `camera`, a file with mount: hand",
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
    return [(Change(text, f"set convention: {other}", lambda r: r._replace(robot=changed)),)]


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
        "the quaternions seem to be in the order w, x, y, z, read as x, y, z, w",
        "correct the names of the columns: qw is the scalar part",
        lambda rotation: rotation_from_quaternion(np.roll(quaternion_from_rotation(rotation), -1, axis=0)),
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
        text = (
            f"the column {reversed_axes[0]} seems to have a reversed sign"
            if len(reversed_axes) == 1
            else f"the columns {', '.join(reversed_axes)} seem to have reversed signs"
        )
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


def check_data(robot: Robot, data: Measurements) -> tuple[str, ...]:
    """Raise an error if the data contain a mistake or are of another arm; return warnings of mistakes in a few rows.

    Photos are checked by the poses that they show to each camera, sockets for mistakes of the joint columns and of the
    robot file; planes, lines, spheres and distances are not checked.

    Raises:
        InputError: the mistake, its errors and the fix.
    """
    if data.photos is not None and data.fixture is not None:
        # Cameras beside the arm are fixtures, those on its hand are targets.
        names = np.stack((data.fixture, data.fixture if data.target is None else data.target))
        camera = np.unique(names, axis=1, return_inverse=True)[1].ravel()
        if camera.any():
            of_each = (check_data(robot, data.subset(camera == one)) for one in np.unique(camera))
            return tuple(dict.fromkeys(itertools.chain.from_iterable(of_each)))
    data = data.each_photo() or data
    data = data if data.kind is None else data.subset(data.kind == "point")
    if data.n < ENOUGH or data.q is None:
        return ()
    poses = registered_poses(robot, data)
    mistake, is_gross = find_row_mistake(robot, data, poses.translation), _is_gross(data, poses)
    if is_gross and not (mistake and mistake.refused):
        mistake = find_mistake(robot, data) or find_part_mistake(robot, data) or mistake
    texts = [f"{data.source}: {mistake.text}" if data.source else mistake.text] if mistake else []
    refuse((mistake and mistake.refused, "".join(texts)), error=InputError)
    others = other_arm(robot, data, poses.translation)
    refuse((others and is_gross, "".join(others)), error=InputError)
    return (*others, *texts)


def other_arm(robot: Robot, data: Measurements, predicted: Array) -> tuple[str, ...]:
    """Return a warning that names the arm of the package that fits the poses, where the robot does not.

    ``predicted`` ``(3, N)`` are positions by the robot, registered or not, m; where they agree, nothing is registered.
    """
    if data.n < ENOUGH or data.q is None or data.kind is not None or _median_error(data, predicted) <= _USUAL_ERROR:
        return ()
    from robacc.modelling.robot_file import library, read_robot

    def error(arm: Robot) -> float:
        try:
            return _median_error(data, registered_poses(arm, data).translation)
        except RobaccError:
            return np.inf

    data = data.subset(even_rows(data.n, SAMPLE))
    if (own := error(robot)) <= _USUAL_ERROR:
        return ()
    fits = {
        arm["name"]: error(dataclasses.replace(read_robot(arm["path"]), targets=robot.targets))
        for arm in library()
        if arm["n_axes"] == len(robot.variables)
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
    # np.median would import numpy.ma, a tenth of the start-up.
    return quantiles(np.linalg.norm(data.position - predicted, axis=0), [0.5])[0]


def _is_gross(data: Measurements, poses: Poses) -> bool:
    """Return whether the registered error may come from a mistake."""
    return _median_error(data, poses.translation) > GROSS * spread(data.position) or (
        data.rotation is not None
        and float(np.median(np.linalg.norm(log_between(poses.rotation, data.rotation), axis=0))) > GROSS
    )


def find_mistake(robot: Robot, data: Measurements) -> Mistake | None:
    """Return the mistake, or the set of mistakes, that explains a gross misfit; None if there is none."""
    data = data.subset(even_rows(data.n, SHORTLIST))
    pool = _judged(robot, data, [()])
    if not pool or (null := pool[0]).total <= GROSS:
        return None
    for groups in _stages(robot, data, pool):
        for sets in filter(None, groups):
            pool.extend(_judged(robot, data, sets))
        if min(item.total for item in pool) < min(2 * GROSS, null.total / CLEAR):
            break
    found = _simplest(pool, null)
    if found is None and null.orientation is not None and null.orientation > GROSS:
        # Positions know nothing of how orientations were read, and an arm may have other errors besides.
        readings = _screened(robot, data, [(reading,) for reading in READINGS])
        turned = [item._replace(total=item.orientation or 0.0) for item in readings]
        found = _simplest(turned, null._replace(total=null.orientation))
    return found


class _Hypothesis(NamedTuple):
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


_Sets = Sequence[tuple[Change, ...]]


def _stages(robot: Robot, data: Measurements, pool: Sequence[_Hypothesis]) -> Iterator[list[_Sets]]:
    """Yield groups of sets of changes, the likely ones first; ``pool`` has what was judged before."""
    assert data.q is not None
    of_arm = arm_poses(robot, data, data.q[None])[1][0].T
    variants = [
        *(measured_changes(data, spread(of_arm)) if data.kind is None else ()),
        *convention_changes(robot),
    ]
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
    for _ in range(2):
        best = sorted(pool, key=lambda item: (item.rank, item.complexity))[:BEST]
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
        if len(sets) > SHORTLIST:
            half = data.subset(slice(None, None, 2))
            batches = (_undone(robot, half, sets[i : i + MOST_SETS]) for i in range(0, len(sets), MOST_SETS))
            rough = np.concatenate([_registered(half, *batch[:4], passes=1)[1] for batch in batches])
            sets = [sets[i] for i in np.argsort(rough, kind="stable")[:SHORTLIST]]
        judged = _screened(robot, data, sets)
    except (RobaccError, np.linalg.LinAlgError):
        return []
    for item in judged[:BEST]:
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


def _registered(
    data: Measurements, rotation: Array, translation: Array, position: Array, by_target: Array, passes: int = PASSES
) -> tuple[Registration, Array, Array]:
    """Return base or sockets, and targets, registered, the median errors over the spreads, and these, both ``(H,)``.

    In sockets, the arm's own positions spread: with too little motion it would reach every socket.
    """
    by_socket = None if data.fixture is None else (data.fixture == np.unique(data.fixture)[:, None]).astype(float)
    turn = None if by_socket is None else np.broadcast_to(np.eye(3), (len(translation), 3, 3))
    found = register_positions(
        rotation, translation, position, by_target, by_socket=by_socket, turn=turn, passes=passes
    )
    size = np.array([spread(each.T) for each in (position if by_socket is None else translation)])
    return found, found.median / size, size


def _screened(robot: Robot, data: Measurements, sets: _Sets) -> list[_Hypothesis]:
    """Return the sets with the errors that remain, the best first."""
    rotation, translation, position, by_target, measured = _undone(robot, data, sets)
    free, share, size = _registered(data, rotation, translation, position, by_target)
    nothing = [None] * len(sets)
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
    hypotheses = map(_Hypothesis, sets, median / size + orientation, rank, median, orientation, axes)
    return sorted(hypotheses, key=lambda item: item.rank)


def _simplest(pool: Sequence[_Hypothesis], null: _Hypothesis) -> Mistake | None:
    """Return the simplest of the hypotheses that explain the error; None if none does."""
    least = min(item.total for item in pool)
    if least * CLEAR >= null.total:
        return None
    equal = (item for item in pool if item.total <= min(ALIKE * least, null.total / CLEAR) and item.changes)
    best, *others = sorted(equal, key=lambda item: (item.complexity, item.total))
    alternatives, unseen = [], set[str]()
    texts = [change.text for change in best.changes]
    for item in others:
        more = item.changes[0].signs > best.changes[0].signs > frozenset()
        if more and len(item.changes) == len(best.changes) == 1:
            unseen |= item.changes[0].signs - best.changes[0].signs
        elif item.complexity <= best.complexity + 2 and not {*texts} <= {change.text for change in item.changes}:
            alternatives.append(" and ".join(change.text for change in item.changes))
    return Mistake(
        "; ".join(texts),
        "; ".join(dict.fromkeys(change.fix for change in best.changes)),
        null.position,
        best.position,
        null.orientation,
        best.orientation,
        tuple(dict.fromkeys(alternatives))[:EXAMPLES],
        tuple(sorted(unseen)),
    )


# Rows that belong to the joints of other rows, and stretches of rows.

_SHIFTS = np.array([0, 1, -1, 2, -2, 3, -3])
"""Rows that a stretch is shifted by."""
_MOST_COST = 9.0
"""Largest cost of a row, in squares of three times the typical error. Each end of a stretch costs as much."""


def find_row_mistake(robot: Robot, data: Measurements, predicted: Array) -> Mistake | None:
    """Return shifted or exchanged rows; None if all rows are in place or nothing can be said.

    Args:
        robot: Robot, whose base and targets are registered.
        data: Measured poses.
        predicted: ``(3, N)`` positions with base and targets registered on all rows, m.
    """
    errors, gross = _lengths(data.position - predicted), 2 * GROSS * spread(data.position)
    middle = float(np.median(errors))
    if (
        data.kind is not None
        or not ENOUGH <= data.n <= MANY
        or (middle <= gross and errors.max() <= max(gross, CLEAR * middle))
    ):
        return None
    predicted = _best_predicted(robot, data, predicted)
    by_shift = _errors_by_shift(predicted, data.position)
    return (
        _permuted(robot, data)
        if np.median(by_shift.min(axis=0)) > PLAUSIBLE * spread(data.position)
        else _shifted(data, by_shift, gross) or _exchanged(data, predicted, gross)
    )


def find_part_mistake(robot: Robot, data: Measurements) -> Mistake | None:
    """Return the stretch of rows that has a mistake; None if there is none, or only base or target moved."""
    errors = _lengths(data.position - _best_predicted(robot, data, registered_poses(robot, data).translation))
    gross, typical = 2 * GROSS * spread(data.position), float(np.quantile(errors, 0.25))
    wrong = errors > max(gross, CLEAR * typical)
    rows = next(_runs(np.where(wrong, 1.0, -1.0), ENOUGH), np.arange(0))
    outside = np.delete(wrong, rows)
    if typical > gross or not rows.size or not outside.size or max(1 - wrong[rows].mean(), outside.mean()) > 2 * FEW:
        return None
    part = data.subset(rows)
    size = float(np.median(errors[rows]))
    alone = float(np.median(_lengths(part.position - registered_poses(robot, part).translation)))
    if alone <= max(gross / 2, size / CLEAR):
        # Only base or target moved: a step, which a trace finds.
        return None
    where = _stretch(data, rows)
    if (mistake := find_mistake(robot, part)) is not None:
        # Its usual fix, in the robot file or of a whole column, would spoil the other rows.
        return mistake._replace(
            name=f"{where}, unlike the other rows: {mistake.name}",
            fix="correct these rows only: the others agree with the robot file",
        )
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
    length = min(max(data.n // BEST, ENOUGH), SHORTLIST, data.n - 2 * margin)
    by_target, (rotation, translation) = rows_by_target(robot, data), arm_poses(robot, data, data.q[None])
    tried: list[tuple[float, Array, Array, Array]] = []
    for start in np.linspace(margin, data.n - length - margin, BEST).astype(int).tolist():
        rows = np.arange(start, start + length)
        turns, links = (np.repeat(each[:, rows], _SHIFTS.size, axis=0) for each in (rotation, translation))
        registered = register_positions(turns, links, data.position.T[rows + _SHIFTS[:, None]], by_target[:, rows])
        tried.extend(
            zip(registered.median.tolist(), registered.rotation, registered.shift, registered.targets, strict=True)
        )
    candidates = [predicted]
    for _, turn, shift, targets in sorted(tried, key=lambda item: item[0])[:BEST]:
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
    shifted = []
    for number, shift in enumerate(_SHIFTS.tolist()):
        others = np.delete(cost, number, axis=0).min(axis=0)
        for rows in _runs(others - cost[number], 2 * _MOST_COST):
            here, there = errors[0, rows], errors[number, rows][np.isfinite(errors[number, rows])]
            if shift and np.median(here) > max(CLEAR * np.median(there), gross):
                place = "" if rows.size >= data.n - 2 * _SHIFTS.max() else f"{_stretch(data, rows)}: "
                by = f"{'one row' if abs(shift) == 1 else f'{abs(shift)} rows'} {'down' if shift > 0 else 'up'}"
                text = f"{place}the measured poses seem to be shifted by {by} against the joints"
                shifted.append((int(rows[0]), text, here, there))
    if not shifted:
        return None
    _, texts, before, after = zip(*sorted(shifted, key=lambda item: item[0]), strict=True)
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
        ", ".join(dict.fromkeys(map(data.label, wrong[members[:LISTED]].tolist()))) + ", …" * (members.size > LISTED)
        for members in cycles
    ]
    what, fix = "the measured poses", "pair each measured pose with its own joint values"
    # Rows of equal joints and different targets: only their names can be wrong.
    if data.target is not None and all(
        np.allclose(data.q[:, wrong[each]], data.q[:, wrong[each[:1]]])  # type: ignore[index]
        and np.unique(data.target[wrong[each]]).size == each.size
        for each in cycles
    ):
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


def _permuted(robot: Robot, data: Measurements) -> Mistake | None:
    """Return all rows if the measured positions are those of the commands in another order.

    Distances from the centre of all positions do not depend on the base. Sorted, they agree then, with the tool that
    fits best, far better than those of other poses of the arm; row by row they do not.
    """
    from scipy.optimize import least_squares

    poses, centred = predict(robot, data), data.position - data.position.mean(axis=1, keepdims=True)
    measured = _lengths(centred)

    def of_arm(tool: Array) -> Array:
        position = poses.translation + np.einsum("ijn,j->in", poses.rotation, tool)
        return _lengths(position - position.mean(axis=1, keepdims=True))

    def differences(tool: Array) -> Array:
        return np.asarray(np.sort(of_arm(tool)) - np.sort(measured))

    tool = least_squares(differences, np.zeros(3), x_scale=0.1).x
    in_order, by_row = rms_length(differences(tool)[None]), rms_length((of_arm(tool) - measured)[None])
    # Of the same points in another order, the difference in order times the root of the number of rows is 0.05 of that
    # by row for an arm with 1 mm of error; 0.4 and more for other poses of the arm.
    if by_row <= PLAUSIBLE * spread(data.position) or in_order * np.sqrt(data.n) > 0.12 * by_row:
        return None
    return Mistake(
        "the measured poses seem to be in another order than the joints: sorted by their distance from the middle of "
        f"all they agree to {1e3 * in_order:.2g} mm rms, row by row only to {1e3 * by_row:.3g} mm",
        "pair each measured pose with its own joint values, by a name or by the time",
    )


def _stretch(data: Measurements, rows: NDArray[np.int64]) -> str:
    return f"{data.counted}s {data.label(int(rows[0]))} to {data.label(int(rows[-1]))}"


def _lengths(vectors: Array) -> Array:
    """Return the lengths ``(N,)`` of vectors ``(3, N)``."""
    return np.asarray(np.linalg.norm(vectors, axis=0))
