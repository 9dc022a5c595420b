"""Status of several results against a required grade: confirmed, met but not confirmed, or not met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from robacc.accuracy.error_statistics import error_statistics
from robacc.accuracy.grade import Grade
from robacc.accuracy.grade_scale import Scale, default_scale
from robacc.accuracy.grading import grade
from robacc.comparison.compared_result import ComparedResult
from robacc.comparison.pairing import unpaired_sample
from robacc.errors import UsageError
from robacc.statistics.records import ErrorStatistics, Unit

Verdict = Literal["demonstrated", "met_not_demonstrated", "not_met"]
"""Verdicts as results store them."""
_UNITS: dict[str, Unit] = {"position": "m", "orientation": "rad"}


@dataclass(frozen=True, slots=True)
class GradeStatus:
    """Status of one result against the required grade."""

    name: str
    verdict: Verdict
    grade: str
    """The result's own grade on the scale."""
    probability: float | None
    """Probability that the limits of the required grade are truly met, given the data."""
    position: float
    """Statistic of the scale, m."""
    position_bound: float | None
    """Upper bound at the scale's confidence."""
    orientation: float | None
    """rad"""
    orientation_bound: float | None
    poses_to_demonstrate: int | None
    """Total number of poses that confirms the required grade with probability 0.9 if the estimate stays the same."""
    why: str | None
    """Reason why the grade is not confirmed, or why the probability is unknown."""


def common_scale(results: Sequence[ComparedResult]) -> Scale:
    """Return the grade scale of the results.

    Raises:
        UsageError: The results have different scales, or a scale that no result stores completely.
    """
    names = {result.scale_name for result in results if result.scale_name is not None}
    scales = {result.scale for result in results if result.scale is not None}
    default = default_scale()
    if len(names) > 1 or len(scales) > 1:
        conflict = " and ".join(sorted(names)) if len(names) > 1 else f"different scales with the name {min(names)}"
        raise UsageError(f"the results were graded on {conflict}; choose the scale with `scale`")
    if scales:
        return next(iter(scales))
    if names <= {default.name}:
        return default
    raise UsageError(f"no result stores the complete scale {min(names)}; give its file with `scale`")


def grade_statuses(
    results: Sequence[ComparedResult], scale: Scale, required_grade: str, seed: int = 0
) -> tuple[GradeStatus, ...]:
    """Return the status of every result, in the order of the results.

    Args:
        results: The results.
        scale: Grade scale to apply.
        required_grade: A step of the scale.
        seed: Seed of the bootstrap.

    Raises:
        UsageError: The scale has no such step, or a result has no position errors to grade.
    """
    names = [step.grade for step in scale.steps]
    if required_grade not in names:
        raise UsageError(f"`grade`: the scale {scale.name} has no grade {required_grade!r}; it has {', '.join(names)}")
    rank = names.index(required_grade)
    return tuple(
        _status_by_errors(result, scale, rank, seed)
        if "position" in result.errors
        else _status_by_figures(result, scale, rank)
        for result in results
    )


def _status_by_errors(result: ComparedResult, scale: Scale, rank: int, seed: int) -> GradeStatus:
    position = _statistics(result, "position", scale, seed)
    orientation = _statistics(result, "orientation", scale, seed) if "orientation" in result.errors else None
    assessed = grade(position, orientation, scale)
    names = [step.grade for step in scale.steps]
    best_confirmed = assessed.demonstrated_grade
    confirmed = best_confirmed is not None and names.index(best_confirmed) <= rank
    met = assessed.grade in names and names.index(assessed.grade) <= rank
    probability = assessed.probability_within(names[rank])
    angle = assessed.orientation
    return GradeStatus(
        result.name,
        "demonstrated" if confirmed else "met_not_demonstrated" if met else "not_met",
        assessed.grade,
        probability,
        assessed.position.value,
        assessed.position.upper_bound,
        None if angle is None else angle.value,
        None if angle is None else angle.upper_bound,
        assessed.poses_needed(rank) if met and not confirmed else None,
        None if confirmed or not met else _why_not_confirmed(assessed),
    )


def _statistics(result: ComparedResult, quantity: str, scale: Scale, seed: int) -> ErrorStatistics:
    errors = result.errors[quantity]
    sample = unpaired_sample(errors)
    share = (errors.independent_poses or sample.n_groups) / sample.n_groups
    return error_statistics(
        sample.vectors, _UNITS[quantity], groups=sample.groups, share=share, confidence=scale.confidence, seed=seed
    )


def _why_not_confirmed(assessed: Grade) -> str:
    quantities = (("position", assessed.position), ("orientation", assessed.orientation))
    missing = [
        f"no upper bound of {name}: {quantity.why}" for name, quantity in quantities if quantity and quantity.why
    ]
    return "; ".join(missing) or f"the upper {100 * assessed.scale.confidence:g} % bound is beyond the limit"


def _status_by_figures(result: ComparedResult, scale: Scale, rank: int) -> GradeStatus:
    """Return the status by the figures alone, for a prediction or a result without errors; they confirm nothing."""
    statistic = "max_radius95" if scale.statistic == "max" and not result.measured else scale.statistic
    position, orientation = (result.figures.get(f"{quantity}.{statistic}") for quantity in _UNITS)
    if position is None:
        raise UsageError(f"{result.name} is a result of {result.command}, which has no {statistic} error to grade")
    names = [*(step.grade for step in scale.steps), scale.otherwise]
    angle = None if orientation is None else orientation.value
    own_rank = next(
        (
            i
            for i, step in enumerate(scale.steps)
            if _meets(step.position, position.value) and _meets(step.orientation, angle)
        ),
        len(scale.steps),
    )
    why = "the result does not list the error of every pose"
    if not result.measured:
        why = "predicted from tolerances, not measured"
    verdict: Verdict = "met_not_demonstrated" if own_rank <= rank else "not_met"
    return GradeStatus(result.name, verdict, names[own_rank], None, position.value, None, angle, None, None, why)


def _meets(limit: float | None, value: float | None) -> bool:
    return limit is None or value is None or value <= limit
