"""Tables: the columns' names and the rows below them, from any source; the text table is the first of them.

:func:`numpy.loadtxt` parses a block of lines. A block that it refuses, or that has a value that is not finite, is
parsed field by field to locate each problem.
"""

from __future__ import annotations

import contextlib
import csv
import itertools
import math
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from robacc.errors import Counted, InputError, Problem
from robacc.geometry import Array
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

MAX_COLUMNS = 2000
"""Largest number of columns of a table."""
MAX_TEXT = 256
"""Characters of an id; text columns are as wide as their longest entry."""


@dataclass(frozen=True, slots=True)
class TableOptions:
    """Freedom that a reader has."""

    is_known: Callable[[str], bool]
    """Whether a name is a documented one."""
    skip_gaps: bool = False
    """Leave out rows with a missing value, in place of a problem for each."""
    sheet: str | None = None
    """Sheet of a workbook; None for its only sheet."""
    bag: str | None = None
    """Topics and samples of a recording, as the reader of recordings takes them."""
    frame: Any = None
    """Data frame that is read in place of a file."""


@dataclass(frozen=True, slots=True)
class TableBody:
    """Rows below the header."""

    numbers: Array
    """``(C, N)`` columns of numbers; NaN where a problem was logged."""
    texts: tuple[NDArray[np.str_], ...]
    """Columns of text, ``(N,)`` each."""
    lines: NDArray[np.int64]
    """``(N,)`` 1-based line of each row, or its row number where the file has no lines."""

    def without(self, gaps: Collection[int]) -> TableBody:
        """Return the rows that are not on the lines ``gaps``."""
        if not gaps:
            return self
        complete = ~np.isin(self.lines, list(gaps))
        texts = tuple(column[complete] for column in self.texts)
        return TableBody(self.numbers[:, complete], texts, self.lines[complete])


class Table:
    """Names of columns, and the rows below them, which are read once."""

    dialect: TableDialect = PLAIN
    """Form of the table, where it is not the documented one."""
    sha256 = ""
    """Digest of the file's bytes, once the body was read."""

    def __init__(
        self,
        file: str,
        names: Sequence[str],
        line: int | None = None,
        counted: Counted = "row",
        skip_gaps: bool = False,
    ) -> None:
        """Take the names of the columns.

        Args:
            file: Name in messages.
            names: Names of the columns.
            line: 1-based line of the names; None where the file has no lines.
            counted: What places in the table are counted in.
            skip_gaps: Leave out rows with a missing value.

        Raises:
            InputError: There are too many columns.
        """
        self.file = file
        self.log = ProblemLog(file, counted)
        self.names = tuple(name.strip() for name in names)
        self.labels = self.names
        """Names in messages: a reader of poses may take names for others."""
        self.line = line
        self.cell_units: Mapping[int, str] = {}
        """Units behind the numbers of the cells, by the index of the column."""
        self.sparse: Collection[int] = ()
        """Columns of texts with empty cells, in a table with several rows a pose, of which some have no numbers."""
        self.times: Set[int] = frozenset()
        """Columns of times, which may be texts or numbers."""
        self.skip_gaps = skip_gaps
        self.remarks: list[str] = []
        """How the table differs from the documented form, and how it came to be, for a message."""
        self.doubts: list[str] = []
        """Warnings of the table as a whole, once the body was read."""
        self.gaps: set[int] = set()
        """Lines or rows that are left out because a value is missing."""
        if len(names) > MAX_COLUMNS:
            raise InputError(Problem(f"found {len(names)} columns", file, line, fix=f"expected at most {MAX_COLUMNS}"))

    def description(self) -> str:
        """Return how the table differs from the documented form; empty where it does not."""
        return ", ".join(filter(None, self.remarks))

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return every row, with the columns of the given indices only; :attr:`log` collects problems of values.

        Raises:
            InputError: The file is damaged.
        """
        raise NotImplementedError

    def text(self, cell: str, line: int, column: str) -> str:
        """Return the text in a cell, cut to the greatest length; log a missing one or a longer one."""
        if not cell:
            self.log.add("the value is missing, expected text", line, column)
        elif len(cell) > MAX_TEXT:
            self.log.add(f"the text has {len(cell)} characters, expected at most {MAX_TEXT}", line, column)
        return cell[:MAX_TEXT]


def header_names(line: str, number: int, file: str) -> tuple[str, ...]:
    """Return the names of the header row.

    Raises:
        InputError: The line is not a header row.
    """
    fix = "export the file with commas, and with a point in decimals"
    try:
        names = tuple(PLAIN.split(line))
    except csv.Error as error:
        names, message, fix = (), f"the header row cannot be read ({error})", "close every quote on its line"
    else:
        signs = {";": "semicolons", "\t": "tabs", **({" ": "spaces"} if len(names) == 1 else {})}
        message = next((f"the columns are separated by {signs[s]}, expected commas"
                        for s in signs if line.strip().count(s) >= len(names)), "")  # fmt: skip
        if not message and all(number_of(name, decimal_comma=False) is not None for name in names):
            message, fix = "found numbers, expected a header row", "begin the file with the columns' names"
    if message:
        raise InputError(Problem(message, file, number, fix=fix))
    return names


def _with_room(numbers: Array, n_rows: int, share: float) -> Array:
    """Return columns ``(C, N)`` of numbers with room for ``n_rows``, the rows in ``share`` (0 to 1) of a file.

    They grow to the size that this share suggests. Pages that are never written cost nothing, while joining parts at
    the end of the file would touch all of the memory twice.
    """
    if n_rows <= numbers.shape[1]:
        return numbers
    larger = np.empty((len(numbers), max(int(n_rows / share * 1.02), n_rows)))
    larger[:, : numbers.shape[1]] = numbers
    return larger


_SKIP = "give `skip_gaps` to leave out rows with a missing value"
_LAST_ROWS = 1000
_FEWEST_ROWS = 5
"""Rows at the end of a file, at most and at least, that show how many decimals a column has."""
_STATUS = frozenset({"status", "state", "result", "ergebnis", "valid", "ok", "quality"})
_FAILED = frozenset(
    {"lost", "missing", "failed", "fail", "error", "nok", "ng", "invalid", "bad", "no", "false", "timeout", "missed"}
)
"""Names of a column that says whether a row was measured, and what it says of a row that was not."""


class TextTable(Table):
    """Table in a text file, or in the text of a workbook's sheet."""

    def __init__(self, stream: BinaryIO, file: str, options: TableOptions, counted: Counted = "line") -> None:
        """Read the names of the columns.

        Raises:
            InputError: The file has no names, or cannot be a table.
        """
        self._reader = LineReader(stream, file)
        self._blocks = self._reader.blocks()
        first = next(self._blocks, Block([], 1))
        if dialect := find_dialect(first.lines, options.is_known):
            self.dialect = dialect
            row = dialect.first_row
            width = len(dialect.names) or len(dialect.split(first.lines[row]))
            names = dialect.names or tuple(f"column {i + 1}" for i in range(width))
            number = first.first + (row if dialect.header_line is None else dialect.header_line)
            self._pending = Block(first.lines[row:], first.first + row)
        else:
            names, number = self._documented_names(first, file)
        super().__init__(file, names, number, counted, options.skip_gaps)
        self._repeats = False
        """Whether the names stand above each block of rows, with other text above them."""
        with contextlib.suppress(csv.Error):  # the row is reported when it is read
            rows = map(self.dialect.split, filter(self.dialect.is_row, self._pending.lines))
            self.cell_units = units_of_columns(rows)
            pairs = itertools.pairwise(filter(self.dialect.is_row, self._pending.lines))
            blocks = (
                above
                for above, line in pairs
                if self.names[0] in line and tuple(self.dialect.split(line)) == self.names
            )
            self._repeats = any(not any(map(self.dialect.is_number, self.dialect.split(above))) for above in blocks)
        self.remarks.append(self.dialect.description())
        self._has_grouped = False
        """Whether a number had separators of thousands."""
        self._widths: list[tuple[int, int]] = []
        """Line and number of fields of each row that does not fit the header."""
        self._below: list[str] = []
        """Lines below the table."""

    def _documented_names(self, first: Block, file: str) -> tuple[tuple[str, ...], int]:
        """Return the names in the first line that is neither blank nor a comment, and its number."""
        for block in itertools.chain((first,), self._blocks):
            for i, line in enumerate(block.lines):
                if PLAIN.is_row(line):
                    number = block.first + i
                    self._pending = Block(block.lines[i + 1 :], number + 1)
                    return header_names(line, number, file), number
        fix = "expected a header row of column names and one row per pose"
        raise InputError(Problem("the file is empty", file, fix=fix))

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return every row, with the columns of the given indices only; :attr:`log` collects problems of rows."""
        table, size = np.empty((len(numbers), 0)), 0
        lines: list[NDArray[np.int64]] = [np.empty(0, dtype=np.int64)]
        columns: list[tuple[NDArray[np.str_], ...]] = [tuple(np.empty(0, dtype=str) for _ in texts)]
        last: list[str] = []
        for block in self._remaining():
            parsed = self._parse(block, numbers, texts)
            start, size = size, size + parsed.lines.size
            table = _with_room(table, size, self._reader.share_read)
            table[:, start:size] = parsed.numbers
            lines.append(parsed.lines)
            columns.append(parsed.texts)
            last = [*last, *block.lines][-_LAST_ROWS:]
        self._report_widths(body_rows=size)
        if self.dialect is PLAIN:
            for problem in self._reader.not_text:
                self.log.add(problem.message, problem.line, fix=problem.fix)
        if cut := self._cut(last):
            self.doubts.append(cut)
        self.remarks += [
            "separators of thousands" if self._has_grouped else "",
            "" if self._reader.encoding == "UTF-8" else self._reader.encoding,
            f"units in the cells: {', '.join(dict.fromkeys(self.cell_units.values()))}" if self.cell_units else "",
            f"not read below the table: {', '.join(map(clip, self._below))}" if self._below else "",
        ]
        self.sha256 = self.sha256 or self._reader.sha256
        joined = tuple(map(np.concatenate, zip(*columns, strict=True)))
        return TableBody(table[:, :size], joined, np.concatenate(lines)).without(self.gaps)

    def _cut(self, lines: list[str]) -> str:
        """Return a warning of a last row without a line end whose last number has fewer decimals than those above."""
        cells = [self.dialect.split(line)[-1] for line in lines if self.dialect.is_row(line) and '"' not in line]
        sign = "," if self.dialect.decimal_comma else "."
        *above, last = [len(cell.partition(sign)[2]) for cell in cells] or [0]
        is_number = bool(cells) and self.dialect.is_number(cells[-1])
        if self._reader.ends_with_line or not is_number or len(above) < _FEWEST_ROWS or last >= min(above):
            return ""
        return f"{cells[-1]}, the last number, has fewer decimals than those above: if it was cut off, delete its line"

    def _remaining(self) -> Iterator[Block]:
        blocks = itertools.chain([self._pending], self._blocks, [Block([], 0)])
        for block, following in itertools.pairwise(blocks):
            yield block if following.lines else self._without_footer(block)

    def _without_footer(self, block: Block) -> Block:
        """Return the last block without the lines below the table."""
        end = len(block.lines)
        while end > 1 and self.dialect.is_footer(block.lines[end - 1], len(self.labels)):
            end -= 1
        self._below = [text for line in block.lines[end:] if self.dialect.is_row(text := line.strip(" \t,;|"))]
        return Block(block.lines[:end], block.first)

    def _parse(self, block: Block, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        parsed = self._parse_fast(block.lines, numbers, texts)
        if parsed is not None and parsed.numbers.shape[1] == len(block.lines):
            return TableBody(parsed.numbers, parsed.texts, parsed.lines + block.first)
        rows = [i for i, line in enumerate(block.lines) if self.dialect.is_row(line)]
        lines = [block.lines[i] for i in rows]
        parsed = self._parse_fast(lines, numbers, texts) if len(rows) < len(block.lines) else None
        if parsed is None:
            return self._parse_fields([(block.first + i, block.lines[i]) for i in rows], numbers, texts)
        return TableBody(parsed.numbers, parsed.texts, np.asarray(rows, dtype=np.int64) + block.first)

    def _parse_fast(self, lines: list[str], numbers: Sequence[int], texts: Sequence[int]) -> TableBody | None:
        """Return the rows parsed by NumPy, lines from 0; None where it cannot or a value is not finite or empty."""
        if not self.cell_units.keys().isdisjoint(numbers):
            return None
        n_columns = len(self.labels)
        only_numbers = len(set(numbers)) == n_columns
        # Without a type for every column a row with too many fields would pass unnoticed.
        kinds = ["f8" if i in set(numbers) else "O" if i in set(texts) else "U1" for i in range(n_columns)]
        dtype = np.dtype(float) if only_numbers else np.dtype([(f"f{i}", kind) for i, kind in enumerate(kinds)])
        dialect = self.dialect
        if (texts and dialect.decimal_comma) or ((texts or dialect is not PLAIN) and '"' in "".join(lines)):
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
        if any(column and not 0 < min(map(len, column)) <= max(map(len, column)) <= MAX_TEXT for column in columns):
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
            if fields is None or self._is_lost(number, fields, numbers, texts):
                continue
            values.append([self._number(fields[i], number, i) for i in numbers])
            columns.append(
                [
                    "" if i in self.sparse and not fields[i] else self.text(fields[i], number, self.labels[i])
                    for i in texts
                ]
            )
            lines.append(number)
        table = np.array(values, dtype=float).reshape(len(lines), len(numbers))
        arrays = tuple(np.array([row[i] for row in columns], dtype=str) for i in range(len(texts)))
        return TableBody(np.ascontiguousarray(table.T), arrays, np.array(lines, dtype=np.int64))

    def _number(self, cell: str, line: int, index: int) -> float:
        """Return the number in a cell of a column; NaN where there is none or a problem was logged."""
        column, comma = self.labels[index], self.dialect.decimal_comma
        if index in self.cell_units and any(sign.isdecimal() for sign in cell):
            cell = self._bare(cell, line, index)
        is_gap = cell.lower() in GAPS
        if self.skip_gaps and is_gap:
            self.gaps.add(line)
            return math.nan
        value = number_of(cell, comma)
        self._has_grouped |= value is not None and is_grouped(cell, comma)
        if value is not None and math.isfinite(value):
            return value
        found = f"found {clip(cell)}, expected a {'' if value is None else 'finite '}number"
        fix = _SKIP if is_gap else advice(cell, column, comma) if value is None else None
        self.log.add(found if cell else "the value is missing, expected a number", line, column, fix)
        return math.nan

    def _bare(self, cell: str, line: int, index: int) -> str:
        """Return a cell without its unit; log a unit that is not the column's."""
        expected, (number, unit) = self.cell_units[index], split_cell(cell)
        if unit is not None and unit != expected:
            fix = "export the column in one unit"
            self.log.add(f"found {clip(cell)}, but the first cell is in {expected}", line, self.labels[index], fix)
        elif unit is None and number_of(number, self.dialect.decimal_comma) is not None:
            fix = f"export every cell with its unit, or none and {expected} in the column's name"
            self.log.add(f"found {clip(cell)} without the unit {expected}", line, self.labels[index], fix)
        return number

    def _is_lost(self, number: int, fields: Sequence[str], numbers: Sequence[int], texts: Sequence[int]) -> bool:
        """Return whether a row is left out: every value is missing, or one is and the status says not measured."""
        status = {text.lower() for name, text in zip(self.labels, fields, strict=True) if name.lower() in _STATUS}
        missing = [fields[i].lower() in GAPS for i in numbers]
        named = not self.sparse and not all(
            self.dialect.is_number(fields[i]) for i in texts
        )  # a number counts the rows
        is_lost = (bool(status & _FAILED) and any(missing)) or (not named and len(missing) > 1 and all(missing))
        self.gaps |= {number} if is_lost and not self.sparse else set()
        return is_lost

    def _fields(self, number: int, line: str) -> list[str] | None:
        try:
            fields = self.dialect.split(line)
        except csv.Error as error:
            self.log.add(f"the row cannot be read ({error})", number, fix="close every quote on its line")
            return None
        n_fields, expected = len(fields), len(self.labels)
        if self._repeats and not any(map(self.dialect.is_number, fields)):
            return None
        if n_fields == expected and any(fields):
            return fields
        if self.skip_gaps and n_fields < expected:
            self.gaps.add(number)
        elif not any(fields):
            self.log.add("every field of the row is empty", number, fix="delete the line")
        else:
            self._widths.append((number, n_fields))
        return None

    def _report_widths(self, body_rows: int) -> None:
        """Log rows with another number of fields than the header; once if no row fits and all have the same number."""
        expected = len(self.labels)
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
