"""Predicted against measured, as text."""

from __future__ import annotations

from collections.abc import Iterator

from robacc.prediction.comparison import MeasuredComparison
from robacc.prediction.components import Components
from robacc.prediction.consistency import ChiSquare, ScaleTest
from robacc.render.text.layout import BLANK, TextLine, columns, heading, items, wrapped
from robacc.render.text.numbers import p_value, three_digits
from robacc.render.text.predict_parts import FACTORS, with_unit

_SOURCES = {"file": "from the file", "given": "given", "estimated": "estimated from the poses"}


def comparison_lines(comparison: MeasuredComparison, width: int) -> Iterator[TextLine]:
    """Everything about the measured poses; running text is wrapped to ``width`` columns."""
    yield from (BLANK, heading(f"Against {comparison.n_poses} measured poses of {comparison.source}"))
    yield from wrapped(comparison.consistency.verdict, width)
    yield from (BLANK, *_errors(comparison))
    yield from (BLANK, *_tests(comparison))
    if comparison.consistency.scale is not None:
        yield from (BLANK, *wrapped(_scale(comparison.consistency.scale), width))
    if comparison.components is not None:
        yield from _components(comparison.components, width)
    yield from (BLANK, heading("One robot is one draw"))
    yield from wrapped(comparison.one_draw, width)


def _errors(comparison: MeasuredComparison) -> list[TextLine]:
    noise, alignment = comparison.evidence.noise, comparison.alignment
    aligned = "nothing aligned" if alignment is None else f"{' and '.join(alignment.effects)} aligned"
    found = [("position", comparison.position_rms, noise.position, noise.source_position, "m")]
    if comparison.orientation_rms is not None and noise.orientation is not None:
        source = noise.source_orientation or "file"
        found.append(("orientation", comparison.orientation_rms, noise.orientation, source, "rad"))
    rows = [
        (name, with_unit(rms, unit), with_unit(sigma, unit), _SOURCES[source])
        for name, rms, sigma, source, unit in found
    ]
    return [TextLine(f"measured, {aligned}"), *columns(("", "RMS error", "noise along an axis", ""), rows)]


def _tests(comparison: MeasuredComparison) -> list[TextLine]:
    found = comparison.consistency
    rows = [
        (label, three_digits(test.statistic), _interval(test), p_value(test.p_value))
        for label, test in (
            ("directions that parameters move", found.parameters),
            ("all others: measuring noise", found.noise),
            ("all together", found.total),
        )
        if test is not None
    ]
    return columns(("normalised squared error", "found", "expected, 95 %", ""), rows)


def _interval(test: ChiSquare) -> str:
    return f"{three_digits(test.lower)} … {three_digits(test.upper)}"


def _scale(test: ScaleTest) -> str:
    return (
        f"Likelihood ratio of the predicted covariance against the same one scaled to fit (all tolerances "
        f"{three_digits(test.factor)} times): {three_digits(test.statistic)}, {p_value(test.p_value)}, from "
        f"{test.draws} sets drawn from the prediction."
    )


def _components(found: Components, width: int) -> Iterator[TextLine]:
    yield from (BLANK, heading("Variance components (one standard deviation)"))
    rows = []
    for component in found.components:
        factor, unit = FACTORS[component.unit]
        size = component.predicted * factor
        estimate, interval, ratio = "–", "–", "–"
        if component.why is None:
            upper = "∞" if component.upper is None else three_digits(component.upper * size)
            estimate, ratio = three_digits(component.estimate * factor), three_digits(component.factor)
            interval = f"{three_digits(component.lower * size)} … {upper}"
        rows.append((component.name, unit, three_digits(size), estimate, interval, ratio, f"{component.dof:.1f}"))
    header = ("kind", "", "predicted", "estimated", f"{100 * found.confidence:g} % interval", "ratio", "worth")
    yield from columns(header, rows)
    worth = "worth: how many independent parameters' errors the estimate rests on"
    yield from items((worth, *found.notes), width)
