"""`robacc calibrate`: fit the effects that are named, with honest figures before and after."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.accuracy.before_after import before_and_after
from robacc.accuracy.stages import Gain, Residuals, Stage
from robacc.chain import BLOCK
from robacc.diagnostics.data_mistakes import refuse_mistake
from robacc.diagnostics.partial_residuals import PartialResidual, partial_residuals
from robacc.effects.base import Effect, effect_class
from robacc.effects.request import Request, build
from robacc.errors import InputError
from robacc.fitting.apply_fit import apply_fit
from robacc.fitting.cross_validation import folds, held_out, parts
from robacc.fitting.deflection_model import DeflectionChoice, choose_deflection, with_deflection
from robacc.fitting.gauss_newton import posterior
from robacc.fitting.identifiability import Identifiability
from robacc.fitting.noise import LackOfFit, lack_of_fit
from robacc.fitting.parameters import Correlation, FittedParameter, correlations, parameters
from robacc.fitting.parsimony import without_idle_rotations
from robacc.fitting.solver import Fit, Options, fit
from robacc.fitting.sparse_prior import ShrunkKind, shrink_to_nominal
from robacc.fitting.warnings import (
    condition_warning,
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
"""Effects that the robot file has a value of, for each of their coefficients."""
_OVERFIT = 1.5
"""Held-out rms over the fitted one beyond which a warning says so."""
_LEVERAGE = 0.5
"""A pose that decides more than this share of its own prediction is named."""


@dataclass(frozen=True)
class Calibration:
    """A calibrated robot and how well it predicts."""

    robot: Robot
    effects: tuple[Effect, ...]
    fit: Fit
    noise: LackOfFit
    nominal: Stage
    before: Stage
    """With base and tool registered, where they are among what is fitted; else as delivered."""
    after: Stage
    gain: Gain | None
    parameters: tuple[FittedParameter, ...]
    """Standard errors are of the data alone, drawn or not."""
    shrunk: tuple[ShrunkKind, ...]
    """Constants drawn to the robot file's values."""
    deflection: DeflectionChoice | None
    """At which pose the moments of elastic effects are taken; None where none is fitted."""
    correlations: tuple[Correlation, ...]
    identifiability: Identifiability
    leverage: tuple[tuple[int, float], ...]
    """Rows of high leverage: index and share."""
    n_folds: int
    warnings: tuple[str, ...]
    residuals: Residuals
    """Of every pose, those left out as outliers too."""
    holdout: Residuals | None
    """Of the poses of ``holdout``, where there are such."""
    partial_residuals: tuple[tuple[Effect, PartialResidual], ...]
    """For each effect that is no constant, the residual along it over what drives it, without and with it."""


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
    progress: Progress = lambda what, done, of: None,
) -> Calibration:
    """Fit what ``requests`` name.

    An effect that acts joint by joint and is named without joints is fitted on the joints where the data show it, by
    the evidence that `trace` uses; with joints in brackets, exactly there. ``priors`` are standard deviations about
    zero by coefficient name, SI (:func:`tolerance_priors`); without them, ``shrink`` draws constants of the arm that
    are named without joints to the robot file's values where most of them do not differ
    (:mod:`robacc.fitting.sparse_prior`).

    Raises:
        InputError: the data hold a mistake, or are too few.
        UsageError: an effect cannot be fitted to this robot and these data.
    """
    refuse_mistake(robot, data)
    options = options or Options()
    plan = _Plan(robot, data, requests, options, priors or {}, shrink)
    progress("fitting", 0, n_folds + 1)
    effects = plan.effects(data)
    found, kinds, deflection = _fitted(plan, effects, data, options)
    effects = found.model.free
    frames = tuple(effect for effect in effects if effect.is_frame)
    registered = fit(Model.of(robot, frames), data, Options(robust=options.robust))
    held = _hold_out(plan, data, holdout, effects, frames, n_folds, seed, progress)
    told = before_and_after(robot, data, registered, found, held, holdout)
    noise = lack_of_fit(found, data)
    return Calibration(
        robot=apply_fit(found),
        effects=effects,
        fit=found,
        noise=noise,
        nominal=told.nominal,
        before=told.before,
        after=told.after,
        gain=told.gain,
        parameters=parameters(found),
        shrunk=kinds,
        deflection=deflection,
        correlations=correlations(found),
        identifiability=found.identifiability,
        leverage=_leverage(found, data),
        n_folds=0 if held is None or holdout is not None else min(n_folds, int(data.groups().max()) + 1),
        warnings=_warnings(found, data, told.after, noise),
        residuals=told.residuals,
        holdout=told.holdout,
        partial_residuals=tuple(
            (e, curve) for e in effects if not e.is_constant for curve in partial_residuals(e, found, data)
        ),
    )


def tolerance_priors(robot: Robot) -> dict[str, float]:
    """The robot file's tolerances as priors of joint offsets and link geometry."""
    priors = {}
    for joint in robot.joints:
        for label, deviation in joint.tolerance.items():
            own = label == joint.offset_parameter
            priors[f"joint_offset.{joint.name}" if own else f"link_geometry.{joint.name}.{label}"] = deviation
    return priors


@dataclass(frozen=True)
class _Plan:
    """What is fitted: some effects as they stand, others where the data show them."""

    robot: Robot
    data: Measurements
    requests: Sequence[Request]
    options: Options
    priors: Mapping[str, float]
    shrink: bool

    def effects(self, data: Measurements) -> tuple[Effect, ...]:
        """The effects for these poses, in the catalogue's order."""
        model = Model.of(self.robot)
        fixed = [request for request in self.requests if not _searched(request)]
        searched = [request.name for request in self.requests if _searched(request)]
        effects = build(fixed, model.arm, data)
        if searched:
            build([request for request in self.requests if _searched(request)], model.arm, data)
            loop = search(Model.of(self.robot, effects), data, only=searched)
            effects = (*effects, *loop.effects)
        return effects

    def with_priors(self, options: Options, effects: Sequence[Effect], data: Measurements) -> Options:
        """``options`` with the priors of the coefficients that have one."""
        if not self.priors:
            return options
        arm = Arm.of(self.robot)
        names = [term.name for effect in effects for term in effect.terms(arm, data)]
        return dataclasses.replace(options, priors=np.array([self.priors.get(name, np.inf) for name in names]))

    @property
    def whole(self) -> tuple[str, ...]:
        """Constants asked for without saying which."""
        return tuple(one.name for one in self.requests if one.name in _CONSTANTS and one.joints is None)


def _fitted(
    plan: _Plan, effects: tuple[Effect, ...], data: Measurements, options: Options
) -> tuple[Fit, tuple[ShrunkKind, ...], DeflectionChoice | None]:
    """The fit of all effects, elastic ones in the form that the data show.

    With priors as they stand, else without what is idle in the arm's constants.
    """
    model, options = Model.of(plan.robot, effects), plan.with_priors(options, effects, data)
    found, model, form = choose_deflection(fit(model, data, options), model, data, options)
    if plan.priors:
        return found, (), form
    found = without_idle_rotations(found, model, data, options)
    return (*shrink_to_nominal(found, data, options, plan.whole), form) if plan.shrink else (found, (), form)


def _searched(request: Request) -> bool:
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
    """Residuals of poses held out, with frames alone and with everything; what is searched is searched again."""
    search = Options(robust=plan.options.robust, tolerance=1e-6)
    if holdout is not None:
        alone = fit(Model.of(plan.robot, frames), data, search)
        whole = _fitted(plan, effects, data, search)[0]
        return held_out(alone, holdout), held_out(whole, holdout)
    assigned = folds(data, n_folds, seed)
    if assigned is None:
        return None
    rows = 3 if data.rotation is None else 6
    before, after = np.empty((rows, data.n)), np.empty((rows, data.n))
    again = any(_searched(request) for request in plan.requests)
    try:
        for number, (learn, rest) in enumerate(parts(assigned), 1):
            progress("cross-fitting", number, n_folds + 1)
            train, test = data.subset(np.flatnonzero(learn)), data.subset(np.flatnonzero(rest))
            chosen = plan.effects(train) if again else with_deflection(effects, "equilibrium")
            before[:, rest] = held_out(fit(Model.of(plan.robot, frames), train, search), test)
            after[:, rest] = held_out(_fitted(plan, chosen, train, search)[0], test)
    except InputError:
        # What is left to learn from without a fold is too little for what is fitted.
        return None
    return before, after


def _leverage(found: Fit, data: Measurements) -> tuple[tuple[int, float], ...]:
    """Rows whose prediction they decide themselves: mean of the hat matrix over their components."""
    kept = found.identifiability.columns
    if kept.size == 0:
        return ()
    inverse = posterior(found.gram, found.precision)
    share = np.empty(data.n)
    for start in range(0, data.n, BLOCK):
        block = slice(start, start + BLOCK)
        _, jacobian = found.model.bind(data.subset(block)).linearise(found.theta, kept)
        columns = jacobian[: found.residual.shape[0]] * found.weight[:, None, block]
        share[block] = np.einsum("mpn,pq,mqn->n", columns, inverse, columns) / found.residual.shape[0]
    high = np.flatnonzero((share > _LEVERAGE) & found.inliers)
    return tuple((int(i), float(share[i])) for i in high[np.argsort(-share[high])])


def _warnings(found: Fit, data: Measurements, after: Stage, noise: LackOfFit) -> tuple[str, ...]:
    warnings = [*data.warnings, *data.contradicted_ids(), *outliers_warning(found, data), *frames_warning(found, data)]
    warnings.extend((*sigma_warning(noise), *weak_parameters_warning(found)))
    count = int(found.identifiability.columns.size)
    spare = int(np.count_nonzero(found.inliers)) * found.residual.shape[0] - count
    if spare < count:
        warnings.append(f"only {spare} more numbers measured than coefficients fitted: measure more poses")
    warnings.extend(condition_warning(found))
    if after.held_out is not None and after.held_out.position.rms > _OVERFIT * after.fitted.position.rms:
        warnings.append("poses held out are predicted much worse than those fitted: fewer effects or more poses")
    if after.held_out is None:
        warnings.append(no_held_out_warning(data))
    return tuple(warnings)
