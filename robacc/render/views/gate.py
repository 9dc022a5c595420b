"""The outcome of a gate: for a terminal, as Markdown, as annotations of a workflow, and as JUnit XML."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from robacc.outcomes import FileOutcome
from robacc.render.text import Document, Grid, Listing, ReportHeadline, Section, Style, Text, as_options, say, unit_of
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
_HEADER = ("criterion", "key", "value", "limit", "bounds", "margin", "conforms")


def title(gate: Document) -> str:
    """Return the gate's name and outcome, and the number of criteria with each outcome."""
    outcomes = [criterion["outcome"] for criterion in gate["criteria"]]
    counts = [f"{outcomes.count(kind)} {look.label}" for kind, look in LOOKS.items() if kind in outcomes]
    return f"Gate {gate['name']}: {LOOKS[gate['outcome']].label.upper()} ({', '.join(counts)})"


def words_of(criterion: Document) -> dict[str, str]:
    """Return a criterion in words: its cells below :data:`_HEADER`, and its ``sentence``, ``said``, ``explained``.

    The sentence has the value, bounds, limit, margin and reasons; ``said`` has the outcome before it; ``explained`` has
    the outcome, its reason and the number of poses that would decide, then the reason for the limit.
    """
    unit, value, given, is_least = (
        unit_of(criterion["unit"]),
        *(criterion[key] for key in ("value", "limit", "at_least")),
    )
    baseline = criterion["baseline"] or {}
    before, file = baseline.get("value"), baseline.get("file")
    if isinstance(given, str | list):
        limit = f"{given} or better" if isinstance(given, str) else " or ".join(given)
    else:
        size = unit.after(f"{unit.factor * abs(given or 0.0):.6g}")
        limit = f"at {'least' if is_least else 'most'} {size}"
        if baseline and not given:
            limit = f"no {'less' if is_least else 'more'} than in {file}"
        elif baseline:
            # A limit on a difference has a sign and a direction.
            extent = "most" if (given > 0.0) != is_least else "least"
            limit = f"at {extent} {size} {'more' if given > 0.0 else 'less'} than in {file}"
    shown = unit.text(value) if isinstance(value, int | float) else value or "missing"
    if isinstance(value, int | float) and before is not None:
        relation = "same as" if value == 0.0 else f"{unit.text(abs(value))} {'more' if value > 0.0 else 'less'} than"
        shown = f"{unit.text(value + before)}, {relation} the {unit.text(before)} in {file}"
    bounds, ends = "", (criterion["lower_bound"], criterion["upper_bound"])
    if criterion["rule"] != "simple" and criterion["share"] is None and ends != (None, None):
        of = "" if before is None else " for the difference"
        bounds = (
            f"{' to '.join(map(unit.text, ends))}{of}, each bound at {100 * criterion['confidence']:g} % confidence"
        )
    chance, probability = "", criterion["conformity_probability"]
    if probability is not None:
        percent = 100.0 * probability
        chance = "> 99.9 %" if percent > 99.9 else "< 0.1 %" if percent < 0.1 else f"{percent:.1f} %"
    decided, needed, if_true = "", criterion["poses_to_decide"], criterion["poses_to_decide_if_value_is_true"]
    if criterion["outcome"] == "inconclusive" and needed is not None:
        # ISO 9283 results count visits of a few commanded poses.
        counted = "visits" if criterion["key"].startswith("iso9283.") else "poses"
        decided = f"{needed} {counted} in total would decide it with a probability of {100 * ASSURANCE:.0f} %"
        decided += f", {if_true} if the measured value is the true one" * (if_true not in (None, needed))
    elif criterion["outcome"] == "inconclusive" and if_true is None and criterion["why"] is None:
        # The distance to the limit is unknown without bounds or without a number of poses.
        is_known = criterion["n_poses"] is not None
        decided = "the value is too close to the limit for any number of poses to decide" * is_known
    label, reasons = LOOKS[criterion["outcome"]].label, [as_options(criterion["why"] or ""), decided]
    parts = (
        f"{criterion['key']} {shown}{f' ({bounds})' * bool(bounds)}, expected {limit}",
        "" if criterion["margin"] is None else f"margin {unit.text(criterion['margin'])}",
        f"conforms with probability {chance}" * bool(chance),
        *reasons,
    )
    sentence = "; ".join(filter(None, parts))
    cells = (
        criterion["name"],
        criterion["key"],
        shown,
        limit,
        bounds or "–",
        unit.text(criterion["margin"]),
        chance or "–",
    )
    return {
        **dict(zip(_HEADER, cells, strict=True)),
        "sentence": sentence,
        "said": f"{label}: {sentence}",
        "explained": f"{'; '.join(filter(None, (label, *reasons)))}. Reason: {criterion['reason']}",
    }


_INDENT = 15
"""Columns: the longest outcome and two spaces."""


def say_gate(gate: Document) -> None:
    """Write the outcome, and each criterion that does not pass, to standard error: for a log without the table."""
    say(title(gate), LOOKS[gate["outcome"]].style)
    for criterion in gate["criteria"]:
        look = LOOKS[criterion["outcome"]]
        if criterion["outcome"] != "pass":
            say(f"{look.label}: {criterion['name']}: {words_of(criterion)['sentence']}", look.style)


def gate_view(gate: Document) -> list[Section]:
    """Return the outcome of the gate and of each criterion as text."""
    indent = " " * _INDENT
    return [
        Section(title(gate), style=LOOKS[gate["outcome"]].style),
        *(
            Section(
                f"{look.label:<{_INDENT}}{own['name']}",
                [Text(indent + words_of(own)["sentence"]), Text(f"{indent}Reason: {own['reason']}", is_note=True)],
                look.style,
            )
            for own in gate["criteria"]
            for look in [LOOKS[own["outcome"]]]
        ),
    ]


def check_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``check``."""
    gate, command = document["gate"], document["result"]["command"]
    return ReportHeadline(
        f"Check against {gate['name']}",
        f"The result of robacc {command} passes {passed(gate)} of the gate {gate['name']}.",
        (),
    )


def passed(gate: Document) -> str:
    """Return how many criteria passed, as ``2 of 3 criteria``."""
    return f"{sum(each['outcome'] == 'pass' for each in gate['criteria'])} of {len(gate['criteria'])} criteria"


def gate_section(gate: Document) -> Section:
    """Return each criterion with outcome, value, limit and bounds, and the reasons."""
    criteria = [(own["name"], LOOKS[own["outcome"]].label, words_of(own)) for own in gate["criteria"]]
    rows = [(name, label, *(words[head] for head in _HEADER[1:])) for name, label, words in criteria]
    reasons = Listing([f"{name}: {words['explained']}" for name, _, words in criteria])
    return Section(
        title(gate), [Grid((_HEADER[0], "outcome", *_HEADER[1:]), rows), reasons, Listing(gate["warnings"], "warning")]
    )


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
    from datetime import UTC, datetime
    from xml.etree.ElementTree import Element, SubElement, indent, tostring

    suites, timestamp = Element("testsuites"), datetime.fromtimestamp(started, UTC).strftime("%Y-%m-%dT%H:%M:%S")
    for number, outcome in enumerate(outcomes):
        if (gate := outcome.gate) is None:
            cases = [(command, "no result", as_options(outcome.problems[0].message), "")]
            streams = {"out": "", "err": "\n".join(as_options(str(problem)) for problem in outcome.problems)}
        else:
            cases = [
                (each["name"], each["outcome"], words_of(each)["said"], f"Reason for the limit: {each['reason']}")
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
            timestamp=timestamp,
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
                SubElement(case, "failure" if kind == "fail" else "error", message=message, type=kind).text = reason
        for stream, text in streams.items():
            SubElement(suite, f"system-{stream}").text = text
    indent(suites)
    return _NOT_XML.sub("\ufffd", f'<?xml version="1.0" encoding="UTF-8"?>\n{tostring(suites, encoding="unicode")}\n')


# A result as workflow commands of GitHub Actions, which shows them as annotations of the run.


def github_annotations(command: str, table: str, gate: Document | None, warnings: tuple[str, ...]) -> str:
    """Return one line per annotation: warnings, criteria and the gate; without a gate the report's first part.

    Args:
        command: The command that made the result.
        table: The report as plain text; the part before its first empty line is used.
        gate: The gate's outcome, if a gate was checked.
        warnings: The command's warnings.
    """
    head = f"robacc {command}"
    entries = [("warning", head, warning) for warning in warnings]
    if gate is None:
        return annotation_lines([*entries, ("notice", head, table.strip().partition("\n\n")[0])])
    entries += [
        (
            LOOKS[criterion["outcome"]].level,
            f"{gate['name']}: {criterion['name']}",
            f"{words_of(criterion)['said']}. Reason for the limit: {criterion['reason']}",
        )
        for criterion in gate["criteria"]
    ]
    return annotation_lines([*entries, (LOOKS[gate["outcome"]].level, head, title(gate))])


def annotation_lines(entries: Iterable[tuple[str, str, str]]) -> str:
    """Return a line ``::level title=HEAD::TEXT`` for each level, head and text, escaped as actions/toolkit does."""
    text_codes = str.maketrans({"%": "%25", "\r": "%0D", "\n": "%0A"})
    head_codes = {**text_codes, **str.maketrans({":": "%3A", ",": "%2C"})}
    return "".join(
        f"::{level} title={head.translate(head_codes)}::{text.translate(text_codes)}\n" for level, head, text in entries
    )


# A result and its gate's outcome as Markdown, for a job summary or a comment on a pull request.


def markdown(command: str, table: str, gate: Document | None, warnings: tuple[str, ...]) -> str:
    """Return the gate's table, the warnings and the report, which is collapsed below a gate.

    Args:
        command: The command that made the result.
        table: The report as plain text; empty if there is only the gate's outcome.
        gate: The gate's outcome, if a gate was checked.
        warnings: The command's warnings.
    """
    lines = [f"## robacc {_escaped(command)}"]
    if gate is not None:
        rows = [
            ("", *_HEADER),
            ["---"] * (1 + len(_HEADER)),
            *(
                (LOOKS[own["outcome"]].sign, *(_escaped(words_of(own)[head]) for head in _HEADER))
                for own in gate["criteria"]
            ),
        ]
        lines += [
            f"### {LOOKS[gate['outcome']].sign} {_escaped(title(gate))}",
            "\n".join(f"| {' | '.join(row)} |" for row in rows),
            "\n".join(
                f"- **{_escaped(own['name'])}**: {_escaped(words_of(own)['explained'])}" for own in gate["criteria"]
            ),
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
