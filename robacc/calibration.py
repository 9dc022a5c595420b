"""Calibration: fit the named effects and report the error before and after, on held-out poses too."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.accuracy.before_after import before_and_after
from robacc.accuracy.stages import Gain, Residuals, Stage
from robacc.diagnostics.data_mistakes import check_data
from robacc.diagnostics.partial_residuals import PartialResidual, partial_residuals
from robacc.diagnostics.read_back_share import read_back_warning
from robacc.diagnostics.rounded_joints import rounding_warning
from robacc.diagnostics.suspected_mistakes import suspected_mistakes
from robacc.effects.base import Effect, effect_class
from robacc.effects.request import Request, build
from robacc.errors import InputError
from robacc.fitting.apply_fit import apply_fit
from robacc.fitting.correlated_errors import correlated_errors, with_correlated_errors
from robacc.fitting.cross_validation import folds, held_out, parts
from robacc.fitting.deflection_model import DeflectionChoice, choose_deflection, with_deflection
from robacc.fitting.fit_repeatability import Repeatability, measured_alone, repeatability_of, settle_scatter
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.identifiability import Identifiability
from robacc.fitting.leverage import high_leverage
from robacc.fitting.mass_uncertainty import mass_warning, with_mass_uncertainty
from robacc.fitting.noise import LackOfFit, lack_of_fit
from robacc.fitting.parameters import (
    Correlation,
    FittedParameter,
    ParameterCovariance,
    correlations,
    parameter_covariance,
    parameters,
)
from robacc.fitting.parsimony import without_idle_rotations
from robacc.fitting.places import places, places_warning
from robacc.fitting.registration import ALIGNABLE
from robacc.fitting.scatter_check import NO_SCATTER, contradicts_scatter, with_scatter_covariance
from robacc.fitting.solver import fit
from robacc.fitting.sparse_prior import ShrunkKind, shrink_to_nominal
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
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.tracing.cross_validation import Progress
from robacc.tracing.loop import search

_CONSTANTS = ("joint_offset", "link_geometry")
"""Effects whose coefficients all have a nominal value in the robot file."""
_OVERFIT_RATIO = 1.5
"""Ratio of the held-out RMS error to the fitted RMS error above which a warning is given."""


@dataclass(frozen=True)
class Calibration:
    """Calibrated robot, its fit and its error before and after."""

    robot: Robot
    effects: tuple[Effect, ...]
    fit: Fit
    noise: LackOfFit
    repeatability: Repeatability | None
    """Scatter of the joints; None if it is not significant beside the noise."""
    nominal_unregistered: Stage
    """The nominal model as it stands in the robot file."""
    nominal: Stage
    """The nominal model, registered: base and tool frames fitted as far as the poses allow."""
    before: Stage
    """Baseline: the model with base and tool registered if the fit includes them, else the nominal model."""
    after: Stage
    gain: Gain | None
    parameters: tuple[FittedParameter, ...]
    """Coefficients; their standard errors come from the data alone, with or without shrinkage."""
    covariance: ParameterCovariance
    shrunk: tuple[ShrunkKind, ...]
    """Constants with shrinkage to the nominal values, by kind."""
    deflection: DeflectionChoice | None
    """Model of the torques behind elastic effects; None if no elastic effect is fitted."""
    correlations: tuple[Correlation, ...]
    identifiability: Identifiability
    leverage: tuple[tuple[int, float], ...]
    """Rows with high leverage: index and share."""
    n_folds: int
    warnings: tuple[str, ...]
    residuals: Residuals
    """Residuals of all poses, outliers included."""
    holdout: Residuals | None
    """Residuals of the validation poses ``holdout``; None without them."""
    partial_residuals: tuple[tuple[Effect, PartialResidual], ...]
    """Partial residual over its driver of each effect that is not a constant."""


def calibrate(
    robot: Robot,
    data: Measurements,
    requests: Sequence[Request],
    *,
    options: Options | None = None,
    priors: Mapping[str, float] | None = None,
    shrink: bool = True,
    n_folds: int = 5,
    seed: int = 0,
    holdout: Measurements | None = None,
    progress: Progress = lambda step, done, total: None,
) -> Calibration:
    """Fit the effects that ``requests`` name.

    A per-joint effect that is requested without joints is fitted on the joints where the evidence supports it, as in
    `trace`; with joints in brackets, it is fitted on exactly those. ``priors`` are standard deviations about zero by
    coefficient name, in SI units (as :mod:`robacc.fitting.tolerances` gives them). Without them, ``shrink`` applies
    shrinkage to nominal to constants of the arm that are requested without joints (:mod:`robacc.fitting.sparse_prior`).

    Raises:
        InputError: The data contain a mistake, or there are too few poses.
        UsageError: An effect cannot be fitted to this robot and these data.
    """
    mistakes = check_data(robot, data)
    options = options or Options()
    plan = _Plan(robot, data, requests, options, priors or {}, shrink)
    progress("fitting", 0, n_folds + 1)
    effects = plan.effects(data)
    unshrunk, deflection = _unshrunk(plan, effects, data, options)
    scattered_options, components = settle_scatter(
        unshrunk, data, options, lambda scattered: _unshrunk(plan, effects, data, scattered)[0]
    )
    is_scatter = True
    if components is not None:
        weighted = _unshrunk(plan, effects, data, scattered_options)
        is_scatter = not contradicts_scatter(unshrunk, weighted[0], components, data)
        if is_scatter:
            options, (unshrunk, deflection) = scattered_options, weighted
        else:
            unshrunk = with_scatter_covariance(unshrunk, components, data)
    correlated = correlated_errors(unshrunk, data)
    unshrunk = with_correlated_errors(unshrunk, correlated)
    plan = dataclasses.replace(plan, options=options)
    final_fit, shrunk = _shrunk(plan, unshrunk, data, options)
    repeatability = None if components is None else repeatability_of(final_fit, components, data)
    if not is_scatter:
        repeatability = measured_alone(repeatability)
    effects = final_fit.model.free
    frames = tuple(effect for effect in effects if effect.is_frame)
    registered = fit(Model.of(robot, frames), data, Options(robust=options.robust))
    held_out_residuals = _hold_out(plan, data, holdout, effects, frames, n_folds, seed, progress)
    comparison = before_and_after(robot, data, registered, final_fit, held_out_residuals, holdout, n_folds, seed)
    noise = lack_of_fit(final_fit, data)
    with_masses = with_mass_uncertainty(final_fit, data)
    return Calibration(
        robot=apply_fit(final_fit),
        effects=effects,
        fit=final_fit,
        noise=noise,
        repeatability=repeatability,
        nominal_unregistered=comparison.nominal_unregistered,
        nominal=comparison.nominal,
        before=comparison.before,
        after=comparison.after,
        gain=comparison.gain,
        parameters=parameters(with_masses),
        covariance=parameter_covariance(with_masses),
        shrunk=shrunk,
        deflection=deflection,
        correlations=correlations(final_fit),
        identifiability=final_fit.identifiability,
        leverage=high_leverage(final_fit, data),
        n_folds=0 if held_out_residuals is None or holdout is not None else min(n_folds, int(places(data).max()) + 1),
        warnings=(
            *mistakes,
            *places_warning(data),
            *few_places_warning(final_fit, data),
            *_warnings(final_fit, data, comparison.after, noise),
            *_request_warnings(requests, final_fit, comparison.nominal, comparison.after),
            *([] if is_scatter else [NO_SCATTER]),
            *([] if correlated is None else [correlated.warning]),
        ),
        residuals=comparison.residuals,
        holdout=comparison.holdout,
        partial_residuals=tuple(
            (effect, curve)
            for effect in effects
            if not effect.is_constant
            for curve in partial_residuals(effect, final_fit, data)
        ),
    )


@dataclass(frozen=True)
class _Plan:
    """Requested effects: fixed effects are fitted as given, searched effects on the joints with evidence."""

    robot: Robot
    data: Measurements
    requests: Sequence[Request]
    options: Options
    priors: Mapping[str, float]
    shrink: bool

    def effects(self, data: Measurements) -> tuple[Effect, ...]:
        """Return the effects for these poses: the fixed effects, then the searched effects."""
        model = Model.of(self.robot)
        fixed = [request for request in self.requests if not _is_searched(request)]
        searched = [request for request in self.requests if _is_searched(request)]
        effects = build(fixed, model.arm, data)
        if searched:
            build(searched, model.arm, data)
            search_result = search(Model.of(self.robot, effects), data, only=[request.name for request in searched])
            effects = (*effects, *search_result.effects)
        return effects

    def with_priors(self, options: Options, effects: Sequence[Effect], data: Measurements) -> Options:
        """Return ``options`` with the priors, infinite for coefficients without a prior."""
        if not self.priors:
            return options
        arm = Arm.of(self.robot)
        names = [term.name for effect in effects for term in effect.terms(arm, data)]
        return dataclasses.replace(options, priors=np.array([self.priors.get(name, np.inf) for name in names]))

    @property
    def all_joint_constants(self) -> tuple[str, ...]:
        """Names of constants that are requested for all joints."""
        return tuple(request.name for request in self.requests if request.name in _CONSTANTS and request.joints is None)


def _fitted(plan: _Plan, effects: tuple[Effect, ...], data: Measurements, options: Options) -> Fit:
    """Fit all effects, with constants shrunk to nominal as the plan says."""
    return _shrunk(plan, _unshrunk(plan, effects, data, options)[0], data, options)[0]


def _unshrunk(
    plan: _Plan, effects: tuple[Effect, ...], data: Measurements, options: Options
) -> tuple[Fit, DeflectionChoice | None]:
    """Fit all effects, with the torque model of elastic effects that the data support.

    Without explicit priors, idle rotations are removed.
    """
    model, options = Model.of(plan.robot, effects), plan.with_priors(options, effects, data)
    chosen, model, deflection = choose_deflection(fit(model, data, options), model, data, options)
    if plan.priors:
        return chosen, deflection
    return without_idle_rotations(chosen, model, data, options), deflection


def _shrunk(plan: _Plan, chosen: Fit, data: Measurements, options: Options) -> tuple[Fit, tuple[ShrunkKind, ...]]:
    """Return the fit with constants shrunk to nominal, unless there are given priors or the plan has no shrinkage."""
    if plan.priors or not plan.shrink:
        return chosen, ()
    return shrink_to_nominal(chosen, data, options, plan.all_joint_constants)


def _is_searched(request: Request) -> bool:
    """Return whether the joints of the requested effect are chosen by evidence."""
    cls = effect_class(request.name)
    return request.joints is None and cls.per_joint and not cls.is_constant


def _hold_out(
    plan: _Plan,
    data: Measurements,
    holdout: Measurements | None,
    effects: tuple[Effect, ...],
    frames: tuple[Effect, ...],
    n_folds: int,
    seed: int,
    progress: Progress,
) -> tuple[Array, Array] | None:
    """Return the residuals of held-out poses, with frames only and with all effects; None if there are too few poses.

    Searched effects are chosen anew in each fold.
    """
    fold_options = dataclasses.replace(plan.options, tolerance=1e-6)
    if holdout is not None:
        baseline = fit(Model.of(plan.robot, frames), data, fold_options)
        extended = _fitted(plan, effects, data, fold_options)
        return held_out(baseline, holdout), held_out(extended, holdout)
    assigned = folds(data, n_folds, seed)
    if assigned is None:
        return None
    components = 3 if data.rotation is None else 6
    before, after = np.empty((components, data.n)), np.empty((components, data.n))
    has_search = any(_is_searched(request) for request in plan.requests)
    try:
        for number, (training, test) in enumerate(parts(assigned), 1):
            progress("cross-fitting", number, n_folds + 1)
            train_data, test_data = data.subset(np.flatnonzero(training)), data.subset(np.flatnonzero(test))
            chosen = plan.effects(train_data) if has_search else with_deflection(effects, "equilibrium")
            before[:, test] = held_out(fit(Model.of(plan.robot, frames), train_data, fold_options), test_data)
            after[:, test] = held_out(_fitted(plan, chosen, train_data, fold_options), test_data)
    except InputError:
        # The poses outside a fold are too few for the fitted coefficients.
        return None
    return before, after


def _request_warnings(requests: Sequence[Request], final_fit: Fit, registered: Stage, after: Stage) -> Iterator[str]:
    """Return a warning about requested effects that no joint shows, and about frames that were not fitted."""
    names = {effect.name for effect in final_fit.model.free}
    unsupported = [request.name for request in requests if _is_searched(request) and request.name not in names]
    if unsupported:
        yield (
            f"no joint shows {' or '.join(unsupported)} on these poses, so it is not fitted; joints in brackets, as "
            f"in {unsupported[0]}[{final_fit.model.arm.names[0]}], fit it all the same"
        )
    frames = [name for name in ALIGNABLE if name not in names]
    if frames and after.fitted.position.rms > registered.fitted.position.rms:
        yield (
            f"the calibrated model is worse ({1e3 * after.fitted.position.rms:.3g} mm rms) than the nominal model with "
            f"base and tool registered ({1e3 * registered.fitted.position.rms:.3g} mm): add {','.join(frames)} to `fit`"
        )


def _warnings(final_fit: Fit, data: Measurements, after: Stage, noise: LackOfFit) -> tuple[str, ...]:
    warnings = [
        *convergence_warning(final_fit),
        *mass_warning(final_fit),
        *data.warnings,
        *data.contradicted_ids(),
        *outliers_warning(final_fit, data),
        *rounding_warning(final_fit, data),
        *read_back_warning(final_fit, data),
        *suspected_mistakes(final_fit),
        *frames_warning(final_fit, data),
    ]
    warnings.extend((*sigma_warning(noise), *weak_parameters_warning(final_fit)))
    n_coefficients = int(final_fit.identifiability.columns.size)
    surplus = int(np.count_nonzero(final_fit.inliers)) * final_fit.residual.shape[0] - n_coefficients
    if surplus < n_coefficients:
        warnings.append(f"only {surplus} more measured values than fitted coefficients: measure more poses")
    warnings.extend(condition_warning(final_fit))
    if after.held_out is not None and after.held_out.position.rms > _OVERFIT_RATIO * after.fitted.position.rms:
        warnings.append(
            "error on held-out poses is much larger than on calibration poses: fit fewer effects or measure more poses"
        )
    if after.held_out is None:
        warnings.append(no_held_out_warning(data))
    return tuple(warnings)
