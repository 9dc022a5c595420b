"""Reader of the poses measured on a known robot, checked against its names, limits, targets and size."""

import dataclasses
import os
from functools import partial
from typing import Any

import numpy as np

from robacc.accuracy.estimation import commanded_poses
from robacc.errors import InputError, Problem
from robacc.fitting.levels import SAMPLE
from robacc.geometry import Array
from robacc.measurements import Measurements, even_rows
from robacc.poses.cameras import seen_from_board
from robacc.poses.checks import TURN, central_range, check_scale, thousandfold
from robacc.poses.csv_file import read_poses
from robacc.poses.reading import BranchColumn, KnownRobot, reading_of
from robacc.robots.arm import build_chain
from robacc.robots.description import Robot


def read_robot_poses(
    path: str | os.PathLike[str],
    robot: Robot,
    *,
    ordered: bool = False,
    ignore_limits: bool = False,
    attained: bool = True,
    any_target: bool = False,
    planned_kinds: bool = False,
) -> Measurements:
    """Return the validated poses of a CSV file that ``robot`` was commanded to.

    Args:
        path: File to read; ``-`` is standard input.
        robot: Robot whose joints' names, types and limits and whose targets apply to the columns.
        ordered: As in :func:`robacc.poses.csv_file.read_poses`.
        ignore_limits: As in :func:`robacc.poses.csv_file.read_poses`.
        attained: As in :func:`robacc.poses.csv_file.read_poses`.
        any_target: Several targets are valid although the robot has one tool.
        planned_kinds: As in :func:`robacc.poses.csv_file.read_poses`.

    Raises:
        InputError: Everything that is wrong with the file; or the spread of its positions shows another unit than that
            of the robot's lengths.
    """
    data = read_poses(
        path,
        robot=joints_of(robot)._replace(
            target_names="any" if any_target and not robot.targets else tuple(robot.targets),
            pose_at=lambda q: build_chain(dataclasses.replace(robot, effects=())).forward(q),
        ),
        ordered=ordered,
        ignore_limits=ignore_limits,
        attained=attained,
        planned_kinds=planned_kinds,
    )
    doubts = check_size(data, robot) if attained and data.kind is None else ()
    return dataclasses.replace(data, warnings=(*data.warnings, *doubts))


def read_rows(path: str, robot: Robot | None, *, ordered: bool = False, **options: Any) -> Measurements:
    """Return the validated poses of a file: with a robot by :func:`read_robot_poses`, which has the ``options``.

    Measured poses of a board in a camera on the hand are turned into those of the camera.

    Raises:
        InputError: Everything that is wrong with the file.
    """
    data = (
        read_poses(path, ordered=ordered)
        if robot is None
        else read_robot_poses(path, robot, ordered=ordered, **options)
    )
    return (
        seen_from_board(data, reading_of(path).camera, partial(nominal_poses, robot=robot))
        if options.get("attained", True)
        else data
    )


def nominal_poses(data: Measurements, robot: Robot | None) -> tuple[Array | None, Array | None]:
    """Return the commanded positions and orientations; None where the commands have none."""
    if data.q is None or robot is None:
        return data.commanded_position, data.commanded_rotation
    poses = build_chain(dataclasses.replace(robot, effects=())).forward(data.q)
    return poses.translation, poses.rotation


def joints_of(robot: Robot) -> KnownRobot:
    """Return the robot's joints for the reader of a pose file: names, types, limits, and joints outside the chain."""
    return KnownRobot(
        joint_names=robot.variable_names,
        joint_types=[joint.type for joint in robot.variables],
        limits=[joint.limits for joint in robot.variables],
        branches=tuple(
            BranchColumn(
                branch.joint.name,
                branch.joint.type,
                branch.position,
                robot.has_masses and robot.carrier(branch) is not None,
            )
            for branch in robot.branch_variables
        ),
        # How a joint variable follows a joint outside the chain, in SI units.
        outside={
            rule.master: f"{joint.name} = {rule.multiplier:g} * {rule.master}"
            + (f" {'-' if rule.offset < 0 else '+'} {abs(rule.offset):g}" if rule.offset else "")
            + f" ({'m' if joint.type == 'prismatic' else 'rad'})"
            for joint in robot.variables
            if (rule := joint.outside)
        },
    )


def check_size(data: Measurements, robot: Robot) -> tuple[str, ...]:
    """Return a warning of positions that spread much farther than the commands; another unit is an error.

    Raises:
        InputError: The spread of the positions is about 1000 times too large or too small.
    """
    if data.q is None or data.n < 2:
        return ()
    sample = data.subset(even_rows(data.n, SAMPLE))
    nominal, _ = commanded_poses(sample, robot)
    check_scale(sample.position, nominal, data.source)
    _check_both_units(sample, robot)
    measured_range, nominal_range = (float(np.max(central_range(p))) for p in (sample.position, nominal))
    # Thrice the spread of the commands, and 0.1 m beyond it, are doubtful.
    if measured_range < 3.0 * nominal_range + 0.1:
        return ()
    return (
        f"{data.source}: the positions spread over {measured_range:.3g} m, but the joints move the robot over "
        f"{nominal_range:.3g} m only; check the unit of the joint columns (rad or degrees), and the robot",
    )


def _check_both_units(data: Measurements, robot: Robot) -> None:
    """Raise an error for positions in m read as mm beside joints in rad read as degrees, which agree with the robot.

    Read so, no joint turns by more than 2 pi degrees, and the positions spread a thousand times less than they would
    at the joints in rad.
    """
    revolute = np.array([joint.type == "revolute" for joint in robot.variables])
    if data.q is None or not revolute.any() or (largest := float(np.max(np.abs(data.q[revolute])))) > np.radians(TURN):
        return
    turned = dataclasses.replace(data, q=np.where(revolute[:, None], np.degrees(data.q), data.q))
    nominal, _ = commanded_poses(turned, robot)
    if (thousandfold(data.position, nominal) or 2.0) > 1:
        return
    spread = 1e3 * float(np.max(central_range(data.position)))
    message = (
        f"the positions spread over {spread:.3g} mm only, and no joint is beyond {np.degrees(largest):.3g} degrees; "
        "read in m and rad, they agree with the size of the robot"
    )
    fix = "if they are in m and rad, give `units` as m,rad, or name the columns x_m, q1_rad and so on"
    raise InputError(Problem(message, data.source, fix=fix))
