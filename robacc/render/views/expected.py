"""What to expect: a prediction, a plan of a measurement with the comments of its CSV, a correction, and an export."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from robacc.errors import listing
from robacc.render.text import (
    IN_DEGREES,
    IN_MM,
    LISTED_ROWS,
    QUANTITIES,
    Block,
    Cell,
    Document,
    Form,
    Grid,
    Listing,
    Number,
    ReportHeadline,
    Section,
    Text,
    Tile,
    amount,
    effect_families,
    effect_label,
    fixed,
    grid,
    joint_unit,
    number,
    of_robot,
    p_value,
    percent,
    three_digits,
    unit_of,
    with_unit,
)

if TYPE_CHECKING:
    from robacc.planning.campaign import CampaignPlan

# A prediction: its grade, errors and budget, the tolerances needed, and its comparison with measured poses.

_CRITERIA = {
    "rms": "rms error",
    "mean_error": "mean error",
    "p95": "95 % of errors within",
    "max": "largest 95 % radius of any pose",
}
_BAR = 14
_NOISE_SOURCES = {
    "file": "from the file",
    "given": "given by the user",
    "estimated": "estimated from the poses",
    "fit": "that of the fit",
}


def predict_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``predict``."""
    position, grade, coverage = document["position"], document["grade"], document["coverage"] or {}
    rms, p95, worst = amount(position["rms_m"]), amount(position["p95_m"]), position["worst"]
    largest = "".join(
        f" The largest share of the variance, {100 * first['share_position']:.0f} %, is from {first['parameter']}."
        for first in document["budget"][:1]
    )
    return ReportHeadline(
        f"Predicted accuracy{of_robot(document)}",
        f"{'The tolerances give' if document['tolerances']['parameters'] else 'The fit of the model gives'} an "
        f"expected position error of {rms} rms over robots and poses, 95 % of the errors within {p95}: grade "
        f"{grade['grade']}.{largest}",
        [
            Tile("position, rms", rms, "over robots and poses"),
            Tile("position, 95th percentile", p95, "over robots and poses"),
            Tile("worst pose, rms", amount(worst["rms_m"]), f"at {worst['label']}"),
        ],
        [(f"grade {grade['grade']}, expected", "plain")],
        [
            ("Configurations", document["configurations"]),
            ("Grade", f"{grade['grade']}, expected, on the scale {grade['scale']}"),
            ("Compared with measured poses", (document["against"] or {}).get("verdict", "").replace("_", " ")),
            (
                "Measured poses within their 95 % bound",
                ", ".join(
                    f"{name} {_percent(coverage[name]['share'])}" for name, *_ in QUANTITIES if coverage.get(name)
                ),
            ),
        ],
    )


def prediction_view(document: Document, source: str = "", form: Form = "page") -> list[Section]:
    """Return grade, errors, worst poses and budget, then allocation and measured poses, whose file is ``source``.

    A page has a chart of the budget.
    """
    parameters, grade, is_page = document["tolerances"]["parameters"], document["grade"], form == "page"
    origin = f"{len(parameters)} tolerances" if parameters else "the fit of its model"
    limited = f"; limited by {' and '.join(grade['limited_by'])}" * bool(grade["limited_by"])
    shares = ", ".join(f"{name} {_percent(share)}" for name, share in grade["share_of_poses_meeting"].items())
    graded = Listing(
        [
            f"criterion: {_CRITERIA[grade['statistic']]}, over robots and poses{limited}",
            f"share of poses that meet each grade individually: {shares}",
        ]
    )
    names = [f"share_{name}" for name, *_ in QUANTITIES]
    # Scatter that the fit did not separate and poses within its ranges have no share of their own.
    budget = sorted(
        (part for part in document["budget"] if part["sd"] is not None or any(part[name] for name in names)),
        key=lambda part: -round(sum(part[name] for name in names), 9),
    )
    unlisted = budget[LISTED_ROWS:]
    position, turn = (_percent(sum(part[name] for part in unlisted)) for name in names)
    budgets = [
        Section(
            "Error budget: share of the variance (parameters sorted by both shares)",
            [
                _budget(("parameter" if parameters else "source"), "parameter", budget[:LISTED_ROWS]),
                Text(
                    f"{len(unlisted)} more parameters: {position} of position, {turn} of orientation" * bool(unlisted)
                ),
            ],
        ),
        *(Section("", [_budget(label, "name", document[f"budget_by_{label}"])]) for label in ("joint", "kind")),
    ]
    return [
        Section(
            f"Expected accuracy{of_robot(document)}, from {origin}",
            []
            if is_page
            else [Text(f"at {document['configurations']}", wraps=False), Text(document["tolerances"]["meaning"])],
        ),
        Section(f"Grade {grade['grade']} predicted (scale: {grade['scale']})", [graded]),
        Section("Predicted error", _errors(document)),
        Section("Worst pose", [Listing([_worst(document, name, unit) for name, unit, *_ in QUANTITIES])]),
        *([] if is_page else budgets),
        *([] if document["allocation"] is None else [_allocation(document["allocation"], grade["statistic"])]),
        *([] if document["against"] is None else _against(document["against"], source)),
        *([] if document["coverage"] is None else [_coverage(document["coverage"])]),
        Section("Limitations", [Listing(() if is_page else document["notes"])]),
    ]


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _errors(document: Document) -> list[Block]:
    errors = [(document[name], unit, factor) for name, unit, _, factor in QUANTITIES]
    columns = [
        ({**part["percentiles_over_poses"][f"{name}_{unit}"], "largest": largest}, factor)
        for part, unit, factor in errors
        for name, largest in (("rms", part["worst"][f"rms_{unit}"]), ("radius95", part[f"max_radius95_{unit}"]))
    ]
    return [
        Grid(
            ("over robots and poses", "mm", "°"),
            [
                (label, *(number(part[f"{key}_{unit}"], factor) for part, unit, factor in errors))
                for label, key in (("rms", "rms"), ("mean", "mean_error"), ("95 % of errors within", "p95"))
            ],
        ),
        Grid(
            ("percentile over poses", "rms, mm", "95 % within, mm", "rms, °", "95 % within, °"),
            [(key.removeprefix("p"), *(number(own[key], factor) for own, factor in columns)) for key in columns[0][0]],
        ),
    ]


def _worst(document: Document, name: str, unit: str) -> str:
    worst = document[name]["worst"]
    direction = " ".join(f"{float(value):+.2f}" for value in worst["direction"])
    rms, radius, sd = (with_unit(worst[f"{key}_{unit}"], unit) for key in ("rms", "radius95", "sd"))
    place = ", ".join(
        f"{joint['name']}={own.after(f'{float(value) * own.factor:.1f}')}"
        for joint, value in zip(document["robot"]["joints"], worst["q"], strict=True)
        for own in [joint_unit(joint)]
    )
    return (
        f"{name}: {worst['label']}, rms {rms}, 95 % within {radius}, largest along ({direction}) of the tool (standard "
        f"deviation {sd}), at {place}"
    )


def _budget(label: str, key: str, parts: Sequence[Document]) -> Grid:
    """Return shares with bars, which the largest share of the table fills."""
    # The bars share the columns that names, tolerances and percentages leave of 80.
    longest, is_toleranced = max((len(part[key]) for part in parts), default=0), label == "parameter"
    width = max(2, min(_BAR, (44 - longest) // 2)) if is_toleranced else _BAR
    names = ("share_position", "share_orientation")
    most = {name: max((part[name] for part in parts), default=0.0) or 1.0 for name in names}
    return grid(
        (label, "1 sd" if is_toleranced else None, "position", "", "orientation", ""),
        [
            (
                part[key],
                with_unit(part["sd"], part["unit"]) if is_toleranced else "",
                *(
                    text
                    for name in names
                    for text in (_percent(part[name]), ("█" * round(width * part[name] / most[name])).ljust(width))
                ),
            )
            for part in parts
        ],
    )


def _allocation(allocation: Document, statistic: str) -> Section:
    title, tolerances = f"Tolerances for grade {allocation['grade']}", allocation["tolerances"]
    if all(tolerance["factor"] == 1.0 for tolerance in tolerances):
        return Section(title, [Text("the given tolerances already reach this grade")])
    rows = [
        (
            tolerance["parameter"],
            *(with_unit(tolerance[f"{which}_sd"], tolerance["unit"]) for which in ("given", "needed")),
            f"{tolerance['factor']:.3f}",
        )
        for tolerance in sorted(tolerances, key=lambda tolerance: round(tolerance["factor"], 9))
        if round(tolerance["factor"], 3) < 1.0
    ]
    verified = ((allocation["verified"][name].get(f"{statistic}_{unit}"), unit) for name, unit, *_ in QUANTITIES)
    sizes = ", ".join(str(with_unit(value, unit)) for value, unit in verified if value is not None)
    return Section(
        title,
        [
            Grid(("parameter", "given (1 sd)", "needed (1 sd)", "factor"), rows),
            Text(f"tolerances that need no change: {len(tolerances) - len(rows)}"),
            Text(
                f"A new prediction with these tolerances {'meets' if allocation['met'] else 'does not meet'} the grade"
                f"{f': {_CRITERIA[statistic]} {sizes}' if sizes else ''}. The allocation minimises the cost, taken as "
                f"1/tolerance. With one factor for all tolerances, this factor is {allocation['uniform_factor']:.3f}."
            ),
        ],
    )


def _against(comparison: Document, source: str) -> list[Section]:
    """Return the comparison of predicted and measured errors."""
    measured, noise, alignment = comparison["measured"], comparison["noise"], comparison["alignment"]
    registered = "not registered" if alignment is None else f"registered: {' and '.join(alignment['what'])} fitted"
    components = comparison["variance_components"] or {"confidence": 0.95, "components": (), "notes": ()}
    sizes = [
        (name, with_unit(rms, unit), with_unit(sigma, unit), _NOISE_SOURCES[noise[f"source_{name}"] or "file"])
        for name, unit, *_ in QUANTITIES
        for rms, sigma in [(measured[f"{name}_rms_{unit}"], noise[f"{name}_{unit}"])]
        if rms is not None and sigma is not None
    ]
    tests = [
        (
            label,
            number(test["statistic"]),
            f"{three_digits(test['lower'])} … {three_digits(test['upper'])}",
            p_value(test["p_value"]),
        )
        for label, key in (
            ("directions affected by parameters", "parameters"),
            ("other directions: measurement noise", "noise"),
            ("total", "total"),
        )
        if (test := comparison["normalised_squared_error"][key]) is not None
    ]
    rows = [
        (
            part["name"],
            unit,
            number(predicted, factor),
            *(("–", "–", "–") if part["why"] else (number(part["estimate"], factor), ends, number(part["factor"]))),
            f"{part['dof']:.1f}",
        )
        for part in components["components"]
        for (factor, unit), predicted in [(unit_of(part["unit"]), part["predicted"])]
        for ends in [
            " … ".join(
                "∞" if part[end] is None else three_digits(part[end] * predicted * factor) for end in ("lower", "upper")
            )
        ]
    ]
    heads = ("kind", "", "predicted", "estimated", percent(components["confidence"]), "ratio", "dof")
    return [
        Section(
            f"Compared with {comparison['n_poses']} measured poses{' of ' * bool(source)}{source}",
            [
                Text(comparison["verdict"]),
                Text(f"measured, {registered}"),
                Grid(("", "rms error", "noise per axis (sd)", ""), sizes),
                Grid(("normalised squared error", "measured", "expected, 95 %", ""), tests),
                *(
                    Text(
                        "Likelihood ratio of the predicted covariance against the best scaled one (all tolerances "
                        f"times {three_digits(scaled['factor'])}): {three_digits(scaled['statistic'])}, "
                        f"{p_value(scaled['p_value'])}, from {scaled['draws']} simulated data sets."
                    )
                    for scaled in [comparison["likelihood_ratio"]]
                    if scaled is not None
                ),
            ],
        ),
        Section(
            "Variance components (one standard deviation)",
            [
                Grid(heads, rows),
                Listing(
                    [
                        "dof: effective number of independent parameter errors in the estimate" * bool(rows),
                        *components["notes"],
                    ]
                ),
            ],
        ),
        Section("Limits of data from one robot", [Text(comparison["one_draw"])]),
    ]


def _coverage(coverage: Document) -> Section:
    """Return the measured poses within the bounds of a model."""
    parts = {name: coverage[name] for name, *_ in QUANTITIES if coverage.get(name) is not None}
    sources = " and ".join(dict.fromkeys(_NOISE_SOURCES[part["noise_source"]] for part in parts.values()))
    return Section(
        f"Measured poses within the {100 * coverage['probability']:g} % bound of their error",
        [
            Grid(
                ("", "poses", "share"),
                [(name, f"{p['n_inside']} of {p['n_poses']}", _percent(p["share"])) for name, p in parts.items()],
            ),
            Listing(
                [
                    f"the bound contains the measurement noise, {sources}",
                    f"{' and '.join(coverage['registered'])} fitted to one half of the poses for the errors of the "
                    "other" * bool(coverage["registered"]),
                ]
            ),
        ],
    )


# A plan of a measurement: route, feasible poses, what to expect of the fit or a trace; and the comments of its CSV.

_PURPOSES = {
    "calibrate": "calibration",
    "trace": "trace of causes",
    "acceptance": "acceptance",
    "health": "health check",
}
_VISITS = 200
"""Visits that the page lists."""


def plan_comments(plan: "CampaignPlan") -> list[str]:
    """Return the comment lines above the columns of the visits."""
    blocks = plan.payload_blocks
    return [
        f"Planned by robacc plan for {_PURPOSES[plan.purpose]} of {plan.robot.name}: "
        f"{plan.chosen.size} poses, {len(plan.route.roles)} visits in this order; nothing was measured.",
        *([f"Payloads, each mounted once: {_payloads(blocks, plan.payloads)}."] if blocks else []),
        "Drive from row to row, and replace the joints by those read in the sockets."
        if plan.candidates.in_sockets
        else "Drive straight from row to row, and add x, y, z (and orientation) as measured; dir_ and speed_ are those "
        "of the moves from row to row.",
        "Check every pose for collisions before you send it.",
    ]


def plan_headline(document: Document) -> ReportHeadline:
    """Return the number of poses and visits, the predicted error, and whether earlier poses are enough."""
    planned, sufficiency = (document["accuracy"] or {}).get("planned"), document["sufficiency"]
    n, visits, noise, power = (document[key] for key in ("n_poses", "n_visits", "noise", "power"))
    already, badges = "", []
    if sufficiency is not None:
        already = f" After {sufficiency['n_already']} poses: {sufficiency['why']}."
        badges = [("enough poses", "good") if sufficiency["enough"] else ("more poses needed", "open")]
    return ReportHeadline(
        f"Plan for the {_PURPOSES[document['purpose']]}{of_robot(document)}",
        f"{n} poses in {visits} visits, chosen from {document['candidates']['feasible']} feasible poses.{already}",
        [
            *(Tile(name, Number(str(n), float(n))) for name, n in (("different poses", n), ("visits", visits))),
            *(
                Tile(label, amount(planned[key]))
                for label, key in (
                    ("predicted error after the fit, rms", "rms_m"),
                    ("the same of random poses", "random_rms_m"),
                )
                if planned is not None
            ),
            *(
                Tile(
                    label, Number(f"{100 * power[key]:.0f} %", power[key]), f"random poses {100 * power[random]:.0f} %"
                )
                for label, key, random in (
                    ("effects found at their usual size", "found", "random_found"),
                    ("found and separated", "separated", "random_separated"),
                )
                if power is not None
            ),
        ],
        badges,
        [
            ("Instrument", f"{amount(noise['position_m'])} along each axis"),
            ("Repeatability", f"{amount(noise['repeatability_m'])} along each axis at the target"),
            ("Source of the noise", str(noise["source"])),
            ("Free effects", ", ".join(document["fit"].split(","))),
        ],
    )


def plan_view(document: Document, form: Form = "page", robot: str = "", output: str | None = None) -> list[Section]:
    """Return whether the poses are enough, what excluded candidates, and what to expect, in short or in full.

    ``robot`` is the name of the robot's file, ``output`` that of the CSV if it was written.
    """
    purpose, options, is_short = document["purpose"], document.get("options", {}), form == "short"
    title = (
        f"Plan for the {_PURPOSES[purpose]} of {document['robot']['name']}: {document['n_poses']} poses, "
        f"{document['n_visits']} visits"
    )
    enough, needed, accuracy = (document[key] for key in ("sufficiency", "needed_poses", "accuracy"))
    excluded = () if is_short else document["candidates"]["excluded"]
    region = "the task" if options.get("task") or options.get("region") else "all poses of the arm"
    sections = [
        Section("Order of the visits" if form == "page" else title, [Listing(_route_facts(document, not is_short))]),
        *([] if enough is None else [_sufficiency(enough, document["n_poses"])]),
        Section(
            "Feasible poses",
            [
                Grid(
                    ("candidates excluded by", "count", "by this alone"),
                    [(each["reason"], str(each["count"]), str(each["alone"])) for each in excluded],
                )
            ],
        ),
        Section(
            "Poses to decide with a probability of 90 %, by true value in % of the limit",
            [
                Grid(
                    ("limit", "mm", *(f"{100 * each['true_over_limit']:.0f} %" for each in needed[0]["by_ratio"])),
                    [
                        (
                            f"{entry['name']} ({entry['statistic']})",
                            number(entry["limit_m"], IN_MM),
                            *("–" if each["n_poses"] is None else str(each["n_poses"]) for each in entry["by_ratio"]),
                        )
                        for entry in needed
                    ],
                ),
                Listing(
                    [
                        *(
                            f"planned for {entry['name']}: {entry['n_poses'] or 'too many'} poses, for a true value of "
                            f"{100 * entry['true_over_limit']:.3g} % of the limit"
                            for entry in needed
                        ),
                        "the nearer the true value to the limit, the more poses; `expected` states the value that you "
                        "expect",
                    ]
                ),
            ]
            if needed
            else [],
        ),
        Section(
            f"Predicted error after the fit, over {region}, mm",
            [] if accuracy is None else _accuracy(document, not is_short),
        ),
    ]
    if is_short:
        more = (
            "`full=True` adds the route, excluded poses, other numbers of poses, standard errors and detection limits"
        )
        ahead = f"next: {_next_step(document, robot, output)}"
        return [*sections, Section("", [Listing(_found(document["power"])), Text(more, is_note=True), Text(ahead)])]
    most, texts = {"full": 8, "page": 20}[form], _inseparable(document["inseparable"] or ())
    fitted = document["coefficients"] if purpose in ("calibrate", "health") else ()
    missing = ", ".join(each["name"] for each in fitted if each["std"] is None)
    errors = [
        (each["name"], number(each["std"], factor), unit)
        for each in fitted
        if each["std"] is not None
        for factor, unit in [unit_of(each["unit"])]
    ]
    pairs = document["correlations"] if purpose == "calibrate" else ()
    return [
        *sections,
        Section(
            "Predicted standard errors",
            [
                Grid(("coefficient", "standard error", "unit"), errors),
                Text(f"not identifiable: {missing}" * bool(missing), is_note=True),
            ],
        ),
        Section(
            "Estimates that stay strongly correlated",
            [Listing([f"{p['first']} and {p['second']} ({p['value']:+.2f})" for p in pairs[:most]])],
        ),
        Section(
            "Effects that a trace of these poses can find",
            [] if document["detection_limits"] is None else _detectability(document, most),
        ),
        Section(
            "Pairs that are not distinguishable at the usual size",
            [Listing(texts[:most]), Text(f"… and {len(texts) - most} more pairs" * (len(texts) > most), is_note=True)],
        ),
        *([_visits(document)] if form == "page" else []),
    ]


def _next_step(document: Document, robot: str, output: str | None) -> str:
    """Return what to do with the plan."""
    purpose, file = document["purpose"], output or "PLAN"
    # What evaluates the measured poses, and its option for what was planned for.
    name, option = {
        "calibrate": ("calibrate", "--fit"),
        "trace": ("trace", "--declared"),
        "acceptance": ("estimate", "--gate"),
        "health": ("health", "--db"),
    }[purpose]
    planned_for = document.get("options", {}).get("gate") if purpose == "acceptance" else document["fit"]
    planned_for = "FILE" if purpose == "health" else planned_for
    start = "measure the poses" if output else "write the poses (`output=PLAN`), measure them"
    to_add = "replace the joints by those read in the sockets"
    start += f" in the order of {file}, "
    start += to_add if document["candidates"]["in_sockets"] else "add the columns x, y, z as measured"
    if document["sufficiency"] is not None:
        file, start = "ALL", f"{start}, put the rows of all batches into one file ALL"
    return f"{start}, then: robacc {name} {file} --robot {robot}" + f" {option} {planned_for}" * bool(planned_for)


def _sufficiency(sufficiency: Document, n_poses: int) -> Section:
    now, later = (number(sufficiency[key], IN_MM) for key in ("now_m", "later_m"))
    own, new = ("poses of the model's fit", "poses") if sufficiency["of_model"] else ("rows measured already", "rows")
    texts = [
        sufficiency["why"],
        f"error to expect: {now} mm rms now, {later} mm with the next poses" * (None not in (now.si, later.si)),
        f"this counts the {sufficiency['n_already']} {own}: fit them together with the new {new}",
    ]
    return Section("Enough" if sufficiency["enough"] else f"Not enough: measure the next {n_poses}", [Listing(texts)])


def _route_facts(document: Document, full: bool) -> list[str]:
    """Return where the poses come from, how often each is visited, and what was assumed; in ``full`` the route too."""
    route, noise, candidates, blocks = (document[key] for key in ("route", "noise", "candidates", "payloads"))
    n_poses, n_visits, repeats, passes = document["n_poses"], document["n_visits"], route["repeats"], route["passes"]
    with_each, checks = " with each payload" * (len(blocks) > 1), n_visits - n_poses - repeats
    again = f", {repeats} of them a second time" * bool(repeats)
    check = f", one of them{with_each} {checks} more time{'s' * (checks > 1)} to show drift" * bool(checks)
    instrument, joints = (three_digits(noise[key] * IN_MM) for key in ("position_m", "repeatability_m"))
    turn, ask = noise["orientation_rad"], "; `noise` and `repeatability` state yours" * ("typical" in noise["source"])
    orientation = "" if turn is None else f", {turn * IN_DEGREES:.3g}° about each axis"
    collisions = "collisions of the links not checked: check every pose before you send it"
    if (checked := document["collisions"]) is not None:
        pairs = ", ".join(" and ".join(pair) for pair in checked["overlapping"])
        collisions = (
            f"{len(checked['pairs'])} pairs of links checked for collisions, without tool, payload and cables"
            + f"; not checked, as they touch at nearly all poses: {pairs}" * bool(pairs)
        )
    validation, worth = document["validation"], document["worth"] or {"new_poses_rms_m": None}
    return [
        f"chosen from {candidates['feasible']} feasible poses of {candidates['source']}{with_each}",
        f"{n_visits} visits: each of the {n_poses} poses once{again}{check}",
        f"instrument {instrument} mm and repeatability {joints} mm along each axis{orientation} "
        f"({noise['source']}{ask})",
        f"route: {passes} pass{'es' * (passes > 1)} through the poses; its moves add up to {route['length']:.1f} times "
        f"the range of a joint ({route['random_length']:.1f} in a random order); each joint is approached from its "
        f"rarer direction in at least {100 * min(route['rarer_direction_share'], default=0.0):.0f} % of its moves"
        if full
        else "",
        collisions,
        f"payloads: {_payloads(blocks, document.get('options', {}).get('payload') or ())}" * bool(blocks),
        "" if validation is None else f"{len(validation['q'])} more poses for validation only",
        ""
        if not full or worth["new_poses_rms_m"] is None
        else f"if there is time for twice the measurements: {worth['verdict']}",
    ]


def _payloads(blocks: Sequence[Document], payloads: Sequence[float]) -> str:
    """Return ``0 kg (visits 1 to 18, 15 poses), 5 kg (…)``, and the payloads that no pose has."""
    used = [block["payload_kg"] for block in blocks]
    texts = [
        f"{block['payload_kg']:g} kg (visits {first} to {first + block['n_visits'] - 1}, {block['n_poses']} poses)"
        for block in blocks
        for first in [block["first_visit"]]
    ]
    return ", ".join([*texts, *(f"none with {payload:g} kg" for payload in payloads if payload not in used)])


def _accuracy(document: Document, is_curve: bool) -> list[Block]:
    """Return the error over the number of poses, or near the planned number; they are added to earlier ones if any."""
    accuracy, is_addition = document["accuracy"], document["sufficiency"] is not None
    planned, knee = accuracy["planned"], accuracy["knee"]
    enough = next((p["n_poses"] for p in accuracy["curve"] if knee is not None and p["n_poses"] >= knee), None)
    marks = {"planned": planned and planned["n_poses"], "enough": None if is_addition else enough}
    rows: list[Sequence[Cell]] = [
        (str(n), *(number(point[f"{key}_m"], IN_MM) for key in ("total_rms", "rms", "worst", "random_rms")), mark)
        for point in accuracy["curve"]
        for n in [point["n_poses"]]
        for mark in [", ".join(name for name, place in marks.items() if place == n)]
        if is_curve or mark
    ]
    if (free := accuracy["of_tracker"]) is not None:
        keys = ("total_rms_m", "rms_m", "worst_m", "random_rms_m")
        rows.append((str(free["n_poses"]), *(number(free[key], IN_MM) for key in keys), "anywhere, with a tracker"))
    advice = "the planned poses do not identify all coefficients; plan more poses or fit less"
    if planned is not None and enough is None:
        advice = "more poses are worth it: ten more still reduce the error to expect by more than 10 %"
    elif planned is not None:
        spare = planned["n_poses"] - enough
        advice = (
            f"{enough} poses are enough (`poses={enough}`): ten more reduce the error to expect by less than 10 %"
            + f"; if there is time, the other {spare} are a reserve for failed measurements and for checking the fit"
            * (spare > 0)
        )
    heads = ("to expect, rms", "model, rms", "model, worst", "model, random", "remark")
    return [
        Grid(("more poses" if is_addition else "poses", *heads), rows),
        Listing(
            [
                "to expect: error of the arm with the fitted model, repeatability included; model: without "
                "repeatability, also at its worst pose and fitted to random poses",
                advice * (planned is None or not is_addition),
            ]
        ),
    ]


def _detectability(document: Document, most: int) -> list[Block]:
    families, untested = effect_families(document), document["not_testable"] or {}
    hidden = dict.fromkeys(
        effect_label(family.name, each["joints"], {})
        for family in families
        for each in family.entries
        if each["joints"] not in [limit["joints"] for limit in family.known]
    )
    by_reason = {reason: [name for name in untested if untested[name] == reason] for reason in untested.values()}
    return [
        Grid(
            ("effect", "lowest limit", "highest", "unit", "usual size", "mean power"),
            [
                (*family.cells(), f"{unit_of(first['unit']).factor * first['usual_size']:.1e}", fixed(family.power, 2))
                for family in families
                for first in family.known[:1]
            ],
        ),
        Listing(
            [
                *_found(document["power"]),
                "limit: size found with probability 1/2; power: probability that the usual size is found",
                f"never found on these poses: {listing([*hidden], most)}" * bool(hidden),
                *(f"not tested ({reason}): {', '.join(names)}" for reason, names in by_reason.items()),
            ]
        ),
    ]


def _found(power: Document | None) -> list[str]:
    """Return the probability that a trace of the poses finds an effect, and whether that is good."""
    if power is None:
        return []
    return [
        "a trace of these poses finds a cause of its usual size with probability {found} on average (random poses: "
        "{random_found}), and distinguishes it from the most similar cause with {separated} "
        "({random_separated})".format(**{key: f"{100 * share:.0f} %" for key, share in power.items()}),
        "this is good: more causes of their usual size are found than missed"
        if power["found"] >= 0.5
        else "this is low: most causes are found only if they are larger than usual; a better instrument "
        "(`noise` states it) raises it, more poses (`poses`) a little",
    ]


def _inseparable(pairs: Sequence[Document]) -> list[str]:
    """Return a text for each pair; a pair that is inseparable both ways has one."""
    ways = {(pair["first"], pair["second"]) for pair in pairs}
    return [
        f"{first} and {second} explain each other {similarity}"
        if (second, first) in ways
        else f"{second} explains {first} {similarity}"
        for first, second, similarity in (
            (p["first"], p["second"], f"(similarity {p['similarity']:.2f})") for p in pairs
        )
        if (second, first) not in ways or first < second
    ]


def _visits(document: Document) -> Section:
    visits, joints = document["visits"], document["robot"]["joints"]
    units, payloads, count = [joint_unit(joint) for joint in joints], visits["payload_kg"], len(visits["q"])
    rows = [
        (
            str(i + 1),
            visits["pose"][i],
            visits["role"][i],
            "" if payloads is None else f"{payloads[i]:g}",
            *(f"{value * unit.factor:.{2 if unit.name == '°' else 1}f}" for value, unit in zip(q, units, strict=True)),
        )
        for i, q in enumerate(visits["q"][:_VISITS])
    ]
    heads = (
        *("visit", "pose", "role", None if payloads is None else "payload, kg"),
        *(f"{joint['name']}, {unit.name}" for joint, unit in zip(joints, units, strict=True)),
    )
    more = f"The first {_VISITS} of {count} visits; the CSV has all of them." * (count > _VISITS)
    return Section("Visits", [grid(heads, rows), Text(more)])


# A correction: corrections, the errors to expect, and what remains.

_CAUSES = {
    "unreached": "not reached by the nominal robot",
    "limit": "joint limit",
    "approach": "unknown direction of approach",
    "singular": "near a singular pose",
    "configuration": "another configuration",
    "too_large": "correction too large",
    "out_of_range": "outside the range of the model",
}
_LEAST = {"position": 1e-3, "orientation": 1e-4}
"""Size in mm or degrees below which the solver's tolerance decides, not the arm."""


def correction_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``correct``."""
    before, after = (document["expected"][stage]["position"] or {} for stage in ("before", "after"))
    now, then = (amount(part.get("expected_rms_m")) for part in (before, after))
    count = f"{document['n_corrected']} of {document['n_targets']} targets"
    return ReportHeadline(
        f"Correction by {document['model']}",
        f"{count} have a corrected command. The position error to expect falls from {now} to {then} rms.",
        [
            Tile("expected error before, rms", now),
            Tile("expected error after, rms", then),
            Tile("95 % bound after, largest", amount(after.get("largest_bound95_m"))),
        ],
        [(f"{count} corrected", "open" if document["n_refused"] else "good")],
    )


def correction_text(parts: Sequence[Document], n_targets: int, names: tuple[str, str], output: str) -> list[Section]:
    """Return the text of a correction, of each kind of targets in turn.

    ``names`` are those of targets and model, ``output`` that of the file that was written.
    """
    targets, model = names
    notes = Listing([*dict.fromkeys(note for part in parts for note in part["notes"])])
    if not any(
        part["correction"][name] and part["correction"][name][f"max_{unit}"] * factor >= _LEAST[name]
        for part in parts
        for name, unit, _, factor in QUANTITIES
    ):
        ahead = "fit a model to measured poses: robacc calibrate POSES --robot ROBOT --write-model MODEL"
        return [
            Section(
                f"Correction of {targets} by {model}: nothing to correct",
                [Text(f"The model is the nominal arm: no command changes, and {output} has those of {targets}.")],
            ),
            Section("", [notes, Text(f"next: {ahead}")]),
        ]
    count = f"{sum(part['n_corrected'] for part in parts)} of {n_targets} targets corrected"
    ahead = (
        f"load {output}, measure the same targets again, and compare with the measurement before: "
        f"robacc compare --paired BEFORE.csv AFTER.csv --model {model}"
    )
    return [
        Section(f"Correction of {targets} by {model}: {count}", [Text(f"The commands are in {output}.", wraps=False)]),
        *(section for part in parts for section in _errors_to_expect(part)),
        Section("", [notes, Text(f"next: {ahead}")]),
    ]


def correction_view(document: Document) -> list[Section]:
    """Return the sections of a page, which lists the targets that are not corrected."""
    targets, most = document["targets"], 40
    rows = [(str(n), why) for n, why in zip(targets["line"], targets["reason"], strict=True) if why is not None]
    more = Text(f"The first {most} of {len(rows)}." * (len(rows) > most))
    table = Grid(("line", "reason"), rows[:most], is_text=True)
    return [*_errors_to_expect(document), Section("Targets not corrected", [table, more])]


def _errors_to_expect(document: Document) -> list[Section]:
    """Return the corrections and the errors to expect, and how many targets are not corrected for which cause."""
    expected, count = document["expected"], document["n_corrected"]
    rows: list[Sequence[Cell]] = [
        (
            label,
            *(
                number(size, factor)
                if size is None or size * factor >= _LEAST[name]
                else Number(f"< {_LEAST[name]:g}", size)
                for name, unit, _, factor in QUANTITIES
                for key in keys
                for size in [(part[name] or {}).get(f"{key}_{unit}")]
            ),
        )
        for label, part, keys in (
            *((f"error {stage}", part, ("expected_rms", "largest_bound95")) for stage, part in expected.items()),
            ("change of the command", document["correction"], ("rms", "max")),
        )
    ]
    turns = ("rms, °", "at most, °") if document["correction"]["orientation"] is not None else (None, None)
    grades = "; ".join(
        f"{', '.join(f'{name} {number}' for name, number in part['grades'].items() if number)} {stage}"
        for stage, part in expected.items()
        if part["grades"]
    )
    frames = "base and tool frames" if document["frame"] == "measuring" else "base frame"
    texts = [
        f"targets by grade: {grades}" * bool(grades),
        "at most: 95 % limit of the worst target" * bool(grades),
        f"error before: of the nominal arm in the {frames} of the model; it is smaller in the frames that fit the "
        "nominal arm best, which robacc calibrate and a registered estimate take",
    ]
    kind = f"{'joint' if document['given'] == 'joints' else 'Cartesian'} target{'s' * (count > 1)}"
    return [
        Section(
            f"Errors to expect at {count} corrected {kind}",
            [grid(("", "rms, mm", "at most, mm", *turns), rows), Listing(texts)] if count else [],
        ),
        Section(
            "",
            [
                Grid(
                    ("not corrected, kept as given", "targets"),
                    [(_CAUSES[cause], str(number)) for cause, number in document["refused"].items()],
                )
            ],
        ),
    ]


# Table of ``robacc export``, at most 80 columns.


def export_view(document: Document) -> list[Section]:
    """Return what the file holds, the error that remains in it, and the tool to set."""
    # Below it, mm or degrees, the digits of the file decide.
    remaining, tool, least = document["remaining_error"], document["tool"], 1e-4
    position, turn = (
        "{} rms, {} largest".format(
            *(
                unit_of(unit).after(f"< {least:g}" if size < least else three_digits(size))
                for size in (factor * remaining[name][f"{key}_{unit}"] for key in ("rms", "max"))
            )
        )
        for name, unit, _, factor in QUANTITIES
    )
    # Adding zero after rounding removes the sign of "-0.0000".
    place = ", ".join(f"{round(IN_MM * value, 4) + 0.0:.4f}" for value in tool["xyz_m"])
    angles = ", ".join(f"{round(IN_DEGREES * value, 5) + 0.0:.5f}" for value in tool["rpy_rad"])
    rows = [
        ("fitted again to", ", ".join(document["refitted"])),
        ("not in the format", ", ".join(document["not_carried"])),
        ("remaining error", f"position {position};"),
        ("", f"orientation {turn};"),
        ("", f"over {remaining['n_poses']} poses within the joint limits"),
        ("tool to set", f"x, y, z {place} mm"),
        ("", f"roll, pitch, yaw {angles}°"),
    ]
    arm = f" of {document['arm']}" * bool(document["arm"])
    table = Grid(("", ""), [(f"{label:<17}", text) for label, text in rows if text], is_text=True)
    return [Section(f"Export as {document['format']}{arm}", [table])]
