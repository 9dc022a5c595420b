"""Charts over the workspace: maps of errors and grades, magnified error vectors, targets of a correction."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.render.plots.canvas import (
    LIGHT,
    Array,
    Chart,
    ChartTable,
    Document,
    Rows,
    Scene3D,
    Unit,
    coordinates,
    error_unit,
    fit_box,
    length_unit,
    line_trace,
    numbers,
    place,
    plain,
    thinned,
    thinning_note,
    vectors,
)
from robacc.render.plots.errors import StageErrors, stages_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_MIN_POSES = 80
"""Smallest number of poses for a map without too many empty cells."""
_STEPS = 7


def workspace_charts(document: Document) -> Iterator[Chart]:
    """Return the map in side view (distance from the vertical axis, height) and top view."""
    mapped = _values(document)
    if mapped is None:
        return
    at, values, label = mapped
    unit = length_unit(float(values.max()))
    quantity = label.rstrip(",")
    worst = int(np.argmax(values))
    radius = np.hypot(at[:, 0], at[:, 1])
    yield Chart(
        "workspace",
        f"{label} over the workspace",
        f"{label} by target position: root mean square over the poses in each cell. Light cells have larger errors, "
        "cells without poses are empty. Left: side view (distance from the frame's vertical axis and height); right: "
        f"top view. The largest error is {unit.text(float(values[worst]))} at x {at[worst, 0]:.2f}, "
        f"y {at[worst, 1]:.2f}, z {at[worst, 2]:.2f} m.",
        f"Two maps of {quantity.lower()} in {unit.name} over the workspace in m; "
        f"from {unit.text(float(values.min()))} to {unit.text(float(values.max()))} over {values.size} poses",
        lambda figure: _draw_map(figure, at, radius, values, unit, quantity),
        _map_table(radius, at[:, 2], values, unit),
        (4.9, 3.2),
    )


def _values(document: Document) -> tuple[Array, Array, str] | None:
    poses = document.get("poses")
    if poses is None:
        return None
    if document["command"] == "predict":
        at, values, label = (
            vectors(poses["commanded_m"]),
            numbers(document["position"]["pose_rms_m"]),
            "Predicted error",
        )
    else:
        errors = stages_of(document, "m")
        if errors is None:
            return None
        used = errors.used > 0
        at, values, label = vectors(errors.poses["commanded_m"])[used], errors.last.sizes[used], "Position error"
        if len(errors.stages) > 1:
            label = f"Position error, {errors.last.label},"
    return (at, values, label) if values.size >= _MIN_POSES else None


def _draw_map(figure: Figure, at: Array, radius: Array, values: Array, unit: Unit, quantity: str) -> None:
    from matplotlib.colors import BoundaryNorm
    from matplotlib.ticker import MaxNLocator

    levels = MaxNLocator(_STEPS).tick_values(float(values.min()) * unit.factor, float(values.max()) * unit.factor)
    norm = BoundaryNorm(levels, 256)
    looks: dict[str, Any] = {
        "C": values * unit.factor,
        "reduce_C_function": _rms,
        "cmap": "cividis",
        "norm": norm,
        "linewidths": 0.2,
    }
    side, above = figure.subplots(1, 2)
    side.hexbin(radius, at[:, 2], gridsize=_cells(radius, at[:, 2]), **looks)
    hexagons = above.hexbin(at[:, 0], at[:, 1], gridsize=_cells(at[:, 0], at[:, 1]), **looks)
    side.set(xlabel="distance from axis, m", ylabel="height z, m", title="from the side")
    above.set(xlabel="x, m", ylabel="y, m", title="from above")
    for axes in (side, above):
        axes.grid(visible=False)
        axes.set_aspect("equal", adjustable="datalim")
        axes.locator_params(nbins=4)
    figure.colorbar(
        hexagons, ax=(side, above), location="bottom", shrink=0.8, aspect=30, label=f"{quantity}, {unit.name}"
    )


def _cells(x: Array, y: Array) -> tuple[int, int]:
    """Return the numbers of cells along both axes, for square cells with a few poses each."""
    width, height = (max(float(np.ptp(coordinate)), 1e-3) for coordinate in (x, y))
    across = float(np.clip(np.sqrt(x.size * width / height) * 0.55, 3, 15))
    return max(2, round(across)), max(2, round(across * height / width / np.sqrt(3)))


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _map_table(radius: Array, height: Array, values: Array, unit: Unit) -> ChartTable:
    """Return the errors by steps of distance and height."""
    rows = []
    r_edges, z_edges = (np.linspace(coordinate.min(), coordinate.max(), 5) for coordinate in (radius, height))
    for i in range(4):
        for j in range(4):
            inside = _within(radius, r_edges, i) & _within(height, z_edges, j)
            if inside.any():
                rows.append(
                    [
                        f"{r_edges[i]:.2f} to {r_edges[i + 1]:.2f} m",
                        f"{z_edges[j]:.2f} to {z_edges[j + 1]:.2f} m",
                        str(int(inside.sum())),
                        unit.text(_rms(values[inside])),
                        unit.text(float(values[inside].max())),
                    ]
                )
    return ChartTable(("distance from axis", "height", "poses", "rms", "largest"), rows)


def _within(values: Array, edges: Array, i: int) -> Any:
    last = i == len(edges) - 2
    return (values >= edges[i]) & ((values <= edges[i + 1]) if last else (values < edges[i + 1]))


# The poses in space with magnified error vectors, as a still chart and an interactive view.

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
        lambda figure: _draw_space(
            figure, at[still], [(s, s.errors[still]) for s in stages], scale, _outline(document)
        ),
        _space_table(poses, stages, unit, at),
        (4.9, 4.2),
        _space_scene(document, poses, at, stages, scale, turned, unit),
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


def _draw_space(
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


def _space_scene(
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


def _space_table(poses: Mapping[str, Any], stages: Sequence[StageErrors], unit: Unit, at: Array) -> ChartTable:
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


# Map of the grade that a calibrated arm holds in each part of its workspace, in space.

_LOOKS = (("after", "s", "square"), ("third", "o", "circle"), ("fourth", "^", "diamond"), ("before", "D", "cross"))
"""Colour, mark of the chart and mark of the view, from the best grade; the last stands for all wider grades too."""
_DRAWN = 1500


def warranty_charts(document: Document) -> Iterator[Chart]:
    """Return the map of a prediction from the fit of a model."""
    voxels = document.get("warranty_map")
    if document["command"] != "predict" or not voxels or not voxels["grade"]:
        return
    at, grades, bound = vectors(voxels["centre_m"]), list(voxels["grade"]), numbers(voxels["bound95_m"])
    order = [*document["grade"]["share_of_poses_meeting"]]
    present = [name for name in order if name in grades]
    present += sorted(set(grades) - set(present))
    counts = {name: grades.count(name) for name in present}
    shares = ", ".join(f"{name} in {count}" for name, count in counts.items())
    unit = length_unit(float(bound.max()))
    worst = int(np.argmax(bound))
    rows = thinned(_DRAWN, bound)
    edge = f"{1e3 * voxels['voxel_m']:g} mm"
    yield Chart(
        "warranty",
        "Grade over the workspace",
        f"Grade that the 95 % bound of every configuration meets, by voxel of {edge}: {shares} of {len(at)} voxels. "
        f"The largest bound is {unit.text(float(bound[worst]))} at x {at[worst, 0]:.2f}, y {at[worst, 1]:.2f}, "
        f"z {at[worst, 2]:.2f} m. Voxels without a configuration are empty."
        f"{thinning_note(rows.size, len(at))}",
        f"Voxels of {edge} in x, y, z in m of the measuring frame, marked by grade: {shares}",
        lambda figure: _draw_warranty(figure, at[rows], [grades[i] for i in rows], present),
        _warranty_table(at, voxels, present, unit.text),
        (4.9, 4.2),
        _warranty_scene(at[rows], [grades[i] for i in rows], bound[rows], present, unit.text),
    )


def _look(number: int) -> tuple[str, str, str]:
    return _LOOKS[min(number, len(_LOOKS) - 1)]


def _draw_warranty(figure: Figure, at: Array, grades: Sequence[str], present: Sequence[str]) -> None:
    axes: Any = figure.add_subplot(projection="3d")
    named = np.array(grades)
    for number, name in enumerate(present):
        colour, mark, _ = _look(number)
        axes.plot(*at[named == name].T, mark, ms=3.2, mew=0, color=LIGHT[colour], label=f"grade {name}", alpha=0.75)
    fit_box(axes, at)
    figure.legend(loc="outside upper center", ncols=len(present))


def _warranty_scene(at: Array, grades: Sequence[str], bound: Array, present: Sequence[str], text: Any) -> Scene3D:
    named = np.array(grades)
    traces = []
    for number, name in enumerate(present):
        colour, _, symbol = _look(number)
        index = np.flatnonzero(named == name)
        columns = np.round(at[index], 4).T.tolist()
        traces.append(
            {
                "type": "scatter3d",
                "mode": "markers",
                "name": f"grade {name}",
                **dict(zip("xyz", columns, strict=True)),
                "marker": {"size": 4, "symbol": symbol, "color": f"role:{colour}"},
                "text": [f"95 % bound {text(float(bound[i]))}" for i in index],
                "hovertemplate": "%{text}<extra></extra>",
            }
        )
    return Scene3D(tuple(traces), ("x, m", "y, m", "z, m"), "Drag to rotate, scroll to zoom, point at a voxel.")


def _warranty_table(at: Array, voxels: Mapping[str, Any], present: Sequence[str], text: Any) -> ChartTable:
    """Return the voxels with the largest bounds."""
    bound = numbers(voxels["bound95_m"])
    order = np.argsort(-bound, kind="stable")[:_ROWS]
    rows = [
        [voxels["grade"][i], *(f"{value:.3f}" for value in at[i]), str(voxels["configurations"][i]), text(bound[i])]
        for i in map(int, order)
    ]
    header = ("grade", "x, m", "y, m", "z, m", "configurations", "95 % bound")
    note = f"The {len(order)} voxels with the largest bounds of {len(at)}; the JSON result has all of them."
    return ChartTable(header, rows, note if len(order) < len(at) else "Sorted by bound, the largest first.")


# The targets of a correction in space, with the errors of the nominal and of the corrected commands.


def correction_charts(document: Document) -> Iterator[Chart]:
    """Return the chart of a correction with its targets in the frame of the targets."""
    if document["command"] != "correct" or not document["targets"]["line"]:
        return
    targets: Mapping[str, Any] = document["targets"]
    stages = (
        StageErrors("before", "error of the nominal command", vectors(targets["error_before_m"])),
        StageErrors("after", "error of the corrected command", vectors(targets["error_after_m"])),
    )
    corrected = np.array(targets["corrected"], dtype=bool)
    count = f"{np.count_nonzero(corrected)} of {corrected.size} targets are corrected"
    yield errors_in_space(
        document,
        targets,
        vectors(targets["wanted_m"]),
        stages,
        "corrections",
        "Corrections in space",
        f"Wanted positions and the error that the model predicts there; {count}, the others keep their error",
    )
