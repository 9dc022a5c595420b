"""The sections of a `correct` report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robacc.render.html.blocks import Block, Cell, Grid, ReportSection, Text, angle, length
from robacc.render.plots.chart import Document

_LISTED = 40
"""Refused targets that the page lists."""


def correct_sections(document: Document) -> Iterator[ReportSection]:
    """Return corrections and expected errors, and the targets that are not corrected."""
    yield _figures(document)
    if document["n_refused"]:
        yield _refused(document)


def _figures(document: Document) -> ReportSection:
    correction, expected = document["correction"], document["expected"]
    rows: list[Sequence[Cell]] = [_row("correction", correction, "rms", "max")]
    for stage in ("before", "after"):
        rows.append(_row(f"expected error {stage}", expected[stage], "expected_rms", "largest_bound95"))
    blocks: list[Block] = [
        Text("Over the corrected targets. The largest expected error is the largest bound of 95 % of the errors."),
        Grid(("", "position, rms", "largest", "orientation, rms", "largest"), rows),
    ]
    grades = [
        [f"grades {stage}", ", ".join(f"{name} {count}" for name, count in expected[stage]["grades"].items() if count)]
        for stage in ("before", "after")
        if expected[stage]["grades"]
    ]
    if grades:
        blocks.append(Grid(("", "targets"), grades, is_text=True))
    return ReportSection("Corrections", blocks)


def _row(label: str, part: Mapping[str, Any], typical: str, largest: str) -> list[Cell]:
    cells: list[Cell] = [label]
    for name, unit, show in (("position", "m", length), ("orientation", "rad", angle)):
        figures = part[name] or {}
        cells += [show(figures.get(f"{key}_{unit}")) for key in (typical, largest)]
    return cells


def _refused(document: Document) -> ReportSection:
    targets = document["targets"]
    rows = [
        [str(line), reason]
        for line, reason in zip(targets["line"], targets["reason"], strict=True)
        if reason is not None
    ]
    more = [Text(f"The first {_LISTED} of {len(rows)}.")] if len(rows) > _LISTED else []
    return ReportSection("Not corrected", [Grid(("line", "reason"), rows[:_LISTED], is_text=True), *more])
