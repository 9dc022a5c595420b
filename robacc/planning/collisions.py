"""Collisions in a plan: what a test of the links' shapes offers, and joints outside the chain, which stand still."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.description import BranchJoint, Robot

SELF_COLLISION = "self-collision"
"""Reason of poses that are excluded because two links touch."""


class LinkCollisions(Protocol):
    """Test of poses for collisions of an arm's links, which a plug-in of the group ``robacc.collisions`` makes."""

    @property
    def pairs(self) -> Sequence[tuple[str, str]]:
        """Links of each pair that is checked."""

    @property
    def overlapping(self) -> Sequence[tuple[str, str]]:
        """Links of each pair that is not checked, because they touch at nearly all poses."""

    def self_collision(self, q: Array) -> NDArray[np.bool_]:
        """Return ``(N,)`` the poses ``(J, N)``, rad or m, at which two links touch."""

    def in_box(self, q: Array, low: Sequence[float], high: Sequence[float]) -> NDArray[np.bool_]:
        """Return ``(N,)`` the poses at which a link is in a box of the base frame; a side may be infinite, m."""

    def beyond(self, q: Array, direction: Sequence[float], offset: float) -> NDArray[np.bool_]:
        """Return ``(N,)`` the poses at which a link leaves the half-space direction . p <= offset, m."""


# Joints outside the chain in a plan: they stand still at their positions of the robot file.

_EQUAL = 1e-4
"""Largest difference between a column and the position, rad or m: a file's rounding."""


def branches_at_rest(robot: Robot, n: int) -> tuple[Array | None, tuple[str, ...]]:
    """Return positions ``(B, n)`` and names of joints outside the chain; None if they load no joint of the chain."""
    if not _loading(robot):
        return None, ()
    variables = robot.branch_variables
    positions = np.array([[branch.position] * n for branch in variables])
    return positions, tuple(branch.joint.name for branch in variables)


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
