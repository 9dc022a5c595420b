"""The ``gate`` part of a JSON result: the evaluation of every criterion in m and rad, null where there is no value."""

from __future__ import annotations

from typing import Any

from robacc.documents.digits import significant_document
from robacc.gates.criteria import RULES, GateCriterion
from robacc.gates.decision_rules import ASSURANCE
from robacc.gates.evaluate import CriterionEvaluation, GateOutcome

_UNITS = {"length": "m", "angle": "rad"}


def gate_document(outcome: GateOutcome) -> dict[str, Any]:
    """Return the outcome of the gate and of each criterion."""
    document = {
        "name": outcome.gate.name,
        "outcome": outcome.outcome,
        "exit_status": outcome.exit_status,
        "assurance": ASSURANCE,
        "criteria": [_criterion(evaluation) for evaluation in outcome.evaluations],
        "warnings": list(outcome.warnings),
    }
    rounded: dict[str, Any] = significant_document(document)
    return rounded


def _criterion(evaluation: CriterionEvaluation) -> dict[str, Any]:
    criterion, decision = evaluation.criterion, evaluation.decision
    baseline = None
    if criterion.baseline is not None:
        baseline = {"file": criterion.baseline, "value": evaluation.baseline_value}
    return {
        "name": criterion.name,
        "key": criterion.key,
        "outcome": evaluation.outcome,
        "why": decision.why,
        "unit": _UNITS.get(evaluation.dimension, "1"),
        "value": evaluation.value if evaluation.word is None else evaluation.word,
        "limit": _limit(criterion),
        "at_least": criterion.at_least,
        "rule": criterion.rule,
        "rule_text": RULES[criterion.rule],
        "confidence": None if criterion.rule == "simple" else criterion.confidence,
        "share": criterion.share if evaluation.is_by_share else None,
        "lower_bound": decision.lower_bound,
        "upper_bound": decision.upper_bound,
        "margin": decision.margin,
        "conformity_probability": decision.probability,
        "method": decision.method,
        "n_poses": evaluation.n,
        "poses_to_decide": decision.poses_to_decide,
        "poses_to_decide_if_value_is_true": decision.poses_if_true,
        "baseline": baseline,
        "instrument_uncertainty_over_limit": evaluation.instrument_ratio,
        "reason": criterion.reason,
        "warnings": list(evaluation.warnings),
        "operating_curve_over": "share_within_limit" if evaluation.is_by_share else "value",
        "operating_curve": [list(point) for point in decision.operating_curve],
    }


def _limit(criterion: GateCriterion) -> list[str] | str | float | None:
    if not criterion.accepted:
        return criterion.limit
    return list(criterion.accepted) if criterion.kind == "word" else criterion.accepted[0]
