"""`robacc trace`: the whole loop with its honest figures: findings, rivals, before and after, and what is left."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.effects.base import Effect
from robacc.effects.transmission_error import TransmissionError
from robacc.errors import RobaccError
from robacc.figures import Gain, Residuals, Stage, paired_gain, pose_figures
from robacc.fitting import Fit, Options, fit
from robacc.folding import fold
from robacc.measurements import Measurements
from robacc.model import Model, predict
from robacc.noise import LackOfFit, lack_of_fit
from robacc.observation import residuals
from robacc.parameters import Parameter, parameters
from robacc.parsimony import without_idle_rotations
from robacc.robots.description import Robot
from robacc.tracing.advice import Advice, advise, rival_effect
from robacc.tracing.competition import Chosen, Ranked
from robacc.tracing.curves import Curve, curves
from robacc.tracing.held_out import Held, Progress, frames_first, hold_out
from robacc.tracing.lines import Line, fitted_lines, profile_lines
from robacc.tracing.loop import SEARCH, Loop, close_loop, coarse
from robacc.tracing.mistakes import refuse_mistake
from robacc.tracing.selection import FALSE_ALARM, RIVAL, Selection, Step

Verdict = Literal["clean", "explained", "partly_explained", "unexplained"]

_MOST_TO_ADVISE = 200
"""Coefficients beyond which rivals are not fitted to find the poses that would decide."""
_FEW = 8
"""A finding whose gain rests for more than half on fewer rows than this is said to rest on few poses."""
_MOST_ALTERNATIVES = 4


@dataclass(frozen=True, slots=True)
class Alternative:
    """A rival that explains the same residual nearly as well."""

    effect: str
    joints: tuple[str, ...]
    likeness: float
    """Cosine between what the two take out of the residual: 1 where these poses cannot tell them apart at all."""
    evidence_lag: float
    """Nats by which its evidence is behind the finding's; negative where it is ahead."""
    settings: dict[str, object]


@dataclass(frozen=True, slots=True)
class Finding:
    """One effect that the model lacked."""

    effect: str
    joints: tuple[str, ...]
    settings: dict[str, object]
    alternatives: tuple[Alternative, ...]
    p_value: float
    """Corrected for everything that competed."""
    evidence: float
    held_out_before: float | None
    """Held-out position rms without it, m; None where too few poses to hold any out."""
    held_out_after: float | None
    chosen_again: tuple[int, int]
    """In how many of how many folds it was chosen again without the poses held out."""
    parameters: tuple[Parameter, ...]
    lines: tuple[Line, ...]
    seen: tuple[tuple[str, float, float], ...]
    """Joint ranges that it was learnt in: name, low, high (rad or m)."""
    warnings: tuple[str, ...]
    curves: tuple[Curve, ...]
    """The residual along it over what drives it, without and with it."""


@dataclass(frozen=True, slots=True)
class Unexplained:
    """What is left after the findings."""

    rms: float
    """Of the fitted residual's length, m."""
    noise_rms: float | None
    """Of the measuring noise's length where it is known from file or repeats, m."""
    structured: bool
    p_value: float
    hints: tuple[str, ...]


@dataclass(frozen=True)
class Trace:
    """What `robacc trace` found."""

    robot: Robot
    """With the findings written into it."""
    verdict: Verdict
    declared: Fit
    final: Fit
    noise: LackOfFit
    nominal: Stage
    before: Stage
    after: Stage
    gain: Gain | None
    findings: tuple[Finding, ...]
    unexplained: Unexplained
    steps: tuple[Step, ...]
    missing: dict[str, str]
    n_folds: int
    next_poses: tuple[Advice, ...]
    """What to measure to decide between a finding and its nearest rival."""
    warnings: tuple[str, ...]
    residuals: Residuals
    """Of every pose, those left out as outliers too."""
    apart: Residuals | None
    """Of the poses of ``holdout``, where there are such."""


def trace(
    model: Model,
    data: Measurements,
    *,
    n_folds: int = 5,
    seed: int = 0,
    holdout: Measurements | None = None,
    empirical: bool = True,
    progress: Progress = lambda what, done, of: None,
) -> Trace:
    """Close the loop on measured poses.

    ``model`` holds the robot and the declared effects. Held-out figures are by cross-fitting of the whole procedure, or
    of ``holdout``, poses of their own.

    Raises:
        InputError: the data hold a mistake that no effect should explain, or are too few.
        UsageError: the data lack what a declared effect needs.
    """
    refuse_mistake(model.arm.robot, data)
    progress("searching", 0, n_folds + 1)
    loop = close_loop(model, data, SEARCH, empirical=empirical)
    held = hold_out(loop, data, holdout, n_folds, seed, empirical, progress)
    loop = _reproduced(loop, held, data)
    declared = without_idle_rotations(loop.declared, loop.declared.model, data, Options())
    final = _polished(loop, data) if loop.effects else declared
    nominal_residual = residuals(data, predict(model.arm.robot, data))
    noise = lack_of_fit(final, data)
    findings = tuple(_finding(loop, effect, final, held, data) for effect in loop.effects)
    unexplained = _left(loop, final, noise, data)
    rows = loop.final.kept
    shown = data if holdout is None else holdout
    kept = rows if holdout is None else np.ones(holdout.n, dtype=bool)
    held_nominal = residuals(holdout, predict(model.arm.robot, holdout)) if holdout is not None else nominal_residual
    after_held = None if held is None else pose_figures(held.after[:, kept])
    return Trace(
        robot=fold(final),
        verdict=_verdict(findings, unexplained),
        declared=declared,
        final=final,
        noise=noise,
        nominal=Stage(
            pose_figures(nominal_residual[:, rows]), None if held is None else pose_figures(held_nominal[:, kept])
        ),
        before=Stage(
            pose_figures(declared.residual[:, rows]),
            None if held is None else pose_figures(held.before[:, kept]),
        ),
        after=Stage(pose_figures(final.residual[:, rows]), after_held),
        gain=None
        if held is None or not findings
        else paired_gain(held.before[:, kept], held.after[:, kept], shown.groups()[kept]),
        findings=findings,
        unexplained=unexplained,
        steps=loop.steps,
        missing=loop.scene.missing,
        n_folds=0 if held is None else held.folds,
        next_poses=_advice(loop, findings, data, noise.noise.position, seed),
        warnings=_warnings(final, data, held, holdout),
        residuals=Residuals(
            nominal_residual,
            declared.residual,
            final.residual,
            *((held.before, held.after) if held is not None and holdout is None else ()),
        ),
        apart=Residuals(held_nominal, held.before, held.after) if held is not None and holdout is not None else None,
    )


def _reproduced(loop: Loop, held: Held | None, data: Measurements) -> Loop:
    """The loop without findings that fewer than half of the folds chose again.

    What most parts of the poses do not show is there by chance, or would predict other poses worse.
    """
    if held is None or not held.folds:
        return loop
    effects = tuple(effect for effect in loop.effects if 2 * held.chosen[effect.key()] >= held.folds)
    if len(effects) == len(loop.effects):
        return loop
    keys = {coarse(effect) for effect in effects}
    loop.selection.chosen = [one for one in loop.selection.chosen if coarse(one.candidate.effect) in keys]
    final = fit(loop.declared.model.with_free(*frames_first(effects)), data, SEARCH) if effects else loop.declared
    return dataclasses.replace(loop, effects=effects, final=final)


def _polished(loop: Loop, data: Measurements) -> Fit:
    """The final fit to full convergence; shrunk blocks are left as the search found them."""
    if loop.final.widths:
        return loop.final
    model = loop.declared.model.with_free(*frames_first(loop.effects))
    found = fit(model, data, Options())
    return without_idle_rotations(found, model, data, Options())


def _advice(loop: Loop, findings: Sequence[Finding], data: Measurements, noise: float, seed: int) -> tuple[Advice, ...]:
    advice = []
    for effect, finding in zip(loop.effects, findings, strict=True):
        if finding.alternatives and loop.final.theta.size <= _MOST_TO_ADVISE:
            nearest = finding.alternatives[0]
            rival = rival_effect(nearest.effect, nearest.joints, nearest.settings)
            one = advise(loop.declared, loop.effects, effect, rival, data, noise, seed)
            if one is not None:
                advice.append(one)
    return tuple(advice)


def _verdict(findings: Sequence[Finding], left: Unexplained) -> Verdict:
    if not findings:
        return "unexplained" if left.structured else "clean"
    named = any(finding.effect != "joint_correction" for finding in findings)
    return "explained" if named and not left.structured else "partly_explained"


# -- findings


def _finding(loop: Loop, effect: Effect, final: Fit, held: Held | None, data: Measurements) -> Finding:
    one = next((c for c in loop.selection.chosen if coarse(c.candidate.effect) == coarse(effect)), None)
    if one is not None:
        own, rivals = loop.selection.contest(one)
        alternatives = _alternatives(loop.selection, one, own, rivals)
        p_value, evidence = own.p_value, own.evidence
    else:
        p_value, evidence, alternatives = _first_seen(loop.steps, effect)
    before = after = None
    if held is not None:
        rows = final.kept if held.folds else slice(None)
        before = pose_figures(held.without[effect.key()][:, rows]).position.rms
        after = pose_figures(held.after[:, rows]).position.rms
    number = final.model.free.index(effect)
    own_parameters = tuple(p for p, owner in zip(parameters(final), final.owners, strict=True) if owner == number)
    folds_chosen = (held.chosen.get(effect.key(), 0), held.folds) if held is not None else (0, 0)
    lines = _lines(loop, effect, one, own_parameters)
    return Finding(
        effect.name,
        effect.joints,
        effect.settings(),
        alternatives,
        p_value,
        evidence,
        before,
        after,
        folds_chosen,
        own_parameters,
        lines,
        _seen(effect, final, data),
        _finding_warnings(effect, final, data, folds_chosen),
        curves(effect, final, data),
    )


def _first_seen(steps: Sequence[Step], effect: Effect) -> tuple[float, float, tuple[Alternative, ...]]:
    """Score of a frame when it was added: it does not compete afterwards."""
    for step in steps:
        if step.action == "add" and step.ranking and step.ranking[0].candidate.effect.key() == effect.key():
            return step.ranking[0].p_value, step.ranking[0].evidence, ()
    return float("nan"), float("nan"), ()


def _alternatives(selection: Selection, one: Chosen, own: Ranked, rivals: Sequence[Ranked]) -> tuple[Alternative, ...]:
    """Rivals near in evidence, one of each effect and joint, with how alike what they explain is."""
    seen = {(one.candidate.effect.name, one.candidate.effect.joints)}
    found: list[Alternative] = []
    for rival in rivals:
        effect = rival.candidate.effect
        name = (effect.name, effect.joints)
        lag = own.total - rival.total
        if name in seen or lag > RIVAL or len(found) == _MOST_ALTERNATIVES:
            continue
        likeness = selection.likeness(one, rival.candidate)
        if likeness < 0.5:
            continue
        seen.add(name)
        found.append(Alternative(effect.name, effect.joints, likeness, lag, effect.settings()))
    return tuple(found)


def _lines(loop: Loop, effect: Effect, one: Chosen | None, own: Sequence[Parameter]) -> tuple[Line, ...]:
    """The strong lines of a periodic error."""
    if not isinstance(effect, TransmissionError):
        return ()
    return profile_lines(loop.selection, one) if effect.shrunk and one is not None else fitted_lines(effect, own)


def _seen(effect: Effect, final: Fit, data: Measurements) -> tuple[tuple[str, float, float], ...]:
    if data.q is None:
        return ()
    arm = final.model.arm
    return tuple(
        (joint, float(data.q[arm.number(joint)].min()), float(data.q[arm.number(joint)].max()))
        for joint in effect.joints
    )


def _finding_warnings(effect: Effect, final: Fit, data: Measurements, chosen: tuple[int, int]) -> tuple[str, ...]:
    warnings = []
    if chosen[1] and chosen[0] < 0.6 * chosen[1]:
        warnings.append(f"{effect} was chosen again in only {chosen[0]} of {chosen[1]} folds")
    few = _rests_on(effect, final, data)
    if few is not None:
        warnings.append(f"more than half of what {effect} explains rests on {few} poses")
    return tuple(warnings)


def _rests_on(effect: Effect, final: Fit, data: Measurements) -> int | None:
    """Number of poses that carry half of a finding's contribution, where they are few."""
    bound = final.model.bind(data)
    number = final.model.free.index(effect)
    lacking = np.where(np.array(final.owners) == number, 0.0, final.theta)
    try:
        moved = bound.poses(lacking).translation - final.poses.translation
    except RobaccError:
        return None
    share = np.sort(np.sum(np.square(moved[:, final.kept]), axis=0))[::-1]
    if share.sum() <= 0:
        return None
    count = int(np.searchsorted(np.cumsum(share) / share.sum(), 0.5)) + 1
    return count if count < min(_FEW, 0.1 * share.size) else None


# -- what is left


def _left(loop: Loop, final: Fit, noise: LackOfFit, data: Measurements) -> Unexplained:
    ranking = loop.selection.rank(with_blocks=True)
    best = ranking[0] if ranking else None
    p_value = 1.0 if best is None else best.p_value
    hints = []
    if best is not None and p_value <= FALSE_ALARM:
        hints.append(f"what is left depends on what {best.candidate.effect} describes, yet that does not explain it")
    structured = p_value <= FALSE_ALARM
    known = noise.p_value is not None
    if noise.p_value is not None and noise.p_value <= FALSE_ALARM:
        structured = True
        p_value = min(p_value, noise.p_value)
        hints.append(
            f"the residual is {noise.ratio:.3g} times the measuring noise (known from "
            f"{'repeats' if noise.noise.source == 'repeats' else 'the file'})"
        )
        if best is not None and best.p_value > FALSE_ALARM:
            hints.append("nothing that was tried depends on it: repeatability, or an effect outside the catalogue")
    residual = final.residual[:3, final.kept]
    return Unexplained(
        float(np.sqrt(np.mean(np.sum(np.square(residual), axis=0)))),
        math.sqrt(3) * noise.noise.position if known else None,
        structured,
        p_value,
        tuple(hints),
    )


def _warnings(final: Fit, data: Measurements, held: Held | None, holdout: Measurements | None) -> tuple[str, ...]:
    warnings = list(data.warnings)
    if held is None:
        warnings.append(f"{data.n} poses are too few to hold any out: every figure is of poses that were fitted")
    if final.outliers.size:
        lines = ", ".join(str(data.line(int(i))) for i in final.outliers[:10])
        warnings.append(f"left out as no part of the rest: {final.outliers.size} row(s), on line(s) {lines}")
    return tuple(warnings)
