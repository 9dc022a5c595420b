"""Results side by side: shared figures, differences to the baseline, a ranking, grades, notes and warnings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

from robacc.accuracy.grade_scale import Scale
from robacc.comparison.compared_result import ComparedFigure, ComparedResult, split_key
from robacc.comparison.differences import RESAMPLED, VECTORIAL, Difference, difference
from robacc.comparison.from_intervals import from_intervals
from robacc.comparison.grade_status import GradeStatus, common_scale, grade_statuses
from robacc.comparison.pairing import Pairing, PoseMatch, pair_poses
from robacc.comparison.ranking import group_letters, indistinguishable_groups, significant_pairs
from robacc.comparison.warning import notes, provenance_warnings
from robacc.errors import UsageError

RANKED_BY = "position.rms"
_SIGNED = frozenset(f"mean_{axis}" for axis in "xyz")
"""Statistics with a sign, which no ranking orders."""
_NO_TEST_OF_MAXIMUM = "no test exists for the largest of all errors"
_NO_TEST_OF_PREDICTION = "a prediction describes robots yet to be built, so it has no sampling error to test with"


@dataclass(frozen=True, slots=True)
class ComparedRow:
    """One figure of every result, and its differences to the baseline."""

    key: str
    unit: str
    figures: tuple[ComparedFigure, ...]
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

    def sentences(self) -> tuple[str, ...]:
        """Return the ranking as text: neighbours that differ, groups that do not, pairs without a test."""
        if not self.groups:
            return ("ordered by the figure; no difference could be tested",)
        neighbours = [pair for pair in self.pairs if self.names.index(pair.worse) == self.names.index(pair.better) + 1]
        lines = [f"{pair.better} is better than {pair.worse}" for pair in neighbours if pair.different]
        lines += [f"{_listed(group)} do not differ significantly" for group in self.groups if len(group) > 1]
        untested = [pair for pair in self.pairs if pair.difference.p_value is None]
        return (*lines, *(f"{pair.better} and {pair.worse} could not be tested" for pair in untested))


@dataclass(frozen=True, slots=True)
class ResultComparison:
    """Return value of :func:`compare`."""

    results: tuple[ComparedResult, ...]
    baseline: str
    confidence: float
    rows: tuple[ComparedRow, ...]
    pairing: tuple[PoseMatch, ...]
    """Match of the poses of every result with those of the baseline."""
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
    _check(names, baseline, confidence)
    keys = _shared_keys(results)
    if not keys:
        commands = " and ".join(dict.fromkeys(result.command for result in results))
        raise UsageError(f"results of {commands} have no figure in common to compare")
    rankable = [key for key in keys if split_key(key)[1] not in _SIGNED]
    if by is not None and by not in rankable:
        raise UsageError(f"`by`: the results have no common figure {by!r}; choose from {', '.join(rankable)}")
    reference = names.index(baseline) if baseline is not None else 0
    differences = _PairwiseDifferences(results, confidence, seed)
    rows = tuple(_row(differences, key, reference) for key in keys)
    pairing = tuple(differences.pose_match(reference, i) for i in range(len(results)) if i != reference)
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
        pairing=pairing,
        ranking=_ranking(differences, ranked_by),
        scale=grade_scale,
        required_grade=required_grade,
        grade_statuses=statuses,
        notes=notes(results, tested, statuses, grade_scale),
        warnings=provenance_warnings(results, pairing),
    )


def _check(names: Sequence[str], baseline: str | None, confidence: float) -> None:
    if len(names) < 2:
        raise UsageError("a comparison needs at least two results")
    if not 0.5 <= confidence < 1.0:
        raise UsageError(f"`confidence`: expected a probability of at least 0.5 and below 1, found {confidence:g}")
    if baseline is not None and baseline not in names:
        raise UsageError(f"`baseline`: no result is named {baseline!r}; choose from {', '.join(names)}")


def _shared_keys(results: Sequence[ComparedResult]) -> list[str]:
    """Return the keys that every result has, in the order of the first; components only if the frames agree."""
    frames = {result.frame for result in results}
    keys = [key for key in results[0].figures if all(key in result.figures for result in results[1:])]
    return [key for key in keys if len(frames) == 1 or split_key(key)[1] not in VECTORIAL]


@dataclass(frozen=True, slots=True, eq=False)
class _PairwiseDifferences:
    """Differences between results; the poses of each pair are matched once."""

    results: Sequence[ComparedResult]
    confidence: float
    seed: int
    _pairings: dict[tuple[int, int, str], Pairing] = field(init=False, default_factory=dict)

    def difference(self, key: str, first: int, second: int) -> Difference:
        """Return the figure of the second result minus the figure of the first."""
        first_result, second_result = self.results[first], self.results[second]
        group, statistic = split_key(key)
        first_figure, second_figure = first_result.figures[key], second_result.figures[key]
        if first_result.digest == second_result.digest:
            return Difference(0.0, 0.0, 0.0, self.confidence, 1.0, "the same result twice", True, None)
        value = second_figure.value - first_figure.value
        if statistic in ("max", "max_radius95") and not group.startswith("iso9283."):
            return Difference(value, None, None, self.confidence, None, "none", False, None, _NO_TEST_OF_MAXIMUM)
        if not (first_result.measured and second_result.measured):
            return Difference(value, None, None, self.confidence, None, "none", False, None, _NO_TEST_OF_PREDICTION)
        if statistic in RESAMPLED and group in first_result.errors and group in second_result.errors:
            pairing = self.pairing(group, first, second)
            return difference(
                statistic,
                pairing.first,
                pairing.second,
                paired=pairing.paired,
                confidence=self.confidence,
                seed=self.seed,
            )
        return from_intervals(first_figure, second_figure, self.confidence)

    def pairing(self, group: str, first: int, second: int) -> Pairing:
        """Return the errors of two results, paired by pose where possible."""
        place = (first, second, group)
        if place not in self._pairings:
            errors = (self.results[first].errors[group], self.results[second].errors[group])
            self._pairings[place] = pair_poses(*errors)
        return self._pairings[place]

    def pose_match(self, first: int, second: int) -> PoseMatch:
        """Return how the poses of two results match."""
        first_result, second_result = self.results[first], self.results[second]
        names = (first_result.name, second_result.name)
        if "position" not in first_result.errors or "position" not in second_result.errors:
            return PoseMatch(*names, False, 0, first_result.n_poses, second_result.n_poses)
        pairing = self.pairing("position", first, second)
        shared = pairing.first.n_groups if pairing.paired else 0
        return PoseMatch(*names, pairing.paired, shared, pairing.n_first, pairing.n_second)


def _row(differences: _PairwiseDifferences, key: str, reference: int) -> ComparedRow:
    figures = tuple(result.figures[key] for result in differences.results)
    to_reference = tuple(
        None if i == reference else differences.difference(key, reference, i) for i in range(len(figures))
    )
    return ComparedRow(key, figures[0].unit, figures, to_reference)


def _ranking(differences: _PairwiseDifferences, key: str) -> Ranking:
    results = differences.results
    order = sorted(range(len(results)), key=lambda i: (abs(results[i].figures[key].value), i))
    pairs = [(i, j, differences.difference(key, order[i], order[j])) for i, j in combinations(range(len(order)), 2)]
    level = 1.0 - differences.confidence
    corrected, different = significant_pairs(pairs, level)
    names = [results[i].name for i in order]
    tested = any(p is not None for p in corrected)
    groups = indistinguishable_groups(len(order), different) if tested else []
    return Ranking(
        key=key,
        unit=results[0].figures[key].unit,
        level=level,
        names=tuple(names),
        values=tuple(results[i].figures[key].value for i in order),
        letters=tuple(group_letters(len(order), groups)),
        groups=tuple(tuple(names[i] for i in group) for group in groups),
        pairs=tuple(
            RankedPair(names[i], names[j], pair_difference, p, (i, j) in different)
            for (i, j, pair_difference), p in zip(pairs, corrected, strict=True)
        ),
    )


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"
