"""A trace told in order: residual against noise, what was found and how sure, before and after, what is left."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TextIO

from robacc.fitting.parameters import FittedParameter
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.detection import draw_detection
from robacc.render.text.layout import BLANK, TextLine, columns, heading, items, wrapped
from robacc.render.text.numbers import measured, odds, p_value, three_digits
from robacc.render.text.stages import deflection, gain_line, stages
from robacc.tracing.findings import Finding
from robacc.tracing.harmonics import Harmonic
from robacc.tracing.rivals import Alternative
from robacc.tracing.trace import Trace

_IN_MM = 1e3
_IN_MICRORADIANS = 1e6
_VERDICTS = {
    "clean": "clean: nothing beyond what is declared",
    "explained": "explained",
    "partly_explained": "partly explained",
    "unexplained": "unexplained: something is there that nothing tried explains",
}
_SHOWN_CANDIDATES = 5
_SHOWN_LINES = 6
_SHOWN_PARAMETERS = 8


def draw_trace(result: Trace, poses: str, robot: str, declared: str, stream: TextIO) -> None:
    """Draw the whole story on ``stream``."""
    write_lines(_parts(result, poses, robot, declared, width_of(stream)), stream)


def _parts(result: Trace, poses: str, robot: str, declared: str, width: int) -> Iterator[TextLine]:
    rows = result.final.residual.shape[1]
    yield heading(f"Trace of {rows} measured poses: {_VERDICTS[result.verdict]}")
    yield TextLine(f"{poses}, commanded by {robot}")
    yield TextLine(f"declared, and fitted on both sides: {declared or 'nothing'}")
    yield BLANK
    yield heading("1. The residual")
    yield from wrapped(_residual(result), width)
    yield BLANK
    yield heading("2. What competed")
    yield from _competed(result, width)
    yield BLANK
    yield heading("3. What was found")
    if not result.findings:
        yield TextLine("nothing, at a false-alarm rate below 1 % over everything that competed")
    for number, finding in enumerate(result.findings, 1):
        yield from _finding(number, finding, width)
    yield from items(deflection(result.deflection), width)
    if result.findings:
        yield TextLine("± is one standard error", "dim")
    yield BLANK
    yield heading("4. Before and after")
    named = [("as delivered", result.nominal), ("declared fitted", result.before)]
    if result.findings:
        named.append(("with findings", result.after))
    yield from stages(named)
    yield from gain_line(result.gain)
    yield BLANK
    yield heading("5. What is left")
    yield from items(_left(result), width)
    if not result.findings:
        yield BLANK
        yield heading("6. What these poses could have shown")
        yield from draw_detection(result.detection, width)
    if result.next_poses:
        yield BLANK
        yield heading("6. What to measure next")
        yield from _next_poses(result, width)


def _residual(result: Trace) -> str:
    noise = result.noise.noise
    size = math.sqrt(3) * noise.position * _IN_MM
    rms = result.before.fitted.position.rms * _IN_MM
    if noise.source in ("file", "repeats"):
        known = "the file's sigma columns" if noise.source == "file" else "repeats"
        return (
            f"rms {three_digits(rms)} mm with what is declared; measuring noise {three_digits(size)} mm, from {known}"
        )
    return (
        f"rms {three_digits(rms)} mm with what is declared; noise is not known from the file or repeats, "
        f"and estimated from the final residual at {three_digits(size)} mm"
    )


def _competed(result: Trace, width: int) -> Iterator[TextLine]:
    first = next((step for step in result.steps if step.ranking), None)
    if first is None:
        yield TextLine("nothing could be offered for these data")
        return
    rows: list[list[str]] = []
    seen: set[tuple[str, tuple[str, ...]]] = set()
    for one in first.ranking:
        effect = one.candidate.effect
        if (effect.name, effect.joints) in seen or len(rows) == _SHOWN_CANDIDATES:
            continue
        seen.add((effect.name, effect.joints))
        rows.append([str(effect), f"{one.evidence:.1f}", p_value(one.p_value)])
    yield from columns(["best of the first step", "evidence, nats", "significance"], rows)
    if result.missing:
        why = "; ".join(f"{name} ({why})" for name, why in result.missing.items())
        yield from (TextLine(one.text, "dim") for one in wrapped(f"not offered: {why}", width))


def _finding(number: int, finding: Finding, width: int) -> Iterator[TextLine]:
    joints = f" on {', '.join(finding.joints)}" if finding.joints else ""
    again, of = finding.stability
    sure = f", chosen again in {again} of {of} folds" if of else ""
    yield TextLine(f"{number}) {finding.effect}{joints}: {p_value(finding.p_value)}{sure}")
    details = []
    if finding.held_out_before is not None and finding.held_out_after is not None:
        details.append(
            f"held out, rms {three_digits(finding.held_out_before * _IN_MM)} mm without it, "
            f"{three_digits(finding.held_out_after * _IN_MM)} mm with it"
        )
    if finding.harmonics:
        shown = finding.harmonics[:_SHOWN_LINES]
        more = f", and {len(finding.harmonics) - len(shown)} weaker" if len(finding.harmonics) > len(shown) else ""
        details.append("orders per turn: " + ", ".join(map(_order, shown)) + more)
    else:
        details.extend(_parameter(one) for one in finding.parameters[:_SHOWN_PARAMETERS])
        if len(finding.parameters) > _SHOWN_PARAMETERS:
            details.append(f"and {len(finding.parameters) - _SHOWN_PARAMETERS} coefficients more")
    details.extend(_alternative(other) for other in finding.alternatives)
    details.extend(finding.warnings)
    yield from items(details, width)


def _parameter(one: FittedParameter) -> str:
    unit = "" if one.unit == "1" else f" {one.unit}"
    if one.std is None:
        return f"{one.name}: no number, {one.why}"
    return f"{one.name} = {' ± '.join(measured(one.value, one.std))}{unit}"


def _order(line: Harmonic) -> str:
    amplitude = f"{line.amplitude * _IN_MICRORADIANS:.0f}"
    if line.amplitude_std is not None:
        amplitude = " ± ".join(measured(line.amplitude * _IN_MICRORADIANS, line.amplitude_std * _IN_MICRORADIANS))
    return f"{line.order:g} ({amplitude} µrad)"


def _alternative(other: Alternative) -> str:
    joints = f"[{','.join(other.joints)}]" if other.joints else ""
    if other.similarity > 0.9999:
        return f"cannot be told from {other.effect}{joints} on these poses"
    return (
        f"might as well be {other.effect}{joints}: what it explains is {100 * other.similarity:.0f} % alike, "
        f"its odds {odds(other.evidence_difference)}"
    )


def _left(result: Trace) -> Iterable[str]:
    left = result.unexplained
    text = f"rms {three_digits(left.rms * _IN_MM)} mm"
    if left.noise_rms is not None:
        text += f", of which measuring noise {three_digits(left.noise_rms * _IN_MM)} mm"
    yield text
    yield (
        f"there is structure in it ({p_value(left.p_value)})"
        if left.structured
        else f"no structure in it that anything tried would explain ({p_value(left.p_value)})"
    )
    yield from left.hints


def _next_poses(result: Trace, width: int) -> Iterator[TextLine]:
    names = result.final.model.arm.names
    for advice in result.next_poses:
        yield from wrapped(advice.text, width)
        if advice.q:
            rows = [
                [str(number), *(f"{value:.3f}" for value in values), three_digits(difference * _IN_MM)]
                for number, (values, difference) in enumerate(zip(advice.q, advice.difference, strict=True), 1)
            ]
            yield from columns(["pose", *names, "differ by, mm"], rows)
