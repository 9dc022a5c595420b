"""Maps of predicted or measured errors over the workspace."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.render.plots.chart import Chart, ChartTable, Document
from robacc.render.plots.columns import Array, numbers, vectors
from robacc.render.plots.stage_errors import stages_of
from robacc.render.plots.units import Unit, length_unit

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
        lambda figure: _draw(figure, at, radius, values, unit, quantity),
        _table(radius, at[:, 2], values, unit),
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


def _draw(figure: Figure, at: Array, radius: Array, values: Array, unit: Unit, quantity: str) -> None:
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


def _table(radius: Array, height: Array, values: Array, unit: Unit) -> ChartTable:
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
