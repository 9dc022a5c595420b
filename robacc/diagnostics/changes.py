"""Changes that undo one data mistake each: of joint columns, of measured poses, and of the robot file."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robacc.diagnostics.mistakes import spread
from robacc.geometry import (
    Array,
    log_so3,
    quaternion_from_rotation,
    rotate_back,
    rotation_from_quaternion,
    rpy_from_rotation,
    transpose,
)
from robacc.measurements import Measurements
from robacc.poses.reading import CONVENTIONS
from robacc.robots.description import Joint, Robot


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
    return Change(text, fix, lambda r: replace(r, q=matrix @ r.q + offset), complexity, frozenset(signs))


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


def joint_changes(robot: Robot) -> list[Change]:
    """Return the elementary changes: a sign, a zero, a unit, an exchange or an interaction."""
    names = robot.variable_names
    pairs = itertools.permutations(range(len(names)), 2)
    return [
        *(_signs(names, (name,)) for name in names),
        *units(robot),
        *_units_of_one(robot),
        *_orders(names),
        *interactions(robot, pairs),
        *zeros(robot, robot.variables),
    ]


_ANGLES = (
    ("degrees", "give the unit in their names, as in q1_deg", np.pi / 180.0),
    ("radians but marked as degrees", "give the unit in their names, as in q1_rad", 180.0 / np.pi),
    ("turns", "convert the columns to rad or degrees", 2.0 * np.pi),
)
"""Unit, fix, and factor to rad."""


def units(robot: Robot) -> list[Change]:
    """Return the changes of the unit of all angles."""
    revolute = np.array([joint.type == "revolute" for joint in robot.variables])
    return [
        _of_joints(f"the joint columns seem to be in {text}", fix, np.diag(np.where(revolute, factor, 1.0)))
        for text, fix, factor in _ANGLES
    ]


def _units_of_one(robot: Robot) -> Iterator[Change]:
    lengths = [
        (unit, "give its unit in the column's name, as in q1_mm", factor)
        for unit, factor in (("millimetres", 1e-3), ("metres but marked as millimetres", 1e3))
    ]
    for i, joint in enumerate(robot.variables):
        for text, fix, factor in _ANGLES if joint.type == "revolute" else lengths:
            one = fix.replace("their names", "the column's name").replace("the columns", "the column")
            matrix = np.diag(np.where(np.arange(len(robot.variables)) == i, factor, 1.0))
            yield _of_joints(f"the column of joint {joint.name} seems to be in {text}", one, matrix)


def _orders(names: Sequence[str]) -> Iterator[Change]:
    count = len(names)
    for i, k in itertools.combinations(range(count), 2):
        order = list(range(count))
        order[i], order[k] = k, i
        text = f"the columns of joints {names[i]} and {names[k]} seem to be exchanged"
        yield _of_joints(text, "correct the names of the columns", np.eye(count)[order])
    if count > 2:
        for order in ([*range(count)][::-1], [*range(1, count), 0], [count - 1, *range(count - 1)]):
            yield _ordered(names, order, 1)


def _ordered(names: Sequence[str], order: Sequence[int], complexity: int) -> Change:
    contents = [names[place] for place in np.argsort(order)]
    text = f"the joint columns seem to be in another order: they hold {listing(contents)}"
    return _of_joints(text, "correct the names of the columns", np.eye(len(names))[list(order)], complexity=complexity)


def permutations(robot: Robot) -> Iterator[Change]:
    """Yield the orders of the joint columns that move more than two, unless there are too many."""
    names = robot.variable_names
    if math.factorial(len(names)) <= MOST_SETS:
        for order in itertools.permutations(range(len(names))):
            moved = sum(place != number for place, number in enumerate(order))
            if moved > 2:
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
    return Change(text, fix, lambda r: replace(r, position=matrix @ r.position), complexity)


def _of_orientations(text: str, fix: str, read: Callable[[Array], Array]) -> Change:
    """Return the change of orientations ``(3, 3, N)`` to ``read`` of them."""
    return Change(text, fix, lambda r: replace(r, rotation=read(r.rotation)))  # type: ignore[arg-type]


def _inverse(recorded: Recorded) -> Recorded:
    assert recorded.rotation is not None
    position = -rotate_back(recorded.rotation, recorded.position)
    return replace(recorded, position=position, rotation=transpose(recorded.rotation))


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
    others = {"standard": "modified", "modified": "standard"}
    if (other := others.get(robot.convention)) is None:
        return []
    changed = replace(robot, convention=other)  # type: ignore[arg-type]
    text = f"the table seems to be of the {other} Denavit-Hartenberg convention"
    return [(Change(text, f"set convention: {other}", lambda r: replace(r, robot=changed)),)]


def _readings() -> Iterator[Change]:
    yield _of_orientations(
        "the quaternions seem to be in the order x, y, z, w",
        "correct the names of the columns: qw is the scalar part",
        lambda rotation: rotation_from_quaternion(np.roll(quaternion_from_rotation(rotation), 1, axis=0)),
    )
    yield _of_orientations(
        "the orientations seem to be inverted: of the measuring frame in the target's",
        "invert each orientation (for quaternions, reverse the signs of qx, qy, qz)",
        transpose,
    )
    yield from _readings_of_angles("fixed-xyz", "roll, pitch, yaw", rpy_from_rotation)
    yield from _readings_of_angles("rotvec", "a rotation vector", log_so3)


def _readings_of_angles(convention: str, read_as: str, angles: Callable[[Array], Array]) -> Iterator[Change]:
    """Yield the readings of three columns that were read in a convention and have another, order or unit."""
    same = CONVENTIONS[convention]
    for written_as, text in _WRITTEN_AS.items():
        if written_as != convention:
            yield _of_orientations(
                f"the orientations seem to be {text}, read as {read_as}",
                f"give `angles`: {written_as}, or convert the columns",
                lambda rotation, other=CONVENTIONS[written_as]: other(angles(rotation)),  # type: ignore[misc]
            )
    yield _of_orientations(
        f"the orientations seem to be {read_as} with the columns in the reverse order",
        "correct the names of the columns",
        lambda rotation: same(angles(rotation)[::-1]),
    )
    yield _of_orientations(
        f"the orientations, read as {read_as}, seem to be in degrees",
        "give the unit in the names of the columns, as in rx_deg",
        lambda rotation: same(np.deg2rad(angles(rotation))),
    )


READINGS = tuple(_readings())
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
        text = f"the column {reversed_axes[0]} seems to have a reversed sign"
        if len(reversed_axes) > 1:
            text = f"the columns {', '.join(reversed_axes)} seem to have reversed signs"
        fix = "measure in a right-handed frame, or reverse the sign of the column"
    elif len(moved) == 2 and not reversed_axes:
        text = f"the columns {moved[0]} and {moved[1]} seem to be exchanged"
    else:
        contents = ", ".join(("-" if sign < 0 else "") + name for sign, name in zip(signs, held, strict=True))
        text = f"the columns of the positions seem to be exchanged: x, y, z are {contents} of the file"
    # A column reversed or an exchange is usual, all columns reversed is not.
    return _of_positions(text, fix, signed, 1 + max(len(reversed_axes) - 1, 0) ** 2)
