"""What `calibrate` and `trace` both report of a fit: its error before and after, its coefficients, its warnings."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.accuracy.before_after import before_and_after
from robacc.accuracy.stages import Gain, Residuals, Stage
from robacc.diagnostics.moved_frames import larger_error_warning, moved_frames
from robacc.diagnostics.read_back_share import read_back_warning
from robacc.diagnostics.rounded_joints import Rounding, evident_rounding
from robacc.diagnostics.suspected_mistakes import suspected_mistakes
from robacc.effects.base import Effect
from robacc.error_model.structure import ErrorStructure, Repeatability
from robacc.fitting.apply_fit import apply_fit
from robacc.fitting.deflection_model import DeflectionChoice
from robacc.fitting.fit_result import Fit
from robacc.fitting.gravity_direction import gravity_warning
from robacc.fitting.held_out import HoldOut
from robacc.fitting.mass_uncertainty import mass_warning, with_mass_uncertainty
from robacc.fitting.noise import LackOfFit, lack_of_fit
from robacc.fitting.parameters import FittedParameter, ParameterCovariance, parameter_covariance, parameters
from robacc.fitting.places import places_warning
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
from robacc.robots.description import Robot
from robacc.tracing.causes import ErrorCause, causes

Progress = Callable[[str, int, int], None]
"""Called with a label of the work, the number of steps done, and the number of all steps."""
_OVERFIT_RATIO = 1.5
"""Ratio of the held-out RMS error to the fitted RMS error above which a warning is given."""


@dataclass(frozen=True)
class Judged:
    """A fitted robot with its error before and after."""

    robot: Robot
    """The robot file with the fit written into it."""
    fit: Fit
    noise: LackOfFit
    repeatability: Repeatability | None
    """Scatter of the joints; None if it is not significant given the noise."""
    nominal_unregistered: Stage
    """The nominal model as it stands in the robot file."""
    nominal: Stage
    """The nominal model, registered: base and tool frames fitted as far as the poses allow."""
    before: Stage
    """Baseline: `calibrate` fits base and tool in it if they are among its effects, `trace` the declared effects."""
    after: Stage
    gain: Gain | None
    parameters: tuple[FittedParameter, ...]
    """Coefficients; standard errors come from the data alone, and include the uncertainty of the masses."""
    covariance: ParameterCovariance
    causes: tuple[ErrorCause, ...]
    """Effects in the fit other than base and tool that the poses distinguish from nothing, the largest first."""
    deflection: DeflectionChoice | None
    """Pose at which the torques of elastic effects are taken; None if no such effect is fitted or no choice was
    made."""
    rounding: Rounding | None
    """Evident rounding of the recorded joints; None without one."""
    n_folds: int
    """Number of groups of poses that are held out in turn; 0 with validation poses, or where poses are too few."""
    warnings: tuple[str, ...]
    residuals: Residuals
    """Residuals of all poses, outliers included."""
    holdout: Residuals | None
    """Residuals of the validation poses ``holdout``; None without them."""


def judge(
    robot: Robot,
    mistakes: Sequence[str],
    before: Fit,
    structure: ErrorStructure,
    deflection: DeflectionChoice | None,
    data: Measurements,
    how: HoldOut,
    found: Sequence[Effect] = (),
) -> Judged:
    """Compare the fit of ``structure`` with the fit ``before`` of the same poses, fitted and held out.

    ``robot`` is the robot file's; ``mistakes`` are warnings about the data, ``found`` the effects that nobody declared.
    """
    fit, gravity = structure.fit, before.model.arm.robot.gravity
    # Findings may stand for what is wrong with the frames, and corrections without a cause have many coefficients.
    without_findings = before if found else fit
    (held_out_before,), (held_out_after,) = how.residuals(before), how.residuals(fit)
    ends = None if held_out_before is None or held_out_after is None else (held_out_before, held_out_after)
    stages = before_and_after(dataclasses.replace(robot, gravity=gravity), data, before, fit, ends, how)
    noise, with_masses = lack_of_fit(fit, data), with_mass_uncertainty(fit, data)
    rounding = evident_rounding(fit, data)
    return Judged(
        robot=apply_fit(fit),
        fit=fit,
        noise=noise,
        repeatability=structure.repeatability,
        nominal_unregistered=stages.nominal_unregistered,
        nominal=stages.nominal,
        before=stages.before,
        after=stages.after,
        gain=stages.gain,
        parameters=parameters(with_masses),
        covariance=parameter_covariance(with_masses),
        causes=causes(fit, data, stages.nominal.fitted.position.rms, found),
        deflection=deflection,
        rounding=rounding,
        n_folds=0 if ends is None else how.folds,
        warnings=(
            *mistakes,
            *gravity_warning(robot.gravity, gravity),
            *_warnings(fit, without_findings, noise, rounding, data),
            *_held_out_warnings(without_findings, stages.after, data, how.validation),
        ),
        residuals=stages.residuals,
        holdout=stages.holdout,
    )


def _warnings(
    fit: Fit, without_findings: Fit, noise: LackOfFit, rounding: Rounding | None, data: Measurements
) -> Iterator[str]:
    """Yield what limits the figures: convergence, poses, outliers, noise, weakly identifiable coefficients."""
    yield from convergence_warning(fit)
    yield from mass_warning(fit)
    yield from data.warnings
    yield from data.contradicted_ids()
    yield from places_warning(data)
    yield from outliers_warning(fit, data)
    yield from () if rounding is None else (rounding.warning,)
    yield from read_back_warning(fit, data)
    yield from suspected_mistakes(fit)
    yield from frames_warning(without_findings, data)
    yield from sigma_warning(noise)
    yield from weak_parameters_warning(fit)
    n_coefficients = int(fit.identifiability.columns.size)
    surplus = int(np.count_nonzero(fit.inliers)) * fit.residual.shape[0] - n_coefficients
    if surplus < n_coefficients and not fit.group_stds:
        yield f"only {surplus} more measured values than fitted coefficients: measure more poses"
    yield from condition_warning(without_findings)


def _held_out_warnings(
    without_findings: Fit, after: Stage, data: Measurements, validation: Measurements | None
) -> Iterator[str]:
    """Yield why held-out errors are much larger than those of the fitted poses, or that there are none."""
    if after.held_out is None:
        yield no_held_out_warning(data)
        return
    fitted, held_out = after.fitted.position.rms, after.held_out.position.rms
    if validation is None:
        if held_out > _OVERFIT_RATIO * fitted:
            yield (
                "error on held-out poses is much larger than on calibration poses: fit fewer effects or measure more "
                "poses"
            )
        return
    moved = moved_frames(without_findings, validation)
    warning = larger_error_warning(fitted, held_out) if moved is None else moved.warning
    if warning is not None:
        yield warning
