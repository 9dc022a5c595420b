"""The poses that were measured on a known robot: by its own names, limits and targets, and held against its size."""

from __future__ import annotations

import os

import numpy as np

from robacc.accuracy.pose_errors import commanded_poses
from robacc.measurements import Measurements
from robacc.poses.csv_file import read_poses
from robacc.poses.plausibility import check_scale
from robacc.robots.description import Robot

_CHECKED = 2000
"""Poses that the spread is judged by; more would not move it."""


def read_robot_poses(
    path: str | os.PathLike[str], robot: Robot, *, ordered: bool = False, attained: bool = True
) -> Measurements:
    """The poses of a CSV file that ``robot`` was commanded to, validated.

    Args:
        path: File to read; ``-`` is standard input.
        robot: Whose joints' names, types and limits, and whose targets, hold for the columns.
        ordered: As in :func:`robacc.poses.csv_file.read_poses`.
        attained: The same.

    Raises:
        InputError: Everything that is wrong with the file; or its positions are in another unit than the robot's
            lengths, which shows in how far they spread.
    """
    data = read_poses(
        path,
        joint_names=robot.variable_names,
        joint_types=[joint.type for joint in robot.variables],
        limits=[joint.limits for joint in robot.variables],
        target_names=tuple(robot.targets),
        ordered=ordered,
        attained=attained,
    )
    if attained and data.q is not None and data.n > 1:
        # Rows at an uneven step: poses that are visited in turn are not all one pose.
        some = data.subset(np.linspace(0, data.n - 1, min(data.n, _CHECKED)).astype(int))
        nominal, _ = commanded_poses(some, robot).block(slice(0, some.n))
        check_scale(some.position, nominal, data.source)
    return data
