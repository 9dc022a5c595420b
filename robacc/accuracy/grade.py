"""Grade of the errors: per quantity, what limits it, and how many poses would confirm it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from robacc.accuracy.grade_scale import Quantity, Scale
from robacc.statistics.intervals import Interval
from robacc.statistics.records import Unit


@dataclass(frozen=True, slots=True)
class QuantityGrade:
    """Grade of position or orientation alone, in m or rad."""

    unit: Unit
    value: float
    """Estimate of the scale's statistic of the error's length."""
    upper_bound: float | None
    """One-sided bound at the scale's confidence."""
    limit: float | None
    """Limit of the awarded grade; None beyond the last step, or where the scale has no limit of this quantity."""
    grade: str
    """Grade by this quantity alone."""
    demonstrated_grade: str | None
    """Best grade whose limit the upper bound meets."""
    method: str
    """Method of the upper bound."""
    why: str | None
    """Reason why there is no upper bound."""
    within: tuple[float, ...] | None
    """Probability that the true statistic is within each step's limit, best step first."""
    interval: Interval
    """Interval of ``value``, at the scale's confidence."""
    n_poses: int
    """Number of commanded poses."""


@dataclass(frozen=True, slots=True)
class NextGrade:
    """Next better grade, and the reduction of each statistic that it requires (0: none)."""

    grade: str
    position: float
    """m"""
    orientation: float | None
    """rad; None where orientation is not graded"""


@dataclass(frozen=True, slots=True)
class Grade:
    """Grade of position and orientation together, its basis and what limits it."""

    grade: str
    scale: Scale
    demonstrated: bool
    """All upper bounds meet the grade's limits: the grade is confirmed at the scale's confidence."""
    demonstrated_grade: str | None
    """Best grade whose limits all upper bounds meet; None where there is none."""
    position: QuantityGrade
    orientation: QuantityGrade | None
    limited_by: tuple[Quantity, ...]
    """Quantities that prevent a better grade; empty at the best grade."""
    next: NextGrade | None
    probabilities: tuple[tuple[str, float], ...]
    """Probability that each grade of the scale is the true grade, the last for no step met; empty where unknown."""
    poses_to_demonstrate: int | None
    """Poses that would confirm the grade with probability 0.9 if the estimate stays as it is; None where the grade is
    confirmed already, or no number of poses suffices."""
    reason: str

    @property
    def probability(self) -> float | None:
        """Probability that the grade is right, given the data."""
        return dict(self.probabilities).get(self.grade)

    def probability_within(self, name: str) -> float | None:
        """Return the probability that the true grade is ``name`` or better; None if unknown or no step of the scale."""
        names = [step.grade for step in self.scale.steps]
        if not self.probabilities or name not in names:
            return None
        return math.fsum(share for _, share in self.probabilities[: names.index(name) + 1])

    def poses_needed(self, rank: int) -> int | None:
        """Return how many poses would confirm step ``rank`` with probability 0.9 if the estimate stays as it is.

        The larger number of the two quantities; None where more than a million are needed.
        """
        return poses_needed(self.scale, rank, {"position": self.position, "orientation": self.orientation})


def poses_needed(scale: Scale, rank: int, quantities: Mapping[Quantity, QuantityGrade | None]) -> int | None:
    """Return the number of :meth:`Grade.poses_needed` for quantities without a grade."""
    if rank == len(scale.steps):
        return None
    largest = 0
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
        largest = max(largest, needed, quantity.n_poses + 1)
    return largest
