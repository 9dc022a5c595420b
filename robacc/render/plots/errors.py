"""Charts of errors: their distributions, ellipsoids, course over time, and stages."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from robacc.render.plots.canvas import (
    CUBE,
    Array,
    Axis,
    Chart,
    Panel,
    Series,
    lengths,
    limits_of,
    numbers,
    place,
    scene,
    thinned,
    thinning_note,
    vectors,
)
from robacc.render.text.layout import Document, Unit, error_unit
from robacc.render.views.elements import Grid
from robacc.render.views.fit import SHORT_STAGES

# Charts of the errors and of the ellipsoids of their covariance, in the tool frame and in the measuring frame.

SHARES = ((0.5, 1.538172), (0.95, 2.795483))
"""Shares of a Gaussian, and the square roots of the chi-square quantiles of three degrees of freedom."""
_ELLIPSOID_POINTS = 500
_DASHES = {"nominal": (0, (1, 1.2)), "before": (0, (5, 1.6)), "after": "-"}
_FRAMES = {
    "tool": ("in the tool frame", "errors fixed to the tool keep their direction in this frame"),
    "base": ("in the measuring frame", "errors of the base or the instrument keep their direction in this frame"),
}
_PLANES = ((0, 1), (0, 2), (1, 2))


def ellipsoid_charts(document: Document) -> Iterator[Chart]:
    """Return a chart for each frame; for a prediction, the mean covariance in the tool frame."""
    for frame, part in (document.get("position_by_frame") or {}).items():
        mean = numbers(part["mean_m"])
        yield _ellipsoids_chart(frame, part, vectors(part["errors_m"]), mean, "centred_covariance_m2")
    if document["command"] == "predict":
        yield _ellipsoids_chart("tool", document["position"], np.zeros((0, 3)), np.zeros(3), "mean_covariance_m2")


def _ellipsoids_chart(frame: str, part: Mapping[str, Any], errors: Array, mean: Array, key: str) -> Chart:
    covariance = vectors(part[key])
    sd = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance)[::-1], 0.0))
    unit = error_unit("m", float(max(np.abs(errors).max(initial=0.0), SHARES[1][1] * sd[0])))
    where, meaning = _FRAMES[frame]
    rows = thinned(_ELLIPSOID_POINTS, *errors.T) if len(errors) else np.zeros(0, dtype=np.int64)
    subject = "Predicted errors" if key.startswith("mean") else "Errors"
    cloud = "each pose's error as a point" if len(errors) else "the mean covariance over the poses"
    axes = ", ".join(unit.text(float(value)) for value in sd)
    reach = SHARES[1][1] * math.sqrt(float(np.diag(covariance).max())) + float(np.abs(mean).max())
    reach = 1.08 * max(reach, float(np.abs(errors).max(initial=0.0))) * unit.factor or 1.0
    shown = (errors[rows] * unit.factor, mean * unit.factor, covariance * unit.factor**2)
    panels: list[Panel | None] = [
        Panel(
            [Axis(f"{'xyz'[k]}, {unit.name}", -reach, reach) for k in plane],
            [Series(one[[*plane]], role, label, **looks) for role, label, one, looks in _cloud(*shown, plane)],
            equal=True,
        )
        for plane in _PLANES
    ]
    in_space = [Series(one, role, label, **looks) for role, label, one, looks in _cloud(*shown)]
    return Chart(
        f"ellipsoids-{frame}",
        f"{subject} {where}",
        f"{subject} {where} in three projections: {cloud}, with the ellipsoids that contain 50 % and 95 % of a "
        f"Gaussian with this covariance ({meaning}). Standard deviations along the three axes of the ellipsoid: {axes}."
        f"{thinning_note(rows.size, len(errors))}",
        f"Three projections of the error cloud {where} in {unit.name} with 50 and 95 % ellipses; standard deviations "
        f"along the axes {axes}",
        [panels[0], None, *panels[1:]],
        _ellipsoids_table(part, key, unit),
        CUBE,
        columns=2,
        scene=scene(in_space, "", unit.name),
    )


def _cloud(
    errors: Array, mean: Array, covariance: Array, plane: Sequence[int] = ()
) -> Iterator[tuple[str, str, Array, dict[str, Any]]]:
    """Yield role, label, coordinates ``(3, n)`` and looks of the points, of the ellipses of a plane or in space."""
    if len(errors):
        yield "nominal", "one pose", errors.T, {"marker": "o", "size": 2.4, "alpha": 0.75}
    for (share, radius), role in zip(SHARES, ("after", "before"), strict=True):
        if plane:
            around = np.linspace(0.0, 2 * np.pi, 97)
            sphere = np.zeros((97, 3))
            sphere[:, plane] = np.stack((np.cos(around), np.sin(around)), axis=1)
            # The projection of an ellipsoid is the ellipse of the covariance of the two coordinates.
            root = np.zeros((3, 3))
            root[np.ix_(plane, plane)] = _root(covariance[np.ix_(plane, plane)])
        else:
            sphere, root = _wires(), _root(covariance)
        yield role, f"contains {100 * share:.0f} %", (mean + radius * sphere @ root).T, {"line": _DASHES[role]}
    yield "ink", "mean", mean[:, None], {"marker": "+", "size": 7.0}


def _root(covariance: Array) -> Array:
    """Return the symmetric root."""
    values, axes = np.linalg.eigh(covariance)
    root: Array = axes * np.sqrt(np.maximum(values, 0.0)) @ axes.T
    return root


def _wires() -> Array:
    """Return points ``(P, 3)`` of meridians and parallels of the unit sphere, NaN between lines."""
    around = np.append(np.linspace(0.0, 2 * np.pi, 49), np.nan)[None, :]
    turn, height = np.linspace(0.0, np.pi, 7)[:-1, None], np.array([-0.7, -0.35, 0.0, 0.35, 0.7])[:, None]
    radius = np.sqrt(1 - height**2)
    meridians = (np.sin(around) * np.cos(turn), np.sin(around) * np.sin(turn), np.cos(around) + 0 * turn)
    parallels = (radius * np.cos(around), radius * np.sin(around), height + 0 * around)
    return np.concatenate([np.stack(lines, axis=-1).reshape(-1, 3) for lines in (meridians, parallels)])


def _ellipsoids_table(part: Mapping[str, Any], key: str, unit: Unit) -> Grid:
    labels = {"covariance_m2": "about zero", "centred_covariance_m2": "about the mean", "mean_covariance_m2": "mean"}
    rows = [
        [f"{labels[name]}, {axis}", *(f"{v:.3g}" for v in row)]
        for name in dict.fromkeys(("covariance_m2", key))
        if name in part and np.ndim(part[name]) == 2
        for axis, row in zip("xyz", vectors(part[name]) * unit.factor**2, strict=True)
    ]
    if "mean_m" in part:
        rows.append(["mean vector", *(unit.text(value) for value in part["mean_m"])])
    return Grid((f"covariance, {unit.name}²", "x", "y", "z"), rows)


# The errors of a result's poses by stage: nominal model, baseline, extended model.

Curve = tuple[str, str, Array]
"""Role, which is its colour, label and values."""
STAGE_MEANINGS = {
    "trace": "baseline: declared effects fitted; extended model: findings added",
    "calibrate": "baseline: base and tool fitted; calibrated: all named effects fitted",
}


class Stages(NamedTuple):
    """The errors of one result by stage, of the same poses."""

    poses: Mapping[str, Any]
    """Columns of the poses, with as many rows as the errors."""
    used: Array
    """``(N,)``, 1 for inliers and 0 for outliers."""
    errors: Sequence[Curve]
    """Role (``nominal``, ``before`` or ``after``: its colour), label, and ``(N, 3)`` m or rad of each stage."""
    held_out: bool = False
    """True if the models of baseline and extended model were fitted without the pose."""

    def sizes(self, mask: Any = slice(None)) -> Sequence[Curve]:
        """Return role, label, and the lengths ``(N,)`` of the errors of each stage, of the rows in ``mask``."""
        return [(role, label, lengths(errors[mask])) for role, label, errors in self.errors]


def stages_of(document: Document, unit: str) -> Stages | None:
    """Return the errors in ``m`` or ``rad``, None if the result has none."""
    poses = document.get("poses_apart") or document.get("poses")
    part = document.get("position" if unit == "m" else "orientation")
    if poses is None or document["command"] == "predict":
        return None
    if "errors_m" not in poses:
        if part is None or f"errors_{unit}" not in part:
            return None
        errors = vectors(part[f"errors_{unit}"])
        return Stages(poses, np.ones(len(errors)), [("after", "measured", errors)])
    columns, is_apart = poses[f"errors_{unit}"], document.get("poses_apart") is not None
    if columns is None:
        return None
    held_out = columns["held_out_after"] is not None
    labels = [*SHORT_STAGES[document["command"]].items()][: 2 if document.get("findings") == [] else 3]
    stages = [(role, label, vectors(columns[f"{'held_out_' * held_out}{role}"])) for role, label in labels]
    used = np.array(poses["used"] or np.ones(len(columns["nominal"])), dtype=np.float64)
    return Stages(poses, used, stages, held_out or is_apart)


# Cumulative distributions of the errors by stage, with the limits.

_STEPS = 400
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 1.0)
_WIDE_RANGE = 12.0
"""Ratio of the largest error to the smallest median from which the scale is logarithmic."""


def distribution_charts(document: Document) -> Iterator[Chart]:
    """Return the distribution of position errors, and of orientation errors if measured."""
    for unit, name in (("m", "position"), ("rad", "orientation")):
        if curves := _curves(document, unit):
            yield _distribution_chart(document, name, unit, curves)


def _curves(document: Document, unit: str) -> Sequence[Curve]:
    if document["command"] == "predict":
        part = document["position" if unit == "m" else "orientation"]
        named = (("after", "predicted rms", "pose_rms"), ("before", "predicted 95 % radius", "pose_radius95"))
        present = [each for each in named if f"{each[2]}_{unit}" in part]
        return [(role, f"{label} by pose", numbers(part[f"{key}_{unit}"])) for role, label, key in present]
    stages = stages_of(document, unit)
    return () if stages is None else stages.sizes(stages.used > 0)


def _distribution_chart(document: Document, name: str, si_unit: str, curves: Sequence[Curve]) -> Chart:
    unit = error_unit(si_unit, max(float(sizes.max()) for _, _, sizes in curves))
    limits = limits_of(document, si_unit)
    errors, meaning = stages_of(document, "m"), STAGE_MEANINGS.get(document["command"], "")
    title = f"Distribution of the {'predicted ' * (document['command'] == 'predict')}{name} error"
    medians = [(label, unit.text(float(np.median(sizes)))) for _, label, sizes in curves]
    caption = (
        f"Share of {'held-out poses' if errors is not None and errors.held_out else 'all poses'} with "
        f"{'an' if name[0] in 'aeiou' else 'a'} {name} error up to the given size. Curves further left are better. "
        f"{meaning[:1].upper()}{meaning[1:]}{'. ' * bool(meaning)}"
        f"Half of the poses are within {', '.join(f'{median} ({label})' for label, median in medians)}."
    )
    if limits:
        caption += (
            f" Vertical lines are limits: {', '.join(f'{label} {unit.text(size)}' for label, _, size in limits)}."
        )
    rows = [
        [f"{100 * share:.0f} %", *(unit.text(float(np.quantile(sizes, share))) for _, _, sizes in curves)]
        for share in _QUANTILES
    ]
    series = []
    for role, label, sizes in curves:
        ordered, share = np.sort(sizes) * unit.factor, np.arange(1, sizes.size + 1) / sizes.size
        pick = thinned(_STEPS, ordered)
        # The corners of the steps, from no pose up.
        x, y = np.repeat(ordered[pick], 2), 100 * np.repeat(np.append(0.0, share[pick]), 2)[1:-1]
        series.append(Series((x, y), role, label, line=_DASHES[role], width=1.6))
    x_axis = error_axis(f"{name} error, {unit.name}", [sizes * unit.factor for _, _, sizes in curves])
    rules = [(size * unit.factor, short_label) for _, short_label, size in limits]
    return Chart(
        "distribution" if name == "position" else "distribution-orientation",
        title,
        caption,
        f"{title}: share of poses, 0 to 100 %, over the size of the error in {unit.name}. "
        + "; ".join(f"{label}: median {median}" for label, median in medians),
        [Panel((replace(x_axis, rules=rules), Axis("share of poses, %", 0, 101)), series)],
        Grid(("share of poses", *(label for _, label, _ in curves)), rows),
    )


def error_axis(title: str, curves: Sequence[Array]) -> Axis:
    """Return an axis from zero, or a logarithmic axis if the sizes of errors have a wide range."""
    top, low = max(float(sizes.max()) for sizes in curves), min(float(np.median(sizes)) for sizes in curves)
    if low <= 0 or top / low <= _WIDE_RANGE:
        return Axis(title, 0, top * 1.04 or 1.0)
    smallest = min(float(np.quantile(sizes, 0.02)) for sizes in curves)
    return Axis(title, max(smallest, low / 30) / 1.3, top * 1.3, is_log=True)


# Errors over time or row order, which show a drift, a step change or a warm-up.

_TIME_POINTS = 700
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
    # The errors of the nominal model are much larger.
    stages = [stage for stage in errors.sizes() if stage[0] != "nominal"]
    labels, sizes = [label for _, label, _ in stages], [own for _, _, own in stages]
    rows, listed = thinned(_TIME_POINTS, x, *sizes), thinned(_ROWS, x, sizes[-1])
    unit = error_unit("m", float(np.max(sizes)))
    over = "time, s" if timed else "line of the file"
    order = "" if timed else " The order of the lines is the order of time only if the file was written so."
    worst = int(np.argmax(sizes[-1]))
    largest, at = unit.text(float(sizes[-1][worst])), place(errors.poses, worst)
    used = errors.used > 0
    # All inliers are in the chart; outliers off scale stand at its upper edge.
    inliers = rows[used[rows]] if used[rows].any() else rows
    top = 1.08 * float(np.array(sizes)[:, inliers].max()) * unit.factor or 1.0
    looks: dict[str, Any] = {"after": {"size": 2.8}, "before": {"size": 3.4, "hollow": True, "width": 0.8}}
    series = [
        Series((x[rows], own[rows] * unit.factor), role, label, marker="o", **looks[role])
        for role, label, own in stages
    ]
    beyond = sizes[-1] * unit.factor > top
    for mark, chosen, label in (("x", ~used & ~beyond, "outlier"), ("^", ~used & beyond, "outlier, off scale")):
        if (those := rows[chosen[rows]]).size:
            y = np.minimum(sizes[-1][those] * unit.factor, 0.97 * top)
            series.append(Series((x[those], y), "ink", label, marker=mark, size=6))
    yield Chart(
        "time",
        f"Position error over {'time' if timed else 'the lines of the file'}",
        f"Each pose's error ({' and '.join(labels)}) over {over}. The largest is at {at}, "
        f"{largest}.{order}{thinning_note(rows.size, x.size)}",
        f"Scatter of position error in {unit.name} over {over}; largest {largest} at {at}",
        [Panel((Axis(over), Axis(f"position error, {unit.name}", 0, top)), series)],
        Grid(
            ("pose", over, *labels),
            [[place(errors.poses, int(i)), f"{x[i]:g}", *(unit.text(float(own[i])) for own in sizes)] for i in listed],
            note=f"{listed.size} of {x.size} poses; the JSON result has all of them." * (listed.size < x.size),
        ),
        (4.9, 2.9),
    )
