"""The sections of a `compare` report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robacc.render.html.blocks import Cell, Grid, Listing, Number, ReportSection, Text, interval, quantity
from robacc.render.plots.chart import Document
from robacc.render.plots.units import Unit, error_unit
from robacc.render.text.numbers import p_value, three_digits


def compare_sections(document: Document) -> Iterator[ReportSection]:
    """Return the ranking, all statistics, the differences from the baseline, and the inputs of each result."""
    if document["ranking"] is not None:
        yield _ranking(document["ranking"])
    yield _values(document)
    if document["baseline"] is not None:
        yield _differences(document)
    yield _inputs(document)


def _ranking(ranking: Mapping[str, Any]) -> ReportSection:
    unit = _unit(ranking["unit"], (entry["value"] for entry in ranking["order"]))
    rows: list[Sequence[Cell]] = [
        [f"{place}. {entry['name']}", quantity(entry["value"], unit), entry["letters"]]
        for place, entry in enumerate(ranking["order"], 1)
    ]
    text = f"By {ranking['by']}, the smallest first; results that share a letter do not differ significantly."
    grid = Grid(("result", ranking["by"], "group"), rows)
    return ReportSection(
        "Ranking", [Text(text), grid, Listing([*ranking["text"], *map(str, ranking["indistinguishable"])])]
    )


def _unit(name: str, values: Any) -> Unit:
    sizes = [value for value in values if value is not None]
    return error_unit(name, *sizes) if name in ("m", "rad") else Unit("", 1.0)


def _values(document: Document) -> ReportSection:
    names = [statistic["name"] for statistic in document["results"]]
    rows: list[Sequence[Cell]] = []
    for statistic in document["statistics"]:
        unit = _unit(statistic["unit"], (value["value"] for value in statistic["values"]))
        by_name = {value["name"]: value for value in statistic["values"]}
        rows.append([statistic["key"], *(_value(by_name.get(name), unit) for name in names)])
    return ReportSection("Statistics", [Grid(("statistic", *names), rows)])


def _value(value: Mapping[str, Any] | None, unit: Unit) -> Cell:
    if value is None or value["value"] is None:
        return "–"
    if not unit.name:
        return Number(three_digits(value["value"]), value["value"])
    return quantity(value["value"], unit, value["lower"], value["upper"])


def _differences(document: Document) -> ReportSection:
    rows: list[Sequence[Cell]] = []
    for statistic in document["statistics"]:
        for difference in statistic["differences"]:
            if difference["value"] is None:
                continue
            unit = _unit(statistic["unit"], [difference["value"]])
            interval_text = interval(
                difference["value"], difference["lower"], difference["upper"], difference["confidence"] or 0.95, unit
            )
            number = quantity(difference["value"], unit, difference["lower"], difference["upper"])
            paired = "yes" if difference["paired"] else "no"
            rows.append(
                [
                    f"{statistic['key']}, {difference['name']}",
                    number,
                    interval_text or "–",
                    p_value(difference["p_value"]),
                    paired,
                ]
            )
    header = ("statistic, result", "difference", "interval", "significance", "same poses")
    text = f"Each result minus {document['baseline']}; negative differences are better."
    return ReportSection(f"Differences from {document['baseline']}", [Text(text), Grid(header, rows)])


def _inputs(document: Document) -> ReportSection:
    results = document["results"]
    keys = dict.fromkeys(key for result in results for key in result["made"])
    rows: list[Sequence[Cell]] = [
        ["robot", *(str(result["robot"] or "–") for result in results)],
        ["poses", *(str(result["n_poses"]) for result in results)],
        *([key, *(str(result["made"].get(key, "–")) for result in results)] for key in keys),
        ["SHA-256", *(result["sha256"] for result in results)],
    ]
    return ReportSection("Compared results", [Grid(("", *(result["name"] for result in results)), rows, is_text=True)])
