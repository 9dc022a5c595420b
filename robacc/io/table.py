"""Tables: the columns' names and the rows below them, from any source; the text table is the first of them.

A text is read once, in blocks of complete lines: a pipe works like a file, and memory is bounded. :func:`numpy.loadtxt`
parses a block. A block that it refuses, or that has a value that is not finite, is parsed field by field to locate each
problem.
"""

import contextlib
import csv
import hashlib
import io
import itertools
import math
import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from robacc.errors import Counted, InputError, Problem, applying, refuse
from robacc.geometry import Array, NDArray
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
from robacc.io.files import ProblemLog, clip, opened

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
    """Leave out rows with a missing value, with a warning, in place of a problem for each."""
    sheet: str | None = None
    """Name of a workbook's sheet; None for its only sheet."""
    bag: str | None = None
    """Topics and samples of a recording: ``joints=/joint_states,measured=/tracker/pose,at=rest``."""
    board: str | None = None
    """File of the board that photos show."""
    contact_sheet: str | None = None
    """File to write with a picture of all photos, the points found in them and what is wrong."""
    frame: Any = None
    """Data frame, or part of a large file, that is read in place of the file; None for the whole file."""


class TableBody(NamedTuple):
    """Rows below the header."""

    numbers: Array
    """``(C, N)`` columns of numbers; NaN where a problem was logged."""
    texts: Sequence[NDArray[np.str_]]
    """Columns of text, ``(N,)`` each."""
    lines: NDArray[np.int64]
    """``(N,)`` 1-based line of each row, or its row number where the file has no lines."""

    def without(self, gaps: Collection[int]) -> "TableBody":
        """Return the rows that are not on the lines ``gaps``."""
        if not gaps:
            return self
        complete = ~np.isin(self.lines, list(gaps))
        return TableBody(self.numbers[:, complete], [column[complete] for column in self.texts], self.lines[complete])


class Table:
    """Names of columns, and the rows below them, which are read once."""

    dialect: TableDialect = PLAIN
    """Form of the table, where it is not the documented one."""
    sha256 = ""
    """Digest of the file's bytes, once the body was read."""
    image_sizes: Mapping[str, tuple[int, ...]] = {}
    """Width and height, px, of the photos of each camera that the rows come from."""

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
        self.file, self.line, self.skip_gaps = file, line, skip_gaps
        self.log = ProblemLog(file, counted)
        self.labels = self.names = tuple(name.strip() for name in names)
        """Names in messages; a reader of poses may take ``names`` for others."""
        self.cell_units: Mapping[int, str] = {}
        """Units behind the numbers of the cells, by the index of the column."""
        self.sparse: Collection[int] = ()
        """Columns of texts with empty cells, in a table with several rows a pose, of which some have no numbers."""
        self.times: Set[int] = frozenset()
        """Columns of times, which may be texts or numbers."""
        many = Problem(f"found {len(names)} columns", file, line, fix=f"expected at most {MAX_COLUMNS}")
        refuse((len(names) > MAX_COLUMNS, many))

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


MAX_LINE = 1 << 20
"""Largest line, bytes: a file without line ends must not fill the memory before it is refused."""
_BLOCK = 1 << 16
"""Bytes split at a time: the block, its lines and its numbers fit the second-level cache."""
_FIRST_BLOCK = 1 << 18
"""Bytes of the first block, whose lines show the form of the table."""
_TAIL = 5 * MAX_LINE
"""Bytes behind a block at most up to a line feed: old files end their lines otherwise."""
BOM = b"\xef\xbb\xbf"
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_UTF16_LIMIT = 1 << 28
"""Largest UTF-16 file, bytes: it is decoded in one piece."""


Block = tuple[int, list[str]]
"""1-based number of the first line, and complete lines of the file without their ends."""

_OF_NUMBERS = b"0123456789+-.eE \t"
"""Characters of numbers and around them."""
SKIP = "give `skip_gaps` to leave out rows with a missing value"
_VALID = frozenset({"valid", "tracked", "visible", "detected"})
_LOST = frozenset({"lost", "missing", "invalid", "occluded", "timeout", "missed"})
_STATUS = _VALID | _LOST | {"status", "state", "result", "ergebnis", "ok", "quality"}
"""Words of a column that says whether a row was measured; those of the first two give no verdict on the values."""
_FAILED = _LOST | {"failed", "fail", "error", "nok", "ng", "bad", "no", "false"}
"""What it says of a row that was not measured. The words that are not lost count where a value is missing, too: alone,
they may be a verdict on the values."""


def lost_words(column: str) -> frozenset[str]:
    """Return what a column's cells say, in small letters, of a row that was not measured and has stale values.

    Nothing for a column that is no status.
    """
    words = {word.lower() for word in re.findall("[A-Z]?[a-z]+|[A-Z]+", column)}
    # Other words may count: `lost_frames`, `n_occluded`.
    is_lost = words <= _LOST | {"is", "beam", "target", "tracker"}
    said = {"yes", "true", "1"} if is_lost else {"no", "false", "0"} if words & _VALID else set[str]()
    return _LOST | said if words & _STATUS else frozenset()


class TextTable(Table):
    """Table in a text file, or in the text of a workbook's sheet: UTF-8 with any line end, or Windows-1252."""

    def __init__(self, stream: BinaryIO, file: str, options: TableOptions, counted: Counted = "line") -> None:
        """Read the names of the columns.

        Raises:
            InputError: The file has no names, or cannot be a table.
        """
        self.file, self._encoding = file, "UTF-8"
        self._digest, self._ends_with_line = hashlib.sha256(), True
        self._not_text: list[tuple[str, int]] = []
        """Problems and numbers of the first lines with bytes that Windows-1252 does not have either."""
        self._has_grouped = False
        """Whether a number had separators of thousands."""
        self._is_long = False
        """Whether the table goes beyond its first block, so that importing orjson takes less time than it saves."""
        self._widths: list[tuple[int, int]] = []
        """Line and number of fields of each row that does not fit the header."""
        self._blocks = self._read_blocks(stream)
        start, lines = next((block for block in self._blocks if any(map(PLAIN.is_row, block[1]))), (0, []))
        names_and_rows = "expected a header row of column names and one row per pose"
        refuse((not lines, Problem("the file is empty", file, fix=names_and_rows)))
        self.dialect = dialect = find_dialect(lines, options.is_known)
        row = dialect.first_row
        number = start + (row if dialect.header_line is None else dialect.header_line)
        if dialect.is_documented:
            names: Sequence[str] = _documented_names(lines[row - 1], number, file)
        else:
            names = dialect.names or [f"column {i + 1}" for i in range(len(dialect.fields(lines[row])))]
        super().__init__(file, names, number, counted, options.skip_gaps)
        self._pending: Block = start + row, lines[row:]
        grid = [dialect.fields(line) for line in lines[row:] if dialect.is_row(line)]
        self.cell_units = units_of_columns(grid)
        self._repeats = any(
            tuple(fields) == self.names and above and not any(map(dialect.is_number, above))
            for above, fields in itertools.pairwise(grid)
        )
        """Whether the names stand above each block of rows, with other text above them."""
        self._status = {i: words for i, label in enumerate(self.labels) if (words := lost_words(label))}
        self.log.remarks.append(dialect.description())
        lacks_names = self.names[0] == "" and "pose" not in self.names
        index = ["".join(fields[:1]) for fields in grid if lacks_names]
        if index and all(text and not dialect.is_number(text) for text in index):  # as pandas writes one
            self.names = ("pose", *self.names[1:])
            self.log.remarks.append("the first column, which has no name, has the names of the poses")

    def _read_blocks(self, stream: BinaryIO, number: int = 1) -> Iterator[Block]:
        """Yield blocks of complete lines, of which the first has the given number.

        Raises:
            InputError: The file is not text, or a line is longer than :data:`MAX_LINE`.
        """
        while data := stream.read(_BLOCK if number > 1 else _FIRST_BLOCK):
            self._is_long = number > 1
            tail = b"" if data.endswith(b"\n") else stream.readline(_TAIL)
            data += tail
            if number == 1 and data.startswith(_UTF16):
                self._encoding = "UTF-16"
                data += stream.read(_UTF16_LIMIT)
            if not self.sha256:  # A part knows that of its file.
                self._digest.update(data)
            self._ends_with_line = data.endswith((b"\n", b"\r"))
            lines = self._lines(data, number)
            # Only a line with much behind the block can be too long, or have no end at all.
            too_long = [i for i, line in enumerate(lines, number) if len(line) > MAX_LINE] if len(tail) > _BLOCK else []
            if len(tail) == _TAIL and not tail.endswith(b"\n"):
                too_long.append(number + len(lines) - 1)
            message, place = f"the line is longer than {MAX_LINE / (1 << 20):g} MB", next(iter(too_long), None)
            refuse((too_long, Problem(message, self.file, place, fix="expected one line per pose")))
            yield number, lines
            number += len(lines)

    def _lines(self, data: bytes, number: int) -> list[str]:
        """Return the lines of bytes, the first of which has this number."""
        if self._encoding == "UTF-16":
            large = Problem("the UTF-16 file is too large", self.file, fix="save it as UTF-8")
            refuse((len(data) > _UTF16_LIMIT, large))
            with contextlib.suppress(UnicodeDecodeError):
                data = data.decode("utf-16").encode(errors="replace")
        other = Problem("the file is not UTF-8 text (it is UTF-16 or binary)", self.file, fix="save it as UTF-8")
        refuse((b"\0" in data or (number == 1 and data.startswith(_UTF16)), other))
        data = data.removeprefix(BOM) if number == 1 else data
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data
        try:
            lines = data.decode().split("\n")
        except UnicodeDecodeError:
            lines = [self._decoded(line, i) for i, line in enumerate(data.split(b"\n"), number)]
        return lines if lines[-1] else lines[:-1]  # nothing follows the last line's end

    def _decoded(self, line: bytes, number: int) -> str:
        try:
            return line.decode()
        except UnicodeDecodeError as error:
            self._encoding = "Windows-1252"
            if len(self._not_text) < 1000 and any(byte in b"\x81\x8d\x8f\x90\x9d" for byte in line):
                message = f"byte {error.start + 1} of the line, 0x{line[error.start]:02x}, is not UTF-8"
                self._not_text.append((message, number))
            return line.decode("cp1252", errors="replace")

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return every row, with the columns of the given indices only; :attr:`log` collects problems of rows."""
        parts: list[TableBody] = []
        last: list[str] = []
        unread: list[str] = []
        blocks = itertools.chain([self._pending], self._blocks, [(0, [])])
        for (first, lines), (_, following) in itertools.pairwise(blocks):
            end = len(lines)
            if not following and self._ends_with_line:  # else a row was cut off
                while end > 1 and self.dialect.is_footer(lines[end - 1], len(self.labels)):
                    end -= 1
            is_unread = [*self.dialect.are_statistics(lines[:end]), *[True] * (len(lines) - end)]
            unread += (
                text
                for line in itertools.compress(lines, is_unread)
                if self.dialect.is_row(text := line.strip(" \t,;|"))
            )
            lines = ["" if is_left_out else line for line, is_left_out in zip(lines, is_unread, strict=True)]
            parts.append(self._parsed(first, lines, numbers, texts))
            last = [*last, *lines][-1000:]
        body = TableBody(
            np.concatenate([part.numbers for part in parts], axis=1),
            [np.concatenate(column) for column in zip(*(part.texts for part in parts), strict=True)],
            np.concatenate([part.lines for part in parts]),
        )
        self._report_widths(body_rows=body.lines.size)
        for message, line in self._not_text if self.dialect.is_documented else ():
            self.log.add(message, line, fix="save the file as UTF-8")
        cells = [self.dialect.split(line)[-1] for line in last if self.dialect.is_row(line) and '"' not in line]
        *above, ending = [len(cell.partition("," if self.dialect.decimal_comma else ".")[2]) for cell in cells] or [0]
        is_number = bool(cells) and self.dialect.is_number(cells[-1])
        # Five rows at least show how many decimals the column has.
        if not self._ends_with_line and is_number and len(above) >= 5 and ending < min(above):
            self.log.warn(
                f"{cells[-1]}, the last number, has fewer decimals than those above: if it was cut off, "
                "delete its line",
                of_file=True,
            )
        self.log.remarks += [
            "separators of thousands" if self._has_grouped else "",
            "" if self._encoding == "UTF-8" else self._encoding,
            f"units in the cells: {', '.join(dict.fromkeys(self.cell_units.values()))}" if self.cell_units else "",
            f"not read in or below the table: {', '.join(map(clip, unread))}" if unread else "",
        ]
        self.sha256 = self.sha256 or self._digest.hexdigest()
        return body.without(self.log.gaps)

    def _parsed(self, first: int, lines: list[str], numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return the rows among lines, of which the first has the number ``first``."""
        places = np.arange(first, first + len(lines), dtype=np.int64)
        parsed = self._parse_fast(lines, places, numbers, texts)
        if parsed is None:
            places = places[[self.dialect.is_row(line) for line in lines]]
            lines = [lines[i - first] for i in places]
            parsed = self._parse_fast(lines, places, numbers, texts) or self._parse_fields(
                lines, places, numbers, texts
            )
        return parsed

    def _parse_fast(
        self, lines: list[str], places: NDArray[np.int64], numbers: Sequence[int], texts: Sequence[int]
    ) -> TableBody | None:
        """Return the columns of rows that have no quotes or gaps; None where a line or field needs a closer look."""
        dialect, width = self.dialect, len(self.labels)
        separator = dialect.separator or "\t"
        lines = lines if dialect.separator else ["\t".join(line.split()) for line in lines]
        text = separator.join(lines)
        is_quoted = '"' in text and (texts or not dialect.is_documented)
        is_grouped = dialect.decimal_comma and (texts or "." in text)  # field by field such numbers are refused
        if is_quoted or is_grouped or not self.cell_units.keys().isdisjoint(numbers):
            return None
        count = len(numbers)
        try:
            if count and {*numbers} == {*range(count)}:
                # Numbers in front of all texts are converted at once, without a text for each field.
                split = (line.rsplit(separator, width - count) for line in lines)
                heads, *behind = zip(*split, strict=True) if count < width else [lines]
                values = self._numbers(heads, separator, count).T[list(numbers)]
                fields = [behind[i - count] for i in (*texts, *self._status)]
                widths = {count + len(behind)}
            else:
                cells = text.split(separator)
                columns = [self._numbers(cells[i::width], separator, 1) for i in numbers]
                values = np.array(columns).reshape(count, len(lines))
                fields = [cells[i::width] for i in (*texts, *self._status)]
                widths = {line.count(separator) + 1 for line in lines}
        except ValueError:
            return None
        stripped = [[*map(str.strip, column)] for column in fields]
        sizes = [*map(len, itertools.chain(*stripped))]
        is_whole = widths <= {width} and 0 < min(sizes, default=1) <= max(sizes, default=1) <= MAX_TEXT
        is_lost = any(
            not words.isdisjoint(map(str.lower, column))
            for words, column in zip(self._status.values(), stripped[len(texts) :], strict=True)
        )
        if is_lost or not is_whole or not np.isfinite(values).all():
            return None
        return TableBody(values, [np.array(column, dtype=str) for column in stripped[: len(texts)]], places)

    def _numbers(self, fields: Sequence[str], separator: str, count: int) -> Array:
        """Return the numbers ``(N, count)`` of fields that have so many each, with separators between them.

        Raises:
            ValueError: A number is no plain number, or a field has more or fewer.
        """
        text = "\n".join(fields)
        text = text.replace(",", ".") if self.dialect.decimal_comma else text
        rows = text.replace(separator, ",").encode()
        # What is left without the numbers shows their count, and that there is no null, true or digit of other scripts.
        if rows.translate(None, _OF_NUMBERS) != b"\n".join([b"," * (count - 1)] * len(fields)):
            raise ValueError(text)
        data = rows.replace(b"\n", b",")
        # JSON has no sign or point before the first digit, and its integers no negative zero.
        if self._is_long and b"-0," not in data + b",":
            import orjson

            with contextlib.suppress(orjson.JSONDecodeError):
                return np.array(orjson.loads(b"[%b]" % data), dtype=float).reshape(-1, count)
        return np.array([*map(float, data.split(b","))]).reshape(-1, count)

    def _parse_fields(
        self, lines: list[str], places: NDArray[np.int64], numbers: Sequence[int], texts: Sequence[int]
    ) -> TableBody:
        """Parse rows field by field and log each problem; a row that does not fit the header is left out."""
        values: list[list[float]] = []
        columns: list[list[str]] = []
        kept: list[int] = []
        for place, line in zip(places.tolist(), lines, strict=True):
            fields = self._fields(place, line)
            if fields is None or self._is_lost(place, fields, numbers, texts):
                continue
            values.append([self._number(fields[i], place, i) for i in numbers])
            filled = [i for i in texts if fields[i] or i not in self.sparse]
            columns.append([self.text(fields[i], place, self.labels[i]) if i in filled else "" for i in texts])
            kept.append(place)
        table = np.array(values, dtype=float).reshape(len(kept), len(numbers))
        arrays = [np.array([row[i] for row in columns], dtype=str) for i in range(len(texts))]
        return TableBody(np.ascontiguousarray(table.T), arrays, np.array(kept, dtype=np.int64))

    def _number(self, cell: str, line: int, index: int) -> float:
        """Return the number in a cell of a column; NaN where there is none or a problem was logged."""
        column, comma = self.labels[index], self.dialect.decimal_comma
        if (expected := self.cell_units.get(index)) and any(sign.isdecimal() for sign in cell):
            whole = clip(cell)
            cell, unit = split_cell(cell)
            if unit not in (None, expected):
                self.log.add(
                    f"found {whole}, but the first cell is in {expected}", line, column, "export the column in one unit"
                )
            elif unit is None and number_of(cell, comma) is not None:
                self.log.add(
                    f"found {whole} without the unit {expected}",
                    line,
                    column,
                    f"export every cell with its unit, or none and {expected} in the column's name",
                )
        is_gap = cell.lower() in GAPS
        if self.skip_gaps and is_gap:
            self.log.gaps.add(line)
            return math.nan
        value = number_of(cell, comma)
        self._has_grouped |= value is not None and is_grouped(cell, comma)
        if value is not None and math.isfinite(value):
            return value
        found = f"found {clip(cell)}, expected a {'' if value is None else 'finite '}number"
        fix = SKIP if is_gap else advice(cell, column, comma) if value is None else None
        self.log.add(found if cell else "the value is missing, expected a number", line, column, fix)
        return math.nan

    def _is_lost(self, line: int, fields: Sequence[str], numbers: Sequence[int], texts: Sequence[int]) -> bool:
        """Return whether a row is left out: every value is missing, or the status says that it was not measured."""
        missing = [fields[i].lower() in GAPS for i in numbers]
        is_unmeasured = any(
            fields[i].lower() in words or (any(missing) and fields[i].lower() in _FAILED)
            for i, words in self._status.items()
        )
        # A number in place of a name counts the rows.
        is_empty = (len(missing) > 1 and all(missing)) and (
            bool(self.sparse) or all(self.dialect.is_number(fields[i]) for i in texts)
        )
        self.log.gaps |= {line} if is_unmeasured or (is_empty and not self.sparse) else set()
        return is_unmeasured or is_empty

    def _fields(self, line: int, text: str) -> list[str] | None:
        """Return the fields of a row; None for a row that does not fit the header, which is logged."""
        try:
            fields = self.dialect.split(text)
        except csv.Error as error:
            self.log.add(f"the row cannot be read ({error})", line, fix="close every quote on its line")
            return None
        expected = len(self.labels)
        if self._repeats and not any(map(self.dialect.is_number, fields)):
            return None
        if len(fields) == expected:
            return fields
        if self.skip_gaps and len(fields) < expected:
            self.log.gaps.add(line)
        else:
            self._widths.append((line, len(fields)))
        return None

    def _report_widths(self, body_rows: int) -> None:
        """Log rows with another number of fields than the header; once if no row fits and all have the same number."""
        expected = len(self.labels)
        is_same = not body_rows and len({width for _, width in self._widths}) == 1 and len(self._widths) > 1
        more = f" here and in the {len(self._widths) - 1} rows below" if is_same else ""
        for line, width in self._widths[:1] if is_same else self._widths:
            fixes = applying(
                (width > 1.5 * expected, "write decimals with a point, not a comma"),
                (width < expected and body_rows > 1, "if another table or a footer begins here, delete it"),
                (is_same, "give each column one name, with the same separator as in the rows"),
            )
            fields = "field" if width == 1 else "fields"
            message = f"found {width} {fields}{more}, expected {expected} as in the header"
            self.log.add(message, line, fix=next(iter(fixes), None))


def _documented_names(line: str, number: int, file: str) -> list[str]:
    """Return the names of the header row of a file of the documented form.

    Raises:
        InputError: The line is not a header row.
    """
    try:
        names = PLAIN.split(line)
    except csv.Error as error:
        message, fix = f"the header row cannot be read ({error})", "close every quote on its line"
        raise InputError(Problem(message, file, number, fix=fix)) from None
    signs = {";": "semicolons", "\t": "tabs", **({" ": "spaces"} if len(names) == 1 else {})}
    word = next((word for sign, word in signs.items() if line.strip().count(sign) >= len(names)), "")
    separated, fix = f"the columns are separated by {word}", "export the file with commas, and with a point in decimals"
    refuse(
        (word, Problem(f"{separated}, expected commas", file, number, fix=fix)),
        (
            all(number_of(name, decimal_comma=False) is not None for name in names),
            Problem("found numbers, expected a header row", file, number, fix="begin the file with the columns' names"),
        ),
    )
    return names


# Parts of a text table that is too large for the memory: some bytes of it in whole lines, read as a table each.

LARGE = 1 << 26
"""Bytes from which a table is read in parts: half a million poses, whose columns fill some hundred megabytes."""
_PART = 1 << 24
"""Bytes of a part: the columns and errors of its poses are small beside the programs' own memory."""
_SAMPLES, _SAMPLE = 256, 1 << 13
"""Places of the file, evenly spread, and bytes at each, that are a sample of it: some ten thousand poses."""


class TableRows:
    """Some rows of a large table; a reader has a class of its own."""

    def table(self, options: TableOptions) -> Table:
        """Return the rows as a table."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class TablePart(TableRows):
    """Lines of a large text table."""

    path: str
    head: bytes
    """First lines of the file, up to the names of the columns."""
    spans: tuple[tuple[int, int, int], ...]
    """First byte, byte behind the last one, and number of the first line of each piece."""
    sha256: str
    """Digest of the whole file."""

    def table(self, options: TableOptions) -> Table:
        """Return the lines as a table."""
        return PartTable(self, options)

    @classmethod
    def divided(cls, path: str, options: TableOptions) -> "tuple[TablePart, ...]":
        """Return an evenly spread sample of a large file of the documented form, and the parts that are the whole.

        Nothing for any other file.

        The file is read once, for its digest and the numbers of its lines.

        Raises:
            InputError: The file cannot be read, or is no table.
        """
        if "://" not in path and not (os.path.isfile(path) and os.path.getsize(path) >= LARGE):
            return ()
        with opened(path) as stream:
            if (size := stream.seek(0, os.SEEK_END)) < LARGE:
                return ()
            stream.seek(0)
            lines = stream.read(MAX_LINE).split(b"\n")
            names = next(
                (i for i, line in enumerate(lines) if line.strip() and not line.removeprefix(BOM).startswith(b"#")),
                None,
            )
            if names is None or b"\0" in lines[0]:
                return ()
            head = b"\n".join(lines[: names + 1]) + b"\n"
            try:
                table = TextTable(io.BytesIO(head), path, options)
            except InputError:
                return ()  # The whole file shows what it is.
            if not table.dialect.is_documented or not all(map(options.is_known, table.names)):
                return ()
            stream.seek(0)
            ends = np.linspace(len(head), size, 1 + -(-(size - len(head)) // _PART), dtype=np.int64)
            samples = np.linspace(len(head), size, 2 * _SAMPLES + 1, dtype=np.int64)[1::2]
            places = {len(head): (len(head), names + 2)}
            wanted = np.unique((*ends, *samples, *(samples + _SAMPLE))).tolist()[1:]
            digest, position, number = hashlib.sha256(), 0, 1
            while block := stream.read(MAX_LINE):
                digest.update(block)
                counted = 0
                while wanted and wanted[0] <= position + len(block):
                    end = block.find(b"\n", max(wanted[0] - position - 1, 0)) + 1
                    if not end:
                        break
                    number, counted = number + block.count(b"\n", counted, end), end
                    places[wanted.pop(0)] = position + end, number
                position, number = position + len(block), number + block.count(b"\n", counted)
            places |= dict.fromkeys(wanted, (position, number))

        def part(first: np.int64, last: np.int64) -> tuple[int, int, int]:
            (start, line), (stop, _) = places[int(first)], places[int(last)]
            return start, stop, line

        spread = tuple(part(start, start + _SAMPLE) for start in samples)
        pieces = [spread, *((part(*pair),) for pair in itertools.pairwise(ends))]
        return tuple(cls(path, head, spans, digest.hexdigest()) for spans in pieces)


class PartTable(TextTable):
    """Table of a part; its rows have the numbers of their lines in the file."""

    def __init__(self, part: TablePart, options: TableOptions) -> None:
        """Read the names of the columns."""
        self._part, self.sha256 = part, part.sha256
        super().__init__(io.BytesIO(part.head), part.path, options)

    def _read_blocks(self, stream: io.BufferedIOBase, number: int = 1) -> Iterator[Block]:  # type: ignore[override]
        yield from super()._read_blocks(stream, number)  # type: ignore[arg-type]
        with opened(self._part.path) as whole:
            for start, stop, first in self._part.spans:
                whole.seek(start)
                yield from super()._read_blocks(io.BytesIO(whole.read(stop - start)), first)
