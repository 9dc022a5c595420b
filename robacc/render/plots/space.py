"""Parts of charts in three dimensions: the box of the still view, traces of the interactive view."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from robacc.render.plots.columns import Array

_MIN_EXTENT = 1e-3
"""m; the extent of the view if all points coincide."""


def fit_box(axes: Any, points: Array) -> None:
    """Fit the axes of matplotlib to ``points`` ``(N, 3)``, m, with equal scales and their labels."""
    from matplotlib.ticker import MaxNLocator

    centre, size = 0.5 * (points.min(axis=0) + points.max(axis=0)), np.ptp(points, axis=0)
    # Points on a line, in a plane or at one place need a margin too.
    size = np.maximum(size, 0.05 * float(size.max()) or _MIN_EXTENT)
    low, high = centre - 0.5 * size, centre + 0.5 * size
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(size, zoom=0.95)
    axes.set(xlabel="x, m", ylabel="y, m", zlabel="z, m")
    axes.tick_params(labelsize=7.5, pad=-2)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((0, 0, 0, 0))
        axis.set_major_locator(MaxNLocator(4))


def line_trace(name: str, points: Array, colour: str, width: float) -> dict[str, Any]:
    """Return a line for plotly through ``points`` ``(N, 3)``; NaN breaks it."""
    return {
        "type": "scatter3d",
        "mode": "lines",
        "name": name,
        **coordinates(points),
        "line": {"color": colour, "width": width},
        "hoverinfo": "skip",
    }


def coordinates(points: Array) -> dict[str, list[float | None]]:
    """Return coordinates rounded to 0.1 mm, null for breaks between lines."""
    columns = np.round(points, 4).T.tolist()
    return {
        axis: [None if math.isnan(value) else value for value in column]
        for axis, column in zip("xyz", columns, strict=True)
    }


def plain(text: str) -> str:
    """Return the text escaped for plotly, which interprets some tags and entities."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
