"""`robacc trace`: search, cross-validation, findings, rivals, error before and after, and remaining error."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.accuracy.before_after import before_and_after
from robacc.accuracy.stages import Stage
from robacc.diagnostics.data_mistakes import check_data
from robacc.diagnostics.moved_frames import MovedFrames, larger_error_warning
from robacc.diagnostics.read_back_share import read_back_warning
from robacc.diagnostics.rounded_joints import evident_rounding
from robacc.diagnostics.suspected_mistakes import suspected_mistakes
from robacc.fitting.apply_fit import apply_fit
from robacc.fitting.cross_validation import HoldOut
from robacc.fitting.deflection_model import DeflectionChoice, choose_form
from robacc.fitting.directional_noise import DirectionalNoise, NoiseAndScatter, noise_and_scatter
from robacc.fitting.error_structure import StructuredFit, with_error_structure
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
from robacc.tracing.confirmation import significant_given_structure
from robacc.tracing.confirmed_search import ConfirmedSearch, confirmed_search, validated_again
from robacc.tracing.cross_validation import CrossValidation, Progress
from robacc.tracing.detection import DetectionLimit, detection_limits
from robacc.tracing.directional_weights import with_directional_weights
from robacc.tracing.findings import Finding, describe_finding
from robacc.tracing.loop import SearchResult
from robacc.tracing.refitting import frames_first, refit
from robacc.tracing.remaining_error import remaining_error
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
        return _trace(model, weighted, HoldOut(holdout, n_folds, seed), empirical, progress)

    return with_directional_weights(run, data, holdout)


@dataclass(frozen=True)
class _Fits:
    """Fits of the declared effects and of all effects at full convergence."""

    declared: Fit
    final: Fit
    form: DeflectionChoice | None
    """Form of elastic effects that the data support."""
    structured: StructuredFit
    """The final fit, allowing for the structure of its errors."""


def _trace(
    model: Model, data: Measurements, how: HoldOut, empirical: bool, progress: Progress
) -> tuple[Trace, DirectionalNoise | None]:
    """Return the result of :func:`trace`, and noise that is larger along one direction than along others."""
    mistakes = check_data(model.arm.robot, data)
    stated = model.arm.robot.gravity
    model = with_gravity_direction(model, data)
    confirmed, fits = _significant(confirmed_search(model, data, how, empirical, progress), data, how)
    apart = noise_and_scatter(fits.final, _repeatability(confirmed.search_result, fits.final, data), data)
    warnings = (*mistakes, *gravity_warning(stated, model.arm.robot.gravity))
    result = _result(model, confirmed, fits, apart, data, how, warnings)
    return result, apart.noise_unless(fits.structured.shared)


def _significant(confirmed: ConfirmedSearch, data: Measurements, how: HoldOut) -> tuple[ConfirmedSearch, _Fits]:
    """Return the findings that are significant given the structure of the remaining errors, and their fits.

    Warnings list those that are withdrawn.
    """
    fits = _fits(confirmed.search_result, data)
    kept, withdrawn = significant_given_structure(confirmed.search_result, fits.final, fits.structured.inflation, data)
    if not withdrawn:
        return confirmed, fits
    validation = validated_again(kept, confirmed.validation, data, how)
    warnings = (*confirmed.warnings, *withdrawn)
    return ConfirmedSearch(kept, validation, confirmed.moved, warnings), _fits(kept, data)


def _result(
    model: Model,
    confirmed: ConfirmedSearch,
    fits: _Fits,
    apart: NoiseAndScatter,
    data: Measurements,
    how: HoldOut,
    warnings: tuple[str, ...],
) -> Trace:
    """Return the result of the confirmed findings and their fits; ``warnings`` come before all others."""
    search_result, validation = confirmed.search_result, confirmed.validation
    structured, final = fits.structured, fits.structured.fit
    noise, repeatability = apart.noise, apart.repeatability
    with_masses = with_mass_uncertainty(final, data)
    coefficients = parameters(with_masses)
    findings = tuple(
        describe_finding(search_result, effect, final, coefficients, structured.inflation, validation, data)
        for effect in search_result.effects
    )
    rounding = evident_rounding(final, data)
    unexplained = remaining_error(search_result, final, noise, data, repeatability, rounding, structured.shared)
    ends = None if validation is None else (validation.before, validation.after)
    stages = before_and_after(model.arm.robot, data, fits.declared, final, ends, how)
    return Trace(
        robot=apply_fit(final),
        verdict=(verdict := verdict_of(findings, unexplained)),
        assumption=assumption_of(verdict, noise, repeatability),
        declared=fits.declared,
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
        deflection=fits.form,
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
        next_poses=_advice(search_result, findings, data, noise.noise.position, how.seed),
        warnings=(
            *warnings,
            *_warnings_of_fits(fits.declared, final, noise, data),
            *([no_held_out_warning(data)] if validation is None else []),
            *([] if how.validation is None else _holdout_warnings(confirmed.moved, stages.after)),
            *confirmed.warnings,
            *([] if rounding is None else [rounding.warning]),
            *apart.warnings_if(structured.shared),
            *structured.warnings,
        ),
        residuals=stages.residuals,
        holdout=stages.holdout,
    )


def _holdout_warnings(moved: MovedFrames | None, after: Stage) -> Iterator[str]:
    """Return a warning of validation poses whose frames moved, or whose error is much larger for another reason."""
    if moved is not None:
        yield moved.warning
    elif after.held_out is not None:
        warning = larger_error_warning(after.fitted.position.rms, after.held_out.position.rms)
        yield from [] if warning is None else [warning]


def _fits(search_result: SearchResult, data: Measurements) -> _Fits:
    """Return the fits of a search at full convergence."""
    declared, final, form = _final_fits(search_result, data)
    return _Fits(declared, final, form, with_error_structure(final, data))


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
