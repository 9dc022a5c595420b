"""Comparison of two fits to the same poses: before and after, fitted and held out."""

from __future__ import annotations

import dataclasses

import numpy as np

from robacc.accuracy.metrics import pose_metrics
from robacc.accuracy.stages import BeforeAfter, Residuals, Stage, paired_gain
from robacc.fitting.solver import Fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.modelling.observation import residuals
from robacc.robots.description import Robot


def before_and_after(
    robot: Robot,
    data: Measurements,
    before: Fit,
    after: Fit,
    held_out: tuple[Array, Array] | None,
    holdout: Measurements | None = None,
) -> BeforeAfter:
    """Return the stages of the nominal ``robot``, of the fit before and of the fit after, on the latter's inliers.

    ``held_out`` are residuals before and after by models fitted without the poses: of each fold of ``data``, or of the
    validation poses ``holdout``; None where no pose was held out.
    """
    nominal = residuals(data, predict(robot, data))
    fitted = [pose_metrics(residual[:, after.inliers]) for residual in (nominal, before.residual, after.residual)]
    calibration = Residuals(nominal, before.residual, after.residual)
    if held_out is None:
        stages = [Stage(metrics, None) for metrics in fitted]
        return BeforeAfter(stages[0], stages[1], stages[2], None, calibration, None)
    if holdout is None:
        calibration = dataclasses.replace(calibration, held_out_before=held_out[0], held_out_after=held_out[1])
        validation, inliers, groups = None, after.inliers, data.groups()
    else:
        nominal = residuals(holdout, predict(robot, holdout))
        validation, inliers, groups = Residuals(nominal, *held_out), np.ones(holdout.n, dtype=bool), holdout.groups()
    outside = [pose_metrics(residual[:, inliers]) for residual in (nominal, *held_out)]
    stages = [Stage(*metrics) for metrics in zip(fitted, outside, strict=True)]
    gain = paired_gain(held_out[0][:, inliers], held_out[1][:, inliers], groups[inliers])
    return BeforeAfter(stages[0], stages[1], stages[2], gain, calibration, validation)
