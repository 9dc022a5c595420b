"""The sections of a `predict` report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robacc.render.html.blocks import Block, Cell, Grid, Listing, ReportSection, Text, angle, length
from robacc.render.plots.chart import Document
from robacc.render.text.numbers import p_value


def predict_sections(document: Document) -> Iterator[ReportSection]:
    """Return errors, grade, allocation, and the comparison with measured poses."""
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
        worst_pose = document[part]["worst"]
        direction = ", ".join(f"{value:+.2f}" for value in worst_pose["direction"])
        worst.append(
            [
                part,
                worst_pose["label"],
                show(worst_pose[f"rms_{unit}"]),
                show(worst_pose[f"radius95_{unit}"]),
                direction,
            ]
        )
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
    text = f"Grade of the position {grade['position']}, of the orientation {grade['orientation']}{limited}."
    return ReportSection(f"Grade {grade['grade']}, expected", [Text(text), Grid(("grade", "poses that meet it"), rows)])


def _allocation(allocation: Mapping[str, Any]) -> ReportSection:
    rows: list[Sequence[Cell]] = [
        [
            tolerance["parameter"],
            _size(tolerance["given_sd"], tolerance),
            _size(tolerance["needed_sd"], tolerance),
            f"{tolerance['factor']:.3g}",
        ]
        for tolerance in allocation["tolerances"]
    ]
    reached = "would reach" if allocation["met"] else "would not reach"
    text = (
        f"Tolerances that {reached} grade {allocation['grade']}; with one factor for all tolerances, this factor is "
        f"{allocation['uniform_factor']:.3g}."
    )
    return ReportSection("Tolerances needed", [Text(text), Grid(("parameter", "given", "needed", "factor"), rows)])


def _size(value: float | None, tolerance: Mapping[str, Any]) -> Cell:
    return angle(value) if tolerance["unit"] == "rad" else length(value)


def _against(comparison: Mapping[str, Any]) -> ReportSection:
    measured = comparison["measured"]
    lines = [
        f"verdict over {comparison['n_poses']} measured poses: {str(comparison['verdict']).replace('_', ' ')}",
        f"measured rms {length(measured['position_rms_m'])} in position",
    ]
    if measured["orientation_rms_rad"] is not None:
        lines[-1] += f", {angle(measured['orientation_rms_rad'])} in orientation"
    if comparison["hint"]:
        lines.append(comparison["hint"])
    rows: list[Sequence[Cell]] = [
        [name, f"{test['ratio']:.3g}", p_value(test["p_value"])]
        for name, test in comparison["normalised_squared_error"].items()
        if test is not None and test.get("p_value") is not None and test.get("ratio") is not None
    ]
    blocks: list[Block] = [Listing(lines)]
    if rows:
        blocks.append(Grid(("normalised squared error", "ratio to the expected value", "significance"), rows))
    return ReportSection("Predicted against measured", blocks)
