"""Which of several results has a wanted grade: demonstrates it, meets it, or does not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from robacc.accuracy.error_statistics import error_statistics
from robacc.accuracy.grade import Grade
from robacc.accuracy.grade_scale import Scale, default_scale
from robacc.accuracy.grading import grade
from robacc.comparison.compared_result import ComparedResult
from robacc.comparison.pairing import whole
from robacc.errors import UsageError
from robacc.statistics.records import ErrorStatistics, Unit

Verdict = Literal["demonstrated", "met, not demonstrated", "not met"]
_UNITS: dict[str, Unit] = {"position": "m", "orientation": "rad"}


@dataclass(frozen=True, slots=True)
class Standing:
    """How one result stands to the wanted grade."""

    name: str
    verdict: Verdict
    grade: str
    """Its own on the scale."""
    probability: float | None
    """That the wanted grade's limits are truly met, given the data."""
    position: float
    """The scale's statistic, m."""
    position_bound: float | None
    """Its upper bound at the scale's confidence."""
    orientation: float | None
    """rad"""
    orientation_bound: float | None
    poses_to_demonstrate: int | None
    """Poses in all with which the wanted grade would be demonstrated with probability 0.9 if the estimate stays."""
    why: str | None
    """Why it is not demonstrated, or the probability is not known."""


def chosen_scale(subjects: Sequence[ComparedResult]) -> Scale:
    """The scale that the results were graded on.

    Raises:
        UsageError: They were graded on different ones, or on one that no result has whole.
    """
    names = {subject.scale_name for subject in subjects if subject.scale_name is not None}
    scales = {subject.scale for subject in subjects if subject.scale is not None}
    default = default_scale()
    if len(names) > 1 or len(scales) > 1:
        what = " and ".join(sorted(names)) if len(names) > 1 else f"different scales of the name {min(names)}"
        raise UsageError(f"the results were graded on {what}; say with --scale which is to hold")
    if scales:
        return next(iter(scales))
    if names <= {default.name}:
        return default
    raise UsageError(f"no result has the scale {min(names)} whole; name its file with --scale")


def standings(subjects: Sequence[ComparedResult], scale: Scale, wanted: str, seed: int = 0) -> tuple[Standing, ...]:
    """Every result's standing, in their order.

    Args:
        subjects: The results.
        scale: That they are judged on.
        wanted: A step of the scale.
        seed: Of the bootstrap.

    Raises:
        UsageError: The scale has no such step, or a result no position errors to judge.
    """
    names = [step.grade for step in scale.steps]
    if wanted not in names:
        raise UsageError(f"no grade {wanted!r} on the scale {scale.name}; it has {', '.join(names)}")
    rank = names.index(wanted)
    return tuple(
        _measured(subject, scale, rank, seed) if "position" in subject.errors else _by_figures(subject, scale, rank)
        for subject in subjects
    )


def _measured(subject: ComparedResult, scale: Scale, rank: int, seed: int) -> Standing:
    position = _statistics(subject, "position", scale, seed)
    orientation = _statistics(subject, "orientation", scale, seed) if "orientation" in subject.errors else None
    found = grade(position, orientation, scale)
    names = [step.grade for step in scale.steps]
    proven = found.demonstrated_grade
    demonstrated = proven is not None and names.index(proven) <= rank
    met = found.grade in names and names.index(found.grade) <= rank
    probability = found.probability_within(names[rank])
    turned = found.orientation
    return Standing(
        subject.name,
        "demonstrated" if demonstrated else "met, not demonstrated" if met else "not met",
        found.grade,
        probability,
        found.position.value,
        found.position.upper_bound,
        None if turned is None else turned.value,
        None if turned is None else turned.upper_bound,
        found.poses_needed(rank) if met and not demonstrated else None,
        None if demonstrated or not met else _lacking(found),
    )


def _statistics(subject: ComparedResult, quantity: str, scale: Scale, seed: int) -> ErrorStatistics:
    sample = whole(subject.errors[quantity])
    return error_statistics(
        sample.vectors, _UNITS[quantity], groups=sample.groups, confidence=scale.confidence, seed=seed
    )


def _lacking(found: Grade) -> str:
    quantities = (("position", found.position), ("orientation", found.orientation))
    unknown = [f"no upper bound of {name}: {one.why}" for name, one in quantities if one is not None and one.why]
    return "; ".join(unknown) or f"the upper {100 * found.scale.confidence:g} % bound is beyond its limit"


def _by_figures(subject: ComparedResult, scale: Scale, rank: int) -> Standing:
    """Of a prediction, or a result without its errors pose by pose: by the figures alone, which demonstrate nothing."""
    statistic = "max_radius95" if scale.statistic == "max" and not subject.measured else scale.statistic
    position, orientation = (subject.figures.get(f"{quantity}.{statistic}") for quantity in _UNITS)
    if position is None:
        raise UsageError(f"{subject.name} is a result of {subject.command}, which has no {statistic} error to grade")
    names = [*(step.grade for step in scale.steps), scale.otherwise]
    turned = None if orientation is None else orientation.value
    own = next(
        (
            i
            for i, step in enumerate(scale.steps)
            if _meets(step.position, position.value) and _meets(step.orientation, turned)
        ),
        len(scale.steps),
    )
    why = "predicted from tolerances, not measured" if not subject.measured else "the result has no errors pose by pose"
    verdict: Verdict = "met, not demonstrated" if own <= rank else "not met"
    return Standing(subject.name, verdict, names[own], None, position.value, None, turned, None, None, why)


def _meets(limit: float | None, value: float | None) -> bool:
    return limit is None or value is None or value <= limit
