"""An estimate as tables to read: mm and degrees, digits that follow the uncertainty, at most 80 columns."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, TextIO

from robacc.accuracy.estimation import EstimateResult, WorstPose
from robacc.accuracy.grade import Grade
from robacc.geometry import Array
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import BLANK, TextLine, beside, columns, heading, items
from robacc.render.text.numbers import chance, decimals, exponent_of_thousand, fixed, p_value, three_digits
from robacc.statistics.confidence import ASSURANCE
from robacc.statistics.intervals import Interval
from robacc.statistics.records import ErrorStatistics, MatrixInterval

if TYPE_CHECKING:
    from robacc.accuracy.figures import ErrorMetrics

_IN_MM = 1e3
_IN_DEGREES = 180.0 / math.pi
_UNLIKELY = 0.005
"""Grades less likely are not listed."""
_FRAMES = {"tool": "axes of the commanded target (frame tool)", "base": "axes of the measuring frame (frame base)"}


def draw_estimate(result: EstimateResult, poses: str, robot: str | None, stream: TextIO) -> None:
    """Write everything ``robacc estimate`` says to ``stream``; ``poses`` and ``robot`` are the files' names."""
    write_lines(estimate_lines(result, poses, robot, width_of(stream)), stream)


def estimate_lines(result: EstimateResult, poses: str, robot: str | None, width: int) -> Iterator[TextLine]:
    """The report's lines; running text is wrapped to ``width`` columns, tables take at most 80."""
    plural = "s" * (result.n_poses != 1)
    yield heading(f"Error of {result.n_poses} measured pose{plural}, {_aligned(result)}")
    source = "standard input" if poses == "-" else poses
    yield TextLine(f"{source}, commanded by {robot if result.commanded == 'robot' else 'its cmd_ columns'}")
    yield TextLine(_FRAMES[result.errors.frame])
    yield BLANK
    yield from _grade(result, width)
    before = result.unaligned
    earlier = None if before is None else before.position
    yield from _block("Position", "mm", _IN_MM, result.position, earlier, result.worst_position)
    if result.orientation is not None:
        earlier = None if before is None else before.orientation
        yield from _block("Orientation", "°", _IN_DEGREES, result.orientation, earlier, result.worst_orientation)
    if result.targets:
        yield from _targets(result)
    for title, texts in _how(result):
        yield from (BLANK, heading(title), *items(texts, width))
    yield from (BLANK, heading("To bear in mind"))
    yield from items([result.position.structure.text, *result.notes], width)


def _aligned(result: EstimateResult) -> str:
    if result.alignment is None:
        return "nothing aligned"
    return f"{' and '.join(result.alignment.effects)} aligned with {result.alignment.n_parameters} parameters"


def _grade(result: EstimateResult, width: int) -> Iterator[TextLine]:
    grade = result.grade
    proven = "demonstrated" if grade.demonstrated else "not demonstrated"
    yield heading(f"Grade {grade.grade}, {proven} (scale: {grade.scale.name})")
    yield from items([*grade.reason.split(". "), *_odds(grade)], width)


def _odds(grade: Grade) -> Iterator[str]:
    """How sure the grade is, and what would make it surer."""
    if grade.probability is not None:
        # What rounds to nothing is left out; the grade itself never is.
        others = [(name, share) for name, share in grade.probabilities if share >= _UNLIKELY or name == grade.grade]
        shares = ", ".join(f"{name} {chance(share)}" for name, share in others)
        yield f"probability of each grade, given these poses: {shares}"
    if grade.poses_to_demonstrate is not None:
        yield (
            f"if the estimate stays as it is, {grade.poses_to_demonstrate} poses in all would demonstrate "
            f"{grade.grade} with a probability of {chance(ASSURANCE)}"
        )


def _block(
    name: str, unit: str, factor: float, found: ErrorStatistics, before: ErrorMetrics | None, worst: Sequence[WorstPose]
) -> Iterator[TextLine]:
    """Everything about one kind of error."""
    yield from (BLANK, heading(f"{name} error, {unit}"))
    yield from _figures(factor, found, before)
    for part in (
        _mean(factor, found),
        _covariances(unit, factor, found),
        _ellipsoid(factor, found),
        _tests(found),
        _worst(name, worst),
    ):
        yield from (BLANK, *part)


def _figures(factor: float, found: ErrorStatistics, before: ErrorMetrics | None) -> list[TextLine]:
    """The error's length: its figures with their intervals, and the unaligned ones beside them."""
    intervals = found.intervals
    figures: list[tuple[str, float | None, Interval]] = [
        ("rms", found.rms, intervals.rms),
        ("mean", found.mean_error, intervals.mean_error),
        ("95th percentile", found.p95, intervals.p95),
        ("maximum", found.max, Interval.missing(found.confidence, "")),
        ("95 % radius, Gaussian of zero mean", found.radius95_zero_mean.value, found.radius95_zero_mean.interval),
        ("95 % radius, Gaussian of own mean", found.radius95_fitted_mean.value, found.radius95_fitted_mean.interval),
    ]
    rows = [(label, *_measured(value, interval, factor)) for label, value, interval in figures]
    if before is None:
        return columns(("length", "", _percent(found)), rows)
    # The radii come last and have no unaligned figure.
    earlier = [three_digits(value * factor) for value in (before.rms, before.mean, before.p95, before.max)]
    both = [(*row, cell) for row, cell in zip_longest(rows, earlier, fillvalue="")]
    return columns(("length", "", _percent(found), "unaligned"), both)


def _mean(factor: float, found: ErrorStatistics) -> list[TextLine]:
    intervals = found.intervals.mean
    if intervals[0].lower is None:
        # A mean that an alignment made zero is rounding: its own digits say nothing, those of the rms do.
        places = decimals(found.rms * factor, None, None)
    else:
        places = max(
            decimals(float(m) * factor, *_limits(i, factor)) for m, i in zip(found.mean, intervals, strict=True)
        )
    components = zip("xyz", found.mean, intervals, strict=True)
    rows = [(axis, *_measured(float(mean), interval, factor, places)) for axis, mean, interval in components]
    return columns(("mean vector", "", _percent(found)), rows)


def _covariances(unit: str, factor: float, found: ErrorStatistics) -> list[TextLine]:
    """The covariance about zero and about the mean, side by side."""
    tables = []
    for name, matrix, interval in (
        ("covariance about zero", found.covariance, found.intervals.covariance),
        ("covariance about the mean", found.centred_covariance, found.intervals.centred_covariance),
    ):
        power = exponent_of_thousand(float(matrix.diagonal().max()) * factor**2)
        rows = _matrix(matrix, interval, factor**2 / 10.0**power)
        title = TextLine(f"{name}, {f'1e{power} ' if power else ''}{unit}²", "dim")
        table = columns(("", "x", "y", "z"), [(axis, *row) for axis, row in zip("xyz", rows, strict=True)])
        tables.append([title, *table])
    about_zero, about_mean = tables
    return beside(about_zero, about_mean)


def _matrix(matrix: Array, interval: MatrixInterval, factor: float) -> list[list[str]]:
    """Rows of a covariance matrix, all with the decimals of its most certain variance."""
    places = 0
    for i in range(3):
        lower = None if interval.lower is None else float(interval.lower[i, i]) * factor
        upper = None if interval.upper is None else float(interval.upper[i, i]) * factor
        places = max(places, decimals(float(matrix[i, i]) * factor, lower, upper))
    return [[fixed(float(value) * factor, places) for value in row] for row in matrix]


def _ellipsoid(factor: float, found: ErrorStatistics) -> list[TextLine]:
    rows = []
    for i, interval in enumerate(found.ellipsoid.intervals):
        # Adding zero after rounding takes the sign off "-0.00".
        direction = [f"{round(float(value), 2) + 0.0:+.2f}" for value in found.ellipsoid.axes[:, i]]
        rows.append((str(i + 1), *_measured(float(found.ellipsoid.sd[i]), interval, factor), *direction))
    return columns(("principal axis, standard deviation", "", _percent(found), "x", "y", "z"), rows)


def _tests(found: ErrorStatistics) -> list[TextLine]:
    tests = found.tests
    rows = []
    for label, test in (
        ("the mean is zero, Hotelling's T²", tests.zero_mean),
        ("Gaussian, Mardia's skewness", tests.skewness),
        ("Gaussian, Mardia's kurtosis", tests.kurtosis),
    ):
        if test.statistic is None or test.p_value is None:
            rows.append((label, "–", test.why or ""))
        else:
            rows.append((label, three_digits(test.statistic), p_value(test.p_value)))
    return columns(("assumption, and the test of it", "", ""), rows)


def _how(result: EstimateResult) -> list[tuple[str, list[str]]]:
    """How the intervals were made: once, where position and orientation were treated alike."""
    position = _intervals(result.position)
    orientation = position if result.orientation is None else _intervals(result.orientation)
    if orientation == position:
        return [("Intervals", position)]
    return [("Intervals of the position", position), ("Intervals of the orientation", orientation)]


def _intervals(found: ErrorStatistics) -> list[str]:
    """What the intervals assume, which figure's was made how, and why one is missing."""
    methods: dict[str, list[str]] = {}
    for name, how in (
        ("rms", found.intervals.rms),
        ("mean", found.intervals.mean_error),
        ("95th percentile", found.intervals.p95),
        ("95 % radius", found.radius95_zero_mean.interval),
        ("mean vector", found.intervals.mean[0]),
        ("covariance", found.intervals.covariance),
        ("principal axes", found.ellipsoid.intervals[0]),
    ):
        methods.setdefault(how.why or how.method, []).append(name)
    return [
        found.assumption,
        *(f"{', '.join(names)}: {method}" for method, names in methods.items()),
        f"maximum: {found.estimate('max')[1].why}",
    ]


def _worst(name: str, worst: Sequence[WorstPose]) -> list[TextLine]:
    ids = any(pose.pose is not None for pose in worst)
    targets = any(pose.target is not None for pose in worst)
    angles = any(pose.orientation is not None for pose in worst)
    headings = [*(["pose"] if ids else []), *(["target"] if targets else []), "position, mm"]
    rows = []
    for pose in worst:
        cells = [*([pose.pose or ""] if ids else []), *([pose.target or ""] if targets else [])]
        cells.append(three_digits(pose.position * _IN_MM))
        if pose.orientation is not None:
            cells.append(three_digits(pose.orientation * _IN_DEGREES))
        rows.append([pose.place, *cells])
    return columns([f"largest {name.lower()} errors", *headings, *(["orientation, °"] if angles else [])], rows)


def _targets(result: EstimateResult) -> Iterator[TextLine]:
    rows = []
    for target in result.targets:
        figures = (target.position.rms, target.position.mean, target.position.p95, target.position.max)
        rows.append((target.name, str(target.n_poses), *(three_digits(value * _IN_MM) for value in figures)))
    yield from (BLANK, heading("Position error by target, mm"))
    yield from columns(("target", "poses", "rms", "mean", "95th percentile", "maximum"), rows)


def _percent(found: ErrorStatistics) -> str:
    return f"{100 * found.confidence:g} % interval"


def _measured(value: float | None, interval: Interval, factor: float, places: int | None = None) -> tuple[str, str]:
    """The value and its interval, with the decimals that the interval leaves meaning to."""
    if value is None:
        return "–", "–"
    lower, upper = _limits(interval, factor)
    places = decimals(value * factor, lower, upper) if places is None else places
    if lower is None and upper is None:
        return fixed(value * factor, places), "–"
    return fixed(value * factor, places), f"{fixed(lower, places)} … {fixed(upper, places)}"


def _limits(interval: Interval, factor: float) -> tuple[float | None, float | None]:
    lower, upper = interval.lower, interval.upper
    return None if lower is None else lower * factor, None if upper is None else upper * factor
