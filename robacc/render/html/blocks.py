"""What a report is made of between a document and a page: numbers with their units, tables, lists, sections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from robacc.render.plots.units import DEGREE, Unit, length_unit
from robacc.render.text.numbers import decimals, fixed


@dataclass(frozen=True, slots=True)
class Number:
    """A number as it is shown, and as the JSON has it: m and rad, null where there is none."""

    text: str
    si: float | None

    def __str__(self) -> str:
        """As it is shown."""
        return self.text


Cell = str | Number


@dataclass(frozen=True, slots=True)
class Grid:
    """A table; the first cell of a row names it."""

    header: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    words: bool = False
    """Whether its cells are text rather than numbers."""
    kind: str = "grid"


@dataclass(frozen=True, slots=True)
class Listing:
    """Lines of text, each an item."""

    items: Sequence[str]
    tone: str = ""
    """``warning`` where they ask for attention."""
    kind: str = "listing"


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph."""

    text: str
    kind: str = "text"


@dataclass(frozen=True, slots=True)
class Command:
    """A line for a shell."""

    text: str
    kind: str = "command"


Block = Grid | Listing | Text | Command


@dataclass(frozen=True, slots=True)
class ReportSection:
    """A part of the page with a heading of its own."""

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True, slots=True)
class Tile:
    """One of the few numbers that matter."""

    label: str
    value: Number
    interval: str = ""
    """``0.42 … 0.53 mm (95 %)``, or why there is none."""


@dataclass(frozen=True, slots=True)
class Badge:
    """An outcome in one or two words."""

    text: str
    tone: str
    """``good``, ``bad``, ``open`` or ``plain``."""


@dataclass(frozen=True, slots=True)
class ReportHeadline:
    """The first screen of a result."""

    title: str
    story: str
    tiles: Sequence[Tile]
    badges: Sequence[Badge] = ()
    facts: Sequence[tuple[str, str]] = field(default_factory=tuple)


def shown(value: float | None, unit: Unit, low: float | None = None, high: float | None = None) -> Number:
    """A number in a unit, with as many digits as its interval leaves meaning to."""
    if value is None:
        return Number("–", None)
    scaled = [None if one is None else one * unit.factor for one in (low, high)]
    text = fixed(value * unit.factor, decimals(value * unit.factor, *scaled))
    return Number(f"{text}{_gap(unit)}{unit.name}", value)


def length(value: float | None, low: float | None = None, high: float | None = None) -> Number:
    """A length in mm, or µm where it is that small."""
    return shown(value, length_unit(*(one for one in (value, high) if one is not None)), low, high)


def angle(value: float | None, low: float | None = None, high: float | None = None) -> Number:
    """An angle in degrees."""
    return shown(value, DEGREE, low, high)


def interval(value: float | None, low: float | None, high: float | None, confidence: float, unit: Unit) -> str:
    """``0.42 … 0.53 mm (95 %)``; nothing where there is none."""
    if value is None or low is None or high is None:
        return ""
    places = decimals(value * unit.factor, low * unit.factor, high * unit.factor)
    ends = " … ".join(fixed(end * unit.factor, places) for end in (low, high))
    return f"{ends}{_gap(unit)}{unit.name} ({100 * confidence:g} %)"


def _gap(unit: Unit) -> str:
    return "" if unit.name == "°" else " "
