"""A calibration as tables: before and after, coefficients with their uncertainties, and what to bear in mind."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TextIO

from robacc.calibration import Calibration
from robacc.fitting.sparse_prior import ShrunkKind
from robacc.measurements import Measurements
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import BLANK, TextLine, columns, heading, items, wrapped
from robacc.render.text.numbers import measured, p_value, three_digits
from robacc.render.text.stages import deflection, gain_line, stages

_IN_MM = 1e3
_SHOWN = 60
_DIFFERING = 6


def draw_calibration(
    result: Calibration, data: Measurements, poses: str, robot: str, fitted: str, stream: TextIO
) -> None:
    """Draw the whole calibration on ``stream``."""
    write_lines(_parts(result, data, poses, robot, fitted, width_of(stream)), stream)


def _parts(
    result: Calibration, data: Measurements, poses: str, robot: str, fitted: str, width: int
) -> Iterator[TextLine]:
    count = result.identifiability.kept.size
    yield heading(f"Calibration from {data.n} measured poses: {count} coefficients fitted")
    yield TextLine(f"{poses}, commanded by {robot}")
    yield from wrapped(f"asked for: {fitted}; fitted: {', '.join(str(effect) for effect in result.effects)}", width)
    yield BLANK
    yield heading("Before and after")
    yield from stages(
        [("as delivered", result.nominal), ("base and tool", result.before), ("calibrated", result.after)]
    )
    yield from gain_line(result.gain)
    yield BLANK
    yield heading("Coefficients")
    yield from _coefficients(result)
    yield BLANK
    yield heading("How well the poses show them")
    yield from items(_quality(result, data), width)


def _coefficients(result: Calibration) -> list[TextLine]:
    shown = [one for one in result.parameters if one.std is not None]
    rows = [
        [one.name, *measured(one.value, one.std or 0.0), "" if one.unit == "1" else one.unit] for one in shown[:_SHOWN]
    ]
    lines = columns(["name", "value", "standard error", "unit"], rows)
    return [*lines, TextLine(f"and {len(shown) - _SHOWN} more, all in the JSON")] if len(shown) > _SHOWN else lines


def _quality(result: Calibration, data: Measurements) -> Iterable[str]:
    noise, found = result.noise.noise, result.fit
    source = {"file": "known from the file", "repeats": "known from repeats"}.get(noise.source)
    size = f"noise {three_digits(noise.position * _IN_MM)} mm along each axis"
    yield f"{size}, {source or 'estimated from the residual'}"
    if result.noise.p_value is not None:
        yield f"residual {result.noise.ratio:.3g} times that noise, lack of fit {p_value(result.noise.p_value)}"
    if source is not None:
        # Of rows weighed by their own residual it is the degrees of freedom again, whatever the model.
        yield f"chi-square {found.chi_square:.4g} on {found.degrees_of_freedom:.1f} degrees of freedom, as weighed"
    indices = ", ".join(f"{name} {value:.3g}" for name, value in result.identifiability.observability().items())
    yield f"condition number {result.identifiability.condition:.3g}; observability {indices}"
    for kind in result.shrunk:
        yield _drawn(kind)
    if result.shrunk:
        yield "standard errors are of the poses alone, drawn or not; --no-shrink draws nothing"
    yield from deflection(result.deflection)
    for one in result.identifiability.dropped:
        yield f"no number: {one.why}"
    for pair in result.correlations[:8]:
        yield f"correlated {pair.value:+.3f}: {pair.first} and {pair.second}"
    if len(result.correlations) > 8:
        yield f"and {len(result.correlations) - 8} pairs more correlated above 0.9"
    for i, share in result.leverage[:5]:
        yield f"{data.place(i)} decides {100 * share:.0f} % of its own prediction"


def _drawn(kind: ShrunkKind) -> str:
    differing = [name for name, p in zip(kind.names, kind.probability, strict=True) if p > 0.5]
    count, what = len(kind.names), {"m": "lengths", "rad": "angles"}[kind.unit]
    if not differing:
        return f"no one of {count} {what} is shown to differ from the robot file's value: all are drawn to it"
    shown = ", ".join(differing[:_DIFFERING]) + (" …" if len(differing) > _DIFFERING else "")
    verb = "differs" if len(differing) == 1 else "differ"
    return (
        f"{len(differing)} of {count} {what} {verb} from the robot file's value, {shown}; the others are drawn to it "
        "as far as the poses allow"
    )
