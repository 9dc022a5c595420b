"""An estimate: its grade, the size of the errors and their statistics; in full, in short, or of many files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from robacc.outcomes import EstimateHeadline, FileOutcome
from robacc.render.text.layout import (
    IN_DEGREES,
    IN_MM,
    Document,
    chance,
    confirmation,
    decimals,
    fixed,
    p_value,
    three_digits,
)
from robacc.render.text.parameter_names import as_options
from robacc.render.views.elements import (
    Block,
    Cell,
    Form,
    Grid,
    Listing,
    Number,
    ReportHeadline,
    Section,
    Text,
    amount,
    measured_cells,
    number,
    of_robot,
    percent,
    tile,
    with_unit,
)
from robacc.render.views.fit import parameter_tables
from robacc.render.views.gate import LOOKS, annotation, sentence, title
from robacc.statistics.intervals import ASSURANCE

_MIN_PROBABILITY = 0.005
"""Less probable grades are not listed."""
_MAX_WORST = 3
_MORE = "`full=True` adds covariances, tests, methods of the intervals and limitations"
_FRAMES = {
    "tool": "components along the axes of the commanded target (frame tool)",
    "base": "components along the axes of the measuring frame (frame base)",
}
_QUANTITIES = (("position", "mm", "m", IN_MM), ("orientation", "°", "rad", IN_DEGREES))
_FIGURES = (("rms", "rms"), ("mean", "mean_error"), ("95th percentile", "p95"), ("maximum", "max"))
_TESTS = {
    "zero_mean": "zero mean, Hotelling's T²",
    "skewness": "Gaussian, Mardia's skewness",
    "kurtosis": "Gaussian, Mardia's kurtosis",
}

Part = Mapping[str, Any]


def estimate_headline(document: Document) -> ReportHeadline:
    """Return the first screen of an estimate."""
    grade, robot = document["grade"], document.get("robot") or {}
    confirmed = confirmation(grade["demonstrated"], grade["confidence"])
    why, alignment = grade["reason"].split(". "), document["alignment"]
    is_modelled = robot.get("effects") or robot.get("fitted_to")
    reference = "model's predictions" if is_modelled else "commanded positions"
    files = {record["kind"]: record["name"] for record in document["inputs"]}
    ahead = "state the robot with `robot`, and let robacc trace find the causes of the error"
    if "robot" in files:
        poses = files.get("poses", "POSES")
        ahead = f"find the causes of the error: robacc trace {poses} --robot {files['robot']}"
    registration = "none"
    if alignment is not None:
        registration = f"{' and '.join(alignment['what'])}, {alignment['n_parameters']} parameters"
    rms, p95 = (amount(document["position"][f"{key}_m"]) for key in ("rms", "p95"))
    return ReportHeadline(
        f"Accuracy{of_robot(document)}",
        f"The measured positions differ from the {reference} by {rms} rms over {document['n_poses']} poses; 95 % of "
        f"the poses are within {p95}. This is grade {grade['grade']}, {confirmed}.",
        [
            tile(f"{name}, {label}", document[name][key], unit, bounds, _why_unbounded(bounds))
            for name, label, key, unit in (
                ("position", "rms", "rms_m", "m"),
                ("position", "95th percentile", "p95_m", "m"),
                ("orientation", "95th percentile", "p95_rad", "rad"),
            )
            if document[name] is not None
            for bounds in [document[name]["intervals"][key]]
        ],
        [(f"grade {grade['grade']}, {confirmed}", "good" if grade["demonstrated"] else "open")],
        [
            ("Why", "; ".join(why[:1] if grade["demonstrated"] else [why[0], *why[1:][-1:]])),
            ("Next", ahead),
            ("Registration", registration),
            ("Grade", f"{grade['grade']} on the scale {grade['scale']}"),
            ("Frame", "axes of the commanded target" if document["frame"] == "tool" else "axes of the measuring frame"),
        ],
    )


def _why_unbounded(bounds: Part) -> str:
    return "" if bounds["upper"] is not None else bounds["why"] or "no interval"


def estimate_view(
    document: Document, poses: str = "", robot: str | None = None, form: Form = "page"
) -> Iterator[Section]:
    """Return the view of an estimate; ``poses`` and ``robot`` are file names.

    In short it has the grade, the size of the errors and the worst poses; else all statistics, registration, methods
    of the intervals and limitations.
    """
    opening = _opening(document, poses, robot)
    if form == "short":
        yield opening
        yield from _short(document, poses, robot)
        return
    if form == "full":
        yield replace(opening, blocks=[*opening.blocks, Text(_FRAMES[document["frame"]], wraps=False)])
    grade = document["grade"]
    texts = [*grade["reason"].split(". ")]
    if grade["probability"] is not None:
        # Probabilities that round to zero are omitted, except that of the grade itself.
        shares = ", ".join(
            f"{entry['grade']} {chance(entry['probability'])}"
            for entry in grade["probabilities"]
            if entry["probability"] >= _MIN_PROBABILITY or entry["grade"] == grade["grade"]
        )
        texts.append(f"probability of each grade, given these poses: {shares}")
    texts += _confirming(grade, f"grade {grade['grade']}")
    steps = [
        [step["grade"], number(step["position_m"], IN_MM), number(step["orientation_rad"], IN_DEGREES)]
        for step in grade["steps"]
    ]
    header = (f"grade, by {grade['statistic']}", "position within, mm", "orientation within, °")
    yield _grade(grade, [Listing(texts), Grid(header, steps)])
    methods: dict[tuple[str, ...], list[str]] = {}
    for name, sign, unit, factor in _QUANTITIES:
        if document[name] is not None:
            yield Section(f"{name.capitalize()} error, {sign}", _statistics(document, name, sign, unit, factor))
            methods.setdefault(_methods(document[name], unit), []).append(name)
    yield from _targets(document)
    if document["alignment"] is not None:
        yield Section("Registration", parameter_tables(document["alignment"]["parameters"]))
    for how, names in methods.items():
        yield Section("Confidence intervals" + f", {names[0]}" * (len(methods) > 1), [Listing(how)])
    notes = document["notes"] if form == "full" else ()
    yield Section("Limitations", [Listing([document["position"]["pose_structure"]["text"], *notes])])


def _short(document: Document, poses: str, robot: str | None) -> Iterator[Section]:
    grade = document["grade"]
    first, *others = grade["reason"].split(". ")
    # The last sentence says why a grade is not confirmed.
    is_said = grade["demonstrated"] or not _is_met(grade)
    unconfirmed = [] if is_said else [*others[-1:], *_confirming(grade, "it")]
    yield _grade(grade, [Listing([first, *unconfirmed])])
    parts = [(document[name], f"{name}, {sign}", *unit) for name, sign, *unit in _QUANTITIES if document[name]]
    heads = [head for part, title, *_ in parts for head in (title, percent(part["confidence"]))]
    rows = [
        (label, *(cell for part, _, unit, factor in parts for cell in _measured(part, f"{key}_{unit}", factor)))
        for label, key in _FIGURES
    ]
    yield Section("", [Grid(("error", *heads), rows)])
    yield from _targets(document)
    worst = ", ".join(
        f"{_place(pose)}{name} {with_unit(pose['error_m'])}"
        for pose in document["worst_poses"]["by_position"][:_MAX_WORST]
        for name in ["" if pose["pose"] is None else f" (pose {pose['pose']})"]
    )
    ahead = f"next: find the causes of the error: robacc trace {poses} --robot {robot or 'ROBOT'}"
    yield Section("", [Text(f"largest errors: {worst}"), Text(_MORE, is_note=True), Text(ahead, wraps=False)])


def _opening(document: Document, poses: str, robot: str | None) -> Section:
    """Return the title, the files and the registration."""
    source = "standard input" if poses == "-" else poses
    reference = f"the model {robot}" if document["commanded"] == "robot" else "its cmd_ columns"
    registration, alignment = "frames as given, not registered", document["alignment"]
    if alignment is not None:
        fitted = " and ".join(alignment["what"])
        registration = f"registered: {fitted} fitted, {alignment['n_parameters']} parameters"
        # Without orientations a tool has no turns, which readers expect; a place that is not known they do not.
        unknown = [entry["name"] for entry in alignment["parameters"] if entry["std"] is None and entry["unit"] == "m"]
        if unknown:
            registration += f"; not identifiable on these poses: {', '.join(unknown)}"
    heading = f"Error of {document['n_poses']} measured pose{'s' * (document['n_poses'] != 1)}"
    lines = [Text(text, wraps=False) for text in (f"{source} against {reference}", registration)]
    if document["unaligned"] is not None:
        size = three_digits(document["unaligned"]["position"]["rms_m"] * IN_MM)
        lines.append(Text(f'before registration: {size} mm rms (`align="none"` leaves the frames as they are)'))
    return Section(heading, lines)


def _is_met(grade: Part) -> bool:
    """Return whether the grade is a step of the scale; else it is below all of them."""
    return grade["grade"] in [step["grade"] for step in grade["steps"]]


def _grade(grade: Part, blocks: Sequence[Block]) -> Section:
    """Return the section of the grade: green if it is confirmed, yellow if not."""
    met = confirmation(grade["demonstrated"], grade["confidence"]) if _is_met(grade) else "no step of the scale is met"
    text = f"Grade {grade['grade']}, {met}"
    return Section(f"{text} (scale: {grade['scale']})", blocks, "green" if grade["demonstrated"] else "bold yellow")


def _confirming(grade: Part, subject: str) -> list[str]:
    """Return how many poses would confirm the grade."""
    if grade["poses_to_demonstrate"] is None:
        return []
    return [
        f"{grade['poses_to_demonstrate']} poses in total would confirm {subject} with a probability of "
        f"{chance(ASSURANCE)}, if the estimate does not change"
    ]


def _measured(part: Part, key: str, factor: float) -> tuple[Number, str]:
    return measured_cells(part[key], factor, part["intervals"][key])


def _statistics(document: Document, name: str, sign: str, unit: str, factor: float) -> Iterator[Block]:
    """Yield all tables of the position or of the orientation error."""
    part = document[name]
    before = None if document["unaligned"] is None else document["unaligned"][name]
    head = percent(part["confidence"])
    rows = [
        (
            label,
            *_measured(part, f"{key}_{unit}", factor),
            "" if before is None else number(before[f"{key}_{unit}"], factor),
        )
        for label, key in _FIGURES
    ]
    rows += [
        (f"95 % radius, Gaussian, {label}", *measured_cells(radius[f"radius_{unit}"], factor, radius["interval"]), "")
        for label, radius in (
            ("zero mean", part["radius95"]["zero_mean"]),
            ("fitted mean", part["radius95"]["fitted_mean"]),
        )
    ]
    columns = 3 if before is None else 4
    yield Grid(("length", "", head, "unregistered")[:columns], [row[:columns] for row in rows])
    yield Grid(("mean vector", "", head), [*_mean(part, unit, factor)])
    yield Grid((f"covariance, {sign}²", "x", "y", "z"), [*_covariances(part, unit, factor)])
    axes: list[Sequence[Cell]] = [
        (
            str(place),
            *measured_cells(axis[f"sd_{unit}"], factor, axis["interval"]),
            # Adding zero after rounding removes the sign of "-0.00".
            *(f"{round(float(value), 2) + 0.0:+.2f}" for value in axis["direction"]),
        )
        for place, axis in enumerate(part["ellipsoid"], 1)
    ]
    yield Grid(("principal axis, standard deviation", "", head, "x", "y", "z"), axes)
    tests = [
        (label, number(test["statistic"]), test["why"] or "" if test["p_value"] is None else p_value(test["p_value"]))
        for label, test in ((label, part["tests"][key]) for key, label in _TESTS.items())
    ]
    yield Grid(("test of an assumption", "statistic", "result"), tests)
    yield _worst(name, document["worst_poses"][f"by_{name}"])


def _mean(part: Part, unit: str, factor: float) -> Iterator[Sequence[Cell]]:
    for axis, value, bounds in zip("xyz", part[f"mean_{unit}"], part["intervals"][f"mean_{unit}"], strict=True):
        mean, ends = measured_cells(value, factor, bounds)
        if bounds["lower"] is None:
            # A mean without an interval may be zero up to rounding, so the digits follow the rms.
            mean = Number(fixed(value * factor, decimals(part[f"rms_{unit}"] * factor, None, None)), value)
        yield axis, mean, ends


def _covariances(part: Part, unit: str, factor: float) -> Iterator[Sequence[Cell]]:
    for key, label in (("covariance", "about zero"), ("centred_covariance", "about the mean")):
        matrix, bounds = part[f"{key}_{unit}2"], part["intervals"][f"{key}_{unit}2"]
        for i, axis in enumerate("xyz"):
            ends = [
                {} if bounds["lower"] is None else {side: bounds[side][i][j] for side in ("lower", "upper")}
                for j in range(3)
            ]
            yield f"{label}, {axis}", *(number(matrix[i][j], factor**2, ends[j]) for j in range(3))


def _place(pose: Part) -> str:
    """Return the line of a pose, or its row where the file has no lines; documents of 0.2 have lines only."""
    return str(pose.get("place", f"line {pose['line']}"))


def _worst(name: str, poses: Sequence[Part]) -> Grid:
    ids = [key for key in ("pose", "target") if any(pose[key] is not None for pose in poses)]
    units = [unit for unit in ("m", "rad") if any(pose[f"error_{unit}"] is not None for pose in poses)]
    heads, factors = {"m": "position, mm", "rad": "orientation, °"}, {"m": IN_MM, "rad": IN_DEGREES}
    rows: list[Sequence[Cell]] = [
        (
            _place(pose),
            *(pose[key] or "" for key in ids),
            *(number(pose[f"error_{unit}"], factors[unit]) for unit in units),
        )
        for pose in poses
    ]
    return Grid((f"largest {name} errors", *ids, *(heads[unit] for unit in units)), rows)


def _targets(document: Document) -> Iterator[Section]:
    """Yield the position errors of each target; nothing without several."""
    rows = [
        (target["target"], str(target["n_poses"]), *(number(target[f"{key}_m"], IN_MM) for _, key in _FIGURES))
        for target in document["targets"]
    ]
    header = ("target", "poses", *(label for label, _ in _FIGURES))
    yield Section("Position error by target, mm", [Grid(header, rows)])


def _methods(part: Part, unit: str) -> tuple[str, ...]:
    """Return the assumption of the intervals, their methods, and why an interval is missing."""
    intervals = part["intervals"]
    methods: dict[str, list[str]] = {}
    for name, bounds in (
        ("rms", intervals[f"rms_{unit}"]),
        ("mean", intervals[f"mean_error_{unit}"]),
        ("95th percentile", intervals[f"p95_{unit}"]),
        ("95 % radius", part["radius95"]["zero_mean"]["interval"]),
        ("mean vector", intervals[f"mean_{unit}"][0]),
        ("covariance", intervals[f"covariance_{unit}2"]),
        ("principal axes", part["ellipsoid"][0]["interval"]),
    ):
        methods.setdefault(bounds["why"] or bounds["method"], []).append(name)
    texts = (f"{', '.join(names)}: {method}" for method, names in methods.items())
    return part["assumption"], *texts, f"maximum: {intervals[f'max_{unit}']['why']}"


# Several files in one table: one line per file, in the order given.

_LEVELS = {4: "error", 5: "warning"}
"""Level of an annotation by the exit status of a gate."""


def many_view(outcomes: Sequence[FileOutcome], robot: str | None, aligned: Sequence[str] | None) -> Iterator[Section]:
    """Return the table of all files; ``robot`` is a file name, ``aligned`` the effects fitted first."""
    alignment = f"registered: {' and '.join(aligned)} fitted in each" if aligned else "not registered"
    alignment = "registered where the frames do not agree" if aligned is None else alignment
    reference = Text(f"against {'their cmd_ columns' if robot is None else f'the model {robot}'}", wraps=False)
    yield Section(f"Pose errors in {len(outcomes)} files, {alignment}", [reference])
    yield Section("", [_table(outcomes)])
    notes = [
        f"{outcome.name}, {criterion['name']}: {LOOKS[criterion['outcome']].label}; {sentence(criterion)}"
        for outcome in outcomes
        for criterion in (outcome.gate or {}).get("criteria", ())
        if criterion["outcome"] != "pass"
    ]
    failed = [outcome for outcome in outcomes if outcome.failed]
    notes += [f"{outcome.name}, {reason(outcome)}" for outcome in failed]
    if failed:
        notes.append(f"{len(failed)} of {len(outcomes)} files could not be estimated")
    yield Section("", [Listing(notes)])


def _table(outcomes: Sequence[FileOutcome]) -> Grid:
    done = [(outcome, outcome.headline) for outcome in outcomes if outcome.headline is not None]
    cells: dict[str, Callable[[FileOutcome, EstimateHeadline], str]] = {
        "poses": lambda _, headline: str(headline.n_poses),
        "rms": lambda _, headline: three_digits(headline.rms * IN_MM),
        "95th pct.": lambda _, headline: three_digits(headline.p95 * IN_MM),
        "max": lambda _, headline: three_digits(headline.max * IN_MM),
        "rms, °": lambda _, headline: str(number(headline.orientation_rms, IN_DEGREES)),
        "grade": lambda _, headline: headline.grade,
        "confirmed": lambda _, headline: "yes" if headline.demonstrated else "no",
        "gate": lambda outcome, _: "–" if outcome.gate is None else LOOKS[outcome.gate["outcome"]].label,
    }
    if all(headline.orientation_rms is None for _, headline in done):
        del cells["rms, °"]
    if all(outcome.gate is None for outcome in outcomes):
        del cells["gate"]
    rows = {outcome.name: [cell(outcome, headline) for cell in cells.values()] for outcome, headline in done}
    return Grid(
        ("position error, mm", *cells), [(outcome.name, *rows.get(outcome.name, ["failed"])) for outcome in outcomes]
    )


def reason(outcome: FileOutcome) -> str:
    """Return the reason why a file has no result, in one line."""
    first = outcome.problems[0]
    counted = next((f"{name} {number}" for name, number in (("line", first.line), ("row", first.row)) if number), "")
    place = ", ".join(part for part in (counted, first.column) if part)
    others = f" (and {outcome.n_problems - 1} more)" if outcome.n_problems > 1 else ""
    return f"failed: {f'{place}: ' if place else ''}{as_options(first.message)}{others}"


def many_annotations(outcomes: Sequence[FileOutcome]) -> str:
    """Return one annotation of GitHub Actions per file, an error for a failed file or gate."""
    lines = []
    for outcome in outcomes:
        head, headline = f"robacc estimate {outcome.name}", outcome.headline
        lines += [annotation("warning", head, warning) for warning in outcome.warnings]
        if headline is None:
            lines.append(annotation("error", head, reason(outcome)))
            continue
        sizes = zip(("rms", "95th pct.", "max"), (headline.rms, headline.p95, headline.max), strict=True)
        parts = [
            f"{headline.n_poses} poses",
            *(f"{name} {with_unit(size)}" for name, size in sizes),
            f"grade {headline.grade}, {'confirmed' if headline.demonstrated else 'not confirmed'}",
            *([] if outcome.gate is None else [title(outcome.gate)]),
        ]
        lines.append(annotation(_LEVELS.get(outcome.exit_status, "notice"), head, "; ".join(parts)))
    return "".join(f"{line}\n" for line in lines)
