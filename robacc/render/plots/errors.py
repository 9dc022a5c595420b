"""Charts of errors: their distributions, ellipsoids, course over time, and stages."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.render.plots.canvas import (
    LIGHT,
    Array,
    Chart,
    ChartTable,
    Document,
    Limit,
    Rows,
    Scene3D,
    Unit,
    error_unit,
    length_unit,
    lengths,
    limits_of,
    numbers,
    place,
    short,
    thinned,
    thinning_note,
    vectors,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Charts of the errors and of the ellipsoids of their covariance, in the tool frame and in the measuring frame.

SHARES = ((0.5, 1.538172), (0.95, 2.795483))
"""Shares of a Gaussian, and the square roots of the chi-square quantiles of three degrees of freedom."""
_ELLIPSOID_POINTS = 500
_FRAMES = {
    "tool": ("in the tool frame", "errors fixed to the tool keep their direction in this frame"),
    "base": ("in the measuring frame", "errors of the base or the instrument keep their direction in this frame"),
}
_PLANES = ((0, 1), (0, 2), (1, 2))


def ellipsoid_charts(document: Document) -> Iterator[Chart]:
    """Return a chart for each frame; for a prediction, the mean covariance in the tool frame."""
    for frame, part in (document.get("position_by_frame") or {}).items():
        yield _ellipsoids_chart(
            frame, part, vectors(part["errors_m"]), numbers(part["mean_m"]), "centred_covariance_m2"
        )
    if document["command"] == "predict":
        yield _ellipsoids_chart("tool", document["position"], np.zeros((0, 3)), np.zeros(3), "mean_covariance_m2")


def _ellipsoids_chart(frame: str, part: Mapping[str, Any], errors: Array, mean: Array, key: str) -> Chart:
    covariance = vectors(part[key])
    sd = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance)[::-1], 0.0))
    reach = float(max(np.abs(errors).max(initial=0.0), SHARES[1][1] * sd[0]))
    unit = length_unit(reach)
    where, meaning = _FRAMES[frame]
    rows = thinned(_ELLIPSOID_POINTS, *errors.T) if len(errors) else np.zeros(0, dtype=np.int64)
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
        lambda figure: _draw_ellipsoids(figure, errors[rows], mean, covariance, unit),
        _ellipsoids_table(part, key, unit),
        (4.9, 4.6),
        _scene(errors[rows], mean, covariance, unit),
    )


def _ellipsoids_table(part: Mapping[str, Any], key: str, unit: Unit) -> ChartTable:
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


def _draw_ellipsoids(figure: Figure, errors: Array, mean: Array, covariance: Array, unit: Unit) -> None:
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


# The errors of a result's poses by stage: nominal model, baseline, extended model.

STAGE_LABELS = {
    "trace": {"nominal": "nominal, registered", "before": "baseline", "after": "extended model"},
    "calibrate": {"nominal": "nominal, registered", "before": "baseline", "after": "calibrated"},
}
STAGE_MEANINGS = {
    "trace": "baseline: declared effects fitted; extended model: findings added",
    "calibrate": "baseline: base and tool fitted; calibrated: all named effects fitted",
}


@dataclass(frozen=True, slots=True)
class StageErrors:
    """The errors of one stage."""

    role: str
    """``nominal``, ``before`` or ``after``: its colour."""
    label: str
    errors: Array
    """``(N, 3)`` m or rad."""

    @property
    def sizes(self) -> Array:
        """Return the lengths ``(N,)`` of the errors."""
        return lengths(self.errors)


@dataclass(frozen=True, slots=True)
class ErrorsByStage:
    """The stages of one result, of the same poses."""

    poses: Mapping[str, Any]
    """Columns of the poses, with as many rows as the errors."""
    used: Array
    """``(N,)``, 1 for inliers and 0 for outliers."""
    stages: tuple[StageErrors, ...]
    held_out: bool
    """True if the models of baseline and extended model were fitted without the pose."""

    @property
    def last(self) -> StageErrors:
        """Return the last stage of the result."""
        return self.stages[-1]


def stages_of(document: Document, unit: str) -> ErrorsByStage | None:
    """Return the errors in ``m`` or ``rad``, None if the result has none."""
    poses = document.get("poses_apart") or document.get("poses")
    if poses is None or document["command"] == "predict":
        return None
    if "errors_m" in poses:
        return _of_fit(document, poses, unit)
    part = document.get("position" if unit == "m" else "orientation")
    if part is None or f"errors_{unit}" not in part:
        return None
    errors = vectors(part[f"errors_{unit}"])
    return ErrorsByStage(poses, np.ones(len(errors)), (StageErrors("after", "measured", errors),), False)


def _of_fit(document: Document, poses: Mapping[str, Any], unit: str) -> ErrorsByStage | None:
    columns = poses[f"errors_{unit}"]
    if columns is None:
        return None
    held_out = columns["held_out_after"] is not None
    names = {
        "nominal": "held_out_nominal" if held_out else "nominal",
        "before": "held_out_before" if held_out else "before",
        "after": "held_out_after" if held_out else "after",
    }
    n = len(columns["nominal"])
    used = np.ones(n) if poses["used"] is None else np.array(poses["used"], dtype=np.float64)
    roles = ["nominal", "before"] if document.get("findings") == [] else list(names)
    labels = STAGE_LABELS[document["command"]]
    stages = tuple(StageErrors(role, labels[role], vectors(columns[names[role]])) for role in roles)
    return ErrorsByStage(poses, used, stages, held_out or document.get("poses_apart") is not None)


# Cumulative distributions of the errors by stage, with the limits.

_STEPS = 400
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 1.0)
_DASHES = {"nominal": (0, (1, 1.2)), "before": (0, (5, 1.6)), "after": "-"}
_WIDE_RANGE = 12.0
"""Ratio of the largest error to the smallest median from which the scale is logarithmic."""
_MAX_RANGE = 1000.0
"""Range of a logarithmic scale from which its labels at 2 and 5 would overlap."""


def distribution_charts(document: Document) -> Iterator[Chart]:
    """Return the distribution of position errors, and of orientation errors if measured."""
    for unit, name in (("m", "position"), ("rad", "orientation")):
        curves = _curves(document, unit)
        if curves:
            yield _distribution_chart(document, name, unit, curves)


Curves = Sequence[tuple[str, str, Array]]
"""Role, label, sizes."""


def _curves(document: Document, unit: str) -> Curves:
    if document["command"] == "predict":
        part = document["position" if unit == "m" else "orientation"]
        if f"pose_rms_{unit}" not in part:
            return ()
        return (
            ("after", "predicted rms by pose", numbers(part[f"pose_rms_{unit}"])),
            ("before", "predicted 95 % radius by pose", numbers(part[f"pose_radius95_{unit}"])),
        )
    errors = stages_of(document, unit)
    if errors is None:
        return ()
    used = errors.used > 0
    return tuple((stage.role, stage.label, stage.sizes[used]) for stage in errors.stages)


def _distribution_chart(document: Document, name: str, unit: str, curves: Curves) -> Chart:
    largest = max(float(sizes.max()) for _, _, sizes in curves)
    shown_unit = error_unit(unit, largest)
    limits = limits_of(document, unit)
    kind = "distribution" if name == "position" else "distribution-orientation"
    predicted = document["command"] == "predict"
    title = f"Distribution of the {'predicted ' if predicted else ''}{name} error"
    return Chart(
        kind,
        title,
        _caption(document, name, curves, limits, shown_unit),
        f"{title}: share of poses, 0 to 100 %, over the size of the error in {shown_unit.name}. "
        + "; ".join(f"{label}: median {shown_unit.text(float(np.median(sizes)))}" for _, label, sizes in curves),
        lambda figure: _draw_distribution(figure, name, curves, limits, shown_unit),
        _distribution_table(curves, shown_unit),
    )


def _caption(document: Document, name: str, curves: Curves, limits: Sequence[Limit], unit: Unit) -> str:
    errors = stages_of(document, "m")
    pose_set = "held-out poses" if errors is not None and errors.held_out else "all poses"
    article = "an" if name[0] in "aeiou" else "a"
    text = f"Share of {pose_set} with {article} {name} error up to the given size. Curves further left are better. "
    text += _meaning(document)
    medians = [f"{unit.text(float(np.median(sizes)))} ({label})" for _, label, sizes in curves]
    text += f"Half of the poses are within {', '.join(medians)}."
    if limits:
        text += (
            f" Vertical lines are limits: {', '.join(f'{limit.label} {unit.text(limit.value)}' for limit in limits)}."
        )
    return text


def _meaning(document: Document) -> str:
    meaning = STAGE_MEANINGS.get(document["command"])
    return "" if meaning is None else f"{meaning[0].upper()}{meaning[1:]}. "


def _distribution_table(curves: Curves, unit: Unit) -> ChartTable:
    rows = []
    for share in _QUANTILES:
        values = [unit.text(float(np.quantile(sizes, share))) for _, _, sizes in curves]
        rows.append([f"{100 * share:.0f} %", *values])
    return ChartTable(("share of poses", *(label for _, label, _ in curves)), rows)


def _draw_distribution(figure: Figure, name: str, curves: Curves, limits: Sequence[Limit], unit: Unit) -> None:
    axes = figure.add_subplot()
    for role, label, sizes in curves:
        ordered = np.sort(sizes) * unit.factor
        share = np.arange(1, ordered.size + 1) / ordered.size
        pick = thinned(_STEPS, ordered)
        axes.step(
            np.concatenate((ordered[pick][:1], ordered[pick])),
            100 * np.concatenate(([0.0], share[pick])),
            where="post",
            color=LIGHT[role],
            linestyle=_DASHES[role],
            label=label,
        )
    _scale(axes, curves, unit)
    left, right = axes.get_xlim()
    for limit in limits:
        value = limit.value * unit.factor
        if left < value < right:
            axes.axvline(value, color=LIGHT["limit"], linewidth=0.9, linestyle=(0, (3, 2)))
            axes.annotate(
                short(limit.short_label, 16),
                (value, 1.0),
                (0, 3),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                ha="center",
                va="bottom",
                fontsize=8,
                annotation_clip=False,
            )
    axes.set(ylim=(0, 101), ylabel="share of poses, %", xlabel=f"{name} error, {unit.name}")
    figure.legend(loc="outside upper center", ncols=len(curves))


def _scale(axes: Axes, curves: Curves, unit: Unit) -> None:
    from matplotlib.ticker import LogLocator

    top = max(float(sizes.max()) for _, _, sizes in curves) * unit.factor
    low = min(float(np.median(sizes)) for _, _, sizes in curves) * unit.factor
    if low > 0 and top / low > _WIDE_RANGE:
        smallest = min(float(np.quantile(sizes, 0.02)) for _, _, sizes in curves) * unit.factor
        axes.set_xscale("log")
        ends = max(smallest, low / 30) / 1.3, top * 1.3
        subs = (1.0,) if ends[1] / ends[0] > _MAX_RANGE else (1.0, 2.0, 5.0)
        axes.xaxis.set_major_locator(LogLocator(subs=subs))
        # The style does not parse formulas, so labels are plain numbers.
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter("")
        axes.set_xlim(*ends)
    else:
        axes.set_xlim(0, top * 1.04 or 1.0)


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
    stages = _shown_stages(errors)
    sizes = [stage.sizes for stage in stages]
    rows = thinned(_TIME_POINTS, x, *sizes)
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
        lambda figure: _draw_over_time(figure, errors, x, rows, unit, over),
        _time_table(errors, x, unit, over),
        (4.9, 2.9),
    )


def _time_table(errors: ErrorsByStage, x: Array, unit: Unit, over: str) -> ChartTable:
    stages = _shown_stages(errors)
    rows = thinned(_ROWS, x, stages[-1].sizes)
    columns = [[unit.text(value) for value in stage.sizes[rows].tolist()] for stage in stages]
    names = [place(errors.poses, int(i)) for i in rows]
    return ChartTable(
        ("pose", over, *(stage.label for stage in stages)),
        [list(row) for row in zip(names, (f"{v:g}" for v in x[rows].tolist()), *columns, strict=True)],
        f"{rows.size} of {x.size} poses; the JSON result has all of them." if rows.size < x.size else "",
    )


def _draw_over_time(figure: Figure, errors: ErrorsByStage, x: Array, rows: Rows, unit: Unit, over: str) -> None:
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
