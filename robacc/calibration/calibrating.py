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
from robacc.error_model.structure import with_error_structure
from robacc.fitting.fit_result import Fit, Identifiability, Options
from robacc.fitting.held_out import HoldOut
from robacc.fitting.masses import choose_form
from robacc.fitting.parameters import Correlation, correlations, high_leverage
from robacc.fitting.priors import ShrunkKind, shrink_to_nominal
from robacc.fitting.registration import ALIGNABLE, with_gravity_direction
from robacc.fitting.solver import fit, refit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.tracing.judging import Judged, Progress, judge, with_directional_weights
from robacc.tracing.search import search


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

    def run(weighted: Measurements) -> Calibration:
        how = HoldOut.of(weighted, holdout, n_folds, seed)
        return _calibrate(robot, requests, weighted, options or Options(), priors or {}, shrink, how, progress)

    return with_directional_weights(run, data, holdout)


def _calibrate(
    stated: Robot,
    requests: Sequence[Request],
    data: Measurements,
    options: Options,
    priors: Mapping[str, float],
    shrink: bool,
    how: HoldOut,
    progress: Progress,
) -> Calibration:
    """Return the result of :func:`calibrate` with weights as the poses have them."""
    mistakes = check_data(stated, data)
    fixed = build([request for request in requests if not is_searched(request)], Arm.of(stated), data)
    robot = with_gravity_direction(Model.of(stated, fixed), data).arm.robot
    progress("fitting", 0, 1)
    effects = (*fixed, *_searched(Model.of(robot, fixed), requests, data))
    model = Model.of(robot, effects)
    if priors:
        names = [term.name for effect in effects for term in effect.terms(model.arm, data)]
        options = dataclasses.replace(options, priors=np.array([priors.get(name, np.inf) for name in names]))
    unshrunk, deflection = choose_form(fit(model, data, options), model, data, options)

    def refitted(scattered: Options) -> Fit:
        nonlocal deflection
        again, deflection = choose_form(refit(unshrunk, effects, data, scattered), model, data, scattered)
        return again

    structure = with_error_structure(unshrunk, data, options, refitted)
    final, shrunk = structure.fit, tuple[ShrunkKind, ...]()
    if shrink and not priors:
        everywhere = [request.name for request in requests if request.joints is None and request.name in CONSTANTS]
        final, shrunk = shrink_to_nominal(final, data, structure.options, everywhere)
    structure = dataclasses.replace(structure, fit=final)
    effects = final.model.free
    frames = tuple(effect for effect in effects if effect.traits.is_frame)
    registered = fit(Model.of(robot, frames), data, Options(robust=options.robust))
    keys = [{effect.key() for effect in some} for some in (frames, default_frames(robot, data))]
    is_nominal = options.robust and keys[0] == keys[1]
    judged = judge(stated, mistakes, registered, structure, deflection, data, how, is_nominal=is_nominal)
    kept = final.identifiability.columns
    warnings = (
        *judged.warnings,
        *_request_warnings(requests, final, judged.nominal, judged.after),
        *structure.warnings,
    )
    return Calibration(
        **vars(dataclasses.replace(judged, warnings=warnings)),
        effects=effects,
        shrunk=shrunk,
        correlations=correlations([final.names[i] for i in kept], final.covariance[np.ix_(kept, kept)]),
        identifiability=final.identifiability,
        leverage=high_leverage(final),
        partial_residuals=tuple(
            (effect, curve)
            for effect in effects
            if not effect.traits.is_constant
            for curve in partial_residuals(effect, final, data)
        ),
    )


def _searched(model: Model, requests: Sequence[Request], data: Measurements) -> tuple[Effect, ...]:
    """Return the searched effects on the joints with evidence; ``model`` has the others."""
    searched = [request for request in requests if is_searched(request)]
    if not searched:
        return ()
    build(searched, model.arm, data)  # An effect that cannot be fitted is an error.
    return search(model, data, only=[request.name for request in searched]).effects


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
