"""What `predict` says beside its pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robacc.render.html.blocks import Block, Cell, Grid, Listing, ReportSection, Text, angle, length
from robacc.render.plots.chart import Document
from robacc.render.text.numbers import p_value


def predict_sections(document: Document) -> Iterator[ReportSection]:
    """Figures, grade, allocation, and what measured poses say of the prediction."""
    yield _figures(document)
    yield _grade(document)
    if document["allocation"] is not None:
        yield _allocation(document["allocation"])
    if document["against"] is not None:
        yield _against(document["against"])


def _figures(document: Document) -> ReportSection:
    rows: list[Sequence[Cell]] = []
    labels = (
        ("rms", "rms"),
        ("mean", "mean_error"),
        ("95th percentile", "p95"),
        ("largest 95 % radius", "max_radius95"),
    )
    for label, key in labels:
        rows.append([label, length(document["position"][f"{key}_m"]), angle(document["orientation"][f"{key}_rad"])])
    worst: list[Sequence[Cell]] = []
    for part, unit, show in (("position", "m", length), ("orientation", "rad", angle)):
        one = document[part]["worst"]
        direction = ", ".join(f"{value:+.2f}" for value in one["direction"])
        worst.append([part, one["label"], show(one[f"rms_{unit}"]), show(one[f"radius95_{unit}"]), direction])
    return ReportSection(
        "Predicted error",
        [
            Text(f"Over {document['configurations']}; {document['tolerances']['meaning']}."),
            Grid(("length of the error", "position", "orientation"), rows),
            Grid(("worst pose", "where", "rms", "95 % radius", "worst direction (tool)"), worst),
        ],
    )


def _grade(document: Document) -> ReportSection:
    grade = document["grade"]
    rows = [[name, f"{100 * share:.0f} %"] for name, share in grade["share_of_poses_meeting"].items()]
    limited = f", limited by {' and '.join(grade['limited_by'])}" if grade["limited_by"] else ""
    words = f"Position alone would get {grade['position']}, orientation {grade['orientation']}{limited}."
    return ReportSection(
        f"Grade {grade['grade']}, expected", [Text(words), Grid(("grade", "poses that meet it"), rows)]
    )


def _allocation(found: Mapping[str, Any]) -> ReportSection:
    rows: list[Sequence[Cell]] = [
        [one["parameter"], _size(one["given_sd"], one), _size(one["needed_sd"], one), f"{one['factor']:.3g}"]
        for one in found["tolerances"]
    ]
    reached = "would reach" if found["met"] else "would not reach"
    words = (
        f"Tolerances that {reached} grade {found['grade']}; all scaled alike it takes {found['uniform_factor']:.3g}."
    )
    return ReportSection("Tolerances needed", [Text(words), Grid(("parameter", "given", "needed", "factor"), rows)])


def _size(value: float | None, one: Mapping[str, Any]) -> Cell:
    return angle(value) if one["unit"] == "rad" else length(value)


def _against(found: Mapping[str, Any]) -> ReportSection:
    measured = found["measured"]
    lines = [
        f"verdict over {found['n_poses']} measured poses: {str(found['verdict']).replace('_', ' ')}",
        f"measured rms {length(measured['position_rms_m'])} in position",
    ]
    if measured["orientation_rms_rad"] is not None:
        lines[-1] += f", {angle(measured['orientation_rms_rad'])} in orientation"
    if found["hint"]:
        lines.append(found["hint"])
    rows: list[Sequence[Cell]] = [
        [name, f"{test['ratio']:.3g}", p_value(test["p_value"])]
        for name, test in found["normalised_squared_error"].items()
        if test is not None and test.get("p_value") is not None and test.get("ratio") is not None
    ]
    blocks: list[Block] = [Listing(lines)]
    if rows:
        blocks.append(Grid(("normalised squared error", "over what is expected", "significance"), rows))
    return ReportSection("Predicted against measured", blocks)
