"""Read and write robots, poses and results."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Annotated, Any

from robacc.api.inputs import checked_poses, load_poses, load_robot, stated
from robacc.api.parameters import (
    Angles,
    Bag,
    Columns,
    Commanded,
    Coverage,
    Help,
    IgnoreLimits,
    Ordered,
    Sheet,
    SkipGaps,
    StrPath,
    Units,
    call,
)
from robacc.documents.envelope import StoredResult
from robacc.measurements import Measurements
from robacc.modelling.robot_file import read_robot
from robacc.poses.reading import PoseFile, SupportsColumns
from robacc.robots.description import Robot

__all__ = ["PoseFile", "read_poses", "read_result", "read_robot", "write_poses", "write_robot"]


@call
def read_poses(
    path: Annotated[
        StrPath | SupportsColumns | Mapping[str, Any],
        Help(
            "File to read, ``-`` for standard input, or a data frame: pandas, Polars, Arrow, or arrays by the names of "
            "columns."
        ),
    ],
    *,
    robot: Annotated[
        StrPath | Robot | None,
        Help("Robot or its file; its joints, limits and targets apply to the columns. None for no robot."),
    ] = None,
    ordered: Ordered = False,
    ignore_limits: IgnoreLimits = False,
    angles: Angles = None,
    units: Units = None,
    columns: Columns = None,
    skip_gaps: SkipGaps = False,
    coverage: Coverage = None,
    sheet: Sheet = None,
    commanded: Commanded = None,
    bag: Bag = None,
) -> Measurements:
    """Read and check the measured poses of a file or a data frame.

    Returns:
        Arrays in SI units, components first and poses last: ``position`` is ``(3, N)``, ``q`` is ``(J, N)``.

    Raises:
        InputError: The file is wrong; with every problem, its line and column.

    Example:
        >>> import robacc
        >>> data = robacc.read_poses("sample_data/poses.csv", robot="sample_data/robot.yaml")
        >>> data.n, data.position.shape
        (60, (3, 60))
    """
    poses = stated(
        path, angles=angles, units=units, columns=columns, skip_gaps=skip_gaps, coverage=coverage, sheet=sheet,
        commanded=commanded, bag=bag,
    )  # fmt: skip
    known = None if robot is None else load_robot(robot, poses=poses)[0]
    return load_poses(poses, known, ordered=ordered, ignore_limits=ignore_limits)[0]


def write_poses(path: StrPath, data: Measurements) -> None:
    """Write poses to a CSV file that :func:`read_poses` reads back to the same numbers.

    Raises:
        InputError: An array is wrong, or the file cannot be written.
    """
    from robacc.io.files import write_pieces
    from robacc.poses.csv_file import pose_pieces

    write_pieces(path, pose_pieces(checked_poses(data, check_units=False)))


def write_robot(path: StrPath, robot: Robot) -> None:
    """Write a robot to a robot file (YAML, m and rad) that :func:`read_robot` reads back to the same numbers.

    Raises:
        InputError: The robot's effects cannot be read, or the file cannot be written.
    """
    from robacc.effects.specification import with_effect_units
    from robacc.io.files import write_text
    from robacc.robots.yaml_robot import robot_to_yaml

    write_text(path, robot_to_yaml(with_effect_units(robot)))


def read_result(path: StrPath) -> StoredResult:
    """Read a result that a command or :meth:`~robacc.api.result.Result.save` stored as JSON.

    Returns:
        ``document``, the JSON document, and ``command``, the name of its command.

    Raises:
        InputError: The file cannot be read, or is not a result with this version of the schema.
    """
    from robacc.documents.envelope import read_result as read

    return read(os.fspath(path))
