"""Predicted accuracy of an arm from the tolerances of its parameters: equations (7) and (8) over poses.

The prediction is for robots whose parameter errors are random within the tolerances. At each pose the error is Gaussian
with mean zero and covariance V_d or V_δ; over poses it is their mixture in equal parts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.accuracy.grade_scale import Scale
from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.prediction.configurations import Configurations
from robacc.prediction.covariances import PoseCovariances, pose_covariances
from robacc.prediction.lengths import (
    length_quantiles,
    mean_lengths,
    mixture_quantile,
    principal_variances,
)
from robacc.prediction.parameters import NORMAL, ToleranceParameter
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.statistics.records import Statistic

RADIUS_PROBABILITY = 0.95
"""Probability of the error radius at each pose."""
PERCENTILES = (5, 25, 50, 75, 95)


@dataclass(frozen=True, slots=True)
class WorstPredictedPose:
    """Pose with the largest predicted RMS error."""

    index: int
    label: str
    q: Array
    """``(J,)`` rad or m"""
    rms: float
    """Root of the covariance's trace, m or rad."""
    radius95: float
    """Radius of 95 % of the errors at this pose, m or rad."""
    direction: Array
    """``(3,)`` unit vector in the tool's frame along which the error is largest; its largest component is positive."""
    sd: float
    """Standard deviation along ``direction``, m or rad."""


@dataclass(frozen=True, slots=True)
class PredictedErrors:
    """Predicted position or orientation errors, m or rad."""

    unit: Literal["m", "rad"]
    covariance: Array
    """``(3, 3, N)`` in the tool's frame: equation (7) or (8)."""
    pose_rms: Array
    """``(N,)`` root of the trace."""
    pose_radius95: Array
    """``(N,)`` radius of 95 % of the errors at each pose, exact for Gaussian errors."""
    mean_covariance: Array
    """``(3, 3)`` mean over poses, tool frame."""
    rms: float
    """Over robots and poses, as are ``mean_error`` and ``p95``."""
    mean_error: float
    p95: float
    max: float
    """Largest of ``pose_radius95``: Gaussian errors have no maximum."""
    worst: WorstPredictedPose
    pose_statistic: Array
    """``(N,)`` the grade scale's statistic at each pose; for p95 and max the 95 % radius."""

    def value(self, statistic: Statistic) -> float:
        """Return the statistic of that name."""
        return {"rms": self.rms, "mean_error": self.mean_error, "p95": self.p95, "max": self.max}[statistic]

    def percentiles(self) -> dict[int, tuple[float, float]]:
        """Return percentiles over poses of the predicted RMS and of the 95 % radius."""
        percentiles = np.percentile(np.stack((self.pose_rms, self.pose_radius95)), PERCENTILES, axis=1)
        return {
            percent: (float(rms), float(radius))
            for percent, (rms, radius) in zip(PERCENTILES, percentiles, strict=True)
        }


@dataclass(frozen=True, slots=True)
class Share:
    """Share of one parameter, joint or kind in the predicted variance; shares sum to 1."""

    name: str
    joint: str | None
    kind: str | None
    tolerance: float | None
    """Standard deviation, m or rad; None for a sum of several parameters."""
    unit: str | None
    position: float
    orientation: float


@dataclass(frozen=True, slots=True)
class PredictedGrade:
    """Grade of the prediction on a scale."""

    scale: Scale
    grade: str
    position: str
    """Grade of position alone."""
    orientation: str
    """Grade of orientation alone."""
    limited_by: tuple[str, ...]
    meeting: tuple[tuple[str, float], ...]
    """Each step's grade and the share of poses whose own statistic meets it, in position and orientation."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """Result of :func:`predict_accuracy`."""

    parameters: tuple[ToleranceParameter, ...]
    configurations: Configurations
    position: PredictedErrors
    orientation: PredictedErrors
    budget: tuple[Share, ...]
    """By parameter, the largest share of position first."""
    by_joint: tuple[Share, ...]
    by_kind: tuple[Share, ...]
    grade: PredictedGrade
    meaning: str
    """Conversion of a tolerance into a variance, as text."""
    notes: tuple[str, ...]
    is_calibrated: bool = False
    """The prediction is that of one calibrated arm, from the fit of its model."""


def predict_accuracy(
    robot: Robot,
    parameters: Sequence[ToleranceParameter],
    configurations: Configurations,
    scale: Scale,
    meaning: str = NORMAL,
) -> Prediction:
    """Predict the covariances, error budget and grade of robots with these tolerances.

    Args:
        robot: The arm.
        parameters: From :func:`robacc.prediction.parameters.uncertain_parameters`.
        configurations: Configurations of equal weight.
        scale: Scale of the grade.
        meaning: Conversion of a tolerance into a variance, as text.
    """
    chain = Arm.of(robot).chain
    covariances = pose_covariances(chain, configurations.scalars, configurations.n, parameters)
    position = predicted_errors("m", covariances.position, configurations, scale.statistic)
    orientation = predicted_errors("rad", covariances.orientation, configurations, scale.statistic)
    by_parameter = _parameter_shares(parameters, covariances)
    notes = list(configurations.notes)
    if robot.effects:
        notes.append("the robot file's effects are not part of a prediction from tolerances")
    if meaning != NORMAL:
        notes.append("radii and percentiles assume that the sum of all errors is Gaussian; covariances do not")
    return Prediction(
        tuple(parameters),
        configurations,
        position,
        orientation,
        budget=tuple(sorted(by_parameter, key=_largest_first)),
        by_joint=_summed_shares(
            by_parameter, [share.joint or share.name.split(".")[0] for share in by_parameter], "joint"
        ),
        by_kind=_summed_shares(by_parameter, [parameter.component for parameter in parameters], "kind"),
        grade=predicted_grade(position, orientation, scale),
        meaning=meaning,
        notes=tuple(notes),
    )


def predicted_errors(
    unit: Literal["m", "rad"], covariance: Array, configurations: Configurations, statistic: Statistic
) -> PredictedErrors:
    """Return the predicted errors of covariances ``(3, 3, N)`` in the tool's frame."""
    variances = principal_variances(covariance)
    rms = np.sqrt(np.sum(variances, axis=0))
    radius = length_quantiles(RADIUS_PROBABILITY, variances)
    means = mean_lengths(variances)
    return PredictedErrors(
        unit,
        covariance,
        rms,
        radius,
        mean_covariance=np.mean(covariance, axis=2),
        rms=math.sqrt(float(np.mean(np.square(rms)))),
        mean_error=float(np.mean(means)),
        p95=mixture_quantile(RADIUS_PROBABILITY, variances),
        max=float(np.max(radius)),
        worst=_worst(covariance, rms, radius, configurations),
        pose_statistic={"rms": rms, "mean_error": means}.get(statistic, radius),
    )


def _worst(covariance: Array, rms: Array, radius: Array, configurations: Configurations) -> WorstPredictedPose:
    # The first of equal poses: rounding makes a different one the largest on different machines.
    index = int(np.argmax(rms >= (1.0 - 1e-9) * np.max(rms)))
    values, vectors = np.linalg.eigh(covariance[:, :, index])
    direction = vectors[:, 2]
    if direction[np.argmax(np.abs(direction))] < 0:
        direction = -direction
    return WorstPredictedPose(
        index,
        configurations.label(index),
        configurations.q[:, index].copy(),
        float(rms[index]),
        float(radius[index]),
        direction,
        math.sqrt(max(float(values[2]), 0.0)),
    )


def _parameter_shares(parameters: Sequence[ToleranceParameter], covariances: PoseCovariances) -> list[Share]:
    totals = float(covariances.position_power.sum()), float(covariances.orientation_power.sum())
    shares = []
    for i, parameter in enumerate(parameters):
        powers = float(covariances.position_power[i]), float(covariances.orientation_power[i])
        position, orientation = (
            power / total if total > 0 else 0.0 for power, total in zip(powers, totals, strict=True)
        )
        shares.append(
            Share(parameter.name, parameter.joint, parameter.kind, parameter.sd, parameter.unit, position, orientation)
        )
    return shares


def _summed_shares(
    shares: Sequence[Share], keys: Sequence[str], grouping: Literal["joint", "kind"]
) -> tuple[Share, ...]:
    sums: dict[str, list[float]] = {}
    for share, key in zip(shares, keys, strict=True):
        total = sums.setdefault(key, [0.0, 0.0])
        total[0] += share.position
        total[1] += share.orientation
    joints: Mapping[str, str | None] = {key: share.joint for share, key in zip(shares, keys, strict=True)}
    summed = [
        Share(
            key, joints[key] if grouping == "joint" else None, key if grouping == "kind" else None, None, None, *total
        )
        for key, total in sums.items()
    ]
    return tuple(sorted(summed, key=_largest_first))


def _largest_first(share: Share) -> tuple[float, float]:
    """Return a sort key, rounded so that equal shares stay in the chain's order on every machine."""
    return -round(share.position, 9), -round(share.orientation, 9)


def predicted_grade(position: PredictedErrors, orientation: PredictedErrors, scale: Scale) -> PredictedGrade:
    """Return the grade of the predicted errors, and the share of poses that meet each step."""
    error_kinds = (("position", position), ("orientation", orientation))
    ranks = {name: _rank(scale, name, errors.value(scale.statistic)) for name, errors in error_kinds}
    names = [*(step.grade for step in scale.steps), scale.otherwise]
    worst_rank = max(ranks.values())
    meeting = []
    for step in scale.steps:
        meeting_poses = position.pose_statistic <= step.position
        if step.orientation is not None:
            meeting_poses &= orientation.pose_statistic <= step.orientation
        meeting.append((step.grade, float(np.mean(meeting_poses))))
    return PredictedGrade(
        scale,
        names[worst_rank],
        names[ranks["position"]],
        names[ranks["orientation"]],
        tuple(name for name, rank in ranks.items() if rank == worst_rank and worst_rank > 0),
        tuple(meeting),
    )


def _rank(scale: Scale, name: str, value: float) -> int:
    for rank, step in enumerate(scale.steps):
        limit = step.position if name == "position" else step.orientation
        if limit is None or value <= limit:
            return rank
    return len(scale.steps)


def step_limits(scale: Scale, grade: str) -> tuple[float, float | None]:
    """Return the limits of a grade: m, and rad or None.

    Raises:
        UsageError: The scale has no step of that name.
    """
    for step in scale.steps:
        if step.grade == grade:
            return step.position, step.orientation
    raise UsageError(f"no grade {grade!r} on the scale {scale.name}; it has {', '.join(s.grade for s in scale.steps)}")
