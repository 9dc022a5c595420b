"""What a gate says of a result as JUnit XML: a suite a gate, a case a criterion.

Valid by the two schemas that are in use, Jenkins' xUnit plug-in's and the one derived from Ant's own report, which asks
for a time and a host: both stand there as constants, so that equal results give equal bytes.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from xml.sax.saxutils import escape, quoteattr

from robacc.gates.evaluate import GateOutcome, Judged
from robacc.outcomes import FileOutcome
from robacc.render.text.gate_text import WORDS, sentence, title

_NO_TIME = "1970-01-01T00:00:00"
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit(command: str, found: GateOutcome) -> str:
    """The document. A failed criterion is a failure; one that could not be decided is an error, so it never passes."""
    return _document(_suite(command, 0, found.gate.name, found))


def junit_of_files(command: str, outcomes: Sequence[FileOutcome]) -> str:
    """A suite a file; one that came to no result has an error in the place of its criteria."""
    lines: list[str] = []
    for number, one in enumerate(outcomes):
        lines += _failed(command, number, one) if one.gate is None else _suite(command, number, one.name, one.gate)
    return _document(lines)


def _document(lines: Iterable[str]) -> str:
    whole = ('<?xml version="1.0" encoding="UTF-8"?>', "<testsuites>", *lines, "</testsuites>")
    return "".join(f"{line}\n" for line in whole)


def _suite(command: str, number: int, name: str, found: GateOutcome) -> Iterator[str]:
    errors = found.count("inconclusive") + found.count("not_evaluated")
    yield _opening(command, number, name, len(found.judged), found.count("fail"), errors)
    for one in found.judged:
        yield from _case(command, name, one)
    yield from _closing(title(found), "\n".join(found.warnings))


def _failed(command: str, number: int, one: FileOutcome) -> Iterator[str]:
    yield _opening(command, number, one.name, 1, 0, 1)
    yield f"    <testcase{_attributes(name=command, classname=f'robacc.{command}.{one.name}', time='0')}>"
    yield f"      <error{_attributes(message=one.problems[0].message, type='no result')}/>"
    yield "    </testcase>"
    yield from _closing("", "\n".join(str(problem) for problem in one.problems))


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


def _case(command: str, suite: str, one: Judged) -> Iterator[str]:
    case = _attributes(name=one.criterion.name, classname=f"robacc.{command}.{suite}", time="0")
    if one.outcome == "pass":
        yield f"    <testcase{case}/>"
        return
    tag = "failure" if one.outcome == "fail" else "error"
    message = _attributes(message=f"{WORDS[one.outcome]}: {sentence(one)}", type=one.outcome)
    yield f"    <testcase{case}>"
    yield f"      <{tag}{message}>{_text(f'Reason for the limit: {one.criterion.reason}')}</{tag}>"
    yield "    </testcase>"


def _attributes(**values: str) -> str:
    return "".join(f" {name}={quoteattr(_clean(value))}" for name, value in values.items())


def _text(value: str) -> str:
    return escape(_clean(value))


def _clean(value: str) -> str:
    """Without the characters that XML does not have."""
    return _NOT_XML.sub("\ufffd", value)
