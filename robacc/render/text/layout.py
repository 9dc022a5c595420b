"""Lines of text in columns, the common layout of reports for terminals and files.

rich only styles the lines on a terminal: laying out its tables takes longer than estimating 100 poses.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from itertools import zip_longest
from typing import Literal, NamedTuple

Style = Literal["", "bold", "dim", "green", "bold red", "bold yellow"]


class TextLine(NamedTuple):
    """One line and its style."""

    text: str
    style: Style = ""


BLANK = TextLine("")


def heading(text: str) -> TextLine:
    """Return the heading of a section."""
    return TextLine(text, "bold")


def columns(header: Sequence[str], rows: Iterable[Sequence[str]], gap: int = 2) -> list[TextLine]:
    """Return a table without rules, its first column aligned left and the others right.

    Rows may be shorter than the header. A header of empty cells is omitted.
    """
    table = [header, *rows]
    widths = [max(map(len, cells)) for cells in zip_longest(*table, fillvalue="")]
    lines = []
    for number, row in enumerate(table):
        first, others = f"{row[0]:<{widths[0]}}", zip(row[1:], widths[1:], strict=False)
        cells = (first, *(f"{cell:>{width}}" for cell, width in others))
        lines.append(TextLine((" " * gap).join(cells).rstrip(), "dim" if number == 0 else ""))
    return lines if any(header) else lines[1:]


def beside(left: Sequence[TextLine], right: Sequence[TextLine], gap: int = 6) -> list[TextLine]:
    """Return two tables side by side, styled as the left table."""
    width = max(len(line.text) for line in left) + gap
    pairs = zip_longest(left, right, fillvalue=BLANK)
    return [TextLine(f"{first.text:<{width}}{second.text}".rstrip(), first.style) for first, second in pairs]


def items(texts: Iterable[str], width: int) -> list[TextLine]:
    """Return each text with a dash, wrapped to ``width`` columns with a hanging indent."""
    lines = []
    for text in texts:
        lines += textwrap.wrap(text, width, initial_indent="- ", subsequent_indent="  ", break_long_words=False)
    return [TextLine(text) for text in lines]


def wrapped(text: str, width: int) -> list[TextLine]:
    """Return a paragraph wrapped to ``width`` columns."""
    return [TextLine(line) for line in textwrap.wrap(text, width, break_long_words=False, break_on_hyphens=False)]
