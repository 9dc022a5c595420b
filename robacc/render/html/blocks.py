"""The parts of an HTML report: numbers with their units, tables, lists, sections, titles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from robacc.render.plots.canvas import DEGREE, Document, Unit, length_unit
from robacc.render.text.layout import decimals, fixed


@dataclass(frozen=True, slots=True)
class Number:
    """A number as text, and its SI value from the JSON document (None without a value)."""

    text: str
    si: float | None

    def __str__(self) -> str:
        """Return the displayed text."""
        return self.text


Cell = str | Number


@dataclass(frozen=True, slots=True)
class Grid:
    """A table; the first cell of a row is its label."""

    header: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    is_text: bool = False
    """True if the cells are text rather than numbers."""
    kind: str = "grid"


@dataclass(frozen=True, slots=True)
class Listing:
    """A list of texts."""

    items: Sequence[str]
    tone: str = ""
    """``warning`` for items that need attention."""
    kind: str = "listing"


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph."""

    text: str
    kind: str = "text"


@dataclass(frozen=True, slots=True)
class Command:
    """A shell command."""

    text: str
    kind: str = "command"


Block = Grid | Listing | Text | Command


@dataclass(frozen=True, slots=True)
class ReportSection:
    """A section of the page with a heading."""

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True, slots=True)
class Tile:
    """A key figure of the headline."""

    label: str
    value: Number
    interval: str = ""
    """``0.42 … 0.53 mm (95 %)``, or why it is missing."""


@dataclass(frozen=True, slots=True)
class Badge:
    """A short outcome with its colour."""

    text: str
    tone: str
    """``good``, ``bad``, ``open`` or ``plain``."""


@dataclass(frozen=True, slots=True)
class ReportHeadline:
    """The first screen of a result: title, summary, key figures, facts."""

    title: str
    summary: str
    tiles: Sequence[Tile]
    badges: Sequence[Badge] = ()
    facts: Sequence[tuple[str, str]] = field(default_factory=tuple)


def quantity(value: float | None, unit: Unit, low: float | None = None, high: float | None = None) -> Number:
    """Return a number in ``unit`` with the digits that its interval supports."""
    if value is None:
        return Number("–", None)
    scaled = [None if bound is None else bound * unit.factor for bound in (low, high)]
    text = fixed(value * unit.factor, decimals(value * unit.factor, *scaled))
    return Number(f"{text}{_gap(unit)}{unit.name}", value)


def length(value: float | None, low: float | None = None, high: float | None = None) -> Number:
    """Return a length in mm, or in µm if it is small."""
    return quantity(value, length_unit(*(size for size in (value, high) if size is not None)), low, high)


def angle(value: float | None, low: float | None = None, high: float | None = None) -> Number:
    """Return an angle in degrees."""
    return quantity(value, DEGREE, low, high)


def interval(value: float | None, low: float | None, high: float | None, confidence: float, unit: Unit) -> str:
    """Return ``0.42 … 0.53 mm (95 %)``; an empty text without an interval."""
    if value is None or low is None or high is None:
        return ""
    places = decimals(value * unit.factor, low * unit.factor, high * unit.factor)
    ends = " … ".join(fixed(end * unit.factor, places) for end in (low, high))
    return f"{ends}{_gap(unit)}{unit.name} ({100 * confidence:g} %)"


def _gap(unit: Unit) -> str:
    return "" if unit.name == "°" else " "


# The robot of a result in titles.


def robot_name(document: Document) -> str | None:
    """Return the robot's name from its file, None without a robot."""
    robot = document.get("robot")
    return None if robot is None else str(robot["name"])


def of_robot(document: Document) -> str:
    """Return ``of`` and the robot's name, to follow a title; empty without a robot."""
    name = robot_name(document)
    return "" if name is None else f" of {name}"
