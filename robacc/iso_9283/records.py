"""What an evaluation after ISO 9283 consists of: figures with intervals, criteria at places, the protocol's conditions.

"Pose" is the standard's word for what a robot is sent to; a visit is one measurement of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from robacc.fitting.registration import Alignment
from robacc.geometry import Array
from robacc.iso_9283.visits import CommandedPose
from robacc.statistics.intervals import Interval

Symbol = Literal["AP", "RP", "vAP", "AD", "RD", "dAP", "dRP", "shift", "E"]
Status = Literal["met", "not met", "unknown"]


@dataclass(frozen=True, slots=True)
class CriterionFigure:
    """A number, m or rad, and its interval; where there is no number, the interval says why."""

    value: float | None
    interval: Interval

    @classmethod
    def missing(cls, confidence: float, why: str) -> CriterionFigure:
        """No number, and the reason."""
        return cls(None, Interval.missing(confidence, why))


@dataclass(frozen=True, slots=True)
class IsoCriterion:
    """One criterion at one place: a commanded pose, or a pair of them."""

    poses: tuple[str, ...]
    source: str | None
    """Name of the file; None where the criterion is over several."""
    n: int
    """Visits, or pairs of them, that it rests on."""
    position: CriterionFigure
    """m"""
    axes: tuple[CriterionFigure, ...] | None = None
    """The parts along x, y, z of the measuring frame, m, where the standard has them."""
    angles: tuple[CriterionFigure, ...] | None = None
    """a, b, c: rad."""
    mean_distance: float | None = None
    """RP: mean distance of the visits from their barycentre, m."""
    sd_distance: float | None = None
    """RP: standard deviation S_l of that distance, m."""
    between: str | None = None
    """Which two approaches, windows or files are furthest apart."""


@dataclass(frozen=True, slots=True)
class Characteristic:
    """One criterion over all places: its largest value, and every place's."""

    symbol: Symbol
    clause: str
    """Of ISO 9283:1998."""
    position: CriterionFigure
    """The largest, m; of a signed criterion the largest size."""
    position_at: str | None
    """The place of the largest."""
    angle: CriterionFigure
    """The largest of a, b, c, rad."""
    angle_at: str | None
    """Its place and letter."""
    places: tuple[IsoCriterion, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Condition:
    """One condition of the standard's protocol, and whether the data meet it."""

    name: str
    clause: str
    status: Status
    why: str


@dataclass(frozen=True, slots=True)
class Iso9283Result:
    """Everything ``robacc iso9283`` says."""

    n_poses: int
    """Measured poses (rows) of all files."""
    sources: tuple[str, ...]
    """Name of each file."""
    commanded: Literal["robot", "file"] | None
    """What says where the target was to be; None: nothing does."""
    poses: tuple[CommandedPose, ...]
    characteristics: tuple[Characteristic, ...]
    """In the standard's order; those that the data cannot support have no number and say why."""
    protocol: tuple[Condition, ...]
    alignments: tuple[Alignment, ...]
    """One a file, where an alignment was asked for."""
    unaligned: Array | None
    """``(files,)`` the largest AP before the alignment, m."""
    confidence: float
    notes: tuple[str, ...]
    warnings: tuple[str, ...]

    def characteristic(self, symbol: Symbol) -> Characteristic:
        """The one of that symbol."""
        return next(one for one in self.characteristics if one.symbol == symbol)
