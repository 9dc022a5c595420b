"""Charts of error budgets, comparisons, gates and evaluations after ISO 9283."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from robacc.render.plots.canvas import (
    DEGREE,
    LIGHT,
    Array,
    Chart,
    ChartTable,
    Document,
    Unit,
    error_unit,
    length_unit,
    short,
    thinned,
    thinning_note,
    vectors,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Charts of the error budget of a prediction.

_BARS = 10


def budget_charts(document: Document) -> Iterator[Chart]:
    """Return the shares by parameter and by joint."""
    for kind, key, name, label in (
        ("budget", "budget", "parameter", "parameter"),
        ("budget-joints", "budget_by_joint", "name", "joint"),
    ):
        shares = document.get(key) or ()
        if shares:
            yield _budget_chart(
                kind, shares, name, label if shares[0].get("sd") is not None or name == "name" else "source"
            )


def _budget_chart(kind: str, shares: Sequence[Mapping[str, Any]], name: str, label: str) -> Chart:
    first = shares[0]
    top = shares[:_BARS]
    omitted = f" The table has the {len(shares) - len(top)} smaller shares." if len(shares) > len(top) else ""
    return Chart(
        kind,
        f"Error budget by {label}",
        f"Share of the predicted variance of position (bars) and orientation (outlines) by {label}; all shares sum to "
        f"100 %. The largest share of position is {first[name]} with {100 * first['share_position']:.1f} %.{omitted}",
        "Bars of shares of variance, position: "
        + "; ".join(f"{share[name]} {100 * share['share_position']:.1f} %" for share in top),
        lambda figure: _draw_budget(figure, top, name),
        _table(shares, name, label),
        (4.9, 1.05 + 0.3 * len(top)),
    )


def _table(shares: Sequence[Mapping[str, Any]], name: str, label: str) -> ChartTable:
    toleranced = label == "parameter"
    header = (label, *(("tolerance (sd)",) if toleranced else ()), "position", "orientation")
    rows = [
        [
            str(share[name]),
            *([_tolerance(share)] if toleranced else []),
            f"{100 * share['share_position']:.2f} %",
            f"{100 * share['share_orientation']:.2f} %",
        ]
        for share in shares
    ]
    return ChartTable(header, rows)


def _tolerance(share: Mapping[str, Any]) -> str:
    return DEGREE.text(share["sd"]) if share["unit"] == "rad" else length_unit(share["sd"]).text(share["sd"])


def _draw_budget(figure: Figure, shares: Sequence[Mapping[str, Any]], name: str) -> None:
    axes = figure.add_subplot()
    rows = np.arange(len(shares))
    position = [100 * share["share_position"] for share in shares]
    orientation = [100 * share["share_orientation"] for share in shares]
    bars = axes.barh(rows - 0.17, position, height=0.34, color=LIGHT["after"], label="position")
    axes.barh(
        rows + 0.19,
        orientation,
        height=0.26,
        facecolor="none",
        edgecolor=LIGHT["before"],
        linewidth=1,
        label="orientation",
    )
    axes.bar_label(bars, [f"{value:.1f}" for value in position], padding=3, fontsize=8)
    axes.set_yticks(rows, [short(str(share[name])) for share in shares])
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.invert_yaxis()
    axes.set(xlabel="share of the variance, %", xlim=(0, 1.12 * max(*position, *orientation)))
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)


# Charts of a statistic of several results with its intervals.

_MAX_RESULTS = 30


def comparison_charts(document: Document) -> Iterator[Chart]:
    """Return a chart for each statistic with intervals, except those of stages; the ranking statistic comes first."""
    if document["command"] != "compare":
        return
    by = (document.get("ranking") or {}).get("by")
    statistics = [
        statistic
        for statistic in document["statistics"]
        if statistic["unit"] in ("m", "rad") and (statistic["key"] == by or statistic["key"].count(".") == 1)
    ]
    for statistic in sorted(statistics, key=lambda statistic: statistic["key"] != by):
        values = [value for value in statistic["values"] if value["value"] is not None][:_MAX_RESULTS]
        if len(values) > 1 and any(value["lower"] is not None for value in values):
            yield _comparison_chart(statistic, values, document["baseline"], statistic["key"] == by)


def _comparison_chart(
    statistic: Mapping[str, Any], values: Sequence[Mapping[str, Any]], baseline: str | None, ranks: bool
) -> Chart:
    ends = [value[name] for value in values for name in ("value", "lower", "upper") if value[name] is not None]
    signed = min(ends) < 0.0
    unit = error_unit(statistic["unit"], *(value["value"] for value in values))
    best = min(values, key=lambda value: abs(float(value["value"])))
    confidence = next((value["confidence"] for value in values if value["confidence"] is not None), 0.95)
    first = "The ranking uses this statistic. " if ranks else ""
    baseline_note = f" The hollow mark is the baseline, {baseline}." if baseline is not None else ""
    return Chart(
        "comparison",
        f"{statistic['key']} of each result",
        f"{first}Each result's {statistic['key']} with its {100 * confidence:g} % interval; the smallest"
        f"{' in magnitude' * signed} is {best['name']}, {unit.text(best['value'])}.{baseline_note} "
        "The tables test the differences: results with "
        "overlapping intervals can still differ significantly.",
        f"Points with intervals in {unit.name}: "
        + "; ".join(f"{value['name']} {unit.text(value['value'])}" for value in values),
        lambda figure: _draw_comparison(figure, statistic["key"], values, baseline, unit, signed),
        ChartTable(
            ("result", "value", "from", "to"),
            [[v["name"], unit.text(v["value"]), unit.text(v["lower"]), unit.text(v["upper"])] for v in values],
        ),
        (4.9, 1.3 + 0.34 * len(values)),
    )


def _draw_comparison(
    figure: Figure, key: str, values: Sequence[Mapping[str, Any]], baseline: str | None, unit: Unit, signed: bool
) -> None:
    axes = figure.add_subplot()
    for row, value in enumerate(values):
        x = value["value"] * unit.factor
        ends = [x if end is None else end * unit.factor for end in (value["lower"], value["upper"])]
        reach = np.maximum([[x - ends[0]], [ends[1] - x]], 0.0)
        is_baseline = value["name"] == baseline
        looks: dict[str, Any] = {
            "mfc": "none" if is_baseline else LIGHT["after"],
            "color": LIGHT["before" if is_baseline else "after"],
        }
        axes.errorbar([x], [row], xerr=reach, fmt="o", ms=6, mew=1.4, capsize=3, linewidth=1.4, **looks)
    axes.set_yticks(range(len(values)), [short(str(value["name"])) for value in values])
    axes.set_ylim(len(values) - 0.5, -0.5)
    if signed:
        axes.axvline(0, color=LIGHT["limit"], linewidth=0.9)
    else:
        axes.set_xlim(left=0)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(f"{key}, {unit.name}")


# Operating curves of a gate: the probability to pass over the true value.

_ROWS = 25
_SHARE = Unit("%", 100.0)


def operating_curve_charts(document: Document) -> Iterator[Chart]:
    """Return the operating curve of each criterion that has one."""
    for criterion in (document.get("gate") or {}).get("criteria", ()):
        if len(criterion["operating_curve"]) > 1:
            yield _gate_chart(criterion)


def _unit(criterion: Mapping[str, Any]) -> Unit:
    """Return the unit of the value and its limit."""
    if criterion["unit"] == "m":
        return length_unit(float(criterion["limit"]), float(criterion["value"]))
    return DEGREE if criterion["unit"] == "rad" else Unit("", 1.0)


def _gate_chart(criterion: Mapping[str, Any]) -> Chart:
    unit = _unit(criterion)
    curve = np.array(criterion["operating_curve"], dtype=np.float64)
    limit, value = float(criterion["limit"]), float(criterion["value"])
    pick = np.unique(np.linspace(0, len(curve) - 1, min(len(curve), _ROWS)).round().astype(int))
    count = "" if criterion["n_poses"] is None else f" with {criterion['n_poses']:,} poses"
    start = f"Probability that this criterion passes{count}, as a function of "
    if criterion["operating_curve_over"] == "share_within_limit":
        abscissa, header = _SHARE, "share of all poses within the limit"
        required = float(criterion["share"])
        text = (
            f"{start}the share of all poses that are within the limit, {unit.text(limit)}. {criterion['rule_text']}. "
            f"The vertical line is the required share, {abscissa.text(required)}. "
            "Passing with a smaller share is a false acceptance."
        )
        axis = f"share of all poses with {short(criterion['key'].rpartition('.')[0], 24)} within {unit.text(limit)}, %"
        marks = _Marks(required, None, True, axis)
    else:
        abscissa, header = unit, "true value"
        side = "below" if criterion["at_least"] else "above"
        text = (
            f"{start}the true value. {criterion['rule_text']}. "
            f"The vertical line is the limit, {unit.text(limit)}; the dot is the measured value, {unit.text(value)}. "
            f"Passing with a true value {side} the limit is a false acceptance."
        )
        axis = f"true value of {short(criterion['key'], 40)}{f', {unit.name}' if unit.name else ''}"
        marks = _Marks(limit, value, bool(criterion["at_least"]), axis)
    return Chart(
        "operating-curve",
        f"Gate {criterion['name']}: operating curve",
        text,
        f"Probability to pass, 0 to 100 %, over the {header}; limit {unit.text(limit)}, measured {unit.text(value)}",
        lambda figure: _draw_gate(figure, marks, curve, abscissa),
        ChartTable(
            (header, "probability to pass"),
            [[abscissa.text(float(true)), f"{100 * share:.1f} %"] for true, share in curve[pick]],
        ),
        (4.9, 2.8),
    )


class _Marks(NamedTuple):
    """Marks on the abscissa of an operating curve, and its label."""

    limit: float
    value: float | None
    at_least: bool
    axis: str


def _draw_gate(figure: Figure, marks: _Marks, curve: Array, unit: Unit) -> None:
    axes = figure.add_subplot()
    x, y = curve[:, 0] * unit.factor, 100 * curve[:, 1]
    limit = marks.limit * unit.factor
    axes.plot(x, y, color=LIGHT["after"], label="probability to pass")
    wrong = x <= limit if marks.at_least else x >= limit
    axes.fill_between(x, y, where=wrong, color=LIGHT["before"], alpha=0.25, linewidth=0, label="false acceptance")
    axes.axvline(limit, color=LIGHT["limit"], linewidth=1.1, linestyle=(0, (3, 2)), label="limit")
    if marks.value is not None:
        axes.plot(
            marks.value * unit.factor, 0, "o", ms=6, color=LIGHT["ink"], clip_on=False, zorder=5, label="measured"
        )
    axes.set(ylim=(0, 102), ylabel="probability to pass, %")
    axes.set_xlabel(marks.axis)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, columnspacing=1.0, handlelength=1.5)


# Charts of an ISO 9283 evaluation: accuracy and repeatability by pose, and the visits of each pose.

_CLOUDS = 12
_VISITS = 200
_PLANES = ((0, 1), (0, 2))

_PANELS = {"AP": "AP, pose accuracy", "RP": "RP, pose repeatability (not accuracy)"}

Criteria = Sequence[tuple[str, str, Mapping[str, Any]]]
"""Colour role, symbol, and the criterion's part of the document."""


def iso9283_charts(document: Document) -> Iterator[Chart]:
    """Return AP and RP of all poses, then the visits of the first poses."""
    if "iso9283" not in document:
        return
    evaluation = document["iso9283"]
    criteria = [
        (role, key, evaluation[key]) for role, key in (("before", "AP"), ("after", "RP")) if evaluation[key]["poses"]
    ]
    if criteria:
        yield _overview(criteria)
    for visits in document["visits"][:_CLOUDS]:
        if visits["n"] > 1:
            yield _cloud(document, visits)


def _overview(criteria: Criteria) -> Chart:
    largest = max(_top(place) for _, _, part in criteria for place in part["poses"])
    unit = length_unit(largest)
    maxima = [
        f"{key} is largest at {part['max_at']}, {unit.text(part['max_m'])}"
        for _, key, part in criteria
        if part["max_m"] is not None
    ]
    rows = [
        [f"{key}, {_label(place)}", str(place["n"]), unit.text(place["position_m"]), *_ends(place, unit)]
        for _, key, part in criteria
        for place in part["poses"]
    ]
    return Chart(
        "iso9283",
        "Accuracy (AP) and repeatability (RP) by commanded pose",
        "AP is the distance of the barycentre of the visits from the commanded pose, RP the scatter of the visits; "
        f"bars are confidence intervals. {'; '.join(maxima)}.",
        f"Points with intervals of AP and RP in {unit.name} for each commanded pose; {'; '.join(maxima)}",
        lambda figure: _draw_overview(figure, criteria, unit),
        ChartTable(("criterion, pose", "visits", "value", "from", "to"), rows),
    )


def _label(place: Mapping[str, Any]) -> str:
    return str(place["pose"])


def _top(place: Mapping[str, Any]) -> float:
    ends = (place["position_m"], place["intervals"]["position_m"]["upper"])
    return max((value for value in ends if value is not None), default=0.0)


def _ends(place: Mapping[str, Any], unit: Unit) -> list[str]:
    interval = place["intervals"]["position_m"]
    return [unit.text(interval["lower"]), unit.text(interval["upper"])]


def _draw_overview(figure: Figure, criteria: Criteria, unit: Unit) -> None:
    # Separate panels, so that readers do not take repeatability for accuracy.
    panels = figure.subplots(len(criteria), 1, sharex=True, squeeze=False)[:, 0]
    names = list(dict.fromkeys(_label(place) for _, _, part in criteria for place in part["poses"]))
    for axes, (role, key, part) in zip(panels, criteria, strict=True):
        places = [place for place in part["poses"] if place["position_m"] is not None]
        x = np.array([names.index(_label(place)) for place in places])
        y = np.array([place["position_m"] for place in places]) * unit.factor
        ends = [(place["intervals"]["position_m"], place["position_m"]) for place in places]
        low = [0.0 if interval["lower"] is None else max(value - interval["lower"], 0.0) for interval, value in ends]
        high = [0.0 if interval["upper"] is None else max(interval["upper"] - value, 0.0) for interval, value in ends]
        bars = np.array([low, high]) * unit.factor
        axes.errorbar(x, y, bars, fmt="o" if key == "AP" else "s", color=LIGHT[role], ms=5, capsize=3, linewidth=1.3)
        axes.set(ylabel=f"{key}, {unit.name}", xlim=(-0.6, len(names) - 0.4))
        axes.set_title(_PANELS[key], loc="left", fontsize="medium")
        axes.set_ylim(bottom=0)
        axes.grid(visible=False, axis="x")
    panels[-1].set_xlabel("commanded pose")
    panels[-1].set_xticks(range(len(names)), [short(name, 10) for name in names], rotation=0 if len(names) < 7 else 60)


def _cloud(document: Document, visits: Mapping[str, Any]) -> Chart:
    attained = vectors(visits["attained_m"])
    centre = np.array(visits["barycentre_m"])
    commanded = None if visits["commanded_m"] is None else np.array(visits["commanded_m"])
    origin = centre if commanded is None else commanded
    offsets = attained - origin
    radius = _repeatability(document, visits)
    reach = float(max(np.abs(offsets).max(), np.abs(centre - origin).max() + (radius or 0.0)))
    unit = length_unit(reach)
    rows = thinned(_VISITS, *offsets.T)
    zero = "the commanded pose" if commanded is not None else "the barycentre because the commanded pose is unknown"
    circle = f"; the circle is RP, {unit.text(radius)}, about the barycentre" if radius is not None else ""
    return Chart(
        "iso9283-cloud",
        f"Visits of {visits['pose']}",
        f"Attained positions of the {visits['n']} visits of {visits['pose']}, from above and from the side, relative "
        f"to {zero} (cross). The square is their barycentre{circle}.{thinning_note(rows.size, len(offsets))}",
        f"Two projections of {visits['n']} visits in {unit.name}; "
        f"barycentre {unit.text(_size(centre - origin))} from zero",
        lambda figure: _draw_cloud(figure, offsets[rows], centre - origin, radius, unit),
        ChartTable(
            ("visit", "x", "y", "z"),
            [[_visit(visits, int(i)), *(unit.text(float(v)) for v in offsets[i])] for i in rows[:60]],
            f"60 of {len(offsets)} visits; the JSON result has all of them." if len(offsets) > 60 else "",
        ),
        (4.9, 2.7),
    )


def _size(vector: Array) -> float:
    return float(np.sqrt(np.sum(np.square(vector))))


def _visit(visits: Mapping[str, Any], i: int) -> str:
    return f"{i + 1}" if visits["cycle"] is None else f"cycle {visits['cycle'][i]}"


def _repeatability(document: Document, visits: Mapping[str, Any]) -> float | None:
    for place in document["iso9283"]["RP"]["poses"]:
        if place["pose"] == visits["pose"] and place["file"] == visits["file"]:
            return None if place["position_m"] is None else float(place["position_m"])
    return None


def _draw_cloud(figure: Figure, offsets: Array, centre: Array, radius: float | None, unit: Unit) -> None:
    from matplotlib.patches import Circle

    reach = 1.08 * max(float(np.abs(offsets).max()), float(np.abs(centre).max()) + (radius or 0.0)) * unit.factor or 1.0
    for (i, j), axes in zip(_PLANES, figure.subplots(1, 2), strict=True):
        x, y = centre[i] * unit.factor, centre[j] * unit.factor
        if radius is not None:
            size = radius * unit.factor
            axes.add_patch(Circle((x, y), size, fill=False, color=LIGHT["before"], linewidth=1.3))
        axes.plot(*(offsets[:, (i, j)].T * unit.factor), "o", ms=2.8, mew=0, color=LIGHT["after"], label="one visit")
        axes.plot(x, y, "s", ms=5, mfc="none", mew=1.3, color=LIGHT["ink"], label="barycentre")
        axes.plot(0, 0, "+", ms=9, mew=1.4, color=LIGHT["ink"], label="commanded")
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        axes.set(xlabel=f"{'xyz'[i]}, {unit.name}", ylabel=f"{'xyz'[j]}, {unit.name}")
