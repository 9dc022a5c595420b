"""A result as workflow commands of GitHub Actions, which it shows as annotations of the run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from robacc.gates.decision_rules import Outcome
from robacc.gates.evaluate import GateOutcome
from robacc.render.text.gate_text import WORDS, sentence, title

_LEVELS: dict[Outcome, Literal["error", "warning", "notice"]] = {
    "pass": "notice",
    "fail": "error",
    "inconclusive": "warning",
    "not_evaluated": "warning",
}


def github_annotations(command: str, table: str, found: GateOutcome | None, warnings: tuple[str, ...]) -> str:
    """One line an annotation: the warnings, each criterion, and the gate; without a gate the result's first part.

    Args:
        command: That made the result.
        table: The result's report as plain text; what stands before its first empty line is shown.
        found: The gate's outcome, where there was a gate.
        warnings: Of the command.
    """
    return "".join(f"{line}\n" for line in _lines(command, table, found, warnings))


def _lines(command: str, table: str, found: GateOutcome | None, warnings: tuple[str, ...]) -> Iterator[str]:
    for warning in warnings:
        yield annotation("warning", f"robacc {command}", warning)
    if found is None:
        yield annotation("notice", f"robacc {command}", table.strip().partition("\n\n")[0])
        return
    for one in found.judged:
        head = f"{found.gate.name}: {one.criterion.name}"
        text = f"{WORDS[one.outcome]}: {sentence(one)}. Reason for the limit: {one.criterion.reason}"
        yield annotation(_LEVELS[one.outcome], head, text)
    yield annotation(_LEVELS[found.outcome], f"robacc {command}", title(found))


def annotation(level: str, head: str, text: str) -> str:
    """``::level title=HEAD::TEXT`` with what ends a property or a line escaped, as actions/toolkit does it."""
    for sign, code in (("%", "%25"), ("\r", "%0D"), ("\n", "%0A")):
        head, text = head.replace(sign, code), text.replace(sign, code)
    head = head.replace(":", "%3A").replace(",", "%2C")
    return f"::{level} title={head}::{text}"
