"""What calls take for a file: its path, or what was read from it before; and the record of it for the result."""

from __future__ import annotations

import dataclasses
import os
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robacc.documents.envelope import InputFile
from robacc.errors import InputError, Problem, UsageError
from robacc.measurements import Measurements
from robacc.robots.description import Robot

if TYPE_CHECKING:
    from robacc.accuracy.grade_scale import Scale

StrPath = str | os.PathLike[str]
STDIN = "-"
_FIRST_AXES: dict[str, tuple[int, ...]] = {
    "position": (3,),
    "rotation": (3, 3),
    "commanded_position": (3,),
    "commanded_rotation": (3, 3),
    "sigma_position": (3,),
    **dict.fromkeys(("sigma_rotation", "time", "temperature", "payload"), ()),
}
"""Of each column of numbers, all axes but the last, which is over poses."""
_BY_JOINT = ("q", "direction", "speed")
_TEXTS = ("pose", "cycle", "target")
_TURNED = 1e-3
"""How far a rotation matrix may be from an orthogonal one, as a quaternion in a file may be from unit length."""


def path_of(source: object) -> str | None:
    """The path, where ``source`` is one."""
    return os.fspath(source) if isinstance(source, str | os.PathLike) else None


def robot_of(
    source: StrPath | Robot | None, base_link: str | None = None, tip_link: str | None = None
) -> tuple[Robot | None, tuple[InputFile, ...]]:
    """As :func:`needed_robot_of`, where there is a robot.

    Raises:
        InputError: The file cannot be read or is wrong.
        UsageError: A link is named that there is not.
    """
    if source is None:
        if base_link or tip_link:
            raise UsageError("`base_link` and `tip_link` choose a chain of a URDF, so they need `robot`")
        return None, ()
    robot, record = needed_robot_of(source, base_link, tip_link)
    return robot, (record,)


def needed_robot_of(
    source: StrPath | Robot, base_link: str | None = None, tip_link: str | None = None
) -> tuple[Robot, InputFile]:
    """The robot of a file, or as given, and its record; of one that is no file, of the robot file it would make.

    Raises:
        InputError: The file cannot be read or is wrong.
        UsageError: A link is named that there is not.
    """
    if isinstance(source, Robot):
        if base_link is not None or tip_link is not None:
            raise UsageError("`base_link` and `tip_link` apply when a URDF is read; this robot has been read already")
        from robacc.robots.yaml_writer import robot_to_yaml

        text = robot_to_yaml(in_si(source))
        return source, InputFile(source.name, sha256(text.encode()).hexdigest(), "robot")
    from robacc.io.files import sha256_of
    from robacc.modelling.robot_file import read_robot

    arm = read_robot(source, base_link=base_link, tip_link=tip_link)
    return arm, InputFile.at(os.fspath(source), sha256_of(source), "robot")


def in_si(robot: Robot) -> Robot:
    """The same robot, with its effects in m and rad.

    Raises:
        InputError: Its effects cannot be read.
    """
    if not robot.effects or robot.effect_units == (1.0, 1.0):
        return robot
    from robacc.effects.specification import entry_of, known_effects

    effects = tuple(entry_of(known.effect, known.values) for known in known_effects(robot))
    return dataclasses.replace(robot, effects=effects, effect_units=(1.0, 1.0))


def poses_of(
    source: StrPath | Measurements,
    robot: Robot | None,
    *,
    ordered: bool = False,
    kind: str = "poses",
    attained: bool = True,
) -> tuple[Measurements, InputFile]:
    """The poses of a file, read for ``robot`` where there is one, or as given; and their record.

    Args:
        source: StrPath, ``-`` for standard input, or poses that were read or made before.
        robot: Whose joints, limits and targets hold for them.
        ordered: Rows of the file are in the order measured; poses as given say so themselves.
        kind: What the record calls them.
        attained: Whether the poses were measured; planned ones may lack x, y, z.

    Raises:
        InputError: Everything that is wrong with the file, or with the arrays.
        UsageError: ``ordered`` of poses that have been read.
    """
    if isinstance(source, Measurements):
        if ordered and not source.ordered:
            raise UsageError("`ordered` applies when a file is read; use read_poses(path, ordered=True)")
        data = checked(source, robot)
        if robot is not None and (wrong := _wrong_targets(data, robot)):
            raise InputError(wrong)
        return some_poses(data), record_of(data, kind)
    from robacc.diagnostics.robot_poses import read_robot_poses

    path = os.fspath(source)
    if robot is None:
        from robacc.poses.csv_file import read_poses

        data = read_poses(path, ordered=ordered)
    else:
        data = read_robot_poses(path, robot, ordered=ordered, attained=attained)
    return some_poses(data), InputFile.at(path, data.sha256 or "", kind)


def some_poses(data: Measurements) -> Measurements:
    """The poses, of which there must be one.

    Raises:
        InputError: There is none.
    """
    if data.n:
        return data
    raise InputError(Problem("there are no poses; one row is needed at least below the header", data.source))


def record_of(data: Measurements, kind: str) -> InputFile:
    """Of the file that the poses are from; else of the CSV that they would make."""
    if data.sha256 is not None:
        return InputFile.at(STDIN if data.source in (None, "<stdin>") else str(data.source), data.sha256, kind)
    from robacc.poses.csv_file import format_poses

    return InputFile("arrays", sha256(format_poses(data).encode()).hexdigest(), kind)


def scale_of(path: StrPath | None) -> tuple[Scale | None, tuple[InputFile, ...]]:
    """The grade scale of a file and its record; nothing for the package's own.

    Raises:
        InputError: The file cannot be read or is wrong.
    """
    if path is None:
        return None, ()
    from robacc.accuracy.grade_scale import load_scale
    from robacc.io.files import read_text, sha256_of

    name = os.fspath(path)
    return load_scale(read_text(name), name), (InputFile.at(name, sha256_of(name), "scale"),)


def checked(data: Measurements, robot: Robot | None = None) -> Measurements:
    """Poses that were made of arrays, or of lists, as arrays of floats of the right shape; ids become text.

    Raises:
        InputError: An array is not of its shape, holds a number that is not finite, a rotation is none, or there are
            other joints than the robot has; everything that is wrong.
    """
    columns = {name: getattr(data, name) for name in (*_FIRST_AXES, *_BY_JOINT, *_TEXTS)}
    arrays = {name: np.asarray(value) for name, value in columns.items() if value is not None}
    n = arrays["position"].shape[-1] if arrays["position"].ndim else 0
    problems: list[Problem] = []
    for name, array in arrays.items():
        first = _FIRST_AXES.get(name, () if name in _TEXTS else _joints(array, robot))
        if array.shape != (*first, n):
            expected = ", ".join(map(str, (*first, n)))
            problems.append(_problem(data, name, f"expected an array of shape ({expected}), found {array.shape}"))
        elif name not in _TEXTS:
            problems += _numbers(data, name, array)
    if problems:
        raise InputError(problems)
    changes: dict[str, Any] = {
        name: array.astype(str if name in _TEXTS else float, copy=False) for name, array in arrays.items()
    }
    return dataclasses.replace(data, **changes)


def _joints(array: NDArray[Any], robot: Robot | None) -> tuple[int, ...]:
    """Of an array by joint, the number of joints expected."""
    if robot is not None:
        return (len(robot.variables),)
    return (array.shape[0],) if array.ndim == 2 else (1,)


def _wrong_targets(data: Measurements, robot: Robot) -> Problem | None:
    """What is wrong with the names of targets: each must be the robot's, and of a robot with one tool there is one."""
    names = [] if data.target is None or data.q is None else np.unique(data.target).tolist()
    if robot.targets:
        unknown = [name for name in names if name not in robot.targets]
        told = f"found {unknown[0]!r}, expected a target of the robot ({', '.join(robot.targets)})" if unknown else ""
    else:
        told = f"found several targets ({', '.join(names)}), but the robot has one tool" if len(names) > 1 else ""
    return _problem(data, "target", told) if told else None


def _numbers(data: Measurements, name: str, array: NDArray[Any]) -> list[Problem]:
    if array.dtype.kind not in "fiu":
        return [_problem(data, name, f"expected numbers, found {array.dtype}")]
    if not np.all(np.isfinite(array)):
        pose = int(np.argmin(np.isfinite(array).reshape(-1, array.shape[-1]).all(axis=0)))
        return [_problem(data, name, f"pose {pose + 1} has a value that is not finite")]
    if name.endswith("rotation") and array.ndim == 3:
        product = np.einsum("kin,kjn->ijn", array, array) - np.eye(3)[..., None]
        wrong = (np.abs(product).max(axis=(0, 1)) > _TURNED) | (np.linalg.det(np.moveaxis(array, -1, 0)) < 0)
        if np.any(wrong):
            return [_problem(data, name, f"pose {int(np.argmax(wrong)) + 1} is no rotation matrix")]
    if name.startswith("sigma") and np.any(array <= 0):
        return [_problem(data, name, "expected standard deviations above 0")]
    return []


def _problem(data: Measurements, name: str, message: str) -> Problem:
    return Problem(message, data.source, column=name)
