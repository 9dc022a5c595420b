"""Lines of text in columns: what a report is made of before it meets a terminal or a file.

Laid out here and not by rich, whose tables take longer to draw than an estimate of 100 poses takes to compute; rich
gives the lines their looks where there is a terminal to show them.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from itertools import zip_longest
from typing import Literal, NamedTuple

Style = Literal["", "bold", "dim"]


class TextLine(NamedTuple):
    """One line and its looks."""

    text: str
    style: Style = ""


BLANK = TextLine("")


def heading(text: str) -> TextLine:
    """What stands above a part."""
    return TextLine(text, "bold")


def columns(header: Sequence[str], rows: Iterable[Sequence[str]], gap: int = 2) -> list[TextLine]:
    """A table without rules: the first column reads from the left, the others stand at the right of theirs.

    Rows may be shorter than the header; the header is left out where all of it is empty.
    """
    table = [header, *rows]
    widths = [max(map(len, cells)) for cells in zip_longest(*table, fillvalue="")]
    lines = []
    for number, row in enumerate(table):
        first, rest = f"{row[0]:<{widths[0]}}", zip(row[1:], widths[1:], strict=False)
        cells = (first, *(f"{cell:>{width}}" for cell, width in rest))
        lines.append(TextLine((" " * gap).join(cells).rstrip(), "dim" if number == 0 else ""))
    return lines if any(header) else lines[1:]


def beside(left: Sequence[TextLine], right: Sequence[TextLine], gap: int = 6) -> list[TextLine]:
    """Two tables side by side; a line looks as the left one does."""
    width = max(len(line.text) for line in left) + gap
    pairs = zip_longest(left, right, fillvalue=BLANK)
    return [TextLine(f"{one.text:<{width}}{other.text}".rstrip(), one.style) for one, other in pairs]


def items(texts: Iterable[str], width: int) -> list[TextLine]:
    """Each text with a dash, wrapped to ``width`` columns, its further lines set in."""
    lines = []
    for text in texts:
        lines += textwrap.wrap(text, width, initial_indent="- ", subsequent_indent="  ", break_long_words=False)
    return [TextLine(text) for text in lines]


def wrapped(text: str, width: int) -> list[TextLine]:
    """A paragraph, wrapped to ``width`` columns."""
    return [TextLine(one) for one in textwrap.wrap(text, width, break_long_words=False, break_on_hyphens=False)]
