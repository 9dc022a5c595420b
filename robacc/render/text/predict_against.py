"""The comparison of predicted and measured errors as text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from robacc.prediction.comparison import MeasuredComparison
from robacc.prediction.components import VarianceComponents
from robacc.prediction.consistency import ChiSquare, ScaleTest
from robacc.prediction.coverage import Coverage
from robacc.render.text.layout import BLANK, TextLine, columns, heading, items, wrapped
from robacc.render.text.numbers import p_value, three_digits
from robacc.render.text.predict_parts import percent, with_unit
from robacc.render.text.units import table_unit

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
