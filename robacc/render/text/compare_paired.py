"""Targets before and after a correction as a table in mm."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TextIO

from robacc.accuracy.metrics import ErrorMetrics
from robacc.comparison.paired_targets import PairedTargets
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import BLANK, TextLine, columns, heading, items
from robacc.render.text.numbers import p_value, three_digits
from robacc.render.text.units import IN_MM

_VERDICTS = {
    "loaded": "the correction was loaded",
    "partly loaded": "only a part of the correction was loaded",
    "not loaded": "no sign that the correction was loaded",
    "undecided": "the measurements do not decide whether the correction was loaded",
}


def draw_paired_targets(result: PairedTargets, names: tuple[str, str], stream: TextIO) -> None:
    """Write the comparison of the files ``names`` to ``stream``."""
    write_lines(paired_lines(result, names, width_of(stream)), stream)


def paired_lines(result: PairedTargets, names: tuple[str, str], width: int) -> Iterator[TextLine]:
    """Return the report's lines, wrapped to ``width`` columns."""
    yield heading(f"{len(result.names)} targets before ({names[0]}) and after ({names[1]}) a correction")
    rows = [_row("before", result.metrics_before), _row("after", result.metrics_after)]
    yield from (BLANK, *columns(("error, mm", "rms", "mean", "95th pct.", "largest"), rows), BLANK)
    gain = result.gain
    low, high = (three_digits(bound * IN_MM) for bound in (gain.low, gain.high))
    texts = [f"gain {three_digits(gain.value * IN_MM)} mm of the rms error, 95 % interval {low} to {high} mm"]
    loaded = result.loaded
    texts.append(
        f"{_VERDICTS[loaded.verdict]}: the targets moved by {100 * loaded.slope:.0f} % of the planned displacement of "
        f"{three_digits(loaded.planned_rms * IN_MM)} mm rms, 95 % interval {100 * loaded.low:.0f} to "
        f"{100 * loaded.high:.0f} %"
    )
    if result.promise is not None:
        promise = result.promise
        kept = "agrees with the model" if promise.kept else "does not agree with the model"
        texts.append(
            f"the error after {kept}: {three_digits(result.metrics_after.rms * IN_MM)} mm rms measured, "
            f"{three_digits(promise.promised_rms * IN_MM)} mm rms predicted with measurement noise; chi-square "
            f"{promise.chi_square:.4g} on {promise.degrees_of_freedom} degrees of freedom, {p_value(promise.p_value)}"
        )
    yield from items((*texts, *result.notes), width)


def _row(label: str, errors: ErrorMetrics) -> tuple[str, ...]:
    figures = (errors.rms, errors.mean, errors.p95, errors.max)
    return (label, *(three_digits(figure * IN_MM) for figure in figures))
