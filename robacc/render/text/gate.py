"""The outcome of a gate as text for a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TextIO

from robacc.gates.decision_rules import Outcome
from robacc.gates.evaluate import GateOutcome
from robacc.render.text.console import GREEN, RED, YELLOW, say, width_of, write_lines
from robacc.render.text.gate_text import OUTCOME_LABELS, sentence, title
from robacc.render.text.layout import BLANK, Style, TextLine, wrapped

_INDENT = 15
"""Columns: the longest outcome and two spaces."""
_STYLES: dict[Outcome, Style] = {
    "pass": "green",
    "fail": "bold red",
    "inconclusive": "bold yellow",
    "not_evaluated": "bold yellow",
}
_COLOURS: dict[Outcome, str] = {"pass": GREEN, "fail": RED, "inconclusive": YELLOW, "not_evaluated": YELLOW}


def say_gate(outcome: GateOutcome) -> None:
    """Write the outcome, and each criterion that does not pass, to standard error: for a log without the table."""
    say(title(outcome), _COLOURS[outcome.outcome])
    for evaluation in outcome.evaluations:
        if evaluation.outcome != "pass":
            label = OUTCOME_LABELS[evaluation.outcome]
            say(f"{label}: {evaluation.criterion.name}: {sentence(evaluation)}", _COLOURS[evaluation.outcome])


def draw_gate(outcome: GateOutcome, stream: TextIO) -> None:
    """Write the outcome of the gate and of each criterion to ``stream``."""
    write_lines(gate_lines(outcome, width_of(stream)), stream)


def gate_lines(outcome: GateOutcome, width: int) -> Iterator[TextLine]:
    """Return the report's lines; text is wrapped to ``width`` columns."""
    yield TextLine(title(outcome), _STYLES[outcome.outcome])
    for evaluation in outcome.evaluations:
        yield BLANK
        label = f"{OUTCOME_LABELS[evaluation.outcome]:<{_INDENT}}{evaluation.criterion.name}"
        yield TextLine(label, _STYLES[evaluation.outcome])
        for text, style in ((sentence(evaluation), ""), (f"Reason: {evaluation.criterion.reason}", "dim")):
            for line in wrapped(text, width - _INDENT):
                yield TextLine(" " * _INDENT + line.text, "dim" if style else "")
