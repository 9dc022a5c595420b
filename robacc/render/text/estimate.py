"""An estimate as tables in mm and degrees: digits follow the uncertainty, at most 80 columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, TextIO

from robacc.accuracy.estimation import EstimateResult, WorstPose
from robacc.accuracy.grade import Grade
from robacc.geometry import Array
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import BLANK, TextLine, beside, columns, heading, items
from robacc.render.text.numbers import (
    chance,
    confirmation,
    decimals,
    exponent_of_thousand,
    fixed,
    p_value,
    three_digits,
)
from robacc.render.text.units import IN_DEGREES, IN_MM
from robacc.statistics.confidence_curves import ASSURANCE
from robacc.statistics.intervals import Interval
from robacc.statistics.records import ErrorStatistics, MatrixInterval

if TYPE_CHECKING:
    from robacc.accuracy.metrics import ErrorMetrics

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
    yield from _grade(result, width)
    before = result.unaligned
    earlier = None if before is None else before.position
    yield from _block("Position", "mm", IN_MM, result.position, earlier, result.worst_position)
    if result.orientation is not None:
        earlier = None if before is None else before.orientation
        yield from _block("Orientation", "°", IN_DEGREES, result.orientation, earlier, result.worst_orientation)
    if result.targets:
        yield from targets_table(result)
    for title, texts in _interval_notes(result):
        yield from (BLANK, heading(title), *items(texts, width))
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


def _grade(result: EstimateResult, width: int) -> Iterator[TextLine]:
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
