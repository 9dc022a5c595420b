"""`robacc trace`: search, cross-validation, findings, rivals, error before and after, and remaining error."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.accuracy.before_after import before_and_after
from robacc.accuracy.stages import Gain, Residuals, Stage
from robacc.diagnostics.data_mistakes import refuse_mistake
from robacc.diagnostics.residual_correlation import residual_correlations
from robacc.effects.base import Effect
from robacc.fitting.apply_fit import apply_fit
from robacc.fitting.deflection_model import DeflectionChoice, choose_form
from robacc.fitting.fit_repeatability import Repeatability, repeatability_of
from robacc.fitting.mass_uncertainty import mass_warning, with_mass_uncertainty
from robacc.fitting.noise import LackOfFit, lack_of_fit
from robacc.fitting.outlier_pattern import outlier_pattern
from robacc.fitting.parameters import FittedParameter, parameters
from robacc.fitting.solver import Fit, Options
from robacc.fitting.warnings import (
    condition_warning,
    convergence_warning,
    frames_warning,
    no_held_out_warning,
    outliers_warning,
    sigma_warning,
    weak_parameters_warning,
)
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.description import Robot
from robacc.tracing.advice import Advice, advise, rival_effect
from robacc.tracing.cross_validation import (
    LEAST_GAIN,
    CrossValidation,
    Progress,
    cross_validate,
    gain_score,
    reduced,
)
from robacc.tracing.detection import DetectionLimit, detection_limits
from robacc.tracing.findings import Finding, describe_finding
from robacc.tracing.loop import SEARCH, SearchResult, frames_first, refit, search
from robacc.tracing.selection import FALSE_ALARM, SelectionStep

Verdict = Literal["clean", "explained", "partly_explained", "unexplained"]

_OF_EVERY_ARM = ("joint_offset", "link_geometry")
"""Effects by which every nominal model deviates."""
_MOST_REPEATABILITY = 1e-4
"""Largest plausible repeatability at the target, m (data sheets: 0.02 to 0.1 mm)."""
_MOST_PRESUMED = 1.2e-4
"""Remaining error, m rms, up to which noise that nothing confirms may be presumed: a laser tracker at some metres
(0.03 to 0.05 mm along each axis) and a data sheet's repeatability together."""
_SMALL_POSE_ERROR = 1e-5
"""Error common to all visits of a pose that no instrument resolves, m."""
_MANY_OUTLIERS = 0.05
"""Share of the rows from which outliers are not accidental."""
_MOST_TO_ADVISE = 200
"""Coefficients beyond which rivals are not fitted to choose the next poses."""


@dataclass(frozen=True, slots=True)
class Unexplained:
    """Remaining error after the findings."""

    rms: float
    """Root mean square of the fitted residual's length, m."""
    noise_rms: float | None
    """Root mean square of the measurement noise's length, m; None if neither file nor repeats give it."""
    structured: bool
    p_value: float
    hints: tuple[str, ...]


@dataclass(frozen=True)
class Trace:
    """Result of `robacc trace`."""

    robot: Robot
    """Robot file with the findings written into it."""
    verdict: Verdict
    assumption: str | None
    """What the verdict presumes where the noise is known from the residual alone."""
    declared: Fit
    final: Fit
    noise: LackOfFit
    nominal_unregistered: Stage
    """The nominal model as it stands in the robot file."""
    nominal: Stage
    """The nominal model, registered: base and tool frames fitted as far as the poses allow."""
    before: Stage
    after: Stage
    gain: Gain | None
    parameters: tuple[FittedParameter, ...]
    """Coefficients of the final fit; standard errors include the uncertainty of the masses."""
    findings: tuple[Finding, ...]
    deflection: DeflectionChoice | None
    """Pose at which the torques of elastic effects are taken; None if no such effect is fitted or no choice was
    made."""
    unexplained: Unexplained
    repeatability: Repeatability | None
    """Scatter of the joints; None if it is not significant beside the noise."""
    explained_share: float | None
    """Share of the baseline's held-out variance above noise and repeatability that the findings explain."""
    steps: tuple[SelectionStep, ...]
    missing: dict[str, str]
    detection: tuple[DetectionLimit, ...]
    """Detection limits of these poses, beside the findings."""
    n_folds: int
    next_poses: tuple[Advice, ...]
    """Poses that distinguish a finding from its nearest rival."""
    warnings: tuple[str, ...]
    residuals: Residuals
    """Residuals of every pose, outliers included."""
    holdout: Residuals | None
    """Residuals of the poses of ``holdout``, if given."""


def trace(
    model: Model,
    data: Measurements,
    *,
    n_folds: int = 5,
    seed: int = 0,
    holdout: Measurements | None = None,
    empirical: bool = True,
    progress: Progress = lambda stage, done, total: None,
) -> Trace:
    """Search for effects on measured poses and report them with held-out errors.

    ``model`` holds the robot and the declared effects. Held-out figures are by cross-validation of the complete search,
    or of the poses ``holdout``.

    Raises:
        InputError: the data contain a mistake that no effect should explain, or are too few.
        UsageError: the data lack a quantity that a declared effect needs.
    """
    refuse_mistake(model.arm.robot, data)
    progress("searching", 0, n_folds + 1)
    search_result = search(model, data, SEARCH, empirical=empirical)
    validation = cross_validate(search_result, data, holdout, n_folds, seed, empirical, progress)
    loop = _reproduced(search_result, validation, data)
    validation = reduced(validation, search_result, loop, data, holdout, n_folds, seed)
    loop, validation, withdrawn = _with_gain(loop, validation, data, holdout, n_folds, seed)
    converged = dataclasses.replace(Options(), scatter=loop.options.scatter, misfit=loop.options.misfit)
    declared, form = choose_form(loop.declared, loop.declared.model, data, converged)
    final, form = _polished(loop, data, converged) if loop.effects else (declared, form)
    noise = lack_of_fit(final, data)
    coefficients = parameters(with_mass_uncertainty(final, data))
    findings = tuple(describe_finding(loop, effect, final, coefficients, validation, data) for effect in loop.effects)
    repeatability = None if loop.components is None else repeatability_of(final, loop.components, data)
    unexplained = _left(loop, final, noise, data, repeatability)
    ends = None if validation is None else (validation.before, validation.after)
    stages = before_and_after(model.arm.robot, data, declared, final, ends, holdout, n_folds, seed)
    return Trace(
        robot=apply_fit(final),
        verdict=(verdict := _verdict(findings, unexplained)),
        assumption=_assumption(verdict, noise),
        declared=declared,
        final=final,
        noise=noise,
        nominal_unregistered=stages.nominal_unregistered,
        nominal=stages.nominal,
        before=stages.before,
        after=stages.after,
        gain=stages.gain if findings else None,
        parameters=coefficients,
        findings=findings,
        deflection=form,
        unexplained=unexplained,
        repeatability=repeatability,
        explained_share=_explained_share(stages.before, stages.after, noise, repeatability),
        steps=loop.steps,
        missing=loop.candidates.missing,
        detection=_detection(loop, validation),
        n_folds=0 if validation is None else validation.folds,
        next_poses=_advice(loop, findings, data, noise.noise.position, seed),
        warnings=(
            *convergence_warning(final),
            *mass_warning(final),
            *data.warnings,
            *data.contradicted_ids(),
            *([no_held_out_warning(data)] if validation is None else []),
            *_withdrawn_warning(withdrawn),
            *outliers_warning(final, data),
            *frames_warning(declared, data),
            *sigma_warning(noise),
            *weak_parameters_warning(final),
            *condition_warning(declared),
        ),
        residuals=stages.residuals,
        holdout=stages.holdout,
    )


def _withdrawn_warning(withdrawn: Sequence[str]) -> tuple[str, ...]:
    if not withdrawn:
        return ()
    names = ", ".join(withdrawn)
    return (f"withdrawn, because the error of held-out poses is not lower with the effect than without: {names}",)


def _reproduced(loop: SearchResult, validation: CrossValidation | None, data: Measurements) -> SearchResult:
    """Return the search without findings that recur in fewer than half of the folds.

    Such findings are accidental, or would increase the error of other poses. In their place come effects that at least
    half of the folds chose instead. Findings that are superfluous among the others go too.
    """
    effects, selection = loop.effects, dataclasses.replace(loop.selection, steps=[])
    if validation is not None and validation.folds:
        recurring = tuple(effect for effect in effects if 2 * validation.chosen[effect.key()] >= validation.folds)
        if recurring != effects:
            effects = (*recurring, *_chosen_instead(loop.effects, validation))
            start = [effect for effect in effects if not effect.is_frame]
            selection = loop.final_candidates.selection(np.ones(data.n, dtype=bool), start)
    selection.chosen = list(selection.chosen)
    selection.prune()
    keys = {choice.candidate.effect.search_key() for choice in selection.chosen}
    effects = tuple(effect for effect in effects if effect.is_frame or effect.search_key() in keys)
    if effects == loop.effects:
        return loop
    steps = (*loop.steps, *selection.steps)
    return _with_effects(dataclasses.replace(loop, selection=selection, steps=steps), effects, data)


def _chosen_instead(findings: Sequence[Effect], validation: CrossValidation) -> tuple[Effect, ...]:
    """Return the effects that at least half of the folds chose and that are none of the findings."""
    count: dict[tuple[object, ...], int] = {}
    first: dict[tuple[object, ...], Effect] = {}
    for effects in validation.all_effects:
        for effect in sorted(effects, key=str):
            if not any(finding.is_same_finding(effect) for finding in findings):
                count[effect.search_key()] = count.get(effect.search_key(), 0) + 1
                first.setdefault(effect.search_key(), effect)
    return tuple(first[key] for key, folds in count.items() if 2 * folds >= validation.folds)


def _with_gain(
    loop: SearchResult,
    validation: CrossValidation | None,
    data: Measurements,
    holdout: Measurements | None,
    n_folds: int,
    seed: int,
) -> tuple[SearchResult, CrossValidation | None, tuple[str, ...]]:
    """Withdraw findings that do not lower the error of held-out poses by more than its uncertainty.

    The weakest goes first and the others are tested again; at the end all findings together must have a gain. Return
    the remaining search, its cross-validation, and the withdrawn findings as text.
    """
    withdrawn: list[str] = []
    judged = data if holdout is None else holdout
    while validation is not None and loop.effects:
        weight = loop.final.weight if holdout is None else None
        scores = {
            effect: gain_score(validation.without[effect.key()], validation.after, judged, weight)
            for effect in loop.effects
            if effect.key() in validation.without
        }
        weakest = min(scores, key=lambda effect: scores[effect], default=None)
        if weakest is not None and scores[weakest] < LEAST_GAIN:
            effects: tuple[Effect, ...] = tuple(effect for effect in loop.effects if effect != weakest)
            withdrawn.append(str(weakest))
        elif gain_score(validation.before, validation.after, judged, weight) < LEAST_GAIN:
            effects = ()
            withdrawn.extend(str(effect) for effect in loop.effects)
        else:
            break
        remaining_search = _with_effects(loop, effects, data)
        validation = reduced(validation, loop, remaining_search, data, holdout, n_folds, seed)
        loop = remaining_search
    return loop, validation, tuple(withdrawn)


def _with_effects(loop: SearchResult, effects: tuple[Effect, ...], data: Measurements) -> SearchResult:
    """Return the search with only ``effects`` of its findings, fitted together."""
    keys = {effect.search_key() for effect in effects}
    chosen = [choice for choice in loop.selection.chosen if choice.candidate.effect.search_key() in keys]
    selection = dataclasses.replace(loop.selection, chosen=chosen, steps=[])
    free = (*loop.declared.model.free, *frames_first(effects))
    final = refit(loop.final, free, data, loop.options) if effects else loop.declared
    return dataclasses.replace(loop, effects=effects, final=final, selection=selection)


def _polished(loop: SearchResult, data: Measurements, options: Options) -> tuple[Fit, DeflectionChoice | None]:
    """Return the final fit at full convergence, with elastic effects in the form that the data support.

    A fit with shrunk blocks is returned unchanged.
    """
    if loop.final.group_stds:
        return loop.final, None
    model = loop.declared.model.with_free(*frames_first(loop.effects))
    fit = refit(loop.final, model.free, data, options)
    return choose_form(fit, model, data, options)


def _advice(
    loop: SearchResult, findings: Sequence[Finding], data: Measurements, noise: float, seed: int
) -> tuple[Advice, ...]:
    advice = []
    for effect, finding in zip(loop.effects, findings, strict=True):
        if finding.alternatives and loop.final.theta.size <= _MOST_TO_ADVISE:
            nearest = finding.alternatives[0]
            rival = rival_effect(nearest.effect, nearest.joints, nearest.settings)
            poses_to_measure = advise(loop.declared, loop.effects, effect, rival, data, noise, seed)
            if poses_to_measure is not None:
                advice.append(poses_to_measure)
    return tuple(advice)


def _detection(loop: SearchResult, validation: CrossValidation | None) -> tuple[DetectionLimit, ...]:
    rows = loop.selection.scorer.rows
    share = rows.size / np.count_nonzero(loop.final.inliers)
    folds = 0 if validation is None else validation.folds
    return tuple(detection_limits(loop.selection, loop.final.weight[:, rows], folds, share))


def _verdict(findings: Sequence[Finding], left: Unexplained) -> Verdict:
    if not findings:
        return "unexplained" if left.structured else "clean"
    named = any(finding.effect != "joint_correction" for finding in findings)
    plausible = all(finding.implausible is None for finding in findings)
    return "explained" if named and plausible and not left.structured else "partly_explained"


def _assumption(verdict: Verdict, noise: LackOfFit) -> str | None:
    """Return what the verdict presumes of a noise that only the residual gives; None if it is known or not used."""
    if noise.p_value is not None or verdict not in ("clean", "explained"):
        return None
    return (
        f"{verdict} if the measurement noise is {1e3 * noise.noise.position:.2g} mm along each axis (standard "
        "deviation); sigma columns or repeated poses would test this"
    )


def _explained_share(
    before: Stage, after: Stage, noise: LackOfFit, repeatability: Repeatability | None
) -> float | None:
    """Return the share of the explainable held-out variance of the baseline that the findings explain, 0 to 1."""
    if before.held_out is None or after.held_out is None:
        return None
    floor = 3.0 * noise.noise.position**2 + (0.0 if repeatability is None else repeatability.position**2)
    total = before.held_out.position.rms**2 - floor
    if total <= 0.0:
        return None
    share = (before.held_out.position.rms**2 - after.held_out.position.rms**2) / total
    return float(min(max(share, 0.0), 1.0))


def _scatter_hints(repeatability: Repeatability | None) -> tuple[str, ...]:
    """Return hints on scatter of the joints that is too large, or too repeatable, for repeatability."""
    if repeatability is None:
        return ()
    hints = []
    if repeatability.source == "residual" and repeatability.position > _MOST_REPEATABILITY:
        hints.append(
            f"the joints scatter by {1e3 * repeatability.position:.3g} mm rms at the target, more than an arm's "
            "repeatability: an effect outside the catalogue, or a payload or load that was not recorded; "
            "measure some poses repeatedly to distinguish these"
        )
    if repeatability.pose_position > max(repeatability.position, _SMALL_POSE_ERROR):
        hints.append(
            f"all visits of a pose share an error of {1e3 * repeatability.pose_position:.3g} mm rms that no candidate "
            "explains"
        )
    return tuple(hints)


def _left(
    loop: SearchResult, final: Fit, noise: LackOfFit, data: Measurements, repeatability: Repeatability | None
) -> Unexplained:
    ranking = loop.selection.rank(with_blocks=True)
    best = ranking[0] if ranking else None
    p_value = 1.0 if best is None else best.p_value
    hints = []
    if best is not None and p_value <= FALSE_ALARM:
        hints.append(f"the remaining error follows {best.candidate.effect}, which does not explain it")
        absent = [name for name in _OF_EVERY_ARM if all(effect.name != name for effect in loop.declared.model.free)]
        if absent:
            hints.append(
                f"every arm deviates in {' and '.join(absent)} too, which were not declared: "
                f"`declared={','.join(absent)}` beside the declared effects may explain it"
            )
    structured = p_value <= FALSE_ALARM
    for correlation in residual_correlations(final, data):
        structured, p_value = True, min(p_value, correlation.p_value)
        hints.append(correlation.text)
    if scatter := _scatter_hints(repeatability):
        structured = True
        hints.extend(scatter)
    pattern = outlier_pattern(data, ~final.inliers, final.model.arm.names)
    if pattern is not None:
        structured = True
        hints.append(pattern.text)
    share = final.outliers.size / data.n
    if share > _MANY_OUTLIERS:
        structured = True
        hints.append(f"{final.outliers.size} of {data.n} rows ({100 * share:.0f} %) are outliers: too many for chance")
    known = noise.p_value is not None
    residual = final.residual[:3, final.inliers]
    rms = float(np.sqrt(np.mean(np.sum(np.square(residual), axis=0))))
    unconfirmed = not known and (repeatability is None or repeatability.source == "residual")
    if unconfirmed and loop.effects and rms > _MOST_PRESUMED:
        structured = True
        hints.append(
            f"the remaining error, {1e3 * rms:.3g} mm rms, is more than usual instrument noise and repeatability; "
            "neither sigma columns nor repeated poses confirm it, so part of it may have a cause outside the model"
        )
    if noise.p_value is not None and noise.p_value <= FALSE_ALARM:
        structured = True
        p_value = min(p_value, noise.p_value)
        hints.append(
            f"the residual is {noise.ratio:.3g} times the measurement noise (known from "
            f"{'repeats' if noise.noise.source == 'repeats' else 'the file'})"
        )
        if best is not None and best.p_value > FALSE_ALARM:
            hints.append("nothing that was tried depends on it: repeatability, or an effect outside the catalogue")
    return Unexplained(
        rms,
        math.sqrt(3) * noise.noise.position if known else None,
        structured,
        p_value,
        tuple(hints),
    )
