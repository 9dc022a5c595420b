"""`robacc trace`: search, cross-validation, findings, rivals, error before and after, and remaining error."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence

from robacc.accuracy.before_after import before_and_after
from robacc.accuracy.stages import Stage
from robacc.diagnostics.data_mistakes import check_data
from robacc.diagnostics.moved_frames import MovedFrames, larger_error_warning, moved_frames
from robacc.diagnostics.read_back_share import read_back_warning
from robacc.diagnostics.rounded_joints import evident_rounding
from robacc.diagnostics.suspected_mistakes import suspected_mistakes
from robacc.effects.base import Effect
from robacc.error_model.structure import DirectionalNoise, with_error_structure
from robacc.fitting.apply_fit import apply_fit
from robacc.fitting.cross_validation import HoldOut
from robacc.fitting.deflection_model import DeflectionChoice, choose_form
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.gravity_direction import gravity_warning, with_gravity_direction
from robacc.fitting.mass_uncertainty import mass_warning, with_mass_uncertainty
from robacc.fitting.noise import LackOfFit, lack_of_fit
from robacc.fitting.parameters import parameter_covariance, parameters
from robacc.fitting.places import places_warning
from robacc.fitting.solver import fit
from robacc.fitting.undeclared_load import undeclared_load
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
from robacc.tracing.advice import Advice, advise, rival_effect
from robacc.tracing.cross_validation import Progress, cross_validate
from robacc.tracing.detection import detection_limits
from robacc.tracing.directional_weights import with_directional_weights
from robacc.tracing.findings import Finding, describe_finding
from robacc.tracing.refitting import frames_first, refit
from robacc.tracing.remaining_error import remaining_error
from robacc.tracing.search import search
from robacc.tracing.trace_result import Trace
from robacc.tracing.verdict import assumption_of, explained_share, verdict_of

_MOST_TO_ADVISE = 200
"""Coefficients beyond which rivals are not fitted to choose the next poses."""


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

    ``model`` holds the robot and the declared effects. Held-out figures are by cross-validation of the models with the
    effects that all poses show, or of the poses ``holdout``.

    Raises:
        InputError: the data contain a mistake that no effect should explain, or are too few.
        UsageError: the data lack a quantity that a declared effect needs.
    """

    def run(weighted: Measurements) -> tuple[Trace, DirectionalNoise | None]:
        return _trace(model, weighted, HoldOut(holdout, n_folds, seed), empirical, progress)

    return with_directional_weights(run, data, holdout)


def _trace(
    model: Model, data: Measurements, how: HoldOut, empirical: bool, progress: Progress
) -> tuple[Trace, DirectionalNoise | None]:
    """Return the result of :func:`trace`, and noise that is larger along one direction than along others."""
    mistakes = check_data(model.arm.robot, data)
    stated = model.arm.robot.gravity
    model = with_gravity_direction(model, data)
    declared, form = choose_form(fit(model, data), model, data, Options())
    found = search(model, data, progress=lambda moves, count: progress(_search_label(count), 0, how.n_folds + 1))
    identified = [i for i in found.identified if empirical or not i.effect.is_profile()]
    effects = [i.effect for i in identified]
    final = declared
    if effects:
        extended = model.with_free(*frames_first(effects))
        final, form = _fitted(refit(declared, extended.free, data, Options()), extended, data)
    refitted = functools.partial(refit, final, final.model.free, data)
    structured = with_error_structure(final, data, Options(), refitted, tuple(found.noise.terms))
    final, repeatability = structured.fit, structured.repeatability
    validation = cross_validate(declared, final, effects, data, how, progress)
    noise = lack_of_fit(final, data)
    with_masses = with_mass_uncertainty(final, data)
    coefficients = parameters(with_masses)
    findings = tuple(describe_finding(i, effects, final, coefficients, validation, data) for i in identified)
    rounding = evident_rounding(final, data)
    unexplained = remaining_error(found, effects, final, noise, data, structured, rounding)
    ends = None if validation is None else (validation.before, validation.after)
    stages = before_and_after(model.arm.robot, data, declared, final, ends, how)
    moved = None if how.validation is None else moved_frames(declared, how.validation)
    result = Trace(
        robot=apply_fit(final),
        verdict=(verdict := verdict_of(findings, unexplained)),
        assumption=assumption_of(verdict, noise, repeatability),
        declared=declared,
        final=final,
        noise=noise,
        nominal_unregistered=stages.nominal_unregistered,
        nominal=stages.nominal,
        before=stages.before,
        after=stages.after,
        gain=stages.gain if findings else None,
        parameters=coefficients,
        covariance=parameter_covariance(with_masses),
        findings=findings,
        deflection=form,
        undeclared_load=undeclared_load(final, data),
        unexplained=unexplained,
        repeatability=repeatability,
        explained_share=explained_share(stages.before, stages.after, noise, repeatability),
        steps=found.steps,
        settled=found.settled,
        missing=found.pool.missing,
        detection=tuple(detection_limits(found)),
        n_folds=0 if validation is None else validation.folds,
        next_poses=_advice(declared, final, effects, findings, data, noise.noise.position, how.seed),
        warnings=(
            *mistakes,
            *gravity_warning(stated, model.arm.robot.gravity),
            *_warnings_of_fits(declared, final, noise, data),
            *([no_held_out_warning(data)] if validation is None else []),
            *([] if how.validation is None else _holdout_warnings(moved, stages.after)),
            *([] if rounding is None else [rounding.warning]),
        ),
        residuals=stages.residuals,
        holdout=stages.holdout,
    )
    return result, structured.directional


def _fitted(fitted: Fit, model: Model, data: Measurements) -> tuple[Fit, DeflectionChoice | None]:
    """Return a fit with its elastic effects in the form that the data support; with shrunk blocks as it is."""
    return (fitted, None) if fitted.group_stds else choose_form(fitted, model, data, Options())


def _holdout_warnings(moved: MovedFrames | None, after: Stage) -> Iterator[str]:
    """Return a warning of validation poses whose frames moved, or whose error is much larger for another reason."""
    if moved is not None:
        yield moved.warning
    elif after.held_out is not None:
        warning = larger_error_warning(after.fitted.position.rms, after.held_out.position.rms)
        yield from [] if warning is None else [warning]


def _warnings_of_fits(declared: Fit, final: Fit, noise: LackOfFit, data: Measurements) -> tuple[str, ...]:
    """Return the warnings of the two fits and of their data."""
    return (
        *suspected_mistakes(final),
        *convergence_warning(final),
        *mass_warning(final),
        *data.warnings,
        *data.contradicted_ids(),
        *places_warning(data),
        *outliers_warning(final, data),
        *read_back_warning(final, data),
        *frames_warning(declared, data),
        *sigma_warning(noise),
        *weak_parameters_warning(final),
        *condition_warning(declared),
    )


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
