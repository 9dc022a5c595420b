"""Read a sheet of a workbook (xlsx, xls, ods) as a table: its cells become lines of text, counted as rows."""

from __future__ import annotations

import datetime as dt
import hashlib
import io
import itertools
from typing import Any, BinaryIO

from robacc.errors import InputError, Problem, UsageError
from robacc.io.dialect import number_of
from robacc.io.table import TableOptions, TextTable

_LIMIT = 1 << 28
"""Largest workbook, bytes."""
_MOST_CELLS = 50_000_000
_EXAMINED = 100
"""Rows of a sheet in which a table is looked for."""
_FEWEST_NUMBERS = 3


def workbook_table(stream: BinaryIO, file: str, options: TableOptions) -> TextTable:
    """Return the table in a sheet of the workbook ``stream``, called ``file`` in messages; its cells are its text.

    Raises:
        UsageError: The extra ``excel`` is not installed, or the workbook has several sheets and none is chosen.
        InputError: The file is no workbook.
    """
    data = stream.read(_LIMIT + 1)
    if len(data) > _LIMIT:
        raise InputError(Problem("the workbook is too large", file, fix="export the sheet as CSV"))
    text, sheet = _sheet_text(data, file, options.sheet)
    table = TextTable(io.BytesIO(text.encode("utf-8", errors="replace")), file, options, "row")
    table.remarks = [remark.replace("separated by tabs", f"sheet {sheet!r}") for remark in table.remarks]
    table.sha256 = hashlib.sha256(data).hexdigest()
    return table


def _sheet_text(data: bytes, file: str, sheet: str | None) -> tuple[str, str]:
    """Return the cells of a sheet as lines separated by tabs, and the sheet's name."""
    try:
        from python_calamine import CalamineError, CalamineWorkbook
    except ImportError as error:
        message = f"{file} is a workbook, which needs an optional package: pip install 'robacc[excel]'"
        raise UsageError(message) from error
    try:
        book = CalamineWorkbook.from_filelike(io.BytesIO(data))
        names = book.sheet_names
        if sheet is not None and sheet not in names:
            raise UsageError(f"`sheet`: {file} has no sheet {sheet!r}; it has {', '.join(names)}")
        if sheet is None and len(names) > 1:
            names = [name for name in names if book.get_sheet_by_name(name).height > 1]
            tables = [name for name in names if _has_numbers(book.get_sheet_by_name(name))]
            names = tables or names
            if len(names) > 1:
                raise UsageError(f"{file} has several sheets; choose one with `sheet`: {', '.join(names)}")
        if not names:
            raise InputError(Problem("the workbook has no sheet with rows", file))
        chosen = book.get_sheet_by_name(sheet or names[0])
        if chosen.height * max(chosen.width, 1) > _MOST_CELLS:
            raise InputError(Problem("the sheet is too large", file, fix="export it as CSV"))
        rows = chosen.to_python(skip_empty_area=False)
    except (CalamineError, OSError, ValueError) as error:
        reason = str(error).strip().partition("\n")[0][:200]
        raise InputError(Problem(f"cannot be read as a workbook ({reason})", file, fix="export it as CSV")) from error
    lines = ("\t".join(map(_cell_text, row)) for row in rows)
    return "".join(f"{line}\n" for line in lines), chosen.name


def _has_numbers(sheet: Any) -> bool:
    """Return whether a sheet has a row with three numbers among its first ones, as poses have."""
    rows = itertools.islice(sheet.iter_rows(), _EXAMINED)
    texts = ([_cell_text(cell) for cell in row if not isinstance(cell, bool)] for row in rows)
    counts = (sum(number_of(text, decimal_comma="," in text) is not None for text in row) for row in texts)
    return any(count >= _FEWEST_NUMBERS for count in counts)


def _cell_text(value: Any) -> str:
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, dt.datetime):
        return value.isoformat(" ")
    if isinstance(value, dt.timedelta):
        return f"{value.total_seconds()!r}"
    return " ".join(str(value).replace('"', "''").split())
