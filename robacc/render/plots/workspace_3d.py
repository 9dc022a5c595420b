"""The poses in space with magnified error vectors, as a still chart and an interactive view."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.render.plots.chart import Chart, ChartTable, Document, Scene3D
from robacc.render.plots.columns import Array, place, vectors
from robacc.render.plots.palette import LIGHT
from robacc.render.plots.space import coordinates, fit_box, line_trace, plain
from robacc.render.plots.stage_errors import StageErrors, stages_of
from robacc.render.plots.thinning import Rows, thinned, thinning_note
from robacc.render.plots.units import Unit, error_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STILL = 220
_TURNED = 900
_ROWS = 60
_VECTOR = 0.12
"""Length of a large error vector in the chart, as a share of the poses' extent."""


def workspace_3d_charts(document: Document) -> Iterator[Chart]:
    """Return the chart of a result with poses and errors in the measuring frame."""
    vectors_of_poses = _vectors(document)
    if vectors_of_poses is None:
        return
    poses, stages = vectors_of_poses
    at = vectors(poses["commanded_m"])
    if len(at) == 0:
        return
    names = " and ".join(f"{stage.label}" for stage in stages)
    start = f"Commanded target positions and their errors ({names})"
    yield errors_in_space(document, poses, at, stages, "poses", "Pose errors in space", start)


def errors_in_space(
    document: Document,
    poses: Mapping[str, Any],
    at: Array,
    stages: Sequence[StageErrors],
    kind: str,
    title: str,
    caption: str,
) -> Chart:
    """Return a chart of points ``at`` ``(N, 3)`` with the errors of each stage, the last the smallest.

    Args:
        document: The result, whose robot is drawn at a typical pose.
        poses: Columns that name the points.
        at: Points, m.
        stages: Errors of the same points; the first decides the magnification.
        kind: Kind of the chart.
        title: Its title.
        caption: First sentence of its caption, without its full stop.
    """
    sizes = [stage.sizes for stage in stages]
    unit = error_unit("m", float(max(stage_sizes.max() for stage_sizes in sizes)))
    scale = _magnification(at, sizes[0])
    still = thinned(_STILL, *sizes)
    turned = thinned(_TURNED, *sizes)
    worst = int(np.argmax(sizes[-1]))
    arm = " The grey line is the arm at a typical pose." if _outline(document) is not None else ""
    return Chart(
        kind,
        title,
        f"{caption}, magnified {scale:,.0f} times.{arm} The largest error is at "
        f"{place(poses, worst)}: {unit.text(float(sizes[-1][worst]))}.{thinning_note(still.size, len(at))}",
        f"Points of {len(at)} poses in x, y, z in m of the measuring frame with error vectors {scale:,.0f} times "
        f"magnified; largest {unit.text(float(sizes[-1][worst]))}",
        lambda figure: _draw(figure, at[still], [(s, s.errors[still]) for s in stages], scale, _outline(document)),
        _table(poses, stages, unit, at),
        (4.9, 4.2),
        _scene(document, poses, at, stages, scale, turned, unit),
    )


def _vectors(document: Document) -> tuple[Mapping[str, Any], Sequence[StageErrors]] | None:
    """Return the poses and their errors in the measuring frame by stage."""
    by_stage = stages_of(document, "m")
    if by_stage is None:
        return None
    if "position_by_frame" in document:
        errors = vectors(document["position_by_frame"]["base"]["errors_m"])
        return by_stage.poses, (StageErrors("after", "measured", errors),)
    return by_stage.poses, [stage for stage in by_stage.stages if stage.role != "nominal"]


def _magnification(at: Array, sizes: Array) -> float:
    """Return a round factor that makes a large error visible relative to the poses' extent."""
    extent = float(np.ptp(at, axis=0).max()) or 1.0
    large = float(np.quantile(sizes, 0.95))
    if large <= 0:
        return 1.0
    wanted = _VECTOR * extent / large
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(1.0, power * max(step for step in (1, 2, 5) if step * power <= wanted))


def _outline(document: Document) -> Array | None:
    outline = (document.get("robot") or {}).get("outline")
    return None if outline is None else vectors(outline["line_m"])


def _draw(
    figure: Figure, at: Array, stages: Sequence[tuple[StageErrors, Array]], scale: float, outline: Array | None
) -> None:
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    axes: Any = figure.add_subplot(projection="3d")
    if outline is not None:
        axes.plot(*outline.T, "-o", color=LIGHT["nominal"], linewidth=2.2, ms=3.4, label="arm, at one pose", alpha=0.8)
    axes.plot(*at.T, "o", ms=1.7, mew=0, color=LIGHT["ink"], label="commanded")
    for stage, errors in stages:
        ends = np.stack((at, at + scale * errors), axis=1)
        axes.add_collection3d(Line3DCollection(ends, colors=LIGHT[stage.role], linewidths=0.9, label=stage.label))
    fit_box(axes, at if outline is None else np.vstack((at, outline)))
    figure.legend(loc="outside upper center", ncols=2 + len(stages))


def _scene(
    document: Document,
    poses: Mapping[str, Any],
    at: Array,
    stages: Sequence[StageErrors],
    scale: float,
    rows: Rows,
    unit: Unit,
) -> Scene3D:
    traces: list[dict[str, Any]] = []
    outline = _outline(document)
    if outline is not None:
        traces.append(
            {
                **line_trace("arm, at one pose", outline, "role:nominal", 7),
                "mode": "lines+markers",
                "marker": {"size": 4, "color": "role:nominal"},
            }
        )
    sizes = {stage.role: stage.sizes for stage in stages}
    texts = [
        "<br>".join(
            [plain(place(poses, int(i))), *(f"{s.label}: {unit.text(float(sizes[s.role][i]))}" for s in stages)]
        )
        for i in rows
    ]
    traces.append(
        {
            "type": "scatter3d",
            "mode": "markers",
            "name": "commanded",
            **coordinates(at[rows]),
            "marker": {"size": 2.4, "color": "role:ink"},
            "text": texts,
            "hovertemplate": "%{text}<extra></extra>",
        }
    )
    for stage in stages:
        ends = at[rows] + scale * stage.errors[rows]
        gaps = np.full_like(ends, np.nan)
        traces.append(
            line_trace(stage.label, np.stack((at[rows], ends, gaps), axis=1).reshape(-1, 3), f"role:{stage.role}", 3)
        )
    note = f"Drag to rotate, scroll to zoom, point at a pose to see its row.{thinning_note(rows.size, len(at))}"
    return Scene3D(tuple(traces), ("x, m", "y, m", "z, m"), note)


def _table(poses: Mapping[str, Any], stages: Sequence[StageErrors], unit: Unit, at: Array) -> ChartTable:
    last = stages[-1]
    order = np.argsort(-last.sizes, kind="stable")[:_ROWS]
    rows = []
    for i in order:
        vector = [unit.text(float(value)) for value in last.errors[i]]
        sizes = [unit.text(float(stage.sizes[i])) for stage in stages]
        rows.append([place(poses, int(i)), *(f"{value:.3f}" for value in at[i]), *vector, *sizes])
    header = ("pose", "x, m", "y, m", "z, m", "error x", "error y", "error z", *(stage.label for stage in stages))
    note = f"The {len(order)} poses with the largest errors of {len(at)}; the JSON result has all of them."
    return ChartTable(header, rows, note if len(order) < len(at) else "Sorted by error, the largest first.")
