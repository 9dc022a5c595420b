"""What `iso9283` says beside its pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robacc.render.html.blocks import Block, Cell, Grid, Listing, ReportSection, angle, interval, length
from robacc.render.plots.chart import Document
from robacc.render.plots.units import length_unit

_WORDS = {
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
_STATUS = {"met": "met", "not_met": "not met", "unknown": "not known"}


def iso9283_sections(document: Document) -> Iterator[ReportSection]:
    """Every characteristic, and the conditions of the protocol."""
    every = _characteristics(document["iso9283"])
    yield ReportSection("Criteria", _criteria(every))
    rows = [
        [f"{one['condition']} ({one['clause']})", _STATUS.get(one["status"], one["status"]), one["why"]]
        for one in document["protocol"]
    ]
    yield ReportSection("Conditions of the protocol", [Grid(("condition, clause", "status", "why"), rows, words=True)])


def _characteristics(found: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    flat: list[Mapping[str, Any]] = []
    for one in found.values():
        flat += [one] if "symbol" in one else list(one.values())
    return flat


def _criteria(every: Sequence[Mapping[str, Any]]) -> list[Block]:
    rows: list[Sequence[Cell]] = []
    for one in every:
        value, bounds = one["max_m"], one["intervals"]["max_m"]
        if value is None:
            continue
        low, high = bounds["lower"], bounds["upper"]
        told = interval(value, low, high, bounds["confidence"], length_unit(value))
        turned = one["orientation"]
        rows.append(
            [
                f"{_WORDS.get(one['symbol'], one['symbol'])} ({one['clause']})",
                length(value, low, high),
                told or "–",
                str(one["max_at"]),
                angle(turned["max_rad"]),
            ]
        )
    header = ("criterion, largest over poses", "position", "interval", "at", "orientation")
    blocks: list[Block] = [Grid(header, rows)]
    missing = [f"{_WORDS.get(o['symbol'], o['symbol'])}: {o['why']}" for o in every if o["max_m"] is None and o["why"]]
    notes = [*dict.fromkeys(note for one in every for note in one["notes"])]
    for texts in (missing, notes):
        if texts:
            blocks.append(Listing(texts))
    return blocks
