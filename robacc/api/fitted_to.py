"""A robot and the poses it was fitted to: the record that a model carries, and the warning where they meet again."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from robacc.documents.envelope import InputFile
from robacc.robots.description import Robot


def fitted_to(robot: Robot, inputs: Sequence[InputFile]) -> Robot:
    """The robot with the poses among ``inputs`` added to those that it was fitted to."""
    digests = (record.sha256 for record in inputs if record.kind == "poses")
    return dataclasses.replace(robot, fitted_to=tuple(dict.fromkeys((*robot.fitted_to, *digests))))


def met_again(robot: Robot | None, inputs: Sequence[InputFile]) -> tuple[str, ...]:
    """A warning for each file of ``inputs`` whose poses the robot was fitted to: no figure of them is of the arm."""
    known = () if robot is None else robot.fitted_to
    return tuple(
        f"{record.name}: the robot file was fitted to these very poses, so their errors say how well the model fits "
        "them; how accurate it is shows on other poses only"
        for record in inputs
        if record.sha256 in known
    )
