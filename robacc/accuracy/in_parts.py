"""Errors of the poses of a large file, counted part by part, by one process or by many, with the same result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial, reduce
from operator import add
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from robacc.accuracy.error_sums import DifferentCommands, ErrorSums
from robacc.accuracy.estimation import ErrorFrame, PoseErrors, Totals, commanded_poses, pose_errors, worst_poses
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.description import Robot
from robacc.threads import single_threaded
from robacc.workers import Workers

if TYPE_CHECKING:
    from robacc.fitting.registration import Alignment


class PredictedBy(NamedTuple):
    """What predicts the commanded poses of every part, and the axes of the errors."""

    robot: Robot | None
    """Registered, if frames were fitted; None for the commanded poses of the file."""
    is_gantry: bool
    """The robot's joint variables are the coordinates of the file's commanded poses."""
    frame: ErrorFrame

    @classmethod
    def of(cls, robot: Robot | None, alignment: Alignment | None, frame: ErrorFrame) -> PredictedBy:
        """Return the robot, or without one the commanded poses of the file, with the frames that were fitted."""
        registered = alignment and alignment.robot
        return cls(registered or robot, robot is None and registered is not None, frame)

    def errors(self, data: Measurements) -> PoseErrors:
        """Return the errors of a part."""
        from robacc.fitting.registration import as_gantry

        position, turns = commanded_poses(as_gantry(data) if self.is_gantry else data, self.robot)
        turns = None if self.is_gantry and data.commanded_rotation is None else turns
        return pose_errors(data, position, turns, self.frame)


@single_threaded
def totals_of_part(
    read: Callable[[], Measurements], predicted: PredictedBy, origins: tuple[Array, Array | None]
) -> Totals:
    """Return what is counted over the poses of a part.

    Args:
        read: Function that reads the part.
        predicted: What predicts the commanded poses.
        origins: ``(3,)`` mean position error, m, and orientation error, rad, of some of the poses.

    Raises:
        InputError: A row is wrong; with every problem of the part.
    """
    data = read()
    errors = predicted.errors(data)
    commands = DifferentCommands.of(data.hashed_commands())
    names = () if data.target is None else np.unique(data.target)
    own = {str(name): np.flatnonzero(data.target == name) for name in names}
    turned, (origin, turned_origin) = errors.rotation, origins
    return Totals(
        ErrorSums.of(errors.position, origin, commands.numbers),
        None if turned is None or turned_origin is None else ErrorSums.of(turned, turned_origin, commands.numbers),
        commands,
        {name: ErrorSums.of(errors.position[:, rows], origin, commands.numbers[rows]) for name, rows in own.items()},
        worst_poses(data, errors),
        data.warnings,
    )


def totals(
    reads: Sequence[Callable[[], Measurements]],
    robot: Robot | None,
    workers: Workers,
    progress: Callable[[str, int, int], None],
    alignment: Alignment | None,
    errors: PoseErrors,
) -> Totals:
    """Return what is counted over all poses.

    Args:
        reads: Functions that read the parts, in their order.
        robot: Robot that predicts the commanded poses; None for those of the file.
        workers: What does the work.
        progress: Called with a label of the work, the number of parts done, and the number of all parts.
        alignment: Frames that were fitted to some of the poses; None without.
        errors: Errors of these poses.

    Raises:
        InputError: A row is wrong; with every problem of its part.
        UsageError: The workers cannot be reached.
    """
    work = partial(
        totals_of_part,
        predicted=PredictedBy.of(robot, alignment, errors.frame),
        origins=(errors.mean, None if errors.rotation is None else errors.rotation.mean(axis=1)),
    )
    return reduce(add, workers.in_order(work, reads, partial(progress, "reading")))
