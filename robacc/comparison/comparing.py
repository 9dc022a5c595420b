"""Results side by side: differences, a ranking, grades, and warnings where they were made differently."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cache, partial
from itertools import combinations
from typing import Any, Literal

import numpy as np

from robacc.accuracy.error_statistics import Unit, error_statistics
from robacc.accuracy.grade import Quantity, Scale, default_scale, grade
from robacc.comparison.stored_results import (
    FITS,
    NO_TEST_OF_MAXIMUM,
    RESAMPLED,
    VECTORIAL,
    ComparedResult,
    Difference,
    ErrorSet,
    difference,
    from_intervals,
    pair_poses,
    split_key,
    unit_of,
)
from robacc.errors import UsageError, refuse
from robacc.statistics.intervals import EstimatedValue, Interval

# Tests of every pair of results, corrected for their number, and groups of results that do not differ.
#
# Sources: S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6
# (1979) 65-70; H.-P. Piepho, "An algorithm for a letter-based representation of all-pairwise comparisons", Journal of
# Computational and Graphical Statistics 13 (2004) 456-466 (insert and absorb).


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Return p-values corrected for their number, which bounds the probability of any false difference.

    None stands for a pair without a test, stays None and does not count.
    """
    tested = sorted((p, i) for i, p in enumerate(p_values) if p is not None)
    raised = np.maximum.accumulate([min(1.0, (len(tested) - rank) * p) for rank, (p, _) in enumerate(tested)])
    corrected = {i: p for (_, i), p in zip(tested, raised.tolist(), strict=True)}
    return [corrected.get(i) for i in range(len(p_values))]


def indistinguishable_groups(count: int, different: Set[tuple[int, int]]) -> list[tuple[int, ...]]:
    """Return the largest groups of ``count`` members without a pair of ``different`` (first index below the second).

    Members with a common group do not differ; members without a common group do. The group of the first member comes
    first.
    """
    groups: list[frozenset[int]] = [frozenset(range(count))]
    for first, second in sorted(different):
        pair = {first, second}
        parts = [group - {member} for group in groups if pair <= group for member in (second, first)]
        split = [*(group for group in groups if not pair <= group), *parts]
        groups = [group for group in dict.fromkeys(split) if not any(group < other for other in split)]
    return sorted(tuple(sorted(group)) for group in groups)


def group_letters(count: int, groups: Sequence[tuple[int, ...]]) -> list[str]:
    """Return the letters of each member: a for the first group, b for the second …; past z, a1, b1 …."""
    names = [chr(ord("a") + i % 26) + (str(i // 26) if i >= 26 else "") for i in range(len(groups))]
    return ["".join(name for name, group in zip(names, groups, strict=True) if i in group) for i in range(count)]


# Status of several results against a required grade: confirmed, met but not confirmed, or not met.

Verdict = Literal["demonstrated", "met_not_demonstrated", "not_met"]
"""Verdicts as results store them."""
_UNITS: dict[Quantity, Unit] = {"position": "m", "orientation": "rad"}


@dataclass(frozen=True, slots=True)
class GradeStatus:
    """Status of one result against the required grade."""

    name: str
    verdict: Verdict
    grade: str
    """The result's own grade on the scale."""
    probability: float | None
    """Probability that the limits of the required grade are truly met, given the data."""
    position: EstimatedValue
    """Statistic of the scale, m, with its interval at the scale's confidence."""
    orientation: EstimatedValue | None
    """rad"""
    poses_to_demonstrate: int | None
    """Total number of poses that confirms the required grade with probability 0.9 if the estimate stays the same."""
    why: str | None
    """Reason why the grade is not confirmed, or why the probability is unknown."""


def common_scale(results: Sequence[ComparedResult]) -> Scale:
    """Return the grade scale of the results.

    Raises:
        UsageError: The results have different scales, or a scale that no result stores completely.
    """
    names = sorted({result.scale_name for result in results if result.scale_name is not None})
    scales = {result.scale for result in results if result.scale is not None}
    conflict = " and ".join(names) if len(names) > 1 else f"different scales with the name {''.join(names)}"
    refuse((max(len(names), len(scales)) > 1, f"the results were graded on {conflict}; choose the scale with `scale`"))
    scale = scales.pop() if scales else default_scale()
    refuse(
        ({*names} - {scale.name}, f"no result stores the complete scale {''.join(names)}; give its file with `scale`")
    )
    return scale


def grade_statuses(
    results: Sequence[ComparedResult], scale: Scale, required_grade: str, seed: int = 0
) -> tuple[GradeStatus, ...]:
    """Return the status of every result, in the order of the results.

    Args:
        results: The results.
        scale: Grade scale to apply.
        required_grade: A step of the scale.
        seed: Seed of the bootstrap.

    Raises:
        UsageError: The scale has no such step, or a result has no position errors to grade.
    """
    names = [step.grade for step in scale.steps]
    unknown = f"`grade`: the scale {scale.name} has no grade {required_grade!r}; it has {', '.join(names)}"
    refuse((required_grade not in names, unknown))
    return tuple(
        _status_by_errors(result, scale, names.index(required_grade), seed)
        if "position" in result.errors
        else _status_by_figures(result, scale, names.index(required_grade))
        for result in results
    )


def _status_by_errors(result: ComparedResult, scale: Scale, rank: int, seed: int) -> GradeStatus:
    of = partial(error_statistics, confidence=scale.confidence, seed=seed)
    graded = [
        of(errors.vectors, unit, groups=errors.groups, share=errors.share)
        for quantity, unit in _UNITS.items()
        if (errors := result.errors.get(quantity)) is not None
    ]
    assessed = grade(graded[0], graded[1] if len(graded) > 1 else None, scale)
    confirmed, met = assessed.confirmed_rank <= rank, assessed.rank <= rank
    missing = [f"no upper bound of {name}: {own.why}" for name, own in assessed.quantities.items() if own.why]
    why = "; ".join(missing) or f"the upper {100 * scale.confidence:g} % bound is beyond the limit"
    figures = [EstimatedValue(own.value, own.interval) for own in assessed.quantities.values()]
    return GradeStatus(
        result.name,
        "demonstrated" if confirmed else "met_not_demonstrated" if met else "not_met",
        assessed.grade,
        assessed.probability_within(rank),
        figures[0],
        figures[1] if len(figures) > 1 else None,
        assessed.poses_needed(rank) if met and not confirmed else None,
        None if confirmed or not met else why,
    )


def _status_by_figures(result: ComparedResult, scale: Scale, rank: int) -> GradeStatus:
    """Return the status by the figures alone, for a prediction or a result without errors; they confirm nothing."""
    statistic = "max_radius95" if scale.statistic == "max" and not result.measured else scale.statistic
    known = {quantity: result.figures.get(f"{quantity}.{statistic}") for quantity in _UNITS}
    if (position := known["position"]) is None:
        raise UsageError(f"{result.name} is a result of {result.command}, which has no {statistic} error to grade")
    own_rank = max(scale.rank_of(name, figure.value) for name, figure in known.items() if figure is not None)
    measured = "the result does not list the error of every pose"
    why = measured if result.measured else "predicted from tolerances, not measured"
    verdict: Verdict = "met_not_demonstrated" if own_rank <= rank else "not_met"
    return GradeStatus(result.name, verdict, scale.name_of(own_rank), None, position, known["orientation"], None, why)


# Warnings of a comparison, where results were made differently, and notes on what its figures do not say.

_CONSEQUENCES = {
    "frame": "lengths are compared; components are not, because their axes differ",
    "alignment": "a registration removes a part of the error that the other result still contains",
    "held out": "errors of calibration poses are smaller than errors of held-out poses",
    "robot file": "errors of the poses that it was fitted to are smaller than errors of other poses",
    "confidence": "the intervals are not comparable",
}


def _warnings(results: Sequence[ComparedResult], pairing: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield a line for each aspect in which the results were made differently, and for poses that differ."""
    for aspect in dict.fromkeys(aspect for result in results for aspect in result.provenance):
        made = {result.name: result.provenance[aspect] for result in results if aspect in result.provenance}
        values = [*dict.fromkeys(made.values())]
        if len(values) > 1:
            listed = "; ".join(f"{', '.join(n for n in made if made[n] == value)}: {value}" for value in values)
            consequence = _CONSEQUENCES.get(aspect)
            yield f"made differently, {aspect}: {listed}" + (f" ({consequence})" if consequence else "")
    with_errors = {result.name for result in results if "position" in result.errors}
    for match in pairing:
        names, most = f"{match['first']} and {match['second']}", max(match["n_first"], match["n_second"])
        text = f"{names} have different poses, so their difference cannot be paired"
        if match["paired"]:
            text = f"{names} share {match['n_shared']} of {most} poses; only these are compared"
        if with_errors >= {match["first"], match["second"]} and match["n_shared"] != most:
            yield f"made differently, poses: {text}"


def _notes(
    results: Sequence[ComparedResult], tested: bool, statuses: Sequence[GradeStatus], scale: Scale | None
) -> tuple[str, ...]:
    """Return the limitations of the comparison; ``tested`` is true if any difference has a p-value."""
    level = 0.0 if scale is None else 100 * scale.confidence
    notes = (
        (
            tested,
            "each difference is tested by itself; the ranking's p-values are corrected for the number of pairs (Holm)",
        ),
        (tested, "the tests apply to other poses of the same robots, not to other robots"),
        (
            any(result.command in FITS for result in results),
            "position and orientation of calibrate and trace are those after the fit, on held-out poses",
        ),
        (
            sum(status.verdict == "demonstrated" for status in statuses) > 1,
            f"each grade by itself is confirmed at {level:g} % confidence, not all together",
        ),
    )
    return tuple(note for applies, note in notes if applies)


RANKED_BY = "position.rms"
_SIGNED = frozenset(f"mean_{axis}" for axis in "xyz")
"""Statistics with a sign, which no ranking orders."""
_NO_TEST_OF_PREDICTION = "a prediction describes robots yet to be built, so it has no sampling error to test with"


@dataclass(frozen=True, slots=True)
class ComparedRow:
    """One figure of every result, and its differences to the baseline."""

    key: str
    unit: str
    figures: tuple[EstimatedValue, ...]
    """One figure for each result, in the order of the results."""
    differences: tuple[Difference | None, ...]
    """Differences to the baseline; None for the baseline itself."""


@dataclass(frozen=True, slots=True)
class RankedPair:
    """Two results in the order of the ranking."""

    better: str
    worse: str
    """By the estimates, whether or not the difference is significant."""
    difference: Difference
    """Worse minus better."""
    p_corrected: float | None
    """p-value corrected for the number of pairs (Holm)."""
    different: bool


@dataclass(frozen=True, slots=True)
class Ranking:
    """Results in the order of one figure, the smallest first."""

    key: str
    unit: str
    level: float
    """Corrected p-value below which two results count as different."""
    names: tuple[str, ...]
    values: tuple[float, ...]
    letters: tuple[str, ...]
    """Group letters; results that share a letter do not differ significantly."""
    groups: tuple[tuple[str, ...], ...]
    """Largest groups of results without a significant difference; without any test, no groups and no letters."""
    pairs: tuple[RankedPair, ...]
    predicted: tuple[str, ...]
    """Predictions, which are not ranked with measured results."""

    def sentences(self) -> tuple[str, ...]:
        """Return the ranking as text: neighbours that differ, groups that do not, pairs without a test, predictions."""
        unranked = [f"{name} is a prediction, which is not ranked with measured arms" for name in self.predicted]
        if not self.groups:
            return (*["ordered by the figure; no difference could be tested"] * (len(self.names) > 1), *unranked)
        neighbours = [pair for pair in self.pairs if self.names.index(pair.worse) == self.names.index(pair.better) + 1]
        lines = [f"{pair.better} is better than {pair.worse}" for pair in neighbours if pair.different]
        lines += [
            f"{', '.join(group[:-1])} and {group[-1]} do not differ significantly"
            for group in self.groups
            if len(group) > 1
        ]
        untested = [pair for pair in self.pairs if pair.difference.p_value is None]
        lines += [f"{pair.better} and {pair.worse} could not be tested" for pair in untested]
        return (*lines, *unranked)


@dataclass(frozen=True, slots=True)
class ResultComparison:
    """Return value of :func:`compare`."""

    results: tuple[ComparedResult, ...]
    baseline: str
    confidence: float
    rows: tuple[ComparedRow, ...]
    pairing: tuple[Mapping[str, Any], ...]
    """Match of the poses of every result with those of the baseline, as in the document."""
    ranking: Ranking
    scale: Scale | None
    required_grade: str | None
    grade_statuses: tuple[GradeStatus, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


def compare(
    results: Sequence[ComparedResult],
    *,
    baseline: str | None = None,
    by: str | None = None,
    required_grade: str | None = None,
    scale: Scale | None = None,
    confidence: float = 0.95,
    seed: int = 0,
) -> ResultComparison:
    """Compare results with each other.

    Args:
        results: At least two results with different names.
        baseline: Name of the result that the others are compared with; None is the first.
        by: Key of the figure that ranks the results; None is the RMS position error, or the first shared figure.
        required_grade: A grade to check every result against.
        scale: Grade scale of ``required_grade``; None is the scale of the results.
        confidence: Confidence of the intervals; differences are significant below 1 - confidence.
        seed: Seed of the bootstrap.

    Raises:
        UsageError: A name, key or grade does not exist, or the results share no figure.
    """
    names = [result.name for result in results]
    # Components are comparable only if the frames agree.
    excluded = frozenset() if len({result.frame for result in results}) == 1 else VECTORIAL
    keys = [
        key
        for key in (results[0].figures if results else ())
        if split_key(key)[1] not in excluded and all(key in result.figures for result in results)
    ]
    rankable = [key for key in keys if split_key(key)[1] not in _SIGNED]
    commands = " and ".join(dict.fromkeys(result.command for result in results))
    refuse(
        (len(names) < 2, "a comparison needs at least two results"),
        (
            not 0.5 <= confidence < 1.0,
            f"`confidence`: expected a probability of at least 0.5 and below 1, found {confidence:g}",
        ),
        (
            baseline is not None and baseline not in names,
            f"`baseline`: no result is named {baseline!r}; choose from {', '.join(names)}",
        ),
        (not keys, f"results of {commands} have no figure in common to compare"),
        (
            by is not None and by not in rankable,
            f"`by`: the results have no common figure {by!r}; choose from {', '.join(rankable)}",
        ),
    )
    reference = names.index(baseline) if baseline is not None else 0

    @cache
    def pairing(group: str, first: int, second: int) -> tuple[ErrorSet, ErrorSet] | None:
        return pair_poses(results[first].errors[group], results[second].errors[group])

    def change(key: str, first: int, second: int) -> Difference:
        """Return the figure of the second result minus the figure of the first."""
        group, statistic = split_key(key)
        figures = results[first].figures[key], results[second].figures[key]
        if results[first].digest == results[second].digest:
            return Difference.same(0.0, confidence, "the same result twice", True, None)
        why = None if results[first].measured and results[second].measured else _NO_TEST_OF_PREDICTION
        if statistic in ("max", "max_radius95") and not group.startswith("iso9283."):
            why = NO_TEST_OF_MAXIMUM
        if why is not None:
            return Difference(figures[1].value - figures[0].value, Interval.missing(confidence, why))
        if statistic in RESAMPLED and group in results[first].errors and group in results[second].errors:
            pair = pairing(group, first, second)
            sets = pair or (results[first].errors[group], results[second].errors[group])
            return difference(statistic, *sets, paired=pair is not None, confidence=confidence, seed=seed)
        return from_intervals(*figures, confidence)

    def match(first: int, second: int) -> Mapping[str, Any]:
        both, shared = {"first": results[first], "second": results[second]}, 0
        are_listed = all("position" in result.errors for result in both.values())
        if are_listed:
            pair = pairing("position", first, second)
            shared = 0 if pair is None else pair[0].n_groups
        return {
            **{place: result.name for place, result in both.items()},
            **{"paired": shared > 0, "n_shared": shared},
            **{f"n_{p}": r.errors["position"].n_groups if are_listed else r.n_poses for p, r in both.items()},
        }

    rows = tuple(
        ComparedRow(
            key,
            unit_of(key),
            tuple(result.figures[key] for result in results),
            tuple(None if i == reference else change(key, reference, i) for i in range(len(results))),
        )
        for key in keys
    )
    matches = tuple(match(reference, i) for i in range(len(results)) if i != reference)
    ranked_by = by or (RANKED_BY if RANKED_BY in rankable else rankable[0])
    grade_scale = None if required_grade is None else scale or common_scale(results)
    statuses: tuple[GradeStatus, ...] = ()
    if grade_scale is not None and required_grade is not None:
        statuses = grade_statuses(results, grade_scale, required_grade, seed)
    tested = any(item is not None and item.p_value is not None for row in rows for item in row.differences)
    return ResultComparison(
        results=tuple(results),
        baseline=names[reference],
        confidence=confidence,
        rows=rows,
        pairing=matches,
        ranking=_ranking(results, ranked_by, confidence, partial(change, ranked_by)),
        scale=grade_scale,
        required_grade=required_grade,
        grade_statuses=statuses,
        notes=_notes(results, tested, statuses, grade_scale),
        warnings=tuple(_warnings(results, matches)),
    )


def _ranking(
    results: Sequence[ComparedResult], key: str, confidence: float, change: Callable[[int, int], Difference]
) -> Ranking:
    """Return the order of the results by a figure; ``change`` gives its difference between two of them."""
    ranked = [i for i, result in enumerate(results) if result.measured] or range(len(results))
    order = sorted(ranked, key=lambda i: (abs(results[i].figures[key].value), i))
    pairs = [(i, j, change(order[i], order[j])) for i, j in combinations(range(len(order)), 2)]
    level = 1.0 - confidence
    corrected = holm([pair_difference.p_value for _, _, pair_difference in pairs])
    different = {(i, j) for (i, j, _), p in zip(pairs, corrected, strict=True) if p is not None and p < level}
    names = [results[i].name for i in order]
    groups = indistinguishable_groups(len(order), different) if any(p is not None for p in corrected) else []
    return Ranking(
        key=key,
        unit=unit_of(key),
        level=level,
        names=tuple(names),
        values=tuple(results[i].figures[key].value for i in order),
        letters=tuple(group_letters(len(order), groups)),
        groups=tuple(tuple(names[i] for i in group) for group in groups),
        pairs=tuple(
            RankedPair(names[i], names[j], pair_difference, p, (i, j) in different)
            for (i, j, pair_difference), p in zip(pairs, corrected, strict=True)
        ),
        predicted=tuple(result.name for i, result in enumerate(results) if i not in ranked),
    )
