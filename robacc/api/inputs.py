"""Inputs of calls: a file by its path, or an object read before; with the record of each for the result."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping, Sequence
from hashlib import sha256
from typing import TYPE_CHECKING, Any

from robacc.api.arrays import check_targets, checked_poses
from robacc.api.result import Result
from robacc.documents.envelope import InputFile
from robacc.documents.read_result import StoredResult, read_result
from robacc.errors import InputError, Problem, UsageError
from robacc.measurements import Measurements
from robacc.poses.reading import PoseFile, SupportsColumns
from robacc.robots.description import Robot

if TYPE_CHECKING:
    from robacc.accuracy.grade_scale import Scale

StrPath = str | os.PathLike[str]
PosesSource = StrPath | Measurements | SupportsColumns | Mapping[str, Any]
"""Poses: a file, poses read before, or a data frame (pandas, Polars, Arrow, or arrays by the names of columns)."""
STDIN = "-"


def path_of(source: object) -> str | None:
    """Return ``source`` as text if it is a path, else None."""
    return os.fspath(source) if isinstance(source, str | os.PathLike) else None


def pose_path(source: StrPath | SupportsColumns | Mapping[str, Any]) -> str:
    """Return the path of a pose file, or of a data frame a path that carries it."""
    return os.fspath(source) if isinstance(source, str | os.PathLike) else PoseFile(source)


def load_robot(
    source: StrPath | Robot, base_link: str | None = None, tip_link: str | None = None, poses: PosesSource | None = None
) -> tuple[Robot, InputFile]:
    """Return the robot and its record; a robot without a file is recorded as the robot file it would make.

    The joint columns of ``poses``, a path or poses read before, choose the chain of a URDF without a ``tip_link``.

    Raises:
        InputError: The file cannot be read or is wrong.
        UsageError: A link does not exist, or is given with a robot that was read before.
    """
    if isinstance(source, Robot):
        if base_link is not None or tip_link is not None:
            raise UsageError("`base_link` and `tip_link` apply when a URDF is read; this robot has been read already")
        from robacc.effects.entry_units import with_effect_units
        from robacc.robots.yaml_writer import robot_to_yaml

        text = robot_to_yaml(with_effect_units(source))
        return source, InputFile(source.name, sha256(text.encode()).hexdigest(), "robot", identity=source.identity)
    from robacc.io.files import sha256_of
    from robacc.modelling.robot_file import read_robot, robot_path

    robot = read_robot(source, base_link=base_link, tip_link=tip_link, joint_columns=lambda: _joint_columns(poses))
    return robot, InputFile.at(os.fspath(source), sha256_of(robot_path(source)), "robot", robot.identity)


def _joint_columns(poses: PosesSource | None) -> Sequence[str]:
    """Return the names of a pose file's columns, or q1 … qN of poses read before; nothing for a pipe or a bad file."""
    if isinstance(poses, Measurements):
        return [] if poses.q is None else [f"q{i + 1}" for i in range(poses.q.shape[0])]
    if poses is None:
        return []
    path = pose_path(poses)
    if not (os.path.isfile(path) or os.path.isdir(path) or (isinstance(path, PoseFile) and path.frame is not None)):
        return []
    from robacc.io.open_table import open_table
    from robacc.poses.reading import table_options

    try:
        with open_table(path, table_options(path)) as table:
            return table.header().names
    except (InputError, UsageError):
        # The reader of the poses reports what is wrong with the file.
        return []


def load_optional_robot(
    source: StrPath | Robot | None,
    base_link: str | None = None,
    tip_link: str | None = None,
    poses: PosesSource | None = None,
) -> tuple[Robot | None, tuple[InputFile, ...]]:
    """Return :func:`load_robot` of ``source``, or no robot and no record if ``source`` is None.

    Raises:
        InputError: The file cannot be read or is wrong.
        UsageError: A link does not exist, or is given without a robot.
    """
    if source is None:
        if base_link or tip_link:
            raise UsageError("`base_link` and `tip_link` choose a chain of a URDF, so they need `robot`")
        return None, ()
    robot, record = load_robot(source, base_link, tip_link, poses)
    return robot, (record,)


def load_poses(
    source: PosesSource,
    robot: Robot | None,
    *,
    ordered: bool = False,
    ignore_limits: bool = False,
    kind: str = "poses",
    attained: bool = True,
    any_target: bool = False,
) -> tuple[Measurements, InputFile]:
    """Return poses, checked against ``robot`` if there is one, and their record.

    Args:
        source: Path, ``-`` for standard input, a data frame, or poses that were read or made before.
        robot: Robot whose joints, limits and targets apply to the poses.
        ordered: The rows of the file are in the order measured; poses read before carry this themselves.
        ignore_limits: Joints of the file outside their limits are a warning, not an error.
        kind: Kind of the input in the record.
        attained: The poses were measured; planned poses may lack x, y, z.
        any_target: Several targets are valid although the robot has one tool.

    Raises:
        InputError: The file or the arrays are wrong; with every problem.
        UsageError: ``ordered`` is given with poses that were read before.
    """
    if isinstance(source, Measurements):
        if ordered and not source.ordered:
            raise UsageError("`ordered` applies when a file is read; use read_poses(path, ordered=True)")
        data = checked_poses(source, robot)
        if robot is not None and (robot.targets or not any_target):
            check_targets(data, robot)
        return require_poses(data), record_of(data, kind)
    from robacc.diagnostics.robot_poses import read_robot_poses

    path = pose_path(source)
    if isinstance(path, PoseFile) and path.reading.commanded is not None and attained:
        from robacc.api.commanded import read_with_commands

        data, commands = read_with_commands(
            path, path.reading.commanded, robot, ordered=ordered, ignore_limits=ignore_limits
        )
        record = InputFile.at(path, data.sha256 or "", kind)
        stated = {**(record.reading or {}), "commanded": commands.name, "commanded_sha256": commands.sha256}
        return require_poses(data), dataclasses.replace(record, reading=stated)
    try:
        if robot is None:
            from robacc.poses.csv_file import read_poses

            data = read_poses(path, ordered=ordered)
        else:
            data = read_robot_poses(
                path, robot, ordered=ordered, ignore_limits=ignore_limits, attained=attained, any_target=any_target
            )
    except InputError:
        from robacc.programs.reading import mistaken_for_poses

        if attained and (problem := mistaken_for_poses(path)) is not None:
            raise InputError(problem) from None
        raise
    return require_poses(data), InputFile.at(path, data.sha256 or "", kind)


def require_poses(data: Measurements) -> Measurements:
    """Return the poses.

    Raises:
        InputError: There are none.
    """
    if data.n:
        return data
    raise InputError(Problem("there are no poses; one row is needed at least below the header", data.source))


def record_of(data: Measurements, kind: str) -> InputFile:
    """Return the record of the file that the poses come from, else of the CSV that they would make."""
    if data.sha256 is not None:
        return InputFile.at(STDIN if data.source in (None, "<stdin>") else str(data.source), data.sha256, kind)
    from robacc.poses.csv_text import format_poses

    return InputFile("arrays", sha256(format_poses(data).encode()).hexdigest(), kind)


def load_grade_scale(path: StrPath | None) -> tuple[Scale | None, tuple[InputFile, ...]]:
    """Return the grade scale of a file and its record; None without a path, for the package's own scale.

    Raises:
        InputError: The file cannot be read or is wrong.
    """
    if path is None:
        return None, ()
    from robacc.accuracy.grade_scale import load_scale
    from robacc.io.files import read_text, sha256_of

    name = os.fspath(path)
    return load_scale(read_text(name), name), (InputFile.at(name, sha256_of(name), "scale"),)


def load_result(source: StrPath | Result | StoredResult) -> StoredResult:
    """Return a stored result; one just computed becomes what its file would be, named by its command.

    Raises:
        InputError: The file cannot be read or holds no result.
    """
    if isinstance(source, StoredResult):
        return source
    if isinstance(source, Result):
        text = source.to_json()
        return StoredResult(json.loads(text), source.command, sha256(text.encode()).hexdigest(), source.command)
    return read_result(os.fspath(source))


def with_fitted_poses(robot: Robot, inputs: Sequence[InputFile]) -> Robot:
    """Return the robot with the poses among ``inputs`` recorded as poses that it was fitted to."""
    digests = (record.sha256 for record in inputs if record.kind == "poses")
    return dataclasses.replace(robot, fitted_to=tuple(dict.fromkeys((*robot.fitted_to, *digests))))


def fitted_pose_warnings(robot: Robot | None, inputs: Sequence[InputFile]) -> tuple[str, ...]:
    """Return a warning for each file of ``inputs`` whose poses the robot was fitted to."""
    digests = () if robot is None else robot.fitted_to
    return tuple(
        f"{record.name}: the robot file was fitted to these same poses, so the errors show how well the model fits "
        "them; measure other poses to show how accurate the model is"
        for record in inputs
        if record.sha256 in digests
    )
