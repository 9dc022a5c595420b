"""The sections of `estimate`, `iso9283`, `predict`, `correct` and `compare` reports, and of a gate's outcome."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from robacc.render.html.blocks import (
    Block,
    Cell,
    Grid,
    Listing,
    Number,
    ReportSection,
    Text,
    angle,
    interval,
    length,
    quantity,
)
from robacc.render.html.fit_sections import parameter_row
from robacc.render.plots.canvas import DEGREE, MILLIMETRE, Document, Unit, error_unit, length_unit
from robacc.render.text.layout import p_value, three_digits

# The sections of an `estimate` report.

_FIGURES = (("rms", "rms"), ("mean", "mean_error"), ("95th percentile", "p95"), ("largest", "max"))


def estimate_sections(document: Document) -> Iterator[ReportSection]:
    """Return position, orientation, grade, worst poses and registration."""
    yield _quantity(document, "position", "m", length, MILLIMETRE)
    if document["orientation"] is not None:
        yield _quantity(document, "orientation", "rad", angle, DEGREE)
    yield _estimate_grade(document)
    yield _worst(document)
    if document["alignment"] is not None:
        yield _alignment(document)


def _quantity(document: Document, part: str, unit: str, show: Callable[..., Number], coarse: Unit) -> ReportSection:
    statistics = document[part]
    unaligned = (document["unaligned"] or {}).get(part)
    rows: list[Sequence[Cell]] = []
    for label, key in _FIGURES:
        bounds = statistics["intervals"][f"{key}_{unit}"]
        value = statistics[f"{key}_{unit}"]
        shown_unit = length_unit(value) if unit == "m" else DEGREE
        interval_text = interval(value, bounds["lower"], bounds["upper"], bounds["confidence"], shown_unit)
        unaligned_cell = [] if unaligned is None else [show(unaligned[f"{key}_{unit}"])]
        rows.append([label, show(value, bounds["lower"], bounds["upper"]), interval_text or "–", *unaligned_cell])
    header = ("length of the error", "value", "interval", *(("unregistered",) if unaligned is not None else ()))
    blocks: list[Block] = [
        Grid(header, rows),
        _matrices(statistics, unit, coarse),
        _axes(statistics, unit),
        _tests(statistics),
        Listing([statistics["assumption"], statistics["pose_structure"]["text"]]),
    ]
    return ReportSection(f"{part.capitalize()} error", blocks)


def _matrices(statistics: Mapping[str, Any], unit: str, coarse: Unit) -> Grid:
    square = coarse.factor**2
    rows: list[Sequence[Cell]] = []
    for key, label in (("covariance", "about zero"), ("centred_covariance", "about the mean")):
        for axis, row in zip("xyz", statistics[f"{key}_{unit}2"], strict=True):
            rows.append([f"{label}, {axis}", *(Number(three_digits(value * square), value) for value in row)])
    return Grid((f"covariance, {coarse.name}²", "x", "y", "z"), rows)


def _axes(statistics: Mapping[str, Any], unit: str) -> Grid:
    rows: list[Sequence[Cell]] = []
    for number, axis in enumerate(statistics["ellipsoid"], 1):
        sd, bounds = axis[f"sd_{unit}"], axis["interval"]
        show, shown_unit = (length, length_unit(sd)) if unit == "m" else (angle, DEGREE)
        interval_text = interval(sd, bounds["lower"], bounds["upper"], bounds["confidence"], shown_unit)
        direction = [f"{value:+.2f}" for value in axis["direction"]]
        rows.append([str(number), show(sd, bounds["lower"], bounds["upper"]), interval_text or "–", *direction])
    return Grid(("principal axis", "standard deviation", "interval", "x", "y", "z"), rows)


def _tests(statistics: Mapping[str, Any]) -> Grid:
    tests = statistics["tests"].values()
    rows = [[test["method"], test["why"] if test["p_value"] is None else p_value(test["p_value"])] for test in tests]
    return Grid(("test of an assumption", "result"), rows)


def _estimate_grade(document: Document) -> ReportSection:
    grade = document["grade"]
    rows: list[Sequence[Cell]] = [
        [step["grade"], length(step["position_m"]), angle(step["orientation_rad"])] for step in grade["steps"]
    ]
    sentences = [sentence for sentence in grade["reason"].split(". ") if sentence]
    header = (f"grade, by {grade['statistic']}", "position within", "orientation within")
    return ReportSection(f"Grade {grade['grade']}", [Listing(sentences), Grid(header, rows)])


def _worst(document: Document) -> ReportSection:
    blocks: list[Block] = []
    for key, label in (("by_position", "by position"), ("by_orientation", "by orientation")):
        rows = [_pose(pose) for pose in document["worst_poses"][key]]
        if rows:
            blocks.append(Grid((f"largest errors {label}", "position", "orientation"), rows))
    for target in document["targets"]:
        blocks.append(Text(f"Target {target['target']}: {target['n_poses']} poses, rms {length(target['rms_m'])}."))
    return ReportSection("Largest errors", blocks)


def _pose(pose: Mapping[str, Any]) -> list[Cell]:
    parts = [f"line {pose['line']}", *(f"{name} {pose[name]}" for name in ("pose", "target") if pose[name] is not None)]
    return [", ".join(parts), length(pose["error_m"]), angle(pose["error_rad"])]


def _alignment(document: Document) -> ReportSection:
    alignment = document["alignment"]
    rows = [parameter_row(parameter) for parameter in alignment["parameters"] if parameter["std"] is not None]
    blocks: list[Block] = [Grid(("parameter", "value", "standard error", "unit"), rows)]
    unidentified = [
        [parameter["name"], str(parameter["why"])] for parameter in alignment["parameters"] if parameter["std"] is None
    ]
    if unidentified:
        blocks.append(Grid(("parameter that is not identifiable", "reason"), unidentified, is_text=True))
    return ReportSection("Registration", blocks)


# The sections of an `iso9283` report.

_NAMES = {
    "AP": "pose accuracy, AP",
    "RP": "pose repeatability, RP",
    "vAP": "multi-directional accuracy variation, vAP",
    "AD": "distance accuracy, AD",
    "RD": "distance repeatability, RD",
    "dAP": "drift of AP",
    "dRP": "drift of RP",
    "shift": "drift of the barycentre",
    "E": "exchangeability, E",
}
_STATUS = {"met": "met", "not_met": "not met", "unknown": "unknown"}


def iso9283_sections(document: Document) -> Iterator[ReportSection]:
    """Return all criteria, and the conditions of the protocol."""
    criteria = _characteristics(document["iso9283"])
    yield ReportSection("Criteria", _criteria(criteria))
    rows = [
        [
            f"{condition['condition']} ({condition['clause']})",
            _STATUS.get(condition["status"], condition["status"]),
            condition["why"],
        ]
        for condition in document["protocol"]
    ]
    yield ReportSection(
        "Conditions of the protocol", [Grid(("condition, clause", "status", "reason"), rows, is_text=True)]
    )


def _characteristics(criteria: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    flat: list[Mapping[str, Any]] = []
    for criterion in criteria.values():
        flat += [criterion] if "symbol" in criterion else list(criterion.values())
    return flat


def _criteria(criteria: Sequence[Mapping[str, Any]]) -> list[Block]:
    rows: list[Sequence[Cell]] = []
    for criterion in criteria:
        value, bounds = criterion["max_m"], criterion["intervals"]["max_m"]
        if value is None:
            continue
        low, high = bounds["lower"], bounds["upper"]
        interval_text = interval(value, low, high, bounds["confidence"], length_unit(value))
        orientation = criterion["orientation"]
        rows.append(
            [
                f"{_NAMES.get(criterion['symbol'], criterion['symbol'])} ({criterion['clause']})",
                length(value, low, high),
                interval_text or "–",
                str(criterion["max_at"]),
                angle(orientation["max_rad"]),
            ]
        )
    header = ("criterion, largest over poses", "position", "interval", "at", "orientation")
    blocks: list[Block] = [Grid(header, rows)]
    missing = [
        f"{_NAMES.get(o['symbol'], o['symbol'])}: {o['why']}" for o in criteria if o["max_m"] is None and o["why"]
    ]
    notes = [*dict.fromkeys(note for criterion in criteria for note in criterion["notes"])]
    for texts in (missing, notes):
        if texts:
            blocks.append(Listing(texts))
    return blocks


# The sections of a `predict` report.


def predict_sections(document: Document) -> Iterator[ReportSection]:
    """Return errors, grade, allocation, and the comparison with measured poses."""
    yield _predicted_figures(document)
    yield _predicted_grade(document)
    if document["allocation"] is not None:
        yield _allocation(document["allocation"])
    if document["against"] is not None:
        yield _against(document["against"])


def _predicted_figures(document: Document) -> ReportSection:
    rows: list[Sequence[Cell]] = []
    labels = (
        ("rms", "rms"),
        ("mean", "mean_error"),
        ("95th percentile", "p95"),
        ("largest 95 % radius", "max_radius95"),
    )
    for label, key in labels:
        rows.append([label, length(document["position"][f"{key}_m"]), angle(document["orientation"][f"{key}_rad"])])
    worst: list[Sequence[Cell]] = []
    for part, unit, show in (("position", "m", length), ("orientation", "rad", angle)):
        worst_pose = document[part]["worst"]
        direction = ", ".join(f"{value:+.2f}" for value in worst_pose["direction"])
        worst.append(
            [
                part,
                worst_pose["label"],
                show(worst_pose[f"rms_{unit}"]),
                show(worst_pose[f"radius95_{unit}"]),
                direction,
            ]
        )
    return ReportSection(
        "Predicted error",
        [
            Text(f"Over {document['configurations']}; {document['tolerances']['meaning']}."),
            Grid(("length of the error", "position", "orientation"), rows),
            Grid(("worst pose", "where", "rms", "95 % radius", "worst direction (tool)"), worst),
        ],
    )


def _predicted_grade(document: Document) -> ReportSection:
    grade = document["grade"]
    rows = [[name, f"{100 * share:.0f} %"] for name, share in grade["share_of_poses_meeting"].items()]
    limited = f", limited by {' and '.join(grade['limited_by'])}" if grade["limited_by"] else ""
    text = f"Grade of the position {grade['position']}, of the orientation {grade['orientation']}{limited}."
    return ReportSection(f"Grade {grade['grade']}, expected", [Text(text), Grid(("grade", "poses that meet it"), rows)])


def _allocation(allocation: Mapping[str, Any]) -> ReportSection:
    rows: list[Sequence[Cell]] = [
        [
            tolerance["parameter"],
            _size(tolerance["given_sd"], tolerance),
            _size(tolerance["needed_sd"], tolerance),
            f"{tolerance['factor']:.3g}",
        ]
        for tolerance in allocation["tolerances"]
    ]
    reached = "would reach" if allocation["met"] else "would not reach"
    text = (
        f"Tolerances that {reached} grade {allocation['grade']}; with one factor for all tolerances, this factor is "
        f"{allocation['uniform_factor']:.3g}."
    )
    return ReportSection("Tolerances needed", [Text(text), Grid(("parameter", "given", "needed", "factor"), rows)])


def _size(value: float | None, tolerance: Mapping[str, Any]) -> Cell:
    return angle(value) if tolerance["unit"] == "rad" else length(value)


def _against(comparison: Mapping[str, Any]) -> ReportSection:
    measured = comparison["measured"]
    lines = [
        f"verdict over {comparison['n_poses']} measured poses: {str(comparison['verdict']).replace('_', ' ')}",
        f"measured rms {length(measured['position_rms_m'])} in position",
    ]
    if measured["orientation_rms_rad"] is not None:
        lines[-1] += f", {angle(measured['orientation_rms_rad'])} in orientation"
    if comparison["hint"]:
        lines.append(comparison["hint"])
    rows: list[Sequence[Cell]] = [
        [name, f"{test['ratio']:.3g}", p_value(test["p_value"])]
        for name, test in comparison["normalised_squared_error"].items()
        if test is not None and test.get("p_value") is not None and test.get("ratio") is not None
    ]
    blocks: list[Block] = [Listing(lines)]
    if rows:
        blocks.append(Grid(("normalised squared error", "ratio to the expected value", "significance"), rows))
    return ReportSection("Predicted against measured", blocks)


# The sections of a `correct` report.

_LISTED = 40
"""Refused targets that the page lists."""


def correct_sections(document: Document) -> Iterator[ReportSection]:
    """Return corrections and expected errors, and the targets that are not corrected."""
    yield _corrected_figures(document)
    if document["n_refused"]:
        yield _refused(document)


def _corrected_figures(document: Document) -> ReportSection:
    correction, expected = document["correction"], document["expected"]
    rows: list[Sequence[Cell]] = [_row("correction", correction, "rms", "max")]
    for stage in ("before", "after"):
        rows.append(_row(f"expected error {stage}", expected[stage], "expected_rms", "largest_bound95"))
    blocks: list[Block] = [
        Text("Over the corrected targets. The largest expected error is the largest bound of 95 % of the errors."),
        Grid(("", "position, rms", "largest", "orientation, rms", "largest"), rows),
    ]
    grades = [
        [f"grades {stage}", ", ".join(f"{name} {count}" for name, count in expected[stage]["grades"].items() if count)]
        for stage in ("before", "after")
        if expected[stage]["grades"]
    ]
    if grades:
        blocks.append(Grid(("", "targets"), grades, is_text=True))
    return ReportSection("Corrections", blocks)


def _row(label: str, part: Mapping[str, Any], typical: str, largest: str) -> list[Cell]:
    cells: list[Cell] = [label]
    for name, unit, show in (("position", "m", length), ("orientation", "rad", angle)):
        figures = part[name] or {}
        cells += [show(figures.get(f"{key}_{unit}")) for key in (typical, largest)]
    return cells


def _refused(document: Document) -> ReportSection:
    targets = document["targets"]
    rows = [
        [str(line), reason]
        for line, reason in zip(targets["line"], targets["reason"], strict=True)
        if reason is not None
    ]
    more = [Text(f"The first {_LISTED} of {len(rows)}.")] if len(rows) > _LISTED else []
    return ReportSection("Not corrected", [Grid(("line", "reason"), rows[:_LISTED], is_text=True), *more])


# The sections of a `compare` report.


def compare_sections(document: Document) -> Iterator[ReportSection]:
    """Return the ranking, all statistics, the differences from the baseline, and the inputs of each result."""
    if document["ranking"] is not None:
        yield _ranking(document["ranking"])
    yield _values(document)
    if document["baseline"] is not None:
        yield _differences(document)
    yield _inputs(document)


def _ranking(ranking: Mapping[str, Any]) -> ReportSection:
    unit = _unit(ranking["unit"], (entry["value"] for entry in ranking["order"]))
    rows: list[Sequence[Cell]] = [
        [f"{place}. {entry['name']}", quantity(entry["value"], unit), entry["letters"]]
        for place, entry in enumerate(ranking["order"], 1)
    ]
    text = f"By {ranking['by']}, the smallest first; results that share a letter do not differ significantly."
    grid = Grid(("result", ranking["by"], "group"), rows)
    return ReportSection(
        "Ranking", [Text(text), grid, Listing([*ranking["text"], *map(str, ranking["indistinguishable"])])]
    )


def _unit(name: str, values: Any) -> Unit:
    sizes = [value for value in values if value is not None]
    return error_unit(name, *sizes) if name in ("m", "rad") else Unit("", 1.0)


def _values(document: Document) -> ReportSection:
    names = [statistic["name"] for statistic in document["results"]]
    rows: list[Sequence[Cell]] = []
    for statistic in document["statistics"]:
        unit = _unit(statistic["unit"], (value["value"] for value in statistic["values"]))
        by_name = {value["name"]: value for value in statistic["values"]}
        rows.append([statistic["key"], *(_value(by_name.get(name), unit) for name in names)])
    return ReportSection("Statistics", [Grid(("statistic", *names), rows)])


def _value(value: Mapping[str, Any] | None, unit: Unit) -> Cell:
    if value is None or value["value"] is None:
        return "–"
    if not unit.name:
        return Number(three_digits(value["value"]), value["value"])
    return quantity(value["value"], unit, value["lower"], value["upper"])


def _differences(document: Document) -> ReportSection:
    rows: list[Sequence[Cell]] = []
    for statistic in document["statistics"]:
        for difference in statistic["differences"]:
            if difference["value"] is None:
                continue
            unit = _unit(statistic["unit"], [difference["value"]])
            interval_text = interval(
                difference["value"], difference["lower"], difference["upper"], difference["confidence"] or 0.95, unit
            )
            number = quantity(difference["value"], unit, difference["lower"], difference["upper"])
            paired = "yes" if difference["paired"] else "no"
            rows.append(
                [
                    f"{statistic['key']}, {difference['name']}",
                    number,
                    interval_text or "–",
                    p_value(difference["p_value"]),
                    paired,
                ]
            )
    header = ("statistic, result", "difference", "interval", "significance", "same poses")
    text = f"Each result minus {document['baseline']}; negative differences are better."
    return ReportSection(f"Differences from {document['baseline']}", [Text(text), Grid(header, rows)])


def _inputs(document: Document) -> ReportSection:
    results = document["results"]
    keys = dict.fromkeys(key for result in results for key in result["made"])
    rows: list[Sequence[Cell]] = [
        ["robot", *(str(result["robot"] or "–") for result in results)],
        ["poses", *(str(result["n_poses"]) for result in results)],
        *([key, *(str(result["made"].get(key, "–")) for result in results)] for key in keys),
        ["SHA-256", *(result["sha256"] for result in results)],
    ]
    return ReportSection("Compared results", [Grid(("", *(result["name"] for result in results)), rows, is_text=True)])


# The section about the outcome of a gate.

_OUTCOMES = {"pass": "passed", "fail": "failed", "inconclusive": "inconclusive", "not_evaluated": "not evaluated"}


def gate_section(document: Document) -> ReportSection | None:
    """Return each criterion with value, bounds, limit and outcome; None without a gate."""
    gate = document.get("gate")
    if not gate:
        return None
    rows = [_criterion(criterion) for criterion in gate["criteria"]]
    header = ("criterion", "outcome", "value", "bounds", "limit", "conformity probability", "poses to decide")
    blocks: list[Block] = [Grid(header, rows)]
    why = [f"{criterion['name']}: {criterion['why']}" for criterion in gate["criteria"] if criterion["why"]]
    why += [f"{criterion['name']}: {criterion['reason']}" for criterion in gate["criteria"] if criterion["reason"]]
    if why:
        blocks.append(Listing(why))
    if gate["warnings"]:
        blocks.append(Listing(list(gate["warnings"]), "warning"))
    return ReportSection(f"Gate {gate['name']}: {_OUTCOMES.get(gate['outcome'], gate['outcome'])}", blocks)


def _criterion(criterion: Mapping[str, Any]) -> Sequence[Cell]:
    bounds = [criterion["lower_bound"], criterion["upper_bound"]]
    bounds_text = (
        " … ".join(str(value_of(bound, criterion["unit"])) for bound in bounds)
        if any(b is not None for b in bounds)
        else "–"
    )
    sign = "at least " if criterion["at_least"] else ""
    limit = criterion["limit"]
    probability = criterion["conformity_probability"]
    return [
        criterion["name"],
        _OUTCOMES.get(criterion["outcome"], criterion["outcome"]),
        value_of(criterion["value"], criterion["unit"]),
        bounds_text,
        f"{sign}{', '.join(map(str, limit)) if isinstance(limit, list) else value_of(limit, criterion['unit'])}",
        "–" if probability is None else f"{100 * probability:.1f} %",
        "–" if criterion["poses_to_decide"] is None else f"{criterion['poses_to_decide']:,}",
    ]


def value_of(value: Any, unit: str) -> Cell:
    """Return a value of a criterion: a number, a word or a grade."""
    if value is None:
        return Number("–", None)
    if isinstance(value, str):
        return value
    if unit == "m":
        return length(value)
    return angle(value) if unit == "rad" else Number(three_digits(float(value)), float(value))
