"""Result of a correction: corrected commands, expected errors and their grades, for all targets of a file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.accuracy.grade_scale import Scale
from robacc.accuracy.metrics import ErrorMetrics, PoseMetrics, length_metrics, pose_metrics
from robacc.correction.circumstances import Circumstances
from robacc.correction.correcting import CorrectedTargets, correct_targets
from robacc.correction.expected import ExpectedErrors, expected_errors
from robacc.correction.limits import Limits
from robacc.correction.refusal import Cause, counts
from robacc.correction.robots import FrameName, RobotPair, robot_pair
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.prediction.calibrated import completed
from robacc.prediction.model_fit import ModelFit
from robacc.prediction.model_uncertainty import model_uncertainty
from robacc.robots.description import Robot

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
        position, orientation = uncertainty.position, uncertainty.orientation if uncertainty.is_oriented else None
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
