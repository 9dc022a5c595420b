"""Cumulative distributions of the errors by stage, with the limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from robacc.render.plots.chart import Chart, ChartTable, Document
from robacc.render.plots.columns import Array, numbers
from robacc.render.plots.labels import short
from robacc.render.plots.limits import Limit, limits_of
from robacc.render.plots.palette import LIGHT
from robacc.render.plots.stage_errors import STAGE_MEANINGS, stages_of
from robacc.render.plots.thinning import thinned
from robacc.render.plots.units import Unit, error_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STEPS = 400
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 1.0)
_DASHES = {"nominal": (0, (1, 1.2)), "before": (0, (5, 1.6)), "after": "-"}
_WIDE_RANGE = 12.0
"""Ratio of the largest error to the smallest median from which the scale is logarithmic."""
_MAX_RANGE = 1000.0
"""Range of a logarithmic scale from which its labels at 2 and 5 would overlap."""


def distribution_charts(document: Document) -> Iterator[Chart]:
    """Return the distribution of position errors, and of orientation errors if measured."""
    for unit, name in (("m", "position"), ("rad", "orientation")):
        curves = _curves(document, unit)
        if curves:
            yield _chart(document, name, unit, curves)


Curves = Sequence[tuple[str, str, Array]]
"""Role, label, sizes."""


def _curves(document: Document, unit: str) -> Curves:
    if document["command"] == "predict":
        part = document["position" if unit == "m" else "orientation"]
        if f"pose_rms_{unit}" not in part:
            return ()
        return (
            ("after", "predicted rms by pose", numbers(part[f"pose_rms_{unit}"])),
            ("before", "predicted 95 % radius by pose", numbers(part[f"pose_radius95_{unit}"])),
        )
    errors = stages_of(document, unit)
    if errors is None:
        return ()
    used = errors.used > 0
    return tuple((stage.role, stage.label, stage.sizes[used]) for stage in errors.stages)


def _chart(document: Document, name: str, unit: str, curves: Curves) -> Chart:
    largest = max(float(sizes.max()) for _, _, sizes in curves)
    shown_unit = error_unit(unit, largest)
    limits = limits_of(document, unit)
    kind = "distribution" if name == "position" else "distribution-orientation"
    predicted = document["command"] == "predict"
    title = f"Distribution of the {'predicted ' if predicted else ''}{name} error"
    return Chart(
        kind,
        title,
        _caption(document, name, curves, limits, shown_unit),
        f"{title}: share of poses, 0 to 100 %, over the size of the error in {shown_unit.name}. "
        + "; ".join(f"{label}: median {shown_unit.text(float(np.median(sizes)))}" for _, label, sizes in curves),
        lambda figure: _draw(figure, name, curves, limits, shown_unit),
        _table(curves, shown_unit),
    )


def _caption(document: Document, name: str, curves: Curves, limits: Sequence[Limit], unit: Unit) -> str:
    errors = stages_of(document, "m")
    pose_set = "held-out poses" if errors is not None and errors.held_out else "all poses"
    article = "an" if name[0] in "aeiou" else "a"
    text = f"Share of {pose_set} with {article} {name} error up to the given size. Curves further left are better. "
    text += _meaning(document)
    medians = [f"{unit.text(float(np.median(sizes)))} ({label})" for _, label, sizes in curves]
    text += f"Half of the poses are within {', '.join(medians)}."
    if limits:
        text += (
            f" Vertical lines are limits: {', '.join(f'{limit.label} {unit.text(limit.value)}' for limit in limits)}."
        )
    return text


def _meaning(document: Document) -> str:
    meaning = STAGE_MEANINGS.get(document["command"])
    return "" if meaning is None else f"{meaning[0].upper()}{meaning[1:]}. "


def _table(curves: Curves, unit: Unit) -> ChartTable:
    rows = []
    for share in _QUANTILES:
        values = [unit.text(float(np.quantile(sizes, share))) for _, _, sizes in curves]
        rows.append([f"{100 * share:.0f} %", *values])
    return ChartTable(("share of poses", *(label for _, label, _ in curves)), rows)


def _draw(figure: Figure, name: str, curves: Curves, limits: Sequence[Limit], unit: Unit) -> None:
    axes = figure.add_subplot()
    for role, label, sizes in curves:
        ordered = np.sort(sizes) * unit.factor
        share = np.arange(1, ordered.size + 1) / ordered.size
        pick = thinned(_STEPS, ordered)
        axes.step(
            np.concatenate((ordered[pick][:1], ordered[pick])),
            100 * np.concatenate(([0.0], share[pick])),
            where="post",
            color=LIGHT[role],
            linestyle=_DASHES[role],
            label=label,
        )
    _scale(axes, curves, unit)
    left, right = axes.get_xlim()
    for limit in limits:
        value = limit.value * unit.factor
        if left < value < right:
            axes.axvline(value, color=LIGHT["limit"], linewidth=0.9, linestyle=(0, (3, 2)))
            axes.annotate(
                short(limit.short_label, 16),
                (value, 1.0),
                (0, 3),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                ha="center",
                va="bottom",
                fontsize=8,
                annotation_clip=False,
            )
    axes.set(ylim=(0, 101), ylabel="share of poses, %", xlabel=f"{name} error, {unit.name}")
    figure.legend(loc="outside upper center", ncols=len(curves))


def _scale(axes: Axes, curves: Curves, unit: Unit) -> None:
    from matplotlib.ticker import LogLocator

    top = max(float(sizes.max()) for _, _, sizes in curves) * unit.factor
    low = min(float(np.median(sizes)) for _, _, sizes in curves) * unit.factor
    if low > 0 and top / low > _WIDE_RANGE:
        smallest = min(float(np.quantile(sizes, 0.02)) for _, _, sizes in curves) * unit.factor
        axes.set_xscale("log")
        ends = max(smallest, low / 30) / 1.3, top * 1.3
        subs = (1.0,) if ends[1] / ends[0] > _MAX_RANGE else (1.0, 2.0, 5.0)
        axes.xaxis.set_major_locator(LogLocator(subs=subs))
        # The style does not parse formulas, so labels are plain numbers.
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter("")
        axes.set_xlim(*ends)
    else:
        axes.set_xlim(0, top * 1.04 or 1.0)
