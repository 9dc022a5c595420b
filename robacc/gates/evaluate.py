"""Evaluation of a gate on a result: an outcome for each criterion, and for all criteria together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from robacc.gates.baseline import difference_to_baseline
from robacc.gates.criteria import Gate, GateCriterion
from robacc.gates.decision_rules import Decision, Outcome, decide
from robacc.gates.keys import KEYS
from robacc.gates.largest import decide_largest
from robacc.gates.lookup import GateFigure, Missing, figure_at, value_at, word_at

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
    value: float | None
    word: str | None
    """Word or grade of the result, for a criterion on one."""
    baseline_value: float | None
    n: int | None
    """Number of commanded poses behind the value."""
    instrument_ratio: float | None
    """The instrument's expanded uncertainty over the limit."""
    warnings: tuple[str, ...]
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
    return GateOutcome(gate, tuple(_evaluate(criterion, document, baselines) for criterion in gate.criteria))


def _evaluate(
    criterion: GateCriterion, document: Mapping[str, Any], baselines: Mapping[str, Mapping[str, Any]]
) -> CriterionEvaluation:
    if criterion.kind == "word":
        return _evaluate_word(criterion, document)
    if criterion.kind == "grade":
        return _evaluate_grade(criterion, document)
    baseline_value = None
    figure: GateFigure | Missing
    if criterion.baseline is None:
        figure = figure_at(document, criterion.key, criterion.confidence)
    else:
        comparison = difference_to_baseline(document, baselines[criterion.baseline], criterion)
        figure = comparison if isinstance(comparison, Missing) else comparison[0]
        baseline_value = None if isinstance(comparison, Missing) else comparison[1].value
    if isinstance(figure, Missing):
        return _not_evaluated(criterion, figure.why)
    if criterion.limit != 0.0 and figure.dimension != criterion.kind:
        why = (
            f"the limit has the dimension {criterion.kind}, but {criterion.key} of the result has the dimension "
            f"{figure.dimension}"
        )
        return _not_evaluated(criterion, why)
    ratio = None if criterion.baseline is not None else _instrument_ratio(criterion, document)
    return CriterionEvaluation(
        criterion,
        _decide_figure(criterion, figure),
        figure.dimension,
        figure.value,
        None,
        baseline_value,
        figure.n,
        ratio,
        _warnings(criterion, ratio),
        _is_by_share(criterion, figure),
    )


def _not_evaluated(criterion: GateCriterion, why: str) -> CriterionEvaluation:
    return CriterionEvaluation(
        criterion, Decision("not_evaluated", why), criterion.kind, None, None, None, None, None, ()
    )


def _is_by_share(criterion: GateCriterion, figure: GateFigure) -> bool:
    if figure.curve is not None and figure.curve.bounds:
        return False
    # The largest value of an ISO 9283 criterion covers its few commanded poses, which are the whole population.
    is_sample_maximum = figure.statistic == "max" and figure.n is not None and criterion.key in KEYS
    is_upper_limit = criterion.baseline is None and not criterion.at_least
    return is_sample_maximum and is_upper_limit and criterion.rule != "simple"


def _decide_figure(criterion: GateCriterion, figure: GateFigure) -> Decision:
    if figure.n is not None and _is_by_share(criterion, figure):
        return decide_largest(criterion, figure.value, figure.n)
    return decide(criterion, figure.value, figure.curve, figure.n)


def _evaluate_word(criterion: GateCriterion, document: Mapping[str, Any]) -> CriterionEvaluation:
    word = word_at(document, criterion.key)
    if isinstance(word, Missing):
        return _not_evaluated(criterion, word.why)
    warnings: tuple[str, ...] = ()
    decision = Decision("pass" if word in criterion.accepted else "fail")
    if criterion.key == "verdict" and decision.outcome == "pass":
        decision, warnings = _qualify_verdict(decision, document)
    return CriterionEvaluation(criterion, decision, "word", None, word, None, None, None, warnings)


def _qualify_verdict(decision: Decision, document: Mapping[str, Any]) -> tuple[Decision, tuple[str, ...]]:
    """Return the decision on an accepted verdict of a trace: inconclusive without held-out poses to confirm it."""
    after, noise = document.get("after"), document.get("noise")
    if isinstance(after, Mapping) and after.get("held_out") is None:
        return Decision("inconclusive", "the result has no held-out poses to confirm the verdict"), ()
    if isinstance(noise, Mapping) and noise.get("source") == "residual":
        return decision, (
            "verdict: the measurement noise is unknown (no sigma columns, no repeated poses), so the verdict says that "
            "no structure remains, not how large the remaining error is; add a limit on after.held_out.position.p95",
        )
    return decision, ()


def _evaluate_grade(criterion: GateCriterion, document: Mapping[str, Any]) -> CriterionEvaluation:
    """Evaluate a grade: position and orientation must both meet its limits, each at the scale's own confidence.

    Each bound is within its limit at the full confidence, so both are together (an intersection-union test, R. L.
    Berger, Technometrics 24, 1982); the probability is the smaller of the two.
    """
    match = value_at(document, "grade")
    if isinstance(match, Missing):
        return _not_evaluated(criterion, match.why)
    grade, required = match[0], criterion.accepted[0]
    steps: Sequence[Mapping[str, Any]] = grade.get("steps") or ()
    names = [str(step.get("grade")) for step in steps]
    if not names:
        return _not_evaluated(criterion, "the result's grade does not list the steps of its scale")
    if required not in names:
        why = f"the scale {grade.get('scale')} has no grade {required}; its grades are {', '.join(names)}"
        return _not_evaluated(criterion, why)
    step, statistic = steps[names.index(required)], grade.get("statistic")
    decisions: list[tuple[Decision, int | None]] = []
    confidence = grade.get("confidence")
    for quantity, unit in (("position", "m"), ("orientation", "rad")):
        limit = step.get(f"{quantity}_{unit}")
        if limit is None or not document.get(quantity):
            continue
        condition = replace(
            criterion,
            key=f"{quantity}.{statistic}",
            limit=limit,
            confidence=criterion.confidence if confidence is None else confidence,
        )
        figure = figure_at(document, condition.key, condition.confidence)
        if isinstance(figure, Missing):
            return _not_evaluated(criterion, figure.why)
        decisions.append((_decide_figure(condition, figure), figure.n))
    decision = _joint_decision([decision for decision, _ in decisions])
    if decision.outcome == "fail" and isinstance(grade.get("reason"), str):
        decision = replace(decision, why=grade["reason"].partition(". ")[0])
    n = next((n_poses for _, n_poses in decisions), None)
    return CriterionEvaluation(criterion, decision, "grade", None, str(grade.get("grade")), None, n, None, ())


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
