"""`robacc trace`: search, cross-validation, findings, rivals, error before and after, and remaining error."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from robacc.accuracy.before_after import before_and_after
from robacc.accuracy.stages import Stage
from robacc.diagnostics.data_mistakes import check_data
from robacc.diagnostics.moved_frames import MovedFrames, held_out_frames, larger_error_warning, moved_frames
from robacc.diagnostics.read_back_share import read_back_warning
from robacc.diagnostics.rounded_joints import evident_rounding
from robacc.diagnostics.suspected_mistakes import suspected_mistakes
from robacc.fitting.apply_fit import apply_fit
from robacc.fitting.cross_validation import HoldOut
from robacc.fitting.deflection_model import DeflectionChoice, choose_form
from robacc.fitting.directional_noise import DirectionalNoise, noise_and_scatter
from robacc.fitting.error_structure import with_error_structure
from robacc.fitting.fit_repeatability import Repeatability, measured_alone, repeatability_of
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.gravity_direction import gravity_warning, with_gravity_direction
from robacc.fitting.mass_uncertainty import mass_warning, with_mass_uncertainty
from robacc.fitting.noise import LackOfFit
from robacc.fitting.parameters import parameter_covariance, parameters
from robacc.fitting.places import places_warning
from robacc.fitting.scatter_check import with_scatter_covariance
from robacc.fitting.undeclared_load import undeclared_load
from robacc.fitting.warnings import (
    condition_warning,
    convergence_warning,
    few_places_warning,
    frames_warning,
    no_held_out_warning,
    outliers_warning,
    sigma_warning,
    weak_parameters_warning,
)
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.tracing.advice import Advice, advise, rival_effect
from robacc.tracing.confirmation import reproduced, significant_given_structure, with_held_out_gain
from robacc.tracing.cross_validation import CrossValidation, Progress, cross_validate, fold_choices
from robacc.tracing.detection import DetectionLimit, detection_limits
from robacc.tracing.directional_weights import with_directional_weights
from robacc.tracing.equal_votes import with_equal_votes
from robacc.tracing.findings import Finding, describe_finding
from robacc.tracing.loop import SearchResult, search
from robacc.tracing.refitting import SEARCH, frames_first, refit
from robacc.tracing.remaining_error import remaining_error
from robacc.tracing.remaining_scatter import with_remaining_scatter, with_scatter_in_fits
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

    ``model`` holds the robot and the declared effects. Held-out figures are by cross-validation of the complete search,
    or of the poses ``holdout``.

    Raises:
        InputError: the data contain a mistake that no effect should explain, or are too few.
        UsageError: the data lack a quantity that a declared effect needs.
    """

    def run(weighted: Measurements) -> tuple[Trace, DirectionalNoise | None]:
        return _trace(model, weighted, n_folds, seed, holdout, empirical, progress)

    return with_directional_weights(run, data, holdout)


def _trace(
    model: Model,
    data: Measurements,
    n_folds: int,
    seed: int,
    holdout: Measurements | None,
    empirical: bool,
    progress: Progress,
) -> tuple[Trace, DirectionalNoise | None]:
    """Return the result of :func:`trace`, and noise that is larger along one direction than along others."""
    mistakes = check_data(model.arm.robot, data)
    stated = model.arm.robot.gravity
    model = with_gravity_direction(model, data)
    first_search = search(
        model,
        data,
        SEARCH,
        empirical=empirical,
        progress=lambda count, n_findings: progress(_search_label(count, n_findings), 0, n_folds + 1),
    )
    first_search = with_scatter_in_fits(first_search, data)
    search_result, validation = _confirmed(first_search, data, holdout, n_folds, seed, empirical, progress)
    moved = None if holdout is None else moved_frames(first_search.declared, holdout)
    frames = None if holdout is None or moved is None else held_out_frames(first_search.declared, holdout)
    search_result, validation, withdrawn = with_held_out_gain(
        search_result, validation, data, holdout, n_folds, seed, frames
    )
    confirmed = search_result
    search_result = with_remaining_scatter(first_search, confirmed, data)
    if search_result.effects != confirmed.effects:
        choices = None if validation is None else validation.choices
        validation = cross_validate(search_result, choices, data, holdout, n_folds, seed, earlier=validation)
    declared, final, form = _final_fits(search_result, data)
    structured = with_error_structure(final, data)
    significant, insignificant = significant_given_structure(search_result, final, structured.inflation, data)
    if insignificant:
        choices = None if validation is None else validation.choices
        validation = cross_validate(significant, choices, data, holdout, n_folds, seed, earlier=validation)
        search_result = significant
        declared, final, form = _final_fits(search_result, data)
        structured = with_error_structure(final, data)
    apart = noise_and_scatter(final, _repeatability(search_result, final, data), data)
    noise, repeatability = apart.noise, apart.repeatability
    final = structured.fit
    with_masses = with_mass_uncertainty(final, data)
    coefficients = parameters(with_masses)
    findings = tuple(
        describe_finding(search_result, effect, final, coefficients, structured.inflation, validation, data)
        for effect in search_result.effects
    )
    rounding = evident_rounding(final, data)
    unexplained = remaining_error(search_result, final, noise, data, repeatability, rounding, structured.shared)
    ends = None if validation is None else (validation.before, validation.after)
    stages = before_and_after(model.arm.robot, data, declared, final, ends, HoldOut(holdout, n_folds, seed))
    result = Trace(
        robot=apply_fit(final),
        verdict=(verdict := verdict_of(findings, unexplained)),
        assumption=assumption_of(verdict, noise, repeatability),
        declared=declared,
        final=final,
        predicting=structured.predicting,
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
        steps=search_result.steps,
        rounds=search_result.rounds,
        settled=search_result.settled,
        missing=search_result.candidates.pool.missing,
        detection=_detection(search_result, validation),
        n_folds=0 if validation is None else validation.folds,
        next_poses=_advice(search_result, findings, data, noise.noise.position, seed),
        warnings=(
            *mistakes,
            *gravity_warning(stated, model.arm.robot.gravity),
            *_warnings_of_fits(declared, final, noise, data),
            *([no_held_out_warning(data)] if validation is None else []),
            *([] if holdout is None else _holdout_warnings(moved, stages.after)),
            *withdrawn,
            *insignificant,
            *([] if rounding is None else [rounding.warning]),
            *apart.warnings_if(structured.shared),
            *structured.warnings,
        ),
        residuals=stages.residuals,
        holdout=stages.holdout,
    )
    return result, apart.noise_unless(structured.shared)


def _confirmed(
    first_search: SearchResult,
    data: Measurements,
    holdout: Measurements | None,
    n_folds: int,
    seed: int,
    empirical: bool,
    progress: Progress,
) -> tuple[SearchResult, CrossValidation | None]:
    """Return the search with the findings that recur in the folds, and its held-out residuals."""
    choices = fold_choices(first_search, data, n_folds, seed, empirical, progress) if holdout is None else None
    choices = None if choices is None else with_equal_votes(choices, first_search, data)
    search_result = reproduced(first_search, choices, data)
    is_whole = search_result.effects == first_search.effects and bool(first_search.effects)
    validation = cross_validate(search_result, choices, data, holdout, n_folds, seed, is_whole=is_whole)
    if validation is None and choices is not None:
        # No fold can be fitted, so that no fold says anything about the findings either.
        return reproduced(first_search, None, data), None
    return search_result, validation


def _holdout_warnings(moved: MovedFrames | None, after: Stage) -> Iterator[str]:
    """Return a warning of validation poses whose frames moved, or whose error is much larger for another reason."""
    if moved is not None:
        yield moved.warning
    elif after.held_out is not None:
        warning = larger_error_warning(after.fitted.position.rms, after.held_out.position.rms)
        yield from [] if warning is None else [warning]


def _search_label(count: int, n_findings: int) -> str:
    """Return the label of the search's progress in round ``count``."""
    findings = f", {n_findings} finding{'s' * (n_findings != 1)}" if count > 1 else ""
    return f"searching, round {count}{findings}"


def _final_fits(search_result: SearchResult, data: Measurements) -> tuple[Fit, Fit, DeflectionChoice | None]:
    """Return fits of the declared effects and of all effects at full convergence.

    Elastic effects are in the form that the data support; the choice is returned too. A fit with shrunk blocks is not
    repeated.
    """
    declared, form = choose_form(
        search_result.declared, search_result.declared.model, data, _converged(search_result.declared)
    )
    if not search_result.effects:
        components = search_result.components
        if components is not None and declared.scatter is None:
            # Errors that rows of a pose share are no scatter, but shared all the same.
            declared = with_scatter_covariance(declared, components, data)
        return declared, declared, form
    if search_result.final.group_stds:
        return declared, search_result.final, None
    model = search_result.declared.model.with_free(*frames_first(search_result.effects))
    converged = _converged(search_result.final)
    final, form = choose_form(refit(search_result.final, model.free, data, converged), model, data, converged)
    return declared, final, form


def _converged(fitted: Fit) -> Options:
    """Return the options of a fit to full convergence, weighted as ``fitted`` is."""
    if fitted.scatter is None:
        return Options()
    return dataclasses.replace(Options(), scatter=fitted.scatter, misfit=fitted.misfit)


def _repeatability(search_result: SearchResult, final: Fit, data: Measurements) -> Repeatability | None:
    """Return the scatter of the joints, apart from an error that no effect explains; None if it is not significant."""
    if search_result.components is None:
        return None
    repeatability = repeatability_of(final, search_result.components, data)
    return repeatability if final.scatter is not None else measured_alone(repeatability)


def _warnings_of_fits(declared: Fit, final: Fit, noise: LackOfFit, data: Measurements) -> tuple[str, ...]:
    """Return the warnings of the two fits and of their data."""
    return (
        *suspected_mistakes(final),
        *convergence_warning(final),
        *mass_warning(final),
        *data.warnings,
        *data.contradicted_ids(),
        *places_warning(data),
        *few_places_warning(final, data),
        *outliers_warning(final, data),
        *read_back_warning(final, data),
        *frames_warning(declared, data),
        *sigma_warning(noise),
        *weak_parameters_warning(final),
        *condition_warning(declared),
    )


def _advice(
    search_result: SearchResult, findings: Sequence[Finding], data: Measurements, noise: float, seed: int
) -> tuple[Advice, ...]:
    advice = []
    for effect, finding in zip(search_result.effects, findings, strict=True):
        if finding.alternatives and search_result.final.theta.size <= _MOST_TO_ADVISE:
            nearest = finding.alternatives[0]
            rival = rival_effect(nearest.effect, nearest.joints, nearest.settings)
            poses_to_measure = advise(search_result.declared, search_result.effects, effect, rival, data, noise, seed)
            if poses_to_measure is not None:
                advice.append(poses_to_measure)
    return tuple(advice)


def _detection(search_result: SearchResult, validation: CrossValidation | None) -> tuple[DetectionLimit, ...]:
    rows = search_result.selection.scorer.rows
    share = rows.size / np.count_nonzero(search_result.final.inliers)
    folds = 0 if validation is None else validation.folds
    return tuple(detection_limits(search_result.selection, search_result.final.weight[:, rows], folds, share))
