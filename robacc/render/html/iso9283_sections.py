"""The sections of an `iso9283` report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robacc.render.html.blocks import Block, Cell, Grid, Listing, ReportSection, angle, interval, length
from robacc.render.plots.chart import Document
from robacc.render.plots.units import length_unit

_NAMES = {
    "AP": "pose accuracy, AP",
    "RP": "pose repeatability, RP",
    "vAP": "multi-directional accuracy variation, vAP",
    "AD": "distance accuracy, AD",
    "RD": "distance repeatability, RD",
    "dAP": "drift of AP",
    "dRP": "drift of RP",
    "shift": "drift of the barycentre",
    "E": "exchangeability, E",
}
_STATUS = {"met": "met", "not_met": "not met", "unknown": "unknown"}


def iso9283_sections(document: Document) -> Iterator[ReportSection]:
    """Return all criteria, and the conditions of the protocol."""
    criteria = _characteristics(document["iso9283"])
    yield ReportSection("Criteria", _criteria(criteria))
    rows = [
        [
            f"{condition['condition']} ({condition['clause']})",
            _STATUS.get(condition["status"], condition["status"]),
            condition["why"],
        ]
        for condition in document["protocol"]
    ]
    yield ReportSection(
        "Conditions of the protocol", [Grid(("condition, clause", "status", "reason"), rows, is_text=True)]
    )


def _characteristics(criteria: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    flat: list[Mapping[str, Any]] = []
    for criterion in criteria.values():
        flat += [criterion] if "symbol" in criterion else list(criterion.values())
    return flat


def _criteria(criteria: Sequence[Mapping[str, Any]]) -> list[Block]:
    rows: list[Sequence[Cell]] = []
    for criterion in criteria:
        value, bounds = criterion["max_m"], criterion["intervals"]["max_m"]
        if value is None:
            continue
        low, high = bounds["lower"], bounds["upper"]
        interval_text = interval(value, low, high, bounds["confidence"], length_unit(value))
        orientation = criterion["orientation"]
        rows.append(
            [
                f"{_NAMES.get(criterion['symbol'], criterion['symbol'])} ({criterion['clause']})",
                length(value, low, high),
                interval_text or "–",
                str(criterion["max_at"]),
                angle(orientation["max_rad"]),
            ]
        )
    header = ("criterion, largest over poses", "position", "interval", "at", "orientation")
    blocks: list[Block] = [Grid(header, rows)]
    missing = [
        f"{_NAMES.get(o['symbol'], o['symbol'])}: {o['why']}" for o in criteria if o["max_m"] is None and o["why"]
    ]
    notes = [*dict.fromkeys(note for criterion in criteria for note in criterion["notes"])]
    for texts in (missing, notes):
        if texts:
            blocks.append(Listing(texts))
    return blocks
