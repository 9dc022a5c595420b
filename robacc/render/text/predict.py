"""A prediction as tables in mm and degrees, at most 80 columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TextIO

from robacc.prediction.allocation import Allocation
from robacc.prediction.comparison import MeasuredComparison
from robacc.prediction.coverage import Coverage
from robacc.prediction.predicting import PredictedErrors, Prediction, Share
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import BLANK, TextLine, columns, heading, items, wrapped
from robacc.render.text.predict_against import comparison_lines, coverage_lines
from robacc.render.text.predict_parts import amount, bar, percent, with_unit
from robacc.render.text.units import table_unit, with_table_unit
from robacc.robots.description import Robot

_LISTED = 12
"""Parameters of the budget in the table; the JSON result has all of them."""
_BAR = 14
_UNCHANGED = 0.9995
"""Smallest factor that rounds to one with three decimals."""
_STATISTICS = {
    "rms": "rms error",
    "mean_error": "mean error",
    "p95": "95 % of errors within",
    "max": "largest 95 % radius of any pose",
}


def draw_prediction(
    robot: Robot,
    prediction: Prediction,
    allocation: Allocation | None,
    comparison: MeasuredComparison | None,
    coverage: Sequence[Coverage],
    stream: TextIO,
) -> None:
    """Write the report of ``robacc predict`` to ``stream``."""
    write_lines(prediction_lines(robot, prediction, allocation, comparison, coverage, width_of(stream)), stream)


def prediction_lines(
    robot: Robot,
    prediction: Prediction,
    allocation: Allocation | None,
    comparison: MeasuredComparison | None,
    coverage: Sequence[Coverage],
    width: int,
) -> Iterator[TextLine]:
    """Return the report's lines; text is wrapped to ``width`` columns, tables take at most 80."""
    source = f"{len(prediction.parameters)} tolerances" if prediction.parameters else "the fit of its model"
    yield heading(f"Expected accuracy of {robot.name}, from {source}")
    yield TextLine(f"at {prediction.configurations.source}")
    yield from wrapped(prediction.meaning, width)
    yield from (BLANK, *_grade(prediction, width))
    yield from (BLANK, heading("Predicted error"))
    yield from _figures(prediction)
    yield from (BLANK, *_over_poses(prediction))
    yield from (BLANK, heading("Worst pose"))
    for name, errors in (("position", prediction.position), ("orientation", prediction.orientation)):
        yield from _worst(robot, errors, name, width)
    yield from (BLANK, heading("Error budget: share of the variance (parameters sorted by both shares)"))
    # Scatter that the fit did not separate and poses within its ranges have no share of their own.
    present = [
        share for share in prediction.budget if share.tolerance is not None or share.position + share.orientation
    ]
    budget = sorted(present, key=lambda share: -round(share.position + share.orientation, 9))
    yield from _budget("parameter" if prediction.parameters else "source", budget[:_LISTED])
    if len(budget) > _LISTED:
        unlisted = budget[_LISTED:]
        shares = (percent(sum(getattr(share, name) for share in unlisted)) for name in ("position", "orientation"))
        yield TextLine("{} more parameters: {} of position, {} of orientation".format(len(unlisted), *shares))
    for label, parts in (("joint", prediction.by_joint), ("kind", prediction.by_kind)):
        if parts:
            yield from (BLANK, *_budget(label, parts))
    if allocation is not None:
        yield from _allocation(prediction, allocation, width)
    if comparison is not None:
        yield from comparison_lines(comparison, width)
    if coverage:
        yield from coverage_lines(coverage, width)
    if prediction.notes:
        yield from (BLANK, heading("Limitations"))
        yield from items(prediction.notes, width)


def _grade(prediction: Prediction, width: int) -> Iterator[TextLine]:
    grade = prediction.grade
    yield heading(f"Grade {grade.grade} predicted (scale: {grade.scale.name})")
    text = f"criterion: {_STATISTICS[grade.scale.statistic]}, over robots and poses"
    if grade.limited_by:
        text += f"; limited by {' and '.join(grade.limited_by)}"
    shares = ", ".join(f"{name} {percent(share)}" for name, share in grade.meeting)
    yield from items((text, f"share of poses that meet each grade individually: {shares}"), width)


def _figures(prediction: Prediction) -> list[TextLine]:
    quantities = (prediction.position, prediction.orientation)
    rows = [
        (label, *(amount(getattr(errors, name), errors.unit) for errors in quantities))
        for label, name in (("rms", "rms"), ("mean", "mean_error"), ("95 % of errors within", "p95"))
    ]
    return columns(("over robots and poses", "mm", "°"), rows)


def _over_poses(prediction: Prediction) -> list[TextLine]:
    quantities = (prediction.position, prediction.orientation)
    percentiles = [errors.percentiles() for errors in quantities]
    rows = [
        (
            str(p),
            *(
                amount(value, errors.unit)
                for errors, by_percentile in zip(quantities, percentiles, strict=True)
                for value in by_percentile[p]
            ),
        )
        for p in percentiles[0]
    ]
    largest = [amount(value, errors.unit) for errors in quantities for value in (errors.worst.rms, errors.max)]
    header = ("percentile over poses", "rms, mm", "95 % within, mm", "rms, °", "95 % within, °")
    return columns(header, [*rows, ("largest", *largest)])


def _worst(robot: Robot, errors: PredictedErrors, name: str, width: int) -> list[TextLine]:
    worst = errors.worst
    direction = " ".join(f"{float(value):+.2f}" for value in worst.direction)
    joints = []
    for joint, value in zip(robot.variables, worst.q, strict=True):
        factor, symbol = table_unit("m" if joint.type == "prismatic" else "rad")
        joints.append(f"{joint.name}={with_table_unit(f'{float(value) * factor:.1f}', symbol)}")
    text = (
        f"{name}: {worst.label}, rms {with_unit(worst.rms, errors.unit)}, 95 % within "
        f"{with_unit(worst.radius95, errors.unit)}, largest along ({direction}) of the tool (standard deviation "
        f"{with_unit(worst.sd, errors.unit)}), at {', '.join(joints)}"
    )
    return items((text,), width)


def _budget(label: str, shares: Sequence[Share]) -> list[TextLine]:
    names = ("position", "orientation")
    largest = {name: max((getattr(share, name) for share in shares), default=0.0) for name in names}
    # The bars share the columns that names, tolerances and percentages leave of 80.
    longest = max((len(share.name) for share in shares), default=0)
    width = max(2, min(_BAR, (44 - longest) // 2)) if label == "parameter" else _BAR
    rows = []
    for share in shares:
        tolerance = [] if share.tolerance is None or share.unit is None else [with_unit(share.tolerance, share.unit)]
        cells = []
        for name in names:
            value = getattr(share, name)
            cells += [percent(value), bar(value, largest[name], width)]
        rows.append((share.name, *tolerance, *cells))
    return columns((label, *(["1 sd"] if label == "parameter" else []), "position", "", "orientation", ""), rows)


def _allocation(prediction: Prediction, allocation: Allocation, width: int) -> Iterator[TextLine]:
    yield from (BLANK, heading(f"Tolerances for grade {allocation.grade}"))
    if all(item.factor == 1.0 for item in allocation.needed):
        yield TextLine("the given tolerances already reach this grade")
        return
    rows = [
        (
            item.parameter.name,
            with_unit(item.parameter.sd, item.parameter.unit),
            with_unit(item.needed, item.parameter.unit),
            f"{item.factor:.3f}",
        )
        for item in sorted(allocation.needed, key=lambda item: round(item.factor, 9))
        if item.factor < _UNCHANGED
    ]
    yield from columns(("parameter", "given (1 sd)", "needed (1 sd)", "factor"), rows)
    yield TextLine(f"the other {len(allocation.needed) - len(rows)} tolerances need no change")
    statistic, verified = prediction.grade.scale.statistic, allocation.verified
    achieved = ", ".join(
        with_unit(errors.value(statistic), errors.unit) for errors in (verified.position, verified.orientation)
    )
    outcome = "meets the grade" if allocation.met else "does not meet the grade"
    yield from wrapped(
        f"A new prediction with these tolerances {outcome}: {_STATISTICS[statistic]} {achieved}. The allocation "
        f"minimises the cost, taken as 1/tolerance. With one factor for all tolerances, this factor is "
        f"{allocation.uniform_factor:.3f}.",
        width,
    )
