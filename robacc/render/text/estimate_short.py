"""An estimate in about fifteen lines: the grade, the size of the errors, and the worst poses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TextIO

from robacc.accuracy.estimation import EstimateResult, WorstPose
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.estimate import grade_heading, measured_figure, opening, targets_table
from robacc.render.text.layout import BLANK, TextLine, columns, items, wrapped
from robacc.render.text.numbers import chance, three_digits
from robacc.render.text.units import IN_DEGREES, IN_MM
from robacc.statistics.confidence_curves import ASSURANCE
from robacc.statistics.intervals import Interval

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
    yield from items(_grade(result), width)
    yield BLANK
    yield from _figures(result)
    if result.targets:
        yield from targets_table(result)
    yield BLANK
    yield from wrapped(f"largest errors: {', '.join(map(_worst, result.worst_position[:_MAX_WORST]))}", width)
    yield TextLine(_MORE, "dim")


def _grade(result: EstimateResult) -> Iterator[str]:
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


def _figures(result: EstimateResult) -> list[TextLine]:
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


def _worst(pose: WorstPose) -> str:
    name = "" if pose.pose is None else f" (pose {pose.pose})"
    return f"{pose.place}{name} {three_digits(pose.position * IN_MM)} mm"
