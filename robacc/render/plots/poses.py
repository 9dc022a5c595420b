"""Charts of the poses of a result: their errors as distributions, clouds, over time and the workspace, in space."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robacc.render.plots.canvas import (
    CUBE,
    SPACE,
    Array,
    Axis,
    Chart,
    Panel,
    Rows,
    Series,
    limits_of,
    numbers,
    place,
    root_mean_square,
    scene,
    thinned,
    thinning_note,
    vectors,
)
from robacc.render.text import MOST_ROWS, QUANTITIES, Document, Grid, unit_of
from robacc.render.views.fit import fit_stages

# The errors of a result's poses by stage: nominal model, baseline, extended model.

Curve = tuple[str, str, Array]
"""Role, which is its colour, label and values."""
_DASHES = {"nominal": (0, (1, 1.2)), "before": (0, (5, 1.6)), "after": "-"}


class Stages(NamedTuple):
    """The errors of one result by stage, of the same poses."""

    poses: Document
    """Columns of the poses, with as many rows as the errors."""
    used: NDArray[np.bool_]
    """``(N,)``, True for inliers and False for outliers."""
    errors: Sequence[Curve]
    """Role (``nominal``, ``before`` or ``after``: its colour), label, and ``(N, 3)`` m or rad of each stage."""
    held_out: bool = False
    """True if the models of baseline and extended model were fitted without the pose."""

    def sizes(self, mask: Any = slice(None)) -> Sequence[Curve]:
        """Return role, label, and the lengths ``(N,)`` of the errors of each stage, of the rows in ``mask``."""
        return [(role, label, np.linalg.norm(errors[mask], axis=1)) for role, label, errors in self.errors]


def stages_of(document: Document, unit: str) -> Stages | None:
    """Return the errors in ``m`` or ``rad``, None if the result has none."""
    poses, is_apart = document.get("poses_apart") or document.get("poses"), document.get("poses_apart") is not None
    if poses is None or document["command"] == "predict":
        return None
    if "errors_m" not in poses:
        part = document.get("position" if unit == "m" else "orientation")
        if part is None or f"errors_{unit}" not in part:
            return None
        errors = vectors(part[f"errors_{unit}"])
        return Stages(poses, np.ones(len(errors), dtype=bool), [("after", "measured", errors)])
    if (columns := poses[f"errors_{unit}"]) is None:
        return None
    held_out = columns["held_out_after"] is not None
    return Stages(
        poses,
        np.array(poses["used"] or [True] * len(columns["nominal"]), dtype=bool),
        [(role, label, vectors(columns["held_out_" * held_out + role])) for role, _, label in fit_stages(document)],
        held_out or is_apart,
    )


# Ellipsoids of the covariance of the errors, in the tool frame and in the measuring frame.

SHARES = ((0.5, 1.538172), (0.95, 2.795483))
"""Shares of a Gaussian, and the square roots of the chi-square quantiles of three degrees of freedom."""
_FRAMES = {
    "tool": ("in the tool frame", "errors fixed to the tool keep their direction in this frame"),
    "base": ("in the measuring frame", "errors of the base or the instrument keep their direction in this frame"),
}


def ellipsoid_charts(document: Document) -> Iterator[Chart]:
    """Return a chart for each frame; for a prediction, the mean covariance in the tool frame."""
    for frame, part in (document.get("position_by_frame") or {}).items():
        yield _ellipsoids_chart(
            frame, part, vectors(part["errors_m"]), numbers(part["mean_m"]), "centred_covariance_m2"
        )
    if document["command"] == "predict":
        yield _ellipsoids_chart("tool", document["position"], np.zeros((0, 3)), np.zeros(3), "mean_covariance_m2")


def _ellipsoids_chart(frame: str, part: Document, errors: Array, mean: Array, key: str) -> Chart:
    covariance = vectors(part[key])
    sd = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance)[::-1], 0.0))
    largest = float(np.abs(errors).max(initial=0.0))
    unit = unit_of("m", max(largest, float(SHARES[1][1] * sd[0])))
    (where, meaning), is_measured = _FRAMES[frame], len(errors) > 0
    rows = thinned(500, *errors.T) if is_measured else np.zeros(0, dtype=np.int64)
    subject = f"{'Predicted errors' if key.startswith('mean') else 'Errors'} {where}"
    cloud = "each pose's error as a point" if is_measured else "the mean covariance over the poses"
    axes = ", ".join(unit.text(float(value)) for value in sd)
    reach = SHARES[1][1] * math.sqrt(float(np.diag(covariance).max())) + float(np.abs(mean).max())
    reach = 1.08 * max(reach, largest) * unit.factor or 1.0
    drawn = (errors[rows] * unit.factor, mean * unit.factor, covariance * unit.factor**2)
    panels = [
        Panel([Axis(f"{'xyz'[k]}, {unit.name}", -reach, reach) for k in plane], _cloud(*drawn, plane), equal=True)
        for plane in ((0, 1), (0, 2), (1, 2))
    ]
    labels = {"covariance_m2": "about zero", "centred_covariance_m2": "about the mean", "mean_covariance_m2": "mean"}
    listed = [
        [f"{labels[name]}, {axis}", *(f"{v:.3g}" for v in row)]
        for name in dict.fromkeys(("covariance_m2", key))
        if name in part and np.ndim(part[name]) == 2
        for axis, row in zip("xyz", vectors(part[name]) * unit.factor**2, strict=True)
    ]
    if "mean_m" in part:
        listed.append(["mean vector", *(unit.text(value) for value in part["mean_m"])])
    return Chart(
        f"ellipsoids-{frame}",
        subject,
        f"{subject} in three projections: {cloud}, with the ellipsoids that contain 50 % and 95 % of a Gaussian with "
        f"this covariance ({meaning}). Standard deviations along the three axes of the ellipsoid: {axes}."
        f"{thinning_note(rows.size, len(errors))}",
        f"Three projections of the error cloud {where} in {unit.name} with 50 and 95 % ellipses; standard deviations "
        f"along the axes {axes}",
        [panels[0], None, *panels[1:]],
        Grid((f"covariance, {unit.name}²", "x", "y", "z"), listed),
        CUBE,
        columns=2,
        scene=scene(_cloud(*drawn), "", unit.name),
    )


CIRCLE = np.array([wave(np.linspace(0.0, 2 * np.pi, 97)) for wave in (np.cos, np.sin)])
"""``(2, P)`` points of the unit circle."""


def _cloud(errors: Array, mean: Array, covariance: Array, plane: Sequence[int] = (0, 1, 2)) -> list[Series]:
    """Return the points, the ellipses of a plane or the ellipsoids in space, and the mean."""
    own = [*plane]
    # The projection of an ellipsoid is the ellipse of the covariance of the two coordinates.
    values, vectors_ = np.linalg.eigh(covariance[np.ix_(own, own)])
    root = vectors_ * np.sqrt(np.maximum(values, 0.0)) @ vectors_.T
    unit_ellipse = (_wires() if len(own) == 3 else CIRCLE.T) @ root
    return [
        *([Series(errors.T[own], "nominal", "one pose", marker="o", size=2.4, alpha=0.75)] if len(errors) else []),
        *(
            Series((mean[own] + radius * unit_ellipse).T, role, f"contains {100 * share:.0f} %", line=_DASHES[role])
            for (share, radius), role in zip(SHARES, ("after", "before"), strict=True)
        ),
        Series(mean[own, None], "ink", "mean", marker="+", size=7.0),
    ]


def _wires() -> Array:
    """Return points ``(P, 3)`` of meridians and parallels of the unit sphere, NaN between lines."""
    around = np.append(np.linspace(0.0, 2 * np.pi, 49), np.nan)[None, :]
    turn, height = np.linspace(0.0, np.pi, 7)[:-1, None], np.array([-0.7, -0.35, 0.0, 0.35, 0.7])[:, None]
    radius = np.sqrt(1 - height**2)
    meridians = (np.sin(around) * np.cos(turn), np.sin(around) * np.sin(turn), np.cos(around) + 0 * turn)
    parallels = (radius * np.cos(around), radius * np.sin(around), height + 0 * around)
    return np.concatenate([np.stack(lines, axis=-1).reshape(-1, 3) for lines in (meridians, parallels)])


# Cumulative distributions of the errors by stage, with the limits.


def distribution_charts(document: Document) -> Iterator[Chart]:
    """Return the distribution of position errors, and of orientation errors if measured."""
    for name, si_unit, *_ in QUANTITIES:
        stages = stages_of(document, si_unit)
        curves = [] if stages is None else stages.sizes(stages.used)
        if document["command"] == "predict":
            curves = [
                (role, f"{label} by pose", numbers(document[name][f"{key}_{si_unit}"]))
                for role, label, key in (
                    ("after", "predicted rms", "pose_rms"),
                    ("before", "predicted 95 % radius", "pose_radius95"),
                )
                if f"{key}_{si_unit}" in document[name]
            ]
        if not curves:
            continue
        unit, limits = unit_of(si_unit, max(float(sizes.max()) for _, _, sizes in curves)), limits_of(document, si_unit)
        title = f"Distribution of the {'predicted ' * (document['command'] == 'predict')}{name} error"
        medians = [(label, unit.text(float(np.median(sizes)))) for _, label, sizes in curves]
        meaning = {
            "trace": "Baseline: declared effects fitted; extended model: findings added. ",
            "calibrate": "Baseline: base and tool fitted; calibrated: all named effects fitted. ",
        }.get(document["command"], "")
        # The corners of the steps, from no pose up.
        series = [
            Series(
                (np.repeat(ordered[pick], 2), 100 * np.repeat(np.append(0.0, (pick + 1) / sizes.size), 2)[1:-1]),
                role,
                label,
                line=_DASHES[role],
                width=1.6,
            )
            for role, label, sizes in curves
            for ordered in [np.sort(sizes) * unit.factor]
            for pick in [thinned(400, ordered)]
        ]
        x_axis = error_axis(f"{name} error, {unit.name}", [sizes * unit.factor for _, _, sizes in curves])
        rules = [(size * unit.factor, short_label) for _, short_label, size in limits]
        yield Chart(
            "distribution" + "-orientation" * (name == "orientation"),
            title,
            f"Share of {'held-out poses' if stages is not None and stages.held_out else 'all poses'} with "
            f"a{'n' * (name == 'orientation')} {name} error up to the given size. Curves further left are better. "
            f"{meaning}Half of the poses are within {', '.join(f'{median} ({label})' for label, median in medians)}."
            + " Vertical lines are limits: {}.".format(", ".join(f"{label} {unit.text(s)}" for label, _, s in limits))
            * bool(limits),
            f"{title}: share of poses, 0 to 100 %, over the size of the error in {unit.name}. "
            + "; ".join(f"{label}: median {median}" for label, median in medians),
            [Panel((replace(x_axis, rules=rules), Axis("share of poses, %", 0, 101)), series)],
            Grid(
                ("share of poses", *(label for _, label, _ in curves)),
                [
                    [f"{100 * share:.0f} %", *(unit.text(float(np.quantile(sizes, share))) for _, _, sizes in curves)]
                    for share in (0.05, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 1.0)
                ],
            ),
        )


def error_axis(title: str, curves: Sequence[Array]) -> Axis:
    """Return an axis from zero, or a logarithmic axis if the sizes of errors have a wide range."""
    top, low = max(float(sizes.max()) for sizes in curves), min(float(np.median(sizes)) for sizes in curves)
    if low <= 0 or top / low <= 12:
        return Axis(title, 0, top * 1.04 or 1.0)
    return Axis(
        title, max(min(float(np.quantile(sizes, 0.02)) for sizes in curves), low / 30) / 1.3, top * 1.3, is_log=True
    )


# Errors over time or row order, which show a drift, a step change or a warm-up.


def error_over_time_charts(document: Document) -> Iterator[Chart]:
    """Return the chart over the logged time, or over the lines of the file without a time."""
    errors = stages_of(document, "m")
    if errors is None or len(errors.used) < 2:
        return
    timed = errors.poses.get("time_s") is not None
    x = numbers(errors.poses["time_s" if timed else "line"])
    # The errors of the nominal model are much larger.
    stages = [stage for stage in errors.sizes() if stage[0] != "nominal"]
    _, labels, sizes = zip(*stages, strict=True)
    last, used = sizes[-1], errors.used
    rows, listed = thinned(700, x, *sizes), thinned(MOST_ROWS, x, last)
    unit = unit_of("m", float(np.max(sizes)))
    over = "time, s" if timed else "line of the file"
    worst = int(np.argmax(last))
    largest, at = unit.text(float(last[worst])), place(errors.poses, worst)
    # All inliers are in the chart; outliers off scale stand at its upper edge.
    inliers = rows[used[rows]] if used[rows].any() else rows
    top = 1.08 * float(np.array(sizes)[:, inliers].max()) * unit.factor or 1.0
    beyond = last * unit.factor > top
    looks: dict[str, Any] = {"after": {"size": 2.8}, "before": {"size": 3.4, "hollow": True, "width": 0.8}}
    series = [
        Series((x[rows], own[rows] * unit.factor), role, label, marker="o", **looks[role])
        for role, label, own in stages
    ] + [
        Series((x[those], np.minimum(last[those] * unit.factor, 0.97 * top)), "ink", label, marker=mark, size=6)
        for mark, chosen, label in (("x", ~used & ~beyond, "outlier"), ("^", ~used & beyond, "outlier, off scale"))
        if (those := rows[chosen[rows]]).size
    ]
    yield Chart(
        "time",
        f"Position error over {'time' if timed else 'the lines of the file'}",
        f"Each pose's error ({' and '.join(labels)}) over {over}. The largest is at {at}, "
        f"{largest}."
        + " The order of the lines is the order of time only if the file was written so." * (not timed)
        + thinning_note(rows.size, x.size),
        f"Scatter of position error in {unit.name} over {over}; largest {largest} at {at}",
        [Panel((Axis(over), Axis(f"position error, {unit.name}", 0, top)), series)],
        Grid(
            ("pose", over, *labels),
            [[place(errors.poses, int(i)), f"{x[i]:g}", *(unit.text(float(own[i])) for own in sizes)] for i in listed],
            note=f"{listed.size} of {x.size} poses; the JSON result has all of them." * (listed.size < x.size),
        ),
        (4.9, 2.9),
    )


# Maps of the errors over the workspace.


def workspace_charts(document: Document) -> Iterator[Chart]:
    """Return the map in side view (distance from the vertical axis, height) and top view."""
    errors, label = stages_of(document, "m"), "Position error"
    values: Array = np.zeros(0)
    if document["command"] == "predict":
        label, at = "Predicted error", vectors(document["poses"]["commanded_m"])
        values = numbers(document["position"]["pose_rms_m"])
    elif errors is not None:
        _, stage, values = errors.sizes(errors.used)[-1]
        at = vectors(errors.poses["commanded_m"])[errors.used]
        label += f", {stage}," * (len(errors.errors) > 1)
    # Fewer poses leave too many cells empty.
    if values.size < 80:
        return
    unit, quantity = unit_of("m", float(values.max())), label.rstrip(",")
    worst, (x, y, z), radius = int(np.argmax(values)), at.T, np.hypot(at[:, 0], at[:, 1])
    views = (("from the side", "distance from axis, m", "height z, m", radius, z), ("from above", "x, m", "y, m", x, y))
    cells = values * unit.factor
    # The table has the errors by steps of distance and height.
    edges = [np.linspace(coordinate.min(), coordinate.max(), 5) for coordinate in (radius, z)]
    places = [np.digitize(c, e[1:-1]) for c, e in zip((radius, z), edges, strict=True)]
    rows = [
        [
            *(f"{edge[i]:.2f} to {edge[i + 1]:.2f} m" for edge, i in zip(edges, cell, strict=True)),
            str(inside.size),
            *map(unit.text, (root_mean_square(inside), inside.max())),
        ]
        for cell in np.ndindex(4, 4)
        if (inside := values[(places[0] == cell[0]) & (places[1] == cell[1])]).size
    ]
    yield Chart(
        "workspace",
        f"{label} over the workspace",
        f"{label} by target position: root mean square over the poses in each cell. Light cells have larger errors, "
        "cells without poses are empty. Left: side view (distance from the frame's vertical axis and height); right: "
        f"top view. The largest error is {unit.text(float(values[worst]))} at x {x[worst]:.2f}, y {y[worst]:.2f}, z "
        f"{z[worst]:.2f} m.",
        f"Two maps of {quantity.lower()} in {unit.name} over the workspace in m; "
        f"from {unit.text(float(values.min()))} to {unit.text(float(values.max()))} over {values.size} poses",
        [
            Panel((Axis(x_title), Axis(y_title)), [Series((a, b, cells), "ink", kind="cells")], title, equal=True)
            for title, x_title, y_title, a, b in views
        ],
        Grid(("distance from axis", "height", "poses", "rms", "largest"), rows),
        columns=2,
        scale=f"{quantity}, {unit.name}",
    )


# The poses in space with magnified error vectors, as a still chart and an interactive view.


def workspace_3d_charts(document: Document) -> Iterator[Chart]:
    """Return the chart of a result with poses and errors in the measuring frame."""
    by_stage = stages_of(document, "m")
    if by_stage is None or not by_stage.poses["commanded_m"]:
        return
    stages = (
        [("after", "measured", vectors(document["position_by_frame"]["base"]["errors_m"]))]
        if "position_by_frame" in document
        else [stage for stage in by_stage.errors if stage[0] != "nominal"]
    )
    start = f"Commanded target positions and their errors ({' and '.join(label for _, label, _ in stages)})"
    yield _errors_in_space(document, by_stage.poses, "commanded_m", stages, "poses", "Pose errors in space", start)


def correction_charts(document: Document) -> Iterator[Chart]:
    """Return the chart of a correction: its targets with the errors of the nominal and of the corrected commands."""
    if document["command"] != "correct" or not document["targets"]["line"]:
        return
    targets: Document = document["targets"]
    stages = [
        (role, f"error of the {name} command", vectors(targets[f"error_{role}_m"]))
        for role, name in (("before", "nominal"), ("after", "corrected"))
    ]
    start = (
        f"Wanted positions and the error that the model predicts there; {sum(targets['corrected'])} of "
        f"{len(targets['corrected'])} targets are corrected, the others keep their error"
    )
    yield _errors_in_space(document, targets, "wanted_m", stages, "corrections", "Corrections in space", start)


def _errors_in_space(
    document: Document, poses: Document, points: str, stages: Sequence[Curve], kind: str, title: str, caption: str
) -> Chart:
    """Return a chart of points with the errors of each stage, the last the smallest.

    Args:
        document: The result, whose robot is drawn at a typical pose.
        poses: Columns that name the points.
        points: Column of the points, m.
        stages: Role, label and errors of the same points; the first decides the magnification.
        kind: Kind of the chart.
        title: Its title.
        caption: First sentence of its caption, without its full stop.
    """
    at, arm = vectors(poses[points]), _arm(document)
    sizes, labels = [np.linalg.norm(errors, axis=1) for *_, errors in stages], [label for _, label, _ in stages]
    unit = unit_of("m", float(np.max(sizes)))
    scale = _magnification(at, sizes[0])
    still, turned = thinned(220, *sizes), thinned(900, *sizes)
    order = np.argsort(-sizes[-1], kind="stable")[:MOST_ROWS]
    largest = unit.text(float(sizes[-1].max()))
    texts = [
        "\n".join(
            (
                place(poses, i),
                *(f"{name}: {unit.text(float(size[i]))}" for name, size in zip(labels, sizes, strict=True)),
            )
        )
        for i in map(int, turned)
    ]

    def series(rows: Rows, texts: Sequence[str]) -> list[Series]:
        gaps = np.full((rows.size, 3), np.nan)
        return [
            *arm,
            Series(at[rows].T, "ink", "commanded", marker="o", size=2.0, texts=texts),
            *(
                Series(
                    np.stack((at[rows], at[rows] + scale * errors[rows], gaps), axis=1).reshape(-1, 3).T,
                    role,
                    label,
                    line="-",
                    width=1.0,
                )
                for role, label, errors in stages
            ),
        ]

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
            note=_note_of_largest(len(order), len(at), "poses", "error"),
        ),
        CUBE,
        scene=scene(
            series(turned, texts),
            f", point at a pose to see its row{thinning_note(turned.size, len(at)).replace('. ', '; ')}".rstrip("."),
        ),
    )


def _note_of_largest(count: int, total: int, things: str, quantity: str) -> str:
    some = f"The {count} {things} with the largest {quantity}s of {total}; the JSON result has all of them."
    return some if count < total else f"Sorted by {quantity}, the largest first."


def _magnification(at: Array, sizes: Array) -> float:
    """Return a round factor that makes a large error visible relative to the poses' extent."""
    large = float(np.quantile(sizes, 0.95))
    if large <= 0:
        return 1.0
    # Such an error is drawn in 12 % of the extent.
    wanted = 0.12 * (float(np.ptp(at, axis=0).max()) or 1.0) / large
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(1.0, power * max(step for step in (1, 2, 5) if step * power <= wanted))


def _arm(document: Document) -> list[Series]:
    """Return the line of the arm at a typical pose, if the result has it."""
    if (outline := (document.get("robot") or {}).get("outline")) is None:
        return []
    line = vectors(outline["line_m"]).T
    return [Series(line, "nominal", "arm, at one pose", marker="o", line="-", size=3.4, width=2.2, alpha=0.8)]


# Map of the grade that a calibrated arm holds in each part of its workspace, in space.

_LOOKS = (("after", "s"), ("third", "o"), ("fourth", "D"), ("before", "^"))
"""Colour and mark from the best grade; the last stands for all wider grades too."""


def warranty_charts(document: Document) -> Iterator[Chart]:
    """Return the map of a prediction from the fit of a model."""
    voxels = document.get("warranty_map")
    if document["command"] != "predict" or not voxels or not voxels["grade"]:
        return
    at, grades, bound = vectors(voxels["centre_m"]), np.array(voxels["grade"]), numbers(voxels["bound95_m"])
    known = [*document["grade"]["share_of_poses_meeting"]]
    present = [name for name in known if name in grades] + sorted({*grades.tolist()} - {*known})
    shares = ", ".join(f"{name} in {np.count_nonzero(grades == name)}" for name in present)
    unit, edge = unit_of("m", float(bound.max())), f"{1e3 * voxels['voxel_m']:g} mm"
    order, rows = np.argsort(-bound, kind="stable")[:MOST_ROWS], thinned(1500, bound)
    x, y, z = at[order[0]]
    series = [
        Series(at[own].T, role, f"grade {name}", marker=marker, size=3.4, alpha=0.75, texts=texts)
        for number, name in enumerate(present)
        for role, marker in [_LOOKS[min(number, len(_LOOKS) - 1)]]
        for own in [rows[grades[rows] == name]]
        for texts in [[f"95 % bound {unit.text(float(bound[i]))}" for i in own]]
    ]
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
            note=_note_of_largest(len(order), len(at), "voxels", "bound"),
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
    at, payloads = vectors(visits["target_in_base_m"]), visits["payload_kg"]
    groups, arm = list(_groups(document, at)), _arm(document)
    series = [Series(at.T, "muted", line="-", width=0.5, alpha=0.6), *arm, *groups]
    counts = ", ".join(
        f"{n} {group.label[:-1] if n == 1 and group.label[-1] == 's' else group.label}"
        for group in groups
        for n in [len(group.at[0])]
        if group.label != "instrument"
    )
    yield Chart(
        "planned-poses",
        "Planned poses in space",
        f"Target positions in the base frame: {counts}. The thin line is the route of the {len(at)} visits"
        f"{', the grey line the arm at a typical pose' if arm else ''}.",
        f"Points of {counts} in x, y, z in m of the base frame, joined by the route",
        [Panel(SPACE, series)],
        Grid(
            ("visit", "pose", "role", *(("payload, kg",) * (payloads is not None)), "x, m", "y, m", "z, m"),
            [
                [str(i + 1), name, visits["role"][i], *([] if payloads is None else [f"{payloads[i]:g}"])]
                + [f"{value:.3f}" for value in at[i]]
                for i, name in enumerate(visits["pose"][:_VISITS])
            ],
            note=f"The first {_VISITS} of {len(at)} visits; the CSV has all of them." * (len(at) > _VISITS),
        ),
        CUBE,
        scene=scene(series, ", point at a pose to see its visit"),
    )


def _groups(document: Document, at: Array) -> Iterator[Series]:
    """Yield the poses by role and payload: each pose has one mark."""
    visits, blocks, instrument = document["visits"], document["payloads"], document["instrument_in_base_m"]
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
    # Of a pose visited twice and of a drift check pose, the first visit stands for all.
    chosen += [
        (
            label,
            colour,
            marker,
            np.flatnonzero(roles == role)[np.sort(np.unique(names[roles == role], return_index=True)[1])],
        )
        for role, label, colour, marker in (
            ("repeat", "poses visited twice", "before", "s"),
            ("check", "drift check poses", "limit", "D"),
        )
    ]
    groups = [(label, colour, marker, at[rows], texts[rows]) for label, colour, marker, rows in chosen]
    validation = vectors((document["validation"] or {"target_in_base_m": ()})["target_in_base_m"])
    labels = [f"validation pose {i + 1}" for i in range(len(validation))]
    groups += [
        ("validation poses", "nominal", "^", validation, labels),
        ("instrument", "ink", "*", vectors([] if instrument is None else [instrument]), ["instrument"]),
    ]
    for label, colour, marker, points, own in groups:
        if len(points):
            size, is_hollow = 8.0 if marker == "*" else 4.5, marker != "o"
            yield Series(points.T, colour, label, marker=marker, size=size, hollow=is_hollow, texts=own, width=1.0)
