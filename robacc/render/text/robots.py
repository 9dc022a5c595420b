"""The arms that come with the package, as a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TextIO

from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import BLANK, TextLine, items
from robacc.render.text.units import IN_MM
from robacc.robots.library import LibraryArm

_USE = (
    "`robot` takes a name of this list; each is the nominal model of a data sheet, without the tool: robacc init NAME "
    "writes a copy to which you add the tool or several targets"
)


def draw_robots(arms: Sequence[LibraryArm], stream: TextIO) -> None:
    """Write a line per arm to ``stream``."""
    rows = [("name", "maker", "model", "axes", "reach mm")]
    rows += [(arm.key, arm.maker, arm.model, str(arm.axes), f"{arm.reach * IN_MM:.0f}") for arm in arms]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    texts = [
        "  ".join(
            f"{cell:>{width}}" if place > 2 else f"{cell:<{width}}"
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    ]
    lines = [TextLine(text, "dim" if number == 0 else "") for number, text in enumerate(texts)]
    write_lines([*lines, BLANK, *items([_USE], width_of(stream))], stream)
