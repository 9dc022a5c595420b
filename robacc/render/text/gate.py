"""The outcome of a gate: for a terminal, as Markdown, as annotations of a workflow, and as JUnit XML."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal, TextIO
from xml.sax.saxutils import escape, quoteattr

from robacc.gates.decision_rules import Outcome
from robacc.gates.evaluate import CriterionEvaluation, GateOutcome
from robacc.outcomes import FileOutcome
from robacc.render.text.console import GREEN, RED, YELLOW, say, width_of, write_lines
from robacc.render.text.layout import BLANK, IN_DEGREES, IN_MM, Style, TextLine, three_digits, wrapped
from robacc.render.text.parameter_names import as_options
from robacc.statistics.confidence_curves import ASSURANCE

# Gate outcomes as text: the same wording in a table, a job summary, an annotation and JUnit.

OUTCOME_LABELS: dict[Outcome, str] = {
    "pass": "pass",
    "fail": "fail",
    "inconclusive": "inconclusive",
    "not_evaluated": "not evaluated",
}
_SCALES = {"length": (IN_MM, " mm"), "angle": (IN_DEGREES, "°")}


def amount(value: float | None, dimension: str) -> str:
    """Return the value in mm, degrees or without unit, three digits; a dash for None."""
    if value is None:
        return "–"
    factor, unit = _SCALES.get(dimension, (1.0, ""))
    return f"{three_digits(factor * value)}{unit}"


def title(outcome: GateOutcome) -> str:
    """Return the gate's name and outcome, and the number of criteria with each outcome."""
    counts = [f"{outcome.count(kind)} {label}" for kind, label in OUTCOME_LABELS.items() if outcome.count(kind)]
    return f"Gate {outcome.gate.name}: {OUTCOME_LABELS[outcome.outcome].upper()} ({', '.join(counts)})"


def limit(evaluation: CriterionEvaluation) -> str:
    """Return the limit with its direction."""
    criterion = evaluation.criterion
    if criterion.kind == "grade":
        return f"{criterion.accepted[0]} or better"
    if criterion.kind == "word":
        return " or ".join(criterion.accepted)
    factor, unit = _SCALES.get(criterion.kind, (1.0, ""))
    size = f"{factor * abs(criterion.limit or 0.0):.6g}{unit}"
    if criterion.baseline is None:
        return f"at least {size}" if criterion.at_least else f"at most {size}"
    if not criterion.limit:
        return f"no {'less' if criterion.at_least else 'more'} than in {criterion.baseline}"
    # A limit on a difference has a sign and a direction.
    is_increase = criterion.limit > 0.0
    extent = "at most" if is_increase != criterion.at_least else "at least"
    return f"{extent} {size} {'more' if is_increase else 'less'} than in {criterion.baseline}"


def value(evaluation: CriterionEvaluation) -> str:
    """Return the measured value; for a comparison, also the baseline's value."""
    if evaluation.word is not None:
        return evaluation.word
    if evaluation.value is None:
        return "missing"
    if evaluation.baseline_value is None:
        return amount(evaluation.value, evaluation.dimension)
    difference = amount(abs(evaluation.value), evaluation.dimension)
    relation = (
        "same as" if evaluation.value == 0.0 else f"{difference} {'more' if evaluation.value > 0.0 else 'less'} than"
    )
    baseline = amount(evaluation.baseline_value, evaluation.dimension)
    measured = amount(evaluation.value + evaluation.baseline_value, evaluation.dimension)
    return f"{measured}, {relation} the {baseline} in {evaluation.criterion.baseline}"


def bounds(evaluation: CriterionEvaluation) -> str | None:
    """Return the bounds that the rule used, None if it used none."""
    lower, upper = evaluation.decision.lower_bound, evaluation.decision.upper_bound
    if evaluation.criterion.rule == "simple" or evaluation.is_by_share or (lower is None and upper is None):
        return None
    suffix = "" if evaluation.baseline_value is None else " for the difference"
    interval = f"{amount(lower, evaluation.dimension)} to {amount(upper, evaluation.dimension)}"
    return f"({interval}{suffix}, each bound at {100 * evaluation.criterion.confidence:g} % confidence)"


def probability(evaluation: CriterionEvaluation) -> str | None:
    """Return the conformity probability in percent, between ``< 0.1 %`` and ``> 99.9 %``."""
    conformity = evaluation.decision.probability
    if conformity is None:
        return None
    percent = 100.0 * conformity
    return "> 99.9 %" if percent > 99.9 else "< 0.1 %" if percent < 0.1 else f"{percent:.1f} %"


def poses_needed(evaluation: CriterionEvaluation) -> str | None:
    """Return the number of poses or visits that would decide an inconclusive criterion, None where unknown."""
    if evaluation.outcome != "inconclusive":
        return None
    needed, needed_if_true = evaluation.decision.poses_to_decide, evaluation.decision.poses_if_true
    if needed is None:
        # The distance to the limit is unknown without bounds or without a number of poses.
        too_close = needed_if_true is None and evaluation.decision.why is None and evaluation.n is not None
        return "the value is too close to the limit for any number of poses to decide" if too_close else None
    # ISO 9283 results count visits of a few commanded poses.
    counted = "visits" if evaluation.criterion.key.startswith("iso9283.") else "poses"
    text = f"{needed} {counted} in total would decide it with a probability of {100 * ASSURANCE:.0f} %"
    if needed_if_true is None or needed_if_true == needed:
        return text
    return f"{text}, {needed_if_true} if the measured value is the true one"


def sentence(evaluation: CriterionEvaluation) -> str:
    """Return one line with the value, bounds, limit, margin and reasons of a criterion, without its outcome."""
    statement = " ".join(text for text in (evaluation.criterion.key, value(evaluation), bounds(evaluation)) if text)
    parts = [f"{statement}, expected {limit(evaluation)}"]
    if evaluation.decision.margin is not None:
        parts.append(f"margin {amount(evaluation.decision.margin, evaluation.dimension)}")
    if (chance := probability(evaluation)) is not None:
        parts.append(f"conforms with probability {chance}")
    return "; ".join([*parts, *explanations(evaluation)])


def explanations(evaluation: CriterionEvaluation) -> list[str]:
    """Return the reason for the decision and the number of poses that would decide, as far as known."""
    why = None if evaluation.decision.why is None else as_options(evaluation.decision.why)
    return [text for text in (why, poses_needed(evaluation)) if text]


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


# Gate outcomes as JUnit XML: one suite per gate, one case per criterion.
#
# The output is valid under both common schemas, that of Jenkins' xUnit plug-in and that derived from Ant's report.
# Ant's schema requires a host, which is a constant. The cases of a suite have equal shares of its time: readers add
# them up.

_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True, slots=True)
class _Suite:
    """Attributes that the elements of a suite share."""

    command: str
    number: int
    name: str
    started: float
    """Seconds since 1970."""
    seconds: float
    """Elapsed time of the command on the suite."""


def junit(command: str, outcome: GateOutcome, started: float = 0.0, seconds: float = 0.0) -> str:
    """Return the document; a failed criterion is a failure, an undecided criterion is an error and never passes.

    Args:
        command: Name of the command.
        outcome: Outcome of its gate.
        started: Start of the command, seconds since 1970.
        seconds: Elapsed time of the command.
    """
    return _document(_suite(_Suite(command, 0, outcome.gate.name, started, seconds), outcome))


def junit_of_files(command: str, outcomes: Sequence[FileOutcome], started: float = 0.0) -> str:
    """Return one suite per file; a file without a result has an error instead of its criteria."""
    lines: list[str] = []
    for number, outcome in enumerate(outcomes):
        suite = _Suite(command, number, outcome.name, started, outcome.seconds)
        lines += _failed(suite, outcome) if outcome.gate is None else _suite(suite, outcome.gate)
    return _document(lines)


def _document(lines: Iterable[str]) -> str:
    document = ('<?xml version="1.0" encoding="UTF-8"?>', "<testsuites>", *lines, "</testsuites>")
    return "".join(f"{line}\n" for line in document)


def _suite(suite: _Suite, outcome: GateOutcome) -> Iterator[str]:
    errors = outcome.count("inconclusive") + outcome.count("not_evaluated")
    yield _opening(suite, len(outcome.evaluations), outcome.count("fail"), errors)
    share = _seconds(suite.seconds / max(1, len(outcome.evaluations)))
    for evaluation in outcome.evaluations:
        yield from _case(suite, share, evaluation)
    yield from _closing(title(outcome), "\n".join(outcome.warnings))


def _failed(suite: _Suite, outcome: FileOutcome) -> Iterator[str]:
    case = _attributes(
        name=suite.command, classname=f"robacc.{suite.command}.{suite.name}", time=_seconds(suite.seconds)
    )
    yield _opening(suite, 1, 0, 1)
    yield f"    <testcase{case}>"
    yield f"      <error{_attributes(message=as_options(outcome.problems[0].message), type='no result')}/>"
    yield "    </testcase>"
    yield from _closing("", "\n".join(as_options(str(problem)) for problem in outcome.problems))


def _opening(suite: _Suite, tests: int, failures: int, errors: int) -> str:
    attributes = _attributes(
        id=str(suite.number),
        package=f"robacc.{suite.command}",
        name=suite.name,
        timestamp=datetime.fromtimestamp(suite.started, UTC).strftime("%Y-%m-%dT%H:%M:%S"),
        hostname="localhost",
        tests=str(tests),
        failures=str(failures),
        errors=str(errors),
        time=_seconds(suite.seconds),
    )
    return f"  <testsuite{attributes}>\n    <properties/>"


def _seconds(seconds: float) -> str:
    return f"{seconds:.3f}"


def _closing(out: str, error: str) -> Iterator[str]:
    yield f"    <system-out>{_xml_text(out)}</system-out>"
    yield f"    <system-err>{_xml_text(error)}</system-err>"
    yield "  </testsuite>"


def _case(suite: _Suite, time: str, evaluation: CriterionEvaluation) -> Iterator[str]:
    case = _attributes(name=evaluation.criterion.name, classname=f"robacc.{suite.command}.{suite.name}", time=time)
    if evaluation.outcome == "pass":
        yield f"    <testcase{case}/>"
        return
    tag = "failure" if evaluation.outcome == "fail" else "error"
    message = _attributes(
        message=f"{OUTCOME_LABELS[evaluation.outcome]}: {sentence(evaluation)}", type=evaluation.outcome
    )
    yield f"    <testcase{case}>"
    yield f"      <{tag}{message}>{_xml_text(f'Reason for the limit: {evaluation.criterion.reason}')}</{tag}>"
    yield "    </testcase>"


def _attributes(**values: str) -> str:
    return "".join(f" {name}={quoteattr(_clean(value))}" for name, value in values.items())


def _xml_text(value: str) -> str:
    return escape(_clean(value))


def _clean(value: str) -> str:
    """Replace the characters that XML does not allow."""
    return _NOT_XML.sub("\ufffd", value)


# A result as workflow commands of GitHub Actions, which shows them as annotations of the run.

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


# A result and its gate's outcome as Markdown, for a job summary or a comment on a pull request.

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
    lines = [f"## robacc {_escaped(command)}", ""]
    if outcome is not None:
        lines += [*_gate(outcome), ""]
    for warning in warnings:
        lines += [f"> **Warning:** {_escaped(warning)}", ""]
    if not table:
        return "\n".join(lines[:-1]) + "\n"
    fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", table)), default=0))
    body = [f"{fence}text", table.rstrip("\n"), fence]
    if outcome is not None:
        body = ["<details><summary>Full result</summary>", "", *body, "", "</details>"]
    return "\n".join([*lines, *body]) + "\n"


def _gate(outcome: GateOutcome) -> Iterator[str]:
    yield f"### {_SIGNS[outcome.outcome]} {_escaped(title(outcome))}"
    yield ""
    yield _row(_HEADER)
    yield _row(["---"] * len(_HEADER))
    for evaluation in outcome.evaluations:
        yield _row([_SIGNS[evaluation.outcome], *map(_escaped, _cells(evaluation))])
    yield ""
    for evaluation in outcome.evaluations:
        parts = [
            OUTCOME_LABELS[evaluation.outcome],
            *explanations(evaluation),
        ]
        criterion = evaluation.criterion
        yield f"- **{_escaped(criterion.name)}**: {_escaped('; '.join(parts))}. Reason: {_escaped(criterion.reason)}"


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


def _escaped(text: str) -> str:
    """Return the text escaped for Markdown and its tables."""
    return re.sub(r"([\\`*_\[\]<>|#~])", r"\\\1", " ".join(text.split()))
