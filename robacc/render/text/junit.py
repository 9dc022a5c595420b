"""Gate outcomes as JUnit XML: one suite per gate, one case per criterion.

The output is valid under both common schemas, that of Jenkins' xUnit plug-in and that derived from Ant's report. Ant's
schema requires a host, which is a constant. The cases of a suite have equal shares of its time: readers add them up.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from xml.sax.saxutils import escape, quoteattr

from robacc.gates.evaluate import CriterionEvaluation, GateOutcome
from robacc.outcomes import FileOutcome
from robacc.render.text.gate_text import OUTCOME_LABELS, sentence, title
from robacc.render.text.parameter_names import as_options

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
    yield f"    <system-out>{_text(out)}</system-out>"
    yield f"    <system-err>{_text(error)}</system-err>"
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
    yield f"      <{tag}{message}>{_text(f'Reason for the limit: {evaluation.criterion.reason}')}</{tag}>"
    yield "    </testcase>"


def _attributes(**values: str) -> str:
    return "".join(f" {name}={quoteattr(_clean(value))}" for name, value in values.items())


def _text(value: str) -> str:
    return escape(_clean(value))


def _clean(value: str) -> str:
    """Replace the characters that XML does not allow."""
    return _NOT_XML.sub("\ufffd", value)
