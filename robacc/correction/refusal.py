"""Reasons for which a target is not corrected."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from robacc.correction.circumstances import Circumstances
from robacc.correction.limits import Limits
from robacc.correction.robots import RobotPair, arm_length
from robacc.correction.solving import JointSolution
from robacc.correction.wanted import WantedPoses, joint_space, nominal_poses, pose_error
from robacc.geometry import Array
from robacc.robots.inverse_kinematics import pose_jacobian

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
    result: list[Refusal | None] = [None] * solution.q.shape[1]
    sources = (
        _unreached(wanted),
        _out_of_range(pair, setting, wanted, limits),
        _unsolved(pair, wanted, setting, solution),
        _singular(pair, wanted, setting, solution),
        _too_large(pair, wanted, setting, solution, limits),
    )
    for source in sources:
        for number, refusal in source.items():
            if result[number] is None:
                result[number] = refusal
    return tuple(result)


def _unreached(wanted: WantedPoses) -> dict[int, Refusal]:
    configuration = "" if wanted.given == "poses" else " in the configuration of its joints"
    reason = f"the nominal robot does not reach the wanted pose{configuration}"
    return {int(i): Refusal(Cause.unreached, reason) for i in np.flatnonzero(~wanted.reached)}


def _unsolved(
    pair: RobotPair, wanted: WantedPoses, setting: Circumstances, solution: JointSolution
) -> dict[int, Refusal]:
    """Return targets that the model does not reach, because of a limit, the approach, or a singular pose."""
    error = np.max(np.abs(solution.error), axis=0, initial=0.0)
    is_exact = not wanted.oriented or solution.q.shape[0] >= 6
    failed = (error > _TOLERANCE) if is_exact else ~solution.settled
    joints = joint_space(pair, wanted.q)
    names = pair.model.arm.names
    at_limit = (solution.q <= joints.low[:, None]) | (solution.q >= joints.high[:, None])
    if not is_exact:
        # Fewer axes never reach every pose: what counts is whether a limit takes part.
        failed |= np.any(at_limit, axis=0)
    result = {}
    for i in np.flatnonzero(failed):
        stopped = [names[j] for j in np.flatnonzero(at_limit[:, i])]
        if stopped:
            reason = f"the correction would take {' and '.join(stopped)} beyond the joint limit"
            result[int(i)] = Refusal(Cause.limit, reason)
        elif setting.follows_order and solution.settled[i]:
            reason = (
                "a joint moves less than its play since the previous target, so its direction of approach is unknown"
            )
            result[int(i)] = Refusal(Cause.approach, reason)
        else:
            position, angle = _amounts(solution.error[:, [i]])
            reason = f"near a singular pose the correction does not converge: {_sizes(position[0], angle[0])} remain"
            result[int(i)] = Refusal(Cause.singular, reason)
    return result


def _singular(
    pair: RobotPair, wanted: WantedPoses, setting: Circumstances, solution: JointSolution
) -> dict[int, Refusal]:
    """Return targets near a singular pose, where joints turn far or change the configuration."""
    joints, length = joint_space(pair, wanted.q), arm_length(pair.nominal, wanted.q)
    move = np.abs(solution.q - wanted.q) / joints.scale[:, None]
    position, angle = _corrections(pair, wanted, setting, solution)
    amplified = np.max(move, axis=0) / np.maximum(position / length + angle, 1e-9)
    result = {}
    names = pair.model.arm.names
    for i in np.flatnonzero((amplified > _AMPLIFICATION) & (np.max(move, axis=0) > _NOTICEABLE)):
        joint = int(np.argmax(move[:, i]))
        turn = f"{float(move[joint, i]) * _DEGREES:.2g}°"
        reason = f"near a singular pose: {names[joint]} would move by {turn} for {_sizes(position[i], angle[i])}"
        result[int(i)] = Refusal(Cause.singular, reason)
    if wanted.oriented and solution.q.shape[0] == 6:
        before, after = (np.linalg.det(_jacobians(pair, q)) for q in (wanted.q, solution.q))
        for i in np.flatnonzero(before * after < 0.0):
            reason = "the correction would pass a singular pose into another configuration"
            result.setdefault(int(i), Refusal(Cause.configuration, reason))
    return result


def _jacobians(pair: RobotPair, q: Array) -> Array:
    return np.moveaxis(pose_jacobian(pair.nominal, q)[1], 2, 0)


def _corrections(
    pair: RobotPair, wanted: WantedPoses, setting: Circumstances, solution: JointSolution
) -> tuple[Array, Array]:
    """Return the lengths (m) and angles (rad) of the corrections ``(N,)``."""
    return _amounts(pose_error(nominal_poses(pair, setting, solution.q), wanted.poses, True))


def _too_large(
    pair: RobotPair, wanted: WantedPoses, setting: Circumstances, solution: JointSolution, limits: Limits
) -> dict[int, Refusal]:
    position, angle = _corrections(pair, wanted, setting, solution)
    far = np.zeros(position.size, dtype=bool)
    if limits.position is not None:
        far |= position > limits.position
    if limits.orientation is not None and wanted.oriented:
        far |= angle > limits.orientation
    allowed = _sizes(limits.position, limits.orientation)
    return {
        int(i): Refusal(
            Cause.too_large, f"the correction of {_sizes(position[i], angle[i])} is larger than {allowed}, see `most`"
        )
        for i in np.flatnonzero(far)
    }


def _out_of_range(pair: RobotPair, setting: Circumstances, wanted: WantedPoses, limits: Limits) -> dict[int, Refusal]:
    """Return targets outside the validity range of an effect, or of what the model was fitted on."""
    if limits.beyond_range:
        return {}
    arm = pair.model.arm
    data = setting.at(wanted.q, setting.motion(wanted.q), np.arange(wanted.q.shape[1]))
    result: dict[int, Refusal] = {}
    for known in pair.model.known:
        for i in np.flatnonzero(known.is_held_at(arm, data)):
            reason = f"outside the validity range of {known.effect}"
            result.setdefault(int(i), Refusal(Cause.out_of_range, reason))
    columns: dict[str, Array | None] = dict(zip(arm.names, wanted.q, strict=True))
    columns |= {"payload_kg": data.payload, "temperature_c": data.temperature}
    for name, (low, high) in (limits.ranges or {}).items():
        if (values := columns.get(name)) is None:
            continue
        margin = _MARGIN * (high - low)
        for i in np.flatnonzero((values < low - margin) | (values > high + margin)):
            reason = f"{name} is outside the range that the model was fitted on"
            result.setdefault(int(i), Refusal(Cause.out_of_range, reason))
    return result


def _amounts(error: Array) -> tuple[Array, Array]:
    """Return the length ``(N,)`` of the first three components and of the others; zero without others."""
    return np.linalg.norm(error[:3], axis=0), np.linalg.norm(error[3:], axis=0)


def _sizes(position: float | None, angle: float | None) -> str:
    """Return lengths in mm and angles in degrees as text."""
    parts = [] if position is None else [f"{1e3 * float(position):.3g} mm"]
    parts += [] if angle is None else [f"{float(angle) * _DEGREES:.2g}°"]
    return " and ".join(parts)


def counts(reasons: tuple[Refusal | None, ...]) -> dict[Cause, int]:
    """Return the number of refused targets by cause, the causes in their order."""
    causes = [refusal.cause for refusal in reasons if refusal is not None]
    return {cause: causes.count(cause) for cause in Cause if cause in causes}
