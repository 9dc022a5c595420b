"""The outcome of a gate: for a terminal, as Markdown, as annotations of a workflow, and as JUnit XML."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, NamedTuple

from robacc.outcomes import FileOutcome
from robacc.render.text.console import Style, say
from robacc.render.text.layout import table_unit, with_table_unit
from robacc.render.text.parameter_names import as_options
from robacc.render.views.elements import Grid, Listing, ReportHeadline, Section, Text
from robacc.statistics.intervals import ASSURANCE

# Gate outcomes as text: the same wording in a table, a page, a job summary, an annotation and JUnit.


class Look(NamedTuple):
    """How an outcome looks."""

    label: str
    gate: str
    """Of a gate with this outcome."""
    style: Style
    """On a terminal."""
    tone: str
    """Of the badge on a page."""
    level: str
    """Of an annotation."""
    sign: str
    """In Markdown."""


LOOKS = {
    "pass": Look("pass", "passed", "green", "good", "notice", "✅"),
    "fail": Look("fail", "failed", "bold red", "bad", "error", "❌"),
    "inconclusive": Look("inconclusive", "inconclusive", "bold yellow", "open", "warning", "❔"),
    "not_evaluated": Look("not evaluated", "not evaluated", "bold yellow", "open", "warning", "⚠️"),
}
HEADER = ("criterion", "key", "value", "limit", "bounds", "margin", "conforms")

Part = Mapping[str, Any]
"""A gate or a criterion as in the JSON document."""


def title(gate: Part) -> str:
    """Return the gate's name and outcome, and the number of criteria with each outcome."""
    outcomes = [criterion["outcome"] for criterion in gate["criteria"]]
    counts = [f"{outcomes.count(kind)} {look.label}" for kind, look in LOOKS.items() if kind in outcomes]
    return f"Gate {gate['name']}: {LOOKS[gate['outcome']].label.upper()} ({', '.join(counts)})"


def said(criterion: Part) -> str:
    """Return the outcome of a criterion, then :func:`sentence`."""
    return f"{LOOKS[criterion['outcome']].label}: {sentence(criterion)}"


def cells(criterion: Part) -> tuple[str, ...]:
    """Return the cells of a criterion below :data:`HEADER`."""
    return (
        criterion["name"],
        criterion["key"],
        value(criterion),
        limit(criterion),
        (bounds(criterion) or "–").strip("()"),
        _amount(criterion["margin"], criterion),
        probability(criterion) or "–",
    )


def _amount(size: float | None, criterion: Part) -> str:
    """Return a value of a criterion in mm, degrees or without unit, three digits; a dash for None."""
    return table_unit(criterion["unit"]).text(size)


def limit(criterion: Part) -> str:
    """Return the limit with its direction."""
    given, baseline = criterion["limit"], criterion["baseline"]
    if isinstance(given, str):
        return f"{given} or better"
    if isinstance(given, list):
        return " or ".join(given)
    factor, unit = table_unit(criterion["unit"])
    size = with_table_unit(f"{factor * abs(given or 0.0):.6g}", unit)
    if baseline is None:
        return f"at least {size}" if criterion["at_least"] else f"at most {size}"
    if not given:
        return f"no {'less' if criterion['at_least'] else 'more'} than in {baseline['file']}"
    # A limit on a difference has a sign and a direction.
    is_increase = given > 0.0
    extent = "at most" if is_increase != criterion["at_least"] else "at least"
    return f"{extent} {size} {'more' if is_increase else 'less'} than in {baseline['file']}"


def value(criterion: Part) -> str:
    """Return the measured value; for a comparison, also the baseline's value."""
    size, baseline = criterion["value"], criterion["baseline"] or {}
    if size is None:
        return "missing"
    if isinstance(size, str):
        return size
    if baseline.get("value") is None:
        return _amount(size, criterion)
    difference = f"{_amount(abs(size), criterion)} {'more' if size > 0.0 else 'less'} than"
    relation = "same as" if size == 0.0 else difference
    measured = _amount(size + baseline["value"], criterion)
    return f"{measured}, {relation} the {_amount(baseline['value'], criterion)} in {baseline['file']}"


def bounds(criterion: Part) -> str | None:
    """Return the bounds that the rule used, None if it used none."""
    ends = (criterion["lower_bound"], criterion["upper_bound"])
    if criterion["rule"] == "simple" or criterion["share"] is not None or ends == (None, None):
        return None
    suffix = "" if (criterion["baseline"] or {}).get("value") is None else " for the difference"
    interval = " to ".join(_amount(end, criterion) for end in ends)
    return f"({interval}{suffix}, each bound at {100 * criterion['confidence']:g} % confidence)"


def probability(criterion: Part) -> str | None:
    """Return the conformity probability in percent, between ``< 0.1 %`` and ``> 99.9 %``."""
    if criterion["conformity_probability"] is None:
        return None
    percent = 100.0 * criterion["conformity_probability"]
    return "> 99.9 %" if percent > 99.9 else "< 0.1 %" if percent < 0.1 else f"{percent:.1f} %"


def _poses_needed(criterion: Part) -> str | None:
    """Return the number of poses or visits that would decide an inconclusive criterion, None where unknown."""
    if criterion["outcome"] != "inconclusive":
        return None
    needed, needed_if_true = criterion["poses_to_decide"], criterion["poses_to_decide_if_value_is_true"]
    if needed is None:
        # The distance to the limit is unknown without bounds or without a number of poses.
        too_close = needed_if_true is None and criterion["why"] is None and criterion["n_poses"] is not None
        return "the value is too close to the limit for any number of poses to decide" if too_close else None
    # ISO 9283 results count visits of a few commanded poses.
    counted = "visits" if criterion["key"].startswith("iso9283.") else "poses"
    text = f"{needed} {counted} in total would decide it with a probability of {100 * ASSURANCE:.0f} %"
    if needed_if_true is None or needed_if_true == needed:
        return text
    return f"{text}, {needed_if_true} if the measured value is the true one"


def sentence(criterion: Part) -> str:
    """Return one line with the value, bounds, limit, margin and reasons of a criterion, without its outcome."""
    statement = " ".join(text for text in (criterion["key"], value(criterion), bounds(criterion)) if text)
    parts = [f"{statement}, expected {limit(criterion)}"]
    if criterion["margin"] is not None:
        parts.append(f"margin {_amount(criterion['margin'], criterion)}")
    if (chance := probability(criterion)) is not None:
        parts.append(f"conforms with probability {chance}")
    return "; ".join([*parts, *_explanations(criterion)])


def explained(criterion: Part) -> str:
    """Return the outcome, its reason and the number of poses that would decide, then the reason for the limit."""
    parts = [LOOKS[criterion["outcome"]].label, *_explanations(criterion)]
    return f"{'; '.join(parts)}. Reason: {criterion['reason']}"


def _explanations(criterion: Part) -> list[str]:
    why = None if criterion["why"] is None else as_options(criterion["why"])
    return [text for text in (why, _poses_needed(criterion)) if text]


_INDENT = 15
"""Columns: the longest outcome and two spaces."""


def say_gate(gate: Part) -> None:
    """Write the outcome, and each criterion that does not pass, to standard error: for a log without the table."""
    say(title(gate), LOOKS[gate["outcome"]].style)
    for criterion in gate["criteria"]:
        if criterion["outcome"] != "pass":
            look = LOOKS[criterion["outcome"]]
            say(f"{look.label}: {criterion['name']}: {sentence(criterion)}", look.style)


def gate_view(gate: Part) -> Iterator[Section]:
    """Return the outcome of the gate and of each criterion as text."""
    yield Section(title(gate), [], LOOKS[gate["outcome"]].style)
    for criterion in gate["criteria"]:
        look, indent = LOOKS[criterion["outcome"]], " " * _INDENT
        texts = [Text(indent + sentence(criterion)), Text(f"{indent}Reason: {criterion['reason']}", is_note=True)]
        yield Section(f"{look.label:<{_INDENT}}{criterion['name']}", texts, look.style)


def check_headline(document: Part) -> ReportHeadline:
    """Return the headline of a result of ``check``."""
    gate, command = document["gate"], document["result"]["command"]
    summary = f"The result of robacc {command} passes {passed(gate)} of the gate {gate['name']}."
    return ReportHeadline(f"Check against {gate['name']}", summary, ())


def passed(gate: Part) -> str:
    """Return how many criteria passed, as ``2 of 3 criteria``."""
    return f"{sum(each['outcome'] == 'pass' for each in gate['criteria'])} of {len(gate['criteria'])} criteria"


def gate_section(document: Part) -> Iterator[Section]:
    """Yield each criterion with outcome, value, limit and bounds, and the reasons; nothing without a gate."""
    if gate := document.get("gate"):
        rows = [(each["name"], LOOKS[each["outcome"]].label, *cells(each)[1:]) for each in gate["criteria"]]
        reasons = [f"{each['name']}: {explained(each)}" for each in gate["criteria"]]
        table = Grid((HEADER[0], "outcome", *HEADER[1:]), rows)
        yield Section(title(gate), [table, Listing(reasons), Listing(gate["warnings"], "warning")])


# Gate outcomes as JUnit XML: one suite per gate, one case per criterion.
#
# The output is valid under both common schemas, that of Jenkins' xUnit plug-in and that derived from Ant's report.
# Ant's schema requires a host, which is a constant. The cases of a suite have equal shares of its time: readers add
# them up.

_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit(command: str, outcomes: Sequence[FileOutcome], started: float = 0.0) -> str:
    """Return one suite per file; a failed criterion is a failure, an undecided criterion is an error and never passes.

    Args:
        command: Name of the command.
        outcomes: Outcomes of files by their gates; a file without a result has an error instead of its criteria.
        started: Start of the command, seconds since 1970.
    """
    from xml.etree.ElementTree import Element, SubElement, indent, tostring

    suites = Element("testsuites")
    for number, outcome in enumerate(outcomes):
        if (gate := outcome.gate) is None:
            cases = [(command, "no result", as_options(outcome.problems[0].message), "")]
            streams = {"out": "", "err": "\n".join(as_options(str(problem)) for problem in outcome.problems)}
        else:
            cases = [
                (each["name"], each["outcome"], said(each), f"Reason for the limit: {each['reason']}")
                for each in gate["criteria"]
            ]
            streams = {"out": title(gate), "err": "\n".join(gate["warnings"])}
        kinds = [kind for _, kind, _, _ in cases]
        suite = SubElement(
            suites,
            "testsuite",
            id=str(number),
            package=f"robacc.{command}",
            name=outcome.name,
            timestamp=datetime.fromtimestamp(started, UTC).strftime("%Y-%m-%dT%H:%M:%S"),
            hostname="localhost",
            tests=str(len(cases)),
            failures=str(kinds.count("fail")),
            errors=str(len(kinds) - kinds.count("fail") - kinds.count("pass")),
            time=f"{outcome.seconds:.3f}",
        )
        SubElement(suite, "properties")
        share = f"{outcome.seconds / max(1, len(cases)):.3f}"
        for name, kind, message, reason in cases:
            case = SubElement(suite, "testcase", name=name, classname=f"robacc.{command}.{outcome.name}", time=share)
            if kind != "pass":
                tag = "failure" if kind == "fail" else "error"
                SubElement(case, tag, message=message, type=kind).text = reason
        for stream, text in streams.items():
            SubElement(suite, f"system-{stream}").text = text
    indent(suites)
    text = f'<?xml version="1.0" encoding="UTF-8"?>\n{tostring(suites, encoding="unicode")}\n'
    return _NOT_XML.sub("\ufffd", text)


# A result as workflow commands of GitHub Actions, which shows them as annotations of the run.


def github_annotations(command: str, table: str, gate: Part | None, warnings: tuple[str, ...]) -> str:
    """Return one line per annotation: warnings, criteria and the gate; without a gate the report's first part.

    Args:
        command: The command that made the result.
        table: The report as plain text; the part before its first empty line is used.
        gate: The gate's outcome, if a gate was checked.
        warnings: The command's warnings.
    """
    head = f"robacc {command}"
    lines = [annotation("warning", head, warning) for warning in warnings]
    if gate is None:
        return "\n".join([*lines, annotation("notice", head, table.strip().partition("\n\n")[0]), ""])
    lines += [
        annotation(
            LOOKS[criterion["outcome"]].level,
            f"{gate['name']}: {criterion['name']}",
            f"{said(criterion)}. Reason for the limit: {criterion['reason']}",
        )
        for criterion in gate["criteria"]
    ]
    return "\n".join([*lines, annotation(LOOKS[gate["outcome"]].level, head, title(gate)), ""])


def annotation(level: str, head: str, text: str) -> str:
    """Return ``::level title=HEAD::TEXT``, escaped as actions/toolkit does."""
    for sign, code in (("%", "%25"), ("\r", "%0D"), ("\n", "%0A")):
        head, text = head.replace(sign, code), text.replace(sign, code)
    head = head.replace(":", "%3A").replace(",", "%2C")
    return f"::{level} title={head}::{text}"


# A result and its gate's outcome as Markdown, for a job summary or a comment on a pull request.


def markdown(command: str, table: str, gate: Part | None, warnings: tuple[str, ...]) -> str:
    """Return the gate's table, the warnings and the report, which is collapsed below a gate.

    Args:
        command: The command that made the result.
        table: The report as plain text; empty if there is only the gate's outcome.
        gate: The gate's outcome, if a gate was checked.
        warnings: The command's warnings.
    """
    lines = [f"## robacc {_escaped(command)}"]
    if gate is not None:
        criteria = gate["criteria"]
        rows = [
            ("", *HEADER),
            ["---"] * (1 + len(HEADER)),
            *((LOOKS[criterion["outcome"]].sign, *map(_escaped, cells(criterion))) for criterion in criteria),
        ]
        lines += [
            f"### {LOOKS[gate['outcome']].sign} {_escaped(title(gate))}",
            "\n".join(f"| {' | '.join(row)} |" for row in rows),
            "\n".join(f"- **{_escaped(each['name'])}**: {_escaped(explained(each))}" for each in criteria),
        ]
    lines += [f"> **Warning:** {_escaped(warning)}" for warning in warnings]
    if table:
        fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", table)), default=0))
        body = "\n".join((f"{fence}text", table.rstrip("\n"), fence))
        lines += [body] if gate is None else ["<details><summary>Full result</summary>", body, "</details>"]
    return "\n\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    """Return the text escaped for Markdown and its tables."""
    return re.sub(r"([\\`*_\[\]<>|#~])", r"\\\1", " ".join(text.split()))
