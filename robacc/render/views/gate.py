"""The outcome of a gate in a page."""

from __future__ import annotations

from robacc.render.text.gate import HEADER, OUTCOME_LABELS, cells, explained, title
from robacc.render.text.layout import Document
from robacc.render.views.elements import Block, Grid, Listing, Section


def gate_section(document: Document) -> Section | None:
    """Return each criterion with outcome, value, limit and bounds, and the reasons; None without a gate."""
    gate = document.get("gate")
    if not gate:
        return None
    rows = []
    for criterion in gate["criteria"]:
        name, *others = cells(criterion)
        rows.append((name, OUTCOME_LABELS[criterion["outcome"]], *others))
    blocks: list[Block] = [Grid((HEADER[0], "outcome", *HEADER[1:]), rows)]
    blocks.append(Listing([f"{criterion['name']}: {explained(criterion)}" for criterion in gate["criteria"]]))
    if gate["warnings"]:
        blocks.append(Listing(gate["warnings"], "warning"))
    return Section(title(gate), blocks)
