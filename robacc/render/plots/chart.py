"""Records of a chart: drawing function, caption and table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Document = Mapping[str, Any]

WIDE = (4.9, 3.2)
"""Inches; fills half of a page on a screen and stays readable on a phone."""


@dataclass(frozen=True, slots=True)
class ChartTable:
    """The table of a chart, as text; the first column is the row's label."""

    header: tuple[str, ...]
    rows: Sequence[Sequence[str]]
    note: str = ""
    """States which rows are omitted, empty if none."""


@dataclass(frozen=True, slots=True)
class Scene3D:
    """An interactive 3-D view: traces and axis titles for plotly.

    Colours are written as ``role:before``; the page substitutes its own.
    """

    traces: tuple[dict[str, Any], ...]
    axes: tuple[str, str, str]
    note: str


@dataclass(frozen=True, slots=True)
class Chart:
    """One chart of one result."""

    kind: str
    """Kind for ``robacc plot``."""
    title: str
    caption: str
    """Explanation of the chart with its main result."""
    alt: str
    """Text alternative: axes and main result."""
    draw: Callable[[Figure], None]
    table: ChartTable
    size: tuple[float, float] = WIDE
    scene: Scene3D | None = None
