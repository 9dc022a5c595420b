"""Correction of targets: the commands that make the real arm reach them, and the refusal of targets.

Equation: with F the nominal kinematics, G the model of the real arm and x the wanted pose, the joint command q' solves
G(q') = x, and the Cartesian command is F(q'). Without a correction the arm reaches G(F^-1(x)).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from robacc.correction.solving import Evaluate, JointSolution, solve
from robacc.correction.wanted import (
    Circumstances,
    PoseEvaluator,
    RobotPair,
    WantedPoses,
    arm_length,
    joint_space,
    nominal_poses,
    pose_error,
    row_weights,
    wanted_poses,
)
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements
from robacc.robots.inverse_kinematics import pose_jacobian

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


def counts(reasons: tuple[Refusal | None, ...]) -> dict[Cause, int]:
    """Return the number of refused targets by cause, the causes in their order."""
    causes = [refusal.cause for refusal in reasons if refusal is not None]
    return {cause: causes.count(cause) for cause in Cause if cause in causes}


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
    rounds = _ApproachRounds(pair, wanted, setting, limits, _approach_matters(pair, setting, wanted.q))
    solution = rounds.solved()
    refused = refusals(pair, wanted, setting, solution, limits)
    is_refused = np.array([refusal is not None for refusal in refused], dtype=bool)
    if is_refused.any() and any(rounds.matters):
        # Refused targets keep their nominal command, which changes the approach to the targets after them.
        solution = rounds.solved((solution, is_refused))
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


@dataclass(frozen=True, slots=True)
class _ApproachRounds:
    """Solution of all targets, repeated where the approach to a target changes with the commands."""

    pair: RobotPair
    wanted: WantedPoses
    setting: Circumstances
    limits: Limits
    matters: tuple[bool, bool]
    """Whether the model depends on the direction and on the speed of approach."""

    def solved(self, beside: tuple[JointSolution, NDArray[np.bool_]] | None = None) -> JointSolution:
        """Return the solution of all targets, each near its nominal joints.

        With a solution and the targets that were refused in it, return the one where these stay at their nominal
        joints. Targets whose approach changes with the commands of others are solved again.
        """
        nominal = self.wanted.q
        joints, length = joint_space(self.pair, nominal), arm_length(self.pair.nominal, nominal)
        weights = row_weights(self.wanted.oriented, nominal.shape[0], length, self.limits.weight)
        if beside is None:
            chosen = np.ones(nominal.shape[1], dtype=bool)
            q, error, settled = nominal.copy(), np.zeros((weights.size, chosen.size)), np.zeros_like(chosen)
            index = np.arange(chosen.size)
        else:
            before, chosen = beside[0], ~beside[1]
            q, error, settled = np.where(chosen, before.q, nominal), before.error.copy(), before.settled.copy()
            changed = self._changed(self.setting.motion(before.q), self.setting.motion(q))
            index = np.flatnonzero(changed & chosen)
        motion = self.setting.motion(q)
        for _ in range(_ROUNDS):
            if index.size == 0:
                break
            part = solve(self._evaluator(motion, index), nominal[:, index], joints, weights, q[:, index])
            q[:, index], error[:, index], settled[index] = part.q, part.error, part.settled
            previous, motion = motion, self.setting.motion(q)
            index = np.flatnonzero(self._changed(previous, motion) & chosen)
        if index.size:
            # The approach does not agree with the commands: the error shows it, and the target is refused.
            error[:, index] = self._evaluator(motion, index)(q[:, index], np.arange(index.size))[0]
        return JointSolution(q, error, settled)

    def _evaluator(self, motion: Motion, index: NDArray[np.int64]) -> Evaluate:
        evaluate = PoseEvaluator(self.pair.model, self.wanted.poses, self.wanted.oriented, self.setting, motion)
        return lambda q, part: evaluate(q, index[part])

    def _changed(self, before: Motion, after: Motion) -> NDArray[np.bool_]:
        """Return ``(N,)`` targets whose approach changed in a way that matters to the model."""
        result = np.zeros(self.wanted.q.shape[1], dtype=bool)
        for old, new, matters in zip(before, after, self.matters, strict=True):
            if matters and old is not None and new is not None:
                result |= np.any(np.abs(new - old) > _SAME_APPROACH, axis=0)
        return result


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
