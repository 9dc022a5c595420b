"""Read a text table as columns of numbers and text, with every problem found in one pass.

:func:`numpy.loadtxt` parses a block of lines. A block that it refuses, or that has a value that is not finite, is
parsed field by field to locate each problem.
"""

from __future__ import annotations

import csv
import itertools
import math
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem
from robacc.geometry import Array
from robacc.io.bag_options import NO_BAG_OPTIONS, BagOptions
from robacc.io.dialect import (
    GAPS,
    PLAIN,
    TableDialect,
    advice,
    find_dialect,
    is_grouped,
    number_of,
    split_cell,
    units_of_columns,
)
from robacc.io.files import ProblemLog, clip
from robacc.io.lines import Block, LineReader

# The header row of a text table: one name a column.

MAX_COLUMNS = 2000
"""Largest number of columns of a table."""


def header_names(line: str, number: int, file: str) -> tuple[str, ...]:
    """Return the names of the header row.

    Raises:
        InputError: The line is not a header row.
    """

    def error_of(message: str, fix: str) -> InputError:
        return InputError(Problem(message, file, number, fix=fix))

    if line.count(",") >= MAX_COLUMNS:
        raise error_of(f"found {line.count(',') + 1} columns", f"expected at most {MAX_COLUMNS}")
    try:
        names = tuple(PLAIN.split(line))
    except csv.Error as error:
        raise error_of(f"the header row cannot be read ({error})", "close every quote on its line") from error
    for separator, separator_name in ((";", "semicolons"), ("\t", "tabs"), (" ", "spaces")):
        if line.strip().count(separator) >= len(names) and (separator != " " or len(names) == 1):
            message = f"the columns are separated by {separator_name}, expected commas"
            raise error_of(message, "export the file with commas, and with a point in decimals")
    if all(_is_number(name) for name in names):
        raise error_of("found numbers, expected a header row", "begin the file with the columns' names")
    return names


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


# Columns of numbers that grow while a file is read.


class GrowingColumns:
    """``(C, N)`` numbers in one array, where N is known only at the end of the file.

    The array grows to the size that the share of the file read so far suggests. Pages that are never written cost
    nothing, while joining parts at the end would touch all of the memory twice.
    """

    def __init__(self, n_columns: int) -> None:
        """Begin with no rows of ``n_columns`` numbers."""
        self._numbers = np.empty((n_columns, 0))
        self._size = 0

    def append(self, part: Array, share: float) -> None:
        """Add rows; ``share`` is the share of the file (0 to 1) read so far."""
        end = self._size + part.shape[1]
        if end > self._numbers.shape[1]:
            larger = np.empty((len(part), max(int(end / share * 1.02), end)))
            larger[:, : self._size] = self._numbers[:, : self._size]
            self._numbers = larger
        self._numbers[:, self._size : end] = part
        self._size = end

    def columns(self) -> Array:
        """Return the numbers; each column is contiguous."""
        return self._numbers[:, : self._size]


# Parts of a table that a reader returns, whatever form the table has: names of columns, rows, and the options.

MAX_TEXT = 256
"""Characters of an id; text columns are as wide as their longest entry."""


@dataclass(frozen=True, slots=True)
class TableOptions:
    """Freedom that a reader has."""

    is_known: Callable[[str], bool] | None = None
    """Whether a name is a documented one; None: only the documented form of a table is read."""
    skip_gaps: bool = False
    """Leave out rows with a missing value, in place of a problem for each."""
    sheet: str | None = None
    """Sheet of a workbook; None for its only sheet."""
    bag: BagOptions = NO_BAG_OPTIONS
    """Topics and samples of a recording."""
    frame: Any = None
    """Data frame that is read in place of a file."""


@dataclass(frozen=True, slots=True)
class Header:
    """Names that a file gives its columns."""

    names: tuple[str, ...]
    line: int | None
    """1-based line of the names; None where the file has no lines."""
    dialect: TableDialect = PLAIN
    """Form of the table, where it is not the documented one."""
    cell_units: Mapping[int, str] = field(default_factory=dict)
    """Units behind the numbers of the cells, by the index of the column."""


@dataclass(frozen=True, slots=True)
class TableBody:
    """Rows below the header."""

    numbers: Array
    """``(C, N)`` columns of numbers; NaN where a problem was logged."""
    texts: tuple[NDArray[np.str_], ...]
    """Columns of text, ``(N,)`` each."""
    lines: NDArray[np.int64]
    """``(N,)`` 1-based line of each row, or its row number where the file has no lines."""
    gaps: tuple[int, ...] = ()
    """Lines of the rows that were left out because a value is missing."""
    cut: str = ""
    """Warning of a last row that may have been cut off."""

    def without(self, gaps: Collection[int]) -> TableBody:
        """Return the rows that are not on the lines ``gaps``."""
        if not gaps:
            return self
        complete = ~np.isin(self.lines, list(gaps))
        texts = tuple(column[complete] for column in self.texts)
        return TableBody(self.numbers[:, complete], texts, self.lines[complete], tuple(sorted(gaps)), self.cut)


# Read the cells of a table one by one, where its rows are not plain numbers; every problem is logged.

_SKIP = "give `skip_gaps` to leave out rows with a missing value"


class CellReader:
    """Reader of the cells of one table."""

    def __init__(self, dialect: TableDialect, units: Mapping[int, str], skip_gaps: bool, log: ProblemLog) -> None:
        """Read cells whose columns of the indices ``units`` have these units; problems go to ``log``."""
        self.dialect = dialect
        self.units = units
        self.skip_gaps = skip_gaps
        self.log = log
        self.gaps: set[int] = set()
        """Lines with a missing value that are left out."""
        self.has_grouped = False
        """Whether a number had separators of thousands."""

    def number(self, cell: str, line: int, index: int, column: str) -> float:
        """Return the number in a cell of the column with this index and name; NaN where there is none."""
        return self._number(self._bare(cell, line, index, column), line, column)

    def text(self, cell: str, line: int, column: str) -> str:
        """Return the text in a cell, cut to the greatest length."""
        if not cell:
            self.log.add("the value is missing, expected text", line, column)
        elif len(cell) > MAX_TEXT:
            self.log.add(f"the text has {len(cell)} characters, expected at most {MAX_TEXT}", line, column)
        return cell[:MAX_TEXT]

    def _bare(self, cell: str, line: int, index: int, column: str) -> str:
        """Return a cell without its unit; log a unit that is not the column's."""
        if index not in self.units or not any(sign.isdecimal() for sign in cell):
            return cell
        expected, (number, unit) = self.units[index], split_cell(cell)
        if unit is not None and unit != expected:
            fix = "export the column in one unit"
            self.log.add(f"found {clip(cell)}, but the first cell is in {expected}", line, column, fix)
        elif unit is None and number_of(number, self.dialect.decimal_comma) is not None:
            fix = f"export every cell with its unit, or none and {expected} in the column's name"
            self.log.add(f"found {clip(cell)} without the unit {expected}", line, column, fix)
        return number

    def _number(self, cell: str, line: int, column: str) -> float:
        if self.skip_gaps and cell.lower() in GAPS:
            self.gaps.add(line)
            return math.nan
        if not cell:
            self.log.add("the value is missing, expected a number", line, column, _SKIP)
            return math.nan
        value = number_of(cell, self.dialect.decimal_comma)
        if value is None:
            fix = _SKIP if cell.lower() in GAPS else advice(cell, column, self.dialect.decimal_comma)
            self.log.add(f"found {clip(cell)}, expected a number", line, column, fix)
            return math.nan
        self.has_grouped |= is_grouped(cell, self.dialect.decimal_comma)
        if not math.isfinite(value):
            fix = _SKIP if cell.lower() in GAPS else None
            self.log.add(f"found {clip(cell)}, expected a finite number", line, column, fix)
            return math.nan
        return value


_LAST_ROWS = 1000
_FEWEST_ROWS = 5
"""Rows at the end of a file, at most and at least, that show how many decimals a column has."""
_STATUS = frozenset({"status", "state", "result", "ergebnis", "valid", "ok", "quality"})
_FAILED = frozenset(
    {"lost", "failed", "fail", "error", "nok", "ng", "invalid", "bad", "no", "false", "timeout", "missed"}
)
"""Names of a column that says whether a row was measured, and what it says of a row that was not."""


class TableReader:
    """Reader of one text table from front to back: first :meth:`header`, then :meth:`body`."""

    def __init__(self, stream: BinaryIO, file: str, options: TableOptions | None = None) -> None:
        """Read ``stream``, called ``file`` in messages."""
        self.file = file
        self.log = ProblemLog(file)
        self.options = options or TableOptions()
        self._dialect = PLAIN
        self._cells = CellReader(PLAIN, {}, self.options.skip_gaps, self.log)
        self._widths: list[tuple[int, int]] = []
        """Line and number of fields of each row that does not fit the header."""
        self._reader = LineReader(stream, self.log)
        self._blocks = self._reader.blocks()
        self._pending: Block | None = None
        self._names: tuple[str, ...] = ()
        self._units: dict[int, str] = {}
        """Unit in the cells of a column, by its index."""
        self._below: list[str] = []
        """Lines below the table."""

    @property
    def sha256(self) -> str:
        """Digest of the bytes read so far: of the complete file once the body was read."""
        return self._reader.sha256

    def header(self) -> Header:
        """Return the column names of the first line that is neither blank nor a comment.

        Raises:
            InputError: The file has no such line, or cannot be a comma-separated table.
        """
        first = next(self._blocks, Block([], 1))
        if self.options.is_known and (dialect := find_dialect(first.lines, self.options.is_known)) is not None:
            return self._foreign_header(first, dialect)
        for block in itertools.chain((first,), self._blocks):
            for i, line in enumerate(block.lines):
                if not PLAIN.is_row(line):
                    continue
                number = block.first + i
                self._names = header_names(line, number, self.file)
                self._pending = Block(block.lines[i + 1 :], number + 1)
                self._units = self._cell_units()
                return Header(self._names, number, cell_units=self._units)
        raise InputError(
            Problem("the file is empty", self.file, fix="expected a header row of column names and one row per pose")
        )

    def _foreign_header(self, first: Block, dialect: TableDialect) -> Header:
        """Return the names of a table in another form; columns without names are numbered."""
        self._dialect = dialect
        width = len(dialect.names) or len(dialect.split(first.lines[dialect.first_row]))
        if width > MAX_COLUMNS:
            problem = Problem(f"found {width} columns", self.file, fix=f"expected at most {MAX_COLUMNS}")
            raise InputError(problem)
        self._names = dialect.names or tuple(f"column {i + 1}" for i in range(width))
        self._pending = Block(first.lines[dialect.first_row :], first.first + dialect.first_row)
        line = dialect.first_row if dialect.header_line is None else dialect.header_line
        self._units = self._cell_units()
        return Header(self._names, first.first + line, dialect, self._units)

    def _cell_units(self) -> dict[int, str]:
        """Return the units in the first cells of the columns, if an export may have them."""
        if self.options.is_known is None or self._pending is None:
            return {}
        lines = (line for line in self._pending.lines if self._dialect.is_row(line))
        try:
            return units_of_columns(self._dialect.split(line) for line in lines)
        except csv.Error:
            return {}

    def description(self) -> str:
        """Return how the table differs from the documented form, for a message; empty where it does not."""
        encoding = self._reader.encoding
        if self._reader.not_utf8:
            encoding = "Windows-1252"
        grouped = "separators of thousands" if self._cells.has_grouped else ""
        units = f"units in the cells: {', '.join(dict.fromkeys(self._units.values()))}" if self._units else ""
        below = f"not read below the table: {', '.join(map(clip, self._below))}" if self._below else ""
        parts = [self._dialect.description(), grouped, "" if encoding == "UTF-8" else encoding, units, below]
        return ", ".join(part for part in parts if part)

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return every row, with the columns of the given indices only; :attr:`log` collects problems of rows."""
        store = GrowingColumns(len(numbers))
        self._cells = CellReader(self._dialect, self._units, self.options.skip_gaps, self.log)
        lines: list[NDArray[np.int64]] = [np.empty(0, dtype=np.int64)]
        columns: list[list[NDArray[np.str_]]] = [[np.empty(0, dtype=str)] for _ in texts]
        last: list[str] = []
        for block in self._remaining():
            parsed = self._parse(block, numbers, texts)
            store.append(parsed.numbers, self._reader.share_read)
            lines.append(parsed.lines)
            last = [*last, *block.lines][-_LAST_ROWS:]
            for column, part in zip(columns, parsed.texts, strict=True):
                column.append(part)
        self._report_widths(body_rows=sum(part.size for part in lines))
        if self._dialect is PLAIN:
            # A reader of exports takes the bytes as Windows-1252 and says so.
            for problem in self._reader.not_utf8 if self.options.is_known is None else self._reader.not_text:
                self.log.add(problem.message, problem.line, fix=problem.fix)
        body = TableBody(
            store.columns(),
            tuple(np.concatenate(column) for column in columns),
            np.concatenate(lines),
            cut=self._cut(last),
        )
        return body.without(self._cells.gaps)

    def _cut(self, lines: list[str]) -> str:
        """Return a warning of a last row without a line end whose last number has fewer decimals than those above."""
        cells = [self._dialect.split(line)[-1] for line in lines if self._dialect.is_row(line) and '"' not in line]
        sign = "," if self._dialect.decimal_comma else "."
        *above, last = [len(cell.partition(sign)[2]) for cell in cells] or [0]
        is_number = bool(cells) and self._dialect.is_number(cells[-1])
        if self._reader.ends_with_line or not is_number or len(above) < _FEWEST_ROWS or last >= min(above):
            return ""
        return f"{cells[-1]}, the last number, has fewer decimals than those above: if it was cut off, delete its line"

    def _remaining(self) -> Iterator[Block]:
        blocks = itertools.chain([self._pending] if self._pending is not None else [], self._blocks, [Block([], 0)])
        for block, following in itertools.pairwise(blocks):
            yield block if following.lines or self.options.is_known is None else self._without_footer(block)

    def _without_footer(self, block: Block) -> Block:
        """Return the last block without the lines below the table."""
        end = len(block.lines)
        while end > 1 and self._dialect.is_footer(block.lines[end - 1], len(self._names)):
            end -= 1
        self._below = [text for line in block.lines[end:] if self._dialect.is_row(text := line.strip(" \t,;|"))]
        return Block(block.lines[:end], block.first)

    def _parse(self, block: Block, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        parsed = self._parse_fast(block.lines, numbers, texts)
        if parsed is not None and parsed.numbers.shape[1] == len(block.lines):
            return TableBody(parsed.numbers, parsed.texts, parsed.lines + block.first)
        rows = [i for i, line in enumerate(block.lines) if self._dialect.is_row(line)]
        lines = [block.lines[i] for i in rows]
        parsed = self._parse_fast(lines, numbers, texts) if len(rows) < len(block.lines) else None
        if parsed is None:
            return self._parse_fields([(block.first + i, block.lines[i]) for i in rows], numbers, texts)
        return TableBody(parsed.numbers, parsed.texts, np.asarray(rows, dtype=np.int64) + block.first)

    def _parse_fast(self, lines: list[str], numbers: Sequence[int], texts: Sequence[int]) -> TableBody | None:
        """Return the rows parsed by NumPy, lines from 0; None where it cannot or a value is not finite or empty."""
        if not self._units.keys().isdisjoint(numbers):
            return None
        n_columns = len(self._names)
        only_numbers = len(set(numbers)) == n_columns
        # Without a type for every column a row with too many fields would pass unnoticed.
        kinds = ["f8" if i in set(numbers) else "O" if i in set(texts) else "U1" for i in range(n_columns)]
        dtype = np.dtype(float) if only_numbers else np.dtype([(f"f{i}", kind) for i, kind in enumerate(kinds)])
        dialect = self._dialect
        if (texts and (dialect.decimal_comma or any('"' in line for line in lines))) or (
            dialect is not PLAIN and any('"' in line for line in lines)
        ):
            return None
        if dialect.decimal_comma:
            if any("." in line for line in lines):  # a point may separate thousands: field by field it is refused
                return None
            lines = [line.replace(",", ".") for line in lines]
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # NumPy warns of a block without rows
                table: NDArray[Any] = np.loadtxt(
                    lines,
                    dtype,
                    comments=None,
                    delimiter=dialect.separator,
                    ndmin=2 if only_numbers else 1,
                    encoding="utf-8",
                )
        except ValueError:
            return None
        if only_numbers:
            if table.shape[1] != n_columns:
                return None
            # In the file's order, which is the usual one, no copy is needed before the columns are stored.
            values = table.T if list(numbers) == list(range(n_columns)) else table.T[list(numbers)]
        else:
            values = np.empty((len(numbers), table.size))
            for row, i in zip(values, numbers, strict=True):
                row[:] = table[f"f{i}"]
        if not np.isfinite(values).all():
            return None
        columns = [[text.strip() for text in table[f"f{i}"]] for i in texts]
        if any(not 0 < len(text) <= MAX_TEXT for column in columns for text in column):
            return None
        arrays = tuple(np.array(column, dtype=str) for column in columns)
        return TableBody(values, arrays, np.arange(values.shape[1], dtype=np.int64))

    def _parse_fields(self, rows: list[tuple[int, str]], numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Parse rows field by field and log each problem; a row that does not fit the header is left out."""
        values: list[list[float]] = []
        columns: list[list[str]] = []
        lines: list[int] = []
        for number, line in rows:
            fields = self._fields(number, line)
            if fields is None or self._is_lost(number, fields, numbers):
                continue
            values.append([self._cells.number(fields[i], number, i, self._names[i]) for i in numbers])
            columns.append([self._cells.text(fields[i], number, self._names[i]) for i in texts])
            lines.append(number)
        table = np.array(values, dtype=float).reshape(len(lines), len(numbers))
        arrays = tuple(np.array([row[i] for row in columns], dtype=str) for i in range(len(texts)))
        return TableBody(np.ascontiguousarray(table.T), arrays, np.array(lines, dtype=np.int64))

    def _is_lost(self, number: int, fields: Sequence[str], numbers: Sequence[int]) -> bool:
        """Return whether the status of a row says that its missing values were not measured; it is then left out."""
        status = {text.lower() for name, text in zip(self._names, fields, strict=True) if name.lower() in _STATUS}
        is_lost = bool(status & _FAILED) and any(fields[i].lower() in GAPS for i in numbers)
        self._cells.gaps |= {number} if is_lost else set()
        return is_lost

    def _fields(self, number: int, line: str) -> list[str] | None:
        try:
            fields = self._dialect.split(line)
        except csv.Error as error:
            self.log.add(f"the row cannot be read ({error})", number, fix="close every quote on its line")
            return None
        n_fields, expected = len(fields), len(self._names)
        if n_fields == expected and any(fields):
            return fields
        if self.options.skip_gaps and n_fields < expected:
            self._cells.gaps.add(number)
        elif not any(fields):
            self.log.add("every field of the row is empty", number, fix="delete the line")
        else:
            self._widths.append((number, n_fields))
        return None

    def _report_widths(self, body_rows: int) -> None:
        """Log rows with another number of fields than the header; once if no row fits and all have the same number."""
        expected = len(self._names)
        widths = {width for _, width in self._widths}
        is_same = not body_rows and len(widths) == 1 and len(self._widths) > 1
        for number, width in self._widths[:1] if is_same else self._widths:
            more = f" here and in the {len(self._widths) - 1} rows below" if is_same else ""
            fix = "write decimals with a point, not a comma" if width > 1.5 * expected else None
            if fix is None and width < expected and body_rows > 1:
                fix = "if another table or a footer begins here, delete it"
            if is_same and fix is None:
                fix = "give each column one name, with the same separator as in the rows"
            fields = "field" if width == 1 else "fields"
            self.log.add(f"found {width} {fields}{more}, expected {expected} as in the header", number, fix=fix)
