"""What a gate says of a result, to read in a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TextIO

from robacc.gates.evaluate import GateOutcome
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.gate_text import WORDS, sentence, title
from robacc.render.text.layout import BLANK, TextLine, heading, wrapped

_INDENT = 15
"""Columns of the longest outcome and two spaces."""


def draw_gate(found: GateOutcome, stream: TextIO) -> None:
    """Write the gate's outcome and each criterion's to ``stream``."""
    write_lines(gate_lines(found, width_of(stream)), stream)


def gate_lines(found: GateOutcome, width: int) -> Iterator[TextLine]:
    """The report's lines, text wrapped to ``width`` columns."""
    yield heading(title(found))
    for one in found.judged:
        yield BLANK
        yield TextLine(f"{WORDS[one.outcome]:<{_INDENT}}{one.criterion.name}", "bold" if one.outcome != "pass" else "")
        for text, style in ((sentence(one), ""), (f"Reason: {one.criterion.reason}", "dim")):
            for line in wrapped(text, width - _INDENT):
                yield TextLine(" " * _INDENT + line.text, "dim" if style else "")
