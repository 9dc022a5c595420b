"""Correction of targets: the commands that make the real arm reach them, and the refusal of targets that cannot be.

Equation: with F the nominal kinematics, G the model of the real arm and x the wanted pose, the joint command q' solves
G(q') = x, and the Cartesian command is F(q'). Without a correction the arm reaches G(F^-1(x)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.correction.circumstances import Circumstances
from robacc.correction.limits import Limits
from robacc.correction.refusal import Refusal, refusals
from robacc.correction.robots import RobotPair, arm_length
from robacc.correction.solving import Evaluate, JointSolution, solve
from robacc.correction.wanted import (
    PoseEvaluator,
    WantedPoses,
    joint_space,
    nominal_poses,
    pose_error,
    row_weights,
    wanted_poses,
)
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements

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
    if any(refused) and any(rounds.matters):
        # Refused targets keep their nominal command, which changes the approach to the targets after them.
        solution = rounds.solved_beside(solution, _mask(refused))
        again = refusals(pair, wanted, setting, solution, limits)
        refused = tuple(first or second for first, second in zip(refused, again, strict=True))
    q = np.where(_mask(refused), wanted.q, solution.q)
    corrected = setting.at(q, setting.motion(q), np.arange(data.n))
    uncorrected = setting.at(wanted.q, setting.motion(wanted.q), np.arange(data.n))
    command = nominal_poses(pair, setting, q)
    return CorrectedTargets(
        pair,
        wanted,
        q,
        command,
        corrected,
        correction=-pose_error(wanted.poses, command, True),
        error_before=_model_error(pair, uncorrected, wanted),
        error_after=_model_error(pair, corrected, wanted),
        refusals=refused,
    )


def _mask(refused: Sequence[Refusal | None]) -> NDArray[np.bool_]:
    return np.array([refusal is not None for refusal in refused], dtype=bool)


def _model_error(pair: RobotPair, data: Measurements, wanted: WantedPoses) -> Array:
    """Return the predicted pose less the wanted pose ``(6, N)``."""
    return -pose_error(wanted.poses, pair.model.bind(data).poses(np.zeros(0)), True)


@dataclass(frozen=True, slots=True)
class _ApproachRounds:
    """Solution of all targets, repeated where the approach to a target changes with the commands."""

    pair: RobotPair
    wanted: WantedPoses
    setting: Circumstances
    limits: Limits
    matters: tuple[bool, bool]
    """Whether the model depends on the direction and on the speed of approach."""

    def solved(self) -> JointSolution:
        """Return the solution of all targets from their nominal joints."""
        n = self.wanted.q.shape[1]
        rows = 6 if self.wanted.oriented else 3
        empty = JointSolution(self.wanted.q.copy(), np.zeros((rows, n)), np.zeros(n, dtype=bool))
        return self._rounds(empty, np.ones(n, dtype=bool), np.arange(n))

    def solved_beside(self, solution: JointSolution, is_refused: NDArray[np.bool_]) -> JointSolution:
        """Return the solution where refused targets stay at their nominal joints."""
        q = np.where(is_refused, self.wanted.q, solution.q)
        changed = self._changed(self.setting.motion(solution.q), self.setting.motion(q))
        start = JointSolution(q, solution.error.copy(), solution.settled.copy())
        return self._rounds(start, ~is_refused, np.flatnonzero(changed & ~is_refused))

    def _rounds(self, start: JointSolution, chosen: NDArray[np.bool_], index: NDArray[np.int64]) -> JointSolution:
        """Solve the targets ``index`` from ``start``, then those of ``chosen`` whose approach changed by it."""
        joints, length = joint_space(self.pair, self.wanted.q), arm_length(self.pair.nominal, self.wanted.q)
        weights = row_weights(self.wanted.oriented, self.wanted.q.shape[0], length, self.limits.weight)
        q, error, settled = start.q, start.error, start.settled
        motion = self.setting.motion(q)
        for _ in range(_ROUNDS):
            if index.size == 0:
                break
            evaluate = self._evaluator(motion, index)
            part = solve(evaluate, self.wanted.q[:, index], joints, weights, q[:, index])
            q[:, index], error[:, index], settled[index] = part.q, part.error, part.settled
            before, motion = motion, self.setting.motion(q)
            index = np.flatnonzero(self._changed(before, motion) & chosen)
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
