"""Gate outcomes as text: the same wording in a table, a job summary, an annotation and JUnit."""

from __future__ import annotations

from robacc.gates.decision_rules import ASSURANCE, Outcome
from robacc.gates.evaluate import CriterionEvaluation, GateOutcome
from robacc.render.text.numbers import three_digits
from robacc.render.text.parameter_names import as_options
from robacc.render.text.units import IN_DEGREES, IN_MM

OUTCOME_LABELS: dict[Outcome, str] = {
    "pass": "pass",
    "fail": "fail",
    "inconclusive": "inconclusive",
    "not_evaluated": "not evaluated",
}
_SCALES = {"length": (IN_MM, " mm"), "angle": (IN_DEGREES, "°")}


def amount(value: float | None, dimension: str) -> str:
    """Return the value in mm, degrees or without unit, three digits; a dash for None."""
    if value is None:
        return "–"
    factor, unit = _SCALES.get(dimension, (1.0, ""))
    return f"{three_digits(factor * value)}{unit}"


def title(outcome: GateOutcome) -> str:
    """Return the gate's name and outcome, and the number of criteria with each outcome."""
    counts = [f"{outcome.count(kind)} {label}" for kind, label in OUTCOME_LABELS.items() if outcome.count(kind)]
    return f"Gate {outcome.gate.name}: {OUTCOME_LABELS[outcome.outcome].upper()} ({', '.join(counts)})"


def limit(evaluation: CriterionEvaluation) -> str:
    """Return the limit with its direction."""
    criterion = evaluation.criterion
    if criterion.kind == "grade":
        return f"{criterion.accepted[0]} or better"
    if criterion.kind == "word":
        return " or ".join(criterion.accepted)
    factor, unit = _SCALES.get(criterion.kind, (1.0, ""))
    size = f"{factor * abs(criterion.limit or 0.0):.6g}{unit}"
    if criterion.baseline is None:
        return f"at least {size}" if criterion.at_least else f"at most {size}"
    if not criterion.limit:
        return f"no {'less' if criterion.at_least else 'more'} than in {criterion.baseline}"
    # A limit on a difference has a sign and a direction.
    is_increase = criterion.limit > 0.0
    extent = "at most" if is_increase != criterion.at_least else "at least"
    return f"{extent} {size} {'more' if is_increase else 'less'} than in {criterion.baseline}"


def value(evaluation: CriterionEvaluation) -> str:
    """Return the measured value; for a comparison, also the baseline's value."""
    if evaluation.word is not None:
        return evaluation.word
    if evaluation.value is None:
        return "missing"
    if evaluation.baseline_value is None:
        return amount(evaluation.value, evaluation.dimension)
    difference = amount(abs(evaluation.value), evaluation.dimension)
    relation = (
        "same as" if evaluation.value == 0.0 else f"{difference} {'more' if evaluation.value > 0.0 else 'less'} than"
    )
    baseline = amount(evaluation.baseline_value, evaluation.dimension)
    measured = amount(evaluation.value + evaluation.baseline_value, evaluation.dimension)
    return f"{measured}, {relation} the {baseline} in {evaluation.criterion.baseline}"


def bounds(evaluation: CriterionEvaluation) -> str | None:
    """Return the bounds that the rule used, None if it used none."""
    lower, upper = evaluation.decision.lower_bound, evaluation.decision.upper_bound
    if evaluation.criterion.rule == "simple" or evaluation.is_by_share or (lower is None and upper is None):
        return None
    suffix = "" if evaluation.baseline_value is None else " for the difference"
    interval = f"{amount(lower, evaluation.dimension)} to {amount(upper, evaluation.dimension)}"
    return f"({interval}{suffix}, each bound at {100 * evaluation.criterion.confidence:g} % confidence)"


def probability(evaluation: CriterionEvaluation) -> str | None:
    """Return the conformity probability in percent, between ``< 0.1 %`` and ``> 99.9 %``."""
    conformity = evaluation.decision.probability
    if conformity is None:
        return None
    percent = 100.0 * conformity
    return "> 99.9 %" if percent > 99.9 else "< 0.1 %" if percent < 0.1 else f"{percent:.1f} %"


def poses_needed(evaluation: CriterionEvaluation) -> str | None:
    """Return the number of poses or visits that would decide an inconclusive criterion, None where unknown."""
    if evaluation.outcome != "inconclusive":
        return None
    needed, needed_if_true = evaluation.decision.poses_to_decide, evaluation.decision.poses_if_true
    if needed is None:
        # The distance to the limit is unknown without bounds or without a number of poses.
        too_close = needed_if_true is None and evaluation.decision.why is None and evaluation.n is not None
        return "the value is too close to the limit for any number of poses to decide" if too_close else None
    # ISO 9283 results count visits of a few commanded poses.
    counted = "visits" if evaluation.criterion.key.startswith("iso9283.") else "poses"
    text = f"{needed} {counted} in total would decide it with a probability of {100 * ASSURANCE:.0f} %"
    if needed_if_true is None or needed_if_true == needed:
        return text
    return f"{text}, {needed_if_true} if the measured value is the true one"


def sentence(evaluation: CriterionEvaluation) -> str:
    """Return one line with the value, bounds, limit, margin and reasons of a criterion, without its outcome."""
    statement = " ".join(text for text in (evaluation.criterion.key, value(evaluation), bounds(evaluation)) if text)
    parts = [f"{statement}, expected {limit(evaluation)}"]
    if evaluation.decision.margin is not None:
        parts.append(f"margin {amount(evaluation.decision.margin, evaluation.dimension)}")
    if (chance := probability(evaluation)) is not None:
        parts.append(f"conforms with probability {chance}")
    return "; ".join([*parts, *explanations(evaluation)])


def explanations(evaluation: CriterionEvaluation) -> list[str]:
    """Return the reason for the decision and the number of poses that would decide, as far as known."""
    why = None if evaluation.decision.why is None else as_options(evaluation.decision.why)
    return [text for text in (why, poses_needed(evaluation)) if text]
