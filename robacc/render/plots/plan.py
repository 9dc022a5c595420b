"""Charts of a plan: its poses in space, the predicted error over the number of poses, detection limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from robacc.render.plots.canvas import CUBE, SPACE, Array, Axis, Chart, Panel, Series, numbers, scene, vectors
from robacc.render.plots.workspace import arm_of
from robacc.render.text.layout import Document, error_unit
from robacc.render.views.elements import EffectFamily, Grid, effect_families

# The poses of a plan in space, by their role, with the route of the visits.

_ROWS = 80
"""Visits that the table lists."""
_PAYLOAD_ROLES = ("after", "third", "fourth", "before", "nominal")


def plan_charts(document: Document) -> Iterator[Chart]:
    """Return the charts of a plan."""
    yield _planned_poses_chart(document)
    accuracy = document["accuracy"]
    if accuracy is not None and len(accuracy["curve"]) > 1:
        yield _accuracy_chart(accuracy)
    if families := sorted(effect_families(document), key=lambda family: -family.power):
        yield _limits_chart(families)


def _planned_poses_chart(document: Document) -> Chart:
    """Return the chart of the visits in the base frame."""
    visits = document["visits"]
    at = vectors(visits["target_in_base_m"])
    groups, arm = list(_groups(document, at)), arm_of(document)
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
        for i, name in enumerate(visits["pose"][:_ROWS])
    ]
    return Chart(
        "planned-poses",
        "Planned poses in space",
        f"Target positions in the base frame: {counts}. The thin line is the route of the {len(at)} visits"
        f"{', the grey line the arm at a typical pose' if arm else ''}.",
        f"Points of {counts} in x, y, z in m of the base frame, joined by the route",
        [Panel(SPACE, series)],
        Grid(
            ("visit", "pose", "role", *(("payload, kg",) * (payloads is not None)), "x, m", "y, m", "z, m"),
            rows,
            note=f"The first {_ROWS} of {len(at)} visits; the CSV has all of them." * (len(at) > _ROWS),
        ),
        CUBE,
        scene=scene(series, ", point at a pose to see its visit"),
    )


def _groups(document: Document, at: Array) -> Iterator[Series]:
    """Yield the poses by role and payload: each pose has one mark."""
    visits, blocks, validation = document["visits"], document["payloads"], document["validation"]
    names, roles = np.array(visits["pose"]), np.array(visits["role"])
    texts = [f"visit {i + 1}: {name}, {role}" for i, (name, role) in enumerate(zip(names, roles, strict=True))]
    is_single = (roles == "pose") & ~np.isin(names, names[roles == "repeat"])
    chosen: list[tuple[str, str, str, Any]] = [("poses", _PAYLOAD_ROLES[0], "o", is_single)]
    if len(blocks) > 1:
        chosen = [
            (
                f"poses with {each['payload_kg']:g} kg",
                role,
                "o",
                is_single & (np.array(visits["payload_kg"]) == each["payload_kg"]),
            )
            for each, role in zip(blocks, _PAYLOAD_ROLES, strict=False)
        ]
    for role, label, colour, marker in (
        ("repeat", "poses visited twice", "before", "s"),
        ("check", "drift check poses", "limit", "D"),
    ):
        first = np.flatnonzero(roles == role)[np.unique(names[roles == role], return_index=True)[1]]
        chosen.append((label, colour, marker, np.isin(np.arange(names.size), first)))
    for label, colour, marker, mask in chosen:
        rows = np.flatnonzero(mask)
        if rows.size:
            yield _group(at[rows], colour, label, marker, [texts[i] for i in rows])
    if validation is not None:
        points = vectors(validation["target_in_base_m"])
        labels = [f"validation pose {i + 1}" for i in range(len(points))]
        yield _group(points, "nominal", "validation poses", "^", labels)
    if document["instrument_in_base_m"] is not None:
        yield _group(vectors([document["instrument_in_base_m"]]), "ink", "instrument", "*", ["instrument"], 8.0)


def _group(points: Array, role: str, label: str, marker: str, texts: Sequence[str], size: float = 4.5) -> Series:
    is_hollow = marker != "o"
    return Series(points.T, role, label, marker=marker, size=size, hollow=is_hollow, texts=texts, width=1.0)


def _accuracy_chart(accuracy: Mapping[str, Any]) -> Chart:
    points, knee, planned = accuracy["curve"], accuracy["knee"], accuracy["planned"]
    unit = error_unit("m", *(point["total_rms_m"] for point in points))
    ending = "Ten more poses still reduce it by more than 10 %."
    if knee is not None:
        ending = f"From {knee} poses on (the knee), ten more reduce it by less than 10 %."
    n = numbers(point["n_poses"] for point in points)
    series = [
        Series(
            (n, unit.factor * numbers(point[key] for point in points)), role, label, marker=marker, line=line, size=3.4
        )
        for key, label, role, line, marker in (
            ("total_rms_m", "with repeatability", "nominal", "-", "s"),
            ("random_rms_m", "random poses", "before", "--", "^"),
            ("rms_m", "planned poses", "after", "-", "o"),
        )
    ]
    at_plan = ""
    if planned is not None:
        at_plan = f" The plan of {planned['n_poses']} poses has {unit.text(planned['rms_m'])}."
        y = [planned["rms_m"] * unit.factor]
        series.append(Series(([planned["n_poses"]], y), "ink", "this plan", marker="o", size=8, hollow=True))
    rules = [] if knee is None else [(knee, f"knee, {knee} poses")]
    return Chart(
        "expected-accuracy",
        "Predicted error over the number of poses",
        f"Predicted rms position error of the calibrated model over the task, for planned and random poses.{at_plan}"
        f" The upper line adds what no fit removes: repeatability and unexplained error. {ending}",
        f"Predicted error in {unit.name} over the number of poses, planned below random; knee at {knee or 'none'}",
        [Panel((Axis("number of poses", rules=rules), Axis(f"predicted error, {unit.name}", 0)), series)],
        Grid(
            ("poses", "rms", "random poses, rms", "worst", "with repeatability, rms"),
            [
                [str(point["n_poses"])]
                + [unit.text(point[key]) for key in ("rms_m", "random_rms_m", "worst_m", "total_rms_m")]
                for point in points
            ],
        ),
        (4.9, 3.0),
    )


def _limits_chart(families: Sequence[EffectFamily]) -> Chart:
    detectable = [family for family in families if family.known]
    sure = sum(family.power >= 0.5 for family in families)
    series, rows = [], []
    for place, family in enumerate(detectable):
        role = "after" if family.power >= 0.5 else "before"
        ends = numbers(family.known[end]["limit"] for end in (0, -1)) / family.entries[0]["usual_size"]
        series.append(
            Series((ends, [place] * 2), role, marker="o", line="-", size=4, width=1.6, hollow=role == "before")
        )
    for family in families:
        limits = [f"{family.known[end]['limit']:.1e}" if family.known else "–" for end in (0, -1)]
        first = family.entries[0]
        usual, power = f"{first['usual_size']:.1e}", f"{100 * family.power:.0f} %"
        rows.append([family.name, *limits, first["unit"], usual, power])
    return Chart(
        "detection-limits",
        "Detection limits",
        "Size of each effect that a trace of these poses finds with probability 1/2, over its usual size; a line joins "
        f"the most and the least visible joint. Left of 1, the usual size is found. {sure} of {len(families)} effects "
        "are found at their usual size with a mean probability of at least 1/2.",
        f"Ranges of detection limits over usual sizes for {len(detectable)} effects, logarithmic",
        [
            Panel(
                (
                    Axis("detection limit over the usual size", is_log=True, rules=[(1.0, "usual size")]),
                    Axis("", names=[family.name for family in detectable]),
                ),
                series,
            )
        ],
        Grid(("effect", "lowest limit", "highest", "unit", "usual size", "mean power"), rows),
        (4.9, 1.0 + 0.24 * max(len(detectable), 3)),
    )
