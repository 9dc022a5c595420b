"""Commands of measured poses from another file: a robot program, or a table of joints or commanded poses."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.api.arrays import check_targets
from robacc.documents.envelope import InputFile
from robacc.errors import InputError, Problem
from robacc.geometry import Array, rotation_from_quaternion
from robacc.measurements import Measurements, commanded_groups
from robacc.poses.motion import motion_between_visits, visits_in_order
from robacc.poses.reading import PoseFile, Reading, reading_of
from robacc.robots.description import Robot

_SHOWN = 6
"""Names that a message lists."""


def read_with_commands(
    path: str, commands: str, robot: Robot | None, *, ordered: bool, ignore_limits: bool
) -> tuple[Measurements, InputFile]:
    """Return measured poses with the commands of another file, and the record of that file.

    Rows are joined by the names of their poses; without names in one of the files, by their order.

    Raises:
        InputError: A file is wrong, has no commands, or does not fit the other.
    """
    from robacc.poses.csv_file import read_poses
    from robacc.poses.known_robot import UNKNOWN_ROBOT, KnownRobot

    planned = _program(commands) if _is_program(commands) else _table(commands, reading_of(path), robot, ignore_limits)

    def known_orientations(names: NDArray[Any] | None, count: int) -> Array | None:
        try:
            rows, _ = _joined(names, count, planned, commands, path)
        except InputError:
            return None  # raised below, after the questions of the file of measured poses
        orientations = _orientations(planned, robot)
        return None if orientations is None else orientations[..., rows]

    known = UNKNOWN_ROBOT if robot is None else KnownRobot(target_names=tuple(robot.targets))
    measured = read_poses(path, robot=known, commands=False, known_orientations=known_orientations)
    if measured.commands is not None:
        message = "the measured poses have commands of their own"
        raise InputError(Problem(message, measured.source, fix="leave out `commanded`, or those columns"))
    if robot is not None:
        check_targets(measured, robot)
    rows, remark = _joined(measured.pose, measured.n, planned, commands, measured.source)
    data = _with_rows(measured, planned, rows, ordered)
    if robot is not None:
        from robacc.diagnostics.robot_poses import check_size

        data = dataclasses.replace(data, warnings=(*data.warnings, *check_size(data, robot)))
    warnings = (*data.warnings, *planned.warnings, f"{measured.source}: {remark}")
    return dataclasses.replace(data, warnings=warnings), InputFile.at(commands, planned.sha256 or "", "commanded")


def _is_program(path: str) -> bool:
    from robacc.programs.reading import is_program

    return is_program(path)


def _table(path: str, reading: Reading, robot: Robot | None, ignore_limits: bool) -> Measurements:
    """Return a table of commands; the units and angles stated for the measured poses hold for its names too."""
    from robacc.diagnostics.robot_poses import read_robot_poses
    from robacc.poses.csv_file import read_poses

    path = PoseFile(path, units=reading.units, angles=reading.angles)
    if robot is None:
        return read_poses(path, attained=False)
    return read_robot_poses(path, robot, ignore_limits=ignore_limits, attained=False)


def _program(path: str) -> Measurements:
    """Return the targets of a robot program in the order of its motions."""
    from robacc.io.files import sha256_of
    from robacc.programs.reading import read_program

    program = read_program(path)
    targets = [program.targets[move.target] for move in program.moves] or list(program.targets)
    kinds = {target.kind for target in targets}
    if len(kinds) != 1:
        message = "the program has no targets in numbers" if not kinds else "the program mixes joints and poses"
        raise InputError(Problem(message, path, fix="list the commanded joints or poses in a CSV"))
    names = np.array([target.name for target in targets])
    values = np.array([target.values for target in targets]).T
    none = np.zeros((3, names.size))
    digest = sha256_of(path)
    if kinds == {"joint"}:
        return Measurements(none, q=values, pose=names, source=path, sha256=digest)
    based = sorted({target.base.name for target in targets if target.base is not None and target.base.name})
    warning = f"{path}: commanded poses are in the program's base frame{' ' + ', '.join(based) if based else ''}"
    return Measurements(
        none,
        commanded_position=values[:3],
        commanded_rotation=rotation_from_quaternion(values[3:]),
        pose=names,
        source=path,
        sha256=digest,
        warnings=(warning,),
    )


def _orientations(planned: Measurements, robot: Robot | None) -> Array | None:
    """Return the commanded orientations ``(3, 3, N)``; None where the commands have none."""
    if planned.q is None or robot is None:
        return planned.commanded_rotation
    from robacc.robots.assembly import build_chain

    rotation: Array = build_chain(dataclasses.replace(robot, effects=())).forward(planned.q).rotation
    return rotation


def _joined(
    names: NDArray[Any] | None, count: int, planned: Measurements, path: str, source: str | None
) -> tuple[NDArray[np.int64], str]:
    """Return the row of ``planned`` for each measured row, and how the rows were joined.

    Args:
        names: Names of the measured poses, if there are any.
        count: Number of measured rows.
        planned: Commands.
        path: Their file.
        source: File of the measured poses.

    Raises:
        InputError: A name is missing or has two commands, or the numbers of rows differ.
    """
    if names is not None and planned.pose is not None:
        rows = {str(name).casefold(): i for i, name in reversed(list(enumerate(planned.pose)))}
        missing = [str(name) for name in dict.fromkeys(names.tolist()) if str(name).casefold() not in rows]
        if not missing:
            _check_unique(planned, path)
            index = np.array([rows[str(name).casefold()] for name in names], dtype=np.int64)
            return index, f"commands of {path} joined by the names of the poses"
        if len(missing) < len(set(names.tolist())) or count != planned.n:
            listed = ", ".join(missing[:_SHOWN]) + (" …" if len(missing) > _SHOWN else "")
            message = f"{len(missing)} of the measured poses have no command in {path}: {listed}"
            raise InputError(Problem(message, source, column="pose", fix="give the poses the same names"))
    if count != planned.n:
        message = f"found {count} measured rows and {planned.n} commands in {path}, which share no names"
        raise InputError(Problem(message, source, fix="name the poses in both files, in a column pose"))
    return np.arange(count), f"commands of {path} joined by the order of rows: the files share no names"


def _check_unique(planned: Measurements, path: str) -> None:
    grouping = commanded_groups(planned.pose, planned.commands)
    if grouping is not None and grouping.contradicted is not None and planned.pose is not None:
        name = planned.pose[np.argmax(grouping.contradicted)]
        raise InputError(Problem(f"pose {name} has two different commands", path, fix="give each pose its own name"))


def _with_rows(measured: Measurements, planned: Measurements, rows: NDArray[np.int64], ordered: bool) -> Measurements:
    def at(values: NDArray[Any] | None) -> NDArray[Any] | None:
        return None if values is None else values[..., rows]

    data = dataclasses.replace(
        measured,
        q=at(planned.q),
        commanded_position=at(planned.commanded_position),
        commanded_rotation=at(planned.commanded_rotation),
        pose=measured.pose if measured.pose is not None else at(planned.pose),
        direction=at(planned.direction),
        speed=at(planned.speed),
        branches=at(planned.branches),
        branch_names=planned.branch_names,
        ordered=ordered,
    )
    if not ordered or data.q is None or data.direction is not None:
        return data
    visits = visits_in_order(data.groups(), data.visit, data.cycle, data.target)
    motion: tuple[Array, Array] = motion_between_visits(data.q, visits)
    return dataclasses.replace(data, direction=motion[0], speed=motion[1])
