"""The outcome of a gate in a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robacc.render.plots.canvas import Document
from robacc.render.text.layout import three_digits
from robacc.render.views.elements import Block, Cell, Grid, Listing, Number, Section, angle, length

_OUTCOMES = {"pass": "passed", "fail": "failed", "inconclusive": "inconclusive", "not_evaluated": "not evaluated"}


def gate_section(document: Document) -> Section | None:
    """Return each criterion with value, bounds, limit and outcome; None without a gate."""
    gate = document.get("gate")
    if not gate:
        return None
    rows = [_criterion(criterion) for criterion in gate["criteria"]]
    header = ("criterion", "outcome", "value", "bounds", "limit", "conformity probability", "poses to decide")
    blocks: list[Block] = [Grid(header, rows)]
    why = [f"{criterion['name']}: {criterion['why']}" for criterion in gate["criteria"] if criterion["why"]]
    why += [f"{criterion['name']}: {criterion['reason']}" for criterion in gate["criteria"] if criterion["reason"]]
    if why:
        blocks.append(Listing(why))
    if gate["warnings"]:
        blocks.append(Listing(list(gate["warnings"]), "warning"))
    return Section(f"Gate {gate['name']}: {_OUTCOMES.get(gate['outcome'], gate['outcome'])}", blocks)


def _criterion(criterion: Mapping[str, Any]) -> Sequence[Cell]:
    bounds = [criterion["lower_bound"], criterion["upper_bound"]]
    bounds_text = (
        " … ".join(str(value_of(bound, criterion["unit"])) for bound in bounds)
        if any(b is not None for b in bounds)
        else "–"
    )
    sign = "at least " if criterion["at_least"] else ""
    limit = criterion["limit"]
    probability = criterion["conformity_probability"]
    return [
        criterion["name"],
        _OUTCOMES.get(criterion["outcome"], criterion["outcome"]),
        value_of(criterion["value"], criterion["unit"]),
        bounds_text,
        f"{sign}{', '.join(map(str, limit)) if isinstance(limit, list) else value_of(limit, criterion['unit'])}",
        "–" if probability is None else f"{100 * probability:.1f} %",
        "–" if criterion["poses_to_decide"] is None else f"{criterion['poses_to_decide']:,}",
    ]


def value_of(value: Any, unit: str) -> Cell:
    """Return a value of a criterion: a number, a word or a grade."""
    if value is None:
        return Number("–", None)
    if isinstance(value, str):
        return value
    if unit == "m":
        return length(value)
    return angle(value) if unit == "rad" else Number(three_digits(float(value)), float(value))
