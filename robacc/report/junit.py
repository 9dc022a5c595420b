"""What a gate says of a result as JUnit XML: a suite a gate, a case a criterion.

Valid by the two schemas that are in use, Jenkins' xUnit plug-in's and the one derived from Ant's own report, which asks
for a time and a host: both stand there as constants, so that equal results give equal bytes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from xml.sax.saxutils import escape, quoteattr

from robacc.gates.judging import GateOutcome, Judged
from robacc.report.gate_text import WORDS, sentence, title

_NO_TIME = "1970-01-01T00:00:00"
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit(command: str, found: GateOutcome) -> str:
    """The document. A failed criterion is a failure; one that could not be decided is an error, so it never passes."""
    return "".join(f"{line}\n" for line in _lines(command, found))


def _lines(command: str, found: GateOutcome) -> Iterator[str]:
    failures = found.count("fail")
    errors = found.count("inconclusive") + found.count("not_evaluated")
    suite = _attributes(
        id="0",
        package=f"robacc.{command}",
        name=found.gate.name,
        timestamp=_NO_TIME,
        hostname="localhost",
        tests=str(len(found.judged)),
        failures=str(failures),
        errors=str(errors),
        time="0",
    )
    yield '<?xml version="1.0" encoding="UTF-8"?>'
    yield "<testsuites>"
    yield f"  <testsuite{suite}>"
    yield "    <properties/>"
    for one in found.judged:
        yield from _case(command, found, one)
    yield f"    <system-out>{_text(title(found))}</system-out>"
    yield f"    <system-err>{_text(chr(10).join(found.warnings))}</system-err>"
    yield "  </testsuite>"
    yield "</testsuites>"


def _case(command: str, found: GateOutcome, one: Judged) -> Iterator[str]:
    case = _attributes(name=one.criterion.name, classname=f"robacc.{command}.{found.gate.name}", time="0")
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
