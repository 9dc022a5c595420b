"""Several results by one statistic, each with its interval."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.render.plots.chart import ChartTable, Document, Picture
from robacc.render.plots.labels import short
from robacc.render.plots.palette import LIGHT
from robacc.render.plots.units import Unit, error_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST = 30


def comparison_pictures(document: Document) -> Iterator[Picture]:
    """The statistics of the results themselves that have intervals (not of their stages), the one that ranks first."""
    if document["command"] != "compare":
        return
    by = (document.get("ranking") or {}).get("by")
    statistics = [
        one
        for one in document["statistics"]
        if one["unit"] in ("m", "rad") and (one["key"] == by or one["key"].count(".") == 1)
    ]
    for one in sorted(statistics, key=lambda one: one["key"] != by):
        values = [value for value in one["values"] if value["value"] is not None][:_MOST]
        if len(values) > 1 and any(value["lower"] is not None for value in values):
            yield _picture(one, values, document["baseline"], one["key"] == by)


def _picture(one: Mapping[str, Any], values: Sequence[Mapping[str, Any]], baseline: str | None, ranks: bool) -> Picture:
    unit = error_unit(one["unit"], max(value["value"] for value in values))
    best = min(values, key=lambda value: float(value["value"]))
    confidence = next((value["confidence"] for value in values if value["confidence"] is not None), 0.95)
    first = "The results are ranked by it. " if ranks else ""
    held = f" The hollow mark is the baseline, {baseline}." if baseline is not None else ""
    return Picture(
        "comparison",
        f"{one['key']} of each result",
        f"{first}Each result's {one['key']} with its {100 * confidence:g} % interval; the smallest is {best['name']}, "
        f"{unit.text(best['value'])}.{held} Whether two differ is in the tables: intervals that overlap may yet.",
        f"Points with intervals in {unit.name}: "
        + "; ".join(f"{value['name']} {unit.text(value['value'])}" for value in values),
        lambda figure: _draw(figure, one["key"], values, baseline, unit),
        ChartTable(
            ("result", "value", "from", "to"),
            [[v["name"], unit.text(v["value"]), unit.text(v["lower"]), unit.text(v["upper"])] for v in values],
        ),
        (4.9, 1.3 + 0.34 * len(values)),
    )


def _draw(figure: Figure, key: str, values: Sequence[Mapping[str, Any]], baseline: str | None, unit: Unit) -> None:
    axes = figure.add_subplot()
    for row, value in enumerate(values):
        x = value["value"] * unit.factor
        ends = [x if end is None else end * unit.factor for end in (value["lower"], value["upper"])]
        reach = np.maximum([[x - ends[0]], [ends[1] - x]], 0.0)
        held = value["name"] == baseline
        looks: dict[str, Any] = {
            "mfc": "none" if held else LIGHT["after"],
            "color": LIGHT["before" if held else "after"],
        }
        axes.errorbar([x], [row], xerr=reach, fmt="o", ms=6, mew=1.4, capsize=3, linewidth=1.4, **looks)
    axes.set_yticks(range(len(values)), [short(str(value["name"])) for value in values])
    axes.set_ylim(len(values) - 0.5, -0.5)
    axes.set_xlim(left=0)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(f"{key}, {unit.name}")
