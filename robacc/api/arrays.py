"""Checks of poses that were made of arrays, as the reader of pose files checks columns."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem
from robacc.measurements import Measurements
from robacc.poses.plausibility import degrees_likely, doubtful_sigma, lengths_too_large
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
_JOINT_FIELDS = ("q", "direction", "speed", "read_back", "branches")
_TEXT_FIELDS = ("pose", "cycle", "visit", "target", "payload_group")
_ROTATION_TOLERANCE = 1e-3
"""Largest deviation of ``R @ R.T`` from the identity; files allow quaternions the same deviation from unit length."""


def checked_poses(data: Measurements, robot: Robot | None = None, *, check_units: bool = True) -> Measurements:
    """Return poses made of arrays or lists with every field as a float array of the right shape; ids become text.

    Args:
        data: The arrays.
        robot: Robot whose joints they are.
        check_units: Raise an error for values that cannot be in m and rad.

    Raises:
        InputError: An array has the wrong shape or a value that is not finite, a matrix is not a rotation, or the
            number of joints is not the robot's; with every problem.
    """
    columns = {name: getattr(data, name) for name in (*_LEADING_AXES, *_JOINT_FIELDS, *_TEXT_FIELDS)}
    arrays = {name: np.asarray(column) for name, column in columns.items() if column is not None}
    n = _pose_count(arrays["position"])
    problems: list[Problem] = []
    for name, array in arrays.items():
        leading = _LEADING_AXES.get(name, () if name in _TEXT_FIELDS else _joint_axis(name, array, robot))
        if array.shape != (*leading, n):
            expected = ", ".join(map(str, (*leading, n)))
            message = f"expected an array of shape ({expected}), found {array.shape}"
            problems.append(_problem(data, name, message, _transposed(name, array, (n, *leading))))
        elif name not in _TEXT_FIELDS:
            problems += _number_problems(data, name, array)
    if check_units and not problems and data.source is None:  # columns of a file were checked with their units
        problems = _unit_problems(data, arrays, robot)
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
        fix = (
            "fit tool_frame, which finds their places, list them under targets: in the robot file instead of tool, or "
            "keep the rows of one target"
        )
        raise InputError(_problem(data, "target", message, fix))


def _joint_axis(name: str, array: NDArray[Any], robot: Robot | None) -> tuple[int, ...]:
    """Return the expected number of joints."""
    if robot is not None and name == "branches":
        return (len(robot.branch_variables),)
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


def _pose_count(position: NDArray[Any]) -> int:
    """Return the number of poses, also of an array whose poses come first."""
    if position.ndim == 2 and position.shape[1] == 3 != position.shape[0]:
        return int(position.shape[0])
    return int(position.shape[-1]) if position.ndim else 0


def _transposed(name: str, array: NDArray[Any], shape: tuple[int, ...]) -> str | None:
    """Return the advice for an array whose poses come first, where its shape is ``shape``."""
    if array.shape != shape or array.ndim < 2:
        return None
    call = f"{name}.T" if array.ndim == 2 else f"numpy.moveaxis({name}, 0, -1)"
    return f"components come first and poses last, so give {call}"


def _unit_problems(data: Measurements, arrays: dict[str, NDArray[Any]], robot: Robot | None) -> list[Problem]:
    """Return a problem for each array that is in mm or degrees, as far as its values show it."""
    problems = []
    if not arrays["position"].size:
        return []
    for name in ("position", "commanded_position"):
        if name in arrays and lengths_too_large(arrays[name]):
            largest = f"{np.max(np.abs(arrays[name])):.4g}"
            problems.append(_problem(data, name, f"found positions up to {largest}, which cannot be m", "give metres"))
    joints = () if robot is None else robot.variables
    for i, q in enumerate(arrays.get("q", ())):
        revolute = i >= len(joints) or joints[i].type == "revolute"
        if revolute and robot is not None and degrees_likely(q, joints[i].limits):
            largest = f"{np.max(np.abs(arrays['q'])):.4g}"
            message = f"found joint angles up to {largest}, which cannot be rad"
            problems.append(_problem(data, "q", message, "give radians: numpy.radians(q)"))
            break
    for name, kind in (("sigma_position", "length"), ("sigma_rotation", "angle")):
        if name in arrays and doubtful_sigma(arrays[name], kind)[0]:
            typical = f"{np.median(arrays[name]):.3g} {'m' if kind == 'length' else 'rad'}"
            problems.append(_problem(data, name, f"found a typical uncertainty of {typical}, which no instrument has"))
    return problems


def _problem(data: Measurements, name: str, message: str, fix: str | None = None) -> Problem:
    return Problem(message, data.source, column=name, fix=fix)
