"""Charts over the workspace: maps of errors and grades, magnified error vectors, corrected targets, planned poses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from robacc.render.plots.canvas import (
    CUBE,
    SPACE,
    Array,
    Axis,
    Chart,
    Panel,
    Rows,
    Series,
    lengths,
    numbers,
    place,
    root_mean_square,
    scene,
    thinned,
    thinning_note,
    vectors,
)
from robacc.render.plots.errors import Curve, stages_of
from robacc.render.text.layout import Document, Unit, error_unit
from robacc.render.views.elements import Grid

_MIN_POSES = 80
"""Smallest number of poses for a map without too many empty cells."""


def workspace_charts(document: Document) -> Iterator[Chart]:
    """Return the map in side view (distance from the vertical axis, height) and top view."""
    poses, errors = document.get("poses"), stages_of(document, "m")
    if poses is not None and document["command"] == "predict":
        label, at, values = "Predicted error", vectors(poses["commanded_m"]), document["position"]["pose_rms_m"]
        values = numbers(values)
    elif poses is not None and errors is not None:
        used = errors.used > 0
        _, stage, values = errors.sizes(used)[-1]
        at = vectors(errors.poses["commanded_m"])[used]
        label = f"Position error, {stage}," if len(errors.errors) > 1 else "Position error"
    else:
        return
    if values.size < _MIN_POSES:
        return
    unit, quantity = error_unit("m", float(values.max())), label.rstrip(",")
    worst, radius = int(np.argmax(values)), np.hypot(at[:, 0], at[:, 1])
    views = (
        ("from the side", "distance from axis, m", "height z, m", radius, at[:, 2]),
        ("from above", "x, m", "y, m", at[:, 0], at[:, 1]),
    )
    cells = values * unit.factor
    yield Chart(
        "workspace",
        f"{label} over the workspace",
        f"{label} by target position: root mean square over the poses in each cell. Light cells have larger errors, "
        "cells without poses are empty. Left: side view (distance from the frame's vertical axis and height); right: "
        f"top view. The largest error is {unit.text(float(values[worst]))} at x {at[worst, 0]:.2f}, "
        f"y {at[worst, 1]:.2f}, z {at[worst, 2]:.2f} m.",
        f"Two maps of {quantity.lower()} in {unit.name} over the workspace in m; "
        f"from {unit.text(float(values.min()))} to {unit.text(float(values.max()))} over {values.size} poses",
        [
            Panel((Axis(x_title), Axis(y_title)), [Series((x, y, cells), "ink", kind="cells")], title, equal=True)
            for title, x_title, y_title, x, y in views
        ],
        _map_table(radius, at[:, 2], values, unit),
        columns=2,
        scale=f"{quantity}, {unit.name}",
    )


def _map_table(radius: Array, height: Array, values: Array, unit: Unit) -> Grid:
    """Return the errors by steps of distance and height."""
    rows = []
    edges = [np.linspace(coordinate.min(), coordinate.max(), 5) for coordinate in (radius, height)]
    places = [np.digitize(c, e[1:-1]) for c, e in zip((radius, height), edges, strict=True)]
    for cell in np.ndindex(4, 4):
        inside = values[(places[0] == cell[0]) & (places[1] == cell[1])]
        if inside.size:
            ends = [f"{edge[i]:.2f} to {edge[i + 1]:.2f} m" for edge, i in zip(edges, cell, strict=True)]
            rows.append([*ends, str(inside.size), *map(unit.text, (root_mean_square(inside), inside.max()))])
    return Grid(("distance from axis", "height", "poses", "rms", "largest"), rows)


# The poses in space with magnified error vectors, as a still chart and an interactive view.

_STILL = 220
_TURNED = 900
_ROWS = 60
_VECTOR = 0.12
"""Length of a large error vector in the chart, as a share of the poses' extent."""


def workspace_3d_charts(document: Document) -> Iterator[Chart]:
    """Return the chart of a result with poses and errors in the measuring frame."""
    by_stage = stages_of(document, "m")
    if by_stage is None or not by_stage.poses["commanded_m"]:
        return
    stages = [stage for stage in by_stage.errors if stage[0] != "nominal"]
    if "position_by_frame" in document:
        stages = [("after", "measured", vectors(document["position_by_frame"]["base"]["errors_m"]))]
    start = f"Commanded target positions and their errors ({' and '.join(label for _, label, _ in stages)})"
    at = vectors(by_stage.poses["commanded_m"])
    yield _errors_in_space(document, by_stage.poses, at, stages, "poses", "Pose errors in space", start)


def correction_charts(document: Document) -> Iterator[Chart]:
    """Return the chart of a correction: its targets with the errors of the nominal and of the corrected commands."""
    if document["command"] != "correct" or not document["targets"]["line"]:
        return
    targets: Mapping[str, Any] = document["targets"]
    stages = [
        (role, f"error of the {name} command", vectors(targets[f"error_{role}_m"]))
        for role, name in (("before", "nominal"), ("after", "corrected"))
    ]
    count = f"{sum(targets['corrected'])} of {len(targets['corrected'])} targets are corrected"
    start = f"Wanted positions and the error that the model predicts there; {count}, the others keep their error"
    at = vectors(targets["wanted_m"])
    yield _errors_in_space(document, targets, at, stages, "corrections", "Corrections in space", start)


def _errors_in_space(
    document: Document,
    poses: Mapping[str, Any],
    at: Array,
    stages: Sequence[Curve],
    kind: str,
    title: str,
    caption: str,
) -> Chart:
    """Return a chart of points ``at`` ``(N, 3)`` with the errors of each stage, the last the smallest.

    Args:
        document: The result, whose robot is drawn at a typical pose.
        poses: Columns that name the points.
        at: Points, m.
        stages: Role, label and errors of the same points; the first decides the magnification.
        kind: Kind of the chart.
        title: Its title.
        caption: First sentence of its caption, without its full stop.
    """
    sizes, labels = [lengths(errors) for _, _, errors in stages], [label for _, label, _ in stages]
    unit = error_unit("m", float(np.max(sizes)))
    scale = _magnification(at, sizes[0])
    still, turned = thinned(_STILL, *sizes), thinned(_TURNED, *sizes)
    order = np.argsort(-sizes[-1], kind="stable")[:_ROWS]
    largest, arm = unit.text(float(sizes[-1].max())), _arm(document)
    texts = [
        "\n".join(
            [
                place(poses, i),
                *(f"{label}: {unit.text(float(size[i]))}" for label, size in zip(labels, sizes, strict=True)),
            ]
        )
        for i in map(int, turned)
    ]

    def series(rows: Rows, texts: Sequence[str]) -> list[Series]:
        shown = [Series(at[rows].T, "ink", "commanded", marker="o", size=2.0, texts=texts)]
        gaps = np.full((rows.size, 3), np.nan)
        for role, label, errors in stages:
            ends = np.stack((at[rows], at[rows] + scale * errors[rows], gaps), axis=1).reshape(-1, 3)
            shown.append(Series(ends.T, role, label, line="-", width=1.0))
        return [*arm, *shown]

    return Chart(
        kind,
        title,
        f"{caption}, magnified {scale:,.0f} times.{' The grey line is the arm at a typical pose.' * bool(arm)} "
        f"The largest error is at {place(poses, int(order[0]))}: {largest}.{thinning_note(still.size, len(at))}",
        f"Points of {len(at)} poses in x, y, z in m of the measuring frame with error vectors {scale:,.0f} times "
        f"magnified; largest {largest}",
        [Panel(SPACE, series(still, ()))],
        Grid(
            ("pose", "x, m", "y, m", "z, m", "error x", "error y", "error z", *labels),
            [
                [place(poses, int(i)), *(f"{value:.3f}" for value in at[i])]
                + [unit.text(float(value)) for value in (*stages[-1][2][i], *(size[i] for size in sizes))]
                for i in order
            ],
            note=f"The {len(order)} poses with the largest errors of {len(at)}; the JSON result has all of them."
            if len(order) < len(at)
            else "Sorted by error, the largest first.",
        ),
        CUBE,
        scene=scene(
            series(turned, texts),
            f", point at a pose to see its row{thinning_note(turned.size, len(at)).replace('. ', '; ')}".rstrip("."),
        ),
    )


def _magnification(at: Array, sizes: Array) -> float:
    """Return a round factor that makes a large error visible relative to the poses' extent."""
    extent = float(np.ptp(at, axis=0).max()) or 1.0
    large = float(np.quantile(sizes, 0.95))
    if large <= 0:
        return 1.0
    wanted = _VECTOR * extent / large
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(1.0, power * max(step for step in (1, 2, 5) if step * power <= wanted))


def _arm(document: Document) -> list[Series]:
    """Return the line of the arm at a typical pose, if the result has it."""
    outline = (document.get("robot") or {}).get("outline")
    if outline is None:
        return []
    return [
        Series(
            vectors(outline["line_m"]).T,
            "nominal",
            "arm, at one pose",
            marker="o",
            line="-",
            size=3.4,
            width=2.2,
            alpha=0.8,
        )
    ]


# Map of the grade that a calibrated arm holds in each part of its workspace, in space.

_LOOKS = (("after", "s"), ("third", "o"), ("fourth", "D"), ("before", "^"))
"""Colour and mark from the best grade; the last stands for all wider grades too."""
_DRAWN = 1500


def warranty_charts(document: Document) -> Iterator[Chart]:
    """Return the map of a prediction from the fit of a model."""
    voxels = document.get("warranty_map")
    if document["command"] != "predict" or not voxels or not voxels["grade"]:
        return
    at, grades, bound = vectors(voxels["centre_m"]), np.array(voxels["grade"]), numbers(voxels["bound95_m"])
    known = [*document["grade"]["share_of_poses_meeting"]]
    present = [name for name in known if name in grades] + sorted({*grades.tolist()} - {*known})
    shares = ", ".join(f"{name} in {np.count_nonzero(grades == name)}" for name in present)
    unit, edge = error_unit("m", float(bound.max())), f"{1e3 * voxels['voxel_m']:g} mm"
    order = np.argsort(-bound, kind="stable")[:_ROWS]
    x, y, z = at[order[0]]
    rows = thinned(_DRAWN, bound)
    series = []
    for number, name in enumerate(present):
        role, marker = _LOOKS[min(number, len(_LOOKS) - 1)]
        own = rows[grades[rows] == name]
        texts = [f"95 % bound {unit.text(float(bound[i]))}" for i in own]
        series.append(Series(at[own].T, role, f"grade {name}", marker=marker, size=3.4, alpha=0.75, texts=texts))
    yield Chart(
        "warranty",
        "Grade over the workspace",
        f"Grade that the 95 % bound of every configuration meets, by voxel of {edge}: {shares} of {len(at)} voxels. "
        f"The largest bound is {unit.text(float(bound[order[0]]))} at x {x:.2f}, y {y:.2f}, z {z:.2f} m. "
        f"Voxels without a configuration are empty.{thinning_note(rows.size, len(at))}",
        f"Voxels of {edge} in x, y, z in m of the measuring frame, marked by grade: {shares}",
        [Panel(SPACE, series)],
        Grid(
            ("grade", "x, m", "y, m", "z, m", "configurations", "95 % bound"),
            [
                [voxels["grade"][i]]
                + [f"{value:.3f}" for value in at[i]]
                + [str(voxels["configurations"][i]), unit.text(bound[i])]
                for i in map(int, order)
            ],
            note=f"The {len(order)} voxels with the largest bounds of {len(at)}; the JSON result has all of them."
            if len(order) < len(at)
            else "Sorted by bound, the largest first.",
        ),
        CUBE,
        scene=scene(series, ", point at a voxel"),
    )


# The poses of a plan in space, by their role, with the route of the visits.

_VISITS = 80
"""Visits that the table lists."""
_PAYLOAD_ROLES = ("after", "third", "fourth", "before", "nominal")


def planned_poses_charts(document: Document) -> Iterator[Chart]:
    """Return the chart of the visits in the base frame."""
    visits = document["visits"]
    at = vectors(visits["target_in_base_m"])
    groups, arm = list(_groups(document, at)), _arm(document)
    series = [Series(at.T, "muted", line="-", width=0.5, alpha=0.6), *arm, *groups]
    counts = ", ".join(
        f"{len(group.at[0])} {group.label[:-1] if len(group.at[0]) == 1 and group.label[-1] == 's' else group.label}"
        for group in groups
        if group.label != "instrument"
    )
    payloads = visits["payload_kg"]
    rows = [
        [str(i + 1), name, visits["role"][i], *([] if payloads is None else [f"{payloads[i]:g}"])]
        + [f"{value:.3f}" for value in at[i]]
        for i, name in enumerate(visits["pose"][:_VISITS])
    ]
    yield Chart(
        "planned-poses",
        "Planned poses in space",
        f"Target positions in the base frame: {counts}. The thin line is the route of the {len(at)} visits"
        f"{', the grey line the arm at a typical pose' if arm else ''}.",
        f"Points of {counts} in x, y, z in m of the base frame, joined by the route",
        [Panel(SPACE, series)],
        Grid(
            ("visit", "pose", "role", *(("payload, kg",) * (payloads is not None)), "x, m", "y, m", "z, m"),
            rows,
            note=f"The first {_VISITS} of {len(at)} visits; the CSV has all of them." * (len(at) > _VISITS),
        ),
        CUBE,
        scene=scene(series, ", point at a pose to see its visit"),
    )


def _groups(document: Document, at: Array) -> Iterator[Series]:
    """Yield the poses by role and payload: each pose has one mark."""
    visits, blocks, validation = document["visits"], document["payloads"], document["validation"]
    names, roles = np.array(visits["pose"]), np.array(visits["role"])
    texts = np.array([f"visit {i}: {name}, {role}" for i, (name, role) in enumerate(zip(names, roles, strict=True), 1)])
    is_single = (roles == "pose") & ~np.isin(names, names[roles == "repeat"])
    chosen: list[tuple[str, str, str, Any]] = [("poses", _PAYLOAD_ROLES[0], "o", is_single)]
    if len(blocks) > 1:
        payloads = np.array(visits["payload_kg"])
        chosen = [
            (f"poses with {kg:g} kg", colour, "o", is_single & (payloads == kg))
            for kg, colour in zip((block["payload_kg"] for block in blocks), _PAYLOAD_ROLES, strict=False)
        ]
    for role, label, colour, marker in (
        ("repeat", "poses visited twice", "before", "s"),
        ("check", "drift check poses", "limit", "D"),
    ):
        first = np.flatnonzero(roles == role)[np.unique(names[roles == role], return_index=True)[1]]
        chosen.append((label, colour, marker, np.isin(np.arange(names.size), first)))
    groups = [(label, colour, marker, at[rows], texts[rows]) for label, colour, marker, rows in chosen]
    if validation is not None:
        points = vectors(validation["target_in_base_m"])
        labels = [f"validation pose {i + 1}" for i in range(len(points))]
        groups.append(("validation poses", "nominal", "^", points, labels))
    if document["instrument_in_base_m"] is not None:
        groups.append(("instrument", "ink", "*", vectors([document["instrument_in_base_m"]]), ["instrument"]))
    for label, colour, marker, points, labels in groups:
        if len(points):
            size, is_hollow = 8.0 if marker == "*" else 4.5, marker != "o"
            yield Series(points.T, colour, label, marker=marker, size=size, hollow=is_hollow, texts=labels, width=1.0)
