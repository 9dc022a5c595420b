"""A prediction as tables in mm and degrees, and its comparison with measured poses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TextIO

from robacc.prediction.comparison import ChiSquare, MeasuredComparison, ScaleTest
from robacc.prediction.components import VarianceComponents
from robacc.prediction.model_uncertainty import Coverage
from robacc.prediction.predicting import Allocation, PredictedErrors, Prediction, Share
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import (
    BLANK,
    TextLine,
    columns,
    heading,
    items,
    p_value,
    table_unit,
    three_digits,
    with_table_unit,
    wrapped,
)
from robacc.robots.description import Robot

# Units and bars of the tables of a prediction.


def amount(value: float, unit: str) -> str:
    """Return a value in mm or degrees, three digits."""
    return three_digits(value * table_unit(unit)[0])


def with_unit(value: float, unit: str) -> str:
    """Return a value in mm or degrees with its unit."""
    return with_table_unit(amount(value, unit), table_unit(unit)[1])


def percent(share: float) -> str:
    """Return a share in percent, one decimal."""
    return f"{100 * share:.1f} %"


def bar(share: float, largest: float, width: int) -> str:
    """Return a bar padded to ``width`` columns; the ``largest`` share of the table fills them."""
    return ("█" * (round(width * share / largest) if largest > 0 else 0)).ljust(width)


# The comparison of predicted and measured errors as text.

_NOISE_SOURCES = {"file": "from the file", "given": "given by the user", "fit": "that of the fit"}
_SOURCES = {"file": "from the file", "given": "given by the user", "estimated": "estimated from the poses"}


def comparison_lines(comparison: MeasuredComparison, width: int) -> Iterator[TextLine]:
    """Return the lines about the measured poses; running text is wrapped to ``width`` columns."""
    yield from (BLANK, heading(f"Compared with {comparison.n_poses} measured poses of {comparison.source}"))
    yield from wrapped(comparison.consistency.verdict, width)
    yield from (BLANK, *_errors(comparison))
    yield from (BLANK, *_tests(comparison))
    if comparison.consistency.scale is not None:
        yield from (BLANK, *wrapped(_scale(comparison.consistency.scale), width))
    if comparison.components is not None:
        yield from _components(comparison.components, width)
    yield from (BLANK, heading("Limits of data from one robot"))
    yield from wrapped(comparison.one_draw, width)


def _errors(comparison: MeasuredComparison) -> list[TextLine]:
    noise, alignment = comparison.statistics.noise, comparison.alignment
    registered = "not registered" if alignment is None else f"registered: {' and '.join(alignment.effects)} fitted"
    quantities = [("position", comparison.position_rms, noise.position, noise.source_position, "m")]
    if comparison.orientation_rms is not None and noise.orientation is not None:
        source = noise.source_orientation or "file"
        quantities.append(("orientation", comparison.orientation_rms, noise.orientation, source, "rad"))
    rows = [
        (name, with_unit(rms, unit), with_unit(sigma, unit), _SOURCES[source])
        for name, rms, sigma, source, unit in quantities
    ]
    return [TextLine(f"measured, {registered}"), *columns(("", "rms error", "noise per axis (sd)", ""), rows)]


def _tests(comparison: MeasuredComparison) -> list[TextLine]:
    consistency = comparison.consistency
    rows = [
        (label, three_digits(test.statistic), _interval(test), p_value(test.p_value))
        for label, test in (
            ("directions affected by parameters", consistency.parameters),
            ("other directions: measurement noise", consistency.noise),
            ("total", consistency.total),
        )
        if test is not None
    ]
    return columns(("normalised squared error", "measured", "expected, 95 %", ""), rows)


def _interval(test: ChiSquare) -> str:
    return f"{three_digits(test.lower)} … {three_digits(test.upper)}"


def _scale(test: ScaleTest) -> str:
    return (
        f"Likelihood ratio of the predicted covariance against the best scaled one (all tolerances times "
        f"{three_digits(test.factor)}): {three_digits(test.statistic)}, {p_value(test.p_value)}, from "
        f"{test.draws} simulated data sets."
    )


def _components(components: VarianceComponents, width: int) -> Iterator[TextLine]:
    yield from (BLANK, heading("Variance components (one standard deviation)"))
    rows = []
    for component in components.components:
        factor, unit = table_unit(component.unit)
        size = component.predicted * factor
        estimate, interval, ratio = "–", "–", "–"
        if component.why is None:
            upper = "∞" if component.upper is None else three_digits(component.upper * size)
            estimate, ratio = three_digits(component.estimate * factor), three_digits(component.factor)
            interval = f"{three_digits(component.lower * size)} … {upper}"
        rows.append((component.name, unit, three_digits(size), estimate, interval, ratio, f"{component.dof:.1f}"))
    header = ("kind", "", "predicted", "estimated", f"{100 * components.confidence:g} % interval", "ratio", "dof")
    yield from columns(header, rows)
    dof = "dof: effective number of independent parameter errors in the estimate"
    yield from items((dof, *components.notes), width)


def coverage_lines(coverage: Sequence[Coverage], width: int) -> Iterator[TextLine]:
    """Return the lines on measured poses within the bounds of a model."""
    first = coverage[0]
    bound = f"{100 * first.probability:g} % bound"
    yield from (BLANK, heading(f"Measured poses within the {bound} of their error"))
    rows = [(item.quantity, f"{item.n_inside} of {item.n_poses}", percent(item.share)) for item in coverage]
    yield from columns(("", "poses", "share"), rows)
    sources = " and ".join(dict.fromkeys(_NOISE_SOURCES[item.noise_source] for item in coverage))
    texts = [f"the bound contains the measurement noise, {sources}"]
    if first.registered:
        texts.append(f"{' and '.join(first.registered)} fitted to one half of the poses for the errors of the other")
    yield from items(texts, width)


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
