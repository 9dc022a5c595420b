"""The robot of a result in titles."""

from __future__ import annotations

from robacc.render.plots.chart import Document


def robot_name(document: Document) -> str | None:
    """Return the robot's name from its file, None without a robot."""
    robot = document.get("robot")
    return None if robot is None else str(robot["name"])


def of_robot(document: Document) -> str:
    """Return ``of`` and the robot's name, to follow a title; empty without a robot."""
    name = robot_name(document)
    return "" if name is None else f" of {name}"
