"""The elements of a view: sections of tables, lists and paragraphs, which a text and a page show in the same words.

The page shows them through its template, :func:`lines_of` as text.
"""

from __future__ import annotations

import statistics
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TextIO

from robacc.render.text import (
    PLAIN_WIDTH,
    STATISTICS,
    Document,
    Style,
    decimals,
    fixed,
    measured,
    three_digits,
    unit_of,
    width_of,
    write_lines,
)

Form = Literal["short", "full", "page"]
"""Form of a view: one screen of text, all of the text, or a page, which has charts, names and notes of its own."""
Line = tuple[str, Style]


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

    def lines(self, width: int) -> Iterator[Line]:
        """Yield the table as text, the last column of texts wrapped; nothing without a row."""
        table = [[*map(str, row)] for row in (self.header, *self.rows)] if self.rows else []
        widths = [max(map(len, cells)) for cells in zip_longest(*table, fillvalue="")]
        lines: list[Line] = []
        for row in filter(any, table):
            *cells, last = (
                f"{cell:{'<' if self.is_text or place in self.left else '>'}{widths[place]}}"
                for place, cell in enumerate(row)
            )
            label, texts = "".join(f"{cell}{' ' * (3 if self.is_ruled else 2)}" for cell in cells), [last]
            if self.is_text:
                texts = textwrap.wrap(row[-1], max(width - len(label), 30), break_long_words=False) or [""]
            for text in texts:
                lines.append((f"{label}{text}".rstrip(), "dim" if row is table[0] else ""))
                label = " " * len(label)
        if self.is_ruled and lines:
            rule = " " + "─" * max(len(text) for text, _ in lines)
            lines = [("", ""), (f" {lines[0][0]}", "bold"), (rule, ""), *[(f" {text}", "") for text, _ in lines[1:]]]
        yield from lines


def grid(header: Sequence[str | None], rows: Iterable[Sequence[Cell]], **looks: Any) -> Grid:
    """Return a table of the columns that have a head: None leaves out a column, whose cells the rows have."""
    return Grid(
        [head for head in header if head is not None],
        [[cell for head, cell in zip(header, row, strict=False) if head is not None] for row in rows],
        **looks,
    )


@dataclass(frozen=True, slots=True)
class Listing:
    """A list of texts; empty ones are left out."""

    items: Sequence[str]
    tone: str = ""
    """``warning`` for items that need attention."""

    def lines(self, width: int) -> Iterator[Line]:
        """Yield the texts with dashes, each with a hanging indent."""
        for text in self.items:
            wrapped = textwrap.wrap(text, width, initial_indent="- ", subsequent_indent="  ", break_long_words=False)
            yield from ((line, "") for line in wrapped)


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph."""

    text: str
    is_note: bool = False
    """True if it explains a table."""
    wraps: bool = True
    """False if it stays in one line, as names of files do."""
    is_command: bool = False

    def lines(self, width: int) -> Iterator[Line]:
        """Yield the paragraph, all of its lines indented like its first."""
        indent = self.text[: len(self.text) - len(self.text.lstrip())]
        wrapper = textwrap.TextWrapper(width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
        for line in wrapper.wrap(self.text) if self.wraps else [self.text]:
            yield line, "dim" if self.is_note else ""


Block = Grid | Listing | Text


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a view with a heading; without a filled block it is left out, unless it is a heading alone."""

    title: str
    blocks: Iterable[Block] | None = None
    """None of a heading alone."""
    style: Style = "bold"
    """Of the heading on a terminal."""


class Tile(NamedTuple):
    """A key figure of the headline."""

    label: str
    value: Number
    interval: str = ""
    """``0.42 … 0.53 mm (95 %)``, or why it is missing."""


class ReportHeadline(NamedTuple):
    """The first screen of a result: title, summary, key figures, facts."""

    title: str
    summary: str
    tiles: Sequence[Tile]
    badges: Sequence[tuple[str, str]] = ()
    """Short outcomes, with their tones: ``good``, ``bad``, ``open`` or ``plain``."""
    facts: Sequence[tuple[str, str]] = ()
    """Those without a text are left out."""


def draw(sections: Iterable[Section], stream: TextIO) -> None:
    """Write sections as text to ``stream``."""
    write_lines(lines_of(sections, width_of(stream)), stream)


def shown(sections: Iterable[Section]) -> Iterator[Section]:
    """Yield the sections that have a line besides their heading, or are no more than a heading."""
    for section in sections:
        filled = [block for block in section.blocks or () if any(block.lines(PLAIN_WIDTH))]
        if filled or section.blocks is None:
            yield replace(section, blocks=filled)


def lines_of(sections: Iterable[Section], width: int) -> Iterator[Line]:
    """Return sections as lines; running text is wrapped to ``width`` columns."""
    for number, section in enumerate(shown(sections)):
        if number:
            yield "", ""
        if section.title:
            yield section.title, section.style
        previous: Block | None = None
        for block in section.blocks or ():
            if isinstance(previous, Grid) and isinstance(block, Grid):
                yield "", ""
            yield from block.lines(width)
            previous = block


# Numbers of tables, in mm and degrees: their heads name the unit, and their digits follow the interval.

UNBOUNDED: Document = MappingProxyType({"lower": None, "upper": None})


def number(value: float | None, factor: float = 1.0, bounds: Document = UNBOUNDED) -> Number:
    """Return ``factor`` times a value, with the digits that ``lower`` and ``upper`` of ``bounds`` support."""
    if value is None:
        return Number("–", None)
    if bounds["lower"] is None or bounds["upper"] is None:
        return Number(three_digits(value * factor), value)
    return Number(
        fixed(value * factor, decimals(value * factor, bounds["lower"] * factor, bounds["upper"] * factor)), value
    )


def interval(value: float | None, factor: float, bounds: Document) -> str:
    """Return ``0.42 … 0.53``, ``at least 0.42`` without an upper bound, or a dash."""
    low, high = bounds["lower"], bounds["upper"]
    if value is None or low is None:
        return "–"
    if high is None:
        return f"at least {three_digits(low * factor)}"
    places = decimals(value * factor, low * factor, high * factor)
    return f"{fixed(low * factor, places)} … {fixed(high * factor, places)}"


def measured_cells(value: float | None, factor: float, bounds: Document) -> tuple[Number, str]:
    """Return a value and its interval."""
    return number(value, factor, bounds), interval(value, factor, bounds)


def statistics_cells(part: Document, unit: str, factor: float) -> list[Number]:
    """Return rms, mean, 95th percentile and maximum of an error."""
    return [number(part[f"{key}_{unit}"], factor) for _, key in STATISTICS]


def with_error(value: float, error: float | None, factor: float, sign: str = "") -> tuple[Number, Number]:
    """Return a value and its standard error, with the digits that the error supports."""
    if error is None:
        return Number(f"{three_digits(value * factor)}{sign}", value), Number("–", None)
    size, std = measured(value * factor, error * factor)
    return Number(f"{size}{sign}", value), Number(f"{std}{sign}", error)


def coefficients(parameters: Iterable[Document]) -> Grid:
    """Return name, value, standard error and unit of the identifiable coefficients."""
    return Grid(
        ("name", "value", "standard error", "unit"),
        [
            (parameter["name"], *with_error(parameter["value"], parameter["std"], factor), unit)
            for parameter in parameters
            if parameter["std"] is not None
            for factor, unit in [unit_of(parameter["unit"])]
        ],
    )


def parameter_tables(parameters: Sequence[Document]) -> list[Block]:
    """Return the coefficients with their standard errors, and the reasons of those that are not identifiable."""
    return [
        coefficients(parameters),
        Grid(
            ("not identifiable", "reason"),
            [(p["name"], str(p.get("why", ""))) for p in parameters if p["std"] is None],
            is_text=True,
        ),
    ]


def with_unit(value: float, unit: str = "m") -> Number:
    """Return a value of an SI unit in mm or degrees with its unit, three digits."""
    return Number(unit_of(unit).text(value), value)


def first_of(texts: Sequence[str], most: int, others: str) -> list[str]:
    """Return the first texts, and how many ``others`` there are."""
    return [*texts[:most], *([f"and {len(texts) - most} {others}"] if len(texts) > most else [])]


def named_by_text(entries: Iterable[tuple[str, str]]) -> list[str]:
    """Return ``NAME, NAME: TEXT`` for each text of ``entries``, each a name and a text."""
    names: dict[str, dict[str, None]] = {}
    for name, text in entries:
        names.setdefault(text, {})[name] = None
    return [f"{', '.join(own)}: {text}" for text, own in names.items()]


def percent(confidence: float) -> str:
    """Return ``95 % interval``, the head of a column."""
    return f"{100 * confidence:g} % interval"


# Numbers with their units, for headlines and sentences.


def amount(value: float | None, unit: str = "m", bounds: Document = UNBOUNDED) -> Number:
    """Return a length in mm, or in µm if it is small, or an angle (``rad``) in degrees."""
    shown = unit_of(unit, value or 0.0)
    cell = number(value, shown.factor, bounds)
    return cell if value is None else Number(shown.after(cell.text), value)


def tile(label: str, value: float, unit: str, bounds: Document, note: str = "") -> Tile:
    """Return the tile of a figure in ``m`` or ``rad`` with its interval, then ``note``."""
    shown, text = unit_of(unit, value), ""
    if bounds["lower"] is not None and bounds["upper"] is not None:
        text = f"{shown.after(interval(value, shown.factor, bounds))} ({100 * bounds['confidence']:g} %)"
    return Tile(label, amount(value, unit, bounds), "; ".join(part for part in (text, note) if part))


def of_robot(document: Document) -> str:
    """Return ``of`` and the robot's name from its file, to follow a title; empty without a robot."""
    robot = document.get("robot")
    return "" if robot is None else f" of {robot['name']}"


class EffectFamily(NamedTuple):
    """Detection limits of one effect over its joints and forms."""

    name: str
    entries: Sequence[Document]
    """All entries, also those that are never found."""
    known: Sequence[Document]
    """Entries with a limit, the least first."""
    power: float
    """Mean probability that the usual size is found."""

    def cells(self, named: bool = False) -> tuple[str, str, str, str]:
        """Return name, lowest and highest limit, perhaps with their joints, and unit of an effect with a limit."""
        ends, unit = (self.known[0], self.known[-1]), unit_of(self.known[0]["unit"])
        low, high = (f"{unit.factor * e['limit']:.1e} {','.join(e['joints']) * named}".rstrip() for e in ends)
        return self.name, low, high * (len(self.known) > 1), unit.name


def effect_families(document: Document) -> list[EffectFamily]:
    """Return the detection limits of a result by effect."""
    limits = document["detection_limits"] or ()
    return [
        EffectFamily(
            name,
            entries,
            sorted((each for each in entries if each["limit"] is not None), key=lambda each: each["limit"]),
            statistics.mean(each.get("power") or 0.0 for each in entries),
        )
        for name in dict.fromkeys(limit["effect"] for limit in limits)
        for entries in [[limit for limit in limits if limit["effect"] == name]]
    ]
