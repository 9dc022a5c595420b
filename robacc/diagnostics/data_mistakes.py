"""Mistakes in the data or the robot file that no effect should be asked to explain: found first, and named."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from robacc.errors import InputError, RobaccError
from robacc.fitting.closed_form import register_frames
from robacc.geometry import Array, quaternion_from_rotation, rotation_from_quaternion
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.robots.description import Robot

GROSS = 0.02
"""Share of the positions' spread: a median error above it is no arm's inaccuracy."""
_CURED = 8.0
"""A mistake is named where undoing it brings the median error down by this factor."""
_FEWEST = 8
"""Poses below which no mistake is looked for: base and tool registered fit so few nearly whatever is wrong."""
_STILL = 1e-12
"""m; poses that spread less do not move."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """A mistake that, undone, makes the data fit."""

    name: str
    fix: str
    before: float
    """Median position error as delivered, base and tool registered, m."""
    after: float


def find_mistake(robot: Robot, data: Measurements) -> Mistake | None:
    """The mistake that explains a gross misfit, or None where there is no such misfit or nothing cures it."""
    if data.n < _FEWEST or data.q is None:
        return None
    before, spread = _median_error(robot, data), _spread(data)
    if before <= GROSS * spread:
        return None
    best: Mistake | None = None
    for name, fix, undone in _suspects(robot, data):
        try:
            mended = undone()
            after = _median_error(*mended)
        except (RobaccError, np.linalg.LinAlgError):
            continue
        # Beside the spread: positions made a thousand times smaller have smaller errors, whatever their unit.
        if after * spread * _CURED < before * _spread(mended[1]) and (best is None or after < best.after):
            best = Mistake(name, fix, before, after)
    return best


def refuse_mistake(robot: Robot, data: Measurements) -> None:
    """Stop where the data hold a mistake.

    Raises:
        InputError: naming the mistake and what to do.
    """
    found = find_mistake(robot, data)
    if found is not None:
        file = f"{data.source}: " if data.source else ""
        raise InputError(
            f"{file}{found.name}: as delivered the median error is {found.before * 1e3:.3g} mm with base and tool "
            f"registered, with that undone {found.after * 1e3:.3g} mm; {found.fix}"
        )


def _median_error(robot: Robot, data: Measurements) -> float:
    registered = register_frames(robot, data, True, True)
    return float(np.median(np.linalg.norm(data.position - predict(registered, data).translation, axis=0)))


def _spread(data: Measurements) -> float:
    return max(float(np.sqrt(np.mean(np.var(data.position, axis=1)) * 3)), _STILL)


Undone = Callable[[], tuple[Robot, Measurements]]


def _suspects(robot: Robot, data: Measurements) -> Iterator[tuple[str, str, Undone]]:
    """What may be wrong: the mistake, what to do about it, and the data or robot without it."""
    assert data.q is not None
    yield from _of_joints(robot, data, data.q)
    yield from _of_units(robot, data, data.q)
    yield from _of_axes(robot, data)
    yield from _of_order(robot, data)
    yield from _of_columns(robot, data, data.q)


def _of_joints(robot: Robot, data: Measurements, q: Array) -> Iterator[tuple[str, str, Undone]]:
    """A single joint's sign or unit."""
    for i, joint in enumerate(robot.variables):
        turned = q.copy()
        turned[i] = -turned[i]
        yield (
            f"the sign of joint {joint.name} seems turned round",
            "set sign: -1 for it in the robot file, or turn the column round",
            _with(robot, data, q=turned),
        )
        if joint.type == "revolute":
            scaled = q.copy()
            scaled[i] = np.deg2rad(scaled[i])
            yield (
                f"the column of joint {joint.name} seems to be in degrees",
                "give its unit in the column's name, as in q1_deg",
                _with(robot, data, q=scaled),
            )


def _of_units(robot: Robot, data: Measurements, q: Array) -> Iterator[tuple[str, str, Undone]]:
    """The unit of all joints, or of the positions."""
    revolute = np.array([joint.type == "revolute" for joint in robot.variables])[:, None]
    yield (
        "the joint columns seem to be in degrees",
        "give the unit in their names, as in q1_deg",
        _with(robot, data, q=np.where(revolute, np.deg2rad(q), q)),
    )
    for factor, unit in ((1e-3, "millimetres"), (1e-6, "micrometres")):
        yield (
            f"the positions seem to be in {unit}",
            "give the unit in their names, as in x_mm",
            _with(robot, data, position=data.position * factor),
        )


def _of_axes(robot: Robot, data: Measurements) -> Iterator[tuple[str, str, Undone]]:
    """The axes of the measured positions: a sign turned round, or two columns exchanged.

    Without orientations all of these are the same left-handed frame, turned.
    """
    if data.rotation is None:
        yield (
            "the positions seem to stand in a left-handed frame",
            "look for a column whose sign is turned round, or two that are exchanged",
            _with(robot, data, position=data.position * np.array([[-1.0], [1.0], [1.0]])),
        )
        return
    for i, axis in enumerate("xyz"):
        yield (
            f"the column {axis} seems to have its sign turned round",
            "measure in a right-handed frame, or turn the column round",
            _with(robot, data, position=data.position * np.where(np.arange(3) == i, -1.0, 1.0)[:, None]),
        )
    for first, second in ((0, 1), (0, 2), (1, 2)):
        order = np.arange(3)
        order[[first, second]] = second, first
        yield (
            f"the columns {'xyz'[first]} and {'xyz'[second]} seem exchanged",
            "name them after what they hold",
            _with(robot, data, position=data.position[order]),
        )


def _of_columns(robot: Robot, data: Measurements, q: Array) -> Iterator[tuple[str, str, Undone]]:
    """Two joint columns exchanged."""
    for (i, first), (j, second) in itertools.combinations(enumerate(robot.variables), 2):
        exchanged = q.copy()
        exchanged[[i, j]] = q[[j, i]]
        yield (
            f"the columns of joints {first.name} and {second.name} seem exchanged",
            "name them after what they hold",
            _with(robot, data, q=exchanged),
        )


def _of_order(robot: Robot, data: Measurements) -> Iterator[tuple[str, str, Undone]]:
    """Rows against each other, the motions of a link, the parts of a quaternion."""
    for step in (1, -1):
        yield (
            f"the measured poses seem shifted by one row {'down' if step > 0 else 'up'} against the joints",
            "pair each measured pose with its own joint values",
            functools.partial(_shifted, robot, data, step),
        )
    if robot.convention in ("standard", "modified"):
        other = "modified" if robot.convention == "standard" else "standard"
        yield (
            f"the table seems to be of the {other} Denavit-Hartenberg convention",
            f"set convention: {other}",
            lambda: (dataclasses.replace(robot, convention=other), data),  # type: ignore[arg-type]
        )
    if data.rotation is not None:
        swapped = rotation_from_quaternion(np.roll(quaternion_from_rotation(data.rotation), 1, axis=0))
        yield (
            "the quaternions seem to be in the order x, y, z, w",
            "name the columns after what they hold: qw is the scalar part",
            _with(robot, data, rotation=swapped),
        )


def _with(robot: Robot, data: Measurements, **changes: np.ndarray) -> Undone:
    return lambda: (robot, dataclasses.replace(data, **changes))  # type: ignore[arg-type]


def _shifted(robot: Robot, data: Measurements, step: int) -> tuple[Robot, Measurements]:
    assert data.q is not None
    inside = data.subset(np.arange(1, data.n) if step > 0 else np.arange(data.n - 1))
    moved = data.q[:, :-1] if step > 0 else data.q[:, 1:]
    return robot, dataclasses.replace(inside, q=moved)
