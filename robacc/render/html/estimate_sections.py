"""What `estimate` says beside its pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from robacc.render.html.blocks import Block, Cell, Grid, Listing, Number, ReportSection, Text, angle, interval, length
from robacc.render.html.fit_sections import parameter_row
from robacc.render.plots.chart import Document
from robacc.render.plots.units import DEGREE, MILLIMETRE, Unit, length_unit
from robacc.render.text.numbers import p_value, three_digits

_FIGURES = (("rms", "rms"), ("mean", "mean_error"), ("95th percentile", "p95"), ("largest", "max"))


def estimate_sections(document: Document) -> Iterator[ReportSection]:
    """Position, orientation, grade, worst poses."""
    yield _quantity(document, "position", "m", length, MILLIMETRE)
    if document["orientation"] is not None:
        yield _quantity(document, "orientation", "rad", angle, DEGREE)
    yield _grade(document)
    yield _worst(document)
    if document["alignment"] is not None:
        yield _alignment(document)


def _quantity(document: Document, part: str, unit: str, show: Callable[..., Number], coarse: Unit) -> ReportSection:
    found = document[part]
    before = (document["unaligned"] or {}).get(part)
    rows: list[Sequence[Cell]] = []
    for label, key in _FIGURES:
        bounds = found["intervals"][f"{key}_{unit}"]
        value = found[f"{key}_{unit}"]
        by = length_unit(value) if unit == "m" else DEGREE
        told = interval(value, bounds["lower"], bounds["upper"], bounds["confidence"], by)
        earlier = [] if before is None else [show(before[f"{key}_{unit}"])]
        rows.append([label, show(value, bounds["lower"], bounds["upper"]), told or "–", *earlier])
    header = ("length of the error", "value", "interval", *(("unaligned",) if before is not None else ()))
    blocks: list[Block] = [
        Grid(header, rows),
        _matrices(found, unit, coarse),
        _axes(found, unit),
        _tests(found),
        Listing([found["assumption"], found["pose_structure"]["text"]]),
    ]
    return ReportSection(f"{part.capitalize()} error", blocks)


def _matrices(found: Mapping[str, Any], unit: str, coarse: Unit) -> Grid:
    square = coarse.factor**2
    rows: list[Sequence[Cell]] = []
    for key, words in (("covariance", "about zero"), ("centred_covariance", "about the mean")):
        for axis, row in zip("xyz", found[f"{key}_{unit}2"], strict=True):
            rows.append([f"{words}, {axis}", *(Number(three_digits(value * square), value) for value in row)])
    return Grid((f"covariance, {coarse.name}²", "x", "y", "z"), rows)


def _axes(found: Mapping[str, Any], unit: str) -> Grid:
    rows: list[Sequence[Cell]] = []
    for number, axis in enumerate(found["ellipsoid"], 1):
        sd, bounds = axis[f"sd_{unit}"], axis["interval"]
        show, by = (length, length_unit(sd)) if unit == "m" else (angle, DEGREE)
        told = interval(sd, bounds["lower"], bounds["upper"], bounds["confidence"], by)
        direction = [f"{value:+.2f}" for value in axis["direction"]]
        rows.append([str(number), show(sd, bounds["lower"], bounds["upper"]), told or "–", *direction])
    return Grid(("principal axis", "standard deviation", "interval", "x", "y", "z"), rows)


def _tests(found: Mapping[str, Any]) -> Grid:
    tests = found["tests"].values()
    rows = [[test["method"], test["why"] if test["p_value"] is None else p_value(test["p_value"])] for test in tests]
    return Grid(("test of an assumption", "result"), rows)


def _grade(document: Document) -> ReportSection:
    grade = document["grade"]
    rows: list[Sequence[Cell]] = [
        [step["grade"], length(step["position_m"]), angle(step["orientation_rad"])] for step in grade["steps"]
    ]
    words = [sentence for sentence in grade["reason"].split(". ") if sentence]
    header = (f"grade, by {grade['statistic']}", "position within", "orientation within")
    return ReportSection(f"Grade {grade['grade']}", [Listing(words), Grid(header, rows)])


def _worst(document: Document) -> ReportSection:
    blocks: list[Block] = []
    for key, words in (("by_position", "by position"), ("by_orientation", "by orientation")):
        rows = [_pose(one) for one in document["worst_poses"][key]]
        if rows:
            blocks.append(Grid((f"largest, {words}", "position", "orientation"), rows))
    for target in document["targets"]:
        blocks.append(Text(f"Target {target['target']}: {target['n_poses']} poses, rms {length(target['rms_m'])}."))
    return ReportSection("Poses to look at", blocks)


def _pose(one: Mapping[str, Any]) -> list[Cell]:
    words = [f"line {one['line']}", *(f"{name} {one[name]}" for name in ("pose", "target") if one[name] is not None)]
    return [", ".join(words), length(one["error_m"]), angle(one["error_rad"])]


def _alignment(document: Document) -> ReportSection:
    alignment = document["alignment"]
    rows = [parameter_row(one) for one in alignment["parameters"] if one["std"] is not None]
    blocks: list[Block] = [Grid(("parameter", "value", "standard error", "unit"), rows)]
    without = [[one["name"], str(one["why"])] for one in alignment["parameters"] if one["std"] is None]
    if without:
        blocks.append(Grid(("parameter without a number", "why"), without, words=True))
    return ReportSection("Alignment", blocks)
