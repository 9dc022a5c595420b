"""The elements of a view: sections of tables, lists and paragraphs, which a text and a page show in the same words.

The page shows them through its template, :func:`lines_of` as text.
"""

from __future__ import annotations

import statistics
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, TextIO

from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import (
    BLANK,
    DEGREE,
    Document,
    Style,
    TextLine,
    Unit,
    columns,
    decimals,
    error_unit,
    fixed,
    items,
    length_unit,
    table_unit,
    three_digits,
    with_table_unit,
    wrapped,
)


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
    """True if the cells are text rather than numbers; the last one may be long."""
    note: str = ""
    """Below the table of a chart: which rows are omitted."""
    left: Sequence[int] = (0,)
    """Places of the columns of numbers that a text aligns left."""
    is_ruled: bool = False
    """True if a text has a rule below the header."""
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
    is_note: bool = False
    """True if it explains a table."""
    wraps: bool = True
    """False if it stays in one line, as names of files do."""
    kind: str = "text"


@dataclass(frozen=True, slots=True)
class Command:
    """A shell command."""

    text: str
    kind: str = "command"


Block = Grid | Listing | Text | Command


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a view with a heading."""

    title: str
    blocks: Iterable[Block]
    style: Style = "bold"
    """Of the heading on a terminal."""


@dataclass(frozen=True, slots=True)
class EffectFamily:
    """Detection limits of one effect over its joints and forms."""

    name: str
    entries: Sequence[Mapping[str, Any]]
    """All entries, also those that are never found."""
    known: Sequence[Mapping[str, Any]]
    """Entries with a limit, the least first."""
    power: float
    """Mean probability that the usual size is found."""


def effect_families(document: Document) -> list[EffectFamily]:
    """Return the detection limits of a result by effect."""
    by_name: dict[str, list[Mapping[str, Any]]] = {}
    for limit in document["detection_limits"] or ():
        by_name.setdefault(limit["effect"], []).append(limit)
    return [
        EffectFamily(
            name,
            entries,
            sorted((each for each in entries if each["limit"] is not None), key=lambda each: each["limit"]),
            statistics.mean(each.get("power") or 0.0 for each in entries),
        )
        for name, entries in by_name.items()
    ]


def draw(sections: Iterable[Section], stream: TextIO) -> None:
    """Write sections as text to ``stream``."""
    write_lines(lines_of(sections, width_of(stream)), stream)


def lines_of(sections: Iterable[Section], width: int) -> Iterator[TextLine]:
    """Return sections as lines; running text is wrapped to ``width`` columns."""
    for number, section in enumerate(sections):
        if number:
            yield BLANK
        if section.title:
            yield TextLine(section.title, section.style)
        after_table = False
        for block in section.blocks:
            if after_table and isinstance(block, Grid):
                yield BLANK
            yield from _lines(block, width)
            after_table = isinstance(block, Grid)


def _lines(block: Block, width: int) -> Iterator[TextLine]:
    if isinstance(block, Listing):
        yield from items(block.items, width)
    elif isinstance(block, Grid):
        rows = [[str(cell) for cell in row] for row in block.rows]
        if block.is_ruled:
            head, *lines = columns(block.header, rows, 3, block.left)
            rule = "─" * max(len(line.text) for line in (head, *lines))
            yield from (BLANK, TextLine(f" {head.text}", "bold"), TextLine(f" {rule}"))
            yield from (TextLine(f" {line.text}") for line in lines)
        elif rows:
            texts = _texts_in_columns([block.header, *rows], width)
            yield from texts if block.is_text else columns(block.header, rows, left=block.left)
    elif isinstance(block, Text) and block.wraps:
        yield from (TextLine(line.text, "dim" if block.is_note else "") for line in wrapped(block.text, width))
    else:
        yield TextLine(block.text)


def _texts_in_columns(rows: Sequence[Sequence[str]], width: int) -> Iterator[TextLine]:
    """Return a table aligned left, its last column wrapped."""
    widths = [max(map(len, cells)) for cells in zip(*(row[:-1] for row in rows), strict=True)]
    for number, row in enumerate(rows):
        if not any(row):
            continue
        label = "".join(f"{cell:<{longest}}  " for cell, longest in zip(row, widths, strict=False))
        for text in textwrap.wrap(row[-1], max(width - len(label), 30), break_long_words=False) or [""]:
            yield TextLine(f"{label}{text}".rstrip(), "" if number else "dim")
            label = " " * len(label)


# Numbers of tables, in mm and degrees: their heads name the unit, and their digits follow the interval.


def number(value: float | None, factor: float = 1.0, bounds: Mapping[str, Any] = MappingProxyType({})) -> Number:
    """Return ``factor`` times a value, with the digits that ``lower`` and ``upper`` of ``bounds`` support."""
    if value is None:
        return Number("–", None)
    low, high = bounds.get("lower"), bounds.get("upper")
    if low is None or high is None:
        return Number(three_digits(value * factor), value)
    return Number(fixed(value * factor, _places(value, low, high, factor)), value)


def interval(value: float | None, factor: float, bounds: Mapping[str, Any]) -> str:
    """Return ``0.42 … 0.53``, ``at least 0.42`` without an upper bound, or a dash."""
    low, high = bounds["lower"], bounds["upper"]
    if value is None or low is None:
        return "–"
    if high is None:
        return f"at least {three_digits(low * factor)}"
    return " … ".join(fixed(end * factor, _places(value, low, high, factor)) for end in (low, high))


def measured_cells(value: float | None, factor: float, bounds: Mapping[str, Any]) -> tuple[Number, str]:
    """Return a value and its interval."""
    return number(value, factor, bounds), interval(value, factor, bounds)


def with_unit(value: float, unit: str) -> Number:
    """Return a value of an SI unit in mm or degrees with its unit, three digits."""
    factor, name = table_unit(unit)
    return Number(with_table_unit(three_digits(value * factor), name), value)


def percent(confidence: float) -> str:
    """Return ``95 % interval``, the head of a column."""
    return f"{100 * confidence:g} % interval"


def _places(value: float, low: float, high: float, factor: float) -> int:
    return decimals(value * factor, low * factor, high * factor)


# Numbers with their units, for headlines and sentences.


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


def length(value: float | None) -> Number:
    """Return a length in mm, or in µm if it is small."""
    return _quantity(value, length_unit(*(() if value is None else (value,))), {})


def angle(value: float | None) -> Number:
    """Return an angle in degrees."""
    return _quantity(value, DEGREE, {})


def tile(label: str, value: float, unit: str, bounds: Mapping[str, Any], note: str = "") -> Tile:
    """Return the tile of a figure in ``m`` or ``rad`` with its interval, then ``note``."""
    shown, low, high = error_unit(unit, value), bounds.get("lower"), bounds.get("upper")
    text = ""
    if low is not None and high is not None:
        ends = interval(value, shown.factor, bounds)
        text = f"{with_table_unit(ends, shown.name)} ({100 * bounds['confidence']:g} %)"
    return Tile(label, _quantity(value, shown, bounds), "; ".join(part for part in (text, note) if part))


def _quantity(value: float | None, unit: Unit, bounds: Mapping[str, Any]) -> Number:
    shown = number(value, unit.factor, bounds)
    return shown if value is None else Number(with_table_unit(shown.text, unit.name), value)


# The robot of a result in titles.


def robot_name(document: Document) -> str | None:
    """Return the robot's name from its file, None without a robot."""
    robot = document.get("robot")
    return None if robot is None else str(robot["name"])


def of_robot(document: Document) -> str:
    """Return ``of`` and the robot's name, to follow a title; empty without a robot."""
    name = robot_name(document)
    return "" if name is None else f" of {name}"
