"""Charts of a plan: its poses in space, the predicted error over the number of poses, detection limits."""

from __future__ import annotations

import dataclasses
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
    Scene3D,
    coordinates,
    fit_box,
    length_unit,
    line_trace,
    numbers,
    plain,
    vectors,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# The poses of a plan in space, by their role, with the route of the visits.

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


def plan_charts(document: Document) -> Iterator[Chart]:
    """Return the charts of a plan."""
    yield planned_poses_chart(document)
    accuracy = document["accuracy"]
    if accuracy is not None and len(accuracy["curve"]) > 1:
        yield _accuracy_chart(accuracy)
    families = effect_families(document)
    if families:
        yield _limits_chart(families)


def _accuracy_chart(accuracy: Mapping[str, Any]) -> Chart:
    points, knee, planned = accuracy["curve"], accuracy["knee"], accuracy["planned"]
    unit = length_unit(*(point["total_rms_m"] for point in points))
    if knee is None:
        ending = "Ten more poses still reduce it by more than 10 %."
    else:
        ending = f"From {knee} poses on (the knee), ten more reduce it by less than 10 %."
    at_plan = "" if planned is None else f" The plan of {planned['n_poses']} poses has {unit.text(planned['rms_m'])}."
    return Chart(
        "expected-accuracy",
        "Predicted error over the number of poses",
        f"Predicted rms position error of the calibrated model over the task, for planned and random poses.{at_plan}"
        f" The upper line adds what no fit removes: repeatability and unexplained error. {ending}",
        f"Predicted error in {unit.name} over the number of poses, planned below random; knee at {knee or 'none'}",
        lambda figure: _draw_accuracy(figure, points, knee, planned, unit.factor, unit.name),
        ChartTable(
            ("poses", "rms", "random poses, rms", "worst", "with repeatability, rms"),
            [
                [
                    str(point["n_poses"]),
                    *(unit.text(point[key]) for key in ("rms_m", "random_rms_m", "worst_m", "total_rms_m")),
                ]
                for point in points
            ],
        ),
        (4.9, 3.0),
    )


def _draw_accuracy(
    figure: Figure,
    points: Sequence[Mapping[str, Any]],
    knee: int | None,
    planned: Mapping[str, Any] | None,
    factor: float,
    unit: str,
) -> None:
    axes = figure.add_subplot()
    n = [point["n_poses"] for point in points]
    lines = (
        ("total_rms_m", "with repeatability", "nominal", "-", "s"),
        ("random_rms_m", "random poses", "before", "--", "^"),
        ("rms_m", "planned poses", "after", "-", "o"),
    )
    for key, label, role, style, marker in lines:
        values = numbers(point[key] for point in points) * factor
        axes.plot(n, values, marker, ls=style, ms=3.4, color=LIGHT[role], label=label)
    if planned is not None:
        axes.plot(
            planned["n_poses"], planned["rms_m"] * factor, "o", ms=8, mfc="none", color=LIGHT["ink"], label="this plan"
        )
    if knee is not None:
        axes.axvline(knee, color=LIGHT["limit"], linewidth=1.1, linestyle=(0, (3, 2)), label=f"knee, {knee} poses")
    axes.set(xlabel="number of poses", ylabel=f"predicted error, {unit}", ylim=(0, None))
    figure.legend(loc="outside upper center", ncols=3, columnspacing=1.0)


@dataclass(frozen=True, slots=True)
class EffectFamily:
    """Detection limits of one effect over its joints and forms."""

    name: str
    unit: str
    usual: float
    limits: Array
    """Limits that exist, ascending; empty where no form of the effect is ever found."""
    power: float
    """Mean probability that the usual size is found."""

    @property
    def ends(self) -> tuple[float, float] | None:
        """Lowest and highest limit as multiples of the usual size."""
        return (float(self.limits[0] / self.usual), float(self.limits[-1] / self.usual)) if self.limits.size else None


def effect_families(document: Document) -> list[EffectFamily]:
    """Return the detection limits by effect, those found most surely first."""
    by_name: dict[str, list[Mapping[str, Any]]] = {}
    for limit in document["detection_limits"] or ():
        by_name.setdefault(limit["effect"], []).append(limit)
    families = [
        EffectFamily(
            name,
            entries[0]["unit"],
            entries[0]["usual_size"],
            np.sort(numbers(entry["limit"] for entry in entries if entry["limit"] is not None)),
            float(np.mean([entry["power"] for entry in entries])),
        )
        for name, entries in by_name.items()
    ]
    return sorted(families, key=lambda family: -family.power)


def _limits_chart(families: Sequence[EffectFamily]) -> Chart:
    detectable = [family for family in families if family.ends is not None]
    sure = sum(family.power >= 0.5 for family in families)
    rows = [
        [
            family.name,
            *([f"{family.limits[0]:.1e}", f"{family.limits[-1]:.1e}"] if family.ends else ["–", "–"]),
            family.unit,
            f"{family.usual:.1e}",
            f"{100 * family.power:.0f} %",
        ]
        for family in families
    ]
    return Chart(
        "detection-limits",
        "Detection limits",
        "Size of each effect that a trace of these poses finds with probability 1/2, over its usual size; a line joins "
        f"the most and the least visible joint. Left of 1, the usual size is found. {sure} of {len(families)} effects "
        "are found at their usual size with a mean probability of at least 1/2.",
        f"Ranges of detection limits over usual sizes for {len(detectable)} effects, logarithmic",
        lambda figure: _draw_limits(figure, detectable),
        ChartTable(("effect", "lowest limit", "highest", "unit", "usual size", "mean power"), rows),
        (4.9, 0.9 + 0.24 * max(len(detectable), 3)),
    )


def _draw_limits(figure: Figure, families: Sequence[EffectFamily]) -> None:
    axes = figure.add_subplot()
    for place, family in enumerate(reversed(families)):
        assert family.ends is not None
        role = "after" if family.power >= 0.5 else "before"
        axes.plot(
            family.ends, (place, place), "-o", color=LIGHT[role], ms=4, mfc=LIGHT[role] if role == "after" else "none"
        )
    axes.axvline(1.0, color=LIGHT["limit"], linewidth=1.1, linestyle=(0, (3, 2)))
    axes.set(xscale="log", xlabel="detection limit over the usual size", ylim=(-0.7, len(families) - 0.3))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_yticks(range(len(families)), [family.name for family in reversed(families)])
    axes.grid(axis="y", visible=False)
