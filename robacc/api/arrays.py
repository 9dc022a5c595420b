"""Checks of poses that were made of arrays, as the reader of pose files checks columns."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem
from robacc.measurements import Measurements
from robacc.robots.description import Robot

_LEADING_AXES: dict[str, tuple[int, ...]] = {
    "position": (3,),
    "rotation": (3, 3),
    "commanded_position": (3,),
    "commanded_rotation": (3, 3),
    "sigma_position": (3,),
    **dict.fromkeys(("sigma_rotation", "time", "temperature", "payload"), ()),
}
"""Lengths of all axes but the last, which is over poses, for each field of numbers."""
_JOINT_FIELDS = ("q", "direction", "speed")
_TEXT_FIELDS = ("pose", "cycle", "visit", "target")
_ROTATION_TOLERANCE = 1e-3
"""Largest deviation of ``R @ R.T`` from the identity; files allow quaternions the same deviation from unit length."""


def checked_poses(data: Measurements, robot: Robot | None = None) -> Measurements:
    """Return poses made of arrays or lists with every field as a float array of the right shape; ids become text.

    Raises:
        InputError: An array has the wrong shape or a value that is not finite, a matrix is not a rotation, or the
            number of joints is not the robot's; with every problem.
    """
    columns = {name: getattr(data, name) for name in (*_LEADING_AXES, *_JOINT_FIELDS, *_TEXT_FIELDS)}
    arrays = {name: np.asarray(column) for name, column in columns.items() if column is not None}
    n = arrays["position"].shape[-1] if arrays["position"].ndim else 0
    problems: list[Problem] = []
    for name, array in arrays.items():
        leading = _LEADING_AXES.get(name, () if name in _TEXT_FIELDS else _joint_axis(array, robot))
        if array.shape != (*leading, n):
            expected = ", ".join(map(str, (*leading, n)))
            problems.append(_problem(data, name, f"expected an array of shape ({expected}), found {array.shape}"))
        elif name not in _TEXT_FIELDS:
            problems += _number_problems(data, name, array)
    if problems:
        raise InputError(problems)
    changes: dict[str, Any] = {
        name: array.astype(str if name in _TEXT_FIELDS else float, copy=False) for name, array in arrays.items()
    }
    return dataclasses.replace(data, **changes)


def check_targets(data: Measurements, robot: Robot) -> None:
    """Raise InputError unless every target is the robot's; a robot with one tool has one target."""
    names = [] if data.target is None or data.q is None else np.unique(data.target).tolist()
    unknown = [name for name in names if name not in robot.targets]
    if robot.targets and unknown:
        message = f"found {unknown[0]!r}, expected a target of the robot ({', '.join(robot.targets)})"
        raise InputError(_problem(data, "target", message))
    if not robot.targets and len(names) > 1:
        message = f"found several targets ({', '.join(names)}), but the robot has one tool"
        raise InputError(_problem(data, "target", message))


def _joint_axis(array: NDArray[Any], robot: Robot | None) -> tuple[int, ...]:
    """Return the expected number of joints."""
    if robot is not None:
        return (len(robot.variables),)
    return (array.shape[0],) if array.ndim == 2 else (1,)


def _number_problems(data: Measurements, name: str, array: NDArray[Any]) -> list[Problem]:
    if array.dtype.kind not in "fiu":
        return [_problem(data, name, f"expected numbers, found {array.dtype}")]
    if not np.all(np.isfinite(array)):
        pose = int(np.argmin(np.isfinite(array).reshape(-1, array.shape[-1]).all(axis=0)))
        return [_problem(data, name, f"pose {pose + 1} has a value that is not finite")]
    if name.endswith("rotation") and array.ndim == 3:
        deviation = np.abs(np.einsum("kin,kjn->ijn", array, array) - np.eye(3)[..., None]).max(axis=(0, 1))
        invalid = (deviation > _ROTATION_TOLERANCE) | (np.linalg.det(np.moveaxis(array, -1, 0)) < 0)
        if np.any(invalid):
            return [_problem(data, name, f"pose {int(np.argmax(invalid)) + 1} is not a rotation matrix")]
    if name.startswith("sigma") and np.any(array <= 0):
        return [_problem(data, name, "expected standard deviations above 0")]
    return []


def _problem(data: Measurements, name: str, message: str) -> Problem:
    return Problem(message, data.source, column=name)
