"""An estimate: its grade, the size of the errors and their statistics; in full, in short, or of many files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robacc.outcomes import FileOutcome
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
    Grid,
    Listing,
    Number,
    Section,
    Text,
    measured_cells,
    number,
    percent,
)
from robacc.render.views.fit import parameter_tables
from robacc.render.views.gate import OUTCOME_LABELS, annotation, sentence, title
from robacc.statistics.confidence_curves import ASSURANCE

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


def estimate_view(document: Document, poses: str, robot: str | None) -> Iterator[Section]:
    """Return the full text of an estimate; ``poses`` and ``robot`` are file names."""
    opening = _opening(document, poses, robot)
    yield Section(opening.title, [*opening.blocks, Text(_FRAMES[document["frame"]], wraps=False)])
    yield from estimate_sections(document)
    limits = [document["position"]["pose_structure"]["text"], *document["notes"]]
    yield Section("Limitations", [Listing(limits)])


def estimate_page(document: Document) -> Iterator[Section]:
    """Return the sections of a page, which shows the notes elsewhere."""
    yield from estimate_sections(document)
    yield Section("Limitations", [Listing([document["position"]["pose_structure"]["text"]])])


def short_estimate_view(document: Document, poses: str, robot: str | None) -> Iterator[Section]:
    """Return the grade, the size of the errors and the worst poses, in about fifteen lines."""
    yield _opening(document, poses, robot)
    grade = document["grade"]
    texts = grade["reason"].split(". ")
    # The last sentence says why a grade is not confirmed.
    unconfirmed = [] if grade["demonstrated"] else [*texts[1:][-1:], *_confirming(grade, "it")]
    yield _grade(grade, [Listing([texts[0], *unconfirmed])])
    parts = [(document[name], unit, factor) for name, _, unit, factor in _QUANTITIES if document[name] is not None]
    heads = [
        head for name, sign, _, _ in _QUANTITIES for head in (f"{name}, {sign}", percent(parts[0][0]["confidence"]))
    ]
    rows = [
        (label, *(cell for part, unit, factor in parts for cell in _measured(part, f"{key}_{unit}", factor)))
        for label, key in _FIGURES
    ]
    yield Section("", [Grid(("error", *heads[: 2 * len(parts)]), rows)])
    yield from _targets(document)
    worst = []
    for pose in document["worst_poses"]["by_position"][:_MAX_WORST]:
        name = "" if pose["pose"] is None else f" (pose {pose['pose']})"
        worst.append(f"{_place(pose)}{name} {three_digits(pose['error_m'] * IN_MM)} mm")
    ahead = f"robacc trace {poses} --robot {robot or 'ROBOT'} finds the causes of the error"
    yield Section(
        "",
        [Text(f"largest errors: {', '.join(worst)}"), Text(f"next: {ahead}"), Text(_MORE, is_note=True)],
    )


def estimate_sections(document: Document) -> Iterator[Section]:
    """Return grade, position, orientation, targets, registration, and the methods of the intervals."""
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
    methods = {}
    for name, sign, unit, factor in _QUANTITIES:
        if document[name] is not None:
            yield Section(f"{name.capitalize()} error, {sign}", _statistics(document, name, sign, unit, factor))
            methods[name] = _methods(document[name], unit)
    yield from _targets(document)
    if document["alignment"] is not None:
        yield Section("Registration", parameter_tables(document["alignment"]["parameters"]))
    if len(methods) == 1 or methods["position"] == methods["orientation"]:
        yield Section("Confidence intervals", [Listing(methods["position"])])
    else:
        yield from (Section(f"Confidence intervals, {name}", [Listing(texts)]) for name, texts in methods.items())


def _opening(document: Document, poses: str, robot: str | None) -> Section:
    """Return the title, the files and the registration."""
    source = "standard input" if poses == "-" else poses
    reference = f"the model {robot}" if document["commanded"] == "robot" else "its cmd_ columns"
    registration, alignment = "not registered", document["alignment"]
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


def _grade(grade: Part, blocks: Sequence[Block]) -> Section:
    """Return the section of the grade: green if it is confirmed, yellow if not."""
    text = f"Grade {grade['grade']}, {confirmation(grade['demonstrated'], grade['confidence'])}"
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
    interval_head = percent(part["confidence"])
    rows: list[Sequence[Cell]] = []
    for label, key in _FIGURES:
        earlier = [] if before is None else [number(before[f"{key}_{unit}"], factor)]
        rows.append((label, *_measured(part, f"{key}_{unit}", factor), *earlier))
    for label, key in (("zero mean", "zero_mean"), ("fitted mean", "fitted_mean")):
        radius = part["radius95"][key]
        cells = measured_cells(radius[f"radius_{unit}"], factor, radius["interval"])
        rows.append((f"95 % radius, Gaussian, {label}", *cells, *([] if before is None else [""])))
    yield Grid(("length", "", interval_head, *([] if before is None else ["unregistered"])), rows)
    yield Grid(("mean vector", "", interval_head), [*_mean(part, unit, factor)])
    yield Grid((f"covariance, {sign}²", "x", "y", "z"), [*_covariances(part, unit, factor)])
    axes: list[Sequence[Cell]] = []
    for place, axis in enumerate(part["ellipsoid"], 1):
        # Adding zero after rounding removes the sign of "-0.00".
        direction = [f"{round(float(value), 2) + 0.0:+.2f}" for value in axis["direction"]]
        axes.append((str(place), *measured_cells(axis[f"sd_{unit}"], factor, axis["interval"]), *direction))
    yield Grid(("principal axis, standard deviation", "", interval_head, "x", "y", "z"), axes)
    tests: list[Sequence[Cell]] = []
    for key, label in _TESTS.items():
        test = part["tests"][key]
        outcome = test["why"] or "" if test["p_value"] is None else p_value(test["p_value"])
        tests.append((label, number(test["statistic"]), outcome))
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
    has_turn = any(pose["error_rad"] is not None for pose in poses)
    rows: list[Sequence[Cell]] = [
        (
            _place(pose),
            *(pose[key] or "" for key in ids),
            number(pose["error_m"], IN_MM),
            *([number(pose["error_rad"], IN_DEGREES)] if has_turn else []),
        )
        for pose in poses
    ]
    return Grid((f"largest {name} errors", *ids, "position, mm", *(["orientation, °"] if has_turn else [])), rows)


def _targets(document: Document) -> Iterator[Section]:
    """Yield the position errors of each target; nothing without several."""
    rows: list[Sequence[Cell]] = [
        (target["target"], str(target["n_poses"]), *(number(target[f"{key}_m"], IN_MM) for _, key in _FIGURES))
        for target in document["targets"]
    ]
    if rows:
        header = ("target", "poses", *(label for label, _ in _FIGURES))
        yield Section("Position error by target, mm", [Grid(header, rows)])


def _methods(part: Part, unit: str) -> list[str]:
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
    texts = [f"{', '.join(names)}: {method}" for method, names in methods.items()]
    return [part["assumption"], *texts, f"maximum: {intervals[f'max_{unit}']['why']}"]


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
    if notes := [*_unmet_criteria(outcomes), *_failures(outcomes)]:
        yield Section("", [Listing(notes)])


def _unmet_criteria(outcomes: Sequence[FileOutcome]) -> Iterator[str]:
    """Return a line for each criterion that a file does not pass."""
    for outcome in outcomes:
        for criterion in outcome.gate["criteria"] if outcome.gate is not None else ():
            if criterion["outcome"] != "pass":
                label = OUTCOME_LABELS[criterion["outcome"]]
                yield f"{outcome.name}, {criterion['name']}: {label}; {sentence(criterion)}"


def _failures(outcomes: Sequence[FileOutcome]) -> Iterator[str]:
    failed = [outcome for outcome in outcomes if outcome.failed]
    yield from (f"{outcome.name}, {reason(outcome)}" for outcome in failed)
    if failed:
        yield f"{len(failed)} of {len(outcomes)} files could not be estimated"


def _table(outcomes: Sequence[FileOutcome]) -> Grid:
    has_orientation = any(
        outcome.headline is not None and outcome.headline.orientation_rms is not None for outcome in outcomes
    )
    has_gate = any(outcome.gate is not None for outcome in outcomes)
    header = ["position error, mm", "poses", "rms", "95th pct.", "max", *(["rms, °"] if has_orientation else [])]
    header += ["grade", "confirmed", *(["gate"] if has_gate else [])]
    return Grid(header, [_cells(outcome, has_orientation, has_gate) for outcome in outcomes])


def _cells(outcome: FileOutcome, has_orientation: bool, has_gate: bool) -> list[str]:
    headline = outcome.headline
    if headline is None:
        return [outcome.name, "failed"]
    cells = [
        outcome.name,
        str(headline.n_poses),
        *(three_digits(size * IN_MM) for size in (headline.rms, headline.p95, headline.max)),
    ]
    if has_orientation:
        cells.append("–" if headline.orientation_rms is None else three_digits(headline.orientation_rms * IN_DEGREES))
    cells += [headline.grade, "yes" if headline.demonstrated else "no"]
    return [
        *cells,
        *([OUTCOME_LABELS[outcome.gate["outcome"]]] if outcome.gate is not None else ["–"] if has_gate else []),
    ]


def reason(outcome: FileOutcome) -> str:
    """Return the reason why a file has no result, in one line."""
    first = outcome.problems[0]
    counted = next((f"{name} {number}" for name, number in (("line", first.line), ("row", first.row)) if number), "")
    place = ", ".join(part for part in (counted, first.column) if part)
    others = f" (and {outcome.n_problems - 1} more)" if outcome.n_problems > 1 else ""
    return f"failed: {f'{place}: ' if place else ''}{as_options(first.message)}{others}"


def many_annotations(outcomes: Sequence[FileOutcome]) -> str:
    """Return one annotation of GitHub Actions per file, an error for a failed file or gate."""
    return "".join(f"{line}\n" for outcome in outcomes for line in _annotated(outcome))


def _annotated(outcome: FileOutcome) -> Iterator[str]:
    head = f"robacc estimate {outcome.name}"
    for warning in outcome.warnings:
        yield annotation("warning", head, warning)
    headline = outcome.headline
    if headline is None:
        yield annotation("error", head, reason(outcome))
        return
    sizes = zip(("rms", "95th pct.", "max"), (headline.rms, headline.p95, headline.max), strict=True)
    parts = [f"{headline.n_poses} poses", *(f"{name} {three_digits(size * IN_MM)} mm" for name, size in sizes)]
    parts.append(f"grade {headline.grade}, {'confirmed' if headline.demonstrated else 'not confirmed'}")
    if outcome.gate is not None:
        parts.append(title(outcome.gate))
    yield annotation(_LEVELS.get(outcome.exit_status, "notice"), head, "; ".join(parts))
