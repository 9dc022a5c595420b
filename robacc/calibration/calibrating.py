"""Calibration: fit the named effects and report the error before and after, on held-out poses too."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from robacc.accuracy.before_after import before_and_after
from robacc.accuracy.stages import Gain, Residuals, Stage
from robacc.calibration.final_fit import final_fit
from robacc.calibration.held_out import hold_out
from robacc.calibration.plan import CalibrationPlan
from robacc.calibration.warning import fit_warnings, request_warnings
from robacc.diagnostics.data_mistakes import check_data
from robacc.diagnostics.partial_residuals import PartialResidual, partial_residuals
from robacc.effects.base import Effect
from robacc.effects.request import Request
from robacc.error_model.structure import DirectionalNoise, Repeatability
from robacc.fitting.apply_fit import apply_fit
from robacc.fitting.cross_validation import HoldOut
from robacc.fitting.deflection_model import DeflectionChoice
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.gravity_direction import gravity_warning, with_gravity_direction
from robacc.fitting.identifiability import Identifiability
from robacc.fitting.leverage import high_leverage
from robacc.fitting.mass_uncertainty import with_mass_uncertainty
from robacc.fitting.noise import LackOfFit, lack_of_fit
from robacc.fitting.parameters import (
    Correlation,
    FittedParameter,
    ParameterCovariance,
    correlations,
    parameter_covariance,
    parameters,
)
from robacc.fitting.places import places, places_warning
from robacc.fitting.solver import fit
from robacc.fitting.sparse_prior import ShrunkKind
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.description import Robot
from robacc.tracing.cross_validation import Progress
from robacc.tracing.directional_weights import with_directional_weights


@dataclass(frozen=True)
class Calibration:
    """Calibrated robot, its fit and its error before and after."""

    robot: Robot
    effects: tuple[Effect, ...]
    fit: Fit
    noise: LackOfFit
    repeatability: Repeatability | None
    """Scatter of the joints; None if it is not significant given the noise."""
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
    plan = CalibrationPlan(robot, requests, priors or {}, shrink)
    how = HoldOut(holdout, n_folds, seed)

    def run(weighted: Measurements) -> tuple[Calibration, DirectionalNoise | None]:
        return _calibrate(plan, weighted, options or Options(), how, progress)

    return with_directional_weights(run, data, holdout)


def _calibrate(
    plan: CalibrationPlan, data: Measurements, options: Options, how: HoldOut, progress: Progress
) -> tuple[Calibration, DirectionalNoise | None]:
    """Return the result of :func:`calibrate`, and noise that is larger along one direction than along others."""
    robot, n_folds, holdout = plan.robot, how.n_folds, how.validation
    mistakes = check_data(robot, data)
    stated = robot.gravity
    robot = with_gravity_direction(Model.of(robot, plan.fixed(data)), data).arm.robot
    plan = dataclasses.replace(plan, robot=robot)
    progress("fitting", 0, n_folds + 1)
    final = final_fit(plan, (*plan.fixed(data), *plan.searched(data)), data, options)
    effects = final.fit.model.free
    frames = tuple(effect for effect in effects if effect.is_frame)
    registered = fit(Model.of(robot, frames), data, Options(robust=options.robust))
    held_out_residuals = hold_out(plan, final.structure.options, data, how, effects, progress)
    comparison = before_and_after(robot, data, registered, final.fit, held_out_residuals, how)
    noise, structure = lack_of_fit(final.fit, data), final.structure
    with_masses = with_mass_uncertainty(final.fit, data)
    result = Calibration(
        robot=apply_fit(final.fit),
        effects=effects,
        fit=final.fit,
        noise=noise,
        repeatability=structure.repeatability,
        nominal_unregistered=comparison.nominal_unregistered,
        nominal=comparison.nominal,
        before=comparison.before,
        after=comparison.after,
        gain=comparison.gain,
        parameters=parameters(with_masses),
        covariance=parameter_covariance(with_masses),
        shrunk=final.shrunk,
        deflection=final.deflection,
        correlations=correlations(final.fit),
        identifiability=final.fit.identifiability,
        leverage=high_leverage(final.fit, data),
        n_folds=0 if held_out_residuals is None or holdout is not None else min(n_folds, int(places(data).max()) + 1),
        warnings=(
            *mistakes,
            *gravity_warning(stated, robot.gravity),
            *places_warning(data),
            *fit_warnings(final.fit, data, comparison.after, noise, holdout),
            *request_warnings(plan.requests, final.fit, comparison.nominal, comparison.after),
            *structure.warnings,
        ),
        residuals=comparison.residuals,
        holdout=comparison.holdout,
        partial_residuals=tuple(
            (effect, curve)
            for effect in effects
            if not effect.is_constant
            for curve in partial_residuals(effect, final.fit, data)
        ),
    )
    return result, structure.directional
