"""Error at each measured pose, by (3)-(5) of Wu and Lee, its metrics, and its axes.

Source: C. H. Wu and C. C. Lee, "Estimation of the Accuracy of a Robot Manipulator" (IEEE TAC, 1985). Their attained
pose is T + dT = T (I + δT) with δT built of the translation d and the rotation δ in the target's frame, to first order.
Here, with T_c = [R_c p_c] commanded and T_a = [R_a p_a] attained in the measuring frame,

    frame "tool":  d = R_c^T (p_a - p_c),  δ = log(R_c^T R_a)
    frame "base":  d = p_a - p_c,          δ = log(R_a R_c^T)

and log is the exact rotation vector, so that large errors are exact too. "tool" gives both in the axes of the
commanded target, "base" in those of the measuring frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from robacc.errors import InputError, Problem, UsageError
from robacc.geometry import Array, log_between, rotate_back, transpose
from robacc.measurements import Measurements

if TYPE_CHECKING:
    from robacc.fitting.registration import Alignment
    from robacc.robots.description import Robot


# RMS, mean, 95th percentile and maximum of the error's length: the metrics that every comparison uses.


@dataclass(frozen=True, slots=True)
class ErrorMetrics:
    """Metrics of the error's length over poses, m or rad."""

    rms: float
    mean: float
    p95: float
    """Interpolated linearly between order statistics."""
    max: float


@dataclass(frozen=True, slots=True)
class PoseMetrics:
    """Metrics of position and, where it was measured, of orientation."""

    position: ErrorMetrics
    orientation: ErrorMetrics | None


def pose_metrics(residual: Array) -> PoseMetrics:
    """Return the metrics of residuals ``(3 or 6, N)`` in m and rad."""
    orientation = length_metrics(lengths(residual[3:])) if residual.shape[0] == 6 else None
    return PoseMetrics(length_metrics(lengths(residual[:3])), orientation)


def length_metrics(length: Array) -> ErrorMetrics:
    """Return the metrics of lengths ``(N,)``, m or rad; NaN without any."""
    if length.size == 0:
        return ErrorMetrics(float("nan"), float("nan"), float("nan"), float("nan"))
    return ErrorMetrics(
        float(np.sqrt(np.mean(np.square(length)))),
        float(np.mean(length)),
        float(np.percentile(length, 95.0)),
        float(np.max(length)),
    )


ErrorFrame = Literal["tool", "base"]
CommandSource = Literal["robot", "file"]

_BLOCK = 16384
"""Poses per block: the working arrays of a block stay in the cache."""


@dataclass(frozen=True, slots=True)
class Commanded:
    """Commanded poses of the target, computed block by block so that a million poses never fill the memory."""

    source: CommandSource
    """The robot model at the commanded joints, or the ``cmd_`` columns."""
    oriented: bool
    """An orientation was commanded, not only a position."""
    block: Callable[[slice], tuple[Array, Array | None]]
    """Positions ``(3, n)`` in the measuring frame, m, and rotations ``(3, 3, n)`` of a slice of the poses."""

    @classmethod
    def at(cls, position: Array, rotation: Array | None, source: CommandSource) -> Commanded:
        """Return the commanded poses of given positions ``(3, N)`` and rotations ``(3, 3, N)``."""
        return cls(
            source, rotation is not None, lambda b: (position[:, b], None if rotation is None else rotation[..., b])
        )


@dataclass(frozen=True, slots=True)
class PoseErrors:
    """Error vectors of all poses."""

    frame: ErrorFrame
    position: Array
    """``(3, N)`` d, m."""
    rotation: Array | None
    """``(3, N)`` δ, a rotation vector in rad; None where the attained or the commanded orientation is unknown."""

    def metrics(self) -> PoseMetrics:
        """Return RMS, mean, 95th percentile and maximum of the lengths."""
        return pose_metrics(self.position if self.rotation is None else np.vstack((self.position, self.rotation)))


def commanded_poses(data: Measurements, robot: Robot | None) -> Commanded:
    """Return the commanded poses: predicted by ``robot`` if given, else from the file.

    Raises:
        UsageError: There are neither a robot nor commanded poses.
        InputError: There is a robot, but the data have no joint variables.
    """
    if robot is not None:
        if data.q is None:
            fix = "add the commanded joints q1, q2, …"
            if data.commanded_position is not None:
                fix += ", or omit `robot` to use the cmd_ columns of the file"
            raise InputError(Problem("has no columns of commanded joints for the robot", data.source, fix=fix))
        return _predicted(robot, data, data.q)
    if data.commanded_position is None:
        ways = "`robot`" if data.q is not None else "`commanded`, a robot program or a table of joints or poses"
        raise UsageError(f"the poses have no commanded positions: give {ways}, or columns cmd_x, cmd_y, cmd_z")
    return Commanded.at(data.commanded_position, data.commanded_rotation, "file")


def registered_poses(data: Measurements, robot: Robot | None, alignment: Alignment | None) -> Commanded:
    """Return the commanded poses after an alignment, or those of :func:`commanded_poses` without."""
    if alignment is None:
        return commanded_poses(data, robot)
    oriented = robot is not None or data.commanded_rotation is not None
    poses = alignment.commanded
    return Commanded.at(poses.translation, poses.rotation if oriented else None, "file" if robot is None else "robot")


def _predicted(robot: Robot, data: Measurements, q: Array) -> Commanded:
    if not robot.effects and not robot.targets and len(q) == len(robot.variables):
        # An arm without effects is its chain, bit for bit; loading all effects takes longer than 10,000 poses.
        from robacc.robots.arm import build_chain

        chain = build_chain(robot)

        def block(part: slice) -> tuple[Array, Array]:
            poses = chain.forward(q[:, part])
            return poses.translation, poses.rotation

        return Commanded("robot", True, block)
    from robacc.modelling.model import predict

    poses = predict(robot, data)
    return Commanded.at(poses.translation, poses.rotation, "robot")


def pose_errors(data: Measurements, commanded: Commanded, frame: ErrorFrame) -> PoseErrors:
    """Compute equations (3)-(5) in ``frame``, as written at the top of this module.

    Raises:
        UsageError: The frame is "tool", but no orientation was commanded.
    """
    if frame == "tool" and not commanded.oriented:
        raise UsageError(
            "frame tool needs the commanded orientation: add columns cmd_qw …, give `robot`, or use frame base"
        )
    position = np.empty((3, data.n))
    rotation = np.empty((3, data.n)) if data.rotation is not None and commanded.oriented else None
    for start in range(0, data.n, _BLOCK):
        block = slice(start, start + _BLOCK)
        target, turn = commanded.block(block)
        difference = data.position[:, block] - target
        position[:, block] = rotate_back(turn, difference) if frame == "tool" and turn is not None else difference
        if rotation is not None and data.rotation is not None and turn is not None:
            attained = data.rotation[..., block]
            pair = (transpose(turn), transpose(attained)) if frame == "tool" else (attained, turn)
            rotation[:, block] = log_between(*pair)
    return PoseErrors(frame, position, rotation)


def lengths(errors: Array) -> Array:
    """Return the lengths ``(N,)`` of errors ``(3, N)``."""
    result: Array = np.sqrt(np.einsum("in,in->n", errors, errors))
    return result


# Position errors in the axes of the tool and of the measuring frame, with their mean and covariance in each.
#
# A cloud that is round in one frame may be long in the other: errors of the tool turn with the tool, errors of the
# base stay fixed in the room.


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """Position errors in one frame, their mean and covariance."""

    errors: Array
    """``(3, N)`` m"""
    mean: Array
    """``(3,)`` m"""
    covariance: Array
    """``(3, 3)`` about zero, divisor N: equation (13) of Wu and Lee (1985), m²."""
    centred: Array
    """``(3, 3)`` about the mean, divisor N, m²."""


def position_statistics(data: Measurements, commanded: Commanded) -> dict[ErrorFrame, FrameStatistics]:
    """Return the statistics in the measuring frame, and in the tool's where a commanded orientation is known."""
    frames: tuple[ErrorFrame, ...] = ("tool", "base") if commanded.oriented else ("base",)
    statistics = {}
    for frame in frames:
        errors = pose_errors(data, commanded, frame).position
        mean = errors.mean(axis=1)
        covariance = errors @ errors.T / data.n
        statistics[frame] = FrameStatistics(errors, mean, covariance, covariance - np.outer(mean, mean))
    return statistics
