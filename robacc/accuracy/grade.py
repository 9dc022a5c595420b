"""Accuracy grades: scales and their reader, the grade that the errors meet, and sentences that explain it."""

import math
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, cast, get_args

from robacc.accuracy.error_statistics import ErrorStatistics, Statistic, Unit
from robacc.errors import applying, refuse
from robacc.io.yaml_nodes import YamlSection, top_section
from robacc.quantities import UNITS
from robacc.statistics.intervals import Interval, largest_known

# Scales of accuracy grades: the record, and its reader from YAML.

Quantity = Literal["position", "orientation"]

VERSION = "1"
_WIDER = "list the best grade first"


class GradeStep(NamedTuple):
    """Grade and the limits that the statistic must meet."""

    grade: str
    position: float
    """m"""
    orientation: float | None
    """rad; None: no limit of orientation"""

    def limit(self, quantity: Quantity) -> float | None:
        """Return the limit of a quantity in m or rad; None where there is none."""
        return self.position if quantity == "position" else self.orientation


class Scale(NamedTuple):
    """Grades from the best to the widest, and the statistic of the error's length that decides."""

    name: str
    statistic: Statistic
    confidence: float
    """Confidence of the upper bound that confirms a grade."""
    steps: tuple[GradeStep, ...]
    otherwise: str
    """Name for errors that meet no step."""

    def step_name(self, rank: int) -> str | None:
        """Return the grade of step ``rank``, 0 for the best; None beyond the last step."""
        return self.steps[rank].grade if rank < len(self.steps) else None

    def name_of(self, rank: int) -> str:
        """Return the grade of step ``rank``; beyond the last step, the name for errors outside all."""
        return self.step_name(rank) or self.otherwise

    def rank_of(self, quantity: Quantity, value: float | None) -> int:
        """Return the rank of the best step that a value in m or rad meets; an unknown value meets free steps only."""
        limits = enumerate(step.limit(quantity) for step in self.steps)
        met = (rank for rank, limit in limits if limit is None or (value is not None and value <= limit))
        return next(met, len(self.steps))


def default_scale() -> Scale:
    """Return the built-in scale, which ``configs/grades/default.yaml`` describes.

    A within 0.1 mm and 0.1 degree is the requirement of CAD/CAM applications in the paper.
    """
    limits = {"A": 0.1, "B": 0.2, "C": 0.5, "D": 1.0, "E": 2.0}  # mm and degrees
    steps = tuple(GradeStep(name, limit * 1e-3, math.radians(limit)) for name, limit in limits.items())
    return Scale("CAD/CAM 0.1 mm, 0.1 degree", "p95", 0.95, steps, "F")


def load_scale(text: str, file: str) -> Scale:
    """Read a scale; a value with a problem is reported, and empty or NaN in the scale.

    Args:
        text: Content of the YAML file.
        file: Name of the file, for messages.

    Raises:
        InputError: With every problem, its line and key.
    """
    top = top_section(text, file, ("robacc", "name", "statistic", "confidence", "units", "steps", "otherwise"))
    top.text("robacc", (VERSION,), needed=True)
    confidence = top.number("confidence", lambda level: 0.5 <= level < 1.0, "at least 0.5 and less than 1")
    if (node := top.get("units")) is None:
        top.source.report(top.node, "units", "is missing", "add it, for example units: {length: mm, angle: deg}")
    units = None if node is None else top.source.section(node, "units", tuple(UNITS))
    length, angle = (
        1.0 if units is None else sizes.get(units.text(key, sizes, needed=True) or "", 1.0)
        for key, sizes in UNITS.items()
    )
    steps: list[GradeStep] = []
    for section in top.sections(
        "steps", "steps", ("grade", "position", "orientation"), "a scale needs at least one step"
    ):
        orientation = None if section.get("orientation") is None else _positive(section, "orientation") * angle
        position, name = _positive(section, "position") * length, section.text("grade", needed=True) or ""
        better = steps[-1] if steps else GradeStep("", -math.inf, 0.0)
        section.report_if(
            (bool(name) and name in [s.grade for s in steps], "grade", f"the grade {name!r} is listed twice", None),
            (
                position <= better.position,
                "position",
                f"the limit is not wider than that of grade {better.grade}",
                _WIDER,
            ),
            (
                orientation is not None and better.orientation is None,
                "orientation",
                f"the better grade {better.grade} has no limit of orientation",
                None,
            ),
            (
                orientation is not None and orientation < (better.orientation or 0.0),
                "orientation",
                f"the limit is narrower than that of grade {better.grade}",
                _WIDER,
            ),
        )
        steps.append(GradeStep(name, position, orientation))
    otherwise = top.text("otherwise", needed=True) or ""
    if otherwise in [step.grade for step in steps]:
        top.report("otherwise", f"{otherwise!r} is also the grade of a step", "choose another name")
    statistic = cast("Statistic", top.text("statistic", get_args(Statistic), needed=True))
    scale = Scale(top.text("name", needed=True) or "", statistic, confidence, tuple(steps), otherwise)
    top.source.raise_if_any()
    return scale


def _positive(section: YamlSection, key: str) -> float:
    return section.number(key, lambda value: value > 0.0, "a number greater than zero")


class QuantityGrade(NamedTuple):
    """Grade of position or orientation alone, in m or rad."""

    unit: Unit
    value: float
    """Estimate of the scale's statistic of the error's length."""
    interval: Interval
    """Interval of ``value`` at the scale's confidence; its upper bound confirms a grade."""
    n_poses: int
    """Number of commanded poses."""
    limit: float | None
    """Limit of the awarded grade; None beyond the last step, or where the scale has no limit of this quantity."""
    grade: str
    """Grade by this quantity alone."""
    demonstrated_grade: str | None
    """Best grade whose limit the upper bound meets."""

    @property
    def why(self) -> str | None:
        """Reason why there is no upper bound."""
        return self.interval.why if self.interval.upper_bound is None else None


class Grade(NamedTuple):
    """Grade of position and orientation together, its basis and what limits it.

    The estimate of a statistic of the error's length, named by the scale, decides the grade. The grade is confirmed
    where the one-sided upper confidence bound of that statistic meets the grade's limits too: few poses can reach a
    grade without confirming it. The probability of each grade is the confidence between its limits and those of the
    next better grade (:mod:`robacc.statistics.intervals`), so a confirmed grade or a better one has at least
    the scale's confidence.
    """

    scale: Scale
    quantities: Mapping[Quantity, QuantityGrade]
    """Position, and orientation where it was measured."""
    position: QuantityGrade
    """Grade by position alone."""
    orientation: QuantityGrade | None
    """Grade by orientation alone; None where it was not measured."""
    rank: int
    """Index of the awarded step, 0 for the best; the number of steps where none is met."""
    confirmed_rank: int
    """Index of the best step whose limits all upper bounds meet."""
    grade: str
    """Name of the awarded grade."""
    demonstrated: bool
    """All upper bounds meet the grade's limits: the grade is confirmed at the scale's confidence."""
    demonstrated_grade: str | None
    """Best grade whose limits all upper bounds meet; None where there is none."""
    limited_by: tuple[Quantity, ...]
    """Quantities that prevent a better grade; empty at the best grade."""
    next: Mapping[str, Any] | None
    """Next better grade and the distances to its limits, with the keys of the result; None at the best."""

    @property
    def probabilities(self) -> tuple[tuple[str, float], ...]:
        """Probability that each grade of the scale is the true grade, the last for no step met; empty where unknown.

        Position and orientation count as independent (exact if one decides).
        """
        steps, own = self.scale.steps, self.quantities.items()
        shares = [[_within(quantity.interval, step.limit(name)) for name, quantity in own] for step in steps]
        if any(None in of_step for of_step in shares):
            return ()
        within = [math.prod(share or 0.0 for share in of_step) for of_step in shares]
        names = [*(step.grade for step in steps), self.scale.otherwise]
        edges = zip(names, [0.0, *within], [*within, 1.0], strict=True)
        return tuple((name, max(high - low, 0.0)) for name, low, high in edges)

    @property
    def probability(self) -> float | None:
        """Probability that the grade is right, given the data."""
        return dict(self.probabilities).get(self.grade)

    def probability_within(self, rank: int) -> float | None:
        """Return the probability that the true grade is that of step ``rank`` or better; None if unknown."""
        shares = [share for _, share in self.probabilities]
        return math.fsum(shares[: rank + 1]) if shares else None

    @property
    def poses_to_demonstrate(self) -> int | None:
        """Poses that would confirm the grade with probability 0.9 if the estimate stays as it is.

        None where the grade is confirmed already, or no number of poses suffices.
        """
        return None if self.demonstrated else self.poses_needed(self.rank)

    def poses_needed(self, rank: int) -> int | None:
        """Return how many poses would confirm step ``rank`` with probability 0.9 if the estimate stays as it is.

        The larger number of the two quantities; None where more than a million are needed.
        """
        needed: list[int | None] = []
        for name, own in self.quantities.items():
            limit = self.scale.steps[rank].limit(name) if rank < len(self.scale.steps) else None
            bound, curve = own.interval.upper_bound, own.interval.curve
            if limit is not None:
                needed.append(own.n_poses + 1)
            if limit is not None and (bound is None or bound > limit):
                needed.append(None if curve is None else curve.poses_for(limit, self.scale.confidence, own.n_poses))
        return largest_known(needed)

    @property
    def reason(self) -> str:
        """Estimates, their limits, the next better grade and the confirmation, in sentences."""
        scale, own, following = self.scale, self.quantities, self.next or {}
        missing = [
            f"{_amount(excess, quantity.unit)} less in {name}"
            for name, quantity in own.items()
            if (excess := following.get(f"{name}_excess_{quantity.unit}"))
        ]
        at_confidence = f"confirmed at {100 * scale.confidence:g} % confidence"
        known = [(name, quantity.interval.upper_bound, quantity.unit) for name, quantity in own.items()]
        bounds = ", ".join(f"{name} {_amount(bound, unit)}" for name, bound, unit in known if bound is not None)
        unbounded = [f"{name} has no upper bound ({quantity.why})" for name, quantity in own.items() if quantity.why]
        best = f"grade {self.demonstrated_grade} is confirmed" if self.demonstrated_grade else "no grade is confirmed"
        confirmation, *_ = applying(
            (self.demonstrated, f"{at_confidence}: the upper bound is within the limit ({bounds})"),
            (bool(unbounded), f"not {at_confidence}: {'; '.join(unbounded)}"),
            (self.rank == len(scale.steps), "no step of the scale is met, so no grade can be confirmed"),
            (True, f"not {at_confidence}: the upper bound is beyond a limit ({bounds}); {best}"),
        )
        sentences = applying(
            (True, "; ".join(self._estimate(name, quantity) for name, quantity in own.items())),
            (self.orientation is None, "orientation was not measured, so the grade covers position only"),
            (
                self.next is not None,
                f"limited by {' and '.join(self.limited_by)}: grade {following.get('grade')} needs "
                f"{' and '.join(missing)}",
            ),
            (True, confirmation),
        )
        return ". ".join(sentences)

    def _estimate(self, name: Quantity, quantity: QuantityGrade) -> str:
        steps, unit = self.scale.steps, quantity.unit
        limits = [limit for step in steps if (limit := step.limit(name)) is not None]
        # More digits where rounding would move the value onto or over a limit.
        factor, digits = _FACTORS[unit], 3
        while digits < 6 and not all(
            (float(f"{factor * quantity.value:.{digits}g}") > factor * limit * (1 + 1e-12)) == (quantity.value > limit)
            for limit in limits
        ):
            digits += 1
        text, beyond = f"{name}: {_NAMES[self.scale.statistic]} {_amount(quantity.value, unit, digits)}", steps[-1]
        if quantity.limit is not None:
            return f"{text}, within {_amount(quantity.limit, unit)}"
        if self.rank < len(steps) or name not in self.limited_by:
            return text
        return f"{text}, beyond the limit of {beyond.grade}, {_amount(beyond.limit(name) or math.inf, unit)}"


def _within(interval: Interval, limit: float | None) -> float | None:
    """Return the probability that the true value is within a limit; None where it is unknown."""
    if limit is None:
        return 1.0
    if interval.curve is not None:
        return interval.curve.below(limit)
    # Without scatter a limit is met with probability 0 or 1.
    return None if interval.upper_bound is None else float(interval.upper_bound <= limit)


_NAMES: dict[Statistic, str] = {
    "rms": "rms error",
    "mean_error": "mean error",
    "p95": "95th percentile of the error",
    "max": "largest error",
}
_FACTORS: dict[Unit, float] = {"m": 1e3, "rad": math.degrees(1.0)}


def _amount(value: float, unit: Unit, digits: int = 3) -> str:
    """Format in mm or degrees, with three significant digits unless more are asked for."""
    # Without an exponent for errors of metres.
    return f"{float(f'{_FACTORS[unit] * value:.{digits}g}'):.{max(digits, 6)}g}{' mm' if unit == 'm' else '°'}"


def grade(position: ErrorStatistics, orientation: ErrorStatistics | None, scale: Scale) -> Grade:
    """Grade the errors on ``scale``; by position alone where no orientation was measured.

    Args:
        position: Statistics of the position errors, unit m.
        orientation: Statistics of the orientation errors, unit rad.
        scale: The steps, and the statistic and confidence that decide.

    Raises:
        UsageError: The confidence of the statistics differs from that of the scale.
    """
    both: dict[Quantity, ErrorStatistics | None] = {"position": position, "orientation": orientation}
    graded = {name: statistics for name, statistics in both.items() if statistics is not None}
    required = f"but the scale {scale.name} requires {scale.confidence:g}"
    refuse(
        *(
            (
                own.confidence != scale.confidence,
                f"the {name} statistics have a confidence of {own.confidence:g}, {required}",
            )
            for name, own in graded.items()
        )
    )
    estimates = {name: statistics.estimate(scale.statistic) for name, statistics in graded.items()}
    ranks = {name: scale.rank_of(name, value) for name, (value, _) in estimates.items()}
    confirmed = {name: scale.rank_of(name, interval.upper_bound) for name, (_, interval) in estimates.items()}
    rank, best = max(ranks.values()), max(confirmed.values())
    quantities = {
        name: QuantityGrade(
            graded[name].unit,
            *estimates[name],
            n_poses=graded[name].n_poses,
            limit=scale.steps[rank].limit(name) if rank < len(scale.steps) else None,
            grade=scale.name_of(ranks[name]),
            demonstrated_grade=scale.step_name(confirmed[name]),
        )
        for name in graded
    }
    following = None
    if rank > 0:
        step = scale.steps[rank - 1]
        excess = {name: max(0.0, value - (step.limit(name) or math.inf)) for name, (value, _) in estimates.items()}
        following = {
            "grade": step.grade,
            "position_excess_m": excess["position"],
            "orientation_excess_rad": excess.get("orientation"),
        }
    return Grade(
        scale=scale,
        quantities=quantities,
        position=quantities["position"],
        orientation=quantities.get("orientation"),
        rank=rank,
        confirmed_rank=best,
        grade=scale.name_of(rank),
        demonstrated=best <= rank < len(scale.steps),
        demonstrated_grade=scale.step_name(best),
        limited_by=tuple(name for name in graded if ranks[name] == rank > 0),
        next=following,
    )
