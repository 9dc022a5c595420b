"""Charts of a trace: candidates with their evidence, and the residual along each effect over its driver."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.render.plots.canvas import (
    LIGHT,
    Array,
    Chart,
    ChartTable,
    Document,
    Rows,
    Unit,
    driver_unit,
    joint_unit,
    numbers,
    place,
    short,
    thinned,
    thinning_note,
)
from robacc.render.text.layout import effect_label, p_value

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_POINTS = 700
_EFFECT_ROWS = 60
_MAX_RELATIVE_STD = 4.0
"""Poses with a standard deviation above this multiple of the median are not plotted."""
_DRIVER_LABELS = {
    "torque": "gravity torque on {joint}",
    "direction": "direction of approach of {joint}",
    "payload_torque": "payload torque on {joint}",
    "speed": "last speed of {joint}, relative to full speed",
    "time_s": "time",
    "temperature_c": "temperature",
    "payload_kg": "payload",
    "distance": "distance from the instrument",
    "predicted": "prediction of the effect",
}

Curve = Mapping[str, Any]


def effect_charts(document: Document) -> Iterator[Chart]:
    """Return the residuals of each finding or fitted effect that is not constant, and the spectra of periodic ones."""
    for effect, joints, curve in _curves(document):
        if not np.isfinite(numbers(curve["residual_before"])).any():
            continue
        yield _residual_chart(document, effect, joints, curve)
        if curve["spectrum"] is not None:
            yield _spectrum_chart(effect, curve)


def _curves(document: Document) -> Iterator[tuple[str, str, Curve]]:
    for finding in document.get("findings", ()):
        for curve in finding.get("partial_residuals", ()):
            yield finding["effect"], ", ".join(finding["joints"]), curve
    for curve in document.get("partial_residuals", ()):
        yield curve["name"], ", ".join(curve["joints"]), curve


def _residual_chart(document: Document, effect: str, joints: str, curve: Curve) -> Chart:
    before, after = numbers(curve["residual_before"]), numbers(curve["residual_after"])
    sd, x = numbers(curve["sd"]), numbers(curve["x"])
    usable = np.flatnonzero(np.isfinite(sd) & (sd <= _MAX_RELATIVE_STD * np.nanmedian(sd)))
    rows = usable[thinned(_POINTS, x[usable], before[usable])]
    largest = float(np.quantile(np.abs(before[usable]), 0.99)) if usable.size else 0.0
    unit, x_unit = joint_unit(curve["unit"], largest), _driver(curve, largest)
    name = f"{effect} on {joints}" if joints else effect
    quantity = f"error of {curve['joint']}" if curve["joint"] else "error along the effect"
    driver = _DRIVER_LABELS.get(curve["driver"], str(curve["driver"])).replace("{joint}", str(curve["joint"]))
    fitted = "the line is the fitted effect" if curve["curve"] is not None else "crosses are the fitted effect"
    omitted = x.size - usable.size
    omitted_note = f" {omitted} poses that determine this error too weakly are omitted." if omitted else ""
    caption = (
        f"Residual of each pose as {quantity} over {driver}, without the effect (circles, all other effects fitted) "
        f"and with it (dots); {fitted}. Dots around zero show that the effect explains the residual."
        f"{omitted_note}{thinning_note(rows.size, usable.size)}"
    )
    rms = [
        float(np.sqrt(np.mean(np.square(residual[usable])))) if usable.size else None for residual in (before, after)
    ]
    alt = (
        f"Scatter of {quantity} in {unit.name} over {driver}{f' in {x_unit.name}' if x_unit.name else ''}; root mean "
        f"square {unit.text(rms[0])} without the effect, {unit.text(rms[1])} with it"
    )
    return Chart(
        "effect",
        f"{name}: residual without and with the effect",
        caption,
        alt,
        lambda figure: _draw_residual(figure, curve, rows, unit, x_unit, (quantity, driver)),
        _residual_table(document, curve, usable, unit, x_unit, driver),
    )


def _driver(curve: Curve, largest: float) -> Unit:
    return joint_unit(curve["unit"], largest) if curve["driver"] == "predicted" else driver_unit(curve["driver_unit"])


def _residual_table(
    document: Document, curve: Curve, usable: Rows, unit: Unit, x_unit: Unit, driver: str
) -> ChartTable:
    x, before = numbers(curve["x"]), numbers(curve["residual_before"])
    rows = usable[thinned(_EFFECT_ROWS, x[usable], before[usable])]
    rows = rows[np.argsort(x[rows], kind="stable")]
    columns = (numbers(curve[key]) for key in ("residual_before", "effect", "residual_after", "sd"))
    values = [[unit.text(value) for value in column[rows].tolist()] for column in columns]
    names = [place(document["poses"], int(i)) for i in rows]
    return ChartTable(
        ("pose", driver, "without effect", "effect", "with effect", "standard deviation"),
        [list(row) for row in zip(names, (x_unit.text(v) for v in x[rows].tolist()), *values, strict=True)],
        f"{rows.size} of {x.size} poses over the range of the driver; the JSON result has all of them."
        if rows.size < x.size
        else "",
    )


def _draw_residual(figure: Figure, curve: Curve, rows: Rows, unit: Unit, x_unit: Unit, labels: tuple[str, str]) -> None:
    axes = figure.add_subplot()
    x, before, after = (numbers(curve[key])[rows] for key in ("x", "residual_before", "residual_after"))
    at, size = _spread_out(x, curve["driver"]) * x_unit.factor, max(1.6, 3.6 - rows.size / 350)
    axes.axhline(0, color=LIGHT["muted"], linewidth=0.8)
    axes.plot(
        at, before * unit.factor, "o", ms=size + 0.4, mfc="none", mew=0.8, color=LIGHT["before"], label="without effect"
    )
    axes.plot(at, after * unit.factor, "o", ms=size - 0.4, mew=0, color=LIGHT["after"], label="with effect")
    if curve["curve"] is not None:
        grid, value = numbers(curve["grid"]) * x_unit.factor, numbers(curve["curve"]) * unit.factor
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
    quantity, driver = short(labels[0], 30), short(labels[1], 44)
    axes.set(xlabel=f"{driver}, {x_unit.name}" if x_unit.name else driver, ylabel=f"{quantity}, {unit.name}")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, handlelength=1.4)


def _spread_out(x: Array, driver: str) -> Array:
    """Return positions on the axis; poses of one direction are spread in their order to stay visible."""
    if driver != "direction":
        return x
    return x + 0.24 * (np.arange(x.size) % 13 - 6) / 6


def _frame(axes: Axes, y: Array) -> None:
    """Set the limits of the axis to 99.5 % of the points with a margin."""
    low, high = np.quantile(y, (0.0025, 0.9975)) if y.size else (-1.0, 1.0)
    room = 0.08 * (high - low or 1.0)
    axes.set_ylim(low - room, high + room)


def _spectrum_chart(effect: str, curve: Curve) -> Chart:
    spectrum = curve["spectrum"]
    orders, before, after = (numbers(spectrum[key]) for key in ("orders", "before_rad", "after_rad"))
    unit = joint_unit("rad", float(before.max()))
    top = np.argsort(-before, kind="stable")[:20]
    strongest = orders[top[0]]
    joint = curve["joint"]
    return Chart(
        "spectrum",
        f"{effect} on {joint}: spectrum of the residual",
        f"Amplitude of the error of {joint} at each order (periods per turn of the joint) that these poses resolve, "
        f"without and with the effect. The strongest is order {strongest:g} with {unit.text(before[top[0]])}; the "
        "dashed line is the amplitude expected from noise alone.",
        f"Amplitude in {unit.name} over periods per turn; strongest at order {strongest:g}, "
        f"{unit.text(before[top[0]])} without the effect and {unit.text(after[top[0]])} with it",
        lambda figure: _draw_spectrum(figure, orders, before, after, spectrum["noise_rad"], joint, unit),
        ChartTable(
            ("order", "without effect", "with effect"),
            [[f"{orders[i]:g}", unit.text(before[i]), unit.text(after[i])] for i in top],
            f"The {top.size} strongest of {orders.size} orders." if top.size < orders.size else "",
        ),
    )


def _draw_spectrum(
    figure: Figure, orders: Array, before: Array, after: Array, noise: float, joint: str, unit: Unit
) -> None:
    axes = figure.add_subplot()
    axes.fill_between(orders, before * unit.factor, color=LIGHT["before"], alpha=0.18, linewidth=0)
    axes.plot(
        orders,
        before * unit.factor,
        color=LIGHT["before"],
        linewidth=1.1,
        linestyle=(0, (5, 1)),
        label="without effect",
    )
    axes.plot(orders, after * unit.factor, color=LIGHT["after"], linewidth=1.3, label="with effect")
    axes.axhline(noise * unit.factor, color=LIGHT["ink"], linewidth=0.9, linestyle=(0, (3, 2)), label="noise alone")
    axes.set(
        xlim=(0, orders[-1]), ylabel=f"amplitude, {unit.name}", xlabel=f"order, periods per turn of {short(joint)}"
    )
    axes.set_ylim(bottom=0)
    axes.legend(loc="upper right")


# Charts of the candidates at each step of a trace, with their evidence.

_BARS = 8
_CANDIDATE_ROWS = 40


def candidate_charts(document: Document) -> Iterator[Chart]:
    """Return one chart per step, the best candidate of each effect and joint by evidence."""
    for number, step in enumerate(_shown_steps(document.get("candidates", ())), 1):
        ranked = _distinct(step["ranking"])
        if ranked:
            yield _chart(number, ranked, _name(step["ranking"][0]) if step["action"] == "add" else None)


def _shown_steps(steps: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the steps that add an effect and the last step that adds none, without exchanges of forms."""
    last = next((step for step in reversed(steps) if step["action"] == "stop"), None)
    return [step for step in steps if step["action"] == "add"] + ([] if last is None else [last])


def _distinct(ranking: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    best: dict[str, Mapping[str, Any]] = {}
    # The ranking combines evidence and prior; bars show and follow the evidence alone.
    for candidate in sorted(ranking, key=lambda candidate: -candidate["evidence"]):
        best.setdefault(_name(candidate), candidate)
    return list(best.values())


def _name(candidate: Mapping[str, Any]) -> str:
    """Return the effect with its joints or the part that changes; forms of an effect have one name."""
    settings = candidate.get("settings") or {}
    part = {key: settings[key] for key in ("part", "target") if key in settings}
    return effect_label(candidate["effect"], candidate["joints"], part)


def _chart(number: int, ranked: Sequence[Mapping[str, Any]], chosen: str | None) -> Chart:
    first = ranked[0]
    runner_up = f"; next is {_name(ranked[1])} with {ranked[1]['evidence']:.1f}" if len(ranked) > 1 else ""
    outcome = "No effect was added."
    if chosen is not None:
        added = "It" if chosen == _name(first) else f"{chosen}, which has a higher prior,"
        outcome = f"{added} was added to the model."
    return Chart(
        "candidates",
        f"Step {number}: candidates" if chosen is not None else "Last step: remaining candidates",
        f"Evidence (log Bayes factor) for each candidate effect; the highest is {_name(first)} with "
        f"{first['evidence']:.1f}, {p_value(first['p_value'])}{runner_up}. {outcome}",
        "Bars of evidence (log Bayes factor): "
        + "; ".join(f"{_name(candidate)} {candidate['evidence']:.1f}" for candidate in ranked[:_BARS]),
        lambda figure: _draw(figure, ranked[:_BARS], chosen),
        ChartTable(
            ("effect", "evidence", "significance"),
            [
                [_name(candidate), f"{candidate['evidence']:.1f}", p_value(candidate["p_value"])]
                for candidate in ranked[:_CANDIDATE_ROWS]
            ],
            f"The best {_CANDIDATE_ROWS} of {len(ranked)}." if len(ranked) > _CANDIDATE_ROWS else "",
        ),
        (4.9, 0.9 + 0.27 * min(len(ranked), _BARS)),
    )


def _draw(figure: Figure, ranked: Sequence[Mapping[str, Any]], chosen: str | None) -> None:
    axes = figure.add_subplot()
    values = [candidate["evidence"] for candidate in ranked]
    colours = [LIGHT["after"] if _name(candidate) == chosen else LIGHT["nominal"] for candidate in ranked]
    bars = axes.barh(range(len(ranked)), values, color=colours, height=0.62)
    axes.bar_label(bars, [f"{value:.1f}" for value in values], padding=3, fontsize=8)
    axes.set_yticks(range(len(ranked)), [short(_name(candidate), 34) for candidate in ranked])
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.invert_yaxis()
    axes.set_xlim(0, 1.16 * max(*values, 1e-9) if len(values) > 1 else 1.16 * max(values[0], 1e-9))
    axes.set_xlabel("evidence (log Bayes factor)")
