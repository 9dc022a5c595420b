"""Measured accuracy: an estimate in full or in short, an evaluation by ISO 9283 and its test poses."""

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

from robacc.iso_9283 import ORIENTATION_TEXT
from robacc.render.text import (
    IN_DEGREES,
    IN_MM,
    LISTED_ROWS,
    QUANTITIES,
    STATISTICS,
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
    amount,
    chance,
    counted_poses,
    decimals,
    fixed,
    grid,
    measured_cells,
    named_by_text,
    number,
    of_robot,
    p_value,
    parameter_tables,
    percent,
    statistics_cells,
    three_digits,
    tile,
    unit_of,
    with_unit,
)
from robacc.robots.description import Robot
from robacc.statistics.intervals import ASSURANCE

if TYPE_CHECKING:
    from robacc.iso_9283.evaluation import Proposal

_FRAMES = {
    "tool": "components along the axes of the commanded target (frame tool)",
    "base": "components along the axes of the measuring frame (frame base)",
}


def _registered(alignment: Document | None, joined: str = ": {} fitted, {} parameters") -> str:
    """Return the frames and the number of parameters of a registration; empty without one."""
    return "" if alignment is None else joined.format(" and ".join(alignment["what"]), alignment["n_parameters"])


def estimate_headline(document: Document) -> ReportHeadline:
    """Return the first screen of an estimate."""
    grade, robot = document["grade"], document.get("robot") or {}
    confirmed, (why, *reasons) = _confirmed(grade), grade["reason"].split(". ")
    reference = "model's predictions" if robot.get("effects") or robot.get("fitted_to") else "commanded positions"
    files = {record["kind"]: record["name"] for record in document["inputs"]}
    rms, p95 = (amount(document["position"][f"{key}_m"]) for key in ("rms", "p95"))
    return ReportHeadline(
        f"Accuracy{of_robot(document)}",
        f"The measured positions differ from the {reference} by {rms} rms over {document['n_poses']} poses; 95 % of "
        f"the poses are within {p95}. This is grade {grade['grade']}, {confirmed}.",
        [
            tile(f"{name}, {label}", document[name][key], unit, bounds, missing)
            for name, label, key, unit in (
                ("position", "rms", "rms_m", "m"),
                ("position", "95th percentile", "p95_m", "m"),
                ("orientation", "95th percentile", "p95_rad", "rad"),
            )
            if document[name] is not None
            for bounds in [document[name]["intervals"][key]]
            for missing in [bounds["why"] or "no interval" if bounds["upper"] is None else ""]
        ],
        [(f"grade {grade['grade']}, {confirmed}", "good" if grade["demonstrated"] else "open")],
        [
            ("Why", "; ".join([why, *([] if grade["demonstrated"] else reasons[-1:])])),
            (
                "Next",
                f"find the causes of the error: robacc trace {files.get('poses', 'POSES')} --robot {files['robot']}"
                if "robot" in files
                else "state the robot with `robot`, and let robacc trace find the causes of the error",
            ),
            ("Registration", _registered(document["alignment"], "{}, {} parameters") or "none"),
            ("Grade", f"{grade['grade']} on the scale {grade['scale']}"),
            ("Frame", "axes of the commanded target" if document["frame"] == "tool" else "axes of the measuring frame"),
        ],
    )


def _confirmed(grade: Document) -> str:
    return f"{'' if grade['demonstrated'] else 'not '}confirmed at {100 * grade['confidence']:g} % confidence"


def estimate_view(
    document: Document, poses: str = "", robot: str | None = None, form: Form = "page", stated: str = ""
) -> list[Section]:
    """Return the view of an estimate; ``poses`` and ``robot`` are file names, ``stated`` how the poses were read.

    In short it has the grade, the size of the errors and the worst poses; else all statistics, registration, methods
    of the intervals and limitations.
    """
    alignment, frame = document["alignment"], [_FRAMES[document["frame"]]] if form == "full" else []
    quantities = [(document[name], name, *units) for name, *units in QUANTITIES if document[name] is not None]
    opening = Section(
        f"Error of {counted_poses(document['n_poses'], document['position']['n_commanded_poses'])}",
        [Text(text, wraps=False) for text in (*_opening(document, poses, robot), *frame)],
    )
    if form == "short":
        heads = [h for part, name, _, sign, _ in quantities for h in (f"{name}, {sign}", percent(part["confidence"]))]
        rows = [
            (
                label,
                *(cell for own, _, unit, _, scale in quantities for cell in _measured(own, f"{key}_{unit}", scale)),
            )
            for label, key in STATISTICS
        ]
        worst = ", ".join(
            f"{_place(pose)}{name} {with_unit(pose['error_m'])}"
            for pose in document["worst_poses"]["by_position"][:3]
            for name in [f" (pose {pose['pose']})" * (pose["pose"] is not None and "photo" not in _place(pose))]
        )
        more = Text("`full=True` adds covariances, tests, methods of the intervals and limitations", is_note=True)
        ahead = f"next: find the causes of the error: robacc trace {poses} --robot {robot or 'ROBOT'}{stated}"
        return [
            opening,
            _grade(document["grade"], True),
            Section("", [Grid(("error", *heads), rows)]),
            _targets(document),
            Section("", [Text(f"largest errors: {worst}"), *_distances(document)[:1], more, Text(ahead, wraps=False)]),
        ]
    methods = {name: _methods(part, unit) for part, name, unit, *_ in quantities}
    is_one = len({*methods.values()}) == 1
    return [
        *([opening] if form == "full" else []),
        _grade(document["grade"], False),
        *(
            Section(f"{name.capitalize()} error, {sign}", _statistics(document, part, name, sign, unit, factor))
            for part, name, unit, sign, factor in quantities
        ),
        _targets(document),
        Section("Distances between poses", _distances(document)),
        Section("Registration", [] if alignment is None else parameter_tables(alignment["parameters"])),
        *(
            Section("Confidence intervals" + ("" if is_one else f", {name}"), [Listing(how)])
            for name, how in [*methods.items()][: 1 if is_one else None]
        ),
        Section(
            "Limitations",
            [Listing([document["position"]["pose_structure"]["text"], *(document["notes"] if form == "full" else ())])],
        ),
    ]


def _grade(grade: Document, is_short: bool) -> Section:
    """Return the grade with its reason, and in full the probability and the limits of each grade."""
    is_met, total = grade["grade"] in [step["grade"] for step in grade["steps"]], grade["poses_to_demonstrate"]
    met, (first, *others) = _confirmed(grade) if is_met else "no step of the scale is met", grade["reason"].split(". ")
    subject = "it" if is_short else f"grade {grade['grade']}"
    confirming = (
        f"{total} poses in total would confirm {subject} with a probability of {chance(ASSURANCE)}, if the estimate "
        "does not change"
    ) * (total is not None)
    # Probabilities that round to zero are omitted, except that of the grade itself.
    shares = ", ".join(
        f"{entry['grade']} {chance(entry['probability'])}"
        for entry in grade["probabilities"]
        if entry["probability"] >= 0.005 or entry["grade"] == grade["grade"]
    )
    known = f"probability of each grade, given these poses: {shares}" * (grade["probability"] is not None)
    table = Grid(
        (f"grade, by {grade['statistic']}", "position within, mm", "orientation within, °"),
        [
            [step["grade"], number(step["position_m"], IN_MM), number(step["orientation_rad"], IN_DEGREES)]
            for step in grade["steps"]
        ],
    )
    # The last sentence says why a grade is not confirmed.
    unconfirmed = [*others[-1:], confirming] if is_met and not grade["demonstrated"] else []
    return Section(
        f"Grade {grade['grade']}, {met} (scale: {grade['scale']})",
        [Listing([first, *unconfirmed])] if is_short else [Listing([first, *others, known, confirming]), table],
        "green" if grade["demonstrated"] else "bold yellow",
    )


def _opening(document: Document, poses: str, robot: str | None) -> list[str]:
    """Return the files and the registration."""
    reference = f"the model {robot}" if document["commanded"] == "robot" else "its cmd_ columns"
    # Without orientations a tool has no turns, which readers expect; a place that is not known they do not.
    parameters, registered = (document["alignment"] or {}).get("parameters", ()), _registered(document["alignment"])
    unknown = ", ".join(each["name"] for each in parameters if each["std"] is None and each["unit"] == "m")
    missing = f"; not identifiable on these poses: {unknown}" * bool(unknown)
    return [
        f"{'standard input' if poses == '-' else poses} against {reference}",
        f"registered{registered}{missing}" if registered else "frames as given, not registered",
        *(
            f'before registration: {with_unit(part["position"]["rms_m"])} rms (`align="none"` leaves the frames as '
            "they are)"
            for part in [document["unaligned"]]
            if part is not None
        ),
    ]


def _measured(part: Document, key: str, factor: float) -> tuple[Number, str]:
    return measured_cells(part[key], factor, part["intervals"][key])


def _statistics(document: Document, part: Document, name: str, sign: str, unit: str, factor: float) -> list[Block]:
    """Return all tables of the position or of the orientation error."""
    before, head = (document["unaligned"] or {}).get(name), percent(part["confidence"])
    unregistered: Sequence[Cell] = [""] * 4 if before is None else statistics_cells(before, unit, factor)
    lengths = [
        (label, *_measured(part, f"{key}_{unit}", factor), own)
        for (label, key), own in zip(STATISTICS, unregistered, strict=True)
    ]
    radii = [
        (f"95 % radius, Gaussian, {label}", *measured_cells(radius[f"radius_{unit}"], factor, radius["interval"]), "")
        for label, radius in ((key.replace("_", " "), part["radius95"][key]) for key in ("zero_mean", "fitted_mean"))
    ]
    # A mean without an interval may be zero up to rounding, so the digits follow the rms.
    places, bounds = decimals(part[f"rms_{unit}"] * factor, None, None), part["intervals"][f"mean_{unit}"]
    tests, worst = part["tests"], document["worst_poses"][f"by_{name}"]
    heads = {"pose": "pose", "target": "target"} | {f"error_{own}": f"{of}, {mark}" for of, own, mark, _ in QUANTITIES}
    return [
        grid(("length", "", head, "unregistered" if document["unaligned"] else None), [*lengths, *radii]),
        Grid(
            ("mean vector", "", head),
            [
                (axis, Number(fixed(value * factor, places), value) if own["lower"] is None else mean, ends)
                for axis, value, own in zip("xyz", part[f"mean_{unit}"], bounds, strict=True)
                for mean, ends in [measured_cells(value, factor, own)]
            ],
        ),
        Grid(
            (f"covariance, {sign}²", "x", "y", "z"),
            [
                (
                    f"{label}, {axis}",
                    *(number(v, factor**2, {"lower": low, "upper": high}) for v, low, high in zip(*rows, strict=True)),
                )
                for key, label in (("covariance", "about zero"), ("centred_covariance", "about the mean"))
                for own in [part["intervals"][f"{key}_{unit}2"]]
                for ends in [[[[None] * 3] * 3 if own[side] is None else own[side] for side in ("lower", "upper")]]
                for axis, *rows in zip("xyz", part[f"{key}_{unit}2"], *ends, strict=True)
            ],
        ),
        Grid(
            ("principal axis, standard deviation", "", head, "x", "y", "z"),
            [
                (
                    str(place),
                    *measured_cells(axis[f"sd_{unit}"], factor, axis["interval"]),
                    # Adding zero after rounding removes the sign of "-0.00".
                    *(f"{round(float(value), 2) + 0.0:+.2f}" for value in axis["direction"]),
                )
                for place, axis in enumerate(part["ellipsoid"], 1)
            ],
        ),
        Grid(
            ("test of an assumption", "statistic", "result"),
            [
                (
                    label,
                    number(tests[key]["statistic"]),
                    tests[key]["why"] or "" if tests[key]["p_value"] is None else p_value(tests[key]["p_value"]),
                )
                for key, label in (
                    ("zero_mean", "zero mean, Hotelling's T²"),
                    ("skewness", "Gaussian, Mardia's skewness"),
                    ("kurtosis", "Gaussian, Mardia's kurtosis"),
                )
            ],
        ),
        grid(
            (
                f"largest {name} errors",
                *(head if any(pose[key] is not None for pose in worst) else None for key, head in heads.items()),
            ),
            [
                (
                    _place(pose),
                    *(pose[key] or "" for key in ("pose", "target")),
                    *(number(pose[f"error_{own}"], scale) for _, own, _, scale in QUANTITIES),
                )
                for pose in worst
            ],
        ),
    ]


def _place(pose: Document) -> str:
    """Return the line of a pose, or its row where the file has no lines; documents of 0.2 have lines only."""
    return str(pose.get("place", f"line {pose['line']}"))


def _targets(document: Document) -> Section:
    """Return the position errors of each target; nothing without several."""
    return Section(
        "Position error by target, mm",
        [
            Grid(
                ("target", "poses", *(name for name, _ in STATISTICS)),
                [
                    (target["target"], str(target["n_poses"]), *statistics_cells(target, "m", IN_MM))
                    for target in document["targets"]
                ],
            )
        ],
    )


def _distances(document: Document) -> list[Block]:
    """Return the errors of the distances between poses, in a sentence and by distance; none if they are unknown."""
    if (found := document.get("distances")) is None:
        return []
    return [
        Text(
            f"distances between poses: 95 % within {with_unit(found['p95_m'])}, largest error "
            f"{with_unit(found['max_m'])} ({' to '.join(found['between'])}, {with_unit(found['distance_m'])})"
            + f"; measured ones are {100 * found['scale']:+.2g} % longer on average"
            * (abs(found["scale"]) >= 1e-5)
        ),
        Grid(
            ("distance up to, mm", "pairs", "rms error, mm", "largest, mm"),
            [
                (
                    str(round(band["up_to_m"] * IN_MM)),
                    str(band["n_pairs"]),
                    number(band["rms_m"], IN_MM),
                    number(band["max_m"], IN_MM),
                )
                for band in found["bands"]
            ],
        ),
        Text("registration of the base does not change them; with the noise of the measurement", is_note=True),
    ]


def _methods(part: Document, unit: str) -> tuple[str, ...]:
    """Return the assumption of the intervals, their methods, and why an interval is missing."""
    intervals = part["intervals"]
    all_bounds = (
        *((name, intervals[f"{key}_{unit}"]) for name, key in STATISTICS[:3]),
        ("95 % radius", part["radius95"]["zero_mean"]["interval"]),
        ("mean vector", intervals[f"mean_{unit}"][0]),
        ("covariance", intervals[f"covariance_{unit}2"]),
        ("principal axes", part["ellipsoid"][0]["interval"]),
    )
    return (
        part["assumption"],
        *named_by_text((name, bounds["why"] or bounds["method"]) for name, bounds in all_bounds),
        f"maximum: {intervals[f'max_{unit}']['why']}",
    )


# An evaluation by ISO 9283. Accuracy and repeatability stand in separate tables: reading RP as AP is the commonest
# mistake with the standard.

_NAMES = {
    "AP": "pose accuracy",
    "vAP": "multi-directional variation",
    "AD": "distance accuracy, ±",
    "E": "exchangeability of robots",
    "RP": "pose repeatability",
    "RD": "distance repeatability, ±",
    "dAP": "drift of pose accuracy",
    "dRP": "drift of pose repeatability",
    "shift": "shift of the barycentre",
}
_GROUPS = (
    ("Accuracy: distance between commanded and attained poses", ("AP", "vAP", "AD", "E")),
    ("Repeatability: scatter of the visits, whatever their distance from the command", ("RP", "RD")),
    ("Drift: change of accuracy and repeatability during the run", ("dAP", "dRP", "shift")),
)
_BESIDE = {
    "xyz_m": ("x", "y", "z"),
    "abc_rad": ("a", "b", "c"),
    "distance": ("mean l", "S_l"),
    "between": ("between",),
}
"""Heads of what stands beside a value in a table by place."""
_TABLES = (
    ("AP", "Pose accuracy AP by pose, mm", "AP_p", "xyz_m"),
    ("AP", "Pose accuracy AP of orientation by pose, °", "", "abc_rad"),
    ("RP", "Pose repeatability RP by pose, mm (not accuracy)", "RP_l", "distance"),
    ("RP", "Pose repeatability RP of orientation by pose, ± ° (not accuracy)", "", "abc_rad"),
    ("vAP", "Multi-directional variation vAP by pose, mm", "vAP", "between"),
    ("E", "Exchangeability E by pose, mm", "E", "between"),
    ("AD", "Distance accuracy AD by pair of poses, mm", "AD_p", "xyz_m"),
    ("RD", "Distance repeatability RD by pair of poses, ± mm (not accuracy)", "RD_p", "xyz_m"),
)
"""Criterion of each table by place, its title, the head of its value, and key of what stands beside it."""
_STATUS = {"met": "met", "not_met": "NOT MET", "unknown": "unknown"}


def iso9283_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``iso9283``."""
    met = sum(condition["status"] == "met" for condition in document["protocol"])
    return ReportHeadline(
        f"ISO 9283 pose criteria{of_robot(document)}",
        f"{document['n_commanded_poses']} commanded poses in {document['n_poses']} visits; each criterion is the "
        f"largest value over the poses. The data meet {met} of {len(document['protocol'])} conditions of the "
        "standard's protocol.",
        [
            tile(label, part["max_m"], "m", part["intervals"]["max_m"], f"at {part['max_at']}")
            for label, symbol in (
                ("accuracy, AP", "AP"),
                ("repeatability, RP", "RP"),
                ("multi-directional, vAP", "vAP"),
            )
            for part in [document["iso9283"][symbol]]
            if part["max_m"] is not None
        ],
        (),
        [
            ("Files", ", ".join(document["files"])),
            ("Registration", _registered((document["alignment"] or [None])[0], "{}") or "none"),
        ],
    )


def iso9283_view(document: Document, robot: str | None = None, form: Form = "page") -> list[Section]:
    """Return all criteria by group, by pose and by pair of poses, the protocol, and the methods of the intervals.

    In short, one table of the criteria; ``robot`` is the file's name.
    """
    confidence, protocol = document["confidence"], document["protocol"]
    parts = [p for entry in document["iso9283"].values() for p in ([entry] if "symbol" in entry else entry.values())]
    criteria = {part["symbol"]: part for part in parts}
    start = Section("Pose criteria of ISO 9283:1998", [Text(fact, wraps=False) for fact in _facts(document, robot)])
    if form == "short":
        listed = [part for part in parts if part["max_m"] or part["symbol"] not in ("vAP", "E")]
        counts = Counter(_STATUS[condition["status"]] for condition in protocol)
        statuses = ", ".join(f"{n} {status}" for status, n in counts.items())
        told = Text(f"conditions of the standard's protocol: {statuses}")
        more = Text("criteria by pose, conditions, methods and limitations: `full`", is_note=True)
        return [start, Section("", [*_summary(listed, confidence), told, more])]
    known = [(part["symbol"], part["intervals"]["max_m"]) for part in parts if part["max_m"] is not None]
    methods = named_by_text((symbol, own["why"] or own["method"].partition("; largest")[0]) for symbol, own in known)
    corrected = (
        "largest over poses: its upper limit is the greatest upper limit, its lower limit is corrected for the number "
        "of poses"
    )
    return [
        *([start] if form == "full" else []),
        *(Section(title, _summary([criteria[symbol] for symbol in symbols], confidence)) for title, symbols in _GROUPS),
        *(
            _places(criteria[symbol], heading, head, key, confidence, len(document["files"]) > 1)
            for symbol, heading, head, key in _TABLES
        ),
        Section(
            "Conditions of the standard's protocol",
            [
                Grid(
                    ("condition", "clause", "status", "reason"),
                    [(each["condition"], each["clause"], _STATUS[each["status"]], each["why"]) for each in protocol],
                    is_text=True,
                )
            ],
        ),
        Section(
            "Confidence intervals",
            [
                Listing(
                    [
                        *methods,
                        corrected * any("; largest" in part["intervals"]["max_m"]["method"] for part in parts),
                        "visits are taken as independent Gaussian draws; no interval includes the instrument's "
                        "systematic error",
                    ]
                )
            ],
        ),
        Section("Limitations", [Listing(document["notes"] if form == "full" else ())]),
    ]


def _facts(document: Document, robot: str | None) -> list[str]:
    """Return the files, how many poses and visits they have, where the commanded poses are from, the registration."""
    files = dict.fromkeys(Counter(pose["file"] for pose in document["visits"]).values())
    counts = sorted({pose["n"] for pose in document["visits"]})
    visits = " to ".join(map(str, dict.fromkeys((counts[0], counts[-1]))))
    each = f"{visits} visit{'s' * (counts != [1])}{' of each' * (len(document['visits']) > 1)}"
    several = ", robot by robot" * (len(document["files"]) > 1)
    poses = f"{' and '.join(map(str, files))} commanded pose{'s' * ([*files] != [1])}{several}"
    before = [three_digits(float(value) * IN_MM) for value in (document["unaligned"] or {}).get("AP_max_m", ())]
    sources = {None: "no commanded poses", "robot": f"commanded poses from the model {robot or ''}"}
    return [
        f"{', '.join(document['files'])}: {poses}, {each}",
        sources.get(document["commanded"], "commanded poses from cmd_ columns"),
        f"registered{_registered(document['alignment'][0])}" if document["alignment"] else "not registered",
        *([f"largest AP before registration: {', '.join(before)} mm"] if before else []),
    ]


def _summary(criteria: Sequence[Document], confidence: float) -> list[Block]:
    """Return the largest value of each criterion, then the missing criteria with the reasons."""
    rows = [
        (label, part["clause"].removeprefix("ISO 9283:1998, "), size, sign, ends, own["max_at"] or "")
        for part in criteria
        for label, unit, sign, own, factor in (
            (f"{_symbol(part):<4}{_NAMES[part['symbol']]}", "m", "mm", part, IN_MM),
            ("      of orientation", "rad", "°", part["orientation"], IN_DEGREES),
        )
        if own[f"max_{unit}"] is not None
        for size, ends in [_measured(own, f"max_{unit}", factor)]
    ]
    missing = named_by_text(
        (f"no {_symbol(part)} ({name})" if _symbol(part) else f"no {name}", part["why"] or "")
        for part in criteria
        for name in [_NAMES[part["symbol"]].removesuffix(", ±")]
        if part["max_m"] is None
    )
    return [
        Grid(("largest over poses", "clause", "", "", percent(confidence), "at"), rows),
        Listing([*missing, *dict.fromkeys(note for part in criteria for note in part["notes"])]),
    ]


def _symbol(criterion: Document) -> str:
    """Return the symbol of a criterion in a text; the shift has none in the standard."""
    return "" if criterion["symbol"] == "shift" else str(criterion["symbol"])


def _places(criterion: Document, heading: str, head: str, key: str, confidence: float, several: bool) -> Section:
    """Return one row per place, the largest first if there are too many, with the file if there are several."""
    has_none = key == "abc_rad" and all(place[key] is None for place in criterion["poses"])
    places = [] if has_none else criterion["poses"]
    if len(places) > LISTED_ROWS:
        heading += f" (the {LISTED_ROWS} largest of {len(places)})"
        places = sorted(places, key=lambda place: -abs(place["position_m"] or 0.0))[:LISTED_ROWS]
    file = "file" if several and criterion["symbol"] != "E" else None
    values = ("visits", head, percent(confidence)) if head else (None, None, None)
    rows = [
        (
            place["pose"],
            place["file"] or "",
            str(place["n"]),
            *_measured(place, "position_m", IN_MM),
            *_beside(place, key),
        )
        for place in places
    ]
    return Section(heading, [grid(("", file, *values, *_BESIDE[key]), rows)])


def _beside(place: Document, key: str) -> list[Cell]:
    """Return what stands beside the value of a place."""
    bounds = place["intervals"]
    if key == "between":
        return [place.get("between") or ""]
    if key == "distance":
        return [number(place.get(f"{own}_distance_m"), IN_MM, bounds["position_m"]) for own in ("mean", "sd")]
    return [
        number(value, IN_MM if key == "xyz_m" else IN_DEGREES, own)
        for value, own in zip(place[key] or (), bounds[key] or (), strict=True)
    ]


# The cube of ISO 9283 and its five poses, as comments of their CSV and as a table.


def proposal_comments(proposal: "Proposal", robot: str) -> list[str]:
    """Return the comment lines above the columns: cube, plane and tool orientation."""
    return [
        f"Test poses of ISO 9283:1998, 6.8, for {robot}: planned poses, not measured.",
        *_cube_facts(proposal),
        *proposal.notes,
    ]


def proposal_view(proposal: "Proposal", robot: Robot) -> list[Section]:
    """Return the cube, the commanded poses in the measuring frame and the joints, in mm and degrees."""
    units = [unit_of("rad" if joint.type == "revolute" else "m") for joint in robot.variables]
    names = [f"{name}, {unit.name}" for name, unit in zip(robot.variable_names, units, strict=True)]
    rows = [
        (f"P{i}", *(fixed(float(value), 2) for value in place))
        for i, place in enumerate(proposal.poses.translation.T * IN_MM, 1)
    ]
    joints = [
        (f"P{i}", *(fixed(float(value) * unit.factor, 3) for value, unit in zip(q, units, strict=True)))
        for i, q in enumerate(proposal.q.T, 1)
    ]
    return [
        Section(f"Test poses of ISO 9283:1998 for {robot.name}", [Listing(_cube_facts(proposal))]),
        Section("", [Grid(("commanded, mm", "x", "y", "z"), rows), Grid(("joints", *names), joints)]),
        Section("Limitations", [Listing(proposal.notes)]),
    ]


def _cube_facts(proposal: "Proposal") -> list[str]:

    x, y, z = (float(value) * IN_MM for value in proposal.centre)
    return [
        f"cube with an edge of {proposal.edge * IN_MM:g} mm and its centre P1 at x {x:.0f}, y {y:.0f}, z {z:.0f} mm in "
        "the base frame",
        f"P2 to P5 at 10 % of the diagonal from the corners, in the plane inclined at 45° towards {proposal.plane}",
        f"{ORIENTATION_TEXT[proposal.orientation]}; every joint keeps at least {100.0 * proposal.margin:.0f} % of its "
        "range to each limit",
    ]
