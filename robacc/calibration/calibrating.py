"""Calibration: fit the named effects and report the error before and after, on held-out poses too."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.accuracy.stages import Stage, default_frames
from robacc.diagnostics.data_mistakes import check_data
from robacc.diagnostics.partial_residuals import PartialResidual, partial_residuals
from robacc.effects.base import Effect, effect_class
from robacc.effects.request import CONSTANTS, Request, build
from robacc.error_model.structure import DirectionalNoise, with_error_structure
from robacc.fitting.fit_result import Fit, Identifiability, Options
from robacc.fitting.held_out import HoldOut
from robacc.fitting.masses import DeflectionChoice, choose_form
from robacc.fitting.parameters import Correlation, correlations, high_leverage
from robacc.fitting.priors import ShrunkKind, shrink_to_nominal
from robacc.fitting.registration import ALIGNABLE, with_gravity_direction
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.tracing.judging import Judged, Progress, judge, with_directional_weights
from robacc.tracing.refitting import refit
from robacc.tracing.search import search

# Effects that a calibration fits, and its fits with and without shrinkage to the nominal values.


@dataclass(frozen=True)
class CalibrationPlan:
    """Requested effects: fixed effects are fitted as given, searched effects on the joints with evidence."""

    robot: Robot
    requests: Sequence[Request]
    priors: Mapping[str, float]
    """Standard deviation about zero, rad or m, by coefficient name; empty without priors."""
    shrink: bool
    """Constants that are requested for all joints are shrunk to nominal where there are no priors."""

    def searched(self, data: Measurements) -> tuple[Effect, ...]:
        """Return the searched effects on the joints with evidence."""
        requests = [request for request in self.requests if is_searched(request)]
        if not requests:
            return ()
        build(requests, Arm.of(self.robot), data)
        return search(Model.of(self.robot, self.fixed(data)), data, only=[r.name for r in requests]).effects

    def fixed(self, data: Measurements) -> tuple[Effect, ...]:
        """Return the effects that are fitted as requested."""
        return build([request for request in self.requests if not is_searched(request)], Arm.of(self.robot), data)

    def with_priors(self, options: Options, effects: Sequence[Effect], data: Measurements) -> Options:
        """Return ``options`` with the priors, infinite for coefficients without a prior."""
        if not self.priors:
            return options
        arm = Arm.of(self.robot)
        names = [term.name for effect in effects for term in effect.terms(arm, data)]
        return dataclasses.replace(options, priors=np.array([self.priors.get(name, np.inf) for name in names]))

    def unshrunk(
        self, effects: tuple[Effect, ...], data: Measurements, options: Options, near: Fit | None = None
    ) -> tuple[Fit, DeflectionChoice | None]:
        """Return the fit of all effects, with the torque model of elastic effects that the data support.

        Without explicit priors, idle rotations are removed. ``near`` is a fit of the same effects to start from.
        """
        model, options = Model.of(self.robot, effects), self.with_priors(options, effects, data)
        fitted = fit(model, data, options) if near is None else refit(near, effects, data, options)
        return choose_form(fitted, model, data, options)

    def shrunk(self, chosen: Fit, data: Measurements, options: Options) -> tuple[Fit, tuple[ShrunkKind, ...]]:
        """Return the fit with constants shrunk to nominal, unless there are priors or the plan has no shrinkage."""
        if self.priors or not self.shrink:
            return chosen, ()
        requested = (request.name for request in self.requests if request.joints is None)
        return shrink_to_nominal(chosen, data, options, [name for name in requested if name in CONSTANTS])


def is_searched(request: Request) -> bool:
    """Return whether the joints of the requested effect are chosen by evidence."""
    cls = effect_class(request.name)
    return request.joints is None and cls.traits.per_joint and not cls.traits.is_constant


@dataclass(frozen=True)
class Calibration(Judged):
    """Calibrated robot, its fit and its error before and after."""

    effects: tuple[Effect, ...]
    shrunk: tuple[ShrunkKind, ...]
    """Constants with shrinkage to the nominal values, by kind; their standard errors come from the data alone."""
    correlations: tuple[Correlation, ...]
    identifiability: Identifiability
    leverage: tuple[tuple[int, float], ...]
    """Rows with high leverage: index and share."""
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
    n_folds: int | None = None,
    seed: int = 0,
    holdout: Measurements | None = None,
    progress: Progress = lambda step, done, total: None,
) -> Calibration:
    """Fit the effects that ``requests`` name.

    A per-joint effect that is requested without joints is fitted on the joints where the evidence supports it, as in
    `trace`; with joints in brackets, it is fitted on exactly those. ``priors`` are standard deviations about zero by
    coefficient name, in SI units (as :mod:`robacc.fitting.priors` gives them). Without them, ``shrink`` applies
    shrinkage to nominal to constants of the arm that are requested without joints (:mod:`robacc.fitting.priors`).
    Held-out figures are those of ``holdout``, of each place of the poses in turn, or of ``n_folds`` parts of them.

    Raises:
        InputError: The data contain a mistake, or there are too few poses.
        UsageError: An effect cannot be fitted to this robot and these data.
    """
    plan = CalibrationPlan(robot, requests, priors or {}, shrink)

    def run(weighted: Measurements) -> tuple[Calibration, DirectionalNoise | None]:
        how = HoldOut.of(weighted, holdout, n_folds, seed)
        return _calibrate(plan, weighted, options or Options(), how, progress)

    return with_directional_weights(run, data, holdout)


def _calibrate(
    plan: CalibrationPlan, data: Measurements, options: Options, how: HoldOut, progress: Progress
) -> tuple[Calibration, DirectionalNoise | None]:
    """Return the result of :func:`calibrate`, and noise that is larger along one direction than along others."""
    stated, mistakes = plan.robot, check_data(plan.robot, data)
    robot = with_gravity_direction(Model.of(stated, plan.fixed(data)), data).arm.robot
    plan = dataclasses.replace(plan, robot=robot)
    progress("fitting", 0, 1)
    effects = (*plan.fixed(data), *plan.searched(data))
    unshrunk, deflection = plan.unshrunk(effects, data, options)

    def refitted(scattered: Options) -> Fit:
        nonlocal deflection
        again, deflection = plan.unshrunk(effects, data, scattered, unshrunk)
        return again

    structure = with_error_structure(unshrunk, data, options, refitted)
    final, shrunk = plan.shrunk(structure.fit, data, structure.options)
    structure = dataclasses.replace(structure, fit=final)
    effects = final.model.free
    frames = tuple(effect for effect in effects if effect.traits.is_frame)
    registered = fit(Model.of(robot, frames), data, Options(robust=options.robust))
    keys = [{effect.key() for effect in some} for some in (frames, default_frames(robot, data))]
    is_nominal = options.robust and keys[0] == keys[1]
    judged = judge(stated, mistakes, registered, structure, deflection, data, how, is_nominal=is_nominal)
    warnings = (
        *judged.warnings,
        *_request_warnings(plan.requests, final, judged.nominal, judged.after),
        *structure.warnings,
    )
    result = Calibration(
        **vars(dataclasses.replace(judged, warnings=warnings)),
        effects=effects,
        shrunk=shrunk,
        correlations=correlations(final),
        identifiability=final.identifiability,
        leverage=high_leverage(final),
        partial_residuals=tuple(
            (effect, curve)
            for effect in effects
            if not effect.traits.is_constant
            for curve in partial_residuals(effect, final, data)
        ),
    )
    return result, structure.directional


def _request_warnings(requests: Sequence[Request], final: Fit, registered: Stage, after: Stage) -> Iterator[str]:
    """Yield a warning about requested effects that no joint shows, and about frames that were not fitted."""
    names = {effect.name for effect in final.model.free}
    unsupported = [request.name for request in requests if is_searched(request) and request.name not in names]
    if unsupported:
        yield (
            f"no joint shows {' or '.join(unsupported)} on these poses, so it is not fitted; joints in brackets, as "
            f"in {unsupported[0]}[{final.model.arm.names[0]}], fit it all the same"
        )
    frames = [name for name in ALIGNABLE if name not in names]
    if frames and after.fitted.position.rms > registered.fitted.position.rms:
        yield (
            f"the calibrated model is worse ({1e3 * after.fitted.position.rms:.3g} mm rms) than the nominal model with "
            f"base and tool registered ({1e3 * registered.fitted.position.rms:.3g} mm): add {','.join(frames)} to `fit`"
        )
