"""Charts of results, but for those of their poses; and all charts of a result in reading order."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from robacc.errors import refuse
from robacc.render.plots.canvas import (
    Array,
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
    vectors,
)
from robacc.render.plots.poses import (
    CIRCLE,
    correction_charts,
    distribution_charts,
    ellipsoid_charts,
    error_over_time_charts,
    planned_poses_charts,
    warranty_charts,
    workspace_3d_charts,
    workspace_charts,
)
from robacc.render.text import Document, Grid, Unit, day, effect_families, effect_label, fixed, p_value, unit_of

# The residual along each effect over its driver.

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
            yield _residual_chart(document, f"{effect} on {', '.join(joints)}" if joints else effect, curve)
            if curve["spectrum"] is not None:
                yield _spectrum_chart(effect, curve)


def _residual_chart(document: Document, name: str, curve: Document) -> Chart:
    columns = [numbers(curve[key]) for key in ("residual_before", "effect", "residual_after", "sd")]
    x, (before, _, after, sd) = numbers(curve["x"]), columns
    # Poses that determine the error too weakly are not plotted.
    usable = np.flatnonzero(np.isfinite(sd) & (sd <= 4.0 * np.nanmedian(sd)))
    rows = usable[thinned(700, x[usable], before[usable])]
    listed = usable[thinned(60, x[usable], before[usable])]
    listed = listed[np.argsort(x[listed], kind="stable")]
    unit = unit_of(curve["unit"], float(np.quantile(np.abs(before[usable]), 0.99)) if usable.size else 0.0)
    x_unit = Unit(1.0, "m") if curve["driver_unit"] == "m" else unit_of(curve["driver_unit"])
    if curve["driver"] == "predicted":
        x_unit = unit
    quantity = f"error of {curve['joint']}" if curve["joint"] else "error along the effect"
    driver = _DRIVER_LABELS.get(curve["driver"], str(curve["driver"])).replace("{joint}", str(curve["joint"]))
    mark, omitted = "crosses are" if curve["curve"] is None else "the line is", x.size - usable.size
    rms = [unit.text(root_mean_square(residual[usable]) if usable.size else None) for residual in (before, after)]
    return Chart(
        "effect",
        f"{name}: residual without and with the effect",
        f"Residual of each pose as {quantity} over {driver}, without the effect (circles, all other effects fitted) "
        f"and with it (dots); {mark} the fitted effect. Dots around zero show that the effect explains the residual."
        + f" {omitted} poses that determine this error too weakly are omitted." * (omitted > 0)
        + thinning_note(rows.size, usable.size),
        f"Scatter of {quantity} in {unit.name} over {driver}{f' in {x_unit.name}' if x_unit.name else ''}; root mean "
        f"square {rms[0]} without the effect, {rms[1]} with it",
        [_residual_panel(curve, rows, unit, x_unit, short(quantity, 30), short(driver, 44))],
        Grid(
            ("pose", driver, "without effect", "effect", "with effect", "standard deviation"),
            [
                [place(document["poses"], int(i)), x_unit.text(x[i]), *(unit.text(column[i]) for column in columns)]
                for i in listed
            ],
            note=f"{listed.size} of {x.size} poses over the range of the driver; the JSON result has all of them."
            * (listed.size < x.size),
        ),
    )


def _residual_panel(curve: Document, rows: Rows, unit: Unit, x_unit: Unit, quantity: str, driver: str) -> Panel:
    x, before, after, effect = (
        numbers(curve[key])[rows] for key in ("x", "residual_before", "residual_after", "effect")
    )
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
            grid, value = (grid[:, None] + [-0.3, 0.3, np.nan]).ravel(), np.repeat(value, 3)
        series.append(Series((grid, value), "ink", "fitted effect", line="-", width=1.4 + 0.6 * is_direction))
    y = np.concatenate((before, after))
    # 99.5 % of the points, with a margin.
    low, high = np.quantile(y, (0.0025, 0.9975)) if y.size else (-1.0, 1.0)
    room = 0.08 * (high - low or 1.0)
    x_axis = (
        Axis(driver, names=("falling (−)", "none", "rising (+)"), first=-1)
        if is_direction
        else Axis(f"{driver}, {x_unit.name}" if x_unit.name else driver)
    )
    return Panel((x_axis, Axis(f"{quantity}, {unit.name}", low - room, high + room, rules=[(0, "")])), series)


def _spectrum_chart(effect: str, curve: Document) -> Chart:
    spectrum, joint, unit = curve["spectrum"], curve["joint"], unit_of("rad")
    orders, before, after = (numbers(spectrum[key]) for key in ("orders", "before_rad", "after_rad"))
    top = np.argsort(-before, kind="stable")[:20]
    first, without, with_it = f"{orders[top[0]]:g}", unit.text(before[top[0]]), unit.text(after[top[0]])
    y = before * unit.factor
    return Chart(
        "spectrum",
        f"{effect} on {joint}: spectrum of the residual",
        f"Amplitude of the error of {joint} at each order (periods per turn of the joint) that these poses resolve, "
        f"without and with the effect. The strongest is order {first} with {without}; the dashed line is the amplitude "
        "expected from noise alone.",
        f"Amplitude in {unit.name} over periods per turn; strongest at order {first}, {without} without the effect and "
        f"{with_it} with it",
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


# The candidates at each step of a trace, with their evidence.


def candidate_charts(document: Document) -> Iterator[Chart]:
    """Return one chart per step, the best candidate of each effect and joint by evidence.

    The steps are those that add an effect and the last that adds none, without exchanges of forms.
    """
    steps: Sequence[Document] = document.get("candidates", ())
    shown = [step for step in steps if step["action"] == "add"] + [s for s in steps if s["action"] == "stop"][-1:]
    for number, step in enumerate(shown, 1):
        ranked: dict[str, Document] = {}
        # The ranking combines evidence and prior; bars show and follow the evidence alone.
        for candidate in sorted(step["ranking"], key=lambda candidate: -candidate["evidence"]):
            ranked.setdefault(_name(candidate), candidate)
        if not ranked:
            continue
        names, evidence = [*ranked], [candidate["evidence"] for candidate in ranked.values()]
        bars, most, outcome = min(len(names), 8), 40, "No effect was added."
        chosen = _name(step["ranking"][0]) if step["action"] == "add" else None
        if chosen is not None:
            subject = "It" if chosen == names[0] else f"{chosen}, which has a higher prior,"
            outcome = f"{subject} was added to the model."
        runner_up = f"; next is {names[1]} with {evidence[1]:.1f}" if len(ranked) > 1 else ""
        yield Chart(
            "candidates",
            f"Step {number}: candidates" if chosen is not None else "Last step: remaining candidates",
            f"Evidence (log Bayes factor) for each candidate effect; the highest is {names[0]} with "
            f"{evidence[0]:.1f}, {p_value(ranked[names[0]]['p_value'])}{runner_up}. {outcome}",
            "Bars of evidence (log Bayes factor): "
            + "; ".join(f"{name} {value:.1f}" for name, value in zip(names[:bars], evidence, strict=False)),
            [
                Panel(
                    (
                        Axis("evidence (log Bayes factor)", 0, 1.16 * max(*evidence, 1e-9)),
                        Axis("", names=[short(name, 34) for name in names[:bars]]),
                    ),
                    [
                        Series(
                            ([max(evidence[i], 0.0) for i in own], own),
                            role,
                            label,
                            kind="bars",
                            size=0.62,
                            texts=[fixed(evidence[i], 1) for i in own],
                        )
                        for role, label in (("after", "added" * (chosen in names[:bars])), ("nominal", ""))
                        for own in [[i for i in range(bars) if (names[i] == chosen) == (role == "after")]]
                    ],
                )
            ],
            Grid(
                ("effect", "evidence", "significance"),
                [[name, f"{c['evidence']:.1f}", p_value(c["p_value"])] for name, c in ranked.items()][:most],
                note=f"The best {most} of {len(ranked)}." * (len(ranked) > most),
            ),
            (4.9, 0.9 + 0.27 * bars + 0.25 * bool(chosen)),
        )


def _name(candidate: Document) -> str:
    """Return the effect with its joints or the part that changes; forms of an effect have one name."""
    settings = candidate.get("settings") or {}
    return effect_label(
        candidate["effect"], candidate["joints"], {key: settings[key] for key in ("part", "target") if key in settings}
    )


# The error budget of a prediction.


def budget_charts(document: Document) -> Iterator[Chart]:
    """Return the shares by parameter and by joint."""
    if shares := document.get("budget"):
        yield _budget_chart("budget", shares, "parameter", "source" if shares[0].get("sd") is None else "parameter")
    if shares := document.get("budget_by_joint"):
        yield _budget_chart("budget-joints", shares, "name", "joint")


def _budget_chart(kind: str, shares: Sequence[Document], name: str, label: str) -> Chart:
    first, toleranced, top = shares[0], label == "parameter", shares[:10]
    rows = np.arange(len(top))
    position, turn = (100 * numbers(share[f"share_{key}"] for share in top) for key in ("position", "orientation"))
    return Chart(
        kind,
        f"Error budget by {label}",
        f"Share of the predicted variance of position (bars) and orientation (outlines) by {label}; all shares sum to "
        f"100 %. The largest share of position is {first[name]} with {100 * first['share_position']:.1f} %."
        + f" The table has the {len(shares) - len(top)} smaller shares."
        * (len(shares) > len(top)),
        "Bars of shares of variance, position: "
        + "; ".join(f"{share[name]} {100 * share['share_position']:.1f} %" for share in top),
        [
            Panel(
                (
                    Axis("share of the variance, %", 0, 1.12 * max(*position, *turn)),
                    Axis("", names=[short(str(share[name])) for share in top]),
                ),
                [
                    Series(
                        (position, rows - 0.17),
                        "after",
                        "position",
                        kind="bars",
                        size=0.34,
                        texts=[f"{value:.1f}" for value in position],
                    ),
                    Series((turn, rows + 0.19), "before", "orientation", kind="bars", size=0.26, hollow=True),
                ],
            )
        ],
        Grid(
            (label, *(("tolerance (sd)",) * toleranced), "position", "orientation"),
            [
                [
                    str(share[name]),
                    *([unit_of(share["unit"], share["sd"]).text(share["sd"])] if toleranced else []),
                    *(f"{100 * share[f'share_{key}']:.2f} %" for key in ("position", "orientation")),
                ]
                for share in shares
            ],
        ),
        (4.9, 1.05 + 0.3 * len(top)),
    )


# A statistic of several results with its intervals.


def comparison_charts(document: Document) -> Iterator[Chart]:
    """Return a chart for each statistic with intervals, except those of stages; the ranking statistic comes first."""
    if document["command"] != "compare":
        return
    by, baseline = (document.get("ranking") or {}).get("by"), document["baseline"]
    for statistic in sorted(document["statistics"], key=lambda statistic: statistic["key"] != by):
        key = statistic["key"]
        values = [value for value in statistic["values"] if value["value"] is not None][:30]
        is_shown = statistic["unit"] in ("m", "rad") and (key == by or key.count(".") == 1)
        if not is_shown or len(values) < 2 or all(value["lower"] is None for value in values):
            continue
        signed = any((value[name] or 0.0) < 0.0 for value in values for name in ("value", "lower", "upper"))
        unit = unit_of(statistic["unit"], *(value["value"] for value in values))
        best = min(values, key=lambda value: abs(float(value["value"])))
        confidence = next((value["confidence"] for value in values if value["confidence"] is not None), 0.95)
        figures = [unit.factor * numbers(value[name] for value in values) for name in ("value", "lower", "upper")]
        is_baseline = np.array([value["name"] == baseline for value in values])
        yield Chart(
            "comparison",
            f"{key} of each result",
            "The ranking uses this statistic. "
            * (key == by)
            + f"Each result's {key} with its {100 * confidence:g} % interval; the smallest"
            f"{' in magnitude' * signed} is {best['name']}, {unit.text(best['value'])}."
            + f" The hollow mark is the baseline, {baseline}." * (baseline is not None)
            + " The tables test the differences: results with overlapping intervals can still differ significantly.",
            f"Points with intervals in {unit.name}: "
            + "; ".join(f"{value['name']} {unit.text(value['value'])}" for value in values),
            [
                Panel(
                    (
                        Axis(f"{key}, {unit.name}", None if signed else 0, rules=[(0, "")] * signed),
                        Axis("", names=[short(str(value["name"])) for value in values]),
                    ),
                    [
                        one
                        for role, mask in (("after", ~is_baseline), ("before", is_baseline))
                        for one in _intervals(
                            [column[mask] for column in figures],
                            np.flatnonzero(mask),
                            role,
                            vertical=False,
                            hollow=role == "before",
                        )
                    ],
                )
            ],
            Grid(
                ("result", "value", "from", "to"),
                [[v["name"], unit.text(v["value"]), unit.text(v["lower"]), unit.text(v["upper"])] for v in values],
            ),
            (4.9, 1.1 + 0.34 * len(values)),
        )


def _intervals(figures: Sequence[Array], at: Array | Rows, role: str, vertical: bool, **looks: Any) -> list[Series]:
    """Return marks at values with lower and upper ends, NaN if unknown, along one axis and ``at`` along the other."""
    values, *bounds = figures
    low, high = (np.where(np.isnan(end), values, end) for end in bounds)
    # A value outside its interval stays on the line.
    along, across = (
        np.stack((np.minimum(low, values), np.maximum(high, values), np.full(values.size, np.nan))).T.ravel(),
        np.repeat(at, 3),
    )
    marks, bars = ((at, values), (across, along)) if vertical else ((values, at), (along, across))
    return [
        Series(bars, role, line="-", marker="_" if vertical else "|", size=7, width=1.3),
        Series(marks, role, **{"marker": "o", "size": 6, **looks}),
    ]


# Operating curves of a gate: the probability to pass over the true value.


def operating_curve_charts(document: Document) -> Iterator[Chart]:
    """Return the operating curve of each criterion that has one."""
    for criterion in (document.get("gate") or {}).get("criteria", ()):
        if len(criterion["operating_curve"]) < 2:
            continue
        limit, value = float(criterion["limit"]), float(criterion["value"])
        unit = unit_of(criterion["unit"], limit, value)
        curve = np.array(criterion["operating_curve"], dtype=np.float64)
        pick = np.unique(np.linspace(0, len(curve) - 1, min(len(curve), 25)).round().astype(int))
        count = "" if criterion["n_poses"] is None else f" with {criterion['n_poses']:,} poses"
        by_share = criterion["operating_curve_over"] == "share_within_limit"
        if by_share:
            abscissa, header, at_least, line = Unit(100.0, "%"), "share of all poses within the limit", True, "required"
            place_, over = (
                float(criterion["share"]),
                f"the share of all poses that are within the limit, {unit.text(limit)}",
            )
            text = (
                f"The vertical line is the required share, {abscissa.text(place_)}. "
                "Passing with a smaller share is a false acceptance."
            )
            axis = (
                f"share of all poses with {short(criterion['key'].rpartition('.')[0], 24)} within {unit.text(limit)}, %"
            )
        else:
            abscissa, header, at_least, line = unit, "true value", bool(criterion["at_least"]), "limit"
            place_, over = limit, "the true value"
            text = (
                f"The vertical line is the limit, {unit.text(limit)}; the dot is the measured value, "
                f"{unit.text(value)}. Passing with a true value {'below' if at_least else 'above'} the limit is a "
                "false acceptance."
            )
            axis = f"true value of {short(criterion['key'], 40)}{f', {unit.name}' if unit.name else ''}"
        x, y = curve[:, 0] * abscissa.factor, 100 * curve[:, 1]
        wrong = np.where(curve[:, 0] <= place_ if at_least else curve[:, 0] >= place_, y, np.nan)
        series = [
            Series((x, y), "after", "probability to pass", line="-", width=1.6),
            Series((x, wrong), "before", "false acceptance", kind="band", alpha=0.25),
            *[Series(([value * unit.factor], [0]), "ink", "measured", marker="o", size=6)] * (not by_share),
        ]
        yield Chart(
            "operating-curve",
            f"Gate {criterion['name']}: operating curve",
            f"Probability that this criterion passes{count}, as a function of {over}. {criterion['rule_text']}. {text}",
            f"Probability to pass, 0 to 100 %, over the {header}; limit {unit.text(limit)}, measured "
            f"{unit.text(value)}",
            [
                Panel(
                    (Axis(axis, rules=[(place_ * abscissa.factor, line)]), Axis("probability to pass, %", -2, 102)),
                    series,
                )
            ],
            Grid(
                (header, "probability to pass"),
                [[abscissa.text(float(true)), f"{100 * share:.1f} %"] for true, share in curve[pick]],
            ),
            (4.9, 2.8),
        )


# An ISO 9283 evaluation: accuracy and repeatability by pose, and the visits of each pose.

_CRITERIA = {
    "AP": ("AP, pose accuracy", "before", "o"),
    "RP": ("RP, pose repeatability (not accuracy)", "after", "s"),
}
"""Title, colour and mark of a criterion by pose."""


def iso9283_charts(document: Document) -> Iterator[Chart]:
    """Return AP and RP of all poses, then the visits of the first poses."""
    if "iso9283" not in document:
        return
    criteria = {key: document["iso9283"][key] for key in _CRITERIA if document["iso9283"][key]["poses"]}
    if criteria:
        names = [*dict.fromkeys(str(place["pose"]) for part in criteria.values() for place in part["poses"])]
        figures = {
            key: (
                numbers(place["position_m"] for place in part["poses"]),
                *(
                    numbers(place["intervals"]["position_m"][end] for place in part["poses"])
                    for end in ("lower", "upper")
                ),
            )
            for key, part in criteria.items()
        }
        # Values without an upper limit stand for themselves.
        unit = unit_of("m", max(float(np.nanmax([*value, *upper, 0.0])) for value, _, upper in figures.values()))
        maxima = "; ".join(
            f"{key} is largest at {part['max_at']}, {unit.text(part['max_m'])}"
            for key, part in criteria.items()
            if part["max_m"] is not None
        )
        # Separate panels, so that readers do not take repeatability for accuracy.
        panels = [
            Panel(
                (Axis("commanded pose" * is_last, -0.6, len(names) - 0.4, names=ticks), Axis(f"{key}, {unit.name}", 0)),
                _intervals([unit.factor * own for own in figures[key]], at, role, vertical=True, marker=marker, size=5),
                title,
            )
            for key, part in criteria.items()
            for title, role, marker in [_CRITERIA[key]]
            for is_last in [key == [*criteria][-1]]
            for ticks in [[short(name, 10) * is_last for name in names]]
            for at in [np.array([names.index(str(place["pose"])) for place in part["poses"]])]
        ]
        yield Chart(
            "iso9283",
            "Accuracy (AP) and repeatability (RP) by commanded pose",
            "AP is the distance of the barycentre of the visits from the commanded pose, RP the scatter of the visits; "
            f"bars are confidence intervals. {maxima}.",
            f"Points with intervals of AP and RP in {unit.name} for each commanded pose; {maxima}",
            panels,
            Grid(
                ("criterion, pose", "visits", "value", "from", "to"),
                [
                    [f"{key}, {place['pose']}", str(place["n"]), *map(unit.text, sizes)]
                    for key, part in criteria.items()
                    for place, *sizes in zip(part["poses"], *figures[key], strict=True)
                ],
            ),
        )
    for visits in document["visits"][:12]:
        if visits["n"] > 1:
            yield _cloud(document, visits)


def _cloud(document: Document, visits: Document) -> Chart:
    attained, centre, cycles = vectors(visits["attained_m"]), numbers(visits["barycentre_m"]), visits["cycle"]
    is_known = visits["commanded_m"] is not None
    origin = numbers(visits["commanded_m"]) if is_known else centre
    offsets, centre = attained - origin, centre - origin
    places = document["iso9283"]["RP"]["poses"]
    radius = next(
        (each["position_m"] for each in places if all(each[key] == visits[key] for key in ("pose", "file"))), None
    )
    reach = max(float(np.abs(offsets).max()), float(np.abs(centre).max()) + (radius or 0.0))
    unit, listed = unit_of("m", reach), 60
    rows, limit = thinned(200, *offsets.T), 1.08 * reach * unit.factor or 1.0
    zero = "the commanded pose" if is_known else "the barycentre because the commanded pose is unknown"
    circle = f"; the circle is RP, {unit.text(radius)}, about the barycentre" if radius is not None else ""
    shown, ring = offsets[rows] * unit.factor, (radius or 0.0) * unit.factor * CIRCLE
    panels = [
        Panel(
            [Axis(f"{'xyz'[k]}, {unit.name}", -limit, limit) for k in plane],
            [
                Series(shown.T[plane], "after", "one visit", marker="o"),
                *([] if radius is None else [Series(middle[:, None] + ring, "before", "RP", line="-")]),
                Series(middle[:, None], "ink", "barycentre", marker="s", size=5, hollow=True),
                Series(([0], [0]), "ink", "commanded", marker="+", size=9),
            ],
            equal=True,
        )
        for plane in ([0, 1], [0, 2])
        for middle in [centre[plane] * unit.factor]
    ]
    return Chart(
        "iso9283-cloud",
        f"Visits of {visits['pose']}",
        f"Attained positions of the {visits['n']} visits of {visits['pose']}, from above and from the side, relative "
        f"to {zero} (cross). The square is their barycentre{circle}.{thinning_note(rows.size, len(offsets))}",
        f"Two projections of {visits['n']} visits in {unit.name}; barycentre "
        f"{unit.text(float(np.linalg.norm(centre)))} from zero",
        panels,
        Grid(
            ("visit", "x", "y", "z"),
            [
                [f"{i + 1}" if cycles is None else f"cycle {cycles[i]}", *map(unit.text, offsets[i])]
                for i in map(int, rows[:listed])
            ],
            note=f"{listed} of {len(offsets)} visits; the JSON result has all of them." * (len(offsets) > listed),
        ),
        (4.9, 2.9),
        columns=2,
    )


# A plan: the predicted error over the number of poses, and detection limits.


def expected_accuracy_charts(document: Document) -> Iterator[Chart]:
    """Return the chart of the error that a plan predicts, if it is known for several numbers of poses."""
    accuracy = document["accuracy"]
    if accuracy is None or len(accuracy["curve"]) < 2:
        return
    points, knee, planned = accuracy["curve"], accuracy["knee"], accuracy["planned"]
    unit = unit_of("m", *(point["total_rms_m"] for point in points))
    ending = (
        f"From {knee} poses on (the knee), ten more reduce it by less than 10 %."
        if knee is not None
        else "Ten more poses still reduce it by more than 10 %."
    )
    series = [
        Series(
            (
                numbers(point["n_poses"] for point in points),
                unit.factor * numbers(point[key] for point in points),
            ),
            role,
            label,
            marker=marker,
            line=line,
            size=3.4,
        )
        for key, label, role, line, marker in (
            ("total_rms_m", "with repeatability", "nominal", "-", "s"),
            ("random_rms_m", "random poses", "before", "--", "^"),
            ("rms_m", "planned poses", "after", "-", "o"),
        )
    ]
    at_plan = ""
    if planned is not None:
        at_plan = f" The plan of {planned['n_poses']} poses has {unit.text(planned['rms_m'])}."
        here = ([planned["n_poses"]], [planned["rms_m"] * unit.factor])
        series.append(Series(here, "ink", "this plan", marker="o", size=8, hollow=True))
    yield Chart(
        "expected-accuracy",
        "Predicted error over the number of poses",
        f"Predicted rms position error of the calibrated model over the task, for planned and random poses.{at_plan}"
        f" The upper line adds what no fit removes: repeatability and unexplained error. {ending}",
        f"Predicted error in {unit.name} over the number of poses, planned below random; knee at {knee or 'none'}",
        [
            Panel(
                (
                    Axis("number of poses", rules=[] if knee is None else [(knee, f"knee, {knee} poses")]),
                    Axis(f"predicted error, {unit.name}", 0),
                ),
                series,
            )
        ],
        Grid(
            ("poses", "rms", "random poses, rms", "worst", "with repeatability, rms"),
            [
                [str(point["n_poses"])]
                + [unit.text(point[key]) for key in ("rms_m", "random_rms_m", "worst_m", "total_rms_m")]
                for point in points
            ],
        ),
        (4.9, 3.0),
    )


def detection_limit_charts(document: Document) -> Iterator[Chart]:
    """Return the chart of the effects that a trace of planned poses can find, the likeliest first."""
    families = sorted(effect_families(document), key=lambda family: -family.power)
    detectable = [family for family in families if family.known]
    if families:
        yield Chart(
            "detection-limits",
            "Detection limits",
            "Size of each effect that a trace of these poses finds with probability 1/2, over its usual size; a line "
            "joins the most and the least visible joint. Left of 1, the usual size is found. "
            f"{sum(family.power >= 0.5 for family in families)} of {len(families)} effects are found at their usual "
            "size with a mean probability of at least 1/2.",
            f"Ranges of detection limits over usual sizes for {len(detectable)} effects, logarithmic",
            [
                Panel(
                    (
                        Axis("detection limit over the usual size", is_log=True, rules=[(1.0, "usual size")]),
                        Axis("", names=[family.name for family in detectable]),
                    ),
                    [
                        Series(
                            (ends / family.entries[0]["usual_size"], [place] * 2),
                            "after" if family.power >= 0.5 else "before",
                            marker="o",
                            line="-",
                            size=4,
                            width=1.6,
                            hollow=family.power < 0.5,
                        )
                        for place, family in enumerate(detectable)
                        for ends in [numbers(family.known[end]["limit"] for end in (0, -1))]
                    ],
                )
            ],
            Grid(
                ("effect", "lowest limit", "highest", "unit", "usual size", "mean power"),
                [
                    (
                        family.name,
                        *(f"{family.known[end]['limit']:.1e}" if family.known else "–" for end in (0, -1)),
                        family.entries[0]["unit"],
                        f"{family.entries[0]['usual_size']:.1e}",
                        f"{100 * family.power:.0f} %",
                    )
                    for family in families
                ],
            ),
            (4.9, 1.0 + 0.24 * max(len(detectable), 3)),
        )


# Control charts: a figure or coefficient over the tests of an arm, with its limits and the changes found.

_MOST_CONTROLS = 40
"""Charts of a page, those of the most certain changes first; and last tests that the table of a chart lists."""


def control_charts(document: Document) -> Iterator[Chart]:
    """Return a chart of each series in a result of ``history changes`` or ``history trend``."""
    if document["command"] == "history-trend":
        named = {"key": document["key"], "unit": document["unit"]}
        yield from (_control_chart(trend["arm"], {**trend, **named}, []) for trend in document["trends"])
    if document["command"] == "history-changes":
        changes = sorted(document["changes"], key=lambda change: float(change["p_value"]))
        names = [(change["arm"], change["key"]) for change in changes]
        series = {(arm["arm"], one["key"]): one for arm in document["arms"] for one in arm.get("series", ())}
        for name in [*dict.fromkeys(name for name in (*names, *series) if name in series)][:_MOST_CONTROLS]:
            own = [change for change, of_series in zip(changes, names, strict=True) if of_series == name]
            yield _control_chart(name[0], series[name], own)


def _control_chart(arm: str, series: Document, changes: Sequence[Document]) -> Chart:
    values, key = series["values"], series["key"]
    unit = unit_of(series["unit"], *(value["value"] for value in values))
    at, dated = _days(value["at"] for value in values), [one for one in changes if one["kind"] != "temperature"]
    value, std, expected, low, high = (
        unit.factor * numbers(value.get(name) for value in values)
        for name in ("value", "std", "expected", "low", "high")
    )
    gap = np.full(len(at), np.nan)
    bars = (
        np.stack([at, at, gap], axis=1).ravel(),
        np.stack([value - 2.0 * std, value + 2.0 * std, gap], axis=1).ravel(),
    )
    drawn = [
        Series(bars, "nominal", "± 2 standard deviations", line="-", width=0.8),
        Series((at, value), "after", "test", marker="o", size=3.4),
    ]
    said = [f"{unit.text(series['rate_per_year'])} a year"] if series.get("rate_per_year") is not None else []
    if said:
        line = np.mean(value) + unit.factor * series["rate_per_year"] * (at - at.mean()) / 365.25
        drawn.append(Series((at, line), "ink", "straight line", line="-"))
    about = f"Value of each test, and the straight line through them: {said[0]}." if said else "Value of each test."
    if has_limits := bool(np.isfinite(expected).all()):
        # A step breaks the lines.
        breaks = np.searchsorted(at, _days(one["at"] for one in dated if one["kind"] != "ramp"))
        x, *lines = (np.insert(line, breaks, np.nan) for line in (at, expected, low, high))
        is_beyond = (value < low) | (value > high)
        is_within = not is_beyond.any()
        drawn += [
            Series((x, lines[0]), "ink", "expected", line="-"),
            *(Series((x, end), "limit", "limits", line=(0, (3, 2)), width=0.9) for end in lines[1:]),
            *([] if is_within else [Series((at[is_beyond], value[is_beyond]), "before", "beyond", marker="x", size=6)]),
        ]
        said = [_said(change) for change in changes] or ["nothing changed beyond the limits"]
        about = (
            f"Value of each test; {'; '.join(said)}. The line is what is expected with the changes found; a test alone "
            "beyond the dashed limits is an alarm. The band is when a change may have begun (95 %)."
        )
        floor, top = float(np.nanmin((low, value))), float(np.nanmax((high, value)))
        for change in dated:
            # Half a day on both sides, so that a date without doubt is seen too.
            span = _days((change["earliest"], change["latest"])) + np.array([-0.5, 0.5])
            drawn.append(Series((span, [floor] * 2, [top] * 2), "third", "change", "band", alpha=0.25))
    rules = [(float(_days([change["at"]])[0]), change["kind"]) for change in dated]
    names = ("value", "std", *("expected", "low", "high") * has_limits)
    return Chart(
        "control",
        f"{key} of {arm}",
        about,
        f"{key} in {unit.name} over the dates of {len(at)} tests; {'; '.join(said)}".rstrip("; "),
        [Panel((Axis("", is_date=True, rules=rules), Axis(f"{short(key, 34)}, {unit.name}")), drawn)],
        Grid(
            ("date", *names),
            [(day(one["at"]), *(unit.text(one[name]) for name in names)) for one in values[-_MOST_CONTROLS:]],
            note=f"The last {_MOST_CONTROLS} of {len(at)} tests; the JSON result has all of them."
            * (len(at) > _MOST_CONTROLS),
        ),
        (4.9, 3.0),
    )


def _said(change: Document) -> str:
    """Return kind, date and size of a change with its interval."""
    unit = unit_of(change["unit"])
    size, low, high = (unit.text(change[name]) for name in ("size", "low", "high"))
    when = "with temperature" if change["kind"] == "temperature" else f"{change['kind']} at {day(change['at'])}"
    return f"{when} by {size} ({low} to {high})"


def _days(dates: Iterable[str]) -> Array:
    """Return dates as days since 1970."""
    return np.array([date.removesuffix("Z") for date in dates], dtype="datetime64[s]").astype(float) / 86400.0


# The charts of a result, in reading order.

_FAMILIES: Sequence[Callable[[Document], Iterator[Chart]]] = (
    distribution_charts,
    iso9283_charts,
    comparison_charts,
    operating_curve_charts,
    effect_charts,
    candidate_charts,
    workspace_3d_charts,
    correction_charts,
    warranty_charts,
    ellipsoid_charts,
    budget_charts,
    error_over_time_charts,
    workspace_charts,
    control_charts,
)
_OF_PLANS = (planned_poses_charts, expected_accuracy_charts, detection_limit_charts)


def charts_of(document: Document) -> list[Chart]:
    """Return all charts that the result has data for."""
    return [
        chart for family in (_OF_PLANS if document["command"] == "plan" else _FAMILIES) for chart in family(document)
    ]


def chart_of(document: Document, kind: str, number: int = 1) -> Chart:
    """Return the ``number``-th chart of a kind, counted from 1; without a kind, of the kind of the main chart.

    Raises:
        UsageError: the result has no such chart; the message lists its charts.
    """
    charts = charts_of(document)
    kinds, start = kinds_of(charts), f"this result of robacc {document['command']} has"
    wanted = kind or "".join(kinds[:1])
    matching = [chart for chart in charts if chart.kind == wanted]
    refuse(
        (not matching, f"{start} no chart{f' {kind!r}' * bool(kind)}; it has {', '.join(kinds) or 'none'}"),
        (not 1 <= number <= len(matching), f"{start} {len(matching)} chart(s) {wanted!r}, not {number}"),
    )
    return matching[number - 1]


def kinds_of(charts: Iterable[Chart]) -> list[str]:
    """Return each kind once, the main chart's first."""
    return [*dict.fromkeys(chart.kind for chart in charts)]
