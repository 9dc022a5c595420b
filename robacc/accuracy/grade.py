"""A grade as it is given: of each quantity, what keeps it from being better, how many poses would demonstrate it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from robacc.accuracy.grade_scale import Quantity, Scale
from robacc.statistics.intervals import Interval
from robacc.statistics.records import Unit


@dataclass(frozen=True, slots=True)
class QuantityGrade:
    """How position or orientation stands on the scale, in m or rad."""

    unit: Unit
    value: float
    """The scale's statistic of the error's length."""
    upper_bound: float | None
    """One-sided, at the scale's confidence."""
    limit: float | None
    """Of the grade awarded; None beyond the last step, or where the scale leaves this quantity free."""
    grade: str
    """What this quantity alone would get."""
    demonstrated_grade: str | None
    """The best grade whose limit the upper bound meets."""
    method: str
    """Of the upper bound."""
    why: str | None
    """Why there is no upper bound."""
    within: tuple[float, ...] | None
    """For each step of the scale, best first, the probability that the true statistic is within its limit."""
    interval: Interval
    """Of ``value``, at the scale's confidence."""
    n_poses: int
    """Commanded poses."""


@dataclass(frozen=True, slots=True)
class NextGrade:
    """The next better grade, and by how much each statistic must fall to reach it (0: it already does)."""

    grade: str
    position: float
    """m"""
    orientation: float | None
    """rad; None where orientation was not judged"""


@dataclass(frozen=True, slots=True)
class Grade:
    """A grade, what it rests on, and what keeps it from being better."""

    grade: str
    scale: Scale
    demonstrated: bool
    demonstrated_grade: str | None
    """The best grade whose limits all upper bounds meet; None where there is none."""
    position: QuantityGrade
    orientation: QuantityGrade | None
    limited_by: tuple[Quantity, ...]
    """What keeps the grade from being better; empty at the best."""
    next: NextGrade | None
    probabilities: tuple[tuple[str, float], ...]
    """Of being the true one, for each grade of the scale, the last being that of no step; empty where unknown."""
    poses_to_demonstrate: int | None
    """Poses with which the grade would be demonstrated with probability 0.9 if the estimate stays as it is; None where
    it is demonstrated already, or there are none that would do."""
    reason: str

    @property
    def probability(self) -> float | None:
        """Of the grade's being right, given the data."""
        return dict(self.probabilities).get(self.grade)

    def probability_within(self, name: str) -> float | None:
        """That the true grade is ``name`` or a better one; None where it is unknown, or on no step of the scale."""
        names = [step.grade for step in self.scale.steps]
        if not self.probabilities or name not in names:
            return None
        return math.fsum(share for _, share in self.probabilities[: names.index(name) + 1])

    def poses_needed(self, rank: int) -> int | None:
        """Poses with which the scale's step ``rank`` would be demonstrated with probability 0.9 if the estimate stays.

        The larger number of the two quantities; None where none below a million would do.
        """
        return poses_needed(self.scale, rank, {"position": self.position, "orientation": self.orientation})


def poses_needed(scale: Scale, rank: int, quantities: Mapping[Quantity, QuantityGrade | None]) -> int | None:
    """As :meth:`Grade.poses_needed`, of quantities that are not yet a grade."""
    if rank == len(scale.steps):
        return None
    most = 0
    for name, quantity in quantities.items():
        limit = scale.steps[rank].limit(name)
        if limit is None or quantity is None:
            continue
        bound, curve = quantity.upper_bound, quantity.interval.curve
        needed: int | None = quantity.n_poses + 1
        if bound is None or bound > limit:
            needed = None if curve is None else curve.poses_for(limit, scale.confidence, quantity.n_poses)
        if needed is None:
            return None
        most = max(most, needed, quantity.n_poses + 1)
    return most
