"""Charts of a statistic of several results with its intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.render.plots.chart import Chart, ChartTable, Document
from robacc.render.plots.labels import short
from robacc.render.plots.palette import LIGHT
from robacc.render.plots.units import Unit, error_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
            yield _chart(statistic, values, document["baseline"], statistic["key"] == by)


def _chart(
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
        lambda figure: _draw(figure, statistic["key"], values, baseline, unit, signed),
        ChartTable(
            ("result", "value", "from", "to"),
            [[v["name"], unit.text(v["value"]), unit.text(v["lower"]), unit.text(v["upper"])] for v in values],
        ),
        (4.9, 1.3 + 0.34 * len(values)),
    )


def _draw(
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
