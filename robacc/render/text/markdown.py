"""A result and what a gate says of it as Markdown, for a job's summary or a comment on a pull request."""

from __future__ import annotations

import re
from collections.abc import Iterator

from robacc.gates.decision_rules import Outcome
from robacc.gates.evaluate import GateOutcome, Judged
from robacc.render.text.gate_text import WORDS, amount, bounds, limit, poses_needed, probability, title, value

_SIGNS: dict[Outcome, str] = {"pass": "✅", "fail": "❌", "inconclusive": "❔", "not_evaluated": "⚠️"}
_HEADER = ("", "criterion", "key", "value", "limit", "bounds", "margin", "conforms")


def markdown(command: str, table: str, found: GateOutcome | None, warnings: tuple[str, ...]) -> str:
    """The gate's table, the warnings, and the result's own report, folded where a gate stands above it.

    Args:
        command: That made the result.
        table: The result's report as plain text; empty where the gate's outcome is all there is.
        found: The gate's outcome, where there was a gate.
        warnings: Of the command.
    """
    lines = [f"## robacc {_text(command)}", ""]
    if found is not None:
        lines += [*_gate(found), ""]
    for warning in warnings:
        lines += [f"> **Warning:** {_text(warning)}", ""]
    if not table:
        return "\n".join(lines[:-1]) + "\n"
    fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", table)), default=0))
    body = [f"{fence}text", table.rstrip("\n"), fence]
    if found is not None:
        body = ["<details><summary>The whole result</summary>", "", *body, "", "</details>"]
    return "\n".join([*lines, *body]) + "\n"


def _gate(found: GateOutcome) -> Iterator[str]:
    yield f"### {_SIGNS[found.outcome]} {_text(title(found))}"
    yield ""
    yield _row(_HEADER)
    yield _row(["---"] * len(_HEADER))
    for one in found.judged:
        yield _row([_SIGNS[one.outcome], *map(_text, _cells(one))])
    yield ""
    for one in found.judged:
        told = [WORDS[one.outcome], *(text for text in (one.decision.why, poses_needed(one)) if text)]
        yield f"- **{_text(one.criterion.name)}**: {_text('; '.join(told))}. Reason: {_text(one.criterion.reason)}"


def _cells(one: Judged) -> tuple[str, ...]:
    margin = amount(one.decision.margin, one.dimension)
    between = (bounds(one) or "–").strip("()")
    return one.criterion.name, one.criterion.key, value(one), limit(one), between, margin, probability(one) or "–"


def _row(cells: list[str] | tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"


def _text(text: str) -> str:
    """Text that Markdown shows as it stands, in a table's cell too."""
    return re.sub(r"([\\`*_\[\]<>|#~])", r"\\\1", " ".join(text.split()))
