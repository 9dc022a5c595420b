"""The catalogue of effects as text to read."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from typing import TextIO

from robacc.effects.catalogue import CatalogueEntry
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import BLANK, TextLine, heading, wrapped

_COEFFICIENTS_SHOWN = 12
_LABEL = 16
"""Columns that the labels take."""


def draw_effects(entries: Sequence[CatalogueEntry], in_detail: bool, stream: TextIO) -> None:
    """Write the catalogue to ``stream`` as a list, or ``in_detail`` the facts of its only entry."""
    lines = _details(entries[0], width_of(stream)) if in_detail else _overview(entries, width_of(stream))
    write_lines(lines, stream)


def _overview(entries: Sequence[CatalogueEntry], width: int) -> Iterator[TextLine]:
    """Return a line or two for each effect, with the reason why it is not applicable."""
    label = max(len(entry.name) for entry in entries) + 2
    for entry in entries:
        text = entry.about.summary
        if entry.availability is not None and entry.availability.why is not None:
            text += f" (not applicable: {entry.availability.why})"
        first = f"{entry.name:<{label}}"
        lines = textwrap.wrap(text, width, initial_indent=first, subsequent_indent=" " * label)
        yield from (TextLine(line) for line in lines)
    yield BLANK
    text = "robacc effects NAME shows an effect's equation, unit, usual size, required data and similar effects"
    yield from (TextLine(line.text, "dim") for line in wrapped(text, width))


def _details(entry: CatalogueEntry, width: int) -> Iterator[TextLine]:
    """Return the facts of an effect."""
    yield heading(entry.name)
    yield from (
        TextLine(text)
        for text in textwrap.wrap(entry.about.summary, width, initial_indent="  ", subsequent_indent="  ")
    )
    for label, value in _facts(entry):
        indent = " " * (_LABEL + 2)
        first = f"  {label:<{_LABEL}}"
        lines = textwrap.wrap(value, width, initial_indent=first, subsequent_indent=indent, break_on_hyphens=False)
        yield from (TextLine(text) for text in lines)


def _facts(entry: CatalogueEntry) -> Iterator[tuple[str, str]]:
    about = entry.about
    yield "equation", about.equation
    yield "unit", about.unit
    yield "usual size", about.usual_size
    yield "needs", about.needs
    yield "confused with", about.confused_with
    yield "source", about.source
    yield "in a file", about.example
    if entry.availability is None:
        return
    if entry.availability.why is not None:
        yield "this robot", f"not applicable: {entry.availability.why}"
        return
    joints = f" to {', '.join(entry.availability.joints)}" if entry.availability.joints else ""
    yield "this robot", f"applicable{joints}"
    names = [f"{name} ({unit})" for name, unit in entry.availability.coefficients]
    more = f" and {len(names) - _COEFFICIENTS_SHOWN} more" if len(names) > _COEFFICIENTS_SHOWN else ""
    yield "coefficients", ", ".join(names[:_COEFFICIENTS_SHOWN]) + more
