"""Evaluation of a gate on a result and its baselines: an outcome for each criterion, and for all together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.error_statistics import length_intervals
from robacc.gates.decision_rules import LEVELS, BoundCurve, Decision, Outcome, decide, decide_largest, difference_curve
from robacc.gates.gate_file import KEYS, Gate, GateCriterion
from robacc.geometry import Array
from robacc.statistics.intervals import Interval
from robacc.statistics.records import Statistic, paired_difference

# Values of a result by their short key: the value, its unit, and the bounds that the result or its poses give.

MOST_POSES = 20_000
"""With more poses, the stored interval is as good as a recomputed one and costs nothing."""
_UNITS = ("m", "rad")
_DIMENSIONS = {"m": "length", "rad": "angle"}


@dataclass(frozen=True, slots=True)
class GateSample:
    """Errors of every pose behind a figure."""

    errors: Array
    """``(3, N)`` m or rad"""
    groups: NDArray[np.int64]
    """``(N,)`` number of each row's commanded pose."""
    rows: NDArray[np.int64]
    """``(N,)`` index of each row in the file, from 0."""
    commanded: Array | None
    """``(3, N)`` commanded position of the target, m."""
    file: str | None
    """SHA-256 of the file of poses."""


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
    statistic: str
    """Last part of the key."""


@dataclass(frozen=True, slots=True)
class Missing:
    """Reason why a result has no value for a key."""

    why: str


def value_at(document: Mapping[str, Any], key: str) -> tuple[Any, Mapping[str, Any], str] | Missing:
    """Return the value of a short key, the object that holds it, and its full name in that object."""
    node: Any = document
    path: list[str] = []
    holder, name = document, ""
    for part in key.split("."):
        if not isinstance(node, Mapping):
            return Missing(f"the result has no keys within {'.'.join(path)}")
        names = (part, *(f"{part}_{unit}" for unit in _UNITS))
        full_name = next((candidate for candidate in names if candidate in node), None)
        path.append(part)
        if full_name is None:
            return Missing(f"a result of robacc {document.get('command', '?')} has no {'.'.join(path)}")
        holder, name, node = node, full_name, node[full_name]
        if node is None:
            why = holder.get("why")
            return Missing(f"the result has no {'.'.join(path)}" + (f": {why}" if isinstance(why, str) else ""))
    return node, holder, name


def word_at(document: Mapping[str, Any], key: str) -> str | Missing:
    """Return the word of a key; a boolean gives ``true`` or ``false``."""
    match = value_at(document, key)
    if isinstance(match, Missing):
        return match
    value = match[0]
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    return value if isinstance(value, str) else Missing(f"the result's {key} is not a word")


def figure_at(document: Mapping[str, Any], key: str, confidence: float) -> GateFigure | Missing:
    """Return the number of a key, with its curve; ``confidence`` is the level that a recomputed curve includes."""
    match = value_at(document, key)
    if isinstance(match, Missing):
        return match
    value, holder, name = match
    stored: Any = _stored_interval(holder, name)
    if isinstance(value, Mapping):
        if "value" not in value:
            return Missing(f"the result's {key} is not a number")
        stored, value = value, value["value"]
    number = _number(value)
    if number is None:
        return Missing(f"the result's {key} is not a number")
    dimension = _DIMENSIONS.get(name.rpartition("_")[2], "number")
    statistic = key.rpartition(".")[2]
    n = _n_poses(document, holder)
    curve = None if stored is None else _stored_curve(_interval(stored), number, statistic)
    sample = sample_at(document, key)
    if sample is not None and statistic in ("rms", "mean_error", "p95") and sample.rows.size <= MOST_POSES:
        levels = sorted({*LEVELS, confidence, max(2.0 * confidence - 1.0, 0.01)})
        n = int(np.unique(sample.groups).size)
        share = (_number(holder.get("independent_poses")) or n) / n
        seed = document.get("seed") or 0
        statistics = length_intervals(sample.errors, levels, groups=sample.groups, share=share, seed=seed)
        intervals = [by_name[cast("Statistic", statistic)] for by_name in statistics]
        curve = BoundCurve.through(intervals)
    return GateFigure(number, dimension, curve, n, statistic)


def sample_at(document: Mapping[str, Any], key: str) -> GateSample | None:
    """Return the errors of the poses behind the statistic of a key; None if the result does not list them."""
    parts = key.split(".")
    unit = {"position": "m", "orientation": "rad"}.get(parts[-2] if len(parts) > 1 else "")
    if unit is None:
        return None
    if len(parts) == 2:
        quantity = document.get(parts[0])
        errors = quantity.get(f"errors_{unit}") if isinstance(quantity, Mapping) else None
        return _sample(errors, document.get("poses"), document)
    kind = parts[1].removesuffix("_inliers")
    if len(parts) != 4 or kind not in ("fitted", "held_out"):
        return None
    holdout = document.get("poses_apart") if kind == "held_out" else None
    poses = document.get("poses") if holdout is None else holdout
    cross_validated = kind == "held_out" and holdout is None and parts[0] != "nominal_unregistered"
    stages = poses.get(f"errors_{unit}") if isinstance(poses, Mapping) else None
    errors = (
        stages.get(f"held_out_{parts[0]}" if cross_validated else parts[0]) if isinstance(stages, Mapping) else None
    )
    source = "poses" if holdout is None else "holdout"
    return _sample(errors, poses, document, source, inliers=parts[1].endswith("_inliers"))


def _sample(
    errors: Any, poses: Any, document: Mapping[str, Any], kind: str = "poses", *, inliers: bool = False
) -> GateSample | None:
    """Return all rows of ``errors``, or those of inliers; None if the document does not say to which poses they belong.

    The metrics of a stage count outliers; those without outliers have keys of their own.
    """
    if errors is None or not isinstance(poses, Mapping) or poses.get("group") is None:
        return None
    rows = np.asarray(errors, dtype=float)
    flags = poses.get("used") if inliers else None
    used = np.ones(len(rows), dtype=bool) if flags is None else np.asarray(flags, dtype=bool)
    groups = np.asarray(poses["group"], dtype=np.int64)
    if rows.ndim != 2 or rows.shape[1] != 3 or used.shape != groups.shape or len(rows) != len(groups) or not used.any():
        return None
    commanded = poses.get("commanded_m")
    digests = [entry["sha256"] for entry in document.get("inputs", ()) if entry.get("kind") == kind]
    return GateSample(
        rows[used].T,
        groups[used],
        np.flatnonzero(used),
        None if commanded is None else np.asarray(commanded, dtype=float)[used].T,
        digests[0] if digests and digests[0] else None,
    )


def _stored_interval(holder: Mapping[str, Any], name: str) -> Mapping[str, Any] | None:
    """Return the interval stored beside a value."""
    intervals = holder.get("intervals")
    for interval in (intervals.get(name) if isinstance(intervals, Mapping) else None, holder.get("interval")):
        if isinstance(interval, Mapping):
            return interval
    return None


def _stored_curve(interval: Interval, value: float, statistic: str) -> BoundCurve:
    """Return the curve through a stored interval, and through the value at level 1/2 if the interval is about it.

    The 95th percentile of a small sample is biased low, so two bounds locate the median better than the value does.
    """
    two_sided = interval.lower is not None and (interval.upper_bound is not None or interval.upper is not None)
    centre = None if two_sided and statistic == "p95" else value
    return BoundCurve.through([interval], centre)


def _interval(stored: Mapping[str, Any]) -> Interval:
    def number(*names: str) -> float | None:
        return next((value for name in names if (value := _number(stored.get(name))) is not None), None)

    why = stored.get("why")
    method = stored.get("method")
    return Interval(
        number("lower", "low"),
        number("upper", "high"),
        number("upper_bound"),
        number("confidence") or 0.95,
        method if isinstance(method, str) else "interval stored in the result",
        why if isinstance(why, str) else None,
    )


def _n_poses(document: Mapping[str, Any], holder: Mapping[str, Any]) -> int | None:
    for node, name in ((holder, "n_commanded_poses"), (holder, "n_poses"), (document, "n_poses")):
        value = _number(node.get(name))
        if value is not None:
            return int(value)
    return None


def _number(value: Any) -> float | None:
    """Return a finite number; None for anything else, booleans included."""
    if isinstance(value, bool | np.bool_ | str | Sequence | Mapping) or value is None or np.ndim(value):
        return None
    return float(value) if math.isfinite(value) else None


# Difference between a figure of a result and the same figure of a baseline: paired where the poses are the same.

_SAME_POSITION = 1e-6
"""m: commanded positions within this distance belong to the same command; robot files have more digits than that."""
_PAIRABLE = ("rms", "mean_error", "p95", "max")


def difference_to_baseline(
    document: Mapping[str, Any], baseline: Mapping[str, Any], criterion: GateCriterion
) -> tuple[GateFigure, GateFigure] | Missing:
    """Return the difference, result minus baseline, and the baseline's figure, or the reason why there is none."""
    figure = figure_at(document, criterion.key, criterion.confidence)
    if isinstance(figure, Missing):
        return figure
    reference = figure_at(baseline, criterion.key, criterion.confidence)
    if isinstance(reference, Missing):
        return Missing(f"in the baseline, {reference.why}")
    if figure.dimension != reference.dimension:
        return Missing(f"{criterion.key} has different units in the result and in the baseline")
    sample, reference_sample = sample_at(document, criterion.key), sample_at(baseline, criterion.key)
    value, curve, n = figure.value - reference.value, None, figure.n
    if sample is not None and reference_sample is not None and figure.statistic in _PAIRABLE:
        pair = _matching_rows(sample, reference_sample, criterion.paired)
        if isinstance(pair, Missing):
            return pair
        if pair is not None:
            seed = document.get("seed")
            value, curve, n = _paired_figure(
                *pair, figure.statistic, criterion.confidence, seed if isinstance(seed, int) else 0
            )
    elif criterion.paired:
        return Missing("paired: true needs the error of every pose, which the result or the baseline does not list")
    if curve is None and figure.curve is not None and reference.curve is not None:
        curve = difference_curve(figure.value, figure.curve, reference.value, reference.curve)
    return GateFigure(value, figure.dimension, curve, n, figure.statistic), reference


def _matching_rows(
    sample: GateSample, reference: GateSample, paired: bool | None
) -> tuple[GateSample, GateSample] | Missing | None:
    """Return the rows in use that the two samples share; None if their poses differ."""
    if paired is False:
        return None
    rows, in_sample, in_reference = np.intersect1d(sample.rows, reference.rows, return_indices=True)
    same_size = sample.rows.size == reference.rows.size
    same_poses = sample.file is not None and sample.file == reference.file
    if not same_poses and sample.commanded is not None and reference.commanded is not None:
        distance = np.abs(sample.commanded[:, in_sample] - reference.commanded[:, in_reference])
        same_poses = same_size and rows.size > 0 and bool(np.all(distance < _SAME_POSITION))
    if paired and not same_poses and not same_size:
        return Missing(
            f"paired: true needs the same poses, but the result has {sample.rows.size} and the baseline has "
            f"{reference.rows.size}"
        )
    if not (same_poses or paired) or rows.size == 0:
        return None
    return _subset(sample, in_sample), _subset(reference, in_reference)


def _subset(sample: GateSample, rows: NDArray[np.intp]) -> GateSample:
    commanded = None if sample.commanded is None else sample.commanded[:, rows]
    return GateSample(sample.errors[:, rows], sample.groups[rows], sample.rows[rows], commanded, sample.file)


def _paired_figure(
    sample: GateSample, reference: GateSample, statistic: str, confidence: float, seed: int
) -> tuple[float, BoundCurve, int]:
    levels = sorted({*LEVELS, confidence, max(2.0 * confidence - 1.0, 0.01)})
    value, intervals = paired_difference(
        sample.errors, reference.errors, cast("Statistic", statistic), levels, groups=sample.groups, seed=seed
    )
    through = BoundCurve.through(intervals)
    curve = BoundCurve(through.z, through.bounds, f"paired, {through.method}", through.why, through.exact)
    return value, curve, int(np.unique(sample.groups).size)


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
