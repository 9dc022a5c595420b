"""The outcome of a gate as text for a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TextIO

from robacc.gates.evaluate import GateOutcome
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.gate_text import OUTCOME_LABELS, sentence, title
from robacc.render.text.layout import BLANK, TextLine, heading, wrapped

_INDENT = 15
"""Columns: the longest outcome and two spaces."""


def draw_gate(outcome: GateOutcome, stream: TextIO) -> None:
    """Write the outcome of the gate and of each criterion to ``stream``."""
    write_lines(gate_lines(outcome, width_of(stream)), stream)


def gate_lines(outcome: GateOutcome, width: int) -> Iterator[TextLine]:
    """Return the report's lines; text is wrapped to ``width`` columns."""
    yield heading(title(outcome))
    for evaluation in outcome.evaluations:
        yield BLANK
        label = f"{OUTCOME_LABELS[evaluation.outcome]:<{_INDENT}}{evaluation.criterion.name}"
        yield TextLine(label, "bold" if evaluation.outcome != "pass" else "")
        for text, style in ((sentence(evaluation), ""), (f"Reason: {evaluation.criterion.reason}", "dim")):
            for line in wrapped(text, width - _INDENT):
                yield TextLine(" " * _INDENT + line.text, "dim" if style else "")
