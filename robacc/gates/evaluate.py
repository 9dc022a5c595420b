"""Evaluation of a gate on a result and its baselines: an outcome for each criterion, and for all together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from robacc.accuracy.error_statistics import Statistic, length_intervals
from robacc.comparison.differences import Pairing, difference, pair_poses
from robacc.comparison.reading import ErrorSet, errors_behind, stored_interval
from robacc.gates.decision_rules import LEVELS, BoundCurve, Decision, Outcome, decide, decide_largest, difference_curve
from robacc.gates.gate_file import KEYS, Gate, GateCriterion

# Values of a result by their short key: the value, its unit, and the bounds that the result or its poses give.

MOST_POSES = 20_000
"""With more poses, the stored interval is as good as a recomputed one and costs nothing."""
_DIMENSIONS = {"m": "length", "rad": "angle"}


@dataclass(frozen=True, slots=True)
class GateFigure:
    """One number of a result."""

    value: float
    dimension: str
    """length (m), angle (rad) or number."""
    curve: BoundCurve | None
    """None if the result has no interval for the figure."""
    n: int | None
    """Number of commanded poses."""


class NoValueError(Exception):
    """Reason why a result has no value for a key."""


def value_at(document: Mapping[str, Any], key: str) -> tuple[Any, Mapping[str, Any], str]:
    """Return the value of a short key, the object that holds it, and its full name in that object.

    Raises:
        NoValueError: The result has no such key, or null there.
    """
    node: Any = document
    path: list[str] = []
    holder, name = document, ""
    for part in key.split("."):
        if not isinstance(node, Mapping):
            raise NoValueError(f"the result has no keys within {'.'.join(path)}")
        path.append(part)
        full_names = [full for full in (part, *(f"{part}_{unit}" for unit in _DIMENSIONS)) if full in node]
        if not full_names:
            raise NoValueError(f"a result of robacc {document.get('command', '?')} has no {'.'.join(path)}")
        holder, name, node = node, full_names[0], node[full_names[0]]
        if node is None:
            why = holder.get("why")
            raise NoValueError(f"the result has no {'.'.join(path)}" + (f": {why}" if isinstance(why, str) else ""))
    return node, holder, name


def word_at(document: Mapping[str, Any], key: str) -> str:
    """Return the word of a key; a boolean gives ``true`` or ``false``.

    Raises:
        NoValueError: The result has no word there.
    """
    value = value_at(document, key)[0]
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if not isinstance(value, str):
        raise NoValueError(f"the result's {key} is not a word")
    return value


def figure_at(document: Mapping[str, Any], key: str, confidence: float) -> GateFigure:
    """Return the number of a key, with its curve; ``confidence`` is the level that a recomputed curve includes.

    Raises:
        NoValueError: The result has no number there.
    """
    value, holder, name = value_at(document, key)
    stored = [(holder.get("intervals") or {}).get(name), holder.get("interval")]
    if isinstance(value, Mapping):
        stored, value = [value], value.get("value")
    number = _number(value)
    if number is None:
        raise NoValueError(f"the result's {key} is not a number")
    statistic = key.rpartition(".")[2]
    counts = [holder.get("n_commanded_poses"), holder.get("n_poses"), document.get("n_poses")]
    n = next((int(count) for count in map(_number, counts) if count is not None), None)
    interval = next((stored_interval(entry) for entry in stored if isinstance(entry, Mapping)), None)
    curve = None
    if interval is not None:
        # The 95th percentile of a small sample is biased low: two bounds locate the median better than the value.
        two_sided = interval.lower is not None and (interval.upper_bound is not None or interval.upper is not None)
        curve = BoundCurve.through([interval], None if two_sided and statistic == "p95" else number)
    errors = _errors_behind(document, key)
    if errors is not None and statistic in ("rms", "mean_error", "p95") and errors.groups.size <= MOST_POSES:
        n = errors.n_groups
        share = (errors.independent_poses or n) / n
        statistics = length_intervals(
            errors.vectors, _levels(confidence), groups=errors.groups, share=share, seed=document.get("seed") or 0
        )
        curve = BoundCurve.through([by_name[cast("Statistic", statistic)] for by_name in statistics])
    return GateFigure(number, _DIMENSIONS.get(name.rpartition("_")[2], "number"), curve, n)


def _errors_behind(document: Mapping[str, Any], key: str) -> ErrorSet | None:
    try:
        return errors_behind(document, key.rpartition(".")[0])
    except ValueError as error:
        raise NoValueError(f"the result's lists do not belong together: {error}") from None


def _levels(confidence: float) -> list[float]:
    """Return the confidences of the intervals behind a curve that has bounds at ``confidence``."""
    return sorted({*LEVELS, confidence, max(2.0 * confidence - 1.0, 0.01)})


def _number(value: Any) -> float | None:
    """Return a finite number; None for anything else, booleans included."""
    if isinstance(value, bool | np.bool_ | str | Sequence | Mapping) or value is None or np.ndim(value):
        return None
    return float(value) if math.isfinite(value) else None


# Difference between a figure of a result and the same figure of a baseline: paired where the poses are the same.

_PAIRABLE = ("rms", "mean_error", "p95", "max")


def difference_to_baseline(
    document: Mapping[str, Any], baseline: Mapping[str, Any], criterion: GateCriterion
) -> tuple[GateFigure, float]:
    """Return the difference, result minus baseline, and the baseline's value.

    Raises:
        NoValueError: The result or the baseline has no such number, or their poses cannot be paired as required.
    """
    key, confidence = criterion.key, criterion.confidence
    figure = figure_at(document, key, confidence)
    try:
        reference = figure_at(baseline, key, confidence)
    except NoValueError as error:
        raise NoValueError(f"in the baseline, {error}") from None
    if figure.dimension != reference.dimension:
        raise NoValueError(f"{key} has different units in the result and in the baseline")
    statistic = key.rpartition(".")[2]
    samples = [_errors_behind(each, key) for each in (baseline, document)] if statistic in _PAIRABLE else []
    first, second = samples or (None, None)
    if first is not None and second is not None:
        if (pair := _paired(first, second, criterion.paired)) is not None:
            differences = [
                difference(
                    statistic,
                    pair.first,
                    pair.second,
                    paired=True,
                    confidence=level,
                    seed=document.get("seed") or 0,
                )
                for level in _levels(confidence)
            ]
            curve = BoundCurve.through(each.interval for each in differences)
            return GateFigure(differences[0].value, figure.dimension, curve, pair.n_second), reference.value
    elif criterion.paired:
        raise NoValueError("paired: true needs the error of every pose, which the result or the baseline does not list")
    independent = None
    if figure.curve is not None and reference.curve is not None:
        independent = difference_curve(figure.value, figure.curve, reference.value, reference.curve)
    return GateFigure(figure.value - reference.value, figure.dimension, independent, figure.n), reference.value


def _paired(baseline: ErrorSet, errors: ErrorSet, paired: bool | None) -> Pairing | None:
    """Return the errors by pose, of all poses of both results; None if their poses differ.

    Raises:
        NoValueError: The criterion requires the same poses, and the results differ in the number of rows.
    """
    if paired is False:
        return None
    pair = pair_poses(baseline, errors)
    if pair.paired and pair.first.n_groups == pair.n_first == pair.n_second:
        return pair
    if not paired:
        return None
    if errors.groups.size != baseline.groups.size:
        raise NoValueError(
            f"paired: true needs the same poses, but the result has {errors.groups.size} and the baseline has "
            f"{baseline.groups.size}"
        )
    return Pairing(baseline, replace(errors, groups=baseline.groups), True, pair.n_first, pair.n_second)


COVERAGE_FACTOR = 2.0
"""Coverage factor of the instrument's expanded uncertainty (JCGM 100, 6.2)."""
MOST_OF_TOLERANCE = 0.25
"""Share of the limit above which the instrument's expanded uncertainty gives a warning: four to one, as ANSI/NCSL
Z540.3 and the practice of ISO 14253-2 ask."""
_EXIT_STATUS: dict[Outcome, int] = {"pass": 0, "fail": 4, "inconclusive": 5, "not_evaluated": 5}
_WORST_FIRST: tuple[Outcome, ...] = ("fail", "not_evaluated", "inconclusive", "pass")


@dataclass(frozen=True, slots=True)
class CriterionEvaluation:
    """One criterion and its decision."""

    criterion: GateCriterion
    decision: Decision
    dimension: str
    """Dimension of the value, its bounds and its limit: length (m), angle (rad), number, grade or word."""
    value: float | None = None
    word: str | None = None
    """Word or grade of the result, for a criterion on one."""
    baseline_value: float | None = None
    n: int | None = None
    """Number of commanded poses behind the value."""
    instrument_ratio: float | None = None
    """The instrument's expanded uncertainty over the limit."""
    warnings: tuple[str, ...] = ()
    is_by_share: bool = False
    """A largest error, decided by the share of all poses within the limit."""

    @property
    def outcome(self) -> Outcome:
        """Return the outcome of the criterion."""
        return self.decision.outcome


@dataclass(frozen=True, slots=True)
class GateOutcome:
    """Evaluation of every criterion of a gate on one result."""

    gate: Gate
    evaluations: tuple[CriterionEvaluation, ...]

    @property
    def outcome(self) -> Outcome:
        """Return fail if one criterion fails, pass if all criteria pass."""
        return min((evaluation.outcome for evaluation in self.evaluations), key=_WORST_FIRST.index)

    @property
    def exit_status(self) -> int:
        """Return the exit status of the command: 0 pass, 4 fail, 5 undecided."""
        return _EXIT_STATUS[self.outcome]

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return the warnings of all criteria, without repetitions."""
        return tuple(dict.fromkeys(text for evaluation in self.evaluations for text in evaluation.warnings))

    def count(self, outcome: Outcome) -> int:
        """Return the number of criteria with that outcome."""
        return sum(evaluation.outcome == outcome for evaluation in self.evaluations)


def evaluate_gate(gate: Gate, document: Mapping[str, Any], baselines: Mapping[str, Mapping[str, Any]]) -> GateOutcome:
    """Evaluate a gate on a result.

    Args:
        gate: The criteria.
        document: The JSON document of the result.
        baselines: The documents of ``gate.baselines``, by their paths in the gate.
    """
    evaluations = []
    for criterion in gate.criteria:
        try:
            evaluations.append(_evaluate(criterion, document, baselines))
        except NoValueError as error:
            decision = Decision("not_evaluated", str(error))
            evaluations.append(CriterionEvaluation(criterion, decision, criterion.kind))
    return GateOutcome(gate, tuple(evaluations))


def _evaluate(
    criterion: GateCriterion, document: Mapping[str, Any], baselines: Mapping[str, Mapping[str, Any]]
) -> CriterionEvaluation:
    if criterion.kind == "word":
        return _evaluate_word(criterion, document)
    if criterion.kind == "grade":
        return _evaluate_grade(criterion, document)
    baseline_value = ratio = None
    if criterion.baseline is not None:
        figure, baseline_value = difference_to_baseline(document, baselines[criterion.baseline], criterion)
    else:
        figure = figure_at(document, criterion.key, criterion.confidence)
        ratio = _instrument_ratio(criterion, document)
    if criterion.limit != 0.0 and figure.dimension != criterion.kind:
        raise NoValueError(
            f"the limit has the dimension {criterion.kind}, but {criterion.key} of the result has the dimension "
            f"{figure.dimension}"
        )
    return CriterionEvaluation(
        criterion,
        _decide_figure(criterion, figure),
        figure.dimension,
        figure.value,
        baseline_value=baseline_value,
        n=figure.n,
        instrument_ratio=ratio,
        warnings=_warnings(criterion, ratio),
        is_by_share=_is_by_share(criterion, figure),
    )


def _is_by_share(criterion: GateCriterion, figure: GateFigure) -> bool:
    if figure.curve is not None and figure.curve.bounds:
        return False
    # The largest value of an ISO 9283 criterion covers its few commanded poses, which are the whole population.
    is_sample_maximum = criterion.key.endswith(".max") and figure.n is not None and criterion.key in KEYS
    is_upper_limit = criterion.baseline is None and not criterion.at_least
    return is_sample_maximum and is_upper_limit and criterion.rule != "simple"


def _decide_figure(criterion: GateCriterion, figure: GateFigure) -> Decision:
    if figure.n is not None and _is_by_share(criterion, figure):
        return decide_largest(criterion, figure.value, figure.n)
    return decide(criterion, figure.value, figure.curve, figure.n)


def _evaluate_word(criterion: GateCriterion, document: Mapping[str, Any]) -> CriterionEvaluation:
    """Evaluate a word; an accepted verdict of a trace is inconclusive without held-out poses to confirm it."""
    word = word_at(document, criterion.key)
    decision = Decision("pass" if word in criterion.accepted else "fail")
    warnings: tuple[str, ...] = ()
    if criterion.key == "verdict" and decision.outcome == "pass":
        after = document.get("after")
        if isinstance(after, Mapping) and after.get("held_out") is None:
            decision = Decision("inconclusive", "the result has no held-out poses to confirm the verdict")
        elif (document.get("noise") or {}).get("source") == "residual":
            warnings = (
                "verdict: the measurement noise is unknown (no sigma columns, no repeated poses), so the verdict says "
                "that no structure remains, not how large the remaining error is; add a limit on "
                "after.held_out.position.p95",
            )
    return CriterionEvaluation(criterion, decision, "word", word=word, warnings=warnings)


def _evaluate_grade(criterion: GateCriterion, document: Mapping[str, Any]) -> CriterionEvaluation:
    """Evaluate a grade: position and orientation must both meet its limits, each at the scale's own confidence.

    Each bound is within its limit at the full confidence, so both are together (an intersection-union test, R. L.
    Berger, Technometrics 24, 1982); the probability is the smaller of the two.
    """
    grade, required = value_at(document, "grade")[0], criterion.accepted[0]
    steps = {str(step.get("grade")): step for step in grade.get("steps") or ()}
    if not steps:
        raise NoValueError("the result's grade does not list the steps of its scale")
    if required not in steps:
        names = ", ".join(steps)
        raise NoValueError(f"the scale {grade.get('scale')} has no grade {required}; its grades are {names}")
    confidence = grade.get("confidence")
    confidence = criterion.confidence if confidence is None else confidence
    decisions: list[Decision] = []
    n = None
    for quantity, unit in (("position", "m"), ("orientation", "rad")):
        limit = steps[required].get(f"{quantity}_{unit}")
        if limit is not None and document.get(quantity):
            key = f"{quantity}.{grade.get('statistic')}"
            figure = figure_at(document, key, confidence)
            n = n if decisions else figure.n
            decisions.append(_decide_figure(replace(criterion, key=key, limit=limit, confidence=confidence), figure))
    decision = _joint_decision(decisions)
    if decision.outcome == "fail" and isinstance(grade.get("reason"), str):
        decision = replace(decision, why=grade["reason"].partition(". ")[0])
    return CriterionEvaluation(criterion, decision, "grade", word=str(grade.get("grade")), n=n)


def _joint_decision(decisions: Sequence[Decision]) -> Decision:
    """Return the decision on several conditions that must all hold."""
    outcome: Outcome = min((decision.outcome for decision in decisions), key=_WORST_FIRST.index, default="pass")
    reasons = dict.fromkeys(decision.why for decision in decisions if decision.outcome == outcome and decision.why)
    probabilities = [decision.probability for decision in decisions if decision.probability is not None]
    undecided = [decision for decision in decisions if decision.outcome == "inconclusive"]
    if outcome != "inconclusive":
        undecided = []

    def largest(numbers: Sequence[int | None]) -> int | None:
        known = [number for number in numbers if number is not None]
        return max(known) if known and len(known) == len(numbers) else None

    return Decision(
        outcome,
        "; ".join(reasons) or None,
        probability=min(probabilities) if probabilities and len(probabilities) == len(decisions) else None,
        method=next((decision.method for decision in decisions if decision.method), None),
        poses_to_decide=largest([decision.poses_to_decide for decision in undecided]),
        poses_if_true=largest([decision.poses_if_true for decision in undecided]),
    )


def _instrument_ratio(criterion: GateCriterion, document: Mapping[str, Any]) -> float | None:
    """Return the expanded measurement uncertainty along an axis over the limit; None if the result has none."""
    noise = document.get("noise")
    if not isinstance(noise, Mapping) or noise.get("source") == "residual" or criterion.kind not in ("length", "angle"):
        return None
    noise_std = noise.get("position_m" if criterion.kind == "length" else "orientation_rad")
    if not isinstance(noise_std, float) or not criterion.limit or not math.isfinite(noise_std):
        return None
    return COVERAGE_FACTOR * noise_std / abs(criterion.limit)


def _warnings(criterion: GateCriterion, ratio: float | None) -> tuple[str, ...]:
    warnings = []
    if ratio is not None and ratio > MOST_OF_TOLERANCE:
        warnings.append(
            f"{criterion.name}: the instrument's expanded uncertainty (k = 2) is {100 * ratio:.0f} % of the limit, "
            f"more than the recommended {100 * MOST_OF_TOLERANCE:.0f} %"
        )
    if ".fitted." in criterion.key and not criterion.key.startswith("nominal."):
        held_out = criterion.key.replace(".fitted.", ".held_out.")
        warnings.append(
            f"{criterion.name}: {criterion.key} is computed on the calibration poses and is too optimistic; "
            f"use {held_out}"
        )
    return tuple(warnings)
