"""How accurate an arm is to be expected, from the tolerances of its parameters: equations (7) and (8) over poses.

The prediction is of robots drawn at random from the tolerances. At each pose the error is Gaussian of mean zero with
covariance V_d or V_δ; over poses it is the mixture of these in equal parts.
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

PROBABILITY = 0.95
"""Of the error radius at each pose."""
PERCENTILES = (5, 25, 50, 75, 95)


@dataclass(frozen=True, slots=True)
class WorstPredictedPose:
    """The pose with the largest predicted RMS error."""

    index: int
    label: str
    q: Array
    """``(J,)`` rad or m"""
    rms: float
    """Root of the covariance's trace, m or rad."""
    radius95: float
    """Holds 95 % of the errors there."""
    direction: Array
    """``(3,)`` unit vector in the tool's frame along which the error is largest; its largest component is positive."""
    sd: float
    """Standard deviation along it."""


@dataclass(frozen=True, slots=True)
class PredictedErrors:
    """Predicted position or orientation errors, m or rad."""

    unit: Literal["m", "rad"]
    covariance: Array
    """``(3, 3, N)`` in the tool's frame: equation (7) or (8)."""
    pose_rms: Array
    """``(N,)`` root of the trace."""
    pose_radius95: Array
    """``(N,)`` radius that holds 95 % of the errors at the pose, exactly for Gaussian errors."""
    mean_covariance: Array
    """``(3, 3)`` over poses, tool frame."""
    rms: float
    """Over robots and poses, as the next two."""
    mean_error: float
    p95: float
    max: float
    """Largest of ``pose_radius95``: no bound holds for Gaussian errors."""
    worst: WorstPredictedPose
    pose_statistic: Array
    """``(N,)`` what the grade scale's statistic is at each pose; for p95 and max the 95 % radius."""

    def value(self, statistic: Statistic) -> float:
        """The statistic of that name."""
        return {"rms": self.rms, "mean_error": self.mean_error, "p95": self.p95, "max": self.max}[statistic]

    def percentiles(self) -> dict[int, tuple[float, float]]:
        """Over poses, of the predicted RMS and of the 95 % radius."""
        both = np.percentile(np.stack((self.pose_rms, self.pose_radius95)), PERCENTILES, axis=1)
        return {p: (float(rms), float(radius)) for p, (rms, radius) in zip(PERCENTILES, both, strict=True)}


@dataclass(frozen=True, slots=True)
class Share:
    """What one parameter, joint or kind contributes to the predicted variance; over all of them shares sum to 1."""

    name: str
    joint: str | None
    kind: str | None
    tolerance: float | None
    """Standard deviation, m or rad; None for a sum of several."""
    unit: str | None
    position: float
    orientation: float


@dataclass(frozen=True, slots=True)
class PredictedGrade:
    """Where the prediction stands on a grade scale."""

    scale: Scale
    grade: str
    position: str
    """What position alone would get."""
    orientation: str
    limited_by: tuple[str, ...]
    meeting: tuple[tuple[str, float], ...]
    """Each step's grade and the share of poses whose own statistic meets it, in position and orientation."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """What :func:`predict_accuracy` found."""

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
    """How a tolerance became a variance."""
    notes: tuple[str, ...]


def predict_accuracy(
    robot: Robot,
    parameters: Sequence[ToleranceParameter],
    configurations: Configurations,
    scale: Scale,
    meaning: str = NORMAL,
) -> Prediction:
    """The covariances, error budget and grade to be expected of robots with these tolerances.

    Args:
        robot: The arm.
        parameters: From :func:`robacc.prediction.parameters.uncertain_parameters`.
        configurations: Where; each counts the same.
        scale: Of the grade.
        meaning: How a tolerance became a variance, in words.
    """
    chain = Arm.of(robot).chain
    found = pose_covariances(chain, configurations.scalars, configurations.n, parameters)
    position = _errors("m", found.position, configurations, scale.statistic)
    orientation = _errors("rad", found.orientation, configurations, scale.statistic)
    by_parameter = _shares(parameters, found)
    notes = list(configurations.notes)
    if robot.effects:
        notes.append("the robot file's effects are not part of a prediction from tolerances")
    if meaning != NORMAL:
        notes.append("radii and percentiles take the sum of all errors to be Gaussian; covariances do not")
    return Prediction(
        tuple(parameters),
        configurations,
        position,
        orientation,
        budget=tuple(sorted(by_parameter, key=_largest_first)),
        by_joint=_summed(by_parameter, [share.joint or share.name.split(".")[0] for share in by_parameter], "joint"),
        by_kind=_summed(by_parameter, [parameter.component for parameter in parameters], "kind"),
        grade=predicted_grade(position, orientation, scale),
        meaning=meaning,
        notes=tuple(notes),
    )


def _errors(
    unit: Literal["m", "rad"], covariance: Array, configurations: Configurations, statistic: Statistic
) -> PredictedErrors:
    variances = principal_variances(covariance)
    rms = np.sqrt(np.sum(variances, axis=0))
    radius = length_quantiles(PROBABILITY, variances)
    means = mean_lengths(variances)
    return PredictedErrors(
        unit,
        covariance,
        rms,
        radius,
        mean_covariance=np.mean(covariance, axis=2),
        rms=math.sqrt(float(np.mean(np.square(rms)))),
        mean_error=float(np.mean(means)),
        p95=mixture_quantile(PROBABILITY, variances),
        max=float(np.max(radius)),
        worst=_worst(covariance, rms, radius, configurations),
        pose_statistic={"rms": rms, "mean_error": means}.get(statistic, radius),
    )


def _worst(covariance: Array, rms: Array, radius: Array, configurations: Configurations) -> WorstPredictedPose:
    # The first of equal ones: which of them rounding makes the largest differs between machines.
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


def _shares(parameters: Sequence[ToleranceParameter], found: PoseCovariances) -> list[Share]:
    totals = float(found.position_power.sum()), float(found.orientation_power.sum())
    shares = []
    for i, parameter in enumerate(parameters):
        parts = float(found.position_power[i]), float(found.orientation_power[i])
        position, orientation = (part / total if total > 0 else 0.0 for part, total in zip(parts, totals, strict=True))
        shares.append(
            Share(parameter.name, parameter.joint, parameter.kind, parameter.sd, parameter.unit, position, orientation)
        )
    return shares


def _summed(shares: Sequence[Share], keys: Sequence[str], what: Literal["joint", "kind"]) -> tuple[Share, ...]:
    sums: dict[str, list[float]] = {}
    for share, key in zip(shares, keys, strict=True):
        total = sums.setdefault(key, [0.0, 0.0])
        total[0] += share.position
        total[1] += share.orientation
    joints: Mapping[str, str | None] = {key: share.joint for share, key in zip(shares, keys, strict=True)}
    summed = [
        Share(key, joints[key] if what == "joint" else None, key if what == "kind" else None, None, None, *total)
        for key, total in sums.items()
    ]
    return tuple(sorted(summed, key=_largest_first))


def _largest_first(share: Share) -> tuple[float, float]:
    """Rounded, so that equal shares stay in the chain's order on every machine."""
    return -round(share.position, 9), -round(share.orientation, 9)


def predicted_grade(position: PredictedErrors, orientation: PredictedErrors, scale: Scale) -> PredictedGrade:
    """Grade of the predicted errors, and the share of poses that meet each step."""
    both = (("position", position), ("orientation", orientation))
    ranks = {name: _rank(scale, name, errors.value(scale.statistic)) for name, errors in both}
    names = [*(step.grade for step in scale.steps), scale.otherwise]
    worst = max(ranks.values())
    meeting = []
    for step in scale.steps:
        within = position.pose_statistic <= step.position
        if step.orientation is not None:
            within &= orientation.pose_statistic <= step.orientation
        meeting.append((step.grade, float(np.mean(within))))
    return PredictedGrade(
        scale,
        names[worst],
        names[ranks["position"]],
        names[ranks["orientation"]],
        tuple(name for name, rank in ranks.items() if rank == worst and worst > 0),
        tuple(meeting),
    )


def _rank(scale: Scale, name: str, value: float) -> int:
    for rank, step in enumerate(scale.steps):
        limit = step.position if name == "position" else step.orientation
        if limit is None or value <= limit:
            return rank
    return len(scale.steps)


def step_limits(scale: Scale, grade: str) -> tuple[float, float | None]:
    """Limits of a grade: m, and rad or None.

    Raises:
        UsageError: the scale has no step of that name.
    """
    for step in scale.steps:
        if step.grade == grade:
            return step.position, step.orientation
    raise UsageError(f"no grade {grade!r} on the scale {scale.name}; it has {', '.join(s.grade for s in scale.steps)}")
