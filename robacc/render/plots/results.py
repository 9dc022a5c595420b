"""Charts of error budgets, comparisons, gates, evaluations after ISO 9283, and what a plan expects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from robacc.render.plots.canvas import (
    Array,
    Axis,
    Chart,
    Panel,
    Rows,
    Series,
    numbers,
    short,
    thinned,
    thinning_note,
    vectors,
)
from robacc.render.text.layout import Document, Unit, error_unit
from robacc.render.views.elements import Grid, effect_families

# Charts of the error budget of a prediction.

_BARS = 10


def budget_charts(document: Document) -> Iterator[Chart]:
    """Return the shares by parameter and by joint."""
    if shares := document.get("budget"):
        yield _budget_chart("budget", shares, "parameter", "source" if shares[0].get("sd") is None else "parameter")
    if shares := document.get("budget_by_joint"):
        yield _budget_chart("budget-joints", shares, "name", "joint")


def _budget_chart(kind: str, shares: Sequence[Mapping[str, Any]], name: str, label: str) -> Chart:
    first, toleranced = shares[0], label == "parameter"
    top = shares[:_BARS]
    omitted = f" The table has the {len(shares) - len(top)} smaller shares." if len(shares) > len(top) else ""
    rows = np.arange(len(top))
    position, orientation = (
        100 * numbers(share[f"share_{key}"] for share in top) for key in ("position", "orientation")
    )
    return Chart(
        kind,
        f"Error budget by {label}",
        f"Share of the predicted variance of position (bars) and orientation (outlines) by {label}; all shares sum to "
        f"100 %. The largest share of position is {first[name]} with {100 * first['share_position']:.1f} %.{omitted}",
        "Bars of shares of variance, position: "
        + "; ".join(f"{share[name]} {100 * share['share_position']:.1f} %" for share in top),
        [
            Panel(
                (
                    Axis("share of the variance, %", 0, 1.12 * max(*position, *orientation)),
                    Axis("", names=[short(str(share[name])) for share in top]),
                ),
                [
                    Series(
                        (position, rows - 0.17),
                        "after",
                        "position",
                        kind="bars",
                        size=0.34,
                        texts=[f"{value:.1f}" for value in position],
                    ),
                    Series((orientation, rows + 0.19), "before", "orientation", kind="bars", size=0.26, hollow=True),
                ],
            )
        ],
        Grid(
            (label, *(("tolerance (sd)",) * toleranced), "position", "orientation"),
            [
                [
                    str(share[name]),
                    *([error_unit(share["unit"], share["sd"]).text(share["sd"])] if toleranced else []),
                    *(f"{100 * share[f'share_{key}']:.2f} %" for key in ("position", "orientation")),
                ]
                for share in shares
            ],
        ),
        (4.9, 1.05 + 0.3 * len(top)),
    )


# Charts of a statistic of several results with its intervals.

_MAX_RESULTS = 30


def comparison_charts(document: Document) -> Iterator[Chart]:
    """Return a chart for each statistic with intervals, except those of stages; the ranking statistic comes first."""
    if document["command"] != "compare":
        return
    by = (document.get("ranking") or {}).get("by")
    for statistic in sorted(document["statistics"], key=lambda statistic: statistic["key"] != by):
        key = statistic["key"]
        values = [value for value in statistic["values"] if value["value"] is not None][:_MAX_RESULTS]
        is_shown = statistic["unit"] in ("m", "rad") and (key == by or key.count(".") == 1)
        if is_shown and len(values) > 1 and any(value["lower"] is not None for value in values):
            yield _comparison_chart(statistic, values, document["baseline"], key == by)


def intervals(
    figures: Sequence[Array], at: Array | Rows, role: str, vertical: bool, label: str = "", **looks: Any
) -> list[Series]:
    """Return marks at values with lower and upper ends, NaN if unknown, along one axis and ``at`` along the other."""
    values, *bounds = figures
    ends = np.stack([np.where(np.isnan(end), values, end) for end in bounds])
    # A value outside its interval stays on the line.
    ends = np.stack((np.minimum(ends[0], values), np.maximum(ends[1], values), np.full(values.size, np.nan)))
    along, across = ends.T.ravel(), np.repeat(at, 3)
    marks, bars = ((at, values), (across, along)) if vertical else ((values, at), (along, across))
    return [
        Series(bars, role, line="-", marker="_" if vertical else "|", size=7, width=1.3),
        Series(marks, role, label, **{"marker": "o", "size": 6, **looks}),
    ]


def _comparison_chart(
    statistic: Mapping[str, Any], values: Sequence[Mapping[str, Any]], baseline: str | None, ranks: bool
) -> Chart:
    signed = any((value[name] or 0.0) < 0.0 for value in values for name in ("value", "lower", "upper"))
    unit = error_unit(statistic["unit"], *(value["value"] for value in values))
    best = min(values, key=lambda value: abs(float(value["value"])))
    confidence = next((value["confidence"] for value in values if value["confidence"] is not None), 0.95)
    first = "The ranking uses this statistic. " if ranks else ""
    baseline_note = f" The hollow mark is the baseline, {baseline}." if baseline is not None else ""
    figures = [unit.factor * numbers(value[key] for value in values) for key in ("value", "lower", "upper")]
    is_baseline = np.array([value["name"] == baseline for value in values])
    series = [
        one
        for role, mask, hollow in (("after", ~is_baseline, False), ("before", is_baseline, True))
        for one in intervals(
            [figure[mask] for figure in figures], np.flatnonzero(mask), role, vertical=False, hollow=hollow
        )
    ]
    return Chart(
        "comparison",
        f"{statistic['key']} of each result",
        f"{first}Each result's {statistic['key']} with its {100 * confidence:g} % interval; the smallest"
        f"{' in magnitude' * signed} is {best['name']}, {unit.text(best['value'])}.{baseline_note} "
        "The tables test the differences: results with "
        "overlapping intervals can still differ significantly.",
        f"Points with intervals in {unit.name}: "
        + "; ".join(f"{value['name']} {unit.text(value['value'])}" for value in values),
        [
            Panel(
                (
                    Axis(f"{statistic['key']}, {unit.name}", None if signed else 0, rules=[(0, "")] * signed),
                    Axis("", names=[short(str(value["name"])) for value in values]),
                ),
                series,
            )
        ],
        Grid(
            ("result", "value", "from", "to"),
            [[v["name"], unit.text(v["value"]), unit.text(v["lower"]), unit.text(v["upper"])] for v in values],
        ),
        (4.9, 1.1 + 0.34 * len(values)),
    )


# Operating curves of a gate: the probability to pass over the true value.

_ROWS = 25


def operating_curve_charts(document: Document) -> Iterator[Chart]:
    """Return the operating curve of each criterion that has one."""
    for criterion in (document.get("gate") or {}).get("criteria", ()):
        if len(criterion["operating_curve"]) > 1:
            yield _gate_chart(criterion)


def _gate_chart(criterion: Mapping[str, Any]) -> Chart:
    limit, value = float(criterion["limit"]), float(criterion["value"])
    unit = error_unit(criterion["unit"], limit, value) if criterion["unit"] in ("m", "rad") else Unit(1.0, "")
    curve = np.array(criterion["operating_curve"], dtype=np.float64)
    pick = np.unique(np.linspace(0, len(curve) - 1, min(len(curve), _ROWS)).round().astype(int))
    count = "" if criterion["n_poses"] is None else f" with {criterion['n_poses']:,} poses"
    if criterion["operating_curve_over"] == "share_within_limit":
        abscissa, header, at_least, line = Unit(100.0, "%"), "share of all poses within the limit", True, "required"
        place = float(criterion["share"])
        over = f"the share of all poses that are within the limit, {unit.text(limit)}"
        text = (
            f"The vertical line is the required share, {abscissa.text(place)}. "
            "Passing with a smaller share is a false acceptance."
        )
        axis = f"share of all poses with {short(criterion['key'].rpartition('.')[0], 24)} within {unit.text(limit)}, %"
    else:
        abscissa, header, at_least, line = unit, "true value", bool(criterion["at_least"]), "limit"
        place, over = limit, "the true value"
        text = (
            f"The vertical line is the limit, {unit.text(limit)}; the dot is the measured value, {unit.text(value)}. "
            f"Passing with a true value {'below' if at_least else 'above'} the limit is a false acceptance."
        )
        axis = f"true value of {short(criterion['key'], 40)}{f', {unit.name}' if unit.name else ''}"
    x, y = curve[:, 0] * abscissa.factor, 100 * curve[:, 1]
    wrong = np.where(curve[:, 0] <= place if at_least else curve[:, 0] >= place, y, np.nan)
    series = [
        Series((x, y), "after", "probability to pass", line="-", width=1.6),
        Series((x, wrong), "before", "false acceptance", kind="band", alpha=0.25),
    ]
    if line == "limit":
        series.append(Series(([value * unit.factor], [0]), "ink", "measured", marker="o", size=6))
    return Chart(
        "operating-curve",
        f"Gate {criterion['name']}: operating curve",
        f"Probability that this criterion passes{count}, as a function of {over}. {criterion['rule_text']}. {text}",
        f"Probability to pass, 0 to 100 %, over the {header}; limit {unit.text(limit)}, measured {unit.text(value)}",
        [
            Panel(
                (Axis(axis, rules=[(place * abscissa.factor, line)]), Axis("probability to pass, %", -2, 102)),
                series,
            )
        ],
        Grid(
            (header, "probability to pass"),
            [[abscissa.text(float(true)), f"{100 * share:.1f} %"] for true, share in curve[pick]],
        ),
        (4.9, 2.8),
    )


# Charts of an ISO 9283 evaluation: accuracy and repeatability by pose, and the visits of each pose.

_CLOUDS = 12
_VISITS = 200
_LISTED_VISITS = 60
_PANELS = {"AP": "AP, pose accuracy", "RP": "RP, pose repeatability (not accuracy)"}
_LOOKS = {"AP": ("before", "o"), "RP": ("after", "s")}


def iso9283_charts(document: Document) -> Iterator[Chart]:
    """Return AP and RP of all poses, then the visits of the first poses."""
    if "iso9283" not in document:
        return
    criteria = {key: document["iso9283"][key] for key in _PANELS if document["iso9283"][key]["poses"]}
    if criteria:
        yield _overview(criteria)
    for visits in document["visits"][:_CLOUDS]:
        if visits["n"] > 1:
            yield _cloud(document, visits)


def _overview(criteria: Mapping[str, Mapping[str, Any]]) -> Chart:
    names = [*dict.fromkeys(str(place["pose"]) for part in criteria.values() for place in part["poses"])]
    last = [*criteria][-1]
    figures = {
        key: (
            numbers(place["position_m"] for place in part["poses"]),
            *(numbers(place["intervals"]["position_m"][end] for place in part["poses"]) for end in ("lower", "upper")),
        )
        for key, part in criteria.items()
    }
    # Values without an upper limit stand for themselves.
    unit = error_unit(
        "m", max(float(np.nanmax(np.append(figure[[0, 2]], 0.0))) for figure in map(np.array, figures.values()))
    )
    maxima = [
        f"{key} is largest at {part['max_at']}, {unit.text(part['max_m'])}"
        for key, part in criteria.items()
        if part["max_m"] is not None
    ]
    # Separate panels, so that readers do not take repeatability for accuracy.
    panels = [
        Panel(
            (
                Axis(
                    "commanded pose" if key == last else "",
                    -0.6,
                    len(names) - 0.4,
                    names=[short(name, 10) * (key == last) for name in names],
                ),
                Axis(f"{key}, {unit.name}", 0),
            ),
            intervals(
                [unit.factor * column for column in figures[key]],
                np.array([names.index(str(place["pose"])) for place in part["poses"]]),
                _LOOKS[key][0],
                vertical=True,
                marker=_LOOKS[key][1],
                size=5,
            ),
            _PANELS[key],
        )
        for key, part in criteria.items()
    ]
    return Chart(
        "iso9283",
        "Accuracy (AP) and repeatability (RP) by commanded pose",
        "AP is the distance of the barycentre of the visits from the commanded pose, RP the scatter of the visits; "
        f"bars are confidence intervals. {'; '.join(maxima)}.",
        f"Points with intervals of AP and RP in {unit.name} for each commanded pose; {'; '.join(maxima)}",
        panels,
        Grid(
            ("criterion, pose", "visits", "value", "from", "to"),
            [
                [f"{key}, {place['pose']}", str(place["n"]), *map(unit.text, sizes)]
                for key, part in criteria.items()
                for place, *sizes in zip(part["poses"], *figures[key], strict=True)
            ],
        ),
    )


def _cloud(document: Document, visits: Mapping[str, Any]) -> Chart:
    attained, centre = vectors(visits["attained_m"]), numbers(visits["barycentre_m"])
    is_known = visits["commanded_m"] is not None
    origin = numbers(visits["commanded_m"]) if is_known else centre
    offsets, centre = attained - origin, centre - origin
    radius = next(
        (
            place["position_m"]
            for place in document["iso9283"]["RP"]["poses"]
            if (place["pose"], place["file"]) == (visits["pose"], visits["file"])
        ),
        None,
    )
    reach = max(float(np.abs(offsets).max()), float(np.abs(centre).max()) + (radius or 0.0))
    unit = error_unit("m", reach)
    rows, limit = thinned(_VISITS, *offsets.T), 1.08 * reach * unit.factor or 1.0
    zero = "the commanded pose" if is_known else "the barycentre because the commanded pose is unknown"
    circle = f"; the circle is RP, {unit.text(radius)}, about the barycentre" if radius is not None else ""
    around, shown = np.linspace(0.0, 2 * np.pi, 97), offsets[rows] * unit.factor
    panels = []
    for i, j in ((0, 1), (0, 2)):
        x, y = centre[[i, j]] * unit.factor
        series = [Series((shown[:, i], shown[:, j]), "after", "one visit", marker="o")]
        if radius is not None:
            ring = radius * unit.factor * np.array([np.cos(around), np.sin(around)])
            series.append(Series((x + ring[0], y + ring[1]), "before", "RP", line="-"))
        series.append(Series(([x], [y]), "ink", "barycentre", marker="s", size=5, hollow=True))
        series.append(Series(([0], [0]), "ink", "commanded", marker="+", size=9))
        axes = [Axis(f"{'xyz'[k]}, {unit.name}", -limit, limit) for k in (i, j)]
        panels.append(Panel(axes, series, equal=True))
    cycles = visits["cycle"]
    return Chart(
        "iso9283-cloud",
        f"Visits of {visits['pose']}",
        f"Attained positions of the {visits['n']} visits of {visits['pose']}, from above and from the side, relative "
        f"to {zero} (cross). The square is their barycentre{circle}.{thinning_note(rows.size, len(offsets))}",
        f"Two projections of {visits['n']} visits in {unit.name}; "
        f"barycentre {unit.text(float(np.sqrt(np.sum(np.square(centre)))))} from zero",
        panels,
        Grid(
            ("visit", "x", "y", "z"),
            [
                [f"{i + 1}" if cycles is None else f"cycle {cycles[i]}", *map(unit.text, offsets[i])]
                for i in map(int, rows[:_LISTED_VISITS])
            ],
            note=f"{_LISTED_VISITS} of {len(offsets)} visits; the JSON result has all of them."
            * (len(offsets) > _LISTED_VISITS),
        ),
        (4.9, 2.9),
        columns=2,
    )


# Charts of a plan: the predicted error over the number of poses, and detection limits.


def expected_accuracy_charts(document: Document) -> Iterator[Chart]:
    """Return the chart of the error that a plan predicts, if it is known for several numbers of poses."""
    accuracy = document["accuracy"]
    if accuracy is None or len(accuracy["curve"]) < 2:
        return
    points, knee, planned = accuracy["curve"], accuracy["knee"], accuracy["planned"]
    unit = error_unit("m", *(point["total_rms_m"] for point in points))
    ending = "Ten more poses still reduce it by more than 10 %."
    if knee is not None:
        ending = f"From {knee} poses on (the knee), ten more reduce it by less than 10 %."
    n = numbers(point["n_poses"] for point in points)
    series = [
        Series(
            (n, unit.factor * numbers(point[key] for point in points)), role, label, marker=marker, line=line, size=3.4
        )
        for key, label, role, line, marker in (
            ("total_rms_m", "with repeatability", "nominal", "-", "s"),
            ("random_rms_m", "random poses", "before", "--", "^"),
            ("rms_m", "planned poses", "after", "-", "o"),
        )
    ]
    at_plan = ""
    if planned is not None:
        at_plan = f" The plan of {planned['n_poses']} poses has {unit.text(planned['rms_m'])}."
        y = [planned["rms_m"] * unit.factor]
        series.append(Series(([planned["n_poses"]], y), "ink", "this plan", marker="o", size=8, hollow=True))
    rules = [] if knee is None else [(knee, f"knee, {knee} poses")]
    yield Chart(
        "expected-accuracy",
        "Predicted error over the number of poses",
        f"Predicted rms position error of the calibrated model over the task, for planned and random poses.{at_plan}"
        f" The upper line adds what no fit removes: repeatability and unexplained error. {ending}",
        f"Predicted error in {unit.name} over the number of poses, planned below random; knee at {knee or 'none'}",
        [Panel((Axis("number of poses", rules=rules), Axis(f"predicted error, {unit.name}", 0)), series)],
        Grid(
            ("poses", "rms", "random poses, rms", "worst", "with repeatability, rms"),
            [
                [str(point["n_poses"])]
                + [unit.text(point[key]) for key in ("rms_m", "random_rms_m", "worst_m", "total_rms_m")]
                for point in points
            ],
        ),
        (4.9, 3.0),
    )


def detection_limit_charts(document: Document) -> Iterator[Chart]:
    """Return the chart of the effects that a trace of planned poses can find, the likeliest first."""
    families = sorted(effect_families(document), key=lambda family: -family.power)
    if not families:
        return
    detectable = [family for family in families if family.known]
    sure = sum(family.power >= 0.5 for family in families)
    series, rows = [], []
    for place, family in enumerate(detectable):
        role = "after" if family.power >= 0.5 else "before"
        ends = numbers(family.known[end]["limit"] for end in (0, -1)) / family.entries[0]["usual_size"]
        series.append(
            Series((ends, [place] * 2), role, marker="o", line="-", size=4, width=1.6, hollow=role == "before")
        )
    for family in families:
        limits = [f"{family.known[end]['limit']:.1e}" if family.known else "–" for end in (0, -1)]
        first = family.entries[0]
        usual, power = f"{first['usual_size']:.1e}", f"{100 * family.power:.0f} %"
        rows.append([family.name, *limits, first["unit"], usual, power])
    yield Chart(
        "detection-limits",
        "Detection limits",
        "Size of each effect that a trace of these poses finds with probability 1/2, over its usual size; a line joins "
        f"the most and the least visible joint. Left of 1, the usual size is found. {sure} of {len(families)} effects "
        "are found at their usual size with a mean probability of at least 1/2.",
        f"Ranges of detection limits over usual sizes for {len(detectable)} effects, logarithmic",
        [
            Panel(
                (
                    Axis("detection limit over the usual size", is_log=True, rules=[(1.0, "usual size")]),
                    Axis("", names=[family.name for family in detectable]),
                ),
                series,
            )
        ],
        Grid(("effect", "lowest limit", "highest", "unit", "usual size", "mean power"), rows),
        (4.9, 1.0 + 0.24 * max(len(detectable), 3)),
    )
