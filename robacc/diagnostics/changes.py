"""Changes of joint columns and of measured poses that undo a data mistake: signs, zeros, units, axes, conventions."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.geometry import (
    Array,
    log_so3,
    quaternion_from_rotation,
    rotate_back,
    rotation_from_quaternion,
    rpy_from_rotation,
    transpose,
)
from robacc.poses.reading import CONVENTIONS
from robacc.robots.description import Robot

# Changes of the joint columns that undo a data mistake: signs, zeros, units, exchanged columns, interactions.

_MOST_SUBSETS = 8
"""Joints up to which every set of signs is tried; with more, sets of up to three signs."""
_FLIPS = 3
_SIGN_FIX = "set sign: -1 for the joint{} in the robot file, or reverse the sign of {} column{}"


@dataclass(frozen=True, slots=True)
class JointChange:
    """Change of joint columns that undoes one mistake, or several signs together."""

    text: str
    fix: str
    apply: Callable[[Array], Array]
    """Map of joint variables ``(J, N)`` to the corrected ones."""
    complexity: int = 1
    """Number of mistakes."""
    signs: frozenset[str] = frozenset()
    """Joints whose sign is reversed."""
    of_neighbours: bool = False
    """Whether it is an interaction of two neighbouring joints."""
    of_all: bool = False
    """Whether it is a unit of all joints."""


def listing(names: Sequence[str]) -> str:
    """Return names as text: ``j1, j4 and j6``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def sign_sets(robot: Robot) -> list[JointChange]:
    """Return the reversals of every set of joint signs, small sets first."""
    names = robot.variable_names
    most = len(names) if len(names) <= _MOST_SUBSETS else _FLIPS
    return [
        reversed_signs(names, chosen)
        for size in range(1, most + 1)
        for chosen in itertools.combinations(range(len(names)), size)
    ]


def joint_changes(robot: Robot) -> list[JointChange]:
    """Return the elementary changes: a sign, a zero, a unit, an exchange or an interaction."""
    names = robot.variable_names
    revolute = [joint.type == "revolute" for joint in robot.variables]
    changes = [reversed_signs(names, (i,)) for i in range(len(names))]
    changes.extend(_units(names, revolute))
    changes.extend(_orders(names))
    changes.extend(interactions(robot))
    changes.extend(_zeros(names, revolute))
    return changes


def interactions(robot: Robot) -> list[JointChange]:
    """Return the changes that undo an interaction: a column that holds the sum or difference of two joints.

    On an arm with a parallelogram, and on controllers whose third axis counts from the horizontal, column 3 holds
    ``q3 + q2`` or ``q3 - q2``.
    """
    names = robot.variable_names
    kinds = [joint.type for joint in robot.variables]
    changes = []
    for i, k in itertools.permutations(range(len(names)), 2):
        if kinds[i] != kinds[k]:
            continue
        for sign, formula in ((1.0, "{j} - {k}"), (-1.0, "{j} + {k}")):
            changes.append(
                JointChange(
                    f"the column of joint {names[i]} seems to hold "
                    f"{formula.format(j=names[i], k=names[k])} (interaction not removed)",
                    f"{'add' if sign > 0 else 'subtract'} the column of {names[k]} {'to' if sign > 0 else 'from'} that "
                    f"of {names[i]}, or give joint {names[i]} `coupling: {{{names[k]}: {sign:g}}}` in the robot file",
                    _added(i, k, sign),
                    of_neighbours=i == k + 1,
                )
            )
    return changes


def inner_zeros(robot: Robot) -> list[JointChange]:
    """Return the changes of the zeros of all joints but the first and the last, which base and target take up."""
    revolute = [joint.type == "revolute" for joint in robot.variables]
    revolute[0] = revolute[-1] = False
    return list(_zeros(robot.variable_names, revolute))


def permutations(robot: Robot) -> Iterator[JointChange]:
    """Yield every order of the joint columns but the given one, for arms of up to six joints."""
    names = robot.variable_names
    if len(names) > 6:
        return
    for order in itertools.permutations(range(len(names))):
        moved = sum(place != number for place, number in enumerate(order))
        if moved > 2:
            yield _ordered(names, order, moved - 1)


def reversed_signs(names: Sequence[str], chosen: Sequence[int]) -> JointChange:
    """Return the reversal of the signs of the joints with the numbers ``chosen``."""
    factor = np.ones((len(names), 1))
    factor[list(chosen)] = -1.0
    reversed_names = [names[i] for i in chosen]
    several = len(chosen) > 1
    subject = (
        f"the signs of joints {listing(reversed_names)} seem"
        if several
        else (f"the sign of joint {reversed_names[0]} seems")
    )
    return JointChange(
        f"{subject} to be reversed",
        _SIGN_FIX.format("s" * several, "each" if several else "its", ""),
        lambda q: q * factor,
        len(chosen),
        frozenset(reversed_names),
    )


def _units(names: Sequence[str], revolute: Sequence[bool]) -> Iterator[JointChange]:
    for text, fix, factor in (
        ("degrees", "give the unit in their names, as in q1_deg", np.pi / 180.0),
        ("radians but marked as degrees", "give the unit in their names, as in q1_rad", 180.0 / np.pi),
        ("turns", "convert the columns to rad or degrees", 2.0 * np.pi),
    ):
        yield JointChange(f"the joint columns seem to be in {text}", fix, _scaled(revolute, factor), of_all=True)
        for i in (i for i, turns in enumerate(revolute) if turns):
            yield JointChange(
                f"the column of joint {names[i]} seems to be in {text}",
                fix.replace("their names", "the column's name").replace("the columns", "the column"),
                _scaled([k == i for k in range(len(names))], factor),
            )
    for i in (i for i, turns in enumerate(revolute) if not turns):
        for factor, unit in ((1e-3, "millimetres"), (1e3, "metres but marked as millimetres")):
            yield JointChange(
                f"the column of joint {names[i]} seems to be in {unit}",
                "give its unit in the column's name, as in q1_mm",
                _scaled([k == i for k in range(len(names))], factor),
            )


def _orders(names: Sequence[str]) -> Iterator[JointChange]:
    count = len(names)
    for i, k in itertools.combinations(range(count), 2):
        order = list(range(count))
        order[i], order[k] = k, i
        yield JointChange(
            f"the columns of joints {names[i]} and {names[k]} seem to be exchanged",
            "correct the names of the columns",
            _reordered(order),
        )
    if count > 2:
        ahead = [*range(1, count), 0]
        for order in (list(range(count))[::-1], ahead, [count - 1, *range(count - 1)]):
            yield _ordered(names, order, 1)


def _ordered(names: Sequence[str], order: Sequence[int], complexity: int) -> JointChange:
    contents = [""] * len(names)
    for place, number in enumerate(order):
        contents[number] = names[place]
    return JointChange(
        f"the joint columns seem to be in another order: they hold {listing(contents)}",
        "correct the names of the columns",
        _reordered(order),
        complexity,
    )


def _zeros(names: Sequence[str], revolute: Sequence[bool]) -> Iterator[JointChange]:
    for i in (i for i, turns in enumerate(revolute) if turns):
        for angle in (90, -90, 180):
            yield JointChange(
                f"joint {names[i]} seems to count from a zero {abs(angle)} degrees away",
                f"add {angle} degrees to its column, or to its theta in the robot file",
                _added_angle(i, np.deg2rad(angle)),
                2,
            )


def _scaled(mask: Sequence[bool], factor: float) -> Callable[[Array], Array]:
    factors = np.where(mask, factor, 1.0)[:, None]
    return lambda q: q * factors


def _reordered(order: Sequence[int]) -> Callable[[Array], Array]:
    index = np.array(order)
    return lambda q: q[index]


def _added(i: int, k: int, sign: float) -> Callable[[Array], Array]:
    def apply(q: Array) -> Array:
        result = q.copy()
        result[i] += sign * q[k]
        return result

    return apply


def _added_angle(i: int, angle: float) -> Callable[[Array], Array]:
    def apply(q: Array) -> Array:
        result = q.copy()
        result[i] += angle
        return result

    return apply


# Changes of the measured poses that undo a data mistake: units, axes, inverse poses, conventions of orientation.

UNITS = (
    (1e-3, "millimetres", "give the unit in their names, as in x_mm"),
    (1e-6, "micrometres", "give the unit in their names, as in x_um"),
    (1e3, "metres but marked as millimetres", "give the unit in their names, as in x_m"),
    (0.0254, "inches", "convert them, or give their unit"),
    (25.4, "inches but marked as millimetres", "convert them, or give their unit"),
)
"""Factor to metres, the unit, and the fix."""
_CLOSE = 0.3
"""Largest difference of an element of a rotation from that of a signed permutation."""
_READ_AS = {"fixed-xyz": "roll, pitch, yaw", "rotvec": "a rotation vector"}
_WRITTEN_AS = {
    "rotvec": "rotation vectors",
    "fixed-xyz": "angles about the fixed axes x, y, z",
    "moving-xyz": "angles about the moving axes x, y, z",
    "kuka-abc": "angles A, B, C about z, y, x",
    "zyz": "angles about the moving axes z, y, z",
}


@dataclass(frozen=True, slots=True)
class MeasuredPoses:
    """Measured poses with some mistakes undone."""

    position: Array
    """``(3, N)``, m"""
    rotation: Array | None
    """``(3, 3, N)``"""
    texts: tuple[str, ...] = ()
    fixes: tuple[str, ...] = ()
    complexity: int = 0
    """Number of mistakes."""
    mirrored: bool = False
    """Whether the first axis of the positions is reversed, so that a left-handed frame becomes right-handed."""

    def with_rotation(self, text: str, fix: str, rotation: Array) -> MeasuredPoses:
        """Return the poses with a wrong reading of the orientations undone."""
        texts, fixes = (*self.texts, text), (*self.fixes, fix)
        return dataclasses.replace(self, rotation=rotation, texts=texts, fixes=fixes, complexity=self.complexity + 1)

    def with_axes(self, text: str, fix: str, matrix: Array) -> MeasuredPoses:
        """Return the poses with wrong axes of the positions undone, which replaces the reversal of the first axis."""
        position, count = self.position, len(self.texts)
        if self.mirrored:
            position, count = position * np.array([[-1.0], [1.0], [1.0]]), count - 1
        texts, fixes = (*self.texts[:count], text), (*self.fixes[:count], fix)
        # A column reversed or an exchange is usual, all columns reversed is not.
        complexity = count + 1 + max(int(np.count_nonzero(matrix.sum(axis=0) < 0)) - 1, 0) ** 2
        return MeasuredPoses(matrix @ position, self.rotation, texts, fixes, complexity)


def measured_changes(position: Array, rotation: Array | None, expected_spread: float) -> list[MeasuredPoses]:
    """Return the measured poses as they are and with mistakes undone.

    Args:
        position: ``(3, N)`` m.
        rotation: ``(3, 3, N)``, or None.
        expected_spread: Standard deviation of the arm's own positions, m.
    """
    as_measured = MeasuredPoses(position, rotation)
    variants = [as_measured]
    spread = max(float(np.sqrt(np.var(position, axis=1).sum())), 1e-12)
    if not 1 / 3 < spread / expected_spread < 3:
        for factor, unit, fix in UNITS:
            if 1 / 3 < factor * spread / expected_spread < 3:
                variants.append(
                    MeasuredPoses(position * factor, rotation, (f"the positions seem to be in {unit}",), (fix,), 1)
                )
    if rotation is not None:
        variants.append(
            MeasuredPoses(
                -rotate_back(rotation, position),
                transpose(rotation),
                ("the measured poses seem to be inverted: the instrument's pose in the target's frame",),
                ("invert each measured pose",),
                1,
            )
        )
    left_handed = "the positions seem to be in a left-handed frame"
    advice = "look for a column with a reversed sign, or for two exchanged columns"
    mirrored = [
        MeasuredPoses(
            item.position * np.array([[-1.0], [1.0], [1.0]]),
            item.rotation,
            (*item.texts, left_handed),
            (*item.fixes, advice),
            item.complexity + 1,
            mirrored=True,
        )
        for item in variants
    ]
    return [*variants, *mirrored]


def orientation_changes(rotation: Array) -> Iterator[tuple[str, str, Array]]:
    """Yield the name, the fix and the orientations with a wrong reading undone."""
    quaternion = quaternion_from_rotation(rotation)
    yield (
        "the quaternions seem to be in the order x, y, z, w",
        "correct the names of the columns: qw is the scalar part",
        rotation_from_quaternion(np.roll(quaternion, 1, axis=0)),
    )
    yield (
        "the orientations seem to be inverted: of the measuring frame in the target's",
        "invert each orientation (for quaternions, reverse the signs of qx, qy, qz)",
        transpose(rotation),
    )
    numbers = {"fixed-xyz": rpy_from_rotation(rotation), "rotvec": log_so3(rotation)}
    for read_as, angles in numbers.items():
        for written_as, text in _WRITTEN_AS.items():
            if written_as != read_as:
                yield (
                    f"the orientations seem to be {text}, read as {_READ_AS[read_as]}",
                    f"give `angles`: {written_as}, or convert the columns",
                    CONVENTIONS[written_as](angles),
                )
        yield (
            f"the orientations seem to be {_READ_AS[read_as]} with the columns in the reverse order",
            "correct the names of the columns",
            CONVENTIONS[read_as](angles[::-1]),
        )
        yield (
            f"the orientations, read as {_READ_AS[read_as]}, seem to be in degrees",
            "give the unit in the names of the columns, as in rx_deg",
            CONVENTIONS[read_as](np.deg2rad(angles)),
        )


def axis_change(of_positions: Array, of_orientations: Array, mirrored: bool) -> tuple[str, str, Array] | None:
    """Return the wrong axes of the positions as text, fix and matrix; None if the frames agree.

    Args:
        of_positions: ``(3, 3)`` rotation from the measuring frame to the base, of the positions.
        of_orientations: ``(3, 3)`` the same, of the orientations.
        mirrored: Whether the first axis of the positions was reversed before.
    """
    matrix = of_orientations.T @ of_positions @ np.diag([-1.0 if mirrored else 1.0, 1.0, 1.0])
    signed = np.round(matrix)
    if np.abs(matrix - signed).max() > _CLOSE or np.abs(np.linalg.det(signed)) != 1.0 or np.all(signed == np.eye(3)):
        return None
    order = np.argmax(np.abs(signed), axis=1)
    signs = signed[np.arange(3), order]
    if np.all(order == np.arange(3)):
        names = ["xyz"[i] for i in np.flatnonzero(signs < 0)]
        if len(names) == 1:
            text = f"the column {names[0]} seems to have a reversed sign"
        else:
            text = f"the columns {', '.join(names)} seem to have reversed signs"
        return text, "measure in a right-handed frame, or reverse the sign of the column", signed
    moved = [i for i in range(3) if order[i] != i]
    if len(moved) == 2 and np.all(signs > 0):
        text = f"the columns {'xyz'[moved[0]]} and {'xyz'[moved[1]]} seem to be exchanged"
    else:
        contents = ", ".join(("-" if s < 0 else "") + "xyz"[o] for s, o in zip(signs, order, strict=True))
        text = f"the columns of the positions seem to be exchanged: x, y, z are {contents} of the file"
    return text, "correct the names of the columns", signed
