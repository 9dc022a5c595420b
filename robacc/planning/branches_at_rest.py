"""Joints outside the chain in a plan: they stand still at their positions of the robot file."""

from __future__ import annotations

import numpy as np

from robacc.errors import InputError, Problem
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.description import BranchJoint, Robot

_EQUAL = 1e-4
"""Largest difference between a column and the position, rad or m: a file's rounding."""


def branches_at_rest(robot: Robot, n: int) -> tuple[Array | None, tuple[str, ...]]:
    """Return positions ``(B, n)`` and names of joints outside the chain; None if they load no joint of the chain."""
    variables = robot.branch_variables
    if not _loading(robot):
        return None, ()
    positions = np.array([branch.position for branch in variables])
    return np.tile(positions[:, None], (1, n)), tuple(branch.joint.name for branch in variables)


def at_rest_warning(robot: Robot) -> tuple[str, ...]:
    """Return a sentence about the joints outside the chain that must stand still; nothing if there are none."""
    loading = _loading(robot)
    if not loading:
        return ()
    listed = ", ".join(f"{branch.joint.name} at {_with_unit(branch)}" for branch in loading)
    return (
        f"the plan holds the joints outside the chain still: {listed}; their weight counts at these positions, which "
        "the planned rows state; to change them, set position in the robot file",
    )


def check_at_rest(robot: Robot, poses: Measurements) -> None:
    """Check that columns of joints outside the chain hold these at their positions.

    Raises:
        InputError: One of them is elsewhere.
    """
    if poses.branches is None:
        return
    for branch, values in zip(robot.branch_variables, poses.branches, strict=True):
        off = np.flatnonzero(np.abs(values - branch.position) > _EQUAL)
        if off.size:
            row = int(off[0])
            found = _with_unit(branch, float(values[row]))
            message = f"found {found}, expected {_with_unit(branch)}: a plan moves only the joints of the chain"
            fix = "set the position of this joint in the robot file to where it stands, or remove the column"
            line = None if poses.rows is None else int(poses.rows[row])
            raise InputError(Problem(message, poses.source, line, branch.joint.name, fix))


def _loading(robot: Robot) -> list[BranchJoint]:
    """Return the moving joints outside the chain whose weight a joint of the chain carries."""
    if not robot.has_masses:
        return []
    return [branch for branch in robot.branch_variables if robot.carrier(branch) is not None]


def _with_unit(branch: BranchJoint, value: float | None = None) -> str:
    position = branch.position if value is None else value
    if branch.joint.type == "prismatic":
        return f"{1e3 * position:.4g} mm"
    return f"{np.degrees(position):.4g}°"
