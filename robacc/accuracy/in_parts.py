"""Errors of the poses of a large file, counted part by part, by one process or by many, with the same result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial, reduce
from operator import add
from typing import TYPE_CHECKING

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


@single_threaded
def totals_of_part(
    read: Callable[[], Measurements],
    robot: Robot | None,
    frame: ErrorFrame,
    origins: tuple[Array, Array | None],
    *,
    is_gantry: bool,
) -> Totals:
    """Return what is counted over the poses of a part.

    Args:
        read: Function that reads the part.
        robot: Robot that predicts the commanded poses: registered, if frames were fitted; None for those of the file.
        frame: Axes of the errors.
        origins: ``(3,)`` mean position error, m, and orientation error, rad, of some of the poses.
        is_gantry: The robot's joint variables are the coordinates of the file's commanded poses.

    Raises:
        InputError: A row is wrong; with every problem of the part.
    """
    from robacc.fitting.registration import as_gantry

    data = read()
    position, turns = commanded_poses(as_gantry(data) if is_gantry else data, robot)
    turns = None if is_gantry and data.commanded_rotation is None else turns
    errors = pose_errors(data, position, turns, frame)
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
    registered = alignment and alignment.robot
    work = partial(
        totals_of_part,
        robot=registered or robot,
        frame=errors.frame,
        origins=(errors.mean, None if errors.rotation is None else errors.rotation.mean(axis=1)),
        is_gantry=robot is None and registered is not None,
    )
    return reduce(add, workers.in_order(work, reads, partial(progress, "reading")))
