"""Charts of a trace: candidates with their evidence, and the residual along each effect over its driver."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from robacc.render.plots.canvas import (
    Axis,
    Chart,
    Panel,
    Rows,
    Series,
    numbers,
    place,
    root_mean_square,
    short,
    thinned,
    thinning_note,
)
from robacc.render.text.layout import Document, Unit, effect_label, error_unit, fixed, p_value, table_unit
from robacc.render.views.elements import Grid

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
    curves = [
        (finding["effect"], finding["joints"], curve)
        for finding in document.get("findings", ())
        for curve in finding.get("partial_residuals", ())
    ]
    curves += [(curve["name"], curve["joints"], curve) for curve in document.get("partial_residuals", ())]
    for effect, joints, curve in curves:
        if np.isfinite(numbers(curve["residual_before"])).any():
            name = f"{effect} on {', '.join(joints)}" if joints else effect
            yield _residual_chart(document, name, curve)
            if curve["spectrum"] is not None:
                yield _spectrum_chart(effect, curve)


def _residual_chart(document: Document, name: str, curve: Curve) -> Chart:
    x, sd, before, after = (numbers(curve[key]) for key in ("x", "sd", "residual_before", "residual_after"))
    usable = np.flatnonzero(np.isfinite(sd) & (sd <= _MAX_RELATIVE_STD * np.nanmedian(sd)))
    rows = usable[thinned(_POINTS, x[usable], before[usable])]
    unit = error_unit(curve["unit"], float(np.quantile(np.abs(before[usable]), 0.99)) if usable.size else 0.0)
    x_unit = Unit(1.0, "m") if curve["driver_unit"] == "m" else table_unit(curve["driver_unit"])
    if curve["driver"] == "predicted":
        x_unit = unit
    quantity = f"error of {curve['joint']}" if curve["joint"] else "error along the effect"
    driver = _DRIVER_LABELS.get(curve["driver"], str(curve["driver"])).replace("{joint}", str(curve["joint"]))
    fitted = "the line is the fitted effect" if curve["curve"] is not None else "crosses are the fitted effect"
    omitted = x.size - usable.size
    omitted_note = f" {omitted} poses that determine this error too weakly are omitted." * (omitted > 0)
    rms = [root_mean_square(residual[usable]) if usable.size else None for residual in (before, after)]
    return Chart(
        "effect",
        f"{name}: residual without and with the effect",
        f"Residual of each pose as {quantity} over {driver}, without the effect (circles, all other effects fitted) "
        f"and with it (dots); {fitted}. Dots around zero show that the effect explains the residual."
        f"{omitted_note}{thinning_note(rows.size, usable.size)}",
        f"Scatter of {quantity} in {unit.name} over {driver}{f' in {x_unit.name}' if x_unit.name else ''}; root mean "
        f"square {unit.text(rms[0])} without the effect, {unit.text(rms[1])} with it",
        [_residual_panel(curve, rows, unit, x_unit, short(quantity, 30), short(driver, 44))],
        _residual_table(document, curve, usable, unit, x_unit, driver),
    )


def _residual_table(document: Document, curve: Curve, usable: Rows, unit: Unit, x_unit: Unit, driver: str) -> Grid:
    x, before = numbers(curve["x"]), numbers(curve["residual_before"])
    rows = usable[thinned(_EFFECT_ROWS, x[usable], before[usable])]
    rows = rows[np.argsort(x[rows], kind="stable")]
    columns = [numbers(curve[key]) for key in ("residual_before", "effect", "residual_after", "sd")]
    return Grid(
        ("pose", driver, "without effect", "effect", "with effect", "standard deviation"),
        [
            [place(document["poses"], int(i)), x_unit.text(x[i]), *(unit.text(column[i]) for column in columns)]
            for i in rows
        ],
        note=f"{rows.size} of {x.size} poses over the range of the driver; the JSON result has all of them."
        * (rows.size < x.size),
    )


def _residual_panel(curve: Curve, rows: Rows, unit: Unit, x_unit: Unit, quantity: str, driver: str) -> Panel:
    keys = ("x", "residual_before", "residual_after", "effect")
    x, before, after, effect = (numbers(curve[key])[rows] for key in keys)
    before, after = before * unit.factor, after * unit.factor
    is_direction = curve["driver"] == "direction"
    # Poses of one direction are spread in their order to stay visible.
    at = (x + is_direction * 0.04 * (np.arange(x.size) % 13 - 6)) * x_unit.factor
    size = max(1.6, 3.6 - rows.size / 350)
    series = [
        Series((at, before), "before", "without effect", marker="o", size=size + 0.4, hollow=True, width=0.8),
        Series((at, after), "after", "with effect", marker="o", size=size - 0.4),
    ]
    if curve["curve"] is None:
        series.append(Series((at, effect * unit.factor), "ink", "fitted effect", marker="x", width=0.8))
    else:
        grid, value = numbers(curve["grid"]) * x_unit.factor, numbers(curve["curve"]) * unit.factor
        if is_direction:
            grid = (grid[:, None] + [-0.3, 0.3, np.nan]).ravel()
            value = np.repeat(value, 3)
        series.append(Series((grid, value), "ink", "fitted effect", line="-", width=1.4 + 0.6 * is_direction))
    y = np.concatenate((before, after))
    # 99.5 % of the points, with a margin.
    low, high = np.quantile(y, (0.0025, 0.9975)) if y.size else (-1.0, 1.0)
    room = 0.08 * (high - low or 1.0)
    x_axis = Axis(f"{driver}, {x_unit.name}" if x_unit.name else driver)
    if is_direction:
        x_axis = Axis(driver, names=("falling (−)", "none", "rising (+)"), first=-1)
    return Panel((x_axis, Axis(f"{quantity}, {unit.name}", low - room, high + room, rules=[(0, "")])), series)


def _spectrum_chart(effect: str, curve: Curve) -> Chart:
    spectrum, joint = curve["spectrum"], curve["joint"]
    orders, before, after = (numbers(spectrum[key]) for key in ("orders", "before_rad", "after_rad"))
    unit = error_unit("rad")
    top = np.argsort(-before, kind="stable")[:20]
    strongest = orders[top[0]]
    y = before * unit.factor
    return Chart(
        "spectrum",
        f"{effect} on {joint}: spectrum of the residual",
        f"Amplitude of the error of {joint} at each order (periods per turn of the joint) that these poses resolve, "
        f"without and with the effect. The strongest is order {strongest:g} with {unit.text(before[top[0]])}; the "
        "dashed line is the amplitude expected from noise alone.",
        f"Amplitude in {unit.name} over periods per turn; strongest at order {strongest:g}, "
        f"{unit.text(before[top[0]])} without the effect and {unit.text(after[top[0]])} with it",
        [
            Panel(
                (
                    Axis(f"order, periods per turn of {short(joint)}", 0, orders[-1]),
                    Axis(f"amplitude, {unit.name}", 0, rules=[(spectrum["noise_rad"] * unit.factor, "noise alone")]),
                ),
                [
                    Series((orders, y), "before", kind="band", alpha=0.18),
                    Series((orders, y), "before", "without effect", line=(0, (5, 1)), width=1.1),
                    Series((orders, after * unit.factor), "after", "with effect", line="-", width=1.3),
                ],
            )
        ],
        Grid(
            ("order", "without effect", "with effect"),
            [[f"{orders[i]:g}", unit.text(before[i]), unit.text(after[i])] for i in top],
            note=f"The {top.size} strongest of {orders.size} orders." * (top.size < orders.size),
        ),
    )


# Charts of the candidates at each step of a trace, with their evidence.

_BARS = 8
_CANDIDATE_ROWS = 40


def candidate_charts(document: Document) -> Iterator[Chart]:
    """Return one chart per step, the best candidate of each effect and joint by evidence.

    The steps are those that add an effect and the last that adds none, without exchanges of forms.
    """
    steps: Sequence[Mapping[str, Any]] = document.get("candidates", ())
    shown = [step for step in steps if step["action"] == "add"] + [s for s in steps if s["action"] == "stop"][-1:]
    for number, step in enumerate(shown, 1):
        best: dict[str, Mapping[str, Any]] = {}
        # The ranking combines evidence and prior; bars show and follow the evidence alone.
        for candidate in sorted(step["ranking"], key=lambda candidate: -candidate["evidence"]):
            best.setdefault(_name(candidate), candidate)
        if best:
            yield _candidates_chart(number, best, _name(step["ranking"][0]) if step["action"] == "add" else None)


def _name(candidate: Mapping[str, Any]) -> str:
    """Return the effect with its joints or the part that changes; forms of an effect have one name."""
    settings = candidate.get("settings") or {}
    part = {key: settings[key] for key in ("part", "target") if key in settings}
    return effect_label(candidate["effect"], candidate["joints"], part)


def _candidates_chart(number: int, ranked: Mapping[str, Mapping[str, Any]], chosen: str | None) -> Chart:
    names, evidence = [*ranked], [candidate["evidence"] for candidate in ranked.values()]
    runner_up = f"; next is {names[1]} with {evidence[1]:.1f}" if len(ranked) > 1 else ""
    outcome = "No effect was added."
    if chosen is not None:
        outcome = f"{'It' if chosen == names[0] else f'{chosen}, which has a higher prior,'} was added to the model."
    count = min(len(names), _BARS)
    bars = []
    for role, label in (("after", "added" * (chosen in names[:count])), ("nominal", "")):
        own = [i for i in range(count) if (names[i] == chosen) == (role == "after")]
        sizes, texts = [max(evidence[i], 0.0) for i in own], [fixed(evidence[i], 1) for i in own]
        bars.append(Series((sizes, own), role, label, kind="bars", size=0.62, texts=texts))
    high = 1.16 * max(*evidence, 1e-9)
    return Chart(
        "candidates",
        f"Step {number}: candidates" if chosen is not None else "Last step: remaining candidates",
        f"Evidence (log Bayes factor) for each candidate effect; the highest is {names[0]} with "
        f"{evidence[0]:.1f}, {p_value(ranked[names[0]]['p_value'])}{runner_up}. {outcome}",
        "Bars of evidence (log Bayes factor): "
        + "; ".join(f"{name} {value:.1f}" for name, value in zip(names[:_BARS], evidence, strict=False)),
        [
            Panel(
                (
                    Axis("evidence (log Bayes factor)", 0, high),
                    Axis("", names=[short(name, 34) for name in names[:count]]),
                ),
                bars,
            )
        ],
        Grid(
            ("effect", "evidence", "significance"),
            [[name, f"{c['evidence']:.1f}", p_value(c["p_value"])] for name, c in ranked.items()][:_CANDIDATE_ROWS],
            note=f"The best {_CANDIDATE_ROWS} of {len(ranked)}." * (len(ranked) > _CANDIDATE_ROWS),
        ),
        (4.9, 0.9 + 0.27 * count + 0.25 * bool(chosen)),
    )
