"""An estimate as tables, in about fifteen lines, and as one line of a table of several files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, TextIO

from robacc.accuracy.estimation import EstimateResult, WorstPose
from robacc.accuracy.grade import Grade
from robacc.geometry import Array
from robacc.outcomes import FileOutcome
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.gate import OUTCOME_LABELS, annotation, sentence, title
from robacc.render.text.layout import (
    BLANK,
    IN_DEGREES,
    IN_MM,
    TextLine,
    beside,
    chance,
    columns,
    confirmation,
    decimals,
    exponent_of_thousand,
    fixed,
    heading,
    items,
    p_value,
    three_digits,
    wrapped,
)
from robacc.render.text.parameter_names import as_options
from robacc.statistics.confidence_curves import ASSURANCE
from robacc.statistics.intervals import Interval
from robacc.statistics.records import ErrorStatistics, MatrixInterval

if TYPE_CHECKING:
    from robacc.accuracy.pose_errors import ErrorMetrics


_MIN_PROBABILITY = 0.005
"""Less probable grades are not listed."""
_FRAMES = {
    "tool": "components along the axes of the commanded target (frame tool)",
    "base": "components along the axes of the measuring frame (frame base)",
}


def draw_estimate(result: EstimateResult, poses: str, robot: str | None, stream: TextIO) -> None:
    """Write the report of ``robacc estimate`` to ``stream``; ``poses`` and ``robot`` are file names."""
    write_lines(estimate_lines(result, poses, robot, width_of(stream)), stream)


def estimate_lines(result: EstimateResult, poses: str, robot: str | None, width: int) -> Iterator[TextLine]:
    """Return the report's lines; text is wrapped to ``width`` columns, tables take at most 80."""
    yield from opening(result, poses, robot)
    yield TextLine(_FRAMES[result.errors.frame])
    yield BLANK
    yield from _grade_lines(result, width)
    before = result.unaligned
    earlier = None if before is None else before.position
    yield from _block("Position", "mm", IN_MM, result.position, earlier, result.worst_position)
    if result.orientation is not None:
        earlier = None if before is None else before.orientation
        yield from _block("Orientation", "°", IN_DEGREES, result.orientation, earlier, result.worst_orientation)
    if result.targets:
        yield from targets_table(result)
    for name, texts in _interval_notes(result):
        yield from (BLANK, heading(name), *items(texts, width))
    yield from (BLANK, heading("Limitations"))
    yield from items([result.position.structure.text, *result.notes], width)


def opening(result: EstimateResult, poses: str, robot: str | None) -> Iterator[TextLine]:
    """Return the title, the files and the registration."""
    plural = "s" * (result.n_poses != 1)
    yield heading(f"Error of {result.n_poses} measured pose{plural}")
    source = "standard input" if poses == "-" else poses
    yield TextLine(f"{source} against {f'the model {robot}' if result.commanded == 'robot' else 'its cmd_ columns'}")
    yield TextLine(_registration(result))


def _registration(result: EstimateResult) -> str:
    if result.alignment is None:
        return "not registered"
    alignment = result.alignment
    text = f"registered: {' and '.join(alignment.effects)} fitted, {alignment.n_parameters} parameters"
    # Without orientations a tool has no turns, which readers expect; a place that is not known they do not.
    unknown = [entry.name for entry in alignment.parameters if entry.std is None and entry.unit == "m"]
    return f"{text}; not identifiable on these poses: {', '.join(unknown)}" if unknown else text


def _grade_lines(result: EstimateResult, width: int) -> Iterator[TextLine]:
    grade = result.grade
    yield grade_heading(grade)
    yield from items([*grade.reason.split(". "), *_odds(grade)], width)


def grade_heading(grade: Grade) -> TextLine:
    """Return the grade: green if it is confirmed, yellow if not."""
    text = f"Grade {grade.grade}, {confirmation(grade.demonstrated, grade.scale.confidence)}"
    return TextLine(f"{text} (scale: {grade.scale.name})", "green" if grade.demonstrated else "bold yellow")


def _odds(grade: Grade) -> Iterator[str]:
    """Return the probability of each grade, and how many poses would confirm this grade."""
    if grade.probability is not None:
        # Probabilities that round to zero are omitted, except that of the grade itself.
        listed = [
            (name, share) for name, share in grade.probabilities if share >= _MIN_PROBABILITY or name == grade.grade
        ]
        shares = ", ".join(f"{name} {chance(share)}" for name, share in listed)
        yield f"probability of each grade, given these poses: {shares}"
    if grade.poses_to_demonstrate is not None:
        yield (
            f"if the estimate does not change, {grade.poses_to_demonstrate} poses in total would confirm grade "
            f"{grade.grade} with a probability of {chance(ASSURANCE)}"
        )


def _block(
    name: str,
    unit: str,
    factor: float,
    statistics: ErrorStatistics,
    before: ErrorMetrics | None,
    worst: Sequence[WorstPose],
) -> Iterator[TextLine]:
    """Return all tables of the position or of the orientation error."""
    yield from (BLANK, heading(f"{name} error, {unit}"))
    yield from _figures(factor, statistics, before)
    for part in (
        _mean(factor, statistics),
        _covariances(unit, factor, statistics),
        _ellipsoid(factor, statistics),
        _tests(statistics),
        _worst(name, worst),
    ):
        yield from (BLANK, *part)


def _figures(factor: float, statistics: ErrorStatistics, before: ErrorMetrics | None) -> list[TextLine]:
    """Return the statistics of the error's length with their intervals, and those before registration."""
    intervals = statistics.intervals
    figures: list[tuple[str, float | None, Interval]] = [
        ("rms", statistics.rms, intervals.rms),
        ("mean", statistics.mean_error, intervals.mean_error),
        ("95th percentile", statistics.p95, intervals.p95),
        ("maximum", statistics.max, Interval.missing(statistics.confidence, "")),
        (
            "95 % radius, Gaussian, zero mean",
            statistics.radius95_zero_mean.value,
            statistics.radius95_zero_mean.interval,
        ),
        (
            "95 % radius, Gaussian, fitted mean",
            statistics.radius95_fitted_mean.value,
            statistics.radius95_fitted_mean.interval,
        ),
    ]
    rows = [(label, *measured_figure(value, interval, factor)) for label, value, interval in figures]
    if before is None:
        return columns(("length", "", _percent(statistics)), rows)
    # The radii come last and have no unregistered value.
    earlier = [three_digits(value * factor) for value in (before.rms, before.mean, before.p95, before.max)]
    table = [(*row, cell) for row, cell in zip_longest(rows, earlier, fillvalue="")]
    return columns(("length", "", _percent(statistics), "unregistered"), table)


def _mean(factor: float, statistics: ErrorStatistics) -> list[TextLine]:
    intervals = statistics.intervals.mean
    if intervals[0].lower is None:
        # A mean without an interval may be zero up to rounding, so the digits follow the rms.
        places = decimals(statistics.rms * factor, None, None)
    else:
        places = max(
            decimals(float(m) * factor, *_limits(i, factor)) for m, i in zip(statistics.mean, intervals, strict=True)
        )
    components = zip("xyz", statistics.mean, intervals, strict=True)
    rows = [(axis, *measured_figure(float(mean), interval, factor, places)) for axis, mean, interval in components]
    return columns(("mean vector", "", _percent(statistics)), rows)


def _covariances(unit: str, factor: float, statistics: ErrorStatistics) -> list[TextLine]:
    """Return the covariances about zero and about the mean, side by side."""
    tables = []
    for name, matrix, interval in (
        ("covariance about zero", statistics.covariance, statistics.intervals.covariance),
        ("covariance about the mean", statistics.centred_covariance, statistics.intervals.centred_covariance),
    ):
        power = exponent_of_thousand(float(matrix.diagonal().max()) * factor**2)
        rows = _matrix(matrix, interval, factor**2 / 10.0**power)
        title = TextLine(f"{name}, {f'1e{power} ' if power else ''}{unit}²", "dim")
        table = columns(("", "x", "y", "z"), [(axis, *row) for axis, row in zip("xyz", rows, strict=True)])
        tables.append([title, *table])
    about_zero, about_mean = tables
    return beside(about_zero, about_mean)


def _matrix(matrix: Array, interval: MatrixInterval, factor: float) -> list[list[str]]:
    """Return the rows of a covariance matrix with the decimals of its most precise variance."""
    places = 0
    for i in range(3):
        lower = None if interval.lower is None else float(interval.lower[i, i]) * factor
        upper = None if interval.upper is None else float(interval.upper[i, i]) * factor
        places = max(places, decimals(float(matrix[i, i]) * factor, lower, upper))
    return [[fixed(float(value) * factor, places) for value in row] for row in matrix]


def _ellipsoid(factor: float, statistics: ErrorStatistics) -> list[TextLine]:
    rows = []
    for i, interval in enumerate(statistics.ellipsoid.intervals):
        # Adding zero after rounding removes the sign of "-0.00".
        direction = [f"{round(float(value), 2) + 0.0:+.2f}" for value in statistics.ellipsoid.axes[:, i]]
        rows.append((str(i + 1), *measured_figure(float(statistics.ellipsoid.sd[i]), interval, factor), *direction))
    return columns(("principal axis, standard deviation", "", _percent(statistics), "x", "y", "z"), rows)


def _tests(statistics: ErrorStatistics) -> list[TextLine]:
    tests = statistics.tests
    rows = []
    for label, test in (
        ("zero mean, Hotelling's T²", tests.zero_mean),
        ("Gaussian, Mardia's skewness", tests.skewness),
        ("Gaussian, Mardia's kurtosis", tests.kurtosis),
    ):
        if test.statistic is None or test.p_value is None:
            rows.append((label, "–", test.why or ""))
        else:
            rows.append((label, three_digits(test.statistic), p_value(test.p_value)))
    return columns(("test of an assumption", "statistic", "result"), rows)


def _interval_notes(result: EstimateResult) -> list[tuple[str, list[str]]]:
    """Return the methods of the intervals, once if position and orientation share them."""
    position = _intervals(result.position)
    orientation = position if result.orientation is None else _intervals(result.orientation)
    if orientation == position:
        return [("Confidence intervals", position)]
    return [("Confidence intervals, position", position), ("Confidence intervals, orientation", orientation)]


def _intervals(statistics: ErrorStatistics) -> list[str]:
    """Return the assumption of the intervals, their methods, and why an interval is missing."""
    methods: dict[str, list[str]] = {}
    for name, interval in (
        ("rms", statistics.intervals.rms),
        ("mean", statistics.intervals.mean_error),
        ("95th percentile", statistics.intervals.p95),
        ("95 % radius", statistics.radius95_zero_mean.interval),
        ("mean vector", statistics.intervals.mean[0]),
        ("covariance", statistics.intervals.covariance),
        ("principal axes", statistics.ellipsoid.intervals[0]),
    ):
        methods.setdefault(interval.why or interval.method, []).append(name)
    return [
        statistics.assumption,
        *(f"{', '.join(names)}: {method}" for method, names in methods.items()),
        f"maximum: {statistics.estimate('max')[1].why}",
    ]


def _worst(name: str, worst: Sequence[WorstPose]) -> list[TextLine]:
    ids = any(pose.pose is not None for pose in worst)
    targets = any(pose.target is not None for pose in worst)
    angles = any(pose.orientation is not None for pose in worst)
    headings = [*(["pose"] if ids else []), *(["target"] if targets else []), "position, mm"]
    rows = []
    for pose in worst:
        cells = [*([pose.pose or ""] if ids else []), *([pose.target or ""] if targets else [])]
        cells.append(three_digits(pose.position * IN_MM))
        if pose.orientation is not None:
            cells.append(three_digits(pose.orientation * IN_DEGREES))
        rows.append([pose.place, *cells])
    return columns([f"largest {name.lower()} errors", *headings, *(["orientation, °"] if angles else [])], rows)


def targets_table(result: EstimateResult) -> Iterator[TextLine]:
    """Return the position errors of each target."""
    rows = []
    for target in result.targets:
        figures = (target.position.rms, target.position.mean, target.position.p95, target.position.max)
        rows.append((target.name, str(target.n_poses), *(three_digits(value * IN_MM) for value in figures)))
    yield from (BLANK, heading("Position error by target, mm"))
    yield from columns(("target", "poses", "rms", "mean", "95th percentile", "maximum"), rows)


def _percent(statistics: ErrorStatistics) -> str:
    return f"{100 * statistics.confidence:g} % interval"


def measured_figure(
    value: float | None, interval: Interval, factor: float, places: int | None = None
) -> tuple[str, str]:
    """Return the value and its interval with the decimals that the interval supports."""
    if value is None:
        return "–", "–"
    lower, upper = _limits(interval, factor)
    places = decimals(value * factor, lower, upper) if places is None else places
    if lower is None and upper is None:
        return fixed(value * factor, places), "–"
    if upper is None:
        return fixed(value * factor, places), f"at least {fixed(lower, places)}"
    return fixed(value * factor, places), f"{fixed(lower, places)} … {fixed(upper, places)}"


def _limits(interval: Interval, factor: float) -> tuple[float | None, float | None]:
    lower, upper = interval.lower, interval.upper
    return None if lower is None else lower * factor, None if upper is None else upper * factor


# An estimate in about fifteen lines: the grade, the size of the errors, and the worst poses.

_MAX_WORST = 3
_MORE = "`full=True` adds covariances, tests, methods of the intervals and limitations"


def draw_short_estimate(result: EstimateResult, poses: str, robot: str | None, stream: TextIO) -> None:
    """Write the short report of ``robacc estimate`` to ``stream``; ``poses`` and ``robot`` are file names."""
    write_lines(short_lines(result, poses, robot, width_of(stream)), stream)


def short_lines(result: EstimateResult, poses: str, robot: str | None, width: int) -> Iterator[TextLine]:
    """Return the report's lines; text is wrapped to ``width`` columns."""
    yield from opening(result, poses, robot)
    yield BLANK
    yield grade_heading(result.grade)
    yield from items(_short_grade(result), width)
    yield BLANK
    yield from _short_figures(result)
    if result.targets:
        yield from targets_table(result)
    yield BLANK
    yield from wrapped(f"largest errors: {', '.join(map(_short_worst, result.worst_position[:_MAX_WORST]))}", width)
    yield TextLine(_MORE, "dim")


def _short_grade(result: EstimateResult) -> Iterator[str]:
    """Return the limits that the grade meets, and for a grade that is not confirmed what would confirm it."""
    grade = result.grade
    met, *others = grade.reason.split(". ")
    yield met
    if grade.demonstrated:
        return
    yield from others[-1:]
    if grade.poses_to_demonstrate is not None:
        yield (
            f"{grade.poses_to_demonstrate} poses in total would confirm it with a probability of {chance(ASSURANCE)}, "
            "if the estimate does not change"
        )


def _short_figures(result: EstimateResult) -> list[TextLine]:
    """Return RMS, mean, 95th percentile and maximum of position and orientation with their intervals."""
    quantities = [(result.position, IN_MM), *([(result.orientation, IN_DEGREES)] if result.orientation else [])]
    percent = f"{100 * result.position.confidence:g} % interval"
    header = ["error", "position, mm", percent, *(["orientation, °", percent] if result.orientation else [])]
    rows: list[list[str]] = []
    for label, name in (("rms", "rms"), ("mean", "mean_error"), ("95th percentile", "p95"), ("maximum", "max")):
        cells = [label]
        for statistics, factor in quantities:
            interval = (
                Interval.missing(statistics.confidence, "") if name == "max" else getattr(statistics.intervals, name)
            )
            cells += measured_figure(getattr(statistics, name), interval, factor)
        rows.append(cells)
    return [*columns(header, rows), *_unregistered(result)]


def _unregistered(result: EstimateResult) -> Sequence[TextLine]:
    if result.unaligned is None:
        return ()
    return (TextLine(f"before registration: {three_digits(result.unaligned.position.rms * IN_MM)} mm rms", "dim"),)


def _short_worst(pose: WorstPose) -> str:
    name = "" if pose.pose is None else f" (pose {pose.pose})"
    return f"{pose.place}{name} {three_digits(pose.position * IN_MM)} mm"


# Several files in one table: one line per file, in the order given.

_LEVELS = {4: "error", 5: "warning"}
"""Level of an annotation by the exit status of a gate."""


def draw_many(
    outcomes: Sequence[FileOutcome], robot: str | None, aligned: Sequence[str] | None, stream: TextIO
) -> None:
    """Write the table of all files to ``stream``; ``robot`` is a file name, ``aligned`` the effects fitted first."""
    write_lines(many_lines(outcomes, robot, aligned, width_of(stream)), stream)


def many_lines(
    outcomes: Sequence[FileOutcome], robot: str | None, aligned: Sequence[str] | None, width: int
) -> Iterator[TextLine]:
    """Return the report's lines."""
    alignment = f"registered: {' and '.join(aligned)} fitted in each" if aligned else "not registered"
    alignment = "registered where the frames do not agree" if aligned is None else alignment
    yield heading(f"Pose errors in {len(outcomes)} files, {alignment}")
    yield TextLine(f"against {'their cmd_ columns' if robot is None else f'the model {robot}'}")
    yield BLANK
    yield from _table(outcomes)
    if notes := [*_unmet_criteria(outcomes), *_failures(outcomes)]:
        yield from (BLANK, *items(notes, width))


def _unmet_criteria(outcomes: Sequence[FileOutcome]) -> Iterator[str]:
    """Return a line for each criterion that a file does not pass."""
    for outcome in outcomes:
        for evaluation in outcome.gate.evaluations if outcome.gate is not None else ():
            if evaluation.outcome != "pass":
                label = OUTCOME_LABELS[evaluation.outcome]
                yield f"{outcome.name}, {evaluation.criterion.name}: {label}; {sentence(evaluation)}"


def _failures(outcomes: Sequence[FileOutcome]) -> Iterator[str]:
    if failed := sum(outcome.failed for outcome in outcomes):
        yield f"{failed} of {len(outcomes)} files could not be estimated"


def _table(outcomes: Sequence[FileOutcome]) -> list[TextLine]:
    has_orientation = any(
        outcome.headline is not None and outcome.headline.orientation_rms is not None for outcome in outcomes
    )
    has_gate = any(outcome.gate is not None for outcome in outcomes)
    header = ["position error, mm", "poses", "rms", "95th pct.", "max", *(["rms, °"] if has_orientation else [])]
    header += ["grade", "confirmed", *(["gate"] if has_gate else [])]
    lines = columns(header, [_cells(outcome, has_orientation, has_gate) for outcome in outcomes])
    start = max(len(header[0]), *(len(outcome.name) for outcome in outcomes)) + 2
    return [
        lines[0],
        *(
            TextLine(f"{outcome.name:<{start}}{reason(outcome)}", "bold") if outcome.failed else line
            for outcome, line in zip(outcomes, lines[1:], strict=True)
        ),
    ]


def _cells(outcome: FileOutcome, has_orientation: bool, has_gate: bool) -> list[str]:
    headline = outcome.headline
    if headline is None:
        return [outcome.name]
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
        *([OUTCOME_LABELS[outcome.gate.outcome]] if outcome.gate is not None else ["–"] if has_gate else []),
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
