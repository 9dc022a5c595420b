"""Charts of the errors and of the ellipsoids of their covariance, in the tool frame and in the measuring frame."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.render.plots.chart import Chart, ChartTable, Document, Scene3D
from robacc.render.plots.columns import Array, numbers, vectors
from robacc.render.plots.palette import LIGHT
from robacc.render.plots.thinning import thinned, thinning_note
from robacc.render.plots.units import Unit, length_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHARES = ((0.5, 1.538172), (0.95, 2.795483))
"""Shares of a Gaussian, and the square roots of the chi-square quantiles of three degrees of freedom."""
_POINTS = 500
_FRAMES = {
    "tool": ("in the tool frame", "errors fixed to the tool keep their direction in this frame"),
    "base": ("in the measuring frame", "errors of the base or the instrument keep their direction in this frame"),
}
_PLANES = ((0, 1), (0, 2), (1, 2))


def ellipsoid_charts(document: Document) -> Iterator[Chart]:
    """Return a chart for each frame; for a prediction, the mean covariance in the tool frame."""
    for frame, part in (document.get("position_by_frame") or {}).items():
        yield _chart(frame, part, vectors(part["errors_m"]), numbers(part["mean_m"]), "centred_covariance_m2")
    if document["command"] == "predict":
        yield _chart("tool", document["position"], np.zeros((0, 3)), np.zeros(3), "mean_covariance_m2")


def _chart(frame: str, part: Mapping[str, Any], errors: Array, mean: Array, key: str) -> Chart:
    covariance = vectors(part[key])
    sd = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance)[::-1], 0.0))
    reach = float(max(np.abs(errors).max(initial=0.0), SHARES[1][1] * sd[0]))
    unit = length_unit(reach)
    where, meaning = _FRAMES[frame]
    rows = thinned(_POINTS, *errors.T) if len(errors) else np.zeros(0, dtype=np.int64)
    subject = "Predicted errors" if key.startswith("mean") else "Errors"
    cloud = "each pose's error as a point" if len(errors) else "the mean covariance over the poses"
    axes = ", ".join(unit.text(float(value)) for value in sd)
    return Chart(
        f"ellipsoids-{frame}",
        f"{subject} {where}",
        f"{subject} {where} in three projections: {cloud}, with the ellipsoids that contain 50 % and 95 % of a "
        f"Gaussian with this covariance ({meaning}). Standard deviations along the three axes of the ellipsoid: {axes}."
        f"{thinning_note(rows.size, len(errors))}",
        f"Three projections of the error cloud {where} in {unit.name} with 50 and 95 % ellipses; standard deviations "
        f"along the axes {axes}",
        lambda figure: _draw(figure, errors[rows], mean, covariance, unit),
        _table(part, key, unit),
        (4.9, 4.6),
        _scene(errors[rows], mean, covariance, unit),
    )


def _table(part: Mapping[str, Any], key: str, unit: Unit) -> ChartTable:
    square = unit.factor**2
    rows = []
    for name in dict.fromkeys(("covariance_m2", key)):
        if name in part:
            label = {"covariance_m2": "about zero", "centred_covariance_m2": "about the mean"}.get(name, "mean")
            matrix = vectors(part[name]) * square if np.ndim(part[name]) == 2 else None
            if matrix is not None:
                rows += [
                    [f"{label}, {axis}", *(f"{v:.3g}" for v in row)] for axis, row in zip("xyz", matrix, strict=True)
                ]
    if "mean_m" in part:
        rows.append(["mean vector", *(unit.text(value) for value in part["mean_m"])])
    return ChartTable((f"covariance, {unit.name}²", "x", "y", "z"), rows)


def _draw(figure: Figure, errors: Array, mean: Array, covariance: Array, unit: Unit) -> None:
    grid = figure.subplots(2, 2)
    reach = SHARES[1][1] * math.sqrt(float(np.diag(covariance).max())) + float(np.abs(mean).max())
    reach = 1.08 * max(reach, float(np.abs(errors).max(initial=0.0))) * unit.factor or 1.0
    for (i, j), axes in zip(_PLANES, (grid[0, 0], grid[1, 0], grid[1, 1]), strict=True):
        axes.plot(*(errors[:, (i, j)].T * unit.factor), "o", ms=2.2, mew=0, color=LIGHT["nominal"], alpha=0.75)
        for (share, radius), style in zip(SHARES, ("-", (0, (5, 1.5))), strict=True):
            role = "after" if share == 0.5 else "before"
            _ellipse(axes, mean[[i, j]], covariance[np.ix_((i, j), (i, j))], radius, unit, role, style)
        axes.plot(*(mean[[i, j]] * unit.factor), "+", ms=7, mew=1.3, color=LIGHT["ink"])
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        axes.set(xlabel=f"{'xyz'[i]}, {unit.name}", ylabel=f"{'xyz'[j]}, {unit.name}")
    _legend(grid[0, 1], bool(len(errors)))


def _ellipse(axes: Axes, mean: Array, covariance: Array, radius: float, unit: Unit, role: str, style: Any) -> None:
    """Draw the projection of the ellipsoid along the third axis."""
    from matplotlib.patches import Ellipse

    values, directions = np.linalg.eigh(covariance)
    width, height = 2 * radius * np.sqrt(np.maximum(values, 0.0)) * unit.factor
    angle = math.degrees(math.atan2(directions[1, 0], directions[0, 0]))
    centre = (float(mean[0]) * unit.factor, float(mean[1]) * unit.factor)
    patch = Ellipse(centre, width, height, angle=angle, fill=False, edgecolor=LIGHT[role], linewidth=1.5)
    patch.set_linestyle(style)
    axes.add_patch(patch)


def _legend(axes: Axes, with_points: bool) -> None:
    from matplotlib.lines import Line2D

    axes.set_axis_off()
    marks = [
        Line2D([], [], color=LIGHT["after"], label="contains 50 %"),
        Line2D([], [], color=LIGHT["before"], linestyle=(0, (5, 1.5)), label="contains 95 %"),
        Line2D([], [], color=LIGHT["ink"], marker="+", linestyle="", ms=7, mew=1.3, label="mean"),
    ]
    if with_points:
        marks.insert(0, Line2D([], [], color=LIGHT["nominal"], marker="o", linestyle="", ms=3, label="one pose"))
    axes.legend(handles=marks, loc="center")


def _scene(errors: Array, mean: Array, covariance: Array, unit: Unit) -> Scene3D:
    values, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(np.maximum(values, 0.0))
    traces: list[dict[str, Any]] = []
    if len(errors):
        cloud = {"size": 2.6, "color": "role:nominal"}
        traces.append(_trace("one pose", errors * unit.factor, {"mode": "markers", "marker": cloud}))
    for share, radius in SHARES:
        role = "after" if share == 0.5 else "before"
        wire = (mean + radius * _wires() @ root.T) * unit.factor
        line = {"mode": "lines", "line": {"color": f"role:{role}", "width": 2}, "hoverinfo": "skip"}
        traces.append(_trace(f"contains {100 * share:.0f} %", wire, line))
    return Scene3D(
        tuple(traces),
        (f"x, {unit.name}", f"y, {unit.name}", f"z, {unit.name}"),
        "Drag to rotate, scroll to zoom.",
    )


def _wires() -> Array:
    """Return points ``(P, 3)`` of meridians and parallels of the unit sphere, NaN between lines."""
    around = np.linspace(0.0, 2 * np.pi, 49)
    lines = []
    for turn in np.linspace(0.0, np.pi, 7)[:-1]:
        flat = np.sin(around)
        lines.append(np.stack((flat * math.cos(turn), flat * math.sin(turn), np.cos(around)), axis=1))
    for height in (-0.7, -0.35, 0.0, 0.35, 0.7):
        radius = math.sqrt(1 - height**2)
        lines.append(np.stack((radius * np.cos(around), radius * np.sin(around), np.full(49, height)), axis=1))
    gap = np.full((1, 3), np.nan)
    return np.concatenate([part for line in lines for part in (line, gap)])


def _trace(name: str, points: Array, looks: dict[str, Any]) -> dict[str, Any]:
    rounded = [[None if math.isnan(v) else float(f"{v:.4g}") for v in column] for column in points.T.tolist()]
    return {"type": "scatter3d", "name": name, **dict(zip("xyz", rounded, strict=True)), **looks}
