"""Stages of a fit, nominal, before and after: their metrics and residuals, fitted and held out, and the gain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.estimation import PoseMetrics, pose_metrics
from robacc.effects.base import Effect, effect_class
from robacc.errors import InputError
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.held_out import HoldOut
from robacc.fitting.registration import ALIGNABLE
from robacc.fitting.solver import fit
from robacc.fitting.visits import places
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict, residuals
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.statistics.distributions import student_quantile
from robacc.statistics.intervals import PoseSampling


@dataclass(frozen=True, slots=True)
class Stage:
    """Metrics of one model: nominal, before or after. Outliers count; metrics without them stand beside."""

    fitted: PoseMetrics
    held_out: PoseMetrics | None
    """None where there are too few poses to hold any out."""
    fitted_inliers: PoseMetrics | None = None
    """Metrics without the outliers; None if there are none."""
    held_out_inliers: PoseMetrics | None = None
    """Metrics of held-out poses without the outliers; None if there are none."""


@dataclass(frozen=True, slots=True)
class Residuals:
    """Residuals ``(3 or 6, N)`` of the same poses at every stage, m and rad, in the measuring frame."""

    unregistered: Array
    """Residuals of the nominal model as it stands in the robot file."""
    nominal: Array
    """Residuals of the nominal model, registered."""
    before: Array
    after: Array
    held_out_nominal: Array | None = None
    """Residuals of the nominal model, registered without the pose; None where no pose was held out."""
    held_out_before: Array | None = None
    """Residuals by models fitted without the pose; None where no pose was held out."""
    held_out_after: Array | None = None


@dataclass(frozen=True, slots=True)
class Gain:
    """Reduction of the position RMS on held-out poses, with an interval over poses."""

    value: float
    low: float
    high: float
    confidence: float


@dataclass(frozen=True)
class BeforeAfter:
    """Stages, gain and residuals of two fits to the same poses."""

    nominal_unregistered: Stage
    """Stage of the nominal model as it stands in the robot file."""
    nominal: Stage
    """Stage of the nominal model, registered: base and tool frames fitted as far as the poses allow."""
    before: Stage
    """Baseline: `calibrate` fits base and tool in it if they are among its effects, `trace` the declared effects."""
    after: Stage
    gain: Gain | None
    """None where no pose was held out."""
    residuals: Residuals
    """Residuals of every calibration pose, outliers included."""
    holdout: Residuals | None
    """Residuals of the validation poses, where there are any."""


def paired_gain(before: Array, after: Array, groups: NDArray[np.int64], confidence: float = 0.95) -> Gain:
    """Return the fall of the position RMS from ``before`` to ``after`` ``(M, N)`` on the same poses.

    The interval is the delta method's over groups of repeats. Both errors of a pose stay together, so that what the
    stages share cancels.
    """
    squares = np.stack([np.sum(np.square(residual[:3]), axis=0) for residual in (before, after)])
    rms = np.sqrt(squares.mean(axis=1))
    value = float(rms[0] - rms[1])
    # Rows that are left out leave gaps in the numbers of the groups.
    sampling = PoseSampling(squares.shape[1], np.unique(groups, return_inverse=True)[1])
    if sampling.n_groups < 3 or rms.min() <= 0:
        return Gain(value, float("nan"), float("nan"), confidence)
    influence = squares / (2 * rms[:, None])
    gain_std = sampling.standard_error(influence[0] - influence[1])
    half_width = student_quantile(0.5 + confidence / 2, sampling.n_groups - 1.0) * gain_std
    return Gain(value, value - half_width, value + half_width, confidence)


# Comparison of two fits to the same poses: nominal, before and after, fitted and held out.


def before_and_after(
    robot: Robot,
    data: Measurements,
    before: Fit,
    after: Fit,
    held_out: tuple[Array, Array] | None,
    how: HoldOut,
    is_nominal: bool,
) -> BeforeAfter:
    """Return the stages of the nominal ``robot``, of the fit before and of the fit after, on the same rows.

    Metrics are of all rows. Where the fit after has outliers, metrics without them stand beside. ``held_out`` are
    residuals before and after by models fitted without the poses that ``how`` holds out; None where there are none.
    ``is_nominal`` says that the fit before is the nominal model, registered.
    """
    unregistered = residuals(data, predict(robot, data))
    if is_nominal:
        registered, apart_registered = before.residual, None if held_out is None else held_out[0]
    else:
        registered, apart_registered = registered_residuals(robot, data, how)
    fitted = (unregistered, registered, before.residual, after.residual)
    inliers, poses = after.inliers, how.validation
    apart: tuple[Array | None, ...] = (None,) * len(fitted)
    judged = gain = validation = None
    if held_out is not None:
        raw, nominal, judged, groups = unregistered, apart_registered, inliers, places(data)
        if poses is not None:
            raw = residuals(poses, predict(robot, poses))
            judged, groups = np.ones(poses.n, dtype=bool), places(poses)
            nominal = raw if nominal is None else nominal
        apart = others = (raw, registered if nominal is None else nominal, *held_out)
        gain = paired_gain(held_out[0][:, judged], held_out[1][:, judged], groups[judged])
        validation = None if poses is None else Residuals(*others)
    calibration = Residuals(*fitted, *(apart[1:] if poses is None else ()))
    stages = [_stage(errors, inliers, other, judged) for errors, other in zip(fitted, apart, strict=True)]
    return BeforeAfter(stages[0], stages[1], stages[2], stages[3], gain, calibration, validation)


def registered_residuals(robot: Robot, data: Measurements, how: HoldOut) -> tuple[Array, Array | None]:
    """Return residuals ``(M, N)`` of the nominal model with base and tool fitted to the poses, as far as these allow.

    The second element are residuals of held-out poses: of each fold, or of the validation poses; None where no pose
    is held out.

    Coordinates of the frames that the poses do not determine keep their nominal values. If the poses are too few, the
    model is not registered.
    """
    try:
        registered = fit(Model.of(robot, default_frames(robot, data)), data, Options(tolerance=1e-6))
    except InputError:
        return residuals(data, predict(robot, data)), None
    return registered.residual, how.residuals(registered)[0]


def default_frames(robot: Robot, data: Measurements) -> list[Effect]:
    """Return the frames with which the nominal model is registered."""
    arm = Arm.of(robot)
    return [effect_class(name).default(arm, data) for name in ALIGNABLE]


def _stage(fitted: Array, inliers: NDArray[np.bool_], apart: Array | None, judged: NDArray[np.bool_] | None) -> Stage:
    """Return the metrics of all rows, and of the inliers where there are outliers."""
    return Stage(
        pose_metrics(fitted),
        None if apart is None else pose_metrics(apart),
        None if inliers.all() else pose_metrics(fitted[:, inliers]),
        None if apart is None or judged is None or judged.all() else pose_metrics(apart[:, judged]),
    )
