"""Robots, poses and results from their files and to them."""

from __future__ import annotations

import os

from robacc.api.inputs import StrPath, checked, in_si, poses_of
from robacc.documents.read_result import StoredResult
from robacc.measurements import Measurements
from robacc.modelling.robot_file import read_robot
from robacc.robots.description import Robot

__all__ = ["read_poses", "read_result", "read_robot", "write_poses", "write_robot"]


def read_poses(path: StrPath, *, robot: Robot | None = None, ordered: bool = False) -> Measurements:
    """The measured poses of a CSV file, validated.

    Args:
        path: File to read; ``-`` is standard input.
        robot: Whose joints' names, types and limits, and whose targets, hold for the columns; None: no robot is known.
        ordered: Rows are in the order measured, and the robot went straight from each to the next: direction and
            speed are derived from it.

    Returns:
        Arrays in SI units, components first and poses last: ``position`` is ``(3, N)``, ``q`` is ``(J, N)``.

    Raises:
        InputError: Everything that is wrong with the file, with line and column.

    Example:
        >>> import robacc
        >>> data = robacc.read_poses("sample_data/poses.csv", robot=robacc.read_robot("sample_data/robot.yaml"))
        >>> data.n, data.position.shape
        (60, (3, 60))
    """
    return poses_of(os.fspath(path), robot, ordered=ordered)[0]


def write_poses(path: StrPath, data: Measurements) -> None:
    """Write poses to a CSV file that :func:`read_poses` reads back, every number in full.

    Raises:
        InputError: An array is not what it should be, or the file cannot be written.
    """
    from robacc.io.files import write_pieces
    from robacc.poses.csv_file import pose_pieces

    write_pieces(path, pose_pieces(checked(data)))


def write_robot(path: StrPath, robot: Robot) -> None:
    """Write a robot to a robot file (YAML, m and rad) that :func:`read_robot` reads back, every number in full.

    Raises:
        InputError: The robot's effects cannot be read, or the file cannot be written.
    """
    from robacc.io.files import write_text
    from robacc.robots.yaml_writer import robot_to_yaml

    write_text(path, robot_to_yaml(in_si(robot)))


def read_result(path: StrPath) -> StoredResult:
    """A result that was stored as JSON, by a command or by :meth:`~robacc.api.result.Result.save`.

    Returns:
        ``document``, the JSON document, and which ``command`` made it.

    Raises:
        InputError: The file cannot be read, or holds no result of this version of the schema.
    """
    from robacc.documents.read_result import read_result as read

    return read(os.fspath(path))
