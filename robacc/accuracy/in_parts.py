"""Errors of the poses of a large file, counted part by part, by one process or by many, with the same result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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


class PosesPart(NamedTuple):
    """Part of the poses, and how their errors are computed."""

    read: Callable[[], Measurements]
    robot: Robot | None
    """The robot that predicts the commanded poses: registered, if frames were fitted; None for those of the file."""
    is_gantry: bool
    """The robot's joint variables are the coordinates of the file's commanded poses."""
    frame: ErrorFrame
    origins: tuple[Array, Array | None]
    """``(3,)`` mean position error, m, and orientation error, rad, of some of the poses."""


@single_threaded
def totals_of_part(part: PosesPart) -> Totals:
    """Return what is counted over the poses of a part.

    Raises:
        InputError: A row is wrong; with every problem of the part.
    """
    from robacc.fitting.registration import as_gantry

    data = part.read()
    position, turns = commanded_poses(as_gantry(data) if part.is_gantry else data, part.robot)
    turns = None if part.is_gantry and data.commanded_rotation is None else turns
    errors = pose_errors(data, position, turns, part.frame)
    commands = DifferentCommands.of(data.hashed_commands())
    names = () if data.target is None else np.unique(data.target)
    own = {str(name): np.flatnonzero(data.target == name) for name in names}
    turned, origin = errors.rotation, part.origins[1]
    return Totals(
        ErrorSums.of(errors.position, part.origins[0], commands.numbers),
        None if turned is None or origin is None else ErrorSums.of(turned, origin, commands.numbers),
        commands,
        {
            name: ErrorSums.of(errors.position[:, rows], part.origins[0], commands.numbers[rows])
            for name, rows in own.items()
        },
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
    frames = None if alignment is None else alignment.robot
    turned = None if errors.rotation is None else errors.rotation.mean(axis=1)
    part = PosesPart(
        reads[0], frames or robot, robot is None and frames is not None, errors.frame, (errors.mean, turned)
    )
    result: Totals | None = None
    for number, one in enumerate(workers.in_order(totals_of_part, [part._replace(read=read) for read in reads])):
        result = one if result is None else result + one
        progress("reading", number + 1, len(reads))
    assert result is not None
    return result
