"""The visits of each commanded pose: attained positions, deviations from the command, and the angles a, b, c.

The standard's a, b, c are here roll, pitch and yaw of R = Rz(c) Ry(b) Rx(a), each deviation taken the short way round,
so that angles near a half turn do no harm. Within 10 degrees of b = 90 degrees, where a and c are not defined singly,
the turn from the command to the attained orientation is written about x, y and z of the measuring frame instead.
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
"""cos(b) below which a deviation of a or c is six times the turn that makes it, and more."""


@dataclass(frozen=True, slots=True)
class CommandedPose:
    """The visits of one commanded pose of one file, in the order measured as far as it is known."""

    label: str
    source: str
    number: int
    """Of its file, from 0."""
    rows: NDArray[np.int64]
    """``(n,)`` rows of the file's measurements."""
    attained: Array
    """``(3, n)`` m, measuring frame."""
    commanded: Array | None
    """``(3,)`` m, of the first visit; None: nobody says where."""
    deviation: Array | None
    """``(3, n)`` attained minus commanded position, m."""
    reference: Array | None
    """``(3,)`` a, b, c of the commanded orientation, or of the first visit's where none was commanded, rad."""
    turn: Array | None
    """``(3, n)`` deviations of a, b, c from ``reference``, rad."""
    oriented: bool
    """Whether ``reference`` is the commanded orientation."""
    at_pole: bool
    """Whether the deviations are about x, y, z of the measuring frame, a and c not being defined."""
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
        """What tells its random draws from other poses', whatever the order of rows."""
        return self.number, zlib.crc32(self.label.encode())

    @property
    def residuals(self) -> Array:
        """``(3, n)`` attained positions about their barycentre, m."""
        result: Array = self.attained - self.attained.mean(axis=1, keepdims=True)
        return result


def visits_of(data: Measurements, commanded: Commanded | None, source: str, number: int) -> tuple[CommandedPose, ...]:
    """The commanded poses of one file in the order of their first visit; of several targets each is a pose of its own.

    Raises:
        InputError: no poses.
    """
    if data.n == 0:
        raise InputError(Problem("has no measured poses", source))
    # By id even where the commands differ, which a warning says: in a cycle it is the command that went wrong.
    groups = data.groups() if data.pose is None else np.unique(data.pose, return_inverse=True)[1]
    if data.target is not None:
        targets = np.unique(data.target, return_inverse=True)[1]
        groups = np.unique(groups * (targets.max() + 1) + targets, return_inverse=True)[1]
    wanted = None if commanded is None else commanded.block(slice(0, data.n))
    _, first = np.unique(groups, return_index=True)
    members = np.split(np.argsort(groups, kind="stable"), np.cumsum(np.bincount(groups))[:-1])
    order = np.argsort(first, kind="stable")
    return tuple(_commanded_pose(data, members[i], wanted, place, source, number) for place, i in enumerate(order))


def wrapped(angle: Array) -> Array:
    """The same angle the short way round, in (-pi, pi]."""
    result: Array = np.pi - (np.pi - angle) % (2.0 * np.pi)
    return result


def _commanded_pose(
    data: Measurements,
    rows: NDArray[np.int64],
    wanted: tuple[Array, Array | None] | None,
    place: int,
    source: str,
    number: int,
) -> CommandedPose:
    if data.time is not None:
        rows = rows[np.argsort(data.time[rows], kind="stable")]
    attained = data.position[:, rows]
    where = None if wanted is None else wanted[0][:, rows]
    how = None if wanted is None or wanted[1] is None else wanted[1][..., rows]
    reference, turn, at_pole = _turns(data, rows, how)
    return CommandedPose(
        label=_label(data, int(rows[0]), place),
        source=source,
        number=number,
        rows=rows,
        attained=attained,
        commanded=None if where is None else where[:, 0],
        deviation=None if where is None else attained - where,
        reference=reference,
        turn=turn,
        oriented=how is not None,
        at_pole=at_pole,
        cycle=None if data.cycle is None else data.cycle[rows],
        time=None if data.time is None else data.time[rows],
        direction=None if data.direction is None else data.direction[:, rows],
    )


def _label(data: Measurements, row: int, place: int) -> str:
    name = f"pose {place + 1}" if data.pose is None else str(data.pose[row])
    several = data.target is not None and np.unique(data.target).size > 1
    return f"{name} {data.target[row]}" if several and data.target is not None else name


def _turns(
    data: Measurements, rows: NDArray[np.int64], commanded: Array | None
) -> tuple[Array | None, Array | None, bool]:
    """Reference angles, deviations from them, and whether they are about the frame's axes."""
    if data.rotation is None:
        return None, None, False
    attained = data.rotation[..., rows]
    reference = attained[..., :1] if commanded is None else commanded
    angles = rpy_from_rotation(reference)
    if np.min(np.cos(angles[1])) < _POLE:
        return angles[:, 0], log_so3(compose(attained, transpose(np.broadcast_to(reference, attained.shape)))), True
    return angles[:, 0], wrapped(rpy_from_rotation(attained) - angles), False


def shifting_commands(poses: Sequence[CommandedPose]) -> str | None:
    """A warning where the command moves between visits of what is said to be one commanded pose."""
    worst, size = None, 1e-6
    for pose in poses:
        if pose.deviation is not None and pose.commanded is not None:
            moved = float(np.max(np.abs(pose.attained - pose.deviation - pose.commanded[:, None])))
            if moved > size:
                worst, size = pose, moved
    if worst is None:
        return None
    return (
        f"the commanded pose of {worst.label} differs by {size * 1e3:.2g} mm between its visits: cycles are "
        "repetitions of one commanded pose (q columns are the joints as commanded, not as read)"
    )
