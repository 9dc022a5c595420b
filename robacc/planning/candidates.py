"""Candidate poses of a plan, and the poses of the task: sampled within the joint limits, or given."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem, UsageError
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.planning.constraints import Constraints, SafetyBox
from robacc.planning.feasibility import Exclusion, Filtered, exclusions, filtered
from robacc.robots.description import Robot
from robacc.robots.summary import low_discrepancy

TASK_POSES = 400
"""Poses that the mean and the worst error over the task's region are computed from."""
_DECIMALS = 6
"""Decimals of commanded joint variables, as in a simulation."""
_MOST_DRAWS = 40
"""Most samples drawn, as a multiple of the candidates sought."""
_TASK_SKIP = 7_919
"""Place in the sequence where poses that are not candidates begin, so that none of them is a candidate too."""


@dataclass(frozen=True, slots=True)
class CandidatePoses:
    """Feasible poses to choose from, and the count of what was excluded."""

    q: Array
    """``(J, N)`` feasible joint variables, rad or m."""
    position: Array
    """``(3, N)`` target in the base frame, m."""
    ids: NDArray[np.str_] | None
    """``(N,)`` names of given candidates; None for sampled ones."""
    n_drawn: int
    """Number of candidates before the filters."""
    excluded: tuple[Exclusion, ...]
    source: str
    payload: Array | None = None
    """``(N,)`` kg; None where no payload was given."""
    n_payloads: int = 1
    """Number of payloads that each pose is a candidate with."""

    @property
    def n(self) -> int:
        """Number of feasible candidates: poses times payloads."""
        return int(self.q.shape[1])

    @property
    def n_poses(self) -> int:
        """Number of feasible poses."""
        return self.n // self.n_payloads


def sampled_joints(robot: Robot, margin: float, count: int, skip: int, seed: int) -> Array:
    """Return joint variables ``(J, count)`` spread evenly within the limits less ``margin``.

    They are the entries of a low-discrepancy sequence after the first ``skip``; ``seed`` shifts the sequence.

    Raises:
        InputError: A prismatic joint has no limits.
    """
    problems = [
        Problem(
            f"the prismatic joint {joint.name} has no limits to choose poses within",
            column=f"joints.{joint.name}.limits",
            fix="give it limits",
        )
        for joint in robot.variables
        if joint.limits is None and joint.type == "prismatic"
    ]
    if problems:
        raise InputError(problems)
    low, high = np.array([joint.limits or (-np.pi, np.pi) for joint in robot.variables]).T[..., None]
    shift = np.random.default_rng([seed, len(robot.variables)]).uniform(size=(len(low), 1))
    unit = (low_discrepancy(len(low), skip + count)[:, skip:] + shift) % 1.0
    keep = margin * (high - low)
    result: Array = np.round(low + keep + (high - low - 2 * keep) * unit, _DECIMALS)
    return np.clip(result, low + keep, high - keep)


def sampled_candidates(model: Model, constraints: Constraints, count: int, seed: int) -> CandidatePoses:
    """Return ``count`` feasible poses, or as many as are among :data:`_MOST_DRAWS` times that many samples.

    Raises:
        UsageError: No sample is feasible; the message names the reason that excludes most.
    """
    robot = model.arm.robot
    parts: list[tuple[Array, Filtered]] = []
    n_feasible = n_drawn = 0
    while n_feasible < count and n_drawn < _MOST_DRAWS * count:
        q = sampled_joints(robot, constraints.margin, count, n_drawn, seed)
        outcome = filtered(model, q, constraints)
        n_drawn += count
        n_feasible += int(np.count_nonzero(outcome.feasible))
        parts.append((q, outcome))
    source = f"{n_drawn} samples within the joint limits"
    return _collected(parts, None, n_drawn, source, count)


def given_candidates(model: Model, constraints: Constraints, data: Measurements) -> CandidatePoses:
    """Return the feasible poses among the rows of a file; a repeated pose counts once.

    Raises:
        UsageError: The rows have no joints, or none is feasible.
    """
    if data.q is None:
        raise UsageError("the candidates have no joint columns")
    _, first = np.unique(data.groups(), return_index=True)
    first = np.sort(first)
    q = data.q[:, first]
    ids = None if data.pose is None else np.array([str(name) for name in data.pose[first]])
    outcome = filtered(model, q, constraints)
    return _collected([(q, outcome)], ids, first.size, f"{first.size} given poses", first.size)


def _collected(
    parts: list[tuple[Array, Filtered]], ids: NDArray[np.str_] | None, n_drawn: int, source: str, count: int
) -> CandidatePoses:
    reasons = exclusions([outcome for _, outcome in parts])
    mask = np.concatenate([outcome.feasible for _, outcome in parts])
    if not mask.any():
        raise UsageError(infeasible("no pose is feasible", n_drawn, reasons))
    at = np.flatnonzero(mask)[:count]
    return CandidatePoses(
        np.concatenate([q for q, _ in parts], axis=1)[:, at],
        np.concatenate([outcome.position for _, outcome in parts], axis=1)[:, at],
        None if ids is None else ids[at],
        n_drawn,
        tuple(entry for entry in reasons if entry.count),
        source,
    )


def infeasible(message: str, n_drawn: int, reasons: tuple[Exclusion, ...]) -> str:
    """Return the message of demands that cannot be met, with the reason that excludes most."""
    if not reasons or reasons[0].count == 0:
        return message
    largest = reasons[0]
    text = f"{message}: of {n_drawn} poses, {largest.count} are excluded by: {largest.reason}"
    others = [f"{entry.count} by: {entry.reason}" for entry in reasons[1:] if entry.count]
    if others:
        text += f"; {'; '.join(others)}"
    return f"{text}. Relax {'the first of these' if others else 'this demand'}"


def task_joints(
    model: Model, constraints: Constraints, region: SafetyBox | None, seed: int, count: int = TASK_POSES
) -> Array:
    """Return joint variables ``(J, T)`` of the task: poses that the robot may take, with the target in ``region``.

    The instrument need not see them.

    Raises:
        UsageError: None of the samples lies in the region.
    """
    without_sight = dataclasses.replace(constraints, sight=None, inside=region or constraints.inside)
    parts: list[tuple[Array, Filtered]] = []
    n_places = n_drawn = 0
    while n_places < count and n_drawn < 10 * _MOST_DRAWS * count:
        step = 5 * count
        q = sampled_joints(model.arm.robot, constraints.margin, step, _TASK_SKIP + n_drawn, seed + 1)
        outcome = filtered(model, q, without_sight)
        parts.append((q, outcome))
        n_places += int(np.count_nonzero(outcome.place))
        n_drawn += step
    if n_places == 0:
        raise UsageError(
            infeasible("no pose of the task is feasible", n_drawn, exclusions([outcome for _, outcome in parts]))
        )
    q = np.concatenate([part[:, outcome.place] for part, outcome in parts], axis=1)
    return q[:, :count]
