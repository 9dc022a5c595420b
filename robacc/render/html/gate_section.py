"""What a gate says of the result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robacc.render.html.blocks import Block, Cell, Grid, Listing, Number, ReportSection, angle, length
from robacc.render.plots.chart import Document
from robacc.render.text.numbers import three_digits

_OUTCOMES = {"pass": "passed", "fail": "failed", "inconclusive": "inconclusive", "not_evaluated": "not evaluated"}


def gate_section(document: Document) -> ReportSection | None:
    """Each criterion with its figure, bound, limit and outcome; None where no gate was asked for."""
    gate = document.get("gate")
    if not gate:
        return None
    rows = [_criterion(one) for one in gate["criteria"]]
    header = ("criterion", "outcome", "value", "bounds", "limit", "probability to conform", "poses to decide")
    blocks: list[Block] = [Grid(header, rows)]
    why = [f"{one['name']}: {one['why']}" for one in gate["criteria"] if one["why"]]
    why += [f"{one['name']}: {one['reason']}" for one in gate["criteria"] if one["reason"]]
    if why:
        blocks.append(Listing(why))
    if gate["warnings"]:
        blocks.append(Listing(list(gate["warnings"]), "warning"))
    return ReportSection(f"Gate {gate['name']}: {_OUTCOMES.get(gate['outcome'], gate['outcome'])}", blocks)


def _criterion(one: Mapping[str, Any]) -> Sequence[Cell]:
    bounds = [one["lower_bound"], one["upper_bound"]]
    told = (
        " … ".join(str(value_of(bound, one["unit"])) for bound in bounds) if any(b is not None for b in bounds) else "–"
    )
    sign = "at least " if one["at_least"] else ""
    limit = one["limit"]
    probability = one["conformity_probability"]
    return [
        one["name"],
        _OUTCOMES.get(one["outcome"], one["outcome"]),
        value_of(one["value"], one["unit"]),
        told,
        f"{sign}{', '.join(map(str, limit)) if isinstance(limit, list) else value_of(limit, one['unit'])}",
        "–" if probability is None else f"{100 * probability:.1f} %",
        "–" if one["poses_to_decide"] is None else f"{one['poses_to_decide']:,}",
    ]


def value_of(value: Any, unit: str) -> Cell:
    """A figure of a criterion, which may be a word or a grade."""
    if value is None:
        return Number("–", None)
    if isinstance(value, str):
        return value
    if unit == "m":
        return length(value)
    return angle(value) if unit == "rad" else Number(three_digits(float(value)), float(value))
