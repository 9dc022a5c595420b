"""Fit of named effects, and what `calibrate` and `trace` report of a fit: errors before and after, causes, warnings."""

import dataclasses
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from robacc.accuracy.error_statistics import Gain, paired_gain
from robacc.accuracy.estimation import PoseMetrics, pose_metrics
from robacc.diagnostics.data_mistakes import check_data
from robacc.diagnostics.partial_residuals import PartialResidual, partial_residuals
from robacc.diagnostics.recorded import Rounding, evident_rounding, read_back_warning
from robacc.effects.base import Effect, effect_class
from robacc.effects.specification import CONSTANTS, Request, build
from robacc.error_model.structure import DirectionalNoise, ErrorStructure, Repeatability, with_error_structure
from robacc.errors import InputError
from robacc.fitting.fit_result import Fit, HoldOut, Identifiability, Options
from robacc.fitting.levels import NORMAL_95
from robacc.fitting.masses import with_mass_uncertainty
from robacc.fitting.normal_equations import posterior
from robacc.fitting.parameters import (
    Correlation,
    FittedParameter,
    ParameterCovariance,
    apply_fit,
    correlations,
    high_leverage,
    parameter_covariance,
    parameters,
)
from robacc.fitting.priors import ShrunkKind, shrink_to_nominal, without_idle_rotations
from robacc.fitting.registration import ALIGNABLE, gravity_warning, with_gravity_direction
from robacc.fitting.solver import fit, refit
from robacc.fitting.visits import places
from robacc.fitting.warnings import LackOfFit, fit_warnings, lack_of_fit
from robacc.geometry import Array, NDArray
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict, residuals
from robacc.robots.arm import BLOCK, Arm
from robacc.robots.description import Robot
from robacc.tracing.search import search

# Causes of the error: every effect in a fit, declared or found, with what it does at the target.
#
# To first order, an effect with the coefficients c moves the target by J_c c. If it is left out and the rest fitted
# again, the coefficients change by -C_:c C_cc^-1 c, C the inverse of the normal equations' matrix, and the error
# grows by the part that nothing else in the model can describe.


@dataclass(frozen=True, slots=True)
class ErrorCause:
    """An effect in the model, or the constants of one joint of it."""

    effect: str
    joints: tuple[str, ...]
    settings: dict[str, object]
    declared: bool
    """Whether it was declared; else it was found."""
    size: float
    """Root mean square over the poses of the distance by which it alone moves the target, m."""
    interval: tuple[float, float]
    """95 % interval of :attr:`size`, m."""
    left: float
    """Root mean square of the error that its absence leaves, the rest of the model fitted again, m."""
    share: float | None
    """Mean square of that error over that of the nominal model, registered if the fit has frames."""
    turn: float | None
    """Root mean square over the poses of the angle by which it alone turns the target, rad; None where orientation was
    not measured."""


def causes(fit: Fit, data: Measurements, nominal_rms: float, found: Collection[Effect] = ()) -> tuple[ErrorCause, ...]:
    """Return the effects of a fit other than base and tool, the largest share first.

    An effect whose size the poses do not distinguish from zero is no cause.

    Args:
        fit: The fit, with the covariance of its coefficients.
        data: Its poses.
        nominal_rms: Position error of the nominal model at the inliers, registered if the fit has frames, m rms.
        found: Effects that were not declared.
    """
    columns = fit.identifiability.columns
    # The means over the inliers of J'J, J the derivatives of the position, and of the orientation if it was measured.
    rows, components = np.flatnonzero(fit.inliers), len(fit.residual)
    moved, *turned = np.zeros((components // 3, columns.size, columns.size))
    for start in range(0, rows.size, BLOCK):
        _, jacobian = fit.model.bind(data.subset(rows[start : start + BLOCK])).linearise(fit.theta, columns, components)
        for products, part in zip((moved, *turned), np.split(jacobian, components // 3), strict=True):
            products += sum(component @ component.T for component in part) / rows.size
    inverse = posterior(fit.gram, fit.precision)
    covariance = fit.covariance[np.ix_(columns, columns)]
    # The identifiable coefficients of each effect, those of a constant effect by joint.
    groups: dict[tuple[int, str | None], list[int]] = {}
    for index, column in enumerate(columns.tolist()):
        number, names = fit.owners[column], fit.names[column].split(".")
        effect = fit.model.free[number]
        by_joint = effect.joints if effect.traits.is_constant else ()
        if not effect.traits.is_frame:
            groups.setdefault((number, next((name for name in by_joint if name in names), None)), []).append(index)
    listed = []
    for (number, joint), indices in groups.items():
        effect, own = fit.model.free[number], np.ix_(indices, indices)
        values = fit.theta[columns[indices]]
        pull = moved[own] @ values
        square, noise = float(values @ pull), float(np.sum(moved[own] * covariance[own]))
        size = float(np.sqrt(max(square, 1e-300)))
        std = float(np.sqrt(max(float(pull @ covariance[own] @ pull), 0.0))) / size
        interval = (float(np.sqrt(max(square - noise, 0.0))) - NORMAL_95 * std, size + NORMAL_95 * std)
        change = inverse[:, indices] @ np.linalg.solve(inverse[own], values)
        left = float(np.sqrt(max(float(change @ moved @ change), 0.0)))
        share = min((left / nominal_rms) ** 2, 1.0) if nominal_rms > 0.0 else None
        turn = float(np.sqrt(max(float(values @ turned[0][own] @ values), 0.0))) if turned else None
        joints, declared = effect.joints if joint is None else (joint,), effect not in found
        listed.append(ErrorCause(effect.name, joints, effect.settings(), declared, size, interval, left, share, turn))
    notable = (cause for cause in listed if cause.interval[0] > 0.0)
    return tuple(sorted(notable, key=lambda cause: -cause.left))


# Stages of a fit to the same poses: nominal, before and after, fitted and held out.


@dataclass(frozen=True)
class Stage:
    """Residuals of one model: nominal, before or after, m and rad in the measuring frame, and their metrics.

    Outliers count; metrics without them stand beside.
    """

    residual: Array
    """``(3 or 6, N)`` at the calibration poses."""
    inliers: NDArray[np.bool_]
    """``(N,)`` poses that are no outliers of the fit after."""
    held_out_residual: Array | None
    """``(3 or 6, M)`` at the validation poses, or at the calibration poses by models fitted without the pose; None
    where no pose was held out."""
    held_out_inliers_mask: NDArray[np.bool_]
    """``(M,)``"""
    share: float = 1.0
    """Degrees of freedom that the fit leaves; see :meth:`HoldOut.share`."""

    @cached_property
    def fitted(self) -> PoseMetrics:
        """Metrics at the calibration poses."""
        return pose_metrics(self.residual)

    @cached_property
    def held_out(self) -> PoseMetrics | None:
        """Metrics at held-out poses; None where no pose was held out."""
        return None if self.held_out_residual is None else pose_metrics(self.held_out_residual)

    @property
    def held_out_rms(self) -> float | None:
        """Position error at held-out poses, m rms; None where no pose was held out."""
        return None if self.held_out is None else self.held_out.position.rms

    @cached_property
    def fitted_inliers(self) -> PoseMetrics | None:
        """Metrics without the outliers; None if there are none."""
        return _without_outliers(self.residual, self.inliers)

    @cached_property
    def held_out_inliers(self) -> PoseMetrics | None:
        """Metrics at held-out poses without the outliers; None if there are none."""
        return _without_outliers(self.held_out_residual, self.held_out_inliers_mask)


def _without_outliers(residual: Array | None, inliers: NDArray[np.bool_]) -> PoseMetrics | None:
    return None if residual is None or inliers.all() else pose_metrics(residual[:, inliers])


def registered_residuals(robot: Robot, data: Measurements, how: HoldOut) -> tuple[Array, Array | None]:
    """Return residuals ``(M, N)`` of the nominal model with base and tool fitted to the poses, as far as these allow.

    The second element are residuals of held-out poses: of each fold, or of the validation poses; None where no pose
    is held out.

    Coordinates of the frames that the poses do not determine keep their nominal values. If the poses are too few, the
    model is not registered.
    """
    try:
        registered = fit(Model.of(robot, default_frames(robot, data)), data)
    except InputError:
        return residuals(data, predict(robot, data)), None
    return registered.residual, how.residuals(registered)[0]


def default_frames(robot: Robot, data: Measurements) -> list[Effect]:
    """Return the frames with which the nominal model is registered."""
    arm = Arm.of(robot)
    return [effect_class(name).default(arm, data) for name in ALIGNABLE]


Progress = Callable[[str, int, int], None]
"""Called with a label of the work, the number of steps done, and the number of all steps."""


@dataclass(frozen=True)
class Judged:
    """A fitted robot with its error before and after."""

    nominal_unregistered: Stage
    """Stage of the nominal model as it stands in the robot file."""
    nominal: Stage
    """Stage of the nominal model, registered: base and tool frames fitted as far as the poses allow."""
    before: Stage
    """Baseline: `calibrate` fits base and tool in it if they are among its effects, `trace` the declared effects."""
    after: Stage
    gain: Gain | None
    """None where no pose was held out."""
    robot: Robot
    """The robot file with the fit written into it."""
    fit: Fit
    noise: LackOfFit
    repeatability: Repeatability | None
    """Scatter of the joints; None if it is not significant given the noise."""
    parameters: tuple[FittedParameter, ...]
    """Coefficients; standard errors come from the data alone, and include the uncertainty of the masses."""
    covariance: ParameterCovariance
    causes: tuple[ErrorCause, ...]
    """Effects in the fit other than base and tool that the poses distinguish from nothing, the largest first."""
    rounding: Rounding | None
    """Evident rounding of the recorded joints; None without one."""
    directional: DirectionalNoise | None
    """Noise that is much larger along one direction than along others; None if it is not."""
    n_folds: int
    """Number of groups of poses that are held out in turn; 0 with validation poses, or where poses are too few."""
    warnings: tuple[str, ...]


def judge(
    robot: Robot,
    mistakes: Sequence[str],
    before: Fit,
    structure: ErrorStructure,
    data: Measurements,
    how: HoldOut,
    held_out_after: Array | None,
    found: Sequence[Effect] = (),
    *,
    is_nominal: bool = False,
) -> Judged:
    """Compare the fit of ``structure`` with the fit ``before`` of the same poses, fitted and held out.

    ``robot`` is the robot file's; ``mistakes`` are warnings about the data, ``held_out_after`` residuals of the fit at
    held-out poses, ``found`` the effects that nobody declared.
    ``is_nominal`` says that the fit before is the nominal model, registered.
    """
    fit, gravity = structure.fit, before.model.arm.robot.gravity
    # Findings may stand for what is wrong with the frames, and corrections without a cause have many coefficients.
    without_findings = before if found else fit
    held_out_before = held_out_after if before is fit else how.residuals(before)[0]
    stated, poses, judged, gain = dataclasses.replace(robot, gravity=gravity), how.validation, fit.inliers, None
    unregistered = residuals(data, predict(stated, data))
    registered, held_out_nominal = (
        (before.residual, held_out_before) if is_nominal else registered_residuals(stated, data, how)
    )
    held_out: tuple[Array | None, ...] = (None,) * 4
    if held_out_before is not None and held_out_after is not None:
        raw, groups = unregistered, places(data)
        if poses is not None:
            raw, groups, judged = residuals(poses, predict(stated, poses)), places(poses), np.ones(poses.n, dtype=bool)
        if held_out_nominal is None:
            held_out_nominal = registered if poses is None else raw
        held_out = raw, held_out_nominal, held_out_before, held_out_after
        gain = paired_gain(held_out_before[:, judged], held_out_after[:, judged], groups[judged])
    fitted = unregistered, registered, before.residual, fit.residual
    shares = 1.0, 1.0, how.share(before), how.share(fit)
    stages = [
        Stage(own, fit.inliers, apart, judged, share)
        for own, apart, share in zip(fitted, held_out, shares, strict=True)
    ]
    basis = stages[any(each.traits.is_frame for each in fit.model.free)]
    rms = stages[3].fitted.position.rms, stages[3].held_out_rms
    noise, with_masses = lack_of_fit(fit, data), with_mass_uncertainty(fit, data)
    rounding = evident_rounding(fit, data)
    return Judged(
        nominal_unregistered=stages[0],
        nominal=stages[1],
        before=stages[2],
        after=stages[3],
        gain=gain,
        robot=apply_fit(fit),
        fit=fit,
        noise=noise,
        repeatability=structure.repeatability,
        parameters=parameters(with_masses),
        covariance=parameter_covariance(with_masses),
        causes=causes(fit, data, (basis.fitted_inliers or basis.fitted).position.rms, found),
        rounding=rounding,
        directional=structure.directional,
        n_folds=0 if gain is None else how.folds,
        warnings=(
            *mistakes,
            *(() if data.is_placed_by_images else gravity_warning(robot.gravity, gravity)),
            *fit_warnings(fit, data, noise, without_findings, rms, poses),
            *(() if rounding is None else (rounding.warning,)),
            *read_back_warning(fit, data),
        ),
    )


# Weights by direction, where the noise is larger along one direction than along others (a camera's depth).


Result = TypeVar("Result", bound=Judged)


def with_directional_weights(
    run: Callable[[Measurements], Result],
    data: Measurements,
    holdout: Measurements | None,
) -> Result:
    """Return the result of ``run``, with weights by direction if the noise differs.

    An error that the model lacks may be larger along a direction, too. With less weight there, the model would be worse
    on other poses; then equal weights stay.

    Args:
        run: Function of the poses, which returns a result with the directional noise that it shows.
        data: Measured poses.
        holdout: Poses that are held out in place of folds of ``data``.
    """
    result = run(data)
    if (noise := result.directional) is None:
        return result

    before = result.after.held_out_residual
    if before is not None and data.position_variance is None:
        of_rows = np.repeat(noise.beyond_least[..., None], data.n, axis=2)
        weighted = run(dataclasses.replace(data, noise_covariance=of_rows))
        after, rows = weighted.after.held_out_residual, places(data if holdout is None else holdout)
        if after is not None and not paired_gain(before, after, rows).high < 0.0:
            sizes = ", ".join(f"{1e3 * std:.3g}" for std in noise.std)
            message = (
                f"{noise.text} (an instrument's noise may differ along its line of sight): {sizes} mm along three "
                "axes; the fit weights each direction by its own noise"
            )
            return dataclasses.replace(weighted, warnings=(*weighted.warnings, message))
    warning = (
        f"{noise.text}: the model lacks an effect, or the instrument's noise differs along its line of sight; "
        "if it is noise, state it in the columns sigma_x, sigma_y, sigma_z, and the fit allows for it"
    )
    return dataclasses.replace(result, warnings=(*result.warnings, warning))


# Calibration: fit of the effects that a request names.


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
    fitted_to_all: Callable[[Fit], Fit] = lambda fit: fit,
) -> Calibration:
    """Fit the effects that ``requests`` name.

    A per-joint effect that is requested without joints is fitted on the joints where the evidence supports it, as in
    `trace`; with joints in brackets, it is fitted on exactly those. ``priors`` are standard deviations about zero by
    coefficient name, in SI units (as :mod:`robacc.fitting.priors` gives them). Without them, ``shrink`` applies
    shrinkage to nominal to constants of the arm that are requested without joints (:mod:`robacc.fitting.priors`).
    Held-out figures are those of ``holdout``, of each place of the poses in turn, or of ``n_folds`` parts of them.
    Where ``data`` are some poses of a large file, ``fitted_to_all`` fits the coefficients to all of them.

    Raises:
        InputError: The data contain a mistake, or there are too few poses.
        UsageError: An effect cannot be fitted to this robot and these data.
    """
    options, priors, stated, poses = options or Options(), priors or {}, robot, data

    def run(data: Measurements) -> Calibration:
        mistakes = check_data(stated, data)
        how = HoldOut.of(data, holdout, n_folds, seed)
        effects = tuple(build([request for request in requests if not is_searched(request)], Arm.of(stated), data))
        robot = with_gravity_direction(Model.of(stated, effects), data).arm.robot
        progress("fitting", 0, 1)
        if searched := [request for request in requests if is_searched(request)]:
            build(searched, Arm.of(robot), data)  # An effect that cannot be fitted is an error.
            only = [request.name for request in searched]
            found = search(Model.of(robot, effects), data, only).effects
            # A process over the joints, which the search needs beside them, was not asked for.
            effects += tuple(effect for effect in found if effect.name in only)
        model = Model.of(robot, effects)
        stds = [priors.get(term.name, np.inf) for effect in effects for term in effect.terms(model.arm, data)]
        settings = dataclasses.replace(options, priors=np.array(stds)) if priors else options
        unshrunk = without_idle_rotations(fit(model, data, settings), model, data, settings)

        def refitted(scattered: Options) -> Fit:
            return without_idle_rotations(refit(unshrunk, effects, data, scattered), model, data, scattered)

        structure = with_error_structure(unshrunk, data, settings, refitted)
        final, shrunk = structure.fit, tuple[ShrunkKind, ...]()
        if shrink and not priors:
            everywhere = [request.name for request in requests if request.joints is None and request.name in CONSTANTS]
            final, shrunk = shrink_to_nominal(final, data, structure.options, everywhere)
        final = fitted_to_all(final)
        structure = dataclasses.replace(structure, fit=final)
        effects = final.model.free
        frames = tuple(effect for effect in effects if effect.traits.is_frame)
        registered = fit(Model.of(robot, frames), data, Options(robust=options.robust))
        keys = [{effect.key() for effect in some} for some in (frames, default_frames(robot, data))]
        is_nominal = options.robust and keys[0] == keys[1]
        held_out = how.residuals(final)[0]
        judged = judge(stated, mistakes, registered, structure, data, how, held_out, is_nominal=is_nominal)
        kept = final.identifiability.columns
        present, warnings = {effect.name for effect in final.model.free}, list(judged.warnings)
        if unsupported := [request.name for request in searched if request.name not in present]:
            warnings.append(
                f"no joint shows {' or '.join(unsupported)} on these poses, so it is not fitted; joints in brackets, "
                f"as in {unsupported[0]}[{final.model.arm.names[0]}], fit it all the same"
            )
        after, nominal = judged.after.fitted.position.rms, judged.nominal.fitted.position.rms
        absent = [name for name in ALIGNABLE if name not in present]
        if absent and after > nominal:
            warnings.append(
                f"the calibrated model is worse ({1e3 * after:.3g} mm rms) than the nominal model with base and tool "
                f"registered ({1e3 * nominal:.3g} mm): add {','.join(absent)} to `fit`"
            )
        warnings += structure.warnings
        return Calibration(
            **vars(dataclasses.replace(judged, warnings=tuple(warnings))),
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

    return with_directional_weights(run, poses, holdout)
