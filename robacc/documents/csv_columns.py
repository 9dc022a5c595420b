"""CSV text from columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping


def csv_text(columns: Mapping[str, Iterable[str]]) -> str:
    """Return a header and a line for each row of columns by name; their cells stand as they are."""
    rows = zip(*columns.values(), strict=True)
    return "\n".join([",".join(columns), *(",".join(row) for row in rows)]) + "\n"


def csv_cell(text: str) -> str:
    """Return the text as a cell, in quotes where a reader would split it."""
    return '"' + text.replace('"', '""') + '"' if any(sign in text for sign in ',"\n\r') else text
