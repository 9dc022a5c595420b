"""The charts of a result, in reading order."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from robacc.errors import UsageError
from robacc.render.plots.canvas import Chart
from robacc.render.plots.effects import candidate_charts, effect_charts
from robacc.render.plots.errors import distribution_charts, ellipsoid_charts, error_over_time_charts
from robacc.render.plots.results import (
    budget_charts,
    comparison_charts,
    detection_limit_charts,
    expected_accuracy_charts,
    iso9283_charts,
    operating_curve_charts,
)
from robacc.render.plots.workspace import (
    correction_charts,
    planned_poses_charts,
    warranty_charts,
    workspace_3d_charts,
    workspace_charts,
)
from robacc.render.text.layout import Document

_FAMILIES: Sequence[Callable[[Document], Iterator[Chart]]] = (
    distribution_charts,
    iso9283_charts,
    comparison_charts,
    operating_curve_charts,
    effect_charts,
    candidate_charts,
    workspace_3d_charts,
    correction_charts,
    warranty_charts,
    ellipsoid_charts,
    budget_charts,
    error_over_time_charts,
    workspace_charts,
)
_OF_COMMAND: Mapping[str, Sequence[Callable[[Document], Iterator[Chart]]]] = {
    "plan": (planned_poses_charts, expected_accuracy_charts, detection_limit_charts)
}
"""Charts of commands whose results have no measured poses."""


def charts_of(document: Document) -> list[Chart]:
    """Return all charts that the result has data for."""
    families = _OF_COMMAND.get(document["command"], _FAMILIES)
    return [chart for family in families for chart in family(document)]


def chart_of(document: Document, kind: str, number: int = 1) -> Chart:
    """Return the ``number``-th chart of a kind, counted from 1; without a kind, of the kind of the main chart.

    Raises:
        UsageError: the result has no such chart; the message lists its charts.
    """
    charts = charts_of(document)
    matching = [chart for chart in charts if chart.kind == (kind or charts[0].kind)]
    if 1 <= number <= len(matching):
        return matching[number - 1]
    command = document["command"]
    if matching:
        raise UsageError(
            f"this result of robacc {command} has {len(matching)} chart(s) {matching[0].kind!r}, not {number}"
        )
    kinds = ", ".join(kinds_of(charts)) or "none"
    raise UsageError(f"this result of robacc {command} has no chart{f' {kind!r}' * bool(kind)}; it has {kinds}")


def kinds_of(charts: Iterable[Chart]) -> list[str]:
    """Return each kind once, the main chart's first."""
    return [*dict.fromkeys(chart.kind for chart in charts)]
