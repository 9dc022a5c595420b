"""Robot program as this package sees it: its text, its targets, its motions, and what a computation would need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

from robacc.programs.conventions import Convention
from robacc.programs.source import ProgramSource
from robacc.robots.description import Frame

TargetKind = Literal["joint", "cartesian"]
MotionType = Literal["joint", "linear", "circular", "other"]


class Dialect(StrEnum):
    """Language of a robot program."""

    krl = "krl"
    rapid = "rapid"
    fanuc = "fanuc"
    urscript = "urscript"
    val3 = "val3"


@dataclass(frozen=True, slots=True)
class ProgramFrame:
    """Tool or base frame that a program names."""

    name: str
    """Name or number in the program: ``tGripper``, ``1``; empty where the program sets a frame without a name."""
    frame: Frame | None
    """Tool in the flange's frame, or base in the robot's base frame; None where the program does not contain it."""


@dataclass(frozen=True, slots=True)
class ProgramNumber:
    """Number of a target, and its place in the text."""

    start: int
    end: int
    value: float
    """Value in the program's unit."""
    unit: float
    """Size of the program's unit in m, rad or 1."""


@dataclass(frozen=True, slots=True)
class ProgramTarget:
    """Target that is written in the program as numbers."""

    name: str
    """Name in the program; ``line 12`` for a target without a name."""
    line: int
    """1-based line of its first number."""
    kind: TargetKind
    values: tuple[float, ...]
    """Joint target: joint variables, rad (m for a joint in mm), as the program counts them. Cartesian target:
    x, y, z (m) and the quaternion w, x, y, z of the tool in the base frame of the target."""
    convention: Convention
    numbers: tuple[ProgramNumber, ...]
    """Numbers in the order of the program's components."""
    configuration: str = ""
    """Configuration of a Cartesian target, as written: ``S 2,T 10``, ``[0,-1,0,0]``, ``N U T, 0, 0, 0``."""
    tool: ProgramFrame | None = None
    """Tool of its motions; None where none is named, or where its motions name several."""
    base: ProgramFrame | None = None
    """Base frame (work object, user frame) of its motions; None as for ``tool``."""
    motion: MotionType | None = None
    """Type of its motions; None without a motion in the files read, or with several types."""
    external: str = ""
    """External axes, as written; they are left alone."""


@dataclass(frozen=True, slots=True)
class ProgramMove:
    """Motion instruction to a target, in the order of the text."""

    line: int
    target: int
    """Index of the target in ``Program.targets``."""
    motion: MotionType
    tool: ProgramFrame | None = None
    base: ProgramFrame | None = None


@dataclass(frozen=True, slots=True)
class ProgramNote:
    """Part of the program that is left as it is, and the reason."""

    line: int
    text: str
    """Excerpt of the program."""
    reason: str


@dataclass(frozen=True, slots=True)
class Program:
    """Robot program that was read."""

    file: str
    dialect: Dialect
    source: ProgramSource
    targets: tuple[ProgramTarget, ...]
    moves: tuple[ProgramMove, ...]
    """Motions to ``targets`` in the order of the text; loops and branches are not followed."""
    notes: tuple[ProgramNote, ...] = ()
    """Everything that the program computes at run time or that the reader does not know, by line."""
    tools: Mapping[str, Frame] = field(default_factory=dict)
    """Tools that the files define, by name."""
    bases: Mapping[str, Frame] = field(default_factory=dict)
    """Base frames that the files define, by name."""

    @property
    def text(self) -> str:
        """Text of the program; bytes of an 8-bit encoding appear as the characters of the same numbers."""
        return self.source.text

    @property
    def encoding(self) -> str:
        """Encoding of the file: ``utf-8``, ``utf-16-le``, ``utf-16-be``, or ``8-bit`` for other code pages."""
        return self.source.encoding
