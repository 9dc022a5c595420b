"""Predicted accuracy of a calibrated arm: what its model file knows of the fit, over poses or the workspace."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from robacc.accuracy.grade_scale import Scale
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.prediction.configurations import Configurations
from robacc.prediction.model_fit import ModelFit
from robacc.prediction.model_uncertainty import SOURCES, model_uncertainty
from robacc.prediction.predicting import Prediction, Share, predicted_errors, predicted_grade
from robacc.robots.description import Robot

MEANING = "errors of the calibrated arm: coefficients of the fit, repeatability, and unexplained error"


def calibrated_accuracy(
    robot: Robot, fit: ModelFit, configurations: Configurations, poses: Measurements | None, scale: Scale, seed: int
) -> Prediction:
    """Predict covariances and grade of a calibrated arm that is commanded through its model.

    Args:
        robot: The fitted robot.
        fit: Record of its fit.
        configurations: Configurations of equal weight.
        poses: Poses with circumstances at these configurations; None for configurations alone, which get directions
            of approach at random and other circumstances from the middle of the ranges of the fit.
        scale: Scale of the grade.
        seed: Seed of the directions.
    """
    data = completed(robot, fit, configurations.q if poses is None else None, poses, seed)
    uncertainty = model_uncertainty(robot, fit, data, measured=False).in_target_frame()
    position = predicted_errors("m", uncertainty.position, configurations, scale.statistic)
    orientation = predicted_errors("rad", uncertainty.orientation, configurations, scale.statistic)
    totals = np.sum(uncertainty.shares, axis=0)
    shares = uncertainty.shares / np.where(totals > 0.0, totals, 1.0)
    budget = [
        Share(name, None, name, None, None, float(share[0]), float(share[1]))
        for name, share in zip(SOURCES, shares, strict=True)
    ]
    budget.sort(key=lambda share: -share.position)
    notes = [*configurations.notes, *_notes(robot, fit, data, uncertainty.is_oriented)]
    return Prediction(
        parameters=(),
        configurations=configurations,
        position=position,
        orientation=orientation,
        budget=tuple(budget),
        by_joint=(),
        by_kind=(),
        grade=predicted_grade(position, orientation, scale),
        meaning=MEANING,
        notes=tuple(notes),
        is_calibrated=True,
    )


def completed(robot: Robot, fit: ModelFit, q: Array | None, poses: Measurements | None, seed: int) -> Measurements:
    """Return poses with every circumstance that an effect may depend on."""
    if poses is None:
        assert q is not None
        targets = list(robot.targets)
        names = np.repeat(targets[:1], q.shape[1]) if targets else None
        poses = Measurements(position=np.zeros((3, q.shape[1])), q=q, target=names)
    assert poses.q is not None
    rng = np.random.default_rng([seed, poses.n])

    def middle(column: Array | None, name: str) -> Array | None:
        if column is not None or name not in fit.ranges:
            return column
        return np.full(poses.n, 0.5 * sum(fit.ranges[name]))

    direction = poses.direction
    if direction is None:
        direction = rng.choice(np.array([-1.0, 1.0]), poses.q.shape)
    return dataclasses.replace(
        poses,
        direction=direction,
        speed=direction if poses.speed is None else poses.speed,
        payload=middle(poses.payload, "payload_kg"),
        temperature=middle(poses.temperature, "temperature_c"),
        time=middle(poses.time, "time_s"),
    )


def _notes(robot: Robot, fit: ModelFit, data: Measurements, is_oriented: bool) -> Sequence[str]:
    notes = [f"the model was fitted to {fit.n_poses} poses"]
    outside = np.zeros(data.n, dtype=bool)
    assert data.q is not None
    for name, row in zip(robot.variable_names, data.q, strict=True):
        low, high = fit.ranges.get(name, (-np.inf, np.inf))
        outside |= (row < low) | (row > high)
    if outside.any():
        notes.append(
            f"{np.count_nonzero(outside)} of {data.n} configurations lie outside the joint ranges of the fit, where "
            "the unexplained error may be larger"
        )
    if not is_oriented:
        notes.append("the fit had no measured orientations, so that of the prediction lacks the unexplained error")
    return notes
