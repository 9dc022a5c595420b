"""The error at each measured pose: equations (3)-(5) of Wu and Lee.

Source: C. H. Wu and C. C. Lee, "Estimation of the Accuracy of a Robot Manipulator" (IEEE TAC, 1985). Their attained
pose is T + dT = T (I + δT) with δT built of the translation d and the rotation δ in the target's frame, to first order.
Here, with T_c = [R_c p_c] commanded and T_a = [R_a p_a] attained in the measuring frame,

    frame "tool":  d = R_c^T (p_a - p_c),  δ = log(R_c^T R_a)
    frame "base":  d = p_a - p_c,          δ = log(R_a R_c^T)

and log is the exact rotation vector, so that a large error is measured as truly as a small one. In "tool" both are
written in the axes of the commanded target, in "base" in those of the measuring frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.errors import InputError, Problem, UsageError
from robacc.figures import PoseFigures, pose_figures
from robacc.geometry import Array, Poses, compose, log_so3, rotate_back, transpose
from robacc.measurements import Measurements
from robacc.robots.assembly import build_chain
from robacc.robots.description import Robot

ErrorFrame = Literal["tool", "base"]
CommandSource = Literal["robot", "file"]

_BLOCK = 16384
"""Poses done at a time: the working arrays of a block stay in the cache."""


@dataclass(frozen=True, slots=True)
class Commanded:
    """Where the target was to be."""

    position: Array
    """``(3, N)`` in the measuring frame, m."""
    rotation: Array | None
    """``(3, 3, N)``; None where only positions were commanded."""
    source: CommandSource
    """The robot's own kinematics at the commanded joints, or the ``cmd_`` columns."""


@dataclass(frozen=True, slots=True)
class PoseErrors:
    """The error vector of each pose."""

    frame: ErrorFrame
    position: Array
    """``(3, N)`` d, m."""
    rotation: Array | None
    """``(3, N)`` δ, a rotation vector in rad; None where the attained or the commanded orientation is not known."""

    def figures(self) -> PoseFigures:
        """Root mean square, mean, 95th percentile and maximum of the lengths."""
        return pose_figures(self.position if self.rotation is None else np.vstack((self.position, self.rotation)))


def commanded_poses(data: Measurements, robot: Robot | None) -> Commanded:
    """Where the targets were to be: predicted by ``robot`` where there is one, else as the file says.

    Raises:
        UsageError: neither a robot nor commanded poses.
        InputError: a robot, and no joint variables to command it.
    """
    if robot is not None:
        if data.q is None:
            fix = "add the commanded joints q1, q2, …"
            if data.commanded_position is not None:
                fix += ", or leave out --robot to use the file's own cmd_ columns"
            raise InputError(Problem("has no joint columns for the robot to be commanded by", data.source, fix=fix))
        poses = _predicted(robot, data, data.q)
        return Commanded(poses.translation, poses.rotation, "robot")
    if data.commanded_position is None:
        raise UsageError(
            "the poses do not say where the target was to be: give --robot, or columns cmd_x, cmd_y, cmd_z"
        )
    return Commanded(data.commanded_position, data.commanded_rotation, "file")


def _predicted(robot: Robot, data: Measurements, q: Array) -> Poses:
    if not robot.effects and not robot.targets and len(q) == len(robot.variables):
        # An arm without effects is its chain, bit for bit; loading every effect would cost more than 10,000 poses.
        return build_chain(robot).forward(q)
    from robacc.model import predict

    return predict(robot, data)


def pose_errors(data: Measurements, commanded: Commanded, frame: ErrorFrame) -> PoseErrors:
    """Equations (3)-(5) in ``frame``; the formulas stand at the top of this module.

    Raises:
        UsageError: frame "tool" without the commanded orientation.
    """
    if frame == "tool" and commanded.rotation is None:
        raise UsageError(
            "frame tool needs the commanded orientation (cmd_qw …, or --robot); frame base needs positions only"
        )
    position = np.empty((3, data.n))
    both = data.rotation is not None and commanded.rotation is not None
    rotation = np.empty((3, data.n)) if both else None
    for start in range(0, data.n, _BLOCK):
        block = slice(start, start + _BLOCK)
        difference = data.position[:, block] - commanded.position[:, block]
        if frame == "tool" and commanded.rotation is not None:
            difference = rotate_back(commanded.rotation[..., block], difference)
        position[:, block] = difference
        if rotation is not None and data.rotation is not None and commanded.rotation is not None:
            attained, wanted = data.rotation[..., block], transpose(commanded.rotation[..., block])
            rotation[:, block] = log_so3(compose(wanted, attained) if frame == "tool" else compose(attained, wanted))
    return PoseErrors(frame, position, rotation)


def rms_length(errors: Array) -> float:
    """Root mean square of the length of errors ``(3, N)``."""
    return float(np.sqrt(np.mean(lengths(errors) ** 2)))


def lengths(errors: Array) -> Array:
    """Length ``(N,)`` of each of the errors ``(3, N)``."""
    result: Array = np.sqrt(np.einsum("in,in->n", errors, errors))
    return result
