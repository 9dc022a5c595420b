"""Targets that the poses name and the robot lacks."""

from __future__ import annotations

from dataclasses import replace

from robacc.measurements import Measurements
from robacc.robots.description import Frame, Robot


def with_measured_targets(robot: Robot, data: Measurements) -> tuple[Robot, Measurements]:
    """Return the robot with the targets that the poses name, if it has none and they name several; and the poses.

    Each starts at the tool. The poses carry a warning.
    """
    names = [] if robot.targets or data.target is None else list(dict.fromkeys(data.target.tolist()))
    if len(names) < 2:
        return robot, data
    text = (
        f"targets {', '.join(names)} are not in the robot file: each starts at its tool, and tool_frame fits its place"
    )
    warned = replace(data, warnings=(*data.warnings, text))
    return replace(robot, tool=Frame(), targets=dict.fromkeys(names, robot.tool)), warned
