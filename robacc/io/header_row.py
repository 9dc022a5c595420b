"""The header row of a text table: one name a column."""

from __future__ import annotations

import csv

from robacc.errors import InputError, Problem
from robacc.io.dialect import PLAIN

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
