"""Operating curves of a gate: the probability to pass over the true value."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from robacc.render.plots.chart import Chart, ChartTable, Document
from robacc.render.plots.columns import Array
from robacc.render.plots.labels import short
from robacc.render.plots.palette import LIGHT
from robacc.render.plots.units import DEGREE, Unit, length_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ROWS = 25
_SHARE = Unit("%", 100.0)


def operating_curve_charts(document: Document) -> Iterator[Chart]:
    """Return the operating curve of each criterion that has one."""
    for criterion in (document.get("gate") or {}).get("criteria", ()):
        if len(criterion["operating_curve"]) > 1:
            yield _chart(criterion)


def _unit(criterion: Mapping[str, Any]) -> Unit:
    """Return the unit of the value and its limit."""
    if criterion["unit"] == "m":
        return length_unit(float(criterion["limit"]), float(criterion["value"]))
    return DEGREE if criterion["unit"] == "rad" else Unit("", 1.0)


def _chart(criterion: Mapping[str, Any]) -> Chart:
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
        lambda figure: _draw(figure, marks, curve, abscissa),
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


def _draw(figure: Figure, marks: _Marks, curve: Array, unit: Unit) -> None:
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
