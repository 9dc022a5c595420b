"""A calibration as tables: before and after, coefficients with their uncertainties, and what to bear in mind."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, TextIO

from robacc.calibration import Calibration
from robacc.measurements import Measurements
from robacc.report.console import draw
from robacc.report.layout import add_row, heading, items, line, stages, table_of
from robacc.report.numbers import p_value, three_digits

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

_IN_MM = 1e3
_SHOWN = 60


def draw_calibration(
    result: Calibration, data: Measurements, poses: str, robot: str, fitted: str, stream: TextIO
) -> None:
    """Draw the whole calibration on ``stream``."""
    draw(_parts(result, data, poses, robot, fitted), stream)


def _parts(result: Calibration, data: Measurements, poses: str, robot: str, fitted: str) -> Iterable[RenderableType]:
    count = result.identifiability.kept.size
    yield heading(f"Calibration from {data.n} measured poses: {count} coefficients fitted")
    yield line(f"{poses}, commanded by {robot}")
    yield line(f"asked for: {fitted}; fitted: {', '.join(str(effect) for effect in result.effects)}")
    yield heading("Before and after", gap=True)
    yield from stages(
        [("as delivered", result.nominal), ("base and tool", result.before), ("calibrated", result.after)]
    )
    if result.gain is not None and math.isfinite(result.gain.low):
        yield line(
            f"gain on poses held out: {three_digits(result.gain.value * _IN_MM)} mm of rms, 95 % interval "
            f"{three_digits(result.gain.low * _IN_MM)} to {three_digits(result.gain.high * _IN_MM)} mm"
        )
    yield heading("Coefficients", gap=True)
    yield _coefficients(result)
    yield heading("How well the poses show them", gap=True)
    yield items(_quality(result, data))


def _coefficients(result: Calibration) -> Table:
    table = table_of("name", "value", "standard error", "unit")
    shown = [one for one in result.parameters if one.std is not None]
    for one in shown[:_SHOWN]:
        add_row(table, one.name, f"{one.value:.6g}", f"{one.std:.2g}", "" if one.unit == "1" else one.unit)
    if len(shown) > _SHOWN:
        add_row(table, f"and {len(shown) - _SHOWN} more, all in the JSON", "", "", "")
    return table


def _quality(result: Calibration, data: Measurements) -> Iterable[str]:
    noise, found = result.noise.noise, result.fit
    source = {"file": "the file", "repeats": "repeats"}.get(noise.source, "the residual")
    yield f"noise {three_digits(noise.position * _IN_MM)} mm along each axis, known from {source}"
    if result.noise.p_value is not None:
        yield f"residual {result.noise.ratio:.3g} times that noise, lack of fit {p_value(result.noise.p_value)}"
    yield f"chi-square {found.chi_square:.4g} on {found.degrees_of_freedom:.1f} degrees of freedom, as weighed"
    indices = ", ".join(f"{name} {value:.3g}" for name, value in result.identifiability.observability().items())
    yield f"condition number {result.identifiability.condition:.3g}; observability {indices}"
    for one in result.identifiability.dropped:
        yield f"no number: {one.why}"
    for pair in result.correlations[:8]:
        yield f"correlated {pair.value:+.3f}: {pair.first} and {pair.second}"
    if len(result.correlations) > 8:
        yield f"and {len(result.correlations) - 8} pairs more correlated above 0.9"
    for i, share in result.leverage[:5]:
        yield f"line {data.line(i)} decides {100 * share:.0f} % of its own prediction"
