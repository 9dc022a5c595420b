"""A result and its gate's outcome as Markdown, for a job summary or a comment on a pull request."""

from __future__ import annotations

import re
from collections.abc import Iterator

from robacc.gates.decision_rules import Outcome
from robacc.gates.evaluate import CriterionEvaluation, GateOutcome
from robacc.render.text.gate_text import OUTCOME_LABELS, amount, bounds, explanations, limit, probability, title, value

_SIGNS: dict[Outcome, str] = {"pass": "✅", "fail": "❌", "inconclusive": "❔", "not_evaluated": "⚠️"}
_HEADER = ("", "criterion", "key", "value", "limit", "bounds", "margin", "conforms")


def markdown(command: str, table: str, outcome: GateOutcome | None, warnings: tuple[str, ...]) -> str:
    """Return the gate's table, the warnings and the report, which is collapsed below a gate.

    Args:
        command: The command that made the result.
        table: The report as plain text; empty if there is only the gate's outcome.
        outcome: The gate's outcome, if a gate was checked.
        warnings: The command's warnings.
    """
    lines = [f"## robacc {_text(command)}", ""]
    if outcome is not None:
        lines += [*_gate(outcome), ""]
    for warning in warnings:
        lines += [f"> **Warning:** {_text(warning)}", ""]
    if not table:
        return "\n".join(lines[:-1]) + "\n"
    fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", table)), default=0))
    body = [f"{fence}text", table.rstrip("\n"), fence]
    if outcome is not None:
        body = ["<details><summary>Full result</summary>", "", *body, "", "</details>"]
    return "\n".join([*lines, *body]) + "\n"


def _gate(outcome: GateOutcome) -> Iterator[str]:
    yield f"### {_SIGNS[outcome.outcome]} {_text(title(outcome))}"
    yield ""
    yield _row(_HEADER)
    yield _row(["---"] * len(_HEADER))
    for evaluation in outcome.evaluations:
        yield _row([_SIGNS[evaluation.outcome], *map(_text, _cells(evaluation))])
    yield ""
    for evaluation in outcome.evaluations:
        parts = [
            OUTCOME_LABELS[evaluation.outcome],
            *explanations(evaluation),
        ]
        criterion = evaluation.criterion
        yield f"- **{_text(criterion.name)}**: {_text('; '.join(parts))}. Reason: {_text(criterion.reason)}"


def _cells(evaluation: CriterionEvaluation) -> tuple[str, ...]:
    margin = amount(evaluation.decision.margin, evaluation.dimension)
    interval = (bounds(evaluation) or "–").strip("()")
    return (
        evaluation.criterion.name,
        evaluation.criterion.key,
        value(evaluation),
        limit(evaluation),
        interval,
        margin,
        probability(evaluation) or "–",
    )


def _row(cells: list[str] | tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"


def _text(text: str) -> str:
    """Return the text escaped for Markdown and its tables."""
    return re.sub(r"([\\`*_\[\]<>|#~])", r"\\\1", " ".join(text.split()))
