"""A comparison, targets before and after a correction, and the outcome of a gate, also as Markdown and JUnit XML.

Many estimates in one table stand here too, since each has the outcome of its gate.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from robacc.render.text import (
    IN_DEGREES,
    IN_MM,
    QUANTITIES,
    Document,
    Form,
    Grid,
    Listing,
    Number,
    ReportHeadline,
    Section,
    Style,
    Text,
    Tile,
    amount,
    as_options,
    chance,
    decimals,
    fixed,
    grid,
    named_by_text,
    number,
    p_value,
    percent,
    say,
    statistics_cells,
    three_digits,
    unit_of,
    with_unit,
)
from robacc.statistics.intervals import ASSURANCE
from robacc.workers import FileOutcome

_STATISTICS = {
    "rms": "rms",
    "mean_error": "mean",
    "p95": "95th percentile",
    "max": "maximum",
    "max_radius95": "largest 95 % radius",
    "radius95": "95 % radius, Gaussian",
    "longest_sd": "principal axis 1, std",
    **{f"mean_{axis}": f"mean {axis}" for axis in "xyz"},
    **{f"sd_{axis}": f"sd {axis}" for axis in "xyz"},
}
_STAGES = {
    "before.held_out": "baseline, held-out poses",
    "nominal.held_out": "nominal, registered",
    "after.fitted": "extended model, calibration poses",
    "before.fitted": "baseline, calibration poses",
    "nominal.fitted": "nominal, registered",
}
_VERDICTS = {"demonstrated": "confirmed", "met_not_demonstrated": "met, not confirmed", "not_met": "not met"}
_ROUNDING = 1e-12
"""m or rad; smaller values are rounding errors."""
_ISO9283 = "iso9283."
_LISTED = ("rms", "mean_error", "p95")
"""Statistics whose differences a text lists for more than two results; the page and the JSON result have all."""


def comparison_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``compare``."""
    names, ranking = [result["name"] for result in document["results"]], document["ranking"] or {}
    return ReportHeadline(
        f"Comparison of {len(names)} results",
        f"By {ranking['by']}: {'; '.join(ranking['text'])}." if ranking else "",
        [
            Tile(entry["name"], amount(entry["value"], ranking["unit"]), f"group {entry['letters']}")
            for entry in ranking.get("order", ())[:3]
            if ranking["unit"] in ("m", "rad")
        ],
        (),
        [("Results", ", ".join(names)), ("Baseline", str(document["baseline"] or "none"))],
    )


def comparison_view(document: Document, form: Form = "page") -> list[Section]:
    """Return ranking, grades and statistics, with the methods of the differences.

    A page has every difference, and how each result was made.
    """
    results, rows, complete = document["results"], document["statistics"], form == "page"
    owners = {row["key"]: row["key"].rpartition(".")[0] for row in rows}
    main = [row for row in rows if _stage(owners[row["key"]]) is None and not row["key"].startswith(_ISO9283)]
    groups = {
        f"{owner.capitalize()} error": [row for row in main if owners[row["key"]] == owner]
        for owner in dict.fromkeys(owners[row["key"]] for row in main)
    }
    groups |= {
        f"ISO 9283, {name}": [row for row in rows if row["key"].startswith(_ISO9283) and row["unit"] == unit]
        for name, unit, *_ in QUANTITIES
    }
    groups |= {
        f"{name.capitalize()} rms": [r for r in rows if r["key"].endswith(f".{name}.rms") and _stage(r["key"])]
        for name, *_ in QUANTITIES
    }
    methods = ((_label(row["key"]), each["why"] or each["method"]) for row in rows for each in row["differences"])
    made = Grid(
        ("", *(result["name"] for result in results)),
        [
            *(
                (key, *(str(result["made"].get(key, "–")) for result in results))
                for key in dict.fromkeys(key for result in results for key in result["made"])
            ),
            ("SHA-256", *(result["sha256"] for result in results)),
        ],
        is_text=True,
    )
    return [
        Section(
            f"{len(results)} results compared; baseline: {_short(document['baseline'])}",
            [] if complete else [_results(document)],
        ),
        _ranking(document["ranking"]),
        *([] if document["grade"] is None else [_grade(document["grade"])]),
        *(_block(document, heading, group, complete) for heading, group in groups.items() if group),
        Section("Differences", [Listing(named_by_text(methods))]),
        Section("Limitations", [Listing(() if complete else document["notes"])]),
        Section("Compared results", [_results(document), made] if complete else []),
    ]


def _short(name: str) -> str:
    """Return a result's name in at most 24 columns."""
    return name if len(name) <= 24 else f"{name[:23]}…"


def _results(document: Document) -> Grid:
    paired = {match["second"]: "same poses" if match["paired"] else "different poses" for match in document["pairing"]}
    return Grid(
        ("result", "command", "robot", "poses", "grade", ""),
        [
            (
                *(_short(str(result[key] or "–")) for key in ("name", "command", "robot", "n_poses", "grade")),
                "" if result["command"] in ("iso9283", "predict") else paired.get(result["name"], ""),
            )
            for result in document["results"]
        ],
    )


def _ranking(ranking: Document) -> Section:
    key, unit, order, stage = ranking["by"], ranking["unit"], ranking["order"], _stage(ranking["by"])
    of_quantity = "" if key.startswith(_ISO9283) else f" of the {key.split('.')[-2]} error"
    pairs = {
        (pair["better"], pair["worse"]): (_difference(pair["difference"], unit)[0], p_value(pair["p_corrected"]))
        for pair in ranking["pairs"]
    }
    rows = [
        (
            _short(entry["name"]),
            _amount(entry["value"], unit),
            entry["letters"],
            *pairs.get((entry["name"], following["name"]), ("", "")),
        )
        for entry, following in zip(order, [*order[1:], {"name": ""}], strict=True)
    ]
    group = "group" * any(entry["letters"] for entry in order)
    of_stage = "" if stage is None else f" ({stage})"
    return Section(
        f"Ranking by {_label(key)}{of_quantity}{of_stage}, {unit_of(unit).name}",
        [
            Grid(("", "", group, "difference to the next", "p, corrected for pairs"), rows),
            Listing(ranking["text"]),
        ],
    )


def _grade(grade: Document) -> Section:
    results = grade["results"]
    return Section(
        f"Grade {grade['wanted']} (scale: {grade['scale']})",
        [
            Grid(
                ("", "", "grade", "probability", "position (bound), mm", "orientation (bound), °"),
                [
                    (
                        _short(each["name"]),
                        _VERDICTS[each["verdict"]],
                        each["grade"],
                        "–" if each["probability"] is None else chance(each["probability"]),
                        *(
                            f"{_amount(each[f'{name}_{unit}'], unit)}"
                            f"{'' if bound is None else f' ({_amount(bound, unit)})'}"
                            for name, unit, *_ in QUANTITIES
                            for bound in [each[f"{name}_upper_bound_{unit}"]]
                        ),
                    )
                    for each in results
                ],
            ),
            Listing(
                [
                    *(f"{each['name']}: {each['why']}" for each in results if each["why"]),
                    *(
                        f"{each['name']}: if the estimate does not change, {each['poses_to_demonstrate']} poses in "
                        "total would probably confirm it"
                        for each in results
                        if each["poses_to_demonstrate"] is not None
                    ),
                ]
            ),
        ],
    )


def _block(document: Document, title: str, rows: Sequence[Document], complete: bool) -> Section:
    """Return the tables of related statistics; few results stand in columns, many in rows."""
    unit, names = rows[0]["unit"], [_short(result["name"]) for result in document["results"]]
    title, interval_head = f"{title}, {unit_of(unit).name}", percent(document["confidence"])
    labels = [_stage(row["key"]) or _label(row["key"]) for row in rows]
    figures = [[_amount(figure["value"], unit) for figure in row["values"]] for row in rows]
    if len(names) == 2:
        return Section(
            title,
            [
                Grid(
                    ("", *names, "difference", interval_head, ""),
                    [
                        [label, *own, *_difference(row["differences"][0], unit)]
                        for label, own, row in zip(labels, figures, rows, strict=True)
                    ],
                )
            ],
        )
    statistics, every = [row["key"].rpartition(".")[2] for row in rows], range(len(rows))
    listed: Sequence[int] = [i for i in every if complete or statistics[i] in _LISTED] or every
    if len(names) <= 4:
        grid = Grid(("", *names), [[label, *own] for label, own in zip(labels, figures, strict=True)])
    else:
        shown = [i for i in every if complete or statistics[i] in (*_LISTED, "max")] or every[:4]
        grid = Grid(("", *(labels[i] for i in shown)), [*zip(names, *(figures[i] for i in shown), strict=True)])
        listed = listed if complete else shown[:1]
    return Section(
        title,
        [
            grid,
            Grid(
                (f"difference from {_short(document['baseline'])}", "difference", interval_head, ""),
                [
                    [f"{labels[i]}, {_short(difference['name'])}", *_difference(difference, unit)]
                    for i in listed
                    for difference in rows[i]["differences"]
                ],
            ),
        ],
    )


def _stage(key: str) -> str | None:
    """Return the label of a fit's stage, None for its main statistics."""
    return next((label for stage, label in _STAGES.items() if key.startswith(f"{stage}.")), None)


def _label(key: str) -> str:
    """Return the name of a statistic, or of a criterion such as ``AP`` or ``drift of AP``."""
    if not key.startswith(_ISO9283):
        return _STATISTICS.get(key.rpartition(".")[2], key.rpartition(".")[2])
    kind, _, base = key.removeprefix(_ISO9283).removesuffix(".max").removesuffix(".orientation").partition(".")
    return f"{kind} of {base}" if base else kind


def _amount(value: float | None, unit: str) -> Number:
    return Number("0", value) if value is not None and abs(value) < _ROUNDING else number(value, unit_of(unit).factor)


def _difference(difference: Document, unit: str) -> tuple[Number, str, str]:
    """Return a difference, its interval and its p-value, with signs and the digits that the interval supports."""
    value, factor = difference["value"], unit_of(unit).factor
    known = [end * factor for end in (difference["lower"], difference["upper"]) if end is not None]
    places = decimals(value * factor, *(known if len(known) == 2 else (None, None)))
    size, *ends = (
        text if text.startswith("-") or float(text) == 0.0 else f"+{text}"
        for number in (value * factor, *known)
        for text in ["0" if abs(number) < _ROUNDING * factor else fixed(number, places)]
    )
    return Number(size, value), " … ".join(ends) if len(ends) == 2 else "–", p_value(difference["p_value"])


# Targets before and after a correction.

_LOADED = {
    "loaded": "the correction was loaded",
    "partly_loaded": "only a part of the correction was loaded",
    "not_loaded": "no sign that the correction was loaded",
    "undecided": "the measurements do not decide whether the correction was loaded",
}


def paired_view(document: Document, names: tuple[str, str]) -> list[Section]:
    """Return the text of the comparison of the files ``names``."""
    gain, loaded = document["gain"], document["loaded"]
    value, low, high = (three_digits(gain[f"{end}_m"] * IN_MM) for end in ("value", "lower", "upper"))
    return [
        Section(f"{document['n_targets']} targets before ({names[0]}) and after ({names[1]}) a correction"),
        Section(
            "",
            [
                Grid(
                    ("error, mm", "rms", "mean", "95th pct.", "largest"),
                    [(stage, *statistics_cells(document[stage], "m", IN_MM)) for stage in ("before", "after")],
                )
            ],
        ),
        Section(
            "",
            [
                Listing(
                    [
                        f"gain {value} mm of the rms error, 95 % interval {low} to {high} mm",
                        f"{_LOADED[loaded['verdict']]}: the targets moved by {100 * loaded['slope']:.0f} % of the "
                        f"planned displacement of {three_digits(loaded['planned_rms_m'] * IN_MM)} mm rms, 95 % "
                        f"interval {100 * loaded['lower']:.0f} to {100 * loaded['upper']:.0f} %",
                        *(
                            f"the error after {'agrees' if promise['kept'] else 'does not agree'} with the model: "
                            f"{three_digits(document['after']['rms_m'] * IN_MM)} mm rms measured, "
                            f"{three_digits(promise['promised_rms_m'] * IN_MM)} mm rms predicted with measurement "
                            f"noise; chi-square {promise['chi_square']:.4g} on {promise['degrees_of_freedom']} degrees "
                            f"of freedom, {p_value(promise['p_value'])}"
                            for promise in [document["promise"]]
                            if promise is not None
                        ),
                        *document["notes"],
                    ]
                )
            ],
        ),
    ]


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
    counts = ", ".join(f"{outcomes.count(kind)} {look.label}" for kind, look in LOOKS.items() if kind in outcomes)
    return f"Gate {gate['name']}: {LOOKS[gate['outcome']].label.upper()} ({counts})"


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
            limit = (
                f"at {'most' if (given > 0.0) != is_least else 'least'} {size} "
                f"{'more' if given > 0.0 else 'less'} than in {file}"
            )
    shown = unit.text(value) if isinstance(value, int | float) else value or "missing"
    if isinstance(value, int | float) and before is not None:
        relation = "same as" if value == 0.0 else f"{unit.text(abs(value))} {'more' if value > 0.0 else 'less'} than"
        shown = f"{unit.text(value + before)}, {relation} the {unit.text(before)} in {file}"
    bounds, ends = "", (criterion["lower_bound"], criterion["upper_bound"])
    if criterion["rule"] != "simple" and criterion["share"] is None and ends != (None, None):
        bounds = (
            f"{' to '.join(map(unit.text, ends))}{' for the difference' * (before is not None)}, each bound at "
            f"{100 * criterion['confidence']:g} % confidence"
        )
    chance, probability = "", criterion["conformity_probability"]
    if probability is not None:
        chance = (
            "> 99.9 %" if probability > 0.999 else "< 0.1 %" if probability < 0.001 else f"{100 * probability:.1f} %"
        )
    decided, needed, if_true = "", criterion["poses_to_decide"], criterion["poses_to_decide_if_value_is_true"]
    if criterion["outcome"] == "inconclusive" and needed is not None:
        # ISO 9283 results count visits of a few commanded poses.
        decided = (
            f"{needed} {'visits' if criterion['key'].startswith('iso9283.') else 'poses'} in total would decide it "
            f"with a probability of {100 * ASSURANCE:.0f} %"
        )
        decided += f", {if_true} if the measured value is the true one" * (if_true not in (None, needed))
    elif criterion["outcome"] == "inconclusive" and if_true is None and criterion["why"] is None:
        # The distance to the limit is unknown without bounds or without a number of poses.
        decided = "the value is too close to the limit for any number of poses to decide" * (
            criterion["n_poses"] is not None
        )
    label, reasons = LOOKS[criterion["outcome"]].label, [as_options(criterion["why"] or ""), decided]
    parts = (
        f"{criterion['key']} {shown}{f' ({bounds})' * bool(bounds)}, expected {limit}",
        "" if criterion["margin"] is None else f"margin {unit.text(criterion['margin'])}",
        f"conforms with probability {chance}" * bool(chance),
        *reasons,
    )
    sentence = "; ".join(filter(None, parts))
    return {
        "criterion": criterion["name"],
        "key": criterion["key"],
        "value": shown,
        "limit": limit,
        "bounds": bounds or "–",
        "margin": unit.text(criterion["margin"]),
        "conforms": chance or "–",
        "sentence": sentence,
        "said": f"{label}: {sentence}",
        "explained": f"{'; '.join(filter(None, (label, *reasons)))}. Reason: {criterion['reason']}",
    }


def say_gate(gate: Document) -> None:
    """Write the outcome, and each criterion that does not pass, to standard error: for a log without the table."""
    say(title(gate), LOOKS[gate["outcome"]].style)
    for criterion in gate["criteria"]:
        look = LOOKS[criterion["outcome"]]
        if criterion["outcome"] != "pass":
            say(f"{look.label}: {criterion['name']}: {words_of(criterion)['sentence']}", look.style)


def gate_view(gate: Document) -> list[Section]:
    """Return the outcome of the gate and of each criterion as text."""
    # The longest outcome and two spaces.
    indent = " " * 15
    return [
        Section(title(gate), style=LOOKS[gate["outcome"]].style),
        *(
            Section(
                f"{look.label:<{len(indent)}}{own['name']}",
                [Text(indent + words_of(own)["sentence"]), Text(f"{indent}Reason: {own['reason']}", is_note=True)],
                look.style,
            )
            for own in gate["criteria"]
            for look in [LOOKS[own["outcome"]]]
        ),
    ]


def check_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``check``."""
    gate = document["gate"]
    return ReportHeadline(
        f"Check against {gate['name']}",
        f"The result of robacc {document['result']['command']} passes {passed(gate)} of the gate {gate['name']}.",
        (),
    )


def passed(gate: Document) -> str:
    """Return how many criteria passed, as ``2 of 3 criteria``."""
    return f"{sum(each['outcome'] == 'pass' for each in gate['criteria'])} of {len(gate['criteria'])} criteria"


def gate_section(gate: Document) -> Section:
    """Return each criterion with outcome, value, limit and bounds, and the reasons."""
    criteria = [(own["name"], LOOKS[own["outcome"]].label, words_of(own)) for own in gate["criteria"]]
    return Section(
        title(gate),
        [
            Grid(
                (_HEADER[0], "outcome", *_HEADER[1:]),
                [(name, label, *(words[head] for head in _HEADER[1:])) for name, label, words in criteria],
            ),
            Listing([f"{name}: {words['explained']}" for name, _, words in criteria]),
            Listing(gate["warnings"], "warning"),
        ],
    )


# Gate outcomes as JUnit XML: one suite per gate, one case per criterion.
#
# The output is valid under both common schemas, that of Jenkins' xUnit plug-in and that derived from Ant's report.
# Ant's schema requires a host, which is a constant. The cases of a suite have equal shares of its time: readers add
# them up.


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
    for place, outcome in enumerate(outcomes):
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
            id=str(place),
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
    text = f'<?xml version="1.0" encoding="UTF-8"?>\n{tostring(suites, encoding="unicode")}\n'
    return re.sub("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", "\ufffd", text)


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


# Several files in one table: one line per file, in the order given.


def many_view(
    command: str, outcomes: Sequence[FileOutcome], robot: str | None, aligned: Sequence[str] | None
) -> list[Section]:
    """Return the table of all files; ``robot`` is a file name, ``aligned`` the effects fitted first."""
    alignment = f"registered: {' and '.join(aligned)} fitted in each" if aligned else "not registered"
    alignment = "registered where the frames do not agree" if aligned is None else alignment
    turn = "rms, °" if any((own.summary or {}).get("rms_rad") is not None for own in outcomes) else None
    gate = "gate" if any(own.gate is not None for own in outcomes) else None

    def cells(done: Mapping[str, Any]) -> tuple[str, ...]:
        if command != "estimate":
            return (*(three_digits(done[key] * IN_MM) for key in ("before_m", "after_m")), done["findings"])
        return (
            *(three_digits(done[key] * IN_MM) for key in ("rms_m", "p95_m", "max_m")),
            number(done["rms_rad"], IN_DEGREES),
            done["grade"],
            "yes" if done["demonstrated"] else "no",
        )

    rows = [
        (outcome.name, "failed")
        if (done := outcome.summary) is None
        else (
            outcome.name,
            str(done["n_poses"]),
            *cells(done),
            "–" if outcome.gate is None else LOOKS[outcome.gate["outcome"]].label,
        )
        for outcome in outcomes
    ]
    notes = [
        f"{outcome.name}, {criterion['name']}: {LOOKS[criterion['outcome']].label}; {words_of(criterion)['sentence']}"
        for outcome in outcomes
        for criterion in (outcome.gate or {}).get("criteria", ())
        if criterion["outcome"] != "pass"
    ]
    failed = [f"{outcome.name}, {_reason(outcome)}" for outcome in outcomes if outcome.failed]
    heads = {
        "estimate": ("rms", "95th pct.", "max", turn, "grade", "confirmed"),
        "calibrate": ("nominal, registered", "calibrated", None),
        "trace": ("nominal, registered", "after", "findings"),
    }[command]
    made = {
        "estimate": f"Pose errors in {len(outcomes)} files, {alignment}",
        "calibrate": f"Calibration of {len(outcomes)} files, rms of held-out poses",
        "trace": f"Trace of {len(outcomes)} files, rms of held-out poses",
    }
    return [
        Section(
            made[command],
            [Text(f"against {'their cmd_ columns' if robot is None else f'the model {robot}'}", wraps=False)],
        ),
        Section("", [grid(("position error, mm", "poses", *heads, gate), rows)]),
        Section(
            "",
            [Listing([*notes, *failed, f"{len(failed)} of {len(outcomes)} files have no result" * bool(failed)])],
        ),
    ]


def _reason(outcome: FileOutcome) -> str:
    """Return the reason why a file has no result, in one line."""
    first = outcome.problems[0]
    counted = next((f"{name} {number}" for name, number in (("line", first.line), ("row", first.row)) if number), "")
    place = ", ".join(part for part in (counted, first.column) if part)
    others = f" (and {outcome.n_problems - 1} more)" * (outcome.n_problems > 1)
    return f"failed: {f'{place}: ' * bool(place)}{as_options(first.message)}{others}"


def many_annotations(command: str, outcomes: Sequence[FileOutcome]) -> str:
    """Return one annotation of GitHub Actions per file, an error for a failed file or gate."""
    entries = []
    for outcome in outcomes:
        head, done = f"robacc {command} {outcome.name}", outcome.summary
        entries += [("warning", head, warning) for warning in outcome.warnings]
        if done is None:
            entries.append(("error", head, _reason(outcome)))
            continue
        figures = [
            f"{name} {with_unit(done[f'{key}_m'])}"
            for name, key in (
                ("rms", "rms"),
                ("95th pct.", "p95"),
                ("max", "max"),
                ("rms before", "before"),
                ("rms after", "after"),
            )
            if f"{key}_m" in done
        ]
        if command == "estimate":
            figures.append(f"grade {done['grade']}, {'confirmed' if done['demonstrated'] else 'not confirmed'}")
        figures += [] if outcome.gate is None else [title(outcome.gate)]
        level = {4: "error", 5: "warning"}.get(outcome.exit_status, "notice")
        entries.append((level, head, "; ".join((f"{done['n_poses']} poses", *figures))))
    return annotation_lines(entries)


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
