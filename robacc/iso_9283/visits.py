"""Visits of each commanded pose, and the records of an evaluation after ISO 9283.

"Pose" is the standard's word for a commanded pose; a visit is one arrival at it. The standard's a, b, c are roll, pitch
and yaw of R = Rz(c) Ry(b) Rx(a). Each deviation is wrapped into half a turn, so that angles near half a turn cause no
jump. Within 10 degrees of b = 90 degrees, where a and c are not defined separately, the rotation from the commanded to
the attained orientation about x, y, z of the measuring frame is used.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.estimation import Commanded
from robacc.errors import InputError, Problem
from robacc.fitting.registration import Alignment
from robacc.geometry import Array, compose, log_so3, rpy_from_rotation, transpose
from robacc.measurements import Measurements
from robacc.statistics.intervals import EstimateOrReason

_POLE = np.cos(np.deg2rad(80.0))
"""cos(b) below which a deviation of a or c is at least six times the rotation that causes it."""

Symbol = Literal["AP", "RP", "vAP", "AD", "RD", "dAP", "dRP", "shift", "E"]
Status = Literal["met", "not met", "unknown"]
Figure = TypeVar("Figure")


@dataclass(frozen=True, slots=True)
class CommandedPose:
    """Visits of one commanded pose of one file, in the order measured if it is known."""

    label: str
    source: str
    number: int
    """Index of the file, from 0."""
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


@dataclass(frozen=True, slots=True)
class IsoCriterion(Generic[Figure]):
    """One criterion at one place: a commanded pose or a pair of commanded poses.

    Results have figures with the interval at one confidence; the computation has estimates with intervals at any.
    """

    poses: tuple[str, ...]
    source: str | None
    """Name of the file; None if the criterion is over several files."""
    n: int
    """Number of visits, or of pairs of visits."""
    position: Figure
    """m"""
    axes: tuple[Figure, ...] | None = None
    """Components along x, y, z of the measuring frame, m, if the standard defines them."""
    angles: tuple[Figure, ...] | None = None
    """a, b, c: rad."""
    mean_distance: float | None = None
    """RP: mean distance of the visits from their barycentre, m."""
    sd_distance: float | None = None
    """RP: standard deviation S_l of that distance, m."""
    between: str | None = None
    """The two approaches, windows or files with the largest distance."""


@dataclass(frozen=True, slots=True)
class Characteristic:
    """One criterion over all places: its largest value, and the value at every place."""

    symbol: Symbol
    clause: str
    """Clause of ISO 9283:1998."""
    position: EstimateOrReason
    """Largest value, m; largest absolute value of a signed criterion."""
    position_at: str | None
    """Place of the largest value."""
    angle: EstimateOrReason
    """Largest of a, b, c, rad."""
    angle_at: str | None
    """Place and letter of the largest angle."""
    places: tuple[IsoCriterion[EstimateOrReason], ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Condition:
    """One condition of the standard's protocol, its status and the reason."""

    name: str
    clause: str
    status: Status
    why: str


@dataclass(frozen=True, slots=True)
class Iso9283Result:
    """Result of ``robacc iso9283``."""

    n_poses: int
    """Measured poses (rows) of all files."""
    sources: tuple[str, ...]
    """Name of each file."""
    commanded: Literal["robot", "file"] | None
    """Source of the commanded poses; None: not known."""
    poses: tuple[CommandedPose, ...]
    characteristics: tuple[Characteristic, ...]
    """In the standard's order; a criterion that the data cannot support has a reason and no number."""
    protocol: tuple[Condition, ...]
    alignments: tuple[Alignment, ...]
    """Registration of each file, if one was requested."""
    unaligned: Array | None
    """``(files,)`` largest AP before registration, m."""
    confidence: float
    notes: tuple[str, ...]
    warnings: tuple[str, ...]

    def characteristic(self, symbol: Symbol) -> Characteristic:
        """Return the characteristic with ``symbol``."""
        return next(entry for entry in self.characteristics if entry.symbol == symbol)


def visits_of(data: Measurements, commanded: Commanded | None, source: str, number: int) -> tuple[CommandedPose, ...]:
    """Return the commanded poses of one file in the order of their first visit; each target counts as a separate pose.

    Raises:
        InputError: There are no poses.
    """
    if data.n == 0:
        raise InputError(Problem("has no measured poses", source))
    # Grouped by id even if the commands differ, which a warning reports: then the command is wrong.
    groups = data.groups() if data.pose is None else np.unique(data.pose, return_inverse=True)[1]
    several_targets = data.target is not None and np.unique(data.target).size > 1
    if data.target is not None:
        targets = np.unique(data.target, return_inverse=True)[1]
        groups = np.unique(groups * data.n + targets, return_inverse=True)[1]
    command = (None, None) if commanded is None else commanded.block(slice(0, data.n))
    _, first = np.unique(groups, return_index=True)
    members = np.split(np.argsort(groups, kind="stable"), np.cumsum(np.bincount(groups))[:-1])
    poses = []
    for index, i in enumerate(np.argsort(first)):
        rows = members[i]
        if data.time is not None:
            rows = rows[np.argsort(data.time[rows], kind="stable")]
        optional = data.cycle, data.time, data.direction, data.rotation, *command
        cycle, time, direction, rotation, position, orientation = (
            None if column is None else column[..., rows] for column in optional
        )
        attained, reference, turn, at_pole = data.position[:, rows], None, None, False
        if rotation is not None:
            target = rotation[..., :1] if orientation is None else orientation
            angles = rpy_from_rotation(target)
            reference, at_pole = angles[:, 0], bool(np.min(np.cos(angles[1])) < _POLE)
            turn = wrapped(rpy_from_rotation(rotation) - angles)
            if at_pole:
                turn = log_so3(compose(rotation, transpose(np.broadcast_to(target, rotation.shape))))
        label = f"pose {index + 1}" if data.pose is None else str(data.pose[rows[0]])
        poses.append(
            CommandedPose(
                label=f"{label} {data.target[rows[0]]}" if several_targets and data.target is not None else label,
                source=source,
                number=number,
                attained=attained,
                commanded=None if position is None else position[:, 0],
                deviation=None if position is None else attained - position,
                reference=reference,
                turn=turn,
                oriented=orientation is not None,
                at_pole=at_pole,
                cycle=cycle,
                time=time,
                direction=direction,
            )
        )
    return tuple(poses)


def wrapped(angle: Array) -> Array:
    """Return the same angle in (-pi, pi]."""
    return np.asarray(np.pi - (np.pi - angle) % (2.0 * np.pi))
