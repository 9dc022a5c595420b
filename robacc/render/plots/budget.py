"""Charts of the error budget of a prediction."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.render.plots.chart import Chart, ChartTable, Document
from robacc.render.plots.labels import short
from robacc.render.plots.palette import LIGHT
from robacc.render.plots.units import DEGREE, length_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BARS = 10


def budget_charts(document: Document) -> Iterator[Chart]:
    """Return the shares by parameter and by joint."""
    for kind, key, name, label in (
        ("budget", "budget", "parameter", "parameter"),
        ("budget-joints", "budget_by_joint", "name", "joint"),
    ):
        shares = document.get(key) or ()
        if shares:
            yield _chart(kind, shares, name, label if shares[0].get("sd") is not None or name == "name" else "source")


def _chart(kind: str, shares: Sequence[Mapping[str, Any]], name: str, label: str) -> Chart:
    first = shares[0]
    top = shares[:_BARS]
    omitted = f" The table has the {len(shares) - len(top)} smaller shares." if len(shares) > len(top) else ""
    return Chart(
        kind,
        f"Error budget by {label}",
        f"Share of the predicted variance of position (bars) and orientation (outlines) by {label}; all shares sum to "
        f"100 %. The largest share of position is {first[name]} with {100 * first['share_position']:.1f} %.{omitted}",
        "Bars of shares of variance, position: "
        + "; ".join(f"{share[name]} {100 * share['share_position']:.1f} %" for share in top),
        lambda figure: _draw(figure, top, name),
        _table(shares, name, label),
        (4.9, 1.05 + 0.3 * len(top)),
    )


def _table(shares: Sequence[Mapping[str, Any]], name: str, label: str) -> ChartTable:
    toleranced = label == "parameter"
    header = (label, *(("tolerance (sd)",) if toleranced else ()), "position", "orientation")
    rows = [
        [
            str(share[name]),
            *([_tolerance(share)] if toleranced else []),
            f"{100 * share['share_position']:.2f} %",
            f"{100 * share['share_orientation']:.2f} %",
        ]
        for share in shares
    ]
    return ChartTable(header, rows)


def _tolerance(share: Mapping[str, Any]) -> str:
    return DEGREE.text(share["sd"]) if share["unit"] == "rad" else length_unit(share["sd"]).text(share["sd"])


def _draw(figure: Figure, shares: Sequence[Mapping[str, Any]], name: str) -> None:
    axes = figure.add_subplot()
    rows = np.arange(len(shares))
    position = [100 * share["share_position"] for share in shares]
    orientation = [100 * share["share_orientation"] for share in shares]
    bars = axes.barh(rows - 0.17, position, height=0.34, color=LIGHT["after"], label="position")
    axes.barh(
        rows + 0.19,
        orientation,
        height=0.26,
        facecolor="none",
        edgecolor=LIGHT["before"],
        linewidth=1,
        label="orientation",
    )
    axes.bar_label(bars, [f"{value:.1f}" for value in position], padding=3, fontsize=8)
    axes.set_yticks(rows, [short(str(share[name])) for share in shares])
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.invert_yaxis()
    axes.set(xlabel="share of the variance, %", xlim=(0, 1.12 * max(*position, *orientation)))
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
