"""The sections of an `estimate` report."""

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
    """Return position, orientation, grade, worst poses and registration."""
    yield _quantity(document, "position", "m", length, MILLIMETRE)
    if document["orientation"] is not None:
        yield _quantity(document, "orientation", "rad", angle, DEGREE)
    yield _grade(document)
    yield _worst(document)
    if document["alignment"] is not None:
        yield _alignment(document)


def _quantity(document: Document, part: str, unit: str, show: Callable[..., Number], coarse: Unit) -> ReportSection:
    statistics = document[part]
    unaligned = (document["unaligned"] or {}).get(part)
    rows: list[Sequence[Cell]] = []
    for label, key in _FIGURES:
        bounds = statistics["intervals"][f"{key}_{unit}"]
        value = statistics[f"{key}_{unit}"]
        shown_unit = length_unit(value) if unit == "m" else DEGREE
        interval_text = interval(value, bounds["lower"], bounds["upper"], bounds["confidence"], shown_unit)
        unaligned_cell = [] if unaligned is None else [show(unaligned[f"{key}_{unit}"])]
        rows.append([label, show(value, bounds["lower"], bounds["upper"]), interval_text or "–", *unaligned_cell])
    header = ("length of the error", "value", "interval", *(("unregistered",) if unaligned is not None else ()))
    blocks: list[Block] = [
        Grid(header, rows),
        _matrices(statistics, unit, coarse),
        _axes(statistics, unit),
        _tests(statistics),
        Listing([statistics["assumption"], statistics["pose_structure"]["text"]]),
    ]
    return ReportSection(f"{part.capitalize()} error", blocks)


def _matrices(statistics: Mapping[str, Any], unit: str, coarse: Unit) -> Grid:
    square = coarse.factor**2
    rows: list[Sequence[Cell]] = []
    for key, label in (("covariance", "about zero"), ("centred_covariance", "about the mean")):
        for axis, row in zip("xyz", statistics[f"{key}_{unit}2"], strict=True):
            rows.append([f"{label}, {axis}", *(Number(three_digits(value * square), value) for value in row)])
    return Grid((f"covariance, {coarse.name}²", "x", "y", "z"), rows)


def _axes(statistics: Mapping[str, Any], unit: str) -> Grid:
    rows: list[Sequence[Cell]] = []
    for number, axis in enumerate(statistics["ellipsoid"], 1):
        sd, bounds = axis[f"sd_{unit}"], axis["interval"]
        show, shown_unit = (length, length_unit(sd)) if unit == "m" else (angle, DEGREE)
        interval_text = interval(sd, bounds["lower"], bounds["upper"], bounds["confidence"], shown_unit)
        direction = [f"{value:+.2f}" for value in axis["direction"]]
        rows.append([str(number), show(sd, bounds["lower"], bounds["upper"]), interval_text or "–", *direction])
    return Grid(("principal axis", "standard deviation", "interval", "x", "y", "z"), rows)


def _tests(statistics: Mapping[str, Any]) -> Grid:
    tests = statistics["tests"].values()
    rows = [[test["method"], test["why"] if test["p_value"] is None else p_value(test["p_value"])] for test in tests]
    return Grid(("test of an assumption", "result"), rows)


def _grade(document: Document) -> ReportSection:
    grade = document["grade"]
    rows: list[Sequence[Cell]] = [
        [step["grade"], length(step["position_m"]), angle(step["orientation_rad"])] for step in grade["steps"]
    ]
    sentences = [sentence for sentence in grade["reason"].split(". ") if sentence]
    header = (f"grade, by {grade['statistic']}", "position within", "orientation within")
    return ReportSection(f"Grade {grade['grade']}", [Listing(sentences), Grid(header, rows)])


def _worst(document: Document) -> ReportSection:
    blocks: list[Block] = []
    for key, label in (("by_position", "by position"), ("by_orientation", "by orientation")):
        rows = [_pose(pose) for pose in document["worst_poses"][key]]
        if rows:
            blocks.append(Grid((f"largest errors {label}", "position", "orientation"), rows))
    for target in document["targets"]:
        blocks.append(Text(f"Target {target['target']}: {target['n_poses']} poses, rms {length(target['rms_m'])}."))
    return ReportSection("Largest errors", blocks)


def _pose(pose: Mapping[str, Any]) -> list[Cell]:
    parts = [f"line {pose['line']}", *(f"{name} {pose[name]}" for name in ("pose", "target") if pose[name] is not None)]
    return [", ".join(parts), length(pose["error_m"]), angle(pose["error_rad"])]


def _alignment(document: Document) -> ReportSection:
    alignment = document["alignment"]
    rows = [parameter_row(parameter) for parameter in alignment["parameters"] if parameter["std"] is not None]
    blocks: list[Block] = [Grid(("parameter", "value", "standard error", "unit"), rows)]
    unidentified = [
        [parameter["name"], str(parameter["why"])] for parameter in alignment["parameters"] if parameter["std"] is None
    ]
    if unidentified:
        blocks.append(Grid(("parameter that is not identifiable", "reason"), unidentified, is_text=True))
    return ReportSection("Registration", blocks)
