"""Comparison of two fits to the same poses: nominal, before and after, fitted and held out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.metrics import pose_metrics
from robacc.accuracy.stages import BeforeAfter, Residuals, Stage, paired_gain
from robacc.effects.base import effect_class
from robacc.errors import InputError
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.held_out import HoldOut
from robacc.fitting.places import places
from robacc.fitting.registration import ALIGNABLE
from robacc.fitting.solver import fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.modelling.observation import residuals
from robacc.robots.arm import Arm
from robacc.robots.description import Robot


class Registered(NamedTuple):
    """Residuals ``(M, N)`` of the nominal model with its base and tool frames fitted."""

    fitted: Array
    held_out: Array | None
    """Residuals of held-out poses: of each fold, or of the validation poses; None where no pose is held out."""


def before_and_after(
    robot: Robot,
    data: Measurements,
    before: Fit,
    after: Fit,
    held_out: tuple[Array, Array] | None,
    how: HoldOut,
) -> BeforeAfter:
    """Return the stages of the nominal ``robot``, of the fit before and of the fit after, on the same rows.

    Metrics are of all rows. Where the fit after has outliers, metrics without them stand beside. ``held_out`` are
    residuals before and after by models fitted without the poses that ``how`` holds out; None where there are none.
    """
    unregistered = residuals(data, predict(robot, data))
    registered = registered_residuals(robot, data, how)
    calibration = Residuals(unregistered, registered.fitted, before.residual, after.residual)
    fitted = (unregistered, registered.fitted, before.residual, after.residual)
    inliers = after.inliers
    if held_out is None:
        stages = [_stage(errors, inliers, None, None) for errors in fitted]
        return BeforeAfter(stages[0], stages[1], stages[2], stages[3], None, calibration, None)
    if (poses := how.validation) is None:
        nominal = registered.fitted if registered.held_out is None else registered.held_out
        apart = (unregistered, nominal, *held_out)
        calibration = Residuals(unregistered, registered.fitted, before.residual, after.residual, nominal, *held_out)
        validation, judged, groups = None, inliers, places(data)
    else:
        unregistered = residuals(poses, predict(robot, poses))
        nominal = unregistered if registered.held_out is None else registered.held_out
        apart = (unregistered, nominal, *held_out)
        validation, judged, groups = (
            Residuals(*apart),
            np.ones(poses.n, dtype=bool),
            places(poses),
        )
    stages = [_stage(errors, inliers, other, judged) for errors, other in zip(fitted, apart, strict=True)]
    gain = paired_gain(held_out[0][:, judged], held_out[1][:, judged], groups[judged])
    return BeforeAfter(stages[0], stages[1], stages[2], stages[3], gain, calibration, validation)


def registered_residuals(robot: Robot, data: Measurements, how: HoldOut) -> Registered:
    """Return residuals of the nominal model with base and tool fitted to the poses, as far as these allow.

    Coordinates of the frames that the poses do not determine keep their nominal values. If the poses are too few, the
    model is not registered.
    """
    arm = Arm.of(robot)
    frames = [effect_class(name).default(arm, data) for name in ALIGNABLE]
    try:
        registered = fit(Model.of(robot, frames), data, Options(tolerance=1e-6))
    except InputError:
        return Registered(residuals(data, predict(robot, data)), None)
    return Registered(registered.residual, how.residuals(registered)[0])


def _stage(fitted: Array, inliers: NDArray[np.bool_], apart: Array | None, judged: NDArray[np.bool_] | None) -> Stage:
    """Return the metrics of all rows, and of the inliers where there are outliers."""
    return Stage(
        pose_metrics(fitted),
        None if apart is None else pose_metrics(apart),
        None if inliers.all() else pose_metrics(fitted[:, inliers]),
        None if apart is None or judged is None or judged.all() else pose_metrics(apart[:, judged]),
    )
