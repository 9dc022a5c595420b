"""What a picture is: how to draw it, what it shows in words, and the numbers behind it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Document = Mapping[str, Any]

WIDE = (4.9, 3.2)
"""Inches: at its own size on a screen half of a page wide, and still to be read on a phone."""


@dataclass(frozen=True, slots=True)
class ChartTable:
    """Numbers behind a picture, as text; the first column names the row."""

    header: tuple[str, ...]
    rows: Sequence[Sequence[str]]
    note: str = ""
    """What is left out, if anything is."""


@dataclass(frozen=True, slots=True)
class Scene3D:
    """A view in three dimensions that the reader can turn: traces and layout of plotly.

    A colour is written ``role:before``, for the page to put its own in.
    """

    traces: tuple[dict[str, Any], ...]
    axes: tuple[str, str, str]
    note: str


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture of one result."""

    kind: str
    """What ``robacc plot --kind`` calls it."""
    title: str
    caption: str
    """What it shows, in words."""
    alt: str
    """The same for one who cannot see it: axes, and what is plain from it."""
    draw: Callable[[Figure], None]
    table: ChartTable
    size: tuple[float, float] = WIDE
    scene: Scene3D | None = None
