"""The catalogue of effects as text to read."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from typing import TextIO

from robacc.effects.catalogue import CatalogueEntry
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import BLANK, TextLine, heading

_COEFFICIENTS_SHOWN = 12
_LABEL = 16
"""Columns that the labels take."""


def draw_effects(entries: Sequence[CatalogueEntry], in_detail: bool, stream: TextIO) -> None:
    """Write the catalogue to ``stream``; ``in_detail`` adds sources, examples and coefficients."""
    write_lines(_parts(entries, in_detail, width_of(stream)), stream)


def _parts(entries: Sequence[CatalogueEntry], in_detail: bool, width: int) -> Iterator[TextLine]:
    for number, entry in enumerate(entries):
        if number:
            yield BLANK
        yield heading(entry.name)
        yield from (
            TextLine(text)
            for text in textwrap.wrap(entry.about.summary, width, initial_indent="  ", subsequent_indent="  ")
        )
        for label, value in _facts(entry, in_detail):
            indent = " " * (_LABEL + 2)
            first = f"  {label:<{_LABEL}}"
            lines = textwrap.wrap(value, width, initial_indent=first, subsequent_indent=indent, break_on_hyphens=False)
            yield from (TextLine(text) for text in lines)


def _facts(entry: CatalogueEntry, in_detail: bool) -> Iterator[tuple[str, str]]:
    about = entry.about
    yield "equation", about.equation
    yield "unit", about.unit
    yield "usual size", about.usual_size
    yield "needs", about.needs
    yield "confused with", about.confused_with
    if in_detail:
        yield "source", about.source
        yield "in a file", about.example
    if entry.offer is None:
        return
    if entry.offer.why is not None:
        yield "this robot", f"not applicable: {entry.offer.why}"
        return
    yield "this robot", "applicable" + (f" to {', '.join(entry.offer.joints)}" if entry.offer.joints else "")
    if in_detail:
        names = [f"{name} ({unit})" for name, unit in entry.offer.coefficients]
        more = f" and {len(names) - _COEFFICIENTS_SHOWN} more" if len(names) > _COEFFICIENTS_SHOWN else ""
        yield "coefficients", ", ".join(names[:_COEFFICIENTS_SHOWN]) + more
