"""Errors in the order of time: a drift, a step or a warm-up shows here first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from robacc.render.plots.chart import ChartTable, Document, Picture
from robacc.render.plots.columns import Array, numbers, place
from robacc.render.plots.palette import LIGHT
from robacc.render.plots.stage_errors import ErrorsByStage, StageErrors, stages_of
from robacc.render.plots.thinning import Rows, shown, thinned
from robacc.render.plots.units import Unit, error_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_POINTS = 700
_ROWS = 60


def course_pictures(document: Document) -> Iterator[Picture]:
    """Over the logged time, else over the lines of the file."""
    found = stages_of(document, "m")
    if found is None:
        return
    timed = found.poses.get("time_s") is not None
    x = numbers(found.poses["time_s"] if timed else found.poses["line"])
    if x.size < 2:
        return
    stages = _told(found)
    sizes = [stage.sizes for stage in stages]
    rows = thinned(_POINTS, x, *sizes)
    unit = error_unit("m", float(max(one.max() for one in sizes)))
    over = "time, s" if timed else "line of the file"
    order = "" if timed else " Lines are the order of the file, which is the order of time only if it was written so."
    worst = int(np.argmax(sizes[-1]))
    names = " and ".join(stage.label for stage in stages)
    yield Picture(
        "time",
        f"Position error over {'time' if timed else 'the lines of the file'}",
        f"Each pose's error ({names}) over {over}. The largest is at {place(found.poses, worst)}, "
        f"{unit.text(float(sizes[-1][worst]))}.{order}{shown(rows.size, x.size)}",
        f"Scatter of position error in {unit.name} over {over}; largest {unit.text(float(sizes[-1][worst]))} at "
        f"{place(found.poses, worst)}",
        lambda figure: _draw(figure, found, x, rows, unit, over),
        _table(found, x, unit, over),
        (4.9, 2.9),
    )


def _table(found: ErrorsByStage, x: Array, unit: Unit, over: str) -> ChartTable:
    stages = _told(found)
    rows = thinned(_ROWS, x, stages[-1].sizes)
    columns = [[unit.text(value) for value in stage.sizes[rows].tolist()] for stage in stages]
    named = [place(found.poses, int(i)) for i in rows]
    return ChartTable(
        ("pose", over, *(stage.label for stage in stages)),
        [list(row) for row in zip(named, (f"{v:g}" for v in x[rows].tolist()), *columns, strict=True)],
        f"{rows.size} of {x.size} poses; all are in the JSON result." if rows.size < x.size else "",
    )


def _draw(figure: Figure, found: ErrorsByStage, x: Array, rows: Rows, unit: Unit, over: str) -> None:
    axes = figure.add_subplot()
    stages = _told(found)
    for stage in stages:
        values = stage.sizes[rows] * unit.factor
        filled = stage.role == "after"
        axes.plot(
            x[rows],
            values,
            "o",
            ms=2.8 if filled else 3.4,
            mew=0 if filled else 0.8,
            mfc=LIGHT["after"] if filled else "none",
            color=LIGHT[stage.role],
            label=stage.label,
        )
    kept = found.used[rows] > 0
    if not kept.all():
        _left_out(axes, found, x, rows[~kept], unit)
    axes.set(xlabel=over, ylabel=f"position error, {unit.name}")
    axes.set_ylim(0, _top(stages, rows[kept] if kept.any() else rows) * unit.factor)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)


def _told(found: ErrorsByStage) -> list[StageErrors]:
    """As delivered is left out, which is larger than the rest by far."""
    return [stage for stage in found.stages if stage.role != "nominal"]


def _top(stages: Sequence[StageErrors], rows: Rows) -> float:
    """Room for every pose that took part."""
    return 1.08 * max(float(stage.sizes[rows].max()) for stage in stages) or 1.0


def _left_out(axes: Axes, found: ErrorsByStage, x: Array, rows: Rows, unit: Unit) -> None:
    """Rows that are no part of the rest, at the upper edge where they are far beyond it."""
    top = _top(_told(found), np.flatnonzero(found.used > 0))
    sizes = found.last.sizes[rows]
    for mark, chosen, label in (("x", sizes <= top, "left out"), ("^", sizes > top, "left out, beyond the picture")):
        if chosen.any():
            y = np.minimum(sizes[chosen], 0.97 * top) * unit.factor
            axes.plot(x[rows[chosen]], y, mark, color=LIGHT["ink"], ms=6, mew=1.2, label=label)
