"""What a gate says of a result, as the ``gate`` part of its JSON document: m and rad, null where there is nothing."""

from __future__ import annotations

from typing import Any

from robacc.documents.digits import significant_document
from robacc.gates.criteria import RULES
from robacc.gates.decision_rules import ASSURANCE
from robacc.gates.evaluate import GateOutcome, Judged

_UNITS = {"length": "m", "angle": "rad"}


def gate_document(found: GateOutcome) -> dict[str, Any]:
    """The gate's outcome, then each criterion's."""
    document = {
        "name": found.gate.name,
        "outcome": found.outcome,
        "exit_status": found.exit_status,
        "assurance": ASSURANCE,
        "criteria": [_criterion(one) for one in found.judged],
        "warnings": list(found.warnings),
    }
    rounded: dict[str, Any] = significant_document(document)
    return rounded


def _criterion(one: Judged) -> dict[str, Any]:
    asked, decision = one.criterion, one.decision
    return {
        "name": asked.name,
        "key": asked.key,
        "outcome": one.outcome,
        "why": decision.why,
        "unit": _UNITS.get(one.dimension, "1"),
        "value": one.value if one.found is None else one.found,
        "limit": (list(asked.words) if asked.kind == "word" else asked.words[0]) if asked.words else asked.limit,
        "at_least": asked.at_least,
        "rule": asked.rule,
        "rule_text": RULES[asked.rule],
        "confidence": None if asked.rule == "simple" else asked.confidence,
        "share": asked.share if one.is_by_share else None,
        "lower_bound": decision.lower_bound,
        "upper_bound": decision.upper_bound,
        "margin": decision.margin,
        "conformity_probability": decision.probability,
        "method": decision.method,
        "n_poses": one.n,
        "poses_to_decide": decision.poses_to_decide,
        "poses_to_decide_if_value_is_true": decision.poses_if_true,
        "baseline": None if asked.baseline is None else {"file": asked.baseline, "value": one.baseline_value},
        "instrument_uncertainty_over_limit": one.instrument_ratio,
        "reason": asked.reason,
        "warnings": list(one.warnings),
        "operating_curve_over": "share_within_limit" if one.is_by_share else "value",
        "operating_curve": [list(point) for point in decision.operating_curve],
    }
