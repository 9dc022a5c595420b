"""A trace as text: residual and noise, candidates, findings with their tests, before and after, remaining error."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from typing import TextIO

from robacc.effects.base import effect_class
from robacc.effects.baseline import Baseline
from robacc.fitting.parameters import FittedParameter
from robacc.render.text.causes import draw_causes
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.detection import draw_detection
from robacc.render.text.effect_label import effect_label
from robacc.render.text.grouped_names import mass_coefficients, without_mass_coefficients
from robacc.render.text.layout import BLANK, TextLine, columns, heading, items, wrapped
from robacc.render.text.numbers import measured, odds, p_value, three_digits
from robacc.render.text.stages import NOISE_SOURCES, deflection, gain_line, repeatability_items, stage_tables
from robacc.render.text.units import IN_DEGREES, IN_MM, table_unit, with_table_unit
from robacc.tracing.findings import Finding
from robacc.tracing.harmonics import Harmonic
from robacc.tracing.search import Alternative
from robacc.tracing.trace_result import Trace
from robacc.tracing.verdict import is_hidden_noise

_VERDICTS = {
    "clean": "clean: no effect beyond the declared effects",
    "explained": "explained",
    "partly_explained": "partly explained",
    "unexplained": "unexplained: the residual is structured and no candidate explains it",
}
_CONVINCING = 0.01
_MAX_CAUSES = 6
_MAX_HINTS = 3
_WORTH_CORRECTING = 0.9
"""Ratio of the errors after and before from which a model is not worth its use."""
_MORE = "`full=True` adds candidates, tests, coefficients, errors before and after, and detection limits"
_MAX_CANDIDATES = 5
_MAX_HARMONICS = 6
_MAX_PARAMETERS = 8
_INDISTINGUISHABLE = 0.9999
"""Similarity from which two effects predict the same on the poses."""


def draw_trace(
    result: Trace, poses: str, robot: str, baseline: Baseline, stream: TextIO, *, full: bool = False
) -> None:
    """Write the report of ``robacc trace`` to ``stream``: how good, why, what now; or with all that was tested."""
    width = width_of(stream)
    parts = _parts(result, width) if full else _short_parts(result, width)
    write_lines(itertools.chain(_opening(result, poses, robot, baseline, width), parts), stream)


def _opening(result: Trace, poses: str, robot: str, baseline: Baseline, width: int) -> Iterator[TextLine]:
    rows = result.fit.residual.shape[1]
    yield heading(f"Trace of {rows} measured poses: {_VERDICTS[result.verdict]}")
    yield TextLine(f"{poses} against the model {robot}")
    for text in declared_effects(baseline):
        yield from wrapped(text, width)
    yield BLANK


def _short_parts(result: Trace, width: int) -> Iterator[TextLine]:
    """Yield causes, what is not distinguishable, what remains, and what to do."""
    yield from draw_causes(result.causes, result.nominal, result.after, width, _MAX_CAUSES)
    yield BLANK
    notes = [
        f"{effect_label(finding.effect, finding.joints, finding.settings)}: {_alternative(rival)}"
        for finding in result.findings
        for rival in finding.alternatives
    ]
    hints = result.unexplained.hints
    notes += [f"{three_digits(result.unexplained.rms * IN_MM)} mm rms remain{_parts_of(result)}", *hints[:_MAX_HINTS]]
    if len(hints) > _MAX_HINTS:
        notes.append(f"and {len(hints) - _MAX_HINTS} more hints")
    yield from items(notes, width)
    yield from wrapped(f"next: {_next_step(result)}", width)
    yield from (TextLine(line.text, "dim") for line in wrapped(_MORE, width))


def _next_step(result: Trace) -> str:
    """Return what to do with the result."""
    if result.next_poses:
        return "measure the poses that `full=True` lists: they distinguish a finding from its alternative"
    before, after = result.nominal.fitted.position.rms, result.after.fitted.position.rms
    if after > _WORTH_CORRECTING * before:
        return "nothing to correct: the model is hardly better than the nominal arm with base and tool registered"
    return "write the model with `write_model`, and let `robacc correct` change the robot's targets by it"


def _parts(result: Trace, width: int) -> Iterator[TextLine]:
    yield heading("Causes")
    yield from draw_causes(result.causes, result.nominal, result.after, width)
    yield BLANK
    yield heading("1. Residual")
    yield from wrapped(_residual(result), width)
    if result.assumption is not None:
        yield from wrapped(result.assumption, width)
    yield BLANK
    yield heading("2. Candidates")
    yield from _candidates(result, width)
    yield BLANK
    yield heading("3. Findings")
    if not result.findings:
        yield TextLine("none, at a false-alarm rate below 1 % over all candidates")
    for number, finding in enumerate(result.findings, 1):
        yield from _finding(number, finding, _baseline_rms(result), width)
    if result.findings:
        note = (
            "% of the residual: share of the baseline's mean square error on held-out poses that the effect removes "
            "if it is added last (shares need not add up to 100 %); ±: one standard error"
        )
        yield from (TextLine(line.text, "dim") for line in wrapped(note, width))
    for text in deflection(result.deflection):
        yield from wrapped(text, width)
    if result.undeclared_load is not None:
        yield from wrapped(f"undeclared load: {result.undeclared_load.statement}", width)
    yield BLANK
    yield heading("4. Before and after")
    rows_of_stages = [
        ("nominal, base and tool registered", result.nominal),
        ("baseline (declared effects)", result.before),
    ]
    if result.findings:
        rows_of_stages.append(("extended model (findings)", result.after))
    yield from stage_tables(rows_of_stages)
    yield from gain_line(result.gain)
    note = "rows are of models; the arm itself keeps the error of the first row until its controller uses the model"
    yield from (TextLine(line.text, "dim") for line in wrapped(note, width))
    yield BLANK
    yield heading("5. Remaining error")
    yield from items(_remaining_error(result), width)
    if not result.findings:
        yield BLANK
        yield heading("6. Detection limits of these poses")
        yield from draw_detection(result.detection, width)
    if result.next_poses:
        yield BLANK
        yield heading(f"{6 if result.findings else 7}. Poses to measure next")
        yield from _next_poses(result, width)


def declared_effects(baseline: Baseline) -> Iterator[str]:
    """Return the declared effects, and for the default how it was chosen and what it lacks."""
    names = ", ".join(baseline.names) or "none"
    yield f"declared effects: {names}{' (default; `declared` changes them)' if baseline.by_default else ''}"
    for name, why in baseline.left_out:
        yield f"{name} is not declared: {why}"


def _residual(result: Trace) -> str:
    noise = result.noise.noise
    size = math.sqrt(3) * noise.position * IN_MM
    rms = result.before.fitted.position.rms * IN_MM
    text = f"baseline: {three_digits(rms)} mm rms; measurement noise: "
    if noise.source in NOISE_SOURCES:
        return f"{text}{three_digits(size)} mm rms, {NOISE_SOURCES[noise.source]}"
    why = "because the file has neither sigma columns nor repeated poses"
    if is_hidden_noise(result.noise, result.repeatability):
        return f"{text}not distinguishable from the arm's repeatability (section 5) {why}"
    return f"{text}{three_digits(size)} mm rms, estimated from the remaining error {why}"


def _candidates(result: Trace, width: int) -> Iterator[TextLine]:
    first = next((step for step in result.steps if step.ranking), None)
    if first is None:
        yield TextLine("none: no effect can be tested on these data")
        return
    rows: list[list[str]] = []
    listed: set[tuple[str, tuple[str, ...]]] = set()
    for ranked in first.ranking:
        effect = ranked.effect
        if (effect.name, effect.joints) in listed or len(rows) == _MAX_CANDIDATES:
            continue
        listed.add((effect.name, effect.joints))
        rows.append([str(effect), f"{ranked.evidence:.1f}", p_value(ranked.p_value)])
    yield from columns(["best candidates, first step", "evidence", "significance"], rows)
    yield TextLine("evidence: log Bayes factor against the baseline; sorted with prior odds", "dim")
    if result.missing:
        why = "; ".join(f"{name} ({why})" for name, why in result.missing.items())
        yield from (TextLine(line.text, "dim") for line in wrapped(f"not tested: {why}", width))


def _baseline_rms(result: Trace) -> float | None:
    """Return the RMS position error of the baseline on held-out poses, m."""
    return None if result.before.held_out is None else result.before.held_out.position.rms


def _finding(number: int, finding: Finding, baseline_rms: float | None, width: int) -> Iterator[TextLine]:
    joints = f" on {', '.join(finding.joints)}" if finding.joints else ""
    if part := finding.settings.get("part"):
        name = finding.settings.get("target")
        joints = f" of the {part}" if name is None else f" of the {part} {name}"
    yield from wrapped(f"{number}) {finding.effect}{joints} {at_tool(finding, baseline_rms)}", width)
    details = [effect_class(finding.effect).about.summary]
    details += [] if finding.statement is None else [finding.statement]
    details.append(p_value(finding.p_value))
    if finding.held_out_before is not None and finding.held_out_after is not None:
        before, after = (three_digits(size * IN_MM) for size in (finding.held_out_before, finding.held_out_after))
        text = f"held-out poses: {before} mm rms without it, {after} mm rms with it"
        if None not in finding.held_out_turn:
            turns = (three_digits((turn or 0.0) * IN_DEGREES) for turn in finding.held_out_turn)
            text += "; orientation {}° and {}°".format(*turns)
        details.append(text)
    if finding.harmonics:
        listed = finding.harmonics[:_MAX_HARMONICS]
        n_unlisted = len(finding.harmonics) - len(listed)
        unlisted = f", and {n_unlisted} weaker harmonics" if n_unlisted else ""
        details.append("harmonics, order per turn (amplitude): " + ", ".join(map(_order, listed)) + unlisted)
    else:
        parameters, masses = without_mass_coefficients(finding.parameters)
        details.extend(_parameter(parameter) for parameter in parameters[:_MAX_PARAMETERS])
        if len(parameters) > _MAX_PARAMETERS:
            details.append(f"and {len(parameters) - _MAX_PARAMETERS} more coefficients")
        details.extend(mass_coefficients(effect, count) for effect, count in masses.items())
    details.extend(_alternative(alternative) for alternative in finding.alternatives)
    details.extend(finding.warnings)
    yield from items(details, width)


def at_tool(finding: Finding, baseline_rms: float | None) -> str:
    """Return what the effect does at the tool, and its share of the mean square error of the baseline."""
    if finding.size_at_tool is None or finding.largest_at_tool is None:
        return "cannot be evaluated alone"
    text = (
        f"moves the tool by up to {three_digits(finding.largest_at_tool * IN_MM)} mm "
        f"({three_digits(finding.size_at_tool * IN_MM)} mm rms)"
    )
    turn, largest_turn = finding.turn_at_tool
    if turn is not None and largest_turn is not None:
        text += f" and turns it by up to {three_digits(largest_turn * IN_DEGREES)}°"
    if finding.held_out_before is None or finding.held_out_after is None or not baseline_rms:
        return text
    share = (finding.held_out_before**2 - finding.held_out_after**2) / baseline_rms**2
    percent = f"{100 * min(share, 1.0):.0f}" if share >= 0.01 else "less than 1"
    return f"{text}, {percent} % of the residual"


def _parameter(parameter: FittedParameter) -> str:
    factor, unit = table_unit(parameter.unit)
    if parameter.std is None:
        return f"{parameter.name}: not identifiable, {parameter.why}"
    number = " ± ".join(measured(factor * parameter.value, factor * parameter.std))
    return f"{parameter.name} = {with_table_unit(number, unit)}"


def _order(harmonic: Harmonic) -> str:
    amplitude = three_digits(harmonic.amplitude * IN_DEGREES)
    if harmonic.amplitude_std is not None:
        amplitude = " ± ".join(measured(harmonic.amplitude * IN_DEGREES, harmonic.amplitude_std * IN_DEGREES))
    return f"{harmonic.order:g} ({amplitude}°)"


def _alternative(alternative: Alternative) -> str:
    label = effect_label(alternative.effect, alternative.joints, alternative.settings)
    text = f"not distinguishable from {label} on these poses"
    if alternative.similarity > _INDISTINGUISHABLE:
        return f"{text}: same predictions"
    return (
        f"{text}: predictions {100 * alternative.similarity:.0f} % similar, odds of the alternative "
        f"{odds(alternative.evidence_difference)}"
    )


def _remaining_error(result: Trace) -> Iterable[str]:
    unexplained = result.unexplained
    text = f"{three_digits(unexplained.rms * IN_MM)} mm rms on the calibration poses"
    if unexplained.noise_rms is not None:
        size = f"{three_digits(unexplained.noise_rms * IN_MM)} mm"
        is_part = unexplained.noise_rms < unexplained.rms
        text += f", of which {size} is measurement noise" if is_part else f"; measurement noise alone is {size}"
    yield text
    yield (
        f"structured: not noise alone{_significance(unexplained.p_value)}"
        if unexplained.structured
        else f"no structure that any candidate explains ({p_value(unexplained.p_value)})"
    )
    if result.explained_share is not None and result.findings:
        share = f"{100 * result.explained_share:.0f} %"
        floor = "noise" if result.repeatability is None else "noise and repeatability"
        yield f"{share} of the explainable error is explained (held-out variance above {floor})"
    if parts := _parts_of(result):
        yield f"its parts{parts}"
    yield from repeatability_items(result.repeatability, result.fit.model.arm)
    yield from unexplained.hints


def _parts_of(result: Trace) -> str:
    """Return the parts of the remaining error; empty if it is noise alone."""
    parts = result.unexplained.parts
    if len(parts) < 2:
        return ""
    return ", mm: " + ", ".join(f"{_PARTS[part]} {three_digits(size * IN_MM)}" for part, size in parts.items())


_PARTS = {
    "noise": "noise",
    "scatter": "scatter of the joints",
    "pose": "error that depends on the pose",
    "wander": "wander over time",
}


def _significance(probability: float) -> str:
    """Return the p-value in brackets where it is what shows the structure."""
    return f" ({p_value(probability)})" if probability < _CONVINCING else ""


def _next_poses(result: Trace, width: int) -> Iterator[TextLine]:
    arm = result.fit.model.arm
    units = [table_unit(arm.unit(name)) for name in arm.names]
    names = [f"{name}, {unit}" for name, (_, unit) in zip(arm.names, units, strict=True)]
    for advice in result.next_poses:
        yield from wrapped(advice.text, width)
        if advice.q:
            rows = [
                [
                    str(number),
                    *(f"{value * factor:.2f}" for value, (factor, _) in zip(values, units, strict=True)),
                    three_digits(difference * IN_MM),
                ]
                for number, (values, difference) in enumerate(zip(advice.q, advice.difference, strict=True), 1)
            ]
            yield from columns(["pose", *names, "difference, mm"], rows)
