"""A calibration and a trace as text: causes, before and after, coefficients, findings, detection limits."""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Iterable, Iterator, Sequence
from typing import TextIO

from robacc.accuracy.pose_errors import PoseMetrics
from robacc.accuracy.stages import Gain, Stage
from robacc.calibration.calibrating import Calibration
from robacc.effects.base import effect_class
from robacc.effects.request import Baseline
from robacc.error_model.structure import Repeatability
from robacc.fitting.fit_result import Dropped
from robacc.fitting.masses import BETTER, DeflectionChoice
from robacc.fitting.parameters import FittedParameter
from robacc.fitting.sparse_prior import ShrunkKind
from robacc.measurements import Measurements
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import (
    BLANK,
    IN_DEGREES,
    IN_MM,
    TextLine,
    columns,
    effect_label,
    grouped,
    heading,
    items,
    mass_coefficients,
    measured,
    odds,
    p_value,
    table_unit,
    three_digits,
    with_table_unit,
    without_mass_coefficients,
    wrapped,
)
from robacc.robots.arm import Arm
from robacc.tracing.detection import DetectionLimit
from robacc.tracing.findings import Finding, Harmonic, is_hidden_noise
from robacc.tracing.judging import ErrorCause
from robacc.tracing.search import Alternative
from robacc.tracing.trace import Trace

# Common parts of the calibrate and trace reports: before and after side by side, the deflection model.

NOISE_SOURCES = {
    "file": "from the file's sigma columns",
    "file and misfit": "from the file's sigma columns and what the remaining error adds to them",
    "repeats": "from repeated poses",
}
"""Where a known measurement noise comes from; any other source is the remaining error alone."""


def stage_tables(stages: Sequence[tuple[str, Stage]]) -> Iterator[TextLine]:
    """Return the errors of each stage, held-out poses first."""
    kinds = (
        ("held_out", "held-out poses"),
        ("held_out_inliers", "held-out poses without outliers"),
        ("fitted", "calibration poses"),
        ("fitted_inliers", "calibration poses without outliers"),
    )
    for kind, title in kinds:
        figures = [(name, getattr(stage, kind)) for name, stage in stages]
        if any(metrics is None for _, metrics in figures):
            continue
        for quantity, unit, factor in (("position", "mm", IN_MM), ("orientation", "°", IN_DEGREES)):
            if getattr(figures[0][1], quantity) is not None:
                yield from _table(f"{quantity}, {unit}, {title}", quantity, factor, figures)


def gain_line(gain: Gain | None) -> Iterator[TextLine]:
    """Return the gain with its interval, nothing without an interval."""
    if gain is None or gain.low != gain.low:
        return
    value, low, high = (three_digits(number * IN_MM) for number in (gain.value, gain.low, gain.high))
    percent = f"{100 * gain.confidence:.0f} %"
    yield TextLine(f"rms reduction on held-out poses: {value} mm ({percent} interval {low} to {high} mm)")


def repeatability_items(repeatability: Repeatability | None, arm: Arm) -> Iterator[str]:
    """Return the intrinsic repeatability joint by joint, and its limitation; nothing if it is not significant."""
    if repeatability is None:
        return
    joints = ", ".join(
        f"{name} {three_digits(std * (IN_DEGREES if arm.is_revolute(name) else IN_MM))}"
        f"{'°' if arm.is_revolute(name) else ' mm'}"
        for name, std in repeatability.joints
        if std is not None
    )
    size = three_digits(repeatability.position * IN_MM)
    yield f"intrinsic repeatability: {size} mm rms at the target ({joints or 'not identifiable joint by joint'})"
    if repeatability.source == "residual":
        yield "without repeated visits, repeatability is not distinguishable from effects outside the catalogue"


def _table(title: str, quantity: str, factor: float, figures: Sequence[tuple[str, PoseMetrics]]) -> list[TextLine]:
    rows = []
    for name, stage in figures:
        metrics = getattr(stage, quantity)
        rows.append(
            [name, *(three_digits(value * factor) for value in (metrics.rms, metrics.mean, metrics.p95, metrics.max))]
        )
    return columns([title, "rms", "mean", "95th pct.", "max"], rows)


def deflection(choice: DeflectionChoice | None) -> Iterator[str]:
    """Return the deflection model used by elastic effects and the reason for it."""
    if choice is None:
        return
    size = f"{three_digits(choice.difference * IN_MM)} mm rms"
    if choice.gain is None:
        yield (
            f"deflection model: equilibrium; torques at the undeflected pose change the prediction by {size}, too "
            "little to distinguish the two models"
        )
        return
    comparison = (
        f"torques at the undeflected pose change the prediction by {size} and twice the log-likelihood by "
        f"{choice.gain:+.3g}; threshold +{BETTER:g}"
    )
    yield f"deflection model: {'equilibrium' if choice.form == 'equilibrium' else 'undeflected pose'}; {comparison}"


# Detection limits as text: the smallest and the largest of each effect over its joints.


def draw_detection(limits: Sequence[DetectionLimit], width: int) -> Iterator[TextLine]:
    """Return a line per effect: its lowest and highest detection limit and the motion it causes at the target."""
    families: dict[str, list[DetectionLimit]] = {}
    for limit in limits:
        families.setdefault(limit.effect, []).append(limit)
    rows, undetectable = [], []
    for name, family in families.items():
        detectable = sorted(
            (limit for limit in family if limit.limit is not None), key=lambda limit: limit.limit or 0.0
        )
        undetectable += [_limit_label(limit) for limit in family if limit.limit is None]
        if detectable:
            motion = statistics.median(limit.rms or 0.0 for limit in detectable) * IN_MM
            highest = _size(detectable[-1]) if len(detectable) > 1 else ""
            rows.append([name, _size(detectable[0]), highest, table_unit(detectable[0].unit)[1], three_digits(motion)])
    yield from columns(["detection limit", "lowest", "highest", "unit", "at the target, mm"], rows)
    yield TextLine("detection limit: smallest size found with probability 1/2", "dim")
    if undetectable:
        names = ", ".join(dict.fromkeys(undetectable))
        yield from (TextLine(line.text, "dim") for line in wrapped(f"not identifiable on these poses: {names}", width))


def _limit_label(limit: DetectionLimit) -> str:
    return f"{limit.effect}[{','.join(limit.joints)}]" if limit.joints else limit.effect


def _size(limit: DetectionLimit) -> str:
    joints = f" {','.join(limit.joints)}" if limit.joints else ""
    return f"{(limit.limit or 0.0) * table_unit(limit.unit)[0]:.1e}{joints}"


# The causes of an arm's error, as text.

_IN_HEADLINE = 3
_NOTABLE = 0.01
"""Least share of the error of a cause that is listed."""


def draw_causes(
    causes: Sequence[ErrorCause], nominal: Stage, after: Stage, width: int, most: int = 8
) -> Iterator[TextLine]:
    """Yield what the error was and is, its largest causes, and a table of at most ``most`` causes."""
    apart = nominal.held_out is not None and after.held_out is not None
    was, now = (
        (stage.held_out if apart and stage.held_out is not None else stage.fitted).position.rms * IN_MM
        for stage in (nominal, after)
    )
    notable = [cause for cause in causes if cause.share is None or cause.share >= _NOTABLE or not cause.declared]
    named = ", ".join(_cause_label(cause) for cause in notable[:_IN_HEADLINE]) or "no single cause"
    yield from wrapped(
        f"{three_digits(was)} mm rms to {three_digits(now)} mm rms"
        f"{' on held-out poses' if apart else ''}: {named}{' and others' if len(notable) > _IN_HEADLINE else ''}",
        width,
    )
    if not causes:
        return
    is_mixed = len({cause.declared for cause in causes}) > 1
    rows = [
        [
            f"{_cause_label(cause)}{' (declared)' * (cause.declared and is_mixed)}",
            three_digits(cause.size * IN_MM),
            " to ".join(three_digits(end * IN_MM) for end in cause.interval),
            three_digits(cause.left * IN_MM),
            "–" if cause.share is None else f"{100 * cause.share:.0f} %",
        ]
        for cause in notable[:most]
    ]
    if rows:
        yield from columns(["effect", "moves, mm", "95 % interval", "without it, mm", "share"], rows)
    if hidden := len(causes) - len(rows):
        yield TextLine(f"and {hidden} smaller; the JSON result has all of them", "dim")
    note = (
        "moves: rms distance by which the effect alone moves the tool; without it: rms error that no other effect can "
        "describe; share: of the nominal model's mean square error"
    )
    yield from (TextLine(line.text, "dim") for line in wrapped(note, width))


def _cause_label(cause: ErrorCause) -> str:
    return effect_label(cause.effect, cause.joints, cause.settings)


# A calibration as tables: before and after, coefficients with their uncertainties, quality of the fit.

_MAX_COEFFICIENTS = 60
_MAX_NAMES = 6
_MAX_DROPPED = 3


def draw_calibration(
    result: Calibration, data: Measurements, poses: str, robot: str, fitted: str, stream: TextIO
) -> None:
    """Write the calibration report to ``stream``."""
    write_lines(_calibration_parts(result, data, poses, robot, fitted, width_of(stream)), stream)


def _calibration_parts(
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


# A trace as text: residual and noise, candidates, findings with their tests, before and after, remaining error.

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
    parts = _trace_parts(result, width) if full else _short_parts(result, width)
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


def _trace_parts(result: Trace, width: int) -> Iterator[TextLine]:
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
