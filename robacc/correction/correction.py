"""Correction of targets: commands that make the real arm reach them, refused targets, and expected errors.

Equation: with F the nominal kinematics, G the model of the real arm and x the wanted pose, the joint command q' solves
G(q') = x, and the Cartesian command is F(q'). Without a correction the arm reaches G(F^-1(x)).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.estimation import ErrorMetrics, PoseMetrics, length_metrics, pose_metrics
from robacc.accuracy.grade import Quantity, Scale
from robacc.correction.solving import Evaluate, JointSolution, solve
from robacc.correction.wanted import (
    Circumstances,
    FrameName,
    RobotPair,
    WantedPoses,
    arm_length,
    joint_space,
    nominal_poses,
    part_of,
    pose_error,
    pose_evaluator,
    robot_pair,
    row_weights,
    wanted_poses,
)
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements
from robacc.prediction.model_fit import ModelFit
from robacc.prediction.model_uncertainty import completed, model_uncertainty
from robacc.prediction.predicting import steps_met
from robacc.robots.description import Robot
from robacc.robots.inverse_kinematics import pose_jacobian
from robacc.statistics.distributions import normal_quantile

# Limits of a correction.


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits beyond which a target is refused, and the weight for arms with fewer than six axes."""

    position: float | None = None
    """m: largest correction; None for no limit."""
    orientation: float | None = None
    """rad"""
    weight: float = 0.01
    """m per rad: weight of orientation for arms with fewer than six axes."""
    beyond_range: bool = False
    """Correct targets outside the validity range of the model too."""
    ranges: Mapping[str, tuple[float, float]] | None = None
    """Lowest and highest value that the model was fitted on, by joint or column; None if unknown."""


# Reasons for which a target is not corrected.

_TOLERANCE = 1e-6
"""m and rad"""
_AMPLIFICATION = 30.0
"""Largest turn of a joint as a multiple of the correction's angle; away from singular poses it is 1 to 5."""
_NOTICEABLE = np.radians(0.5)
"""rad: turn of a joint below which a singular pose does no harm."""
_MARGIN = 0.05
"""Share of a range by which a target may exceed it."""
_DEGREES = 180.0 / np.pi


class Cause(StrEnum):
    """Cause of a refusal."""

    unreached = "unreached"
    limit = "limit"
    approach = "approach"
    singular = "singular"
    configuration = "configuration"
    too_large = "too_large"
    out_of_range = "out_of_range"


@dataclass(frozen=True, slots=True)
class Refusal:
    """Cause of the refusal of a target, and the reason as a sentence."""

    cause: Cause
    reason: str


def refusals(
    pair: RobotPair, wanted: WantedPoses, setting: Circumstances, solution: JointSolution, limits: Limits
) -> tuple[Refusal | None, ...]:
    """Return the reason of each target that is refused, the first that applies; None for the others."""
    names, n_joints = pair.model.arm.names, solution.q.shape[0]
    joints, length = joint_space(pair, wanted.q), arm_length(pair.nominal, wanted.q)
    result: list[Refusal | None] = [None] * solution.q.shape[1]

    def refuse(refused: NDArray[np.bool_], cause: Cause, reason: Callable[[int], str]) -> None:
        for i in np.flatnonzero(refused).tolist():
            result[i] = result[i] or Refusal(cause, reason(i))

    configuration = "" if wanted.given == "poses" else " in the configuration of its joints"
    reached = f"the nominal robot does not reach the wanted pose{configuration}"
    refuse(~wanted.reached, Cause.unreached, lambda _: reached)
    for outside, reason in _out_of_range(pair, setting, wanted, limits):
        refuse(outside, Cause.out_of_range, lambda _, reason=reason: reason)  # type: ignore[misc]

    # Targets that the model does not reach, because of a limit, the approach, or a singular pose. Arms with fewer axes
    # never reach every pose: what counts is whether a limit takes part.
    at_limit = (solution.q <= joints.low[:, None]) | (solution.q >= joints.high[:, None])
    failed = ~solution.settled | np.any(at_limit, axis=0)
    if not wanted.oriented or n_joints >= 6:
        failed = np.max(np.abs(solution.error), axis=0, initial=0.0) > _TOLERANCE
    remaining = _amounts(solution.error)

    def stopped(i: int) -> str:
        limited = " and ".join(names[j] for j in np.flatnonzero(at_limit[:, i]))
        return f"the correction would take {limited} beyond the joint limit"

    approach = "a joint moves less than its play since the previous target, so its direction of approach is unknown"
    refuse(failed & np.any(at_limit, axis=0), Cause.limit, stopped)
    refuse(failed & setting.follows_order & solution.settled, Cause.approach, lambda _: approach)
    converges = "near a singular pose the correction does not converge"
    refuse(failed, Cause.singular, lambda i: f"{converges}: {_sizes(*remaining[:, i])} remain")

    # Near a singular pose joints turn far or change the configuration.
    correction = _amounts(pose_error(nominal_poses(pair, setting, solution.q), wanted.poses, True))
    move = np.abs(solution.q - wanted.q) / joints.scale[:, None]
    largest, joint = np.max(move, axis=0), np.argmax(move, axis=0)
    amplified = largest / np.maximum(correction[0] / length + correction[1], 1e-9)

    def moves(i: int) -> str:
        turn = f"{float(largest[i]) * _DEGREES:.2g}°"
        return f"near a singular pose: {names[joint[i]]} would move by {turn} for {_sizes(*correction[:, i])}"

    refuse((amplified > _AMPLIFICATION) & (largest > _NOTICEABLE), Cause.singular, moves)
    if wanted.oriented and n_joints == 6:
        before, after = (
            np.linalg.det(np.moveaxis(pose_jacobian(pair.nominal, q)[1], 2, 0)) for q in (wanted.q, solution.q)
        )
        passes = "the correction would pass a singular pose into another configuration"
        refuse(before * after < 0.0, Cause.configuration, lambda _: passes)

    most = (limits.position, limits.orientation if wanted.oriented else None)
    far = np.any(correction > [[np.inf if limit is None else limit] for limit in most], axis=0)
    allowed = _sizes(limits.position, limits.orientation)
    refuse(
        far,
        Cause.too_large,
        lambda i: f"the correction of {_sizes(*correction[:, i])} is larger than {allowed}, see `most`",
    )
    return tuple(result)


def _out_of_range(
    pair: RobotPair, setting: Circumstances, wanted: WantedPoses, limits: Limits
) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """Yield targets ``(N,)`` outside the validity range of an effect, or of what the model was fitted on, and why.

    A temperature that no effect depends on refuses no target.
    """
    if limits.beyond_range:
        return
    arm = pair.model.arm
    data = setting.at(wanted.q, setting.motion(wanted.q), np.arange(wanted.q.shape[1]))
    for known in pair.model.known:
        yield known.is_held_at(arm, data), f"outside the validity range of {known.effect}"
    columns: dict[str, Array | None] = dict(zip(arm.names, wanted.q, strict=True))
    columns["payload_kg"] = data.payload
    if any("temperature_c" in known.effect.validity_drivers(arm) for known in pair.model.known):
        columns["temperature_c"] = data.temperature
    for name, (low, high) in (limits.ranges or {}).items():
        if (values := columns.get(name)) is not None:
            margin = _MARGIN * (high - low)
            outside = (values < low - margin) | (values > high + margin)
            yield outside, f"{name} is outside the range that the model was fitted on"


def _amounts(error: Array) -> Array:
    """Return the lengths ``(2, N)`` of the first three components and of the others; zero without others."""
    return np.stack((np.linalg.norm(error[:3], axis=0), np.linalg.norm(error[3:], axis=0)))


def _sizes(position: float | None, angle: float | None) -> str:
    """Return lengths in mm and angles in degrees as text."""
    parts = [] if position is None else [f"{1e3 * float(position):.3g} mm"]
    parts += [] if angle is None else [f"{float(angle) * _DEGREES:.2g}°"]
    return " and ".join(parts)


_SAME_APPROACH = 1e-6
"""Change of a relative speed that changes no pose by as much as the tolerance."""
_ROUNDS = 5
"""Rounds over all targets until directions and speeds of approach agree with the corrected commands."""

Motion = tuple[Array | None, Array | None]
"""Direction and speed of approach ``(J, N)``; None where unknown."""


@dataclass(frozen=True, slots=True)
class CorrectedTargets:
    """Commands of all targets; a refused target keeps its nominal command."""

    pair: RobotPair
    wanted: WantedPoses
    q: Array
    """``(J, N)`` corrected joint commands, rad or m."""
    command: Poses
    """``(N)`` poses that the controller computes for ``q``, measuring frame."""
    data: Measurements
    """Targets at their corrected commands, with their circumstances."""
    correction: Array
    """``(6, N)`` command less wanted pose: m, and a rotation vector in rad, measuring frame."""
    error_before: Array
    """``(6, N)`` predicted pose at the nominal command less wanted pose."""
    error_after: Array
    """``(6, N)`` predicted pose at the corrected command less wanted pose; for a refused target as before."""
    refusals: tuple[Refusal | None, ...]
    """``(N)`` reason of each refused target; None for a corrected target."""

    @property
    def is_corrected(self) -> NDArray[np.bool_]:
        """``(N,)`` targets with a correction."""
        return np.array([refusal is None for refusal in self.refusals], dtype=bool)


def correct_targets(data: Measurements, pair: RobotPair, setting: Circumstances, limits: Limits) -> CorrectedTargets:
    """Return the corrected commands of targets.

    Raises:
        InputError: The targets have neither joints nor poses, or the arm has no elastic equilibrium.
        MissingColumnError: The targets lack what an effect of the model depends on.
    """
    wanted = wanted_poses(data, pair, setting)
    matters = _approach_matters(pair, setting, wanted.q)
    solution = _solved(pair, wanted, setting, limits, matters)
    refused = refusals(pair, wanted, setting, solution, limits)
    is_refused = np.array([refusal is not None for refusal in refused], dtype=bool)
    if is_refused.any() and any(matters):
        # Refused targets keep their nominal command, which changes the approach to the targets after them.
        solution = _solved(pair, wanted, setting, limits, matters, (solution, is_refused))
        again = refusals(pair, wanted, setting, solution, limits)
        refused = tuple(first or second for first, second in zip(refused, again, strict=True))
        is_refused = np.array([refusal is not None for refusal in refused], dtype=bool)
    q = np.where(is_refused, wanted.q, solution.q)
    corrected, uncorrected = (setting.at(each, setting.motion(each), np.arange(data.n)) for each in (q, wanted.q))
    command = nominal_poses(pair, setting, q)
    error_before, error_after = (
        -pose_error(wanted.poses, pair.model.bind(poses).poses(np.zeros(0)), True) for poses in (uncorrected, corrected)
    )
    return CorrectedTargets(
        pair,
        wanted,
        q,
        command,
        corrected,
        correction=-pose_error(wanted.poses, command, True),
        error_before=error_before,
        error_after=error_after,
        refusals=refused,
    )


def _solved(
    pair: RobotPair,
    wanted: WantedPoses,
    setting: Circumstances,
    limits: Limits,
    matters: tuple[bool, bool],
    beside: tuple[JointSolution, NDArray[np.bool_]] | None = None,
) -> JointSolution:
    """Return the solution of all targets, each near its nominal joints.

    It is repeated for targets whose approach changes with the commands of others, in a way that ``matters`` to the
    model: in direction, in speed. With a solution ``beside`` and the targets that were refused in it, return the one
    where these stay at their nominal joints.
    """
    nominal, n = wanted.q, wanted.q.shape[1]
    joints, length = joint_space(pair, nominal), arm_length(pair.nominal, nominal)
    weights = row_weights(wanted.oriented, nominal.shape[0], length, limits.weight)

    def changed(before: Motion, after: Motion) -> NDArray[np.int64]:
        """Return the numbers of targets to solve again."""
        result = np.zeros(n, dtype=bool)
        for old, new, counts in zip(before, after, matters, strict=True):
            if counts and old is not None and new is not None:
                result |= np.any(np.abs(new - old) > _SAME_APPROACH, axis=0)
        return np.flatnonzero(result & chosen)

    chosen, index = np.ones(n, dtype=bool), np.arange(n)
    q, error, settled = nominal.copy(), np.zeros((weights.size, n)), np.zeros(n, dtype=bool)
    if beside is not None:
        before, chosen = beside[0], ~beside[1]
        q, error, settled = np.where(chosen, before.q, nominal), before.error.copy(), before.settled.copy()
        index = changed(setting.motion(before.q), setting.motion(q))

    def evaluator() -> Evaluate:
        return pose_evaluator(pair.model, part_of(wanted.poses, index), wanted.oriented, setting, motion, index)

    motion = setting.motion(q)
    for _ in range(_ROUNDS):
        if index.size == 0:
            break
        part = solve(evaluator(), nominal[:, index], joints, weights, q[:, index])
        q[:, index], error[:, index], settled[index] = part.q, part.error, part.settled
        previous, motion = motion, setting.motion(q)
        index = changed(previous, motion)
    if index.size:
        # The approach does not agree with the commands: the error shows it, and the target is refused.
        error[:, index] = evaluator()(q[:, index], np.arange(index.size))[0]
    return JointSolution(q, error, settled)


def _approach_matters(pair: RobotPair, setting: Circumstances, q: Array) -> tuple[bool, bool]:
    """Return whether the model's poses depend on direction and on speed of approach, where the order gives them."""
    if not setting.follows_order:
        return False, False
    index = np.arange(min(q.shape[1], 2))
    results = []
    for signs in ((1.0, 1.0), (-1.0, 1.0), (1.0, -1.0)):
        direction, speed = (np.full(q.shape, sign) for sign in signs)
        poses = pair.model.bind(setting.at(q[:, index], (direction, speed), index)).poses(np.zeros(0))
        results.append(np.concatenate((poses.rotation.reshape(9, -1), poses.translation)))
    return not np.array_equal(results[0], results[1]), not np.array_equal(results[0], results[2])


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
    counted: tuple[tuple[Quantity, Array | None], ...] = (("position", bounds[0]), ("orientation", bounds[1]))
    sizes = {name: bound for name, bound in counted[: 1 + oriented] if bound is not None}
    grades = None
    if "position" in sizes:
        # The best grade whose limits the bounds meet.
        grades = tuple(map(scale.name_of, np.argmax(steps_met(scale, sizes), axis=0).tolist()))
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
    return np.asarray(
        np.sqrt(np.maximum(first + np.where(scatter, (quantile - dof) * np.sqrt(second / dof), 0.0), 0.0))
    )


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
        """Number of refused targets by cause, the causes in their order."""
        causes = [refusal.cause for refusal in self.targets.refusals if refusal is not None]
        return {cause: causes.count(cause) for cause in Cause if cause in causes}


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
        notes.append("a joint target is taken as the pose that the nominal robot has there")
    if pair.left_out:
        listed = ", ".join(map(str, pair.left_out))
        notes.append(f"{listed}: an effect of the measurement, not of the arm, is not corrected")
    if setting.follows_order and setting.columns.direction is None and setting.columns.speed is None:
        notes.append("assumed: the arm drives to the targets in their order; the approach to the first is unknown")
    if targets.wanted.oriented and targets.q.shape[0] < 6:
        notes.append(
            f"{targets.q.shape[0]} axes do not reach every pose: the correction has the least error, where 1° of "
            f"orientation counts as {1e3 * limits.weight / _DEGREES:.3g} mm"
        )
    return notes
