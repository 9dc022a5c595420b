"""Errors over time or row order, which show a drift, a step change or a warm-up."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from robacc.render.plots.chart import Chart, ChartTable, Document
from robacc.render.plots.columns import Array, numbers, place
from robacc.render.plots.palette import LIGHT
from robacc.render.plots.stage_errors import ErrorsByStage, StageErrors, stages_of
from robacc.render.plots.thinning import Rows, thinned, thinning_note
from robacc.render.plots.units import Unit, error_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_POINTS = 700
_ROWS = 60


def error_over_time_charts(document: Document) -> Iterator[Chart]:
    """Return the chart over the logged time, or over the lines of the file without a time."""
    errors = stages_of(document, "m")
    if errors is None:
        return
    timed = errors.poses.get("time_s") is not None
    x = numbers(errors.poses["time_s"] if timed else errors.poses["line"])
    if x.size < 2:
        return
    stages = _shown_stages(errors)
    sizes = [stage.sizes for stage in stages]
    rows = thinned(_POINTS, x, *sizes)
    unit = error_unit("m", float(max(stage_sizes.max() for stage_sizes in sizes)))
    over = "time, s" if timed else "line of the file"
    order = "" if timed else " The order of the lines is the order of time only if the file was written so."
    worst = int(np.argmax(sizes[-1]))
    names = " and ".join(stage.label for stage in stages)
    yield Chart(
        "time",
        f"Position error over {'time' if timed else 'the lines of the file'}",
        f"Each pose's error ({names}) over {over}. The largest is at {place(errors.poses, worst)}, "
        f"{unit.text(float(sizes[-1][worst]))}.{order}{thinning_note(rows.size, x.size)}",
        f"Scatter of position error in {unit.name} over {over}; largest {unit.text(float(sizes[-1][worst]))} at "
        f"{place(errors.poses, worst)}",
        lambda figure: _draw(figure, errors, x, rows, unit, over),
        _table(errors, x, unit, over),
        (4.9, 2.9),
    )


def _table(errors: ErrorsByStage, x: Array, unit: Unit, over: str) -> ChartTable:
    stages = _shown_stages(errors)
    rows = thinned(_ROWS, x, stages[-1].sizes)
    columns = [[unit.text(value) for value in stage.sizes[rows].tolist()] for stage in stages]
    names = [place(errors.poses, int(i)) for i in rows]
    return ChartTable(
        ("pose", over, *(stage.label for stage in stages)),
        [list(row) for row in zip(names, (f"{v:g}" for v in x[rows].tolist()), *columns, strict=True)],
        f"{rows.size} of {x.size} poses; the JSON result has all of them." if rows.size < x.size else "",
    )


def _draw(figure: Figure, errors: ErrorsByStage, x: Array, rows: Rows, unit: Unit, over: str) -> None:
    axes = figure.add_subplot()
    stages = _shown_stages(errors)
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
    used = errors.used[rows] > 0
    if not used.all():
        _draw_outliers(axes, errors, x, rows[~used], unit)
    axes.set(xlabel=over, ylabel=f"position error, {unit.name}")
    axes.set_ylim(0, _top(stages, rows[used] if used.any() else rows) * unit.factor)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)


def _shown_stages(errors: ErrorsByStage) -> list[StageErrors]:
    """Return the stages without the nominal model, whose errors are much larger."""
    return [stage for stage in errors.stages if stage.role != "nominal"]


def _top(stages: Sequence[StageErrors], rows: Rows) -> float:
    """Return the upper limit of the axis, which includes all inliers."""
    return 1.08 * max(float(stage.sizes[rows].max()) for stage in stages) or 1.0


def _draw_outliers(axes: Axes, errors: ErrorsByStage, x: Array, rows: Rows, unit: Unit) -> None:
    """Draw the outliers, at the upper edge if they are off scale."""
    top = _top(_shown_stages(errors), np.flatnonzero(errors.used > 0))
    sizes = errors.last.sizes[rows]
    for mark, chosen, label in (("x", sizes <= top, "outlier"), ("^", sizes > top, "outlier, off scale")):
        if chosen.any():
            y = np.minimum(sizes[chosen], 0.97 * top) * unit.factor
            axes.plot(x[rows[chosen]], y, mark, color=LIGHT["ink"], ms=6, mew=1.2, label=label)
