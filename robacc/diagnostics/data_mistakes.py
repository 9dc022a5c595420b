"""Mistakes in the data or the robot file, detected before any effect is fitted."""

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
"""Median error, as a share of the standard deviation of the positions, above which it is no inaccuracy of an arm."""
_IMPROVEMENT = 8.0
"""Factor by which a correction has to reduce the median error for its mistake to be reported."""
_LEAST_POSES = 8
"""Poses that the check needs at least: registration of base and tool fits fewer poses in spite of a mistake."""
_LEAST_SPREAD = 1e-12
"""m; least standard deviation of the positions."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """A mistake in the data or the robot file, and the error with and without it."""

    name: str
    fix: str
    before: float
    """Median position error of the registered nominal model, m."""
    after: float
    """The same with the mistake corrected, m."""


def find_mistake(robot: Robot, data: Measurements) -> Mistake | None:
    """Return the mistake that explains a gross misfit, or None if there is none."""
    if data.n < _LEAST_POSES or data.q is None:
        return None
    before, position_std = _median_error(robot, data), _position_std(data)
    if before <= GROSS * position_std:
        return None
    best: Mistake | None = None
    for name, fix, correct in _hypotheses(robot, data):
        try:
            corrected = correct()
            after = _median_error(*corrected)
        except (RobaccError, np.linalg.LinAlgError):
            continue
        # Relative to the positions' own scatter, since a change of their unit scales the error too.
        if after * position_std * _IMPROVEMENT < before * _position_std(corrected[1]) and (
            best is None or after < best.after
        ):
            best = Mistake(name, fix, before, after)
    return best


def refuse_mistake(robot: Robot, data: Measurements) -> None:
    """Raise an error if the data contain a mistake.

    Raises:
        InputError: the mistake, its errors and the fix.
    """
    mistake = find_mistake(robot, data)
    if mistake is not None:
        file = f"{data.source}: " if data.source else ""
        raise InputError(
            f"{file}{mistake.name}: with base and tool registered, the median error is {mistake.before * 1e3:.3g} mm, "
            f"and {mistake.after * 1e3:.3g} mm after this correction; {mistake.fix}"
        )


def _median_error(robot: Robot, data: Measurements) -> float:
    registered = register_frames(robot, data, True, True)
    return float(np.median(np.linalg.norm(data.position - predict(registered, data).translation, axis=0)))


def _position_std(data: Measurements) -> float:
    return max(float(np.sqrt(np.mean(np.var(data.position, axis=1)) * 3)), _LEAST_SPREAD)


Correction = Callable[[], tuple[Robot, Measurements]]


def _hypotheses(robot: Robot, data: Measurements) -> Iterator[tuple[str, str, Correction]]:
    """Yield possible mistakes: the text, the fix, and a function that corrects robot and data."""
    assert data.q is not None
    yield from _joint_hypotheses(robot, data, data.q)
    yield from _unit_hypotheses(robot, data, data.q)
    yield from _axis_hypotheses(robot, data)
    yield from _order_hypotheses(robot, data)
    yield from _column_hypotheses(robot, data, data.q)


def _joint_hypotheses(robot: Robot, data: Measurements, q: Array) -> Iterator[tuple[str, str, Correction]]:
    """Yield a wrong sign or unit of a single joint."""
    for i, joint in enumerate(robot.variables):
        turned = q.copy()
        turned[i] = -turned[i]
        yield (
            f"the sign of joint {joint.name} seems to be reversed",
            "set sign: -1 for the joint in the robot file, or reverse the sign of its column",
            _corrected(robot, data, q=turned),
        )
        if joint.type == "revolute":
            scaled = q.copy()
            scaled[i] = np.deg2rad(scaled[i])
            yield (
                f"the column of joint {joint.name} seems to be in degrees",
                "give its unit in the column's name, as in q1_deg",
                _corrected(robot, data, q=scaled),
            )


def _unit_hypotheses(robot: Robot, data: Measurements, q: Array) -> Iterator[tuple[str, str, Correction]]:
    """Yield a wrong unit of all joints, or of the positions."""
    revolute = np.array([joint.type == "revolute" for joint in robot.variables])[:, None]
    yield (
        "the joint columns seem to be in degrees",
        "give the unit in their names, as in q1_deg",
        _corrected(robot, data, q=np.where(revolute, np.deg2rad(q), q)),
    )
    for factor, unit in ((1e-3, "millimetres"), (1e-6, "micrometres")):
        yield (
            f"the positions seem to be in {unit}",
            "give the unit in their names, as in x_mm",
            _corrected(robot, data, position=data.position * factor),
        )


def _axis_hypotheses(robot: Robot, data: Measurements) -> Iterator[tuple[str, str, Correction]]:
    """Yield a wrong axis of the measured positions: a reversed sign, or two exchanged columns.

    Without orientations all of these are equivalent: the frame is left-handed.
    """
    if data.rotation is None:
        yield (
            "the positions seem to be in a left-handed frame",
            "look for a column with a reversed sign, or for two exchanged columns",
            _corrected(robot, data, position=data.position * np.array([[-1.0], [1.0], [1.0]])),
        )
        return
    for i, axis in enumerate("xyz"):
        yield (
            f"the column {axis} seems to have a reversed sign",
            "measure in a right-handed frame, or reverse the sign of the column",
            _corrected(robot, data, position=data.position * np.where(np.arange(3) == i, -1.0, 1.0)[:, None]),
        )
    for first, second in ((0, 1), (0, 2), (1, 2)):
        order = np.arange(3)
        order[[first, second]] = second, first
        yield (
            f"the columns {'xyz'[first]} and {'xyz'[second]} seem to be exchanged",
            "correct the names of the columns",
            _corrected(robot, data, position=data.position[order]),
        )


def _column_hypotheses(robot: Robot, data: Measurements, q: Array) -> Iterator[tuple[str, str, Correction]]:
    """Yield two exchanged joint columns."""
    for (i, first), (j, second) in itertools.combinations(enumerate(robot.variables), 2):
        exchanged = q.copy()
        exchanged[[i, j]] = q[[j, i]]
        yield (
            f"the columns of joints {first.name} and {second.name} seem to be exchanged",
            "correct the names of the columns",
            _corrected(robot, data, q=exchanged),
        )


def _order_hypotheses(robot: Robot, data: Measurements) -> Iterator[tuple[str, str, Correction]]:
    """Yield a wrong order of rows, of the motions of a link, or of the parts of a quaternion."""
    for step in (1, -1):
        yield (
            f"the measured poses seem to be shifted by one row {'down' if step > 0 else 'up'} against the joints",
            "pair each measured pose with its own joint values",
            functools.partial(_shifted, robot, data, step),
        )
    if robot.convention in ("standard", "modified"):
        other_convention = "modified" if robot.convention == "standard" else "standard"
        yield (
            f"the table seems to be of the {other_convention} Denavit-Hartenberg convention",
            f"set convention: {other_convention}",
            lambda: (dataclasses.replace(robot, convention=other_convention), data),  # type: ignore[arg-type]
        )
    if data.rotation is not None:
        swapped = rotation_from_quaternion(np.roll(quaternion_from_rotation(data.rotation), 1, axis=0))
        yield (
            "the quaternions seem to be in the order x, y, z, w",
            "correct the names of the columns: qw is the scalar part",
            _corrected(robot, data, rotation=swapped),
        )


def _corrected(robot: Robot, data: Measurements, **changes: np.ndarray) -> Correction:
    return lambda: (robot, dataclasses.replace(data, **changes))  # type: ignore[arg-type]


def _shifted(robot: Robot, data: Measurements, step: int) -> tuple[Robot, Measurements]:
    assert data.q is not None
    inside = data.subset(np.arange(1, data.n) if step > 0 else np.arange(data.n - 1))
    moved = data.q[:, :-1] if step > 0 else data.q[:, 1:]
    return robot, dataclasses.replace(inside, q=moved)
