"""An estimate as tables to read: mm and degrees, digits that follow the uncertainty, at most 80 columns."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, TextIO

from robacc.estimation import EstimateResult, WorstPose
from robacc.figures import ErrorFigures
from robacc.geometry import Array
from robacc.report.console import draw
from robacc.report.numbers import decimals, exponent_of_thousand, fixed, p_value, three_digits
from robacc.statistics.intervals import Interval
from robacc.statistics.records import ErrorStatistics, MatrixInterval

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

_IN_MM = 1e3
_IN_DEGREES = 180.0 / math.pi
_FRAMES = {"tool": "axes of the commanded target (frame tool)", "base": "axes of the measuring frame (frame base)"}


def draw_estimate(result: EstimateResult, poses: str, robot: str | None, stream: TextIO) -> None:
    """Draw everything ``robacc estimate`` says on ``stream``; ``poses`` and ``robot`` are the files' names."""
    draw(_parts(result, poses, robot), stream)


def _parts(result: EstimateResult, poses: str, robot: str | None) -> Iterable[RenderableType]:
    plural = "s" * (result.n_poses != 1)
    yield _heading(f"Error of {result.n_poses} measured pose{plural}, {_aligned(result)}")
    yield _lines(f"{poses}, commanded by {robot if result.commanded == 'robot' else 'its cmd_ columns'}")
    yield _lines(_FRAMES[result.errors.frame])
    yield from _grade(result)
    before = None if result.unaligned is None else result.unaligned.position
    yield from _block("Position", "mm", _IN_MM, result.position, before, result.worst_position)
    if result.orientation is not None:
        before = None if result.unaligned is None else result.unaligned.orientation
        yield from _block("Orientation", "°", _IN_DEGREES, result.orientation, before, result.worst_orientation)
    if result.targets:
        yield from _targets(result)
    yield from _how(result)
    yield from _listed("To bear in mind", [result.position.structure.text, *result.notes])


def _aligned(result: EstimateResult) -> str:
    if result.alignment is None:
        return "nothing aligned"
    return f"{' and '.join(result.alignment.effects)} aligned with {result.alignment.n_parameters} parameters"


def _block(
    name: str, unit: str, factor: float, found: ErrorStatistics, before: ErrorFigures | None, worst: Sequence[WorstPose]
) -> Iterable[RenderableType]:
    """Everything about one kind of error."""
    yield _heading(f"{name} error, {unit}", gap=True)
    yield _figures(factor, found, before)
    yield _lines("")
    yield _mean(factor, found)
    yield _lines("")
    yield _covariances(unit, factor, found)
    yield _lines("")
    yield _ellipsoid(factor, found)
    yield _lines("")
    yield _tests(found)
    yield _lines("")
    yield _worst(name, worst)


def _figures(factor: float, found: ErrorStatistics, before: ErrorFigures | None) -> Table:
    """The error's length: its figures with their intervals, and the unaligned ones beside them."""
    table = _table("length", "", _percent(found), *(["unaligned"] if before else []))
    intervals = found.intervals
    rows: list[tuple[str, float | None, Interval]] = [
        ("rms", found.rms, intervals.rms),
        ("mean", found.mean_error, intervals.mean_error),
        ("95th percentile", found.p95, intervals.p95),
        ("maximum", found.max, Interval.missing(found.confidence, "")),
        ("95 % radius, Gaussian of zero mean", found.radius95_zero_mean.value, found.radius95_zero_mean.interval),
        ("95 % radius, Gaussian of own mean", found.radius95_fitted_mean.value, found.radius95_fitted_mean.interval),
    ]
    # The radii come last and have no unaligned figure.
    earlier = () if before is None else (before.rms, before.mean, before.p95, before.max)
    for (label, value, interval), unaligned in zip_longest(rows, earlier):
        cell = "" if unaligned is None else three_digits(unaligned * factor)
        table.add_row(label, *_measured(value, interval, factor), cell)
    return table


def _mean(factor: float, found: ErrorStatistics) -> Table:
    table = _table("mean vector", "", _percent(found))
    intervals = found.intervals.mean
    places = max(decimals(float(m) * factor, *_limits(i, factor)) for m, i in zip(found.mean, intervals, strict=True))
    for axis, mean, interval in zip("xyz", found.mean, intervals, strict=True):
        table.add_row(axis, *_measured(float(mean), interval, factor, places))
    return table


def _covariances(unit: str, factor: float, found: ErrorStatistics) -> Table:
    """The covariance about zero and about the mean, side by side."""
    from rich.table import Table

    grid = Table.grid(padding=(0, 6, 0, 0))
    cells = []
    for name, matrix, interval in (
        ("covariance about zero", found.covariance, found.intervals.covariance),
        ("about the mean", found.centred_covariance, found.intervals.centred_covariance),
    ):
        power = exponent_of_thousand(float(matrix.diagonal().max()) * factor**2)
        rows = _matrix(matrix, interval, factor**2 / 10.0**power)
        scale = f"1e{power} " if power else ""
        table = _table("", "x", "y", "z")
        title = f"{name}, {scale}{unit}²"
        table.title, table.title_justify, table.title_style, table.min_width = title, "left", "dim", len(title)
        for axis, row in zip("xyz", rows, strict=True):
            table.add_row(axis, *row)
        cells.append(table)
    grid.add_row(*cells)
    return grid


def _matrix(matrix: Array, interval: MatrixInterval, factor: float) -> list[list[str]]:
    """Rows of a covariance matrix, all with the decimals of its most certain variance."""
    places = 0
    for i in range(3):
        lower = None if interval.lower is None else float(interval.lower[i, i]) * factor
        upper = None if interval.upper is None else float(interval.upper[i, i]) * factor
        places = max(places, decimals(float(matrix[i, i]) * factor, lower, upper))
    return [[fixed(float(value) * factor, places) for value in row] for row in matrix]


def _ellipsoid(factor: float, found: ErrorStatistics) -> Table:
    table = _table("principal axis, standard deviation", "", _percent(found), "x", "y", "z")
    for i, interval in enumerate(found.ellipsoid.intervals):
        direction = [f"{float(value):+.2f}" for value in found.ellipsoid.axes[:, i]]
        table.add_row(str(i + 1), *_measured(float(found.ellipsoid.sd[i]), interval, factor), *direction)
    return table


def _tests(found: ErrorStatistics) -> Table:
    table = _table("assumption, and the test of it", "", "")
    tests = found.tests
    for label, test in (
        ("the mean is zero, Hotelling's T²", tests.zero_mean),
        ("Gaussian, Mardia's skewness", tests.skewness),
        ("Gaussian, Mardia's kurtosis", tests.kurtosis),
    ):
        if test.statistic is None or test.p_value is None:
            table.add_row(label, "–", test.why or "")
        else:
            table.add_row(label, three_digits(test.statistic), p_value(test.p_value))
    return table


def _how(result: EstimateResult) -> Iterable[RenderableType]:
    """How the intervals were made: once, where position and orientation were treated alike."""
    position = _intervals(result.position)
    orientation = position if result.orientation is None else _intervals(result.orientation)
    if orientation == position:
        yield from _listed("Intervals", position)
    else:
        yield from _listed("Intervals of the position", position)
        yield from _listed("Intervals of the orientation", orientation)


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


def _worst(name: str, worst: Sequence[WorstPose]) -> Table:
    ids = any(pose.pose is not None for pose in worst)
    targets = any(pose.target is not None for pose in worst)
    angles = any(pose.orientation is not None for pose in worst)
    headings = [*(["pose"] if ids else []), *(["target"] if targets else []), "position, mm"]
    table = _table(f"largest {name.lower()} errors", *headings, *(["orientation, °"] if angles else []))
    for pose in worst:
        cells = [*([pose.pose or ""] if ids else []), *([pose.target or ""] if targets else [])]
        cells.append(three_digits(pose.position * _IN_MM))
        if pose.orientation is not None:
            cells.append(three_digits(pose.orientation * _IN_DEGREES))
        table.add_row(f"line {pose.line}", *cells)
    return table


def _targets(result: EstimateResult) -> Iterable[RenderableType]:
    yield _heading("Position error by target, mm", gap=True)
    table = _table("target", "poses", "rms", "mean", "95th percentile", "maximum")
    for target in result.targets:
        figures = (target.position.rms, target.position.mean, target.position.p95, target.position.max)
        table.add_row(target.name, str(target.n_poses), *(three_digits(value * _IN_MM) for value in figures))
    yield table


def _grade(result: EstimateResult) -> Iterable[RenderableType]:
    grade = result.grade
    proven = "demonstrated" if grade.demonstrated else "not demonstrated"
    yield _heading(f"Grade {grade.grade}, {proven} (scale: {grade.scale.name})", gap=True)
    yield _items(grade.reason.split(". "))


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


def _table(*columns: str) -> Table:
    """A table without lines: its first column reads from the left, figures stand at the right of theirs."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for i, column in enumerate(columns):
        table.add_column(column, justify="right" if i else "left")
    return table


def _heading(text: str, *, gap: bool = False) -> RenderableType:
    from rich.text import Text

    return Text.assemble("\n" * gap, (text, "bold"))


def _lines(text: str) -> RenderableType:
    from rich.text import Text

    return Text(text)


def _listed(title: str, items: Iterable[str]) -> Iterable[RenderableType]:
    yield _heading(title, gap=True)
    yield _items(items)


def _items(items: Iterable[str]) -> RenderableType:
    """Each item with a dash, its further lines set in."""
    from rich.table import Table
    from rich.text import Text

    grid = Table.grid(padding=(0, 1, 0, 0))
    for item in items:
        grid.add_row("-", Text(item))
    return grid
