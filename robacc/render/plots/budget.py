"""Which tolerance a predicted error comes from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.render.plots.chart import ChartTable, Document, Picture
from robacc.render.plots.labels import short
from robacc.render.plots.palette import LIGHT
from robacc.render.plots.units import DEGREE, length_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BARS = 10


def budget_pictures(document: Document) -> Iterator[Picture]:
    """Of a prediction: each parameter's share, and each joint's."""
    for kind, key, name, what in (
        ("budget", "budget", "parameter", "parameter"),
        ("budget-joints", "budget_by_joint", "name", "joint"),
    ):
        shares = document.get(key) or ()
        if shares:
            yield _picture(kind, shares, name, what)


def _picture(kind: str, shares: Sequence[Mapping[str, Any]], name: str, what: str) -> Picture:
    first = shares[0]
    top = shares[:_BARS]
    rest = f" The {len(shares) - len(top)} smaller ones are in the table." if len(shares) > len(top) else ""
    return Picture(
        kind,
        f"Error budget by {what}",
        f"Share of the predicted variance of position (bars) and orientation (outlines) that each {what} brings; over "
        f"all of them the shares sum to 100 %. The largest in position is {first[name]} with "
        f"{100 * first['share_position']:.1f} %.{rest}",
        "Bars of shares of variance, position: "
        + "; ".join(f"{one[name]} {100 * one['share_position']:.1f} %" for one in top),
        lambda figure: _draw(figure, top, name),
        _table(shares, name, what),
        (4.9, 1.05 + 0.3 * len(top)),
    )


def _table(shares: Sequence[Mapping[str, Any]], name: str, what: str) -> ChartTable:
    toleranced = what == "parameter"
    header = (what, *(("tolerance, one sd",) if toleranced else ()), "position", "orientation")
    rows = [
        [
            str(one[name]),
            *([_tolerance(one)] if toleranced else []),
            f"{100 * one['share_position']:.2f} %",
            f"{100 * one['share_orientation']:.2f} %",
        ]
        for one in shares
    ]
    return ChartTable(header, rows)


def _tolerance(one: Mapping[str, Any]) -> str:
    return DEGREE.text(one["sd"]) if one["unit"] == "rad" else length_unit(one["sd"]).text(one["sd"])


def _draw(figure: Figure, shares: Sequence[Mapping[str, Any]], name: str) -> None:
    axes = figure.add_subplot()
    rows = np.arange(len(shares))
    position = [100 * one["share_position"] for one in shares]
    turned = [100 * one["share_orientation"] for one in shares]
    bars = axes.barh(rows - 0.17, position, height=0.34, color=LIGHT["after"], label="position")
    axes.barh(
        rows + 0.19, turned, height=0.26, facecolor="none", edgecolor=LIGHT["before"], linewidth=1, label="orientation"
    )
    axes.bar_label(bars, [f"{value:.1f}" for value in position], padding=3, fontsize=8)
    axes.set_yticks(rows, [short(str(one[name])) for one in shares])
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.invert_yaxis()
    axes.set(xlabel="share of the variance, %", xlim=(0, 1.12 * max(*position, *turned)))
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
