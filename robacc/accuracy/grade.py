"""Accuracy grades: scales and their reader, the grade that the errors meet, and sentences that explain it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast, get_args

from robacc.errors import InputError, Problem, UsageError
from robacc.statistics.intervals import Interval
from robacc.statistics.records import ErrorStatistics, Statistic, Unit

if TYPE_CHECKING:
    import yaml


# Scales of accuracy grades: the record, and its reader from YAML, which reports every problem with its line.

Quantity = Literal["position", "orientation"]

VERSION = "1"
STATISTICS: tuple[str, ...] = get_args(Statistic)
_KEYS = ("robacc", "name", "statistic", "confidence", "units", "steps", "otherwise")
_STEP_KEYS = ("grade", "position", "orientation")
_UNITS = {"length": {"m": 1.0, "mm": 1e-3}, "angle": {"rad": 1.0, "deg": math.pi / 180.0}}


@dataclass(frozen=True, slots=True)
class GradeStep:
    """Grade and the limits that the statistic must meet."""

    grade: str
    position: float
    """m"""
    orientation: float | None
    """rad; None: no limit of orientation"""

    def limit(self, quantity: Quantity) -> float | None:
        """Return the limit of a quantity in m or rad; None where there is none."""
        return self.position if quantity == "position" else self.orientation


@dataclass(frozen=True, slots=True)
class Scale:
    """Grades from the best to the widest, and the statistic of the error's length that decides."""

    name: str
    statistic: Statistic
    confidence: float
    """Confidence of the upper bound that confirms a grade."""
    steps: tuple[GradeStep, ...]
    otherwise: str
    """Name for errors that meet no step."""

    def name_of(self, rank: int) -> str:
        """Return the grade of step ``rank``, 0 for the best; beyond the last step, the name for errors outside all."""
        return self.steps[rank].grade if rank < len(self.steps) else self.otherwise


def default_scale() -> Scale:
    """Return the built-in scale: A within 0.1 mm and 0.1 degree, the CAD/CAM requirement of the paper."""
    import yaml

    # importlib.resources loads zipfile and more: 3 ms of the 150 that an estimate may take. libyaml, where available,
    # takes a tenth of the time; a user's file is not read by it, because deep nesting makes it end the process.
    path = Path(__file__).parents[1] / "data" / "grades" / "default.yaml"
    text = path.read_text(encoding="utf-8")
    return _scale_of(yaml.compose(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)), path.name)


def load_scale(text: str, file: str) -> Scale:
    """Read a scale.

    Args:
        text: Content of the YAML file.
        file: Name of the file, for messages.

    Raises:
        InputError: With every problem, its line and key.
    """
    from robacc.io.yaml_nodes import compose

    return _scale_of(compose(text, file), file)


def _scale_of(root: yaml.Node | None, file: str) -> Scale:
    reader = _GradeScaleReader(file)
    scale = _read(reader, root)
    if scale is None or reader.problems:
        raise InputError(reader.problems)
    return scale


@dataclass(frozen=True, slots=True)
class _GradeScaleReader:
    """Reader of values from YAML nodes, which know their lines; it collects the problems."""

    file: str
    problems: list[Problem] = field(default_factory=list)

    def report(self, node: yaml.Node | None, key: str, message: str, fix: str | None = None) -> None:
        """Record a problem at a node's line."""
        line = 1 if node is None else node.start_mark.line + 1
        self.problems.append(Problem(message, self.file, line, key or None, fix))

    def mapping(self, node: yaml.Node | None, key: str, known: tuple[str, ...]) -> dict[str, yaml.Node]:
        """Return the children of a mapping by name; report unknown and repeated names."""
        from difflib import get_close_matches

        from yaml import MappingNode

        if not isinstance(node, MappingNode):
            self.report(node, key, f"expected a mapping with the keys {', '.join(known)}")
            return {}
        result: dict[str, yaml.Node] = {}
        for child, value in node.value:
            name = str(child.value)
            if name not in known:
                near = get_close_matches(name, known, n=1)
                fix = f"did you mean {near[0]}" if near else f"the keys are {', '.join(known)}"
                self.report(child, _join(key, name), "unknown key", fix)
            elif name in result:
                self.report(child, _join(key, name), "duplicate key", "remove one of them")
            result.setdefault(name, value)
        return result

    def text(self, node: yaml.Node | None, key: str, parent: yaml.Node | None) -> str | None:
        """Return a word or number as text; report any other node and return None."""
        from yaml import ScalarNode

        if node is None:
            self.report(parent, key, "missing key")
        elif not isinstance(node, ScalarNode) or not node.value.strip() or not node.value.isprintable():
            self.report(node, key, "expected a single word or number")
        else:
            return str(node.value).strip()
        return None

    def choice(
        self, node: yaml.Node | None, key: str, parent: yaml.Node | None, allowed: tuple[str, ...]
    ) -> str | None:
        """Return one of the ``allowed`` words; report any other."""
        value = self.text(node, key, parent)
        if value is not None and value not in allowed:
            self.report(node, key, f"found {value!r}, expected one of {', '.join(allowed)}")
            return None
        return value

    def positive(self, node: yaml.Node | None, key: str, parent: yaml.Node | None) -> float | None:
        """Return a finite number greater than zero; report any other."""
        value = self.text(node, key, parent)
        if value is None:
            return None
        try:
            # float() also takes 1_000 and digits of other scripts.
            number = float(value) if value.isascii() and "_" not in value else math.nan
        except ValueError:
            number = math.nan
        if not (math.isfinite(number) and number > 0.0):
            self.report(node, key, f"found {value!r}, expected a number greater than zero")
            return None
        return number


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


def _read(reader: _GradeScaleReader, root: yaml.Node | None) -> Scale | None:
    top = reader.mapping(root, "", _KEYS)
    if not top:
        return None
    reader.choice(top.get("robacc"), "robacc", root, (VERSION,))
    name = reader.text(top.get("name"), "name", root)
    statistic = reader.choice(top.get("statistic"), "statistic", root, STATISTICS)
    confidence = reader.positive(top.get("confidence"), "confidence", root)
    if confidence is not None and not 0.5 <= confidence < 1.0:
        reader.report(top["confidence"], "confidence", f"found {confidence:g}, expected at least 0.5 and less than 1")
    factors = _read_units(reader, top.get("units"), root)
    steps = _read_steps(reader, top.get("steps"), root, factors)
    otherwise = reader.text(top.get("otherwise"), "otherwise", root)
    if otherwise in [step.grade for step in steps]:
        reader.report(
            top["otherwise"], "otherwise", f"{otherwise!r} is also the grade of a step", "choose another name"
        )
    if name is None or statistic is None or confidence is None or otherwise is None:
        return None
    return Scale(name, cast("Statistic", statistic), confidence, tuple(steps), otherwise)


def _read_units(reader: _GradeScaleReader, node: yaml.Node | None, root: yaml.Node | None) -> tuple[float, float]:
    """Return metres and radians per unit of the file."""
    if node is None:
        reader.report(root, "units", "missing key", "add it, for example units: {length: mm, angle: deg}")
        return 1.0, 1.0
    units = reader.mapping(node, "units", tuple(_UNITS))
    length, angle = (
        _UNITS[kind].get(reader.choice(units.get(kind), f"units.{kind}", node, tuple(_UNITS[kind])) or "", 1.0)
        for kind in _UNITS
    )
    return length, angle


def _read_steps(
    reader: _GradeScaleReader, node: yaml.Node | None, root: yaml.Node | None, factors: tuple[float, float]
) -> list[GradeStep]:
    from yaml import SequenceNode

    if not isinstance(node, SequenceNode) or not node.value:
        reader.report(node or root, "steps", "expected a list of at least one step")
        return []
    steps: list[GradeStep] = []
    for index, item in enumerate(node.value):
        key = f"steps[{index}]"
        fields = reader.mapping(item, key, _STEP_KEYS)
        if not fields:
            continue
        letter = reader.text(fields.get("grade"), f"{key}.grade", item)
        position = reader.positive(fields.get("position"), f"{key}.position", item)
        orientation = None
        if "orientation" in fields:
            orientation = reader.positive(fields["orientation"], f"{key}.orientation", item)
        if letter is None or position is None:
            continue
        step = GradeStep(letter, position * factors[0], None if orientation is None else orientation * factors[1])
        _compare(reader, item, key, step, steps)
        steps.append(step)
    return steps


def _compare(reader: _GradeScaleReader, node: yaml.Node, key: str, step: GradeStep, before: list[GradeStep]) -> None:
    """Report a step that contradicts the steps ``before`` it."""
    if step.grade in [earlier.grade for earlier in before]:
        reader.report(node, f"{key}.grade", f"the grade {step.grade!r} is listed twice")
    if not before:
        return
    last = before[-1]
    if step.position <= last.position:
        reader.report(
            node,
            f"{key}.position",
            f"the limit is not wider than that of grade {last.grade}",
            "list the best grade first",
        )
    if last.orientation is None and step.orientation is not None:
        reader.report(node, f"{key}.orientation", f"the better grade {last.grade} has no limit of orientation")
    if last.orientation is not None and step.orientation is not None and step.orientation < last.orientation:
        reader.report(
            node,
            f"{key}.orientation",
            f"the limit is narrower than that of grade {last.grade}",
            "list the best grade first",
        )


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


# Sentences that explain a grade: the estimates, their limits, the confirmation, and the next better grade.

_NAMES: dict[Statistic, str] = {
    "rms": "rms error",
    "mean_error": "mean error",
    "p95": "95th percentile of the error",
    "max": "largest error",
}
_DIGITS = 3
_MOST_DIGITS = 6


def grade_reason(
    scale: Scale,
    rank: int,
    quantities: dict[Quantity, QuantityGrade],
    limited_by: tuple[Quantity, ...],
    following: NextGrade | None,
    demonstrated: bool,
    demonstrated_grade: str | None,
) -> str:
    """Explain a grade in sentences."""
    statistic = _NAMES[scale.statistic]
    estimates = []
    for name, quantity in quantities.items():
        limits = [limit for step in scale.steps if (limit := step.limit(name)) is not None]
        text = f"{name}: {statistic} {_beside(quantity.value, limits, quantity.unit)}"
        if quantity.limit is not None:
            text += f", within {_amount(quantity.limit, quantity.unit)}"
        elif rank == len(scale.steps) and name in limited_by:
            last = scale.steps[-1].limit(name)
            text += f", beyond the limit of {scale.steps[-1].grade}, {_amount(last or math.inf, quantity.unit)}"
        estimates.append(text)
    sentences = ["; ".join(estimates)]
    if "orientation" not in quantities:
        sentences.append("orientation was not measured, so the grade covers position only")
    if following is not None:
        by_quantity: tuple[tuple[str, Unit, float | None], ...] = (
            ("position", "m", following.position),
            ("orientation", "rad", following.orientation),
        )
        missing = [f"{_amount(excess, unit)} less in {name}" for name, unit, excess in by_quantity if excess]
        sentences.append(
            f"limited by {' and '.join(limited_by)}: grade {following.grade} needs {' and '.join(missing)}"
        )
    sentences.append(_confirmation(scale, rank, quantities, demonstrated, demonstrated_grade))
    return ". ".join(sentences)


def _confirmation(
    scale: Scale, rank: int, quantities: dict[Quantity, QuantityGrade], demonstrated: bool, confirmed: str | None
) -> str:
    confidence = f"{100 * scale.confidence:g} %"
    at_confidence = f"at {confidence} confidence"
    if demonstrated:
        return f"confirmed {at_confidence}: the upper bound is within the limit ({_bounds(quantities)})"
    missing = [f"{name} has no upper bound ({quantity.why})" for name, quantity in quantities.items() if quantity.why]
    if missing:
        return f"not confirmed {at_confidence}: {'; '.join(missing)}"
    if rank == len(scale.steps):
        return "no step of the scale is met, so no grade can be confirmed"
    best = f"grade {confirmed} is confirmed" if confirmed else "no grade is confirmed"
    return f"not confirmed {at_confidence}: the upper bound is beyond a limit ({_bounds(quantities)}); {best}"


def _bounds(quantities: dict[Quantity, QuantityGrade]) -> str:
    return ", ".join(
        f"{name} {_amount(quantity.upper_bound, quantity.unit)}"
        for name, quantity in quantities.items()
        if quantity.upper_bound is not None
    )


def _beside(value: float, limits: Sequence[float], unit: Unit) -> str:
    """Format as :func:`_amount`, with more digits where rounding would move the value onto or over a limit."""
    factor = 1e3 if unit == "m" else math.degrees(1.0)
    for digits in range(_DIGITS, _MOST_DIGITS):
        rounded = float(f"{factor * value:.{digits}g}")
        if all((rounded > factor * limit * (1 + 1e-12)) == (value > limit) for limit in limits):
            return _amount(value, unit, digits)
    return _amount(value, unit, _MOST_DIGITS)


def _amount(value: float, unit: Unit, digits: int = _DIGITS) -> str:
    """Format in mm or degrees, with three significant digits unless more are asked for."""
    shown = 1e3 * value if unit == "m" else math.degrees(value)
    # Without an exponent for errors of metres.
    return f"{float(f'{shown:.{digits}g}'):.{max(digits, 6)}g}{' mm' if unit == 'm' else '°'}"


# Accuracy grade: the step of a scale that the errors meet, and whether the data confirm it.
#
# The estimate of a statistic of the error's length, named by the scale, decides the grade. The grade is confirmed
# where the one-sided upper confidence bound of that statistic meets the grade's limits too: few poses can reach a
# grade without confirming it. The probability of each grade is the confidence between its limits and those of the
# next better grade (:mod:`robacc.statistics.confidence_curves`), so a confirmed grade or a better one has at least
# the scale's confidence. :mod:`robacc.accuracy.grade` reads the scales.


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
