"""The poses of a plan in space, by their role, with the route of the visits."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.render.plots.chart import Chart, ChartTable, Document, Scene3D
from robacc.render.plots.columns import Array, vectors
from robacc.render.plots.palette import LIGHT
from robacc.render.plots.space import coordinates, fit_box, line_trace, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ROWS = 80
"""Visits that the table lists."""
_PAYLOAD_ROLES = ("after", "third", "fourth", "before", "nominal")


@dataclasses.dataclass(frozen=True, slots=True)
class _Group:
    """Points with one mark."""

    label: str
    points: Array
    """``(n, 3)`` m"""
    texts: Sequence[str]
    role: str
    marker: str
    """Of matplotlib."""
    symbol: str
    """Of plotly."""
    size: float


def planned_poses_chart(document: Document) -> Chart:
    """Return the chart of the visits in the base frame."""
    visits = document["visits"]
    at = vectors(visits["target_in_base_m"])
    groups = list(_groups(document, at))
    outline = (document["robot"] or {}).get("outline")
    arm = None if outline is None else vectors(outline["line_m"])
    counts = ", ".join(
        f"{len(group.points)} {group.label[:-1] if len(group.points) == 1 and group.label[-1] == 's' else group.label}"
        for group in groups
        if group.label != "instrument"
    )
    return Chart(
        "planned-poses",
        "Planned poses in space",
        f"Target positions in the base frame: {counts}. The thin line is the route of the {len(at)} visits"
        f"{', the grey line the arm at a typical pose' if arm is not None else ''}.",
        f"Points of {counts} in x, y, z in m of the base frame, joined by the route",
        lambda figure: _draw(figure, groups, at, arm),
        _table(visits, at),
        (4.9, 4.2),
        _scene(groups, at, arm),
    )


def _groups(document: Document, at: Array) -> Iterator[_Group]:
    visits = document["visits"]
    names, roles, payload = np.array(visits["pose"]), np.array(visits["role"]), visits["payload_kg"]
    texts = [f"visit {i + 1}: {plain(name)}, {role}" for i, (name, role) in enumerate(zip(names, roles, strict=True))]
    blocks = document["payloads"]
    repeated = np.isin(names, names[roles == "repeat"])
    for number, block in enumerate(blocks if len(blocks) > 1 else [None]):
        mask = (roles == "pose") & ~repeated
        if block is not None:
            mask &= np.array(payload) == block["payload_kg"]
        label = "poses" if block is None else f"poses with {block['payload_kg']:g} kg"
        if mask.any():
            role = _PAYLOAD_ROLES[number]
            yield _Group(label, at[mask], [texts[i] for i in np.flatnonzero(mask)], role, "o", "circle", 4.5)
    for role, label, colour, marker, symbol in (
        ("repeat", "poses visited twice", "before", "s", "square"),
        ("check", "drift check poses", "limit", "D", "diamond"),
    ):
        place = np.unique(names[roles == role], return_index=True)[1]
        where = np.flatnonzero(roles == role)[place]
        if where.size:
            yield _Group(label, at[where], [texts[i] for i in where], colour, marker, symbol, 4.5)
    validation = document["validation"]
    if validation is not None:
        points = vectors(validation["target_in_base_m"])
        labels = [f"validation pose {i + 1}" for i in range(len(points))]
        yield _Group("validation poses", points, labels, "nominal", "^", "cross", 4.5)
    instrument = document["instrument_in_base_m"]
    if instrument is not None:
        yield _Group("instrument", vectors([instrument]), ["instrument"], "ink", "*", "diamond-open", 8.0)


def _draw(figure: Figure, groups: Sequence[_Group], at: Array, outline: Array | None) -> None:
    axes: Any = figure.add_subplot(projection="3d")
    axes.plot(*at.T, "-", color=LIGHT["muted"], linewidth=0.5, alpha=0.6)
    if outline is not None:
        axes.plot(*outline.T, "-o", color=LIGHT["nominal"], linewidth=2.2, ms=3.4, alpha=0.8)
    for group in groups:
        filled = group.marker == "o"
        axes.plot(
            *group.points.T,
            group.marker,
            ms=group.size,
            mew=0 if filled else 1.0,
            mfc=LIGHT[group.role] if filled else "none",
            color=LIGHT[group.role],
            label=group.label,
        )
    points = np.vstack([at, *(group.points for group in groups), *([] if outline is None else [outline])])
    fit_box(axes, points)
    figure.legend(loc="outside upper center", ncols=3, columnspacing=1.0, handlelength=1.2)


def _scene(groups: Sequence[_Group], at: Array, outline: Array | None) -> Scene3D:
    traces: list[dict[str, Any]] = [line_trace("route", at, "role:muted", 1.5)]
    if outline is not None:
        traces.append(line_trace("arm, at one pose", outline, "role:nominal", 7))
    for group in groups:
        traces.append(
            {
                "type": "scatter3d",
                "mode": "markers",
                "name": group.label,
                **coordinates(group.points),
                "marker": {"size": group.size, "color": f"role:{group.role}", "symbol": group.symbol},
                "text": list(group.texts),
                "hovertemplate": "%{text}<extra></extra>",
            }
        )
    note = "Drag to rotate, scroll to zoom, point at a pose to see its visit."
    return Scene3D(tuple(traces), ("x, m", "y, m", "z, m"), note)


def _table(visits: Mapping[str, Any], at: Array) -> ChartTable:
    has_payload = visits["payload_kg"] is not None
    rows = []
    for i, name in enumerate(visits["pose"][:_ROWS]):
        payload = [f"{visits['payload_kg'][i]:g}"] if has_payload else []
        rows.append([str(i + 1), name, visits["role"][i], *payload, *(f"{value:.3f}" for value in at[i])])
    header = ("visit", "pose", "role", *(("payload, kg",) if has_payload else ()), "x, m", "y, m", "z, m")
    note = f"The first {_ROWS} of {len(at)} visits; the CSV has all of them." if len(at) > _ROWS else ""
    return ChartTable(header, rows, note)
