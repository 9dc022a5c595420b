"""Open a table: a Parquet file or a workbook, known by its first bytes, a data frame, or else text.

Other packages add readers of further kinds of files, see :class:`Reader`.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import io
import itertools
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import PurePath
from typing import Any, BinaryIO, Protocol

from robacc.errors import InputError, Problem, UsageError
from robacc.io.dialect import number_of
from robacc.io.files import STANDARD_STREAM, TEXT_LIMIT, opened
from robacc.io.table import Table, TableOptions, TextTable

_PARQUET = b"PAR1"
"""First and last bytes of every Parquet file."""
_WORKBOOKS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""First bytes of zipped and of old workbooks."""
_EXPORT, _UNPACK = "export the poses as CSV", "unpack it first"
_OTHER_FILES = {
    b"%PDF": ("a PDF document", _EXPORT),
    b"\x1f\x8b": ("compressed by gzip", _UNPACK),
    b"BZh": ("compressed by bzip2", _UNPACK),
    b"7z\xbc\xaf": ("an archive of 7-Zip", _UNPACK),
    b"\x89PNG": ("a PNG image", _EXPORT),
    b"\xff\xd8\xff": ("a JPEG image", _EXPORT),
    b"<!doctype": ("an HTML page", _EXPORT),
    b"<html": ("an HTML page", _EXPORT),
    b"<?xml": ("an XML document", _EXPORT),
}
"""What a file is that begins with these bytes, in small letters, and is no table, and what to do."""
_LONGEST = 16
"""Bytes that tell one kind of file from another."""
_SUFFIXES = frozenset({".parquet", ".pq"})
_OF_TEXT = frozenset({"", ".csv", ".txt", ".tsv", ".tab", ".prn", ".dat", ".asc", ".log", ".tum", ".json", ".jsonl"})
"""Ends of the names of text files, about which no plug-in is asked: the search for them takes a tenth of a second."""


class Reader(Protocol):
    """Reader of a further kind of files: an entry point of the group ``robacc.readers`` names an object or a module.

    Readers are asked about a folder, and about a file that no reader of this package takes by its first bytes and whose
    name or bytes are not those of a text file.
    """

    def takes(self, path: str, first: bytes) -> bool:
        """Return whether a file is of this kind, by its name or its first 16 bytes; of a folder there are none."""

    def read(self, path: str, options: TableOptions) -> Table:
        """Return the file as a table; ``-`` is standard input, of which the first bytes are not consumed yet.

        Raises:
            InputError: The file cannot be read; with its name, and the line where there is one.
            UsageError: A statement of ``options`` is wrong, or a package is missing.
        """


def _by_plug_in(path: str, first: bytes, options: TableOptions) -> Table | None:
    """Return the table that the first reader among the plug-ins makes of a file; None where none takes it."""
    from importlib.metadata import entry_points

    for entry in entry_points(group="robacc.readers"):
        try:
            reader: Reader = entry.load()
        except (ImportError, AttributeError) as error:
            raise UsageError(f"the reader {entry.name} ({entry.value}) cannot be loaded: {error}") from error
        if reader.takes(path, first):
            return reader.read(path, options)
    return None


@contextmanager
def open_table(path: str, options: TableOptions) -> Iterator[Table]:
    """Open the file, or standard input for ``-``, as a table.

    Raises:
        InputError: The file cannot be opened or read.
        UsageError: The file is Parquet, and the extra ``parquet`` is not installed.
    """
    if options.frame is not None:
        from robacc.io.column_table import ColumnTable, frame_columns

        yield ColumnTable(frame_columns(options.frame, path), path, options.skip_gaps)
    elif os.path.isdir(path):
        if (table := _by_plug_in(path, b"", options)) is None:
            raise InputError(
                Problem(
                    "is a folder, expected a file",
                    path,
                    fix="name a file, or the folder of a ROS 2 bag with its metadata.yaml",
                )
            )
        yield table
    else:
        with opened(path) as stream:
            yield _table(stream, "<stdin>" if path == STANDARD_STREAM else path, options)


def _table(stream: BinaryIO, file: str, options: TableOptions) -> Table:
    if hasattr(stream, "peek"):
        first = bytes(stream.peek(_LONGEST)[:_LONGEST])
    else:
        first = stream.read(_LONGEST)
        stream.seek(0)
    text = first.removeprefix(b"\xef\xbb\xbf").lstrip()
    if first.startswith(_PARQUET):
        from robacc.io.column_table import ParquetTable

        return ParquetTable(stream, file, options.skip_gaps)
    if first.startswith(_WORKBOOKS):
        return _workbook_table(stream, file, options)
    if re.match(rb"\{|\[\s*[\[{]|(---\s+)?header:", text) or file.lower().endswith((".yaml", ".yml")):
        from robacc.io.column_table import records_table

        return records_table(stream.read(TEXT_LIMIT), file, options.skip_gaps)
    suffix = PurePath(file).suffix.lower()
    other = next(
        (kind for start, kind in _OTHER_FILES.items() if start in (first[: len(start)], text.lower()[: len(start)])),
        None,
    )
    is_text = b"\0" not in first or first.startswith((b"\xff\xfe", b"\xfe\xff"))  # UTF-16
    if other or not is_text or suffix not in _OF_TEXT:
        path = STANDARD_STREAM if stream is sys.stdin.buffer else file
        if (table := _by_plug_in(path, first, options)) is not None:
            return table
    if other:
        raise InputError(Problem(f"is {other[0]}, expected a table of poses", file, fix=other[1]))
    if suffix in _SUFFIXES:
        raise InputError(
            Problem(
                "is not a Parquet file: it does not begin with PAR1",
                file,
                fix="export it again, or rename it to .csv if it is text",
            )
        )
    return TextTable(stream, file, options)


# Sheets of workbooks (xlsx, xls, ods): their cells become lines of text, counted as rows.

_LIMIT = 1 << 28
"""Largest workbook, bytes."""
_MOST_CELLS = 50_000_000
_EXAMINED = 100
"""Rows of a sheet in which a table is looked for."""
_FEWEST_NUMBERS = 3


def _workbook_table(stream: BinaryIO, file: str, options: TableOptions) -> TextTable:
    """Return the table in the chosen sheet of a workbook, or in its only one with numbers."""
    data = stream.read(_LIMIT + 1)
    if len(data) > _LIMIT:
        raise InputError(Problem("the workbook is too large", file, fix="export the sheet as CSV"))
    try:
        from python_calamine import CalamineError, CalamineWorkbook
    except ImportError as error:
        raise UsageError(
            f"{file} is a workbook, which needs an optional package: pip install 'robacc[excel]'"
        ) from error
    try:
        book = CalamineWorkbook.from_filelike(io.BytesIO(data))
        names = book.sheet_names
        if options.sheet is not None and options.sheet not in names:
            raise UsageError(f"`sheet`: {file} has no sheet {options.sheet!r}; it has {', '.join(names)}")
        if options.sheet is None and len(names) > 1:
            names = [name for name in names if book.get_sheet_by_name(name).height > 1]
            names = [name for name in names if _has_numbers(book.get_sheet_by_name(name))] or names
            if len(names) > 1:
                raise UsageError(f"{file} has several sheets; choose one with `sheet`: {', '.join(names)}")
        if not names:
            raise InputError(Problem("the workbook has no sheet with rows", file))
        sheet = book.get_sheet_by_name(options.sheet or names[0])
        if sheet.height * max(sheet.width, 1) > _MOST_CELLS:
            raise InputError(Problem("the sheet is too large", file, fix="export it as CSV"))
        rows = sheet.to_python(skip_empty_area=False)
    except (CalamineError, OSError, ValueError) as error:
        reason = str(error).strip().partition("\n")[0][:200]
        raise InputError(Problem(f"cannot be read as a workbook ({reason})", file, fix="export it as CSV")) from error
    text = "".join("\t".join(map(_cell_text, row)) + "\n" for row in rows)
    table = TextTable(io.BytesIO(text.encode(errors="replace")), file, options, "row")
    table.log.remarks = [text.replace("separated by tabs", f"sheet {sheet.name!r}") for text in table.log.remarks]
    table.sha256 = hashlib.sha256(data).hexdigest()
    return table


def _has_numbers(sheet: Any) -> bool:
    """Return whether a sheet has a row with three numbers among its first ones, as poses have."""
    rows = itertools.islice(sheet.iter_rows(), _EXAMINED)
    texts = ([_cell_text(cell) for cell in row if not isinstance(cell, bool)] for row in rows)
    counts = (sum(number_of(text, decimal_comma="," in text) is not None for text in row) for row in texts)
    return any(count >= _FEWEST_NUMBERS for count in counts)


def _cell_text(value: Any) -> str:
    if isinstance(value, float | dt.timedelta):
        return repr(value if isinstance(value, float) else value.total_seconds())
    if isinstance(value, dt.datetime):
        return value.isoformat(" ")
    return " ".join(str(value).replace('"', "''").split())
