"""Charts as data: panels of axes with points, lines, bars and bands, and one short backend for each library.

matplotlib draws every chart as a still image, in the page and as a file; plotly turns those in space in the page. Both
are needed: plotly writes no file without a browser, matplotlib draws nothing that turns in a page without a server.
The module changes no global state of matplotlib, and the same document gives the same bytes.
"""

import io
import math
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from robacc.errors import install_advice, refuse
from robacc.geometry import Array as Array, NDArray
from robacc.render.text import Document, Grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# The optional libraries that charts and reports need.


def need(*libraries: str) -> None:
    """Raise an error if a library of the extra ``report`` is missing.

    Raises:
        UsageError: a library is not installed; the message says how to install the extra.
    """
    missing = [name for name in libraries if find_spec(name) is None]
    needed = f"charts and reports need {' and '.join(missing)}, which is not installed"
    refuse((missing, f"{needed}; run {install_advice('report')}"))


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


# What a chart is.

Rows = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Series:
    """Points, a line, bars, a band or cells of one colour, in display units."""

    at: Sequence[Any] | Array
    """Coordinates (x, y) or (x, y, z), each ``(n,)``; values of cells are a third coordinate."""
    role: str
    """Colour."""
    label: str = ""
    """In the legend; empty leaves it out."""
    kind: str = "line"
    """``line`` for points and lines, which NaN breaks; ``bars`` (lengths x at y), ``band`` (from 0 to y, or from y to a
    third coordinate), ``cells``."""
    marker: str = ""
    line: Any = ""
    """Line style of matplotlib; empty for points."""
    size: float = 3.0
    """Of a mark or the height of a bar."""
    width: float = 1.4
    hollow: bool = False
    alpha: float = 1.0
    texts: Sequence[str] = ()
    """Of each bar, or of each point in the view that turns."""


@dataclass(frozen=True, slots=True)
class Axis:
    """A title with the unit, limits (None fits the data), names, and lines across."""

    title: str
    low: float | None = None
    high: float | None = None
    is_log: bool = False
    is_date: bool = False
    """True for days since 1970."""
    names: Sequence[str] = ()
    """Of the whole numbers from ``first``."""
    first: int = 0
    rules: Sequence[tuple[float, str]] = ()
    """Values with a dashed line across, and its label."""


@dataclass(frozen=True, slots=True)
class Panel:
    """Series on two axes or in space."""

    axes: Sequence[Axis]
    series: Sequence[Series]
    title: str = ""
    equal: bool = False
    """True if both axes have one scale."""


CUBE = (4.9, 4.3)
SPACE = Axis("x, m"), Axis("y, m"), Axis("z, m")


@dataclass(frozen=True, slots=True)
class Chart:
    """One chart of one result."""

    kind: str
    """Kind for ``robacc report --chart``."""
    title: str
    caption: str
    """Explanation of the chart with its main result."""
    alt: str
    """Text alternative: axes and main result."""
    panels: Sequence[Panel | None]
    """Row by row; None leaves a place empty."""
    table: Grid
    size: tuple[float, float] = (4.9, 3.2)
    """Inches; fills half of a page on a screen and stays readable on a phone."""
    columns: int = 1
    scale: str = ""
    """Label of the colours of cells."""
    scene: dict[str, Any] | None = None
    """A view that turns: ``traces`` of plotly, whose colours are as in ``role:before``, titles ``axes``, ``note``."""

    def draw(self, figure: "Figure") -> None:
        """Draw the chart with matplotlib."""
        drawn: list[Any] = []
        rows = -(-len(self.panels) // self.columns)
        for place, panel in enumerate(self.panels, 1):
            if panel is not None:
                drawn.append(
                    figure.add_subplot(rows, self.columns, place, projection="3d" if len(panel.axes) == 3 else None)
                )
                _draw_panel(drawn[-1], panel)
        if self.scale:
            figure.colorbar(
                drawn[-1].collections[0], ax=drawn, location="bottom", shrink=0.8, aspect=30, label=self.scale
            )
        named = {
            label: handle for axes in drawn for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        if named:
            # 70 characters stand in one row, with a mark and a gap for each entry.
            ncols = len(named) if sum(map(len, named)) + 7 * len(named) < 70 else -(-len(named) // 2)
            figure.legend([*named.values()], [*named], loc="outside upper center", ncols=ncols, columnspacing=1.2)


def _draw_panel(axes: Any, panel: Panel) -> None:
    from matplotlib.colors import BoundaryNorm
    from matplotlib.ticker import MaxNLocator

    for series in panel.series:
        colour, label = LIGHT[series.role], series.label or "_"
        if series.kind == "bars":
            bars = axes.barh(
                series.at[1],
                series.at[0],
                height=series.size,
                label=label,
                facecolor="none" if series.hollow else colour,
                edgecolor=colour if series.hollow else "none",
            )
            axes.bar_label(bars, series.texts or [""] * len(bars), padding=3, fontsize=8)
        elif series.kind == "band":
            axes.fill_between(*series.at, color=colour, alpha=series.alpha, linewidth=0, label=label)
        elif series.kind == "cells":
            # Root mean square of the values in hexagons, with a few poses in each.
            x, y, values = series.at
            width, height = (max(float(np.ptp(coordinate)), 1e-3) for coordinate in (x, y))
            across = float(np.clip(np.sqrt(x.size * width / height) * 0.55, 3, 15))
            axes.hexbin(
                x,
                y,
                C=values,
                reduce_C_function=root_mean_square,
                gridsize=(max(2, round(across)), max(2, round(across * height / width / np.sqrt(3)))),
                cmap="cividis",
                norm=BoundaryNorm(MaxNLocator(7).tick_values(values.min(), values.max()), 256),
                linewidths=0.2,
            )
            axes.grid(visible=False)
        else:
            # These marks have no inside.
            axes.plot(
                *series.at,
                marker=series.marker,
                linestyle=series.line or "none",
                color=colour,
                label=label,
                alpha=series.alpha,
                linewidth=series.width,
                markersize=series.size,
                markeredgewidth=min(series.width, 1.0)
                if (series.hollow or series.marker in ("+", "x", "|", "_"))
                else 0,
                markerfacecolor="none" if series.hollow else colour,
            )
    axes.set_title(panel.title, loc="left", fontsize="medium")
    if hasattr(axes, "zaxis"):
        # The axes fit to all points, m, with equal scales.
        points = np.hstack([np.array(series.at) for series in panel.series])
        low, high = np.nanmin(points, axis=1), np.nanmax(points, axis=1)
        # Points on a line, in a plane or at one place need a margin too; m.
        size = np.maximum(high - low, 0.05 * float((high - low).max()) or 1e-3)
        axes.set_box_aspect(tuple(size), zoom=0.9)
        axes.tick_params(labelsize=7.5, pad=-2)
        for name, described, centre, extent in zip("xyz", panel.axes, 0.5 * (low + high), size, strict=True):
            axes.set(**{f"{name}lim": (centre - 0.5 * extent, centre + 0.5 * extent), f"{name}label": described.title})
            axis = getattr(axes, f"{name}axis")
            axis.set_pane_color((0, 0, 0, 0))
            axis.set_major_locator(MaxNLocator(4))
        return
    if panel.equal:
        axes.set_aspect("equal", adjustable="box" if panel.axes[0].low is not None else "datalim")
        axes.locator_params(nbins=4)
    for name, axis in zip("xy", panel.axes, strict=True):
        _draw_axis(axes, name, axis)


def _draw_axis(axes: Any, name: str, axis: Axis) -> None:
    from matplotlib.ticker import LogLocator

    line, limit = getattr(axes, f"{name}axis"), getattr(axes, f"set_{name}lim")
    line.set_label_text(axis.title)
    if axis.is_log:
        getattr(axes, f"set_{name}scale")("log")
        # In a wider range, labels at 2 and 5 would overlap.
        is_long = axis.low and axis.high and axis.high / axis.low > 1000.0
        line.set_major_locator(LogLocator(subs=(1.0,) if is_long else (1.0, 2.0, 5.0)))
        # The style does not parse formulas, so labels are plain numbers.
        line.set_major_formatter("{x:g}")
        line.set_minor_formatter("")
    if axis.is_date:
        dates: Any = import_module("matplotlib.dates")
        locator = dates.AutoDateLocator(maxticks=6)
        line.set_major_locator(locator)
        line.set_major_formatter(dates.ConciseDateFormatter(locator))
    # A call of the limits, even without one, would end the fit to the data.
    if axis.low is not None or axis.high is not None:
        limit(axis.low, axis.high)
    if axis.names:
        count = len(axis.names)
        # No more than 50 characters stand side by side.
        is_tilted = name == "x" and count * max(map(len, axis.names)) > 50
        line.set_ticks(range(axis.first, axis.first + count), axis.names, rotation=60 if is_tilted else 0)
        line.set_tick_params(length=0)
        axes.grid(visible=False, axis=name)
        if name == "y":
            limit(count - 0.4, -0.6)
    low, high = sorted(getattr(axes, f"get_{name}lim")())
    for value, label in axis.rules:
        if low <= value <= high:
            rule, place, shift, side = (
                (axes.axvline, (value, 1.0), (0, 3), "center")
                if name == "x"
                else (axes.axhline, (1.0, value), (0, 2), "right")
            )
            rule(value, color=LIGHT["limit"], linewidth=0.9, linestyle=(0, (3, 2)))
            axes.annotate(
                short(label, 24),
                place,
                shift,
                getattr(axes, f"get_{name}axis_transform")(),
                textcoords="offset points",
                fontsize=8,
                annotation_clip=False,
                ha=side,
                va="bottom",
            )


def scene(series: Sequence[Series], note: str, unit: str = "m") -> dict[str, Any]:
    """Return the view of series in space for plotly, whose coordinates have four digits or 0.1 mm."""
    # Marks of matplotlib that plotly has in space.
    symbols = {"o": "circle", "s": "square", "D": "diamond", "^": "cross", "*": "diamond-open", "+": "cross"}
    return {
        "traces": [
            {
                "type": "scatter3d",
                "name": one.label or "route",
                **{
                    name: [None if math.isnan(value) else float(f"{value:.6g}") for value in column]
                    for name, column in zip(
                        "xyz", (np.round(points, 4) if unit == "m" else points).tolist(), strict=True
                    )
                },
                "mode": "+".join([mode for mode, has in (("lines", one.line), ("markers", one.marker)) if has]),
                "line": {"color": f"role:{one.role}", "width": 3 * one.width},
                "marker": {"size": one.size, "color": f"role:{one.role}", "symbol": symbols.get(one.marker, "circle")},
                **({"text": texts, "hovertemplate": "%{text}<extra></extra>"} if texts else {"hoverinfo": "skip"}),
            }
            for one in series
            for points in [np.array(one.at, dtype=np.float64)]
            # plotly interprets some tags and entities.
            for texts in [[escape(text, quote=False).replace("\n", "<br>") for text in one.texts]]
        ],
        "axes": [f"{name}, {unit}" for name in "xyz"],
        "note": f"Drag to rotate, scroll to zoom{note}.",
    }


# Selection of the poses that a chart shows, reproducible and including the extremes.


def thinned(most: int, *columns: Array) -> Rows:
    """Return the rows to show, ascending: all of them up to ``most``.

    With more rows, a quarter of the selection are the rows with the largest and smallest values of each column
    ``(N,)``; the others are spread evenly over all rows. The selection keeps the range and the extremes.
    """
    n = columns[0].size
    if n <= most:
        return np.arange(n)
    each = max(1, most // (8 * len(columns)))
    orders = np.array(
        [np.argsort(np.where(np.isfinite(own), own, np.nanmedian(own)), kind="stable") for own in columns]
    )
    extreme = np.unique((orders[:, :each], orders[:, -each:]))
    remaining = np.setdiff1d(np.arange(n), extreme)
    evenly = remaining[np.linspace(0, remaining.size - 1, most - extreme.size).round().astype(np.int64)]
    return np.sort(np.concatenate((extreme, evenly)))


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


def root_mean_square(values: Any) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def place(poses: Mapping[str, Any], i: int) -> str:
    """Return the label of a pose: its line in the file, and its ids if it has any."""
    if "label" in poses:
        return str(poses["label"][i])
    parts = [f"line {poses['line'][i]}"]
    parts += [f"{name} {poses[name][i]}" for name in ("pose", "cycle", "target") if poses.get(name)]
    return ", ".join(parts)


# Limits of a gate or of a grade scale, drawn as lines in charts.


def limits_of(document: Document, unit: str) -> list[tuple[str, str, float]]:
    """Return label, short label and value of the gate's limits in ``m`` or ``rad``, or of the grade scale."""
    quantity = "position" if unit == "m" else "orientation"
    steps = [(step["grade"], step[f"{quantity}_{unit}"]) for step in (document.get("grade") or {}).get("steps") or ()]
    return [
        (f"gate {criterion['name']} ({criterion['key']})", str(criterion["name"]), float(criterion["limit"]))
        for criterion in (document.get("gate") or {}).get("criteria", ())
        if criterion["unit"] == unit and quantity in criterion["key"].split(".") and criterion["baseline"] is None
        if isinstance(criterion["limit"], int | float)
    ] or [(f"grade {name}", str(name), size) for name, size in steps if size is not None]


# Drawing as part of a page or as a file.

FONT = "DejaVu Sans"
"""Part of matplotlib, so that text has the same size on every machine."""
_STYLE: dict[Any, Any] = {
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
_WHITE: dict[Any, Any] = {"figure.facecolor": "white"}
_DATES: dict[str, Any] = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}
"""Metadata that files lack, so that the same document gives the same bytes."""


def as_part(chart: Chart, salt: str) -> str:
    """Return the chart as an ``<svg>`` element that uses the colours and the font of the page.

    ``salt`` makes its ids unique on the page.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    buffer = io.StringIO()
    with _drawn(chart, {"svg.fonttype": "none", "svg.hashsalt": salt}) as figure:
        # ``savefig`` would draw twice, once for the layout.
        canvas: Any = FigureCanvasSVG(figure)
        canvas.print_svg(buffer, metadata=_DATES["svg"])
    text = buffer.getvalue()
    text = text[text.index("<svg") :].strip()
    for pattern, new in (
        (r"(?s)<metadata>.*?</metadata>\s*", ""),
        # Groups lose their ids, which repeat from chart to chart; nothing refers to them.
        (r'<g id="[^"]*"', "<g"),
        (r'^(<svg[^>]*?) width="[^"]*"', r"\1"),
        (r'^(<svg[^>]*?) height="[^"]*"', r"\1"),
        (f"'{FONT}'", "var(--font)"),
        *((colour, f"var(--c-{role})") for role, colour in LIGHT.items()),
        (r"\n\s*", "\n"),
    ):
        text = re.sub(pattern, new, text)
    return text


def as_file(chart: Chart, form: str) -> bytes:
    """Return the chart as a file with a white background: ``svg``, ``png`` or ``pdf``."""
    buffer = io.BytesIO()
    with _drawn(chart, {"svg.fonttype": "path", "svg.hashsalt": "robacc", **_WHITE}) as figure:
        figure.savefig(buffer, format=form, metadata=_DATES.get(form))
    return buffer.getvalue()


def as_figure(chart: Chart) -> "Figure":
    """Return the chart as a figure with a white background."""
    with _drawn(chart, _WHITE) as figure:
        return figure


@contextmanager
def _drawn(chart: Chart, overrides: dict[Any, Any]) -> "Iterator[Figure]":
    """Yield the drawn chart, within the style."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_STYLE | overrides), warnings.catch_warnings():
        # A character that the font lacks becomes a box in a file; a page uses the reader's fonts.
        warnings.filterwarnings("ignore", message=".*[Gg]lyph.*missing")
        # Long names may leave too little room for the layout; the chart is still drawn.
        warnings.filterwarnings("ignore", message="constrained_layout not applied")
        figure = Figure(figsize=chart.size, layout="constrained", dpi=220)
        chart.draw(figure)
        yield figure
