"""A result held against a gate: an outcome for each criterion, and one for all of them together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from robacc.gates.comparing import compared
from robacc.gates.criteria import Gate, GateCriterion
from robacc.gates.decision_rules import Decision, Outcome, decide
from robacc.gates.keys import KEYS
from robacc.gates.largest import decide_largest
from robacc.gates.lookup import GateFigure, Missing, figure, found_at, word

COVERAGE_FACTOR = 2.0
"""Of the instrument's expanded uncertainty (JCGM 100, 6.2)."""
MOST_OF_TOLERANCE = 0.25
"""Share of the limit that the instrument's expanded uncertainty may take before a warning says so: four to one, as
ANSI/NCSL Z540.3 and the practice of ISO 14253-2 ask."""
_EXIT_STATUS: dict[Outcome, int] = {"pass": 0, "fail": 4, "inconclusive": 5, "not_evaluated": 5}
_WORST: tuple[Outcome, ...] = ("fail", "not_evaluated", "inconclusive", "pass")


@dataclass(frozen=True, slots=True)
class Judged:
    """One criterion and what became of it."""

    criterion: GateCriterion
    decision: Decision
    dimension: str
    """length (m), angle (rad), number, grade or word: of the value and all that is of its kind."""
    value: float | None
    found: str | None
    """The word or grade found, where the criterion is of one."""
    baseline_value: float | None
    n: int | None
    """Poses that the value is of, repetitions of one counted as one."""
    instrument_ratio: float | None
    """The instrument's expanded uncertainty over the limit."""
    warnings: tuple[str, ...]
    is_by_share: bool = False
    """Whether a largest error was judged by the share of all poses within the limit."""

    @property
    def outcome(self) -> Outcome:
        """Of the criterion."""
        return self.decision.outcome


@dataclass(frozen=True, slots=True)
class GateOutcome:
    """What a gate says of a result."""

    gate: Gate
    judged: tuple[Judged, ...]

    @property
    def outcome(self) -> Outcome:
        """Fail where one criterion fails; pass where all of them do."""
        return min((one.outcome for one in self.judged), key=_WORST.index)

    @property
    def exit_status(self) -> int:
        """Of the command: 0 pass, 4 fail, 5 undecided."""
        return _EXIT_STATUS[self.outcome]

    @property
    def warnings(self) -> tuple[str, ...]:
        """Of every criterion, each once."""
        return tuple(dict.fromkeys(text for one in self.judged for text in one.warnings))

    def count(self, outcome: Outcome) -> int:
        """Criteria with that outcome."""
        return sum(one.outcome == outcome for one in self.judged)


def judge(gate: Gate, document: Mapping[str, Any], baselines: Mapping[str, Mapping[str, Any]]) -> GateOutcome:
    """Hold a result against a gate.

    Args:
        gate: The criteria.
        document: The result, as its JSON document.
        baselines: The documents of ``gate.baselines``, by their paths in the gate.
    """
    return GateOutcome(gate, tuple(_judged(one, document, baselines) for one in gate.criteria))


def _judged(
    criterion: GateCriterion, document: Mapping[str, Any], baselines: Mapping[str, Mapping[str, Any]]
) -> Judged:
    if criterion.kind == "word":
        return _word(criterion, document)
    if criterion.kind == "grade":
        return _grade(criterion, document)
    baseline = None
    if criterion.baseline is None:
        found = figure(document, criterion.key, criterion.confidence)
    else:
        both = compared(document, baselines[criterion.baseline], criterion)
        found = both if isinstance(both, Missing) else both[0]
        baseline = None if isinstance(both, Missing) else both[1].value
    if isinstance(found, Missing):
        return _missing(criterion, found.why)
    if criterion.limit != 0.0 and found.dimension != criterion.kind:
        why = f"the limit is of the kind {criterion.kind}, the result's {criterion.key} of the kind {found.dimension}"
        return _missing(criterion, why)
    by_share = _is_by_share(criterion, found)
    decision = _decided(criterion, found)
    ratio = None if criterion.baseline is not None else _instrument_ratio(criterion, document)
    return Judged(
        criterion,
        decision,
        found.dimension,
        found.value,
        None,
        baseline,
        found.n,
        ratio,
        _warnings(criterion, ratio),
        by_share,
    )


def _missing(criterion: GateCriterion, why: str) -> Judged:
    return Judged(criterion, Decision("not_evaluated", why), criterion.kind, None, None, None, None, None, ())


def _is_by_share(criterion: GateCriterion, found: GateFigure) -> bool:
    if found.curve is not None and found.curve.bounds:
        return False
    # The largest of an ISO 9283 criterion is over its few commanded poses, which are all that it is of.
    largest = found.statistic == "max" and found.n is not None and criterion.baseline is None
    largest = largest and criterion.key in KEYS
    return largest and criterion.rule != "simple" and not criterion.at_least


def _decided(criterion: GateCriterion, found: GateFigure) -> Decision:
    if found.n is not None and _is_by_share(criterion, found):
        return decide_largest(criterion, found.value, found.n)
    return decide(criterion, found.value, found.curve, found.n)


def _word(criterion: GateCriterion, document: Mapping[str, Any]) -> Judged:
    found = word(document, criterion.key)
    if isinstance(found, Missing):
        return _missing(criterion, found.why)
    warnings: tuple[str, ...] = ()
    decision = Decision("pass" if found in criterion.words else "fail")
    if criterion.key == "verdict" and decision.outcome == "pass":
        decision, warnings = _verdict(decision, document)
    return Judged(criterion, decision, "word", None, found, None, None, None, warnings)


def _verdict(decision: Decision, document: Mapping[str, Any]) -> tuple[Decision, tuple[str, ...]]:
    """What a welcome verdict of a trace is worth: nothing where no pose was held out to judge on."""
    after, noise = document.get("after"), document.get("noise")
    if isinstance(after, Mapping) and after.get("held_out") is None:
        return Decision("inconclusive", "no poses were held out, so nothing shows what the verdict is worth"), ()
    if isinstance(noise, Mapping) and noise.get("source") == "residual":
        return decision, (
            "verdict: the measuring noise is not known (no sigma columns, no repeats), so it says that no structure is "
            "left, not how large the rest is; add a limit on after.held_out.position.p95",
        )
    return decision, ()


def _grade(criterion: GateCriterion, document: Mapping[str, Any]) -> Judged:
    """A grade is met where position and orientation both meet its limits; each at the scale's own confidence.

    Each bound is within its limit at the full confidence, so both are together (an intersection-union test, R. L.
    Berger, Technometrics 24, 1982); the probability is the smaller of the two.
    """
    found = found_at(document, "grade")
    if isinstance(found, Missing):
        return _missing(criterion, found.why)
    grade, wanted = found[0], criterion.words[0]
    steps: Sequence[Mapping[str, Any]] = grade.get("steps") or ()
    names = [str(step.get("grade")) for step in steps]
    if not names:
        return _missing(criterion, "the result's grade comes without its scale's steps")
    if wanted not in names:
        return _missing(criterion, f"the scale {grade.get('scale')} has no grade {wanted}; it has {', '.join(names)}")
    step, statistic = steps[names.index(wanted)], grade.get("statistic")
    parts: list[tuple[Decision, int | None]] = []
    confidence = grade.get("confidence")
    for quantity, unit in (("position", "m"), ("orientation", "rad")):
        limit = step.get(f"{quantity}_{unit}")
        if limit is None or not document.get(quantity):
            continue
        own = replace(
            criterion,
            key=f"{quantity}.{statistic}",
            limit=limit,
            confidence=criterion.confidence if confidence is None else confidence,
        )
        value = figure(document, own.key, own.confidence)
        if isinstance(value, Missing):
            return _missing(criterion, value.why)
        parts.append((_decided(own, value), value.n))
    decision = _joined([one for one, _ in parts])
    if decision.outcome == "fail" and isinstance(grade.get("reason"), str):
        decision = replace(decision, why=grade["reason"].partition(". ")[0])
    n = next((number for _, number in parts), None)
    return Judged(criterion, decision, "grade", None, str(grade.get("grade")), None, n, None, ())


def _joined(parts: Sequence[Decision]) -> Decision:
    """All of several decisions together."""
    outcome: Outcome = min((one.outcome for one in parts), key=_WORST.index, default="pass")
    whys = dict.fromkeys(one.why for one in parts if one.outcome == outcome and one.why)
    known = [one.probability for one in parts]
    probabilities = [one for one in known if one is not None]
    undecided = [one for one in parts if one.outcome == "inconclusive"] if outcome == "inconclusive" else []

    def most(numbers: Sequence[int | None]) -> int | None:
        found = [number for number in numbers if number is not None]
        return max(found) if found and len(found) == len(numbers) else None

    return Decision(
        outcome,
        "; ".join(whys) or None,
        probability=min(probabilities) if probabilities and len(probabilities) == len(known) else None,
        method=next((one.method for one in parts if one.method), None),
        poses_to_decide=most([one.poses_to_decide for one in undecided]),
        poses_if_true=most([one.poses_if_true for one in undecided]),
    )


def _instrument_ratio(criterion: GateCriterion, document: Mapping[str, Any]) -> float | None:
    """Expanded measuring uncertainty along an axis over the limit, where the result knows of one."""
    noise = document.get("noise")
    if not isinstance(noise, Mapping) or noise.get("source") == "residual" or criterion.kind not in ("length", "angle"):
        return None
    one = noise.get("position_m" if criterion.kind == "length" else "orientation_rad")
    if not isinstance(one, float) or not criterion.limit or not math.isfinite(one):
        return None
    return COVERAGE_FACTOR * one / abs(criterion.limit)


def _warnings(criterion: GateCriterion, ratio: float | None) -> tuple[str, ...]:
    warnings = []
    if ratio is not None and ratio > MOST_OF_TOLERANCE:
        warnings.append(
            f"{criterion.name}: the instrument's expanded uncertainty (k = 2) is {100 * ratio:.0f} % of the limit, "
            f"more than the {100 * MOST_OF_TOLERANCE:.0f} % of good practice"
        )
    if ".fitted." in criterion.key and not criterion.key.startswith("nominal."):
        held = criterion.key.replace(".fitted.", ".held_out.")
        warnings.append(
            f"{criterion.name}: {criterion.key} is of the poses that were fitted, which flatters; judge by {held}"
        )
    return tuple(warnings)
