"""Gate outcomes as JUnit XML: one suite per gate, one case per criterion.

The output is valid under both common schemas, that of Jenkins' xUnit plug-in and that derived from Ant's report. Ant's
schema requires a time and a host; both are constants, so that equal results give equal bytes.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from xml.sax.saxutils import escape, quoteattr

from robacc.gates.evaluate import CriterionEvaluation, GateOutcome
from robacc.outcomes import FileOutcome
from robacc.render.text.gate_text import OUTCOME_LABELS, sentence, title
from robacc.render.text.parameter_names import as_options

_NO_TIME = "1970-01-01T00:00:00"
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit(command: str, outcome: GateOutcome) -> str:
    """Return the document; a failed criterion is a failure, an undecided criterion is an error and never passes."""
    return _document(_suite(command, 0, outcome.gate.name, outcome))


def junit_of_files(command: str, outcomes: Sequence[FileOutcome]) -> str:
    """Return one suite per file; a file without a result has an error instead of its criteria."""
    lines: list[str] = []
    for number, outcome in enumerate(outcomes):
        lines += (
            _failed(command, number, outcome)
            if outcome.gate is None
            else _suite(command, number, outcome.name, outcome.gate)
        )
    return _document(lines)


def _document(lines: Iterable[str]) -> str:
    document = ('<?xml version="1.0" encoding="UTF-8"?>', "<testsuites>", *lines, "</testsuites>")
    return "".join(f"{line}\n" for line in document)


def _suite(command: str, number: int, name: str, outcome: GateOutcome) -> Iterator[str]:
    errors = outcome.count("inconclusive") + outcome.count("not_evaluated")
    yield _opening(command, number, name, len(outcome.evaluations), outcome.count("fail"), errors)
    for evaluation in outcome.evaluations:
        yield from _case(command, name, evaluation)
    yield from _closing(title(outcome), "\n".join(outcome.warnings))


def _failed(command: str, number: int, outcome: FileOutcome) -> Iterator[str]:
    yield _opening(command, number, outcome.name, 1, 0, 1)
    yield f"    <testcase{_attributes(name=command, classname=f'robacc.{command}.{outcome.name}', time='0')}>"
    yield f"      <error{_attributes(message=as_options(outcome.problems[0].message), type='no result')}/>"
    yield "    </testcase>"
    yield from _closing("", "\n".join(as_options(str(problem)) for problem in outcome.problems))


def _opening(command: str, number: int, name: str, tests: int, failures: int, errors: int) -> str:
    suite = _attributes(
        id=str(number),
        package=f"robacc.{command}",
        name=name,
        timestamp=_NO_TIME,
        hostname="localhost",
        tests=str(tests),
        failures=str(failures),
        errors=str(errors),
        time="0",
    )
    return f"  <testsuite{suite}>\n    <properties/>"


def _closing(out: str, error: str) -> Iterator[str]:
    yield f"    <system-out>{_text(out)}</system-out>"
    yield f"    <system-err>{_text(error)}</system-err>"
    yield "  </testsuite>"


def _case(command: str, suite: str, evaluation: CriterionEvaluation) -> Iterator[str]:
    case = _attributes(name=evaluation.criterion.name, classname=f"robacc.{command}.{suite}", time="0")
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
