"""Changes of the joint columns that undo a data mistake: signs, zeros, units, exchanged columns, interactions."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.geometry import Array
from robacc.robots.description import Robot

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
