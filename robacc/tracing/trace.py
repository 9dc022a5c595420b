"""`robacc trace`: search, findings, rivals, error before and after, and remaining error."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.diagnostics.data_mistakes import check_data
from robacc.effects.base import Effect
from robacc.effects.request import CONSTANTS
from robacc.error_model.structure import DirectionalNoise, correction_of_position, with_error_structure
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.held_out import HoldOut
from robacc.fitting.masses import DeflectionChoice, UndeclaredLoad, choose_form, undeclared_load
from robacc.fitting.priors import shrink_to_nominal
from robacc.fitting.registration import with_gravity_direction
from robacc.fitting.solver import fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.tracing.detection import Advice, DetectionLimit, advise, detection_limits, rival_effect
from robacc.tracing.findings import (
    Finding,
    Unexplained,
    Verdict,
    assumption_of,
    describe_finding,
    explained_share,
    number_of,
    remaining_error,
    verdict_of,
)
from robacc.tracing.judging import Judged, Progress, judge, with_directional_weights
from robacc.tracing.refitting import frames_first, refit
from robacc.tracing.search import Identified, Ranked, SearchStep, search

# Record of the result of `robacc trace`.


@dataclass(frozen=True)
class Trace(Judged):
    """Result of `robacc trace`; without findings there is no gain."""

    verdict: Verdict
    assumption: str | None
    """What the verdict presumes where the noise is known from the residual alone."""
    declared: Fit
    findings: tuple[Finding, ...]
    undeclared_load: UndeclaredLoad | None
    """Whether the torques point to a load on one link; None unless masses are uncertain."""
    unexplained: Unexplained
    explained_share: float | None
    """Share of the baseline's held-out variance above noise and repeatability that the findings explain."""
    steps: tuple[SearchStep, ...]
    settled: bool
    """Whether the search ended because no move gained."""
    missing: dict[str, str]
    detection: tuple[DetectionLimit, ...]
    """Detection limits of these poses, given the findings."""
    next_poses: tuple[Advice, ...]
    """Poses that distinguish a finding from its nearest rival."""


_MOST_TO_ADVISE = 200
"""Coefficients beyond which rivals are not fitted to choose the next poses."""


def trace(
    model: Model,
    data: Measurements,
    *,
    n_folds: int | None = None,
    seed: int = 0,
    holdout: Measurements | None = None,
    empirical: bool = True,
    progress: Progress = lambda stage, done, total: None,
) -> Trace:
    """Search for effects on measured poses and report them with held-out errors.

    ``model`` holds the robot and the declared effects. Held-out figures are of models with the effects that all poses
    show, fitted without the pose: those of ``holdout``, of each place in turn, or of ``n_folds`` parts of the places.

    Raises:
        InputError: the data contain a mistake that no effect should explain, or are too few.
        UsageError: the data lack a quantity that a declared effect needs.
    """

    def run(weighted: Measurements) -> tuple[Trace, DirectionalNoise | None]:
        how = HoldOut.of(weighted, holdout, n_folds, seed)
        return _trace(model, weighted, how, empirical, seed, progress)

    return with_directional_weights(run, data, holdout)


def _trace(
    model: Model, data: Measurements, how: HoldOut, empirical: bool, seed: int, progress: Progress
) -> tuple[Trace, DirectionalNoise | None]:
    """Return the result of :func:`trace`, and noise that is larger along one direction than along others."""
    stated, mistakes = model.arm.robot, check_data(model.arm.robot, data)
    model = with_gravity_direction(model, data)
    declared, declared_form = choose_form(fit(model, data), model, data, Options())
    found = search(model, data, progress=lambda moves, count: progress(_search_label(count), 0, 1))
    identified = [i for i in found.identified if empirical or not i.effect.is_profile()]
    own_places = HoldOut.of(data, None, None, seed)
    final, form = _fitted(declared, declared_form, identified, model, data)
    while (useless := _useless(final, identified, own_places)) is not None:
        identified.remove(useless)
        final, form = _fitted(declared, declared_form, identified, model, data)
    if empirical and (left := correction_of_position(final, data, found.noise)) is not None:
        correction = Identified(left[0], Ranked(left[0], left[1], -left[2], 0.0))
        corrected, corrected_form = _fitted(declared, declared_form, [*identified, correction], model, data)
        if _useless(corrected, [correction], own_places) is None:
            identified.append(correction)
            final, form = corrected, corrected_form
    effects = [one.effect for one in identified]
    refitted = functools.partial(refit, final, final.model.free, data)
    structured = with_error_structure(final, data, Options(), refitted, tuple(found.noise.terms))
    arm = model.arm
    constants = [one.name for one in model.free if one.name in CONSTANTS and one.joints == one.possible_joints(arm)]
    final, _ = shrink_to_nominal(structured.fit, data, structured.options, constants)
    before = shrink_to_nominal(declared, data, Options(), constants)[0] if identified else final
    structured, repeatability = dataclasses.replace(structured, fit=final), structured.repeatability
    numbers = [number_of(effect, final) for effect in effects]
    fitted_effects = [final.model.free[number] for number in numbers]
    judged = judge(stated, mistakes, before, structured, form, data, how, fitted_effects)
    without = how.residuals(final, [[number] for number in numbers])
    findings = tuple(
        describe_finding(one, effects, judged, residual, data)
        for one, residual in zip(identified, without, strict=True)
    )
    noise = judged.noise
    unexplained = remaining_error(found, findings, final, noise, data, structured, judged.rounding)
    result = Trace(
        **vars(judged if findings else dataclasses.replace(judged, gain=None)),
        verdict=(verdict := verdict_of(findings, unexplained)),
        assumption=assumption_of(verdict, noise, repeatability),
        declared=declared,
        findings=findings,
        undeclared_load=undeclared_load(final, data),
        unexplained=unexplained,
        explained_share=explained_share(judged.before, judged.after, noise, repeatability),
        steps=found.steps,
        settled=found.settled,
        missing=found.pool.missing,
        detection=tuple(detection_limits(found)),
        next_poses=_advice(declared, final, effects, findings, data, noise.noise.position, seed),
    )
    return result, structured.directional


def _fitted(
    declared: Fit, form: DeflectionChoice | None, identified: Sequence[Identified], model: Model, data: Measurements
) -> tuple[Fit, DeflectionChoice | None]:
    """Return the fit with the identified effects, elastic ones in the form that the data support.

    ``declared`` is the fit without them, in the form ``form``. With shrunk blocks the form is that of equilibrium.
    """
    if not identified:
        return declared, form
    extended = model.with_free(*frames_first([one.effect for one in identified]))
    fitted = refit(declared, extended.free, data, Options())
    return (fitted, None) if fitted.group_stds else choose_form(fitted, extended, data, Options())


def _useless(fit: Fit, identified: Sequence[Identified], own_places: HoldOut) -> Identified | None:
    """Return the effect without which the poses, each held out in turn, are predicted best, if better than with it.

    The search looks at a part of a large set, and its likelihood knows only the structures of its terms: an error
    outside the catalogue may resemble an effect there and not elsewhere. On 632 poses of a UR10 (series D), a profile
    of the last joint of 7 log units raised the error of held-out poses. Rows have the weights of the noise alone: with
    scatter in them, which the fits share, a lag of an IRB 120 was taken for useless.
    """
    numbers = [[number_of(one.effect, fit)] for one in identified]
    whole, *without = own_places.residuals(fit, [(), *numbers]) if numbers else [None]
    if whole is None:
        return None
    costs = [np.inf if residual is None else _cost(fit, residual) for residual in without]
    best = int(np.argmin(costs))
    return identified[best] if costs[best] < _cost(fit, whole) else None


def _cost(fit: Fit, residual: Array) -> float:
    """Return the whitened sum of squares of held-out residuals ``(M, N)`` of the inliers."""
    return float(np.sum(np.square(fit.whitening.apply(residual * fit.inliers))))


def _advice(
    declared: Fit,
    final: Fit,
    effects: Sequence[Effect],
    findings: Sequence[Finding],
    data: Measurements,
    noise: float,
    seed: int,
) -> tuple[Advice, ...]:
    advice = []
    for effect, finding in zip(effects, findings, strict=True):
        if finding.alternatives and final.theta.size <= _MOST_TO_ADVISE:
            nearest = finding.alternatives[0]
            rival = rival_effect(nearest.effect, nearest.joints, nearest.settings)
            poses_to_measure = advise(declared, effects, effect, rival, data, noise, seed)
            if poses_to_measure is not None:
                advice.append(poses_to_measure)
    return tuple(advice)


def _search_label(n_findings: int) -> str:
    """Return the label of the search's progress."""
    return "searching" if not n_findings else f"searching, {n_findings} finding{'s' * (n_findings != 1)}"
