"""The accuracy grade: which step of a scale the errors meet, and whether the data demonstrate it.

A grade is given by the estimate of one stated statistic of the error's length. It is demonstrated only where the
one-sided upper confidence bound of that statistic meets the grade's limits too: few poses can earn a grade, not
prove it. The probability of each grade is the confidence that lies between its limits and the next better one's
(:mod:`robacc.statistics.confidence`), so a demonstrated grade, or a better one, has at least the scale's confidence.
:mod:`robacc.accuracy.grade_scale` reads the scales.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from robacc.accuracy.grade_scale import Scale, Step, default_scale, load_scale
from robacc.errors import UsageError
from robacc.statistics.intervals import Interval
from robacc.statistics.records import ErrorStatistics, Statistic, Unit

__all__ = ["Grade", "NextGrade", "QuantityGrade", "Scale", "Step", "default_scale", "grade", "load_scale"]

Quantity = Literal["position", "orientation"]

_NAMES: dict[Statistic, str] = {
    "rms": "RMS error",
    "mean_error": "mean error",
    "p95": "95th percentile of the error",
    "max": "largest error",
}


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
        return _poses_needed(self.scale, rank, {"position": self.position, "orientation": self.orientation})


def grade(position: ErrorStatistics, orientation: ErrorStatistics | None, scale: Scale) -> Grade:
    """Grade the errors on ``scale``; by position alone where no orientation was measured.

    Args:
        position: Of the position errors, unit m.
        orientation: Of the orientation errors, unit rad.
        scale: The steps, and the statistic and confidence they are judged by.

    Raises:
        UsageError: The statistics were computed at another confidence than the scale's.
    """
    judged: list[tuple[Quantity, ErrorStatistics]] = [("position", position)]
    if orientation is not None:
        judged.append(("orientation", orientation))
    for name, statistics in judged:
        if statistics.confidence != scale.confidence:
            raise UsageError(
                f"the {name} statistics are at a confidence of {statistics.confidence:g}, "
                f"the scale {scale.name} asks for {scale.confidence:g}"
            )
    ranks = {name: _rank(scale, name, statistics.estimate(scale.statistic)[0]) for name, statistics in judged}
    proven = {
        name: _rank(scale, name, statistics.estimate(scale.statistic)[1].upper_bound) for name, statistics in judged
    }
    rank, proven_rank = max(ranks.values()), max(proven.values())
    quantities = {
        name: _quantity(scale, name, statistics, rank, ranks[name], proven[name]) for name, statistics in judged
    }
    limited_by = tuple(name for name, _ in judged if ranks[name] == rank and rank > 0)
    following = _next(scale, rank, quantities)
    demonstrated = rank < len(scale.steps) and proven_rank <= rank
    demonstrated_grade = scale.steps[proven_rank].grade if proven_rank < len(scale.steps) else None
    return Grade(
        grade=_name(scale, rank),
        scale=scale,
        demonstrated=demonstrated,
        demonstrated_grade=demonstrated_grade,
        position=quantities["position"],
        orientation=quantities.get("orientation"),
        limited_by=limited_by,
        next=following,
        probabilities=_probabilities(scale, quantities),
        poses_to_demonstrate=None if demonstrated else _poses_needed(scale, rank, quantities),
        reason=_reason(scale, rank, quantities, limited_by, following, demonstrated, demonstrated_grade),
    )


def _limit(step: Step, name: Quantity) -> float | None:
    return step.position if name == "position" else step.orientation


def _name(scale: Scale, rank: int) -> str:
    return scale.steps[rank].grade if rank < len(scale.steps) else scale.otherwise


def _rank(scale: Scale, name: Quantity, value: float | None) -> int:
    """Index of the best step that ``value`` meets, or the number of steps; an unknown value meets free limits only."""
    for rank, step in enumerate(scale.steps):
        limit = _limit(step, name)
        if limit is None or (value is not None and value <= limit):
            return rank
    return len(scale.steps)


def _quantity(
    scale: Scale, name: Quantity, statistics: ErrorStatistics, rank: int, own_rank: int, proven_rank: int
) -> QuantityGrade:
    value, interval = statistics.estimate(scale.statistic)
    return QuantityGrade(
        unit=statistics.unit,
        value=value,
        upper_bound=interval.upper_bound,
        limit=_limit(scale.steps[rank], name) if rank < len(scale.steps) else None,
        grade=_name(scale, own_rank),
        demonstrated_grade=scale.steps[proven_rank].grade if proven_rank < len(scale.steps) else None,
        method=interval.method,
        why=interval.why if interval.upper_bound is None else None,
        within=_within(scale, name, interval),
        interval=interval,
        n_poses=statistics.n_poses,
    )


def _within(scale: Scale, name: Quantity, interval: Interval) -> tuple[float, ...] | None:
    limits = [_limit(step, name) for step in scale.steps]
    curve = interval.curve
    if curve is None:
        # Without scatter every limit is met for certain or not at all; what is free is met in any case.
        bound = interval.upper_bound
        if bound is None:
            return (1.0,) * len(limits) if all(limit is None for limit in limits) else None
        return tuple(1.0 if limit is None or bound <= limit else 0.0 for limit in limits)
    return tuple(1.0 if limit is None else curve.below(limit) for limit in limits)


def _probabilities(scale: Scale, quantities: dict[Quantity, QuantityGrade]) -> tuple[tuple[str, float], ...]:
    """Of each grade: position and orientation are taken as independent, which is exact where one of them decides."""
    within = [1.0] * len(scale.steps)
    for quantity in quantities.values():
        if quantity.within is None:
            return ()
        within = [one * other for one, other in zip(within, quantity.within, strict=True)]
    shares = [high - low for low, high in zip([0.0, *within], [*within, 1.0], strict=True)]
    names = [*(step.grade for step in scale.steps), scale.otherwise]
    return tuple((name, max(share, 0.0)) for name, share in zip(names, shares, strict=True))


def _poses_needed(scale: Scale, rank: int, quantities: Mapping[Quantity, QuantityGrade | None]) -> int | None:
    if rank == len(scale.steps):
        return None
    most = 0
    for name, quantity in quantities.items():
        limit = _limit(scale.steps[rank], name)
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


def _next(scale: Scale, rank: int, quantities: dict[Quantity, QuantityGrade]) -> NextGrade | None:
    if rank == 0:
        return None
    step = scale.steps[rank - 1]
    excess: dict[Quantity, float] = {}
    for name, quantity in quantities.items():
        limit = _limit(step, name)
        excess[name] = 0.0 if limit is None else max(0.0, quantity.value - limit)
    return NextGrade(step.grade, excess["position"], excess.get("orientation"))


def _reason(
    scale: Scale,
    rank: int,
    quantities: dict[Quantity, QuantityGrade],
    limited_by: tuple[Quantity, ...],
    following: NextGrade | None,
    demonstrated: bool,
    demonstrated_grade: str | None,
) -> str:
    """The grade in words: what was found, what limits it, whether it is demonstrated, what is missing to the next."""
    statistic = _NAMES[scale.statistic]
    found = []
    for name, quantity in quantities.items():
        value = f"{name}: {statistic} {_amount(quantity.value, quantity.unit)}"
        if quantity.limit is not None:
            value += f", within {_amount(quantity.limit, quantity.unit)}"
        elif rank == len(scale.steps) and name in limited_by:
            last = _limit(scale.steps[-1], name)
            value += f", beyond {_amount(last or math.inf, quantity.unit)} of {scale.steps[-1].grade}"
        found.append(value)
    sentences = ["; ".join(found)]
    if "orientation" not in quantities:
        sentences.append("orientation was not measured, so the grade is of position only")
    if following is not None:
        by_quantity: tuple[tuple[str, Unit, float | None], ...] = (
            ("position", "m", following.position),
            ("orientation", "rad", following.orientation),
        )
        missing = [f"{_amount(excess, unit)} less in {name}" for name, unit, excess in by_quantity if excess]
        sentences.append(f"limited by {' and '.join(limited_by)}: {following.grade} takes {' and '.join(missing)}")
    sentences.append(_demonstration(scale, rank, quantities, demonstrated, demonstrated_grade))
    return ". ".join(sentences)


def _demonstration(
    scale: Scale, rank: int, quantities: dict[Quantity, QuantityGrade], demonstrated: bool, proven: str | None
) -> str:
    confidence = f"{100 * scale.confidence:g} %"
    if demonstrated:
        return f"demonstrated: the upper {confidence} bound meets it ({_bounds(quantities)})"
    unknown = [f"{name}: {quantity.why}" for name, quantity in quantities.items() if quantity.why]
    if unknown:
        return f"not demonstrated: no upper bound of {'; of '.join(unknown)}"
    if rank == len(scale.steps):
        return "no step of the scale is met, so there is nothing to demonstrate"
    shown = f"{proven} is demonstrated" if proven else "no grade is demonstrated"
    return f"not demonstrated: the upper {confidence} bound is beyond a limit ({_bounds(quantities)}); {shown}"


def _bounds(quantities: dict[Quantity, QuantityGrade]) -> str:
    return ", ".join(
        f"{name} {_amount(quantity.upper_bound, quantity.unit)}"
        for name, quantity in quantities.items()
        if quantity.upper_bound is not None
    )


def _amount(value: float, unit: Unit) -> str:
    """In mm or degrees, three digits."""
    return f"{1e3 * value:.3g} mm" if unit == "m" else f"{math.degrees(value):.3g}°"
