"""What `compare` says beside its pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robacc.render.html.blocks import Cell, Grid, Listing, Number, ReportSection, Text, interval, shown
from robacc.render.plots.chart import Document
from robacc.render.plots.units import Unit, error_unit
from robacc.render.text.numbers import p_value, three_digits


def compare_sections(document: Document) -> Iterator[ReportSection]:
    """Ranking, every statistic of every result, what differs from the baseline, and how each was made."""
    if document["ranking"] is not None:
        yield _ranking(document["ranking"])
    yield _values(document)
    if document["baseline"] is not None:
        yield _differences(document)
    yield _made(document)


def _ranking(ranking: Mapping[str, Any]) -> ReportSection:
    unit = _unit(ranking["unit"], (one["value"] for one in ranking["order"]))
    rows: list[Sequence[Cell]] = [
        [f"{place}. {one['name']}", shown(one["value"], unit), one["letters"]]
        for place, one in enumerate(ranking["order"], 1)
    ]
    words = f"By {ranking['by']}, the smallest first; results that share a letter cannot be told apart."
    grid = Grid(("result", ranking["by"], "group"), rows)
    return ReportSection(
        "Ranking", [Text(words), grid, Listing([*ranking["text"], *map(str, ranking["indistinguishable"])])]
    )


def _unit(name: str, values: Any) -> Unit:
    sizes = [value for value in values if value is not None]
    return error_unit(name, *sizes) if name in ("m", "rad") else Unit("", 1.0)


def _values(document: Document) -> ReportSection:
    names = [one["name"] for one in document["results"]]
    rows: list[Sequence[Cell]] = []
    for one in document["statistics"]:
        unit = _unit(one["unit"], (value["value"] for value in one["values"]))
        found = {value["name"]: value for value in one["values"]}
        rows.append([one["key"], *(_value(found.get(name), unit) for name in names)])
    return ReportSection("Statistics", [Grid(("statistic", *names), rows)])


def _value(value: Mapping[str, Any] | None, unit: Unit) -> Cell:
    if value is None or value["value"] is None:
        return "–"
    if not unit.name:
        return Number(three_digits(value["value"]), value["value"])
    return shown(value["value"], unit, value["lower"], value["upper"])


def _differences(document: Document) -> ReportSection:
    rows: list[Sequence[Cell]] = []
    for one in document["statistics"]:
        for other in one["differences"]:
            if other["value"] is None:
                continue
            unit = _unit(one["unit"], [other["value"]])
            told = interval(other["value"], other["lower"], other["upper"], other["confidence"] or 0.95, unit)
            number = shown(other["value"], unit, other["lower"], other["upper"])
            paired = "yes" if other["paired"] else "no"
            rows.append([f"{one['key']}, {other['name']}", number, told or "–", p_value(other["p_value"]), paired])
    header = ("statistic, result", "difference", "interval", "significance", "on the same poses")
    words = f"Of each result less that of {document['baseline']}; negative is better."
    return ReportSection(f"Differences from {document['baseline']}", [Text(words), Grid(header, rows)])


def _made(document: Document) -> ReportSection:
    found = document["results"]
    keys = dict.fromkeys(key for one in found for key in one["made"])
    rows: list[Sequence[Cell]] = [
        ["robot", *(str(one["robot"] or "–") for one in found)],
        ["poses", *(str(one["n_poses"]) for one in found)],
        *([key, *(str(one["made"].get(key, "–")) for one in found)] for key in keys),
        ["SHA-256", *(one["sha256"] for one in found)],
    ]
    return ReportSection("What was compared", [Grid(("", *(one["name"] for one in found)), rows, words=True)])
