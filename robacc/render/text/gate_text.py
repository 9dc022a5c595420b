"""What a gate says of a criterion, in words: the same ones in a table, a job summary, an annotation and JUnit."""

from __future__ import annotations

import math

from robacc.gates.decision_rules import ASSURANCE, Outcome
from robacc.gates.evaluate import GateOutcome, Judged
from robacc.render.text.numbers import three_digits

WORDS: dict[Outcome, str] = {
    "pass": "pass",
    "fail": "fail",
    "inconclusive": "inconclusive",
    "not_evaluated": "not evaluated",
}
_SCALES = {"length": (1e3, " mm"), "angle": (180.0 / math.pi, "°")}


def amount(value: float | None, dimension: str) -> str:
    """In mm, degrees or as a bare number, three digits; a dash where there is none."""
    if value is None:
        return "–"
    factor, unit = _SCALES.get(dimension, (1.0, ""))
    return f"{three_digits(factor * value)}{unit}"


def title(found: GateOutcome) -> str:
    """The gate's name and outcome, and how many criteria came out how."""
    counts = [f"{found.count(outcome)} {word}" for outcome, word in WORDS.items() if found.count(outcome)]
    return f"Gate {found.gate.name}: {WORDS[found.outcome].upper()} ({', '.join(counts)})"


def limit(one: Judged) -> str:
    """The limit, with the way it is meant."""
    asked = one.criterion
    if asked.kind == "grade":
        return f"{asked.words[0]} or better"
    if asked.kind == "word":
        return " or ".join(asked.words)
    factor, unit = _SCALES.get(asked.kind, (1.0, ""))
    size = f"{factor * abs(asked.limit or 0.0):.6g}{unit}"
    if asked.baseline is None:
        return f"at least {size}" if asked.at_least else f"at most {size}"
    if not asked.limit:
        return f"no {'less' if asked.at_least else 'more'} than in {asked.baseline}"
    # A difference may be asked to be small or to be large, in either direction.
    more = asked.limit > 0.0
    extent = "at most" if more != asked.at_least else "at least"
    return f"{extent} {size} {'more' if more else 'less'} than in {asked.baseline}"


def value(one: Judged) -> str:
    """The value found; of a comparison, the result's own and the baseline's."""
    if one.found is not None:
        return one.found
    if one.value is None:
        return "not there"
    if one.baseline_value is None:
        return amount(one.value, one.dimension)
    difference = amount(abs(one.value), one.dimension)
    words = "as" if one.value == 0.0 else f"{difference} {'more' if one.value > 0.0 else 'less'} than"
    there = amount(one.baseline_value, one.dimension)
    return f"{amount(one.value + one.baseline_value, one.dimension)}, {words} the {there} in {one.criterion.baseline}"


def bounds(one: Judged) -> str | None:
    """The bounds that the rule looked at; None where it looked at none."""
    lower, upper = one.decision.lower_bound, one.decision.upper_bound
    if one.criterion.rule == "simple" or one.is_by_share or (lower is None and upper is None):
        return None
    of = "" if one.baseline_value is None else " for the difference"
    both = f"{amount(lower, one.dimension)} to {amount(upper, one.dimension)}"
    return f"({both}{of}, each bound at {100 * one.criterion.confidence:g} %)"


def probability(one: Judged) -> str | None:
    """The conformity probability; never as a certainty."""
    found = one.decision.probability
    if found is None:
        return None
    percent = 100.0 * found
    return "> 99.9 %" if percent > 99.9 else "< 0.1 %" if percent < 0.1 else f"{percent:.1f} %"


def poses_needed(one: Judged) -> str | None:
    """How many poses, or visits of them, would decide what is inconclusive, where that can be told."""
    if one.outcome != "inconclusive":
        return None
    sure, plain = one.decision.poses_to_decide, one.decision.poses_if_true
    if sure is None:
        # Without bounds, or with no number of poses to reckon from, nothing is known of how close the value lies.
        close = plain is None and one.decision.why is None and one.n is not None
        return "the value lies so close to the limit that no number of poses will decide" if close else None
    # A result by ISO 9283 counts every visit of its few commanded poses.
    counted = "visits" if one.criterion.key.startswith("iso9283.") else "poses"
    text = f"{sure} {counted} in all would decide it with a probability of {100 * ASSURANCE:.0f} %"
    return text if plain is None or plain == sure else f"{text}, {plain} if the value found is the true one"


def sentence(one: Judged) -> str:
    """Everything about a criterion in one line, its outcome left out."""
    found = " ".join(text for text in (one.criterion.key, value(one), bounds(one)) if text)
    parts = [f"{found}, expected {limit(one)}"]
    if one.decision.margin is not None:
        parts.append(f"margin {amount(one.decision.margin, one.dimension)}")
    if (chance := probability(one)) is not None:
        parts.append(f"conforms with probability {chance}")
    parts += [text for text in (one.decision.why, poses_needed(one)) if text]
    return "; ".join(parts)
