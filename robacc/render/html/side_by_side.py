"""Several results in one table, one column per result."""

from __future__ import annotations

from collections.abc import Sequence

from robacc.render.html.blocks import Cell, Grid, Listing, ReportHeadline, ReportSection
from robacc.render.html.reproduce import command_line
from robacc.render.plots.chart import Document

_SAME = ("poses", "robot", "holdout")


def side_by_side(
    documents: Sequence[Document], headlines: Sequence[ReportHeadline], names: Sequence[str]
) -> ReportSection:
    """Return outcome, key figures and facts of each result, with warnings about different inputs."""
    rows: list[Sequence[Cell]] = [
        ["command", *(str(document["command"]) for document in documents)],
        ["outcome", *(", ".join(badge.text for badge in headline.badges) or "–" for headline in headlines)],
    ]
    labels = dict.fromkeys(tile.label for headline in headlines for tile in headline.tiles)
    for label in labels:
        cells: list[Cell] = [label]
        for headline in headlines:
            tile = next((tile for tile in headline.tiles if tile.label == label), None)
            cells.append("–" if tile is None else tile.value)
        rows.append(cells)
    for term in dict.fromkeys(term for headline in headlines for term, _ in headline.facts):
        rows.append([term, *(dict(headline.facts).get(term, "–") for headline in headlines)])
    rows.append(["made by", *(f"robacc {document['robacc']}" for document in documents)])
    rows.append(["call", *(command_line(document) for document in documents)])
    blocks = [Grid(("", *names), rows, is_text=True)]
    return ReportSection("Side by side", [*blocks, *_differences(documents)])


def _differences(documents: Sequence[Document]) -> list[Listing]:
    """Return warnings about differences in inputs and versions."""
    warnings = []
    for kind in _SAME:
        hashes = {
            tuple(record["sha256"] for record in document["inputs"] if record["kind"] == kind) for document in documents
        }
        if len(hashes) > 1:
            warnings.append(f"the results were not made from the same {kind} file")
    if len({document["robacc"] for document in documents}) > 1:
        warnings.append("the results were made by different versions of robacc")
    return [Listing(warnings, "warning")] if warnings else []
