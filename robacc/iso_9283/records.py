"""Results of an evaluation after ISO 9283: figures with intervals, criteria at places, the protocol's conditions.

"Pose" is the standard's word for a commanded pose; a visit is one arrival at it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

from robacc.fitting.registration import Alignment
from robacc.geometry import Array
from robacc.iso_9283.visits import CommandedPose
from robacc.statistics.intervals import EstimateOrReason

Symbol = Literal["AP", "RP", "vAP", "AD", "RD", "dAP", "dRP", "shift", "E"]
Status = Literal["met", "not met", "unknown"]


Figure = TypeVar("Figure")


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
