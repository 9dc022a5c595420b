"""Several results in one table: a column each, so that what differs is seen."""

from __future__ import annotations

from collections.abc import Sequence

from robacc.render.html.blocks import Cell, Grid, Listing, ReportHeadline, ReportSection
from robacc.render.html.reproduce import command_line
from robacc.render.plots.chart import Document

_SAME = ("poses", "robot", "holdout")


def side_by_side(
    documents: Sequence[Document], headlines: Sequence[ReportHeadline], names: Sequence[str]
) -> ReportSection:
    """Outcome, figures and facts of each result, and what they were made from if it is not the same."""
    rows: list[Sequence[Cell]] = [
        ["command", *(str(document["command"]) for document in documents)],
        ["outcome", *(", ".join(badge.text for badge in one.badges) or "–" for one in headlines)],
    ]
    labels = dict.fromkeys(tile.label for one in headlines for tile in one.tiles)
    for label in labels:
        cells: list[Cell] = [label]
        for one in headlines:
            tile = next((tile for tile in one.tiles if tile.label == label), None)
            cells.append("–" if tile is None else tile.value)
        rows.append(cells)
    for term in dict.fromkeys(term for one in headlines for term, _ in one.facts):
        rows.append([term, *(dict(one.facts).get(term, "–") for one in headlines)])
    rows.append(["made by", *(f"robacc {document['robacc']}" for document in documents)])
    rows.append(["call", *(command_line(document) for document in documents)])
    blocks = [Grid(("", *names), rows, words=True)]
    return ReportSection("Side by side", [*blocks, *_differences(documents)])


def _differences(documents: Sequence[Document]) -> list[Listing]:
    """What makes the results hard to compare."""
    told = []
    for kind in _SAME:
        hashes = {
            tuple(record["sha256"] for record in document["inputs"] if record["kind"] == kind) for document in documents
        }
        if len(hashes) > 1:
            told.append(f"the results are not of the same {kind}")
    if len({document["robacc"] for document in documents}) > 1:
        told.append("the results were made by different versions of robacc")
    return [Listing(told, "warning")] if told else []
