"""A result as workflow commands of GitHub Actions, which shows them as annotations of the run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from robacc.gates.decision_rules import Outcome
from robacc.gates.evaluate import GateOutcome
from robacc.render.text.gate_text import OUTCOME_LABELS, sentence, title

_LEVELS: dict[Outcome, Literal["error", "warning", "notice"]] = {
    "pass": "notice",
    "fail": "error",
    "inconclusive": "warning",
    "not_evaluated": "warning",
}


def github_annotations(command: str, table: str, outcome: GateOutcome | None, warnings: tuple[str, ...]) -> str:
    """Return one line per annotation: warnings, criteria and the gate; without a gate the report's first part.

    Args:
        command: The command that made the result.
        table: The report as plain text; the part before its first empty line is used.
        outcome: The gate's outcome, if a gate was checked.
        warnings: The command's warnings.
    """
    return "".join(f"{line}\n" for line in _lines(command, table, outcome, warnings))


def _lines(command: str, table: str, outcome: GateOutcome | None, warnings: tuple[str, ...]) -> Iterator[str]:
    for warning in warnings:
        yield annotation("warning", f"robacc {command}", warning)
    if outcome is None:
        yield annotation("notice", f"robacc {command}", table.strip().partition("\n\n")[0])
        return
    for evaluation in outcome.evaluations:
        criterion = evaluation.criterion
        head = f"{outcome.gate.name}: {criterion.name}"
        text = f"{OUTCOME_LABELS[evaluation.outcome]}: {sentence(evaluation)}. Reason for the limit: {criterion.reason}"
        yield annotation(_LEVELS[evaluation.outcome], head, text)
    yield annotation(_LEVELS[outcome.outcome], f"robacc {command}", title(outcome))


def annotation(level: str, head: str, text: str) -> str:
    """Return ``::level title=HEAD::TEXT``, escaped as actions/toolkit does."""
    for sign, code in (("%", "%25"), ("\r", "%0D"), ("\n", "%0A")):
        head, text = head.replace(sign, code), text.replace(sign, code)
    head = head.replace(":", "%3A").replace(",", "%2C")
    return f"::{level} title={head}::{text}"
