"""Reader of workbooks (xlsx, xls, ods): cells become lines of text, counted as rows; needs the extra ``excel``."""

from __future__ import annotations

import datetime as dt
import hashlib
import io
import itertools
from typing import Any, BinaryIO

from robacc.errors import InputError, Problem, UsageError, install_advice, refuse
from robacc.io.dialect import number_of
from robacc.io.table import TableOptions, TextTable

_WORKBOOK_LIMIT = 1 << 28
"""Largest workbook, bytes."""
_MOST_CELLS = 50_000_000
_EXAMINED_ROWS = 100
"""Rows of a sheet in which a table is looked for."""
_FEWEST_NUMBERS = 3


def takes(path: str, first: bytes) -> bool:
    """Return whether a file is a zipped or an old workbook, by its first bytes."""
    return first.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0"))


def read_stream(stream: BinaryIO, file: str, options: TableOptions) -> TextTable:
    """Return the table in the chosen sheet of a workbook, or in its only one with numbers.

    Raises:
        UsageError: The extra ``excel`` is not installed, or the sheet is not clear.
        InputError: The workbook cannot be read.
    """
    data = stream.read(_WORKBOOK_LIMIT + 1)
    refuse((len(data) > _WORKBOOK_LIMIT, Problem("the workbook is too large", file, fix="export the sheet as CSV")))
    try:
        from python_calamine import CalamineError, CalamineWorkbook
    except ImportError as error:
        raise UsageError(
            f"{file} is a workbook, which needs an optional package; run {install_advice('excel')}"
        ) from error
    try:
        book = CalamineWorkbook.from_filelike(io.BytesIO(data))
        names = book.sheet_names
        unknown = f"`sheet`: {file} has no sheet {options.sheet!r}; it has {', '.join(names)}"
        refuse((options.sheet is not None and options.sheet not in names, unknown))
        if options.sheet is None and len(names) > 1:
            names = [name for name in names if book.get_sheet_by_name(name).height > 1]
            names = [name for name in names if _has_numbers(book.get_sheet_by_name(name))] or names
            refuse((len(names) > 1, f"{file} has several sheets; choose one with `sheet`: {', '.join(names)}"))
        refuse((not names, Problem("the workbook has no sheet with rows", file)))
        sheet = book.get_sheet_by_name(options.sheet or names[0])
        large = Problem("the sheet is too large", file, fix="export it as CSV")
        refuse((sheet.height * max(sheet.width, 1) > _MOST_CELLS, large))
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
    rows = itertools.islice(sheet.iter_rows(), _EXAMINED_ROWS)
    texts = ([_cell_text(cell) for cell in row if not isinstance(cell, bool)] for row in rows)
    counts = (sum(number_of(text, decimal_comma="," in text) is not None for text in row) for row in texts)
    return any(count >= _FEWEST_NUMBERS for count in counts)


def _cell_text(value: Any) -> str:
    if isinstance(value, float | dt.timedelta):
        return repr(value if isinstance(value, float) else value.total_seconds())
    if isinstance(value, dt.datetime):
        return value.isoformat(" ")
    return " ".join(str(value).replace('"', "''").split())
