"""A calibration as tables: before and after, coefficients with their uncertainties, quality of the fit."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TextIO

from robacc.calibration.calibrating import Calibration
from robacc.fitting.identifiability import Dropped
from robacc.fitting.sparse_prior import ShrunkKind
from robacc.measurements import Measurements
from robacc.render.text.causes import draw_causes
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.grouped_names import grouped, mass_coefficients, without_mass_coefficients
from robacc.render.text.layout import BLANK, TextLine, columns, heading, items, wrapped
from robacc.render.text.numbers import measured, p_value, three_digits
from robacc.render.text.stages import NOISE_SOURCES, deflection, gain_line, repeatability_items, stage_tables
from robacc.render.text.units import IN_MM, table_unit

_MAX_COEFFICIENTS = 60
_MAX_NAMES = 6
_MAX_DROPPED = 3


def draw_calibration(
    result: Calibration, data: Measurements, poses: str, robot: str, fitted: str, stream: TextIO
) -> None:
    """Write the calibration report to ``stream``."""
    write_lines(_parts(result, data, poses, robot, fitted, width_of(stream)), stream)


def _parts(
    result: Calibration, data: Measurements, poses: str, robot: str, fitted: str, width: int
) -> Iterator[TextLine]:
    count = result.identifiability.columns.size
    yield heading(f"Calibration from {data.n} measured poses: {count} coefficients fitted")
    yield TextLine(f"{poses} against the model {robot}")
    yield from wrapped(f"requested: {fitted.replace(',', ', ')}", width)
    yield from wrapped(f"fitted: {', '.join(str(effect) for effect in result.effects)}", width)
    yield BLANK
    yield heading("Causes")
    yield from draw_causes(result.causes, result.nominal, result.after, width)
    yield BLANK
    yield heading("Before and after")
    yield from stage_tables(
        [
            ("nominal, base and tool registered", result.nominal),
            ("baseline", result.before),
            ("calibrated", result.after),
        ]
    )
    yield from gain_line(result.gain)
    yield BLANK
    yield heading("Coefficients")
    yield from _coefficients(result, width)
    yield BLANK
    yield heading("Quality of the fit")
    yield from items(_quality(result, data), width)


def _coefficients(result: Calibration, width: int) -> list[TextLine]:
    estimated, masses = without_mass_coefficients(p for p in result.parameters if p.std is not None)
    rows = []
    for parameter in estimated[:_MAX_COEFFICIENTS]:
        factor, unit = table_unit(parameter.unit)
        rows.append([parameter.name, *measured(factor * parameter.value, factor * (parameter.std or 0.0)), unit])
    lines = columns(["name", "value", "standard error", "unit"], rows)
    if len(estimated) > _MAX_COEFFICIENTS:
        lines.append(TextLine(f"and {len(estimated) - _MAX_COEFFICIENTS} more; the JSON result has all of them"))
    for effect, count in masses.items():
        lines.extend(wrapped(mass_coefficients(effect, count), width))
    return lines


def _quality(result: Calibration, data: Measurements) -> Iterable[str]:
    noise, fit = result.noise.noise, result.fit
    source = NOISE_SOURCES.get(noise.source)
    if noise.along_axes is None:
        size = f"{three_digits(noise.position * IN_MM)} mm along each axis"
    else:
        size = f"{', '.join(three_digits(std * IN_MM) for std in noise.along_axes)} mm along x, y, z"
    yield f"measurement noise {size} (standard deviation), {source or 'estimated from the residual'}"
    if result.noise.p_value is not None:
        yield f"residual {result.noise.ratio:.3g} times this noise; lack-of-fit test {p_value(result.noise.p_value)}"
    if result.noise.p_value is not None:
        # With noise estimated from the residual, chi-square equals the degrees of freedom for every model.
        yield f"weighted chi-square {fit.chi_square:.4g} on {fit.degrees_of_freedom:.1f} degrees of freedom"
    indices = ", ".join(f"{name} {value:.3g}" for name, value in result.identifiability.observability().items())
    yield f"condition number {result.identifiability.condition:.3g}; observability indices {indices}"
    yield from repeatability_items(result.repeatability, result.fit.model.arm)
    for kind in result.shrunk:
        yield _shrinkage(kind)
    if result.shrunk:
        yield "standard errors come from the poses alone, without the prior; `shrink=False` fits without it"
    yield from deflection(result.deflection)
    yield from _not_identifiable(result.identifiability.dropped)
    for pair in result.correlations[:8]:
        yield f"correlation {pair.value:+.3f} between {pair.first} and {pair.second}"
    if len(result.correlations) > 8:
        yield f"and {len(result.correlations) - 8} more pairs with a correlation above 0.9"
    for i, share in result.leverage[:5]:
        yield f"{data.place(i)} determines {100 * share:.0f} % of its own prediction (leverage)"


def _not_identifiable(dropped: Sequence[Dropped]) -> Iterator[str]:
    """Return what the poses do not determine: a few coefficients each with its reason, many by reason."""
    if len(dropped) <= _MAX_DROPPED:
        yield from (f"not identifiable: {each.why}" for each in dropped)
        return
    without_effect = [each.name for each in dropped if not each.partners]
    if without_effect:
        yield f"not identifiable: without effect on these poses: {grouped(without_effect)}"
    if confounded := [each.name for each in dropped if each.partners]:
        yield (
            f"not identifiable: not distinguishable from fitted coefficients on these poses: {grouped(confounded)} "
            "(the JSON result names the partners of each)"
        )


def _shrinkage(kind: ShrunkKind) -> str:
    differing = [name for name, p in zip(kind.names, kind.probability, strict=True) if p > 0.5]
    count, quantity = len(kind.names), {"m": "lengths", "rad": "angles"}[kind.unit]
    if not differing:
        return f"none of the {count} {quantity} differs significantly from nominal; all are shrunk to nominal"
    listed = ", ".join(differing[:_MAX_NAMES]) + (" …" if len(differing) > _MAX_NAMES else "")
    verb = "differs" if len(differing) == 1 else "differ"
    return (
        f"{len(differing)} of {count} {quantity} {verb} from nominal: {listed}; the others are shrunk to nominal "
        "as far as the poses allow"
    )
