"""Texts of results and messages: numbers with the digits that their uncertainty supports, units, names, terminals.

Messages go to standard error and tables to standard output, in colour only on a terminal, unless NO_COLOR is set and
not empty (https://no-color.org) or TERM is ``dumb``.

A view of a result is a list of sections of tables, lists and paragraphs, which a text and a page show in the same
words: the page shows them through its template, :func:`lines_of` as text.
"""

import math
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import zip_longest
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TextIO

from robacc.errors import InputError, Note, RobaccError, by_key

Document = Mapping[str, Any]
"""A JSON result, or an object in it."""

# Parameter names in texts of the library, shown as options of the command line: the library names a parameter of a call
# in backquotes, as its signature spells it: ```align` needs `against```; on the terminal: ``--align needs --against``.

_MARKED = re.compile(r"""(?<![\w'"`/\\])`([a-z][a-z0-9_]*)(?:=("?)([^\s`"]+)\2)?`(?![\w'"`/\\])""")
"""A name in backquotes, perhaps with a value; not within quotes, where it is text of a user's file."""
NEGATIVE_OPTIONS = {"empirical": "--named-only", "robust": "--all-rows"}
"""Options that set a parameter to False and are not spelled ``--no-`` and its name."""


def as_options(text: str) -> str:
    """Return ``text`` with every parameter name in backquotes replaced by the option of that name.

    A plain name keeps its length, so lines that are wrapped already stay as they are.

    >>> as_options('`align` needs `against`; try `align="base_frame,tool_frame"` or `shrink=False`')
    '--align needs --against; try --align base_frame,tool_frame or --no-shrink'
    """
    return _MARKED.sub(_option, text)


def _option(match: re.Match[str]) -> str:
    name, value = match[1].replace("_", "-"), match[3]
    if value == "False":
        return NEGATIVE_OPTIONS.get(match[1], f"--no-{name}")
    return f"--{name}" if value in (None, "True") else f"--{name} {value}"


# Terminal output.

Style = Literal["", "bold", "dim", "green", "red", "yellow", "bold red", "bold yellow"]
_CODES = {"bold": "1", "dim": "2", "green": "32", "red": "31", "yellow": "33"}
"""Select Graphic Rendition of ECMA-48, 8.3.117."""
is_quiet = False
"""Whether notes are left out; the command line sets it."""
LISTED_ROWS = 12
"""Rows of a table of the details; the page and the JSON result have all."""
MOST_ROWS = 60
"""Rows of a table of poses, or of coefficients."""
PLAIN_WIDTH = 80
"""Columns of a table written to a file or a pipe; fits a mail, a ticket and a printed page."""


def say(text: str, style: Style = "") -> None:
    """Write a message to standard error."""
    write_lines(((line, style) for line in text.split("\n")), sys.stderr)


def say_error(error: RobaccError) -> None:
    """Write a red line for each problem, then the tips."""
    if not isinstance(error, InputError):
        say(f"error: {error}", "red")
        return
    for problem in error.problems:
        say(f"error: {f'{problem.place}: ' if problem.place else ''}{problem.message}", "red")
    if error.total > len(error.problems):
        say(f"error: … and {error.total - len(error.problems)} more problems", "red")
    for fix in dict.fromkeys(problem.fix for problem in error.problems if problem.fix):
        say(f"  tip: {fix}")


def say_warnings(warnings: Iterable[str]) -> None:
    """Write a yellow line for each warning, then a dim line for each note."""
    for text in sorted(warnings, key=lambda text: isinstance(text, Note)):
        if not isinstance(text, Note):
            say(f"warning: {text}", "yellow")
        elif not is_quiet:
            say(f"note: {text}", "dim")


@contextmanager
def warnings_below(warnings: Iterable[str]) -> Iterator[None]:
    """Write the warnings after the body, which writes the result: below a long table they stay in view.

    They are also written if the body fails, for example because the reader of the result closed the pipe.
    """
    try:
        yield
    finally:
        say_warnings(warnings)


def write_lines(lines: Iterable[tuple[str, Style]], stream: TextIO) -> None:
    """Write lines with their styles, which only a terminal shows, and with unprintable characters escaped.

    Names and texts from files reach messages and tables; an escape sequence in them could clear or rewrite the screen.
    """
    is_styled = stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
    # Spaces that Python counts as unprintable, and that do no more than a space.
    spaces = "\u00a0\u2002\u2003\u2007\u2009\u202f\u3000"
    for line, style in lines:
        text = as_options("".join(s if s.isprintable() or s in spaces else ascii(s)[1:-1] for s in line))
        codes = ";".join(_CODES[word] for word in style.split()) if is_styled else ""
        stream.write(f"\033[{codes}m{text}\033[0m\n" if codes else f"{text}\n")


# Numbers as text: as many digits as the uncertainty supports.

_DIGITS_OF_UNCERTAINTY = 2
"""Digits of an interval's half width (JCGM 100:2008, 7.2.6)."""
_DIGITS_WITHOUT = 3
"""Digits of a number of unknown uncertainty."""


def decimals(value: float, lower: float | None, upper: float | None) -> int:
    """Return the decimals of a value with the interval ``lower … upper``; three significant digits without one."""
    size, digits = (
        (0.5 * (upper - lower), _DIGITS_OF_UNCERTAINTY)
        if lower is not None and upper is not None and upper > lower
        else (abs(value), _DIGITS_WITHOUT)
    )
    if size <= 0.0 or not math.isfinite(size):
        return _DIGITS_WITHOUT
    # Rounding first makes 0.0996 count as 0.10.
    return min(max(digits - 1 - math.floor(math.log10(float(f"{size:.{digits - 1}e}"))), 0), 9)


def fixed(value: float | None, places: int) -> str:
    """Return the number with ``places`` decimals, zero without a sign; a dash for None and NaN."""
    if value is None or not math.isfinite(value):
        return "–"
    text = f"{value:.{places}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def three_digits(value: float) -> str:
    """Return three significant digits, with an exponent only for very small and very large values."""
    if 1e-4 <= abs(value) < 1e6:
        return fixed(value, decimals(value, None, None))
    return "0" if abs(value) < 1e-12 else f"{value:.2e}"


def measured(value: float, error: float) -> tuple[str, str]:
    """Return value and standard error: two digits of the error, the value to the same place (JCGM 100:2008, 7.2.6)."""
    if not (error > 0.0 and math.isfinite(error) and math.isfinite(value)):
        return f"{value + 0.0:.6g}", f"{error:g}"
    error_text = f"{error:.{_DIGITS_OF_UNCERTAINTY - 1}e}"
    place = int(error_text.partition("e")[2]) - (_DIGITS_OF_UNCERTAINTY - 1)
    if 1e-4 <= abs(float(error_text)) < 1e6:
        error_text = fixed(round(error, -place), max(-place, 0))
    size = max(abs(value), error)
    if 1e-4 <= size < 1e6:
        # A double has no more than fifteen digits, however small the error of noise-free poses.
        return fixed(round(value, -place), min(max(-place, 0), 14 - math.floor(math.log10(size)))), error_text
    digits = math.floor(math.log10(abs(value))) - place if value else -1
    if digits < 0:
        rounded = round(value * 10.0**-place)
        return ("0" if rounded == 0 else f"{rounded * 10.0**place:.0e}"), error_text
    return f"{value:.{min(digits, 14)}e}", error_text


def p_value(probability: float | None) -> str:
    """Return ``p = 0.032``, or ``p < 1e-6`` for smaller probabilities."""
    if probability is None or math.isnan(probability):
        return "–"
    return "p < 1e-6" if probability < 1e-6 else f"p = {probability:.2g}"


def counted_poses(rows: int, poses: int) -> str:
    """Return how many poses were measured, and in how many rows if these are more."""
    if rows == poses:
        return f"{rows} measured pose{'s' * (rows != 1)}"
    return f"{rows} rows of {poses} pose{'s' * (poses != 1)}"


def chance(probability: float) -> str:
    """Return a probability in whole percent, at most ``> 99 %`` and at least ``< 1 %``."""
    if probability > 0.995:
        return "> 99 %"
    return "< 1 %" if probability < 0.005 else f"{100 * probability:.0f} %"


def odds(difference: float) -> str:
    """Return the odds of an alternative whose evidence is lower by ``difference`` (log Bayes factor)."""
    # Beyond 700 the exponential overflows.
    ratio = f"{math.exp(min(abs(difference), 700.0)):.3g}"
    return f"{ratio} to 1" if difference < 0 and ratio != "1" else f"1 to {ratio}"


# Units: mm and degrees in tables, whatever the unit of the result or of the robot file; charts and headlines use one
# unit each, chosen by its largest value.

IN_MM = 1e3
IN_DEGREES = 180.0 / math.pi
QUANTITIES = (("position", "m", "mm", IN_MM), ("orientation", "rad", "°", IN_DEGREES))
"""Quantity, unit of the result, unit of tables, and the factor between them."""
STATISTICS = (("rms", "rms"), ("mean", "mean_error"), ("95th percentile", "p95"), ("maximum", "max"))
"""Names and keys of the statistics of an error's length."""


class Unit(NamedTuple):
    """A display unit."""

    factor: float
    """Displayed number = factor times SI value."""
    name: str

    def text(self, value: float | None) -> str:
        """Return three digits and the unit, of a count all digits; a dash for None and NaN."""
        if value is None or not math.isfinite(value):
            return "–"
        is_count = not self.name and float(value).is_integer()
        return f"{value:.0f}" if is_count else self.after(three_digits(value * self.factor))

    def after(self, number: str) -> str:
        """Return a number with the unit; degrees follow without a space."""
        return f"{number}{'' if self.name.startswith('°') else ' '}{self.name}".rstrip()


def unit_of(unit: str, *sizes: float) -> Unit:
    """Return the unit that tables show for an SI unit; micrometres for lengths if all ``sizes`` are below 0.02 mm.

    ``rad/(N m)`` becomes ``°/(N m)``: only the unit before the first slash or space is that of an effect's size.
    """
    match = re.fullmatch("(m|rad)([/ ].*)?", unit)
    if match is None:
        return Unit(1.0, "" if unit == "1" else unit)
    if unit == "m" and sizes and max((abs(size) for size in sizes if math.isfinite(size)), default=0.0) < 2e-5:
        return Unit(1e6, "µm")
    factor, name = (IN_MM, "mm") if match[1] == "m" else (IN_DEGREES, "°")
    return Unit(factor, name + (match[2] or ""))


# Names.


def day(date: str) -> str:
    """Return a date to the minute with its zone, or to the day at midnight."""
    return date[:10] if date.endswith("T00:00:00Z") else f"{date[:16].replace('T', ' ')} UTC"


def joint_unit(joint: Document) -> Unit:
    """Return the unit of the variable of a joint."""
    return unit_of("m" if joint["type"] == "prismatic" else "rad")


def grouped(names: Sequence[str]) -> str:
    """Return names with a common beginning together: ``tool_frame.a (roll, pitch)``."""
    parts_of_names = (name.rpartition(".") for name in names)
    members = by_key((start, last) for start, _, last in parts_of_names)
    return ", ".join(
        f"{start} ({', '.join(parts)})"
        if start and len(parts) > 1
        else ", ".join(f"{start}.{part}".lstrip(".") for part in parts)
        for start, parts in members.items()
    )


def effect_label(effect: str, joints: Sequence[str], settings: Mapping[str, Any]) -> str:
    """Return ``backlash[j3]``, ``step[base] at line 65``: the effect, its joints or the part that changes, and where.

    Masses that are fitted too are named: the same effect with the file's masses may be another finding.
    """
    part, masses = settings.get("part"), settings.get("masses", "known")
    where = ",".join(joints) if joints and part != "payload" else settings.get("target") or part
    label = f"{effect}[{where}]" if where else effect
    for key, text in (("from_line", " at line {}"), ("from_time_s", " at {:.6g} s")):
        label += text.format(settings[key]) if key in settings else ""
    return label if masses == "known" else f"{label} with {masses} masses"


# The elements of a view: sections of tables, lists and paragraphs.

Form = Literal["short", "full", "page"]
"""Form of a view: one screen of text, all of the text, or a page, which has charts, names and notes of its own."""
Line = tuple[str, Style]


class Number(NamedTuple):
    """A number as text, and its SI value from the JSON document (None without a value)."""

    text: str
    si: float | None

    def __str__(self) -> str:
        """Return the displayed text."""
        return self.text


Cell = str | Number


class Grid(NamedTuple):
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
            label = "".join(f"{cell}{' ' * (3 if self.is_ruled else 2)}" for cell in cells)
            wrapped = textwrap.wrap(row[-1], max(width - len(label), 30), break_long_words=False) or [""]
            for text in wrapped if self.is_text else [last]:
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


class Listing(NamedTuple):
    """A list of texts; empty ones are left out."""

    items: Sequence[str]
    tone: str = ""
    """``warning`` for items that need attention."""

    def lines(self, width: int) -> Iterator[Line]:
        """Yield the texts with dashes, each with a hanging indent."""
        for text in self.items:
            wrapped = textwrap.wrap(text, width, initial_indent="- ", subsequent_indent="  ", break_long_words=False)
            yield from ((line, "") for line in wrapped)


class Text(NamedTuple):
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
        lines = wrapper.wrap(self.text) if self.wraps else [self.text]
        yield from ((line, "dim" if self.is_note else "") for line in lines)


Block = Grid | Listing | Text


class Section(NamedTuple):
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


def draw(sections: Iterable[Section], stream: TextIO | None = None) -> None:
    """Write sections as text to ``stream``, or to standard output."""
    page = stream or sys.stdout
    # A terminal's columns up to 100, beyond which reading is hard.
    width = min(shutil.get_terminal_size().columns, 100) if page.isatty() else PLAIN_WIDTH
    write_lines(lines_of(sections, width), page)
    page.flush()


def shown(sections: Iterable[Section]) -> Iterator[Section]:
    """Yield the sections that have a line besides their heading, or are no more than a heading."""
    for section in sections:
        filled = [block for block in section.blocks or () if any(block.lines(PLAIN_WIDTH))]
        if filled or section.blocks is None:
            yield section._replace(blocks=filled)


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
    shown = unit_of(unit, value)
    ends = (
        f"{shown.after(interval(value, shown.factor, bounds))} ({100 * bounds['confidence']:g} %)"
        if bounds["lower"] is not None and bounds["upper"] is not None
        else ""
    )
    return Tile(label, amount(value, unit, bounds), "; ".join(filter(None, (ends, note))))


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
            sum(each.get("power") or 0.0 for each in entries) / len(entries),
        )
        for name in dict.fromkeys(limit["effect"] for limit in limits)
        for entries in [[limit for limit in limits if limit["effect"] == name]]
    ]
