"""Where a picture is drawn: one style, and the figure as part of a page or as a file of its own.

Everything is matplotlib's; no global state of it is touched, and the same document gives the same bytes.
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
"""Comes with matplotlib, so that text takes the same room on every machine."""
_DOTS_PER_INCH = 220
_STYLE: dict[str, Any] = {
    "font.family": [FONT],
    "font.size": 9.0,
    # Names from files are plain text: a dollar sign in one is no formula.
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
    """The picture as an ``<svg>`` element for a page: its colours are the page's variables, its text the page's font.

    ``salt`` keeps its ids apart from those of the page's other pictures.
    """
    text = _saved(draw, size, "svg", {"svg.fonttype": "none", "svg.hashsalt": salt}).decode()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    # Only what is referred to keeps its id: groups are numbered alike in every picture.
    text = re.sub(r'<g id="[^"]*"', "<g", text)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    text = text.replace(f"'{FONT}'", "var(--font)")
    for role, colour in LIGHT.items():
        text = text.replace(colour, f"var(--c-{role})")
    return re.sub(r"\n\s*", "\n", text).strip()


def as_file(draw: Callable[[Figure], None], size: tuple[float, float], form: str) -> bytes:
    """The picture as a file on white: ``svg``, ``png`` or ``pdf``."""
    more = {"svg.fonttype": "path", "svg.hashsalt": "robacc", "figure.facecolor": "white"}
    return _saved(draw, size, form, more)


def _saved(draw: Callable[[Figure], None], size: tuple[float, float], form: str, more: dict[str, Any]) -> bytes:
    from matplotlib.figure import Figure

    page = io.BytesIO()
    dates = {"svg": {"Date": None, "Creator": None}, "pdf": {"CreationDate": None, "Creator": None, "Producer": None}}
    with _style(more):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        figure.savefig(page, format=form, dpi=_DOTS_PER_INCH, metadata=dates.get(form))
    return page.getvalue()


@contextmanager
def _style(more: dict[str, Any]) -> Iterator[None]:
    import matplotlib

    style: Any = {**_STYLE, **more}
    with matplotlib.rc_context(style), warnings.catch_warnings():
        # A sign that the font lacks is drawn as a box in a file, and by the reader's own fonts on a page.
        warnings.filterwarnings("ignore", message=".*[Gg]lyph.*missing")
        # Where names leave too little room, the picture is drawn all the same.
        warnings.filterwarnings("ignore", message="constrained_layout not applied")
        yield
