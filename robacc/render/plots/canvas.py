"""Drawing of charts in one style, as part of a page or as a file.

The module changes no global state of matplotlib, and the same document gives the same bytes.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from robacc.render.plots.palette import LIGHT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FONT = "DejaVu Sans"
"""Part of matplotlib, so that text has the same size on every machine."""
_DOTS_PER_INCH = 220
_STYLE: dict[str, Any] = {
    "font.family": [FONT],
    "font.size": 9.0,
    # Names from files are plain text: a dollar sign starts no formula.
    "text.parse_math": False,
    "axes.edgecolor": LIGHT["muted"],
    "axes.labelcolor": LIGHT["ink"],
    "axes.titlesize": 9.0,
    "axes.titlecolor": LIGHT["ink"],
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.linewidth": 0.8,
    "grid.color": LIGHT["grid"],
    "grid.linewidth": 0.7,
    "xtick.color": LIGHT["muted"],
    "ytick.color": LIGHT["muted"],
    "xtick.labelcolor": LIGHT["ink"],
    "ytick.labelcolor": LIGHT["ink"],
    "text.color": LIGHT["ink"],
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.6,
    "figure.facecolor": "none",
    "path.simplify": True,
    "pdf.fonttype": 42,
}


def as_part(draw: Callable[[Figure], None], size: tuple[float, float], salt: str) -> str:
    """Return the chart as an ``<svg>`` element that uses the colours and the font of the page.

    ``salt`` makes its ids unique on the page.
    """
    text = _saved(draw, size, "svg", {"svg.fonttype": "none", "svg.hashsalt": salt}).decode()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    # Groups lose their ids, which repeat from chart to chart; nothing refers to them.
    text = re.sub(r'<g id="[^"]*"', "<g", text)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    text = text.replace(f"'{FONT}'", "var(--font)")
    for role, colour in LIGHT.items():
        text = text.replace(colour, f"var(--c-{role})")
    return re.sub(r"\n\s*", "\n", text).strip()


def as_file(draw: Callable[[Figure], None], size: tuple[float, float], form: str) -> bytes:
    """Return the chart as a file with a white background: ``svg``, ``png`` or ``pdf``."""
    overrides = {"svg.fonttype": "path", "svg.hashsalt": "robacc", "figure.facecolor": "white"}
    return _saved(draw, size, form, overrides)


def as_figure(draw: Callable[[Figure], None], size: tuple[float, float]) -> Figure:
    """Return the chart as a figure with a white background."""
    from matplotlib.figure import Figure

    with _style({"figure.facecolor": "white"}):
        figure = Figure(figsize=size, layout="constrained", dpi=_DOTS_PER_INCH)
        draw(figure)
    return figure


def _saved(draw: Callable[[Figure], None], size: tuple[float, float], form: str, overrides: dict[str, Any]) -> bytes:
    from matplotlib.figure import Figure

    buffer = io.BytesIO()
    dates = {"svg": {"Date": None, "Creator": None}, "pdf": {"CreationDate": None, "Creator": None, "Producer": None}}
    with _style(overrides):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        figure.savefig(buffer, format=form, dpi=_DOTS_PER_INCH, metadata=dates.get(form))
    return buffer.getvalue()


@contextmanager
def _style(overrides: dict[str, Any]) -> Iterator[None]:
    import matplotlib

    style: Any = {**_STYLE, **overrides}
    with matplotlib.rc_context(style), warnings.catch_warnings():
        # A character that the font lacks becomes a box in a file; a page uses the reader's fonts.
        warnings.filterwarnings("ignore", message=".*[Gg]lyph.*missing")
        # Long names may leave too little room for the layout; the chart is still drawn.
        warnings.filterwarnings("ignore", message="constrained_layout not applied")
        yield
