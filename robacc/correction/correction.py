"""Result of a correction: corrected commands, expected errors with their bounds, and their grades."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.accuracy.grade import Quantity, Scale
from robacc.accuracy.pose_errors import ErrorMetrics, PoseMetrics, length_metrics, pose_metrics
from robacc.correction.correcting import Cause, CorrectedTargets, Limits, correct_targets, counts
from robacc.correction.wanted import Circumstances, FrameName, RobotPair, robot_pair
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.prediction.model_fit import ModelFit
from robacc.prediction.model_uncertainty import completed, model_uncertainty
from robacc.prediction.predicting import steps_met
from robacc.robots.description import Robot
from robacc.statistics.distributions import normal_quantile

# Expected errors of targets before and after the correction: their length, its 95 % bound, and the grade.
#
# A predicted error e with covariance V of what the model does not know has a length below the bound with probability
# 0.95. Its square is a weighted sum of noncentral chi-squares, here by Pearson's approximation with three cumulants,
# within 2 % of the exact radius. Source: E. S. Pearson, "Note on an approximation to the distribution of non-central
# chi-square", Biometrika 46 (1959); for quadratic forms J. P. Imhof, Biometrika 48 (1961), eq. 4.2.

PROBABILITY = 0.95


@dataclass(frozen=True, slots=True)
class ExpectedErrors:
    """Expected errors of N targets, at their nominal or at their corrected commands."""

    position: Array
    """``(N,)`` length of the predicted error, m."""
    orientation: Array
    """``(N,)`` angle of the predicted error, rad."""
    position_rms: Array
    """``(N,)`` root mean square of the error's length: predicted error and uncertainty of the model, m."""
    orientation_rms: Array
    """``(N,)`` rad."""
    position_bound: Array | None
    """``(N,)`` bound of 95 % of the errors, m; None where the model has no uncertainty."""
    orientation_bound: Array | None
    """``(N,)`` rad; None where the model has no uncertainty of orientation."""
    grades: tuple[str, ...] | None
    """``(N,)`` grade of each bound; None without bounds."""

    @property
    def orientation_is_known(self) -> bool:
        """Return whether the model says how uncertain its orientation is; a fit to positions alone does not."""
        return self.position_bound is None or self.orientation_bound is not None


def expected_errors(
    error: Array, position: Array | None, orientation: Array | None, scale: Scale, oriented: bool
) -> ExpectedErrors:
    """Return lengths, bounds and grades of predicted errors ``(6, N)``.

    Args:
        error: Predicted position errors, m, and orientation errors, rad.
        position: ``(3, 3, N)`` covariance of the unpredicted position error, m²; None if unknown.
        orientation: ``(3, 3, N)`` rad²; None if unknown.
        scale: Scale of the grades.
        oriented: Whether orientation counts.
    """
    lengths, rms, bounds = [], [], []
    for part, covariance in ((error[:3], position), (error[3:], orientation)):
        square = np.sum(np.square(part), axis=0)
        lengths.append(np.sqrt(square))
        rms.append(np.sqrt(square + (0.0 if covariance is None else np.einsum("iin->n", covariance))))
        bounds.append(None if covariance is None else length_bound(PROBABILITY, part, covariance))
    grades = None
    if bounds[0] is not None:
        grades = target_grades(scale, bounds[0], bounds[1] if oriented else None)
    return ExpectedErrors(lengths[0], lengths[1], rms[0], rms[1], bounds[0], bounds[1], grades)


def length_bound(probability: float, mean: Array, covariance: Array) -> Array:
    """Return radii ``(N,)`` about zero that contain ``probability`` of N(mean, covariance).

    Args:
        probability: Above 0.5.
        mean: ``(3, N)``.
        covariance: ``(3, 3, N)``.
    """
    moved = np.einsum("ijn,jn->in", covariance, mean)
    square = np.einsum("ijn,jkn->ikn", covariance, covariance)
    first = np.einsum("iin->n", covariance) + np.sum(np.square(mean), axis=0)
    second = np.einsum("iin->n", square) + 2.0 * np.sum(mean * moved, axis=0)
    third = np.einsum("ijn,jin->n", square, covariance) + 3.0 * np.sum(np.square(moved), axis=0)
    scatter = second > 1e-28 * np.square(first)
    dof = np.where(scatter, second**3 / np.where(scatter, third, 1.0) ** 2, 1.0)
    # Wilson and Hilferty's cube root; at one degree of freedom, exactly.
    part = 2.0 / (9.0 * dof)
    quantile = dof * (1.0 - part + normal_quantile(probability) * np.sqrt(part)) ** 3
    quantile = np.where(dof <= 1.0, normal_quantile(0.5 * (1.0 + probability)) ** 2, quantile)
    result: Array = np.sqrt(np.maximum(first + np.where(scatter, (quantile - dof) * np.sqrt(second / dof), 0.0), 0.0))
    return result


def target_grades(scale: Scale, position: Array, orientation: Array | None) -> tuple[str, ...]:
    """Return the best grade whose limits position (m) and orientation (rad), each ``(N,)``, meet."""
    sizes: dict[Quantity, Array] = {"position": position}
    if orientation is not None:
        sizes["orientation"] = orientation
    return tuple(scale.name_of(rank) for rank in np.argmax(steps_met(scale, sizes), axis=0).tolist())


def grade_counts(scale: Scale, grades: Sequence[str]) -> tuple[tuple[str, int], ...]:
    """Return the number of targets of each grade, the best first."""
    names = [*(step.grade for step in scale.steps), scale.otherwise]
    return tuple((name, list(grades).count(name)) for name in names)


_DEGREES = 180.0 / np.pi


@dataclass(frozen=True, slots=True)
class Correction:
    """Corrected targets with their expected errors."""

    targets: CorrectedTargets
    limits: Limits
    limits_source: Literal["option", "model", "none"]
    before: ExpectedErrors
    """At the nominal commands."""
    after: ExpectedErrors
    """At the corrected commands."""
    scale: Scale
    notes: tuple[str, ...]
    """Assumptions and limitations."""

    @property
    def n_targets(self) -> int:
        """Number of targets."""
        return len(self.targets.refusals)

    @property
    def n_corrected(self) -> int:
        """Number of corrected targets."""
        return int(np.count_nonzero(self.targets.is_corrected))

    @property
    def correction_metrics(self) -> PoseMetrics:
        """Metrics of the corrected targets' corrections, m and rad."""
        return pose_metrics(self.targets.correction[:, self.targets.is_corrected])

    def metrics(self, sizes: Array) -> ErrorMetrics:
        """Return the metrics over the corrected targets of sizes ``(N,)`` of all targets, m or rad."""
        return length_metrics(sizes[self.targets.is_corrected])

    @property
    def causes(self) -> dict[Cause, int]:
        """Number of refused targets by cause."""
        return counts(self.targets.refusals)


def correction(
    data: Measurements,
    model: Robot,
    nominal: Robot,
    setting: Circumstances,
    fit: ModelFit | None,
    *,
    frame: FrameName,
    limits: Limits,
    limits_source: Literal["option", "model", "none"],
    scale: Scale,
) -> Correction:
    """Correct targets and compute their expected errors.

    Raises:
        InputError: The robots have different joints, or the targets cannot be used.
        MissingColumnError: The targets lack what an effect of the model depends on.
    """
    pair = robot_pair(model, nominal, frame)
    targets = correct_targets(data, pair, setting, limits)
    oriented = targets.wanted.oriented
    position, orientation = None, None
    if fit is not None:
        uncertainty = model_uncertainty(model, fit, completed(model, fit, None, targets.data, 0), measured=False)
        position, orientation = uncertainty.position, uncertainty.orientation if fit.unexplained.shape[0] == 6 else None
    before = expected_errors(targets.error_before, position, orientation, scale, oriented)
    after = expected_errors(targets.error_after, position, orientation, scale, oriented)
    return Correction(
        targets, limits, limits_source, before, after, scale, tuple(_notes(pair, targets, setting, limits))
    )


def _notes(pair: RobotPair, targets: CorrectedTargets, setting: Circumstances, limits: Limits) -> list[str]:
    notes = []
    if targets.wanted.given == "joints":
        notes.append("joint targets mean the pose that the nominal robot has there")
    if pair.left_out:
        listed = ", ".join(map(str, pair.left_out))
        notes.append(f"{listed}: an effect of the measurement, not of the arm, is not corrected")
    if setting.follows_order and setting.columns.direction is None and setting.columns.speed is None:
        notes.append("the arm drives from target to target in their order; the approach to the first is unknown")
    if targets.wanted.oriented and targets.q.shape[0] < 6:
        notes.append(
            f"{targets.q.shape[0]} axes do not reach every pose: the correction has the least error, where 1° of "
            f"orientation counts as {1e3 * limits.weight / _DEGREES:.3g} mm"
        )
    return notes
