"""The residual along an effect over what drives it, without and with the effect; and its spectrum."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.render.plots.chart import ChartTable, Document, Picture
from robacc.render.plots.columns import Array, numbers, place
from robacc.render.plots.labels import short
from robacc.render.plots.palette import LIGHT
from robacc.render.plots.thinning import Rows, shown, thinned
from robacc.render.plots.units import Unit, driver_unit, joint_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_POINTS = 700
_ROWS = 60
_LOOSE = 4.0
"""A pose whose reading is this many times less certain than the middle one's says too little to be drawn."""
_WORDS = {
    "torque": "gravity torque on {joint}",
    "direction": "direction of approach of {joint}",
    "payload_torque": "payload's torque on {joint}",
    "speed": "last speed of {joint}, share of full",
    "time_s": "time",
    "temperature_c": "temperature",
    "payload_kg": "payload",
    "distance": "distance from the instrument",
    "predicted": "what the effect explains",
}

Curve = Mapping[str, Any]


def effect_pictures(document: Document) -> Iterator[Picture]:
    """For each finding (each effect fitted that is no constant), its curves and the spectra of periodic ones."""
    for effect, joints, curve in _curves(document):
        if not np.isfinite(numbers(curve["residual_before"])).any():
            continue
        yield _residual_picture(document, effect, joints, curve)
        if curve["spectrum"] is not None:
            yield _spectrum_picture(effect, curve)


def _curves(document: Document) -> Iterator[tuple[str, str, Curve]]:
    for one in document.get("findings", ()):
        for curve in one.get("partial_residuals", ()):
            yield one["effect"], ", ".join(one["joints"]), curve
    for curve in document.get("partial_residuals", ()):
        yield curve["name"], ", ".join(curve["joints"]), curve


def _residual_picture(document: Document, effect: str, joints: str, curve: Curve) -> Picture:
    before, after = numbers(curve["residual_before"]), numbers(curve["residual_after"])
    sd, x = numbers(curve["sd"]), numbers(curve["x"])
    sure = np.flatnonzero(np.isfinite(sd) & (sd <= _LOOSE * np.nanmedian(sd)))
    rows = sure[thinned(_POINTS, x[sure], before[sure])]
    largest = float(np.quantile(np.abs(before[sure]), 0.99)) if sure.size else 0.0
    unit, by = joint_unit(curve["unit"], largest), _driver(curve, largest)
    name = f"{effect} on {joints}" if joints else effect
    what = f"error of {curve['joint']}" if curve["joint"] else "error along the effect"
    driver = _WORDS.get(curve["driver"], str(curve["driver"])).replace("{joint}", str(curve["joint"]))
    fitted = "the line is the fitted effect" if curve["curve"] is not None else "crosses are the fitted effect"
    left = x.size - sure.size
    loose = f" {left} poses that hardly show this joint's error are not drawn." if left else ""
    caption = (
        f"Each pose's residual, told as the {what}, over the {driver}: before (circles: everything else fitted, this "
        f"effect left out) and after (dots: with it); {fitted}. What the effect explains is gone when the dots lie "
        f"about zero.{loose}{shown(rows.size, sure.size)}"
    )
    spread = [float(np.sqrt(np.mean(np.square(one[sure])))) if sure.size else None for one in (before, after)]
    alt = (
        f"Scatter of {what} in {unit.name} over {driver}{f' in {by.name}' if by.name else ''}; root mean square "
        f"{unit.text(spread[0])} before, {unit.text(spread[1])} after"
    )
    return Picture(
        "effect",
        f"{name}: residual before and after",
        caption,
        alt,
        lambda figure: _draw_residual(figure, curve, rows, unit, by, (what, driver)),
        _residual_table(document, curve, sure, unit, by, driver),
    )


def _driver(curve: Curve, largest: float) -> Unit:
    return joint_unit(curve["unit"], largest) if curve["driver"] == "predicted" else driver_unit(curve["driver_unit"])


def _residual_table(document: Document, curve: Curve, sure: Rows, unit: Unit, by: Unit, driver: str) -> ChartTable:
    x, before = numbers(curve["x"]), numbers(curve["residual_before"])
    rows = sure[thinned(_ROWS, x[sure], before[sure])]
    rows = rows[np.argsort(x[rows], kind="stable")]
    columns = (numbers(curve[key]) for key in ("residual_before", "effect", "residual_after", "sd"))
    values = [[unit.text(value) for value in column[rows].tolist()] for column in columns]
    named = [place(document["poses"], int(i)) for i in rows]
    return ChartTable(
        ("pose", driver, "before", "explained", "after", "standard deviation"),
        [list(row) for row in zip(named, (by.text(v) for v in x[rows].tolist()), *values, strict=True)],
        f"{rows.size} of {x.size} poses, over the whole range; all are in the JSON result."
        if rows.size < x.size
        else "",
    )


def _draw_residual(figure: Figure, curve: Curve, rows: Rows, unit: Unit, by: Unit, words: tuple[str, str]) -> None:
    axes = figure.add_subplot()
    x, before, after = (numbers(curve[key])[rows] for key in ("x", "residual_before", "residual_after"))
    at, size = _spread_out(x, curve["driver"]) * by.factor, max(1.6, 3.6 - rows.size / 350)
    axes.axhline(0, color=LIGHT["muted"], linewidth=0.8)
    axes.plot(at, before * unit.factor, "o", ms=size + 0.4, mfc="none", mew=0.8, color=LIGHT["before"], label="before")
    axes.plot(at, after * unit.factor, "o", ms=size - 0.4, mew=0, color=LIGHT["after"], label="after")
    if curve["curve"] is not None:
        grid, value = numbers(curve["grid"]) * by.factor, numbers(curve["curve"]) * unit.factor
        looks: dict[str, Any] = {"color": LIGHT["ink"], "label": "fitted effect"}
        if curve["driver"] == "direction":
            axes.hlines(value, grid - 0.3, grid + 0.3, linewidth=2, **looks)
        else:
            axes.plot(grid, value, linewidth=1.4, **looks)
    else:
        effect = numbers(curve["effect"])[rows] * unit.factor
        axes.plot(at, effect, "x", ms=3, mew=0.8, color=LIGHT["ink"], label="fitted effect")
    _frame(axes, np.concatenate((before, after)) * unit.factor)
    if curve["driver"] == "direction":
        axes.set_xticks([-1, 0, 1], ["falling (−)", "none", "rising (+)"])
    what, driver = short(words[0], 30), short(words[1], 44)
    axes.set(xlabel=f"{driver}, {by.name}" if by.name else driver, ylabel=f"{what}, {unit.name}")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, handlelength=1.4)


def _spread_out(x: Array, driver: str) -> Array:
    """Poses of one direction set side by side, in their order, so that each is seen."""
    if driver != "direction":
        return x
    return x + 0.24 * (np.arange(x.size) % 13 - 6) / 6


def _frame(axes: Axes, y: Array) -> None:
    """All but the wildest half per cent of the points, with room above and below."""
    low, high = np.quantile(y, (0.0025, 0.9975)) if y.size else (-1.0, 1.0)
    room = 0.08 * (high - low or 1.0)
    axes.set_ylim(low - room, high + room)


def _spectrum_picture(effect: str, curve: Curve) -> Picture:
    spectrum = curve["spectrum"]
    orders, before, after = (numbers(spectrum[key]) for key in ("orders", "before_rad", "after_rad"))
    unit = joint_unit("rad", float(before.max()))
    top = np.argsort(-before, kind="stable")[:20]
    strongest = orders[top[0]]
    joint = curve["joint"]
    return Picture(
        "spectrum",
        f"{effect} on {joint}: spectrum of the residual",
        f"Amplitude of the error of {joint} at each order (periods per turn of the joint) that these poses can show, "
        f"before and after. The strongest is order {strongest:g} with {unit.text(before[top[0]])}; the dashed line is "
        "what noise alone would show.",
        f"Amplitude in {unit.name} over periods per turn; strongest at order {strongest:g}, "
        f"{unit.text(before[top[0]])} before and {unit.text(after[top[0]])} after",
        lambda figure: _draw_spectrum(figure, orders, before, after, spectrum["noise_rad"], joint, unit),
        ChartTable(
            ("order", "before", "after"),
            [[f"{orders[i]:g}", unit.text(before[i]), unit.text(after[i])] for i in top],
            f"The {top.size} strongest of {orders.size} orders." if top.size < orders.size else "",
        ),
    )


def _draw_spectrum(
    figure: Figure, orders: Array, before: Array, after: Array, noise: float, joint: str, unit: Unit
) -> None:
    axes = figure.add_subplot()
    axes.fill_between(orders, before * unit.factor, color=LIGHT["before"], alpha=0.18, linewidth=0)
    axes.plot(orders, before * unit.factor, color=LIGHT["before"], linewidth=1.1, linestyle=(0, (5, 1)), label="before")
    axes.plot(orders, after * unit.factor, color=LIGHT["after"], linewidth=1.3, label="after")
    axes.axhline(noise * unit.factor, color=LIGHT["ink"], linewidth=0.9, linestyle=(0, (3, 2)), label="noise alone")
    axes.set(
        xlim=(0, orders[-1]), ylabel=f"amplitude, {unit.name}", xlabel=f"order, periods per turn of {short(joint)}"
    )
    axes.set_ylim(bottom=0)
    axes.legend(loc="upper right")
