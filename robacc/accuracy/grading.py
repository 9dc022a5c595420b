"""Accuracy grade: the step of a scale that the errors meet, and whether the data confirm it.

The estimate of a statistic of the error's length, named by the scale, decides the grade. The grade is confirmed where
the one-sided upper confidence bound of that statistic meets the grade's limits too: few poses can reach a grade without
confirming it. The probability of each grade is the confidence between its limits and those of the next better grade
(:mod:`robacc.statistics.confidence_curves`), so a confirmed grade or a better one has at least the scale's confidence.
:mod:`robacc.accuracy.grade_scale` reads the scales.
"""

from __future__ import annotations

from robacc.accuracy.grade import Grade, NextGrade, QuantityGrade, poses_needed
from robacc.accuracy.grade_scale import Quantity, Scale
from robacc.accuracy.grade_text import grade_reason
from robacc.errors import UsageError
from robacc.statistics.intervals import Interval
from robacc.statistics.records import ErrorStatistics


def grade(position: ErrorStatistics, orientation: ErrorStatistics | None, scale: Scale) -> Grade:
    """Grade the errors on ``scale``; by position alone where no orientation was measured.

    Args:
        position: Statistics of the position errors, unit m.
        orientation: Statistics of the orientation errors, unit rad.
        scale: The steps, and the statistic and confidence that decide.

    Raises:
        UsageError: The confidence of the statistics differs from that of the scale.
    """
    graded: list[tuple[Quantity, ErrorStatistics]] = [("position", position)]
    if orientation is not None:
        graded.append(("orientation", orientation))
    for name, statistics in graded:
        if statistics.confidence != scale.confidence:
            raise UsageError(
                f"the {name} statistics have a confidence of {statistics.confidence:g}, "
                f"but the scale {scale.name} requires {scale.confidence:g}"
            )
    ranks = {name: _rank(scale, name, statistics.estimate(scale.statistic)[0]) for name, statistics in graded}
    confirmed_ranks = {
        name: _rank(scale, name, statistics.estimate(scale.statistic)[1].upper_bound) for name, statistics in graded
    }
    rank, confirmed_rank = max(ranks.values()), max(confirmed_ranks.values())
    quantities = {
        name: _quantity(scale, name, statistics, rank, ranks[name], confirmed_ranks[name])
        for name, statistics in graded
    }
    limited_by = tuple(name for name, _ in graded if ranks[name] == rank and rank > 0)
    following = _next(scale, rank, quantities)
    demonstrated = rank < len(scale.steps) and confirmed_rank <= rank
    demonstrated_grade = scale.steps[confirmed_rank].grade if confirmed_rank < len(scale.steps) else None
    return Grade(
        grade=scale.name_of(rank),
        scale=scale,
        demonstrated=demonstrated,
        demonstrated_grade=demonstrated_grade,
        position=quantities["position"],
        orientation=quantities.get("orientation"),
        limited_by=limited_by,
        next=following,
        probabilities=_probabilities(scale, quantities),
        poses_to_demonstrate=None if demonstrated else poses_needed(scale, rank, quantities),
        reason=grade_reason(scale, rank, quantities, limited_by, following, demonstrated, demonstrated_grade),
    )


def _rank(scale: Scale, name: Quantity, value: float | None) -> int:
    """Return the index of the best step that ``value`` meets, or the number of steps if there is none.

    An unknown value meets only steps without a limit.
    """
    for rank, step in enumerate(scale.steps):
        limit = step.limit(name)
        if limit is None or (value is not None and value <= limit):
            return rank
    return len(scale.steps)


def _quantity(
    scale: Scale, name: Quantity, statistics: ErrorStatistics, rank: int, quantity_rank: int, confirmed_rank: int
) -> QuantityGrade:
    value, interval = statistics.estimate(scale.statistic)
    return QuantityGrade(
        unit=statistics.unit,
        value=value,
        upper_bound=interval.upper_bound,
        limit=scale.steps[rank].limit(name) if rank < len(scale.steps) else None,
        grade=scale.name_of(quantity_rank),
        demonstrated_grade=scale.steps[confirmed_rank].grade if confirmed_rank < len(scale.steps) else None,
        method=interval.method,
        why=interval.why if interval.upper_bound is None else None,
        within=_within(scale, name, interval),
        interval=interval,
        n_poses=statistics.n_poses,
    )


def _within(scale: Scale, name: Quantity, interval: Interval) -> tuple[float, ...] | None:
    limits = [step.limit(name) for step in scale.steps]
    curve = interval.curve
    if curve is None:
        # Without scatter a limit is met with probability 0 or 1; a step without a limit is always met.
        bound = interval.upper_bound
        if bound is None:
            return (1.0,) * len(limits) if all(limit is None for limit in limits) else None
        return tuple(1.0 if limit is None or bound <= limit else 0.0 for limit in limits)
    return tuple(1.0 if limit is None else curve.below(limit) for limit in limits)


def _probabilities(scale: Scale, quantities: dict[Quantity, QuantityGrade]) -> tuple[tuple[str, float], ...]:
    """Return each grade's probability; position and orientation count as independent (exact if one decides)."""
    within = [1.0] * len(scale.steps)
    for quantity in quantities.values():
        if quantity.within is None:
            return ()
        within = [product * share for product, share in zip(within, quantity.within, strict=True)]
    shares = [high - low for low, high in zip([0.0, *within], [*within, 1.0], strict=True)]
    names = [*(step.grade for step in scale.steps), scale.otherwise]
    return tuple((name, max(share, 0.0)) for name, share in zip(names, shares, strict=True))


def _next(scale: Scale, rank: int, quantities: dict[Quantity, QuantityGrade]) -> NextGrade | None:
    if rank == 0:
        return None
    step = scale.steps[rank - 1]
    excess: dict[Quantity, float] = {}
    for name, quantity in quantities.items():
        limit = step.limit(name)
        excess[name] = 0.0 if limit is None else max(0.0, quantity.value - limit)
    return NextGrade(step.grade, excess["position"], excess.get("orientation"))
