"""Drawing of charts in one style: records, colours, units, limits and thinning, as part of a page or as a file.

The module changes no global state of matplotlib, and the same document gives the same bytes.
"""

from __future__ import annotations

import io
import math
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robacc.errors import UsageError, install_advice
from robacc.render.text.layout import three_digits

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# The optional libraries that charts and reports need.


def need(*libraries: str) -> None:
    """Raise an error if a library of the extra ``report`` is missing.

    Raises:
        UsageError: a library is not installed; the message says how to install the extra.
    """
    missing = [name for name in libraries if find_spec(name) is None]
    if missing:
        raise UsageError(
            f"charts and reports need {' and '.join(missing)}, which is not installed; run {install_advice('report')}"
        )


# Names from files, shortened for charts.


def short(text: str, longest: int = 26) -> str:
    """Return one printable line of at most ``longest`` characters; the tables have the full names."""
    line = "".join(sign if sign.isprintable() else " " for sign in text)
    return line if len(line) <= longest else f"{line[: longest - 1]}…"


# Colours by their role, in a light and a dark set.
#
# The colours of data are from M. Okabe and K. Ito, "Color Universal Design" (2008), distinguishable with any kind of
# colour vision. Shape or line style carries the same information, for prints in grey.

LIGHT: Final = {
    "ink": "#1b2530",
    "muted": "#59636e",
    "grid": "#dde2e7",
    "paper": "#fffffe",
    "nominal": "#7a838c",
    "before": "#d55e00",
    "after": "#0072b2",
    "third": "#009e73",
    "fourth": "#cc79a7",
    "limit": "#1b2531",
}
"""Colours in files and on light pages; all differ, so that a page can substitute each with its own variable."""

DARK: Final = {
    "ink": "#e6e9ec",
    "muted": "#a3adb7",
    "grid": "#343c45",
    "paper": "#161b21",
    "nominal": "#8f99a3",
    "before": "#e69f00",
    "after": "#56b4e9",
    "third": "#2fbf94",
    "fourth": "#e09cc4",
    "limit": "#e6e9ec",
}


def css_variables(colours: dict[str, str]) -> str:
    """Return the declarations ``--c-ink: …; …``."""
    return " ".join(f"--c-{role}: {value};" for role, value in colours.items())


# Display units; a chart uses one unit, chosen by its largest value.


class Unit(NamedTuple):
    """A display unit."""

    name: str
    factor: float
    """Displayed number = factor times SI value."""

    def text(self, value: float | None) -> str:
        """Return three digits and the unit; a dash for None and NaN."""
        if value is None or not math.isfinite(value):
            return "–"
        gap = "" if self.name == "°" else " "
        return f"{three_digits(value * self.factor)}{gap}{self.name}".rstrip()


MILLIMETRE = Unit("mm", 1e3)
METRE = Unit("m", 1.0)
DEGREE = Unit("°", 180.0 / math.pi)
_LENGTHS = (Unit("µm", 1e6), MILLIMETRE)
_OTHERS = {"1": "", "N m": "N m", "N": "N", "s": "s", "kg": "kg", "°C": "°C", "": ""}


def length_unit(*sizes: float) -> Unit:
    """Return millimetres, or micrometres if all sizes (m) are below 0.02 mm."""
    return _LENGTHS[0] if _largest(sizes) < 2e-5 else MILLIMETRE


def joint_unit(unit: str, *sizes: float) -> Unit:
    """Return the unit of a joint error: degrees, as in the tables; mm or µm for lengths."""
    return length_unit(*sizes) if unit == "m" else DEGREE


def driver_unit(unit: str) -> Unit:
    """Return the unit of a driver's axis: degrees, metres, or the unit itself."""
    return {"rad": DEGREE, "m": METRE}.get(unit) or Unit(_OTHERS.get(unit, unit), 1.0)


def error_unit(unit: str, *sizes: float) -> Unit:
    """Return the unit of an error's length: mm or µm, or degrees."""
    return DEGREE if unit == "rad" else length_unit(*sizes)


def _largest(sizes: Iterable[float]) -> float:
    return max((abs(size) for size in sizes if math.isfinite(size)), default=0.0)


# Records of a chart: drawing function, caption and table.

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


# Selection of the poses that a chart shows, reproducible and including the extremes.

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


def thinned(most: int, *columns: Array) -> Rows:
    """Return the rows to show, ascending: all of them up to ``most``.

    With more rows, a quarter of the selection are the rows with the largest and smallest values of each column
    ``(N,)``; the others are spread evenly over all rows. The selection keeps the range and the extremes.
    """
    n = columns[0].size
    if n <= most:
        return np.arange(n)
    each = max(1, most // (8 * len(columns)))
    extreme: set[int] = set()
    for column in columns:
        order = np.argsort(np.where(np.isfinite(column), column, np.nanmedian(column)), kind="stable")
        extreme.update(order[:each].tolist())
        extreme.update(order[-each:].tolist())
    remaining = np.setdiff1d(np.arange(n), np.array(sorted(extreme)))
    evenly = remaining[np.linspace(0, remaining.size - 1, most - len(extreme)).round().astype(np.int64)]
    return np.sort(np.concatenate((np.array(sorted(extreme), dtype=np.int64), evenly)))


def thinning_note(count: int, total: int) -> str:
    """Return the sentence for a caption; an empty text if all poses are shown."""
    return "" if count >= total else f" The chart shows {count:,} of {total:,} poses, including the extremes."


# Columns of a document as arrays.


def numbers(values: Iterable[Any]) -> Array:
    """Return ``(N,)`` numbers, NaN for null."""
    return np.array([math.nan if value is None else value for value in values], dtype=np.float64)


def vectors(rows: Iterable[Any]) -> Array:
    """Return ``(N, 3)`` from three numbers per pose."""
    return np.array(list(rows), dtype=np.float64).reshape(-1, 3)


def lengths(rows: Array) -> Array:
    """Return the lengths ``(N,)`` of vectors ``(N, 3)``."""
    result: Array = np.sqrt(np.sum(np.square(rows), axis=1))
    return result


def place(poses: Mapping[str, Any], i: int) -> str:
    """Return the label of a pose: its line in the file, and its ids if it has any."""
    if "label" in poses:
        return str(poses["label"][i])
    parts = [f"line {poses['line'][i]}"]
    parts += [f"{name} {poses[name][i]}" for name in ("pose", "cycle", "target") if poses.get(name)]
    return ", ".join(parts)


# Limits of a gate or of a grade scale, drawn as lines in charts.


@dataclass(frozen=True, slots=True)
class Limit:
    """One limit of an error's size."""

    label: str
    short_label: str
    """Printed next to the line."""
    value: float
    """m or rad"""


def limits_of(document: Document, unit: str) -> tuple[Limit, ...]:
    """Return the limits of the gate in ``m`` or ``rad``, or the steps of the grade scale without a gate."""
    quantity = "position" if unit == "m" else "orientation"
    gate_limits = tuple(
        Limit(f"gate {criterion['name']} ({criterion['key']})", str(criterion["name"]), float(criterion["limit"]))
        for criterion in (document.get("gate") or {}).get("criteria", ())
        if criterion["unit"] == unit and quantity in criterion["key"].split(".") and criterion["baseline"] is None
        if isinstance(criterion["limit"], int | float)
    )
    if gate_limits:
        return gate_limits
    steps = (document.get("grade") or {}).get("steps") or ()
    key = f"{quantity}_{unit}"
    return tuple(
        Limit(f"grade {step['grade']}", str(step["grade"]), step[key]) for step in steps if step[key] is not None
    )


# Parts of charts in three dimensions: the box of the still view, traces of the interactive view.

_MIN_EXTENT = 1e-3
"""m; the extent of the view if all points coincide."""


def fit_box(axes: Any, points: Array) -> None:
    """Fit the axes of matplotlib to ``points`` ``(N, 3)``, m, with equal scales and their labels."""
    from matplotlib.ticker import MaxNLocator

    centre, size = 0.5 * (points.min(axis=0) + points.max(axis=0)), np.ptp(points, axis=0)
    # Points on a line, in a plane or at one place need a margin too.
    size = np.maximum(size, 0.05 * float(size.max()) or _MIN_EXTENT)
    low, high = centre - 0.5 * size, centre + 0.5 * size
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(size, zoom=0.95)
    axes.set(xlabel="x, m", ylabel="y, m", zlabel="z, m")
    axes.tick_params(labelsize=7.5, pad=-2)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((0, 0, 0, 0))
        axis.set_major_locator(MaxNLocator(4))


def line_trace(name: str, points: Array, colour: str, width: float) -> dict[str, Any]:
    """Return a line for plotly through ``points`` ``(N, 3)``; NaN breaks it."""
    return {
        "type": "scatter3d",
        "mode": "lines",
        "name": name,
        **coordinates(points),
        "line": {"color": colour, "width": width},
        "hoverinfo": "skip",
    }


def coordinates(points: Array) -> dict[str, list[float | None]]:
    """Return coordinates rounded to 0.1 mm, null for breaks between lines."""
    columns = np.round(points, 4).T.tolist()
    return {
        axis: [None if math.isnan(value) else value for value in column]
        for axis, column in zip("xyz", columns, strict=True)
    }


def plain(text: str) -> str:
    """Return the text escaped for plotly, which interprets some tags and entities."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


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
