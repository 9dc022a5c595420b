"""Charts of an ISO 9283 evaluation: accuracy and repeatability by pose, and the visits of each pose."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.render.plots.chart import Chart, ChartTable, Document
from robacc.render.plots.columns import Array, vectors
from robacc.render.plots.labels import short
from robacc.render.plots.palette import LIGHT
from robacc.render.plots.thinning import thinned, thinning_note
from robacc.render.plots.units import Unit, length_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
