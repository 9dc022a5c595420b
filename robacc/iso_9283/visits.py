"""Visits of each commanded pose: attained positions, deviations from the command, and the angles a, b, c.

The standard's a, b, c are roll, pitch and yaw of R = Rz(c) Ry(b) Rx(a). Each deviation is wrapped into half a turn, so
that angles near half a turn cause no jump. Within 10 degrees of b = 90 degrees, where a and c are not defined
separately, the rotation from the commanded to the attained orientation about x, y, z of the measuring frame is used.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.pose_errors import Commanded
from robacc.errors import InputError, Problem
from robacc.geometry import Array, compose, log_so3, rpy_from_rotation, transpose
from robacc.measurements import Measurements

_POLE = np.cos(np.deg2rad(80.0))
"""cos(b) below which a deviation of a or c is at least six times the rotation that causes it."""


@dataclass(frozen=True, slots=True)
class CommandedPose:
    """Visits of one commanded pose of one file, in the order measured if it is known."""

    label: str
    source: str
    number: int
    """Index of the file, from 0."""
    rows: NDArray[np.int64]
    """``(n,)`` rows of the file's measurements."""
    attained: Array
    """``(3, n)`` m, measuring frame."""
    commanded: Array | None
    """``(3,)`` m, of the first visit; None: not known."""
    deviation: Array | None
    """``(3, n)`` attained minus commanded position, m."""
    reference: Array | None
    """``(3,)`` a, b, c of the commanded orientation, or of the first visit if none was commanded, rad."""
    turn: Array | None
    """``(3, n)`` deviations of a, b, c from ``reference``, rad."""
    oriented: bool
    """True if ``reference`` is the commanded orientation."""
    at_pole: bool
    """True if the deviations are about x, y, z of the measuring frame, since a and c are not defined."""
    cycle: NDArray[Any] | None
    """``(n,)`` names of the repetitions."""
    time: Array | None
    """``(n,)`` s"""
    direction: Array | None
    """``(J, n)`` in {-1, 0, 1}"""

    @property
    def n(self) -> int:
        """Number of visits."""
        return int(self.attained.shape[1])

    @property
    def stream(self) -> tuple[int, int]:
        """Stream of random numbers of this pose, independent of the order of rows."""
        return self.number, zlib.crc32(self.label.encode())

    @property
    def residuals(self) -> Array:
        """Attained positions minus their barycentre, ``(3, n)``, m."""
        return np.asarray(self.attained - self.attained.mean(axis=1, keepdims=True))


def visits_of(data: Measurements, commanded: Commanded | None, source: str, number: int) -> tuple[CommandedPose, ...]:
    """Return the commanded poses of one file in the order of their first visit; each target counts as a separate pose.

    Raises:
        InputError: There are no poses.
    """
    if data.n == 0:
        raise InputError(Problem("has no measured poses", source))
    # Grouped by id even if the commands differ, which a warning reports: then the command is wrong.
    groups = data.groups() if data.pose is None else np.unique(data.pose, return_inverse=True)[1]
    if data.target is not None:
        targets = np.unique(data.target, return_inverse=True)[1]
        groups = np.unique(groups * (targets.max() + 1) + targets, return_inverse=True)[1]
    commands = None if commanded is None else commanded.block(slice(0, data.n))
    _, first = np.unique(groups, return_index=True)
    members = np.split(np.argsort(groups, kind="stable"), np.cumsum(np.bincount(groups))[:-1])
    order = np.argsort(first, kind="stable")
    poses = []
    for index, i in enumerate(order):
        rows = members[i]
        if data.time is not None:
            rows = rows[np.argsort(data.time[rows], kind="stable")]
        attained = data.position[:, rows]
        position, rotation = (
            None if part is None else part[..., rows] for part in ((None, None) if commands is None else commands)
        )
        reference, turn, at_pole = _turns(data, rows, rotation)
        label = f"pose {index + 1}" if data.pose is None else str(data.pose[rows[0]])
        if data.target is not None and np.unique(data.target).size > 1:
            label += f" {data.target[rows[0]]}"
        poses.append(
            CommandedPose(
                label=label,
                source=source,
                number=number,
                rows=rows,
                attained=attained,
                commanded=None if position is None else position[:, 0],
                deviation=None if position is None else attained - position,
                reference=reference,
                turn=turn,
                oriented=rotation is not None,
                at_pole=at_pole,
                cycle=None if data.cycle is None else data.cycle[rows],
                time=None if data.time is None else data.time[rows],
                direction=None if data.direction is None else data.direction[:, rows],
            )
        )
    return tuple(poses)


def wrapped(angle: Array) -> Array:
    """Return the same angle in (-pi, pi]."""
    return np.asarray(np.pi - (np.pi - angle) % (2.0 * np.pi))


def _turns(
    data: Measurements, rows: NDArray[np.int64], commanded: Array | None
) -> tuple[Array | None, Array | None, bool]:
    """Return reference angles, deviations from them, and True if the deviations are about the frame's axes."""
    if data.rotation is None:
        return None, None, False
    attained = data.rotation[..., rows]
    reference = attained[..., :1] if commanded is None else commanded
    angles = rpy_from_rotation(reference)
    if np.min(np.cos(angles[1])) < _POLE:
        return angles[:, 0], log_so3(compose(attained, transpose(np.broadcast_to(reference, attained.shape)))), True
    return angles[:, 0], wrapped(rpy_from_rotation(attained) - angles), False


def shifting_commands(poses: Sequence[CommandedPose]) -> str | None:
    """Return a warning if the command changes between visits of one commanded pose."""
    worst_pose, largest_move = None, 1e-6
    for pose in poses:
        if pose.deviation is not None and pose.commanded is not None:
            move = float(np.max(np.abs(pose.attained - pose.deviation - pose.commanded[:, None])))
            if move > largest_move:
                worst_pose, largest_move = pose, move
    if worst_pose is None:
        return None
    return (
        f"the command of {worst_pose.label} differs by {largest_move * 1e3:.2g} mm between its visits, but cycles "
        "repeat one commanded pose; put commanded joint values into the q columns, not encoder readings"
    )
