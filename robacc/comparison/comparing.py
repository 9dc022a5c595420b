"""Results side by side: every shared figure, its difference to the baseline, a ranking, grades, and warnings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

from robacc.accuracy.grade_scale import Scale
from robacc.comparison.compared_result import ComparedFigure, ComparedResult, split_key
from robacc.comparison.differences import RESAMPLED, VECTORIAL, Difference, difference
from robacc.comparison.from_intervals import from_intervals
from robacc.comparison.grade_status import Standing, chosen_scale, standings
from robacc.comparison.pairing import Pairing, pair
from robacc.comparison.ranking import decided, groups, letters
from robacc.comparison.warning import made_differently, notes
from robacc.errors import UsageError

RANKED_BY = "position.rms"
_SIGNED = frozenset(f"mean_{axis}" for axis in "xyz")
"""Statistics of which less is not better."""
_LARGEST = "no test holds for the largest of all errors"
_PREDICTED = "a prediction is of robots to come, not a sample of one: it has no sampling error to test by"


@dataclass(frozen=True, slots=True)
class Row:
    """One figure of every result, and how much each differs from the baseline's."""

    key: str
    unit: str
    figures: tuple[ComparedFigure, ...]
    """Of the results, in their order."""
    differences: tuple[Difference | None, ...]
    """To the baseline; None at the baseline itself."""


@dataclass(frozen=True, slots=True)
class Pair:
    """Two results, by their places in order of the ranking's figure."""

    better: str
    worse: str
    """By the estimate, whether or not the difference is real."""
    difference: Difference
    """Worse less better."""
    p_corrected: float | None
    """Corrected for the number of pairs (Holm)."""
    different: bool


@dataclass(frozen=True, slots=True)
class Ranking:
    """The results in order of one figure, the smallest first."""

    key: str
    unit: str
    level: float
    """Of the corrected p-value below which two results count as different."""
    names: tuple[str, ...]
    values: tuple[float, ...]
    letters: tuple[str, ...]
    """Results that share a letter cannot be told apart."""
    groups: tuple[tuple[str, ...], ...]
    """Largest groups of results that cannot be told apart; none, and no letters, where nothing could be tested."""
    pairs: tuple[Pair, ...]

    def sentences(self) -> tuple[str, ...]:
        """The ranking in words: neighbours that differ, then those that do not."""
        if not self.groups:
            return ("in order of the figure; no difference could be tested",)
        neighbours = [pair for pair in self.pairs if self.names.index(pair.worse) == self.names.index(pair.better) + 1]
        lines = [f"{pair.better} is better than {pair.worse}" for pair in neighbours if pair.different]
        lines += [f"{_listed(group)} cannot be told apart" for group in self.groups if len(group) > 1]
        untested = [pair for pair in self.pairs if pair.difference.p_value is None]
        return (*lines, *(f"{pair.better} and {pair.worse} could not be tested" for pair in untested))


@dataclass(frozen=True, slots=True)
class Paired:
    """Whether two results are of the same poses."""

    first: str
    second: str
    paired: bool
    shared: int
    """Commanded poses in common; 0 where they are not compared in pairs."""
    n_first: int
    n_second: int


@dataclass(frozen=True, slots=True)
class ResultComparison:
    """What :func:`compare` found."""

    subjects: tuple[ComparedResult, ...]
    baseline: str
    confidence: float
    rows: tuple[Row, ...]
    pairing: tuple[Paired, ...]
    """Of every result with the baseline."""
    ranking: Ranking
    scale: Scale | None
    wanted: str | None
    standings: tuple[Standing, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


def compare(
    subjects: Sequence[ComparedResult],
    *,
    baseline: str | None = None,
    by: str | None = None,
    wanted: str | None = None,
    scale: Scale | None = None,
    confidence: float = 0.95,
    seed: int = 0,
) -> ResultComparison:
    """Hold results against each other.

    Args:
        subjects: At least two, of different names.
        baseline: The name of the one that the others are held against; None is the first.
        by: Key of the figure that ranks them; None is the RMS position error, or the first shared one.
        wanted: A grade; says which results have it.
        scale: That ``wanted`` is a step of; None is the results' own.
        confidence: Of the intervals; differences count as real below 1 - confidence.
        seed: Of the bootstrap.

    Raises:
        UsageError: Names, keys or grades that are not there, or nothing to compare.
    """
    names = [subject.name for subject in subjects]
    if len(subjects) < 2:
        raise UsageError("a comparison takes at least two results")
    if not 0.5 <= confidence < 1.0:
        raise UsageError(f"the confidence is a probability of at least 0.5 and below 1, not {confidence:g}")
    if baseline is not None and baseline not in names:
        raise UsageError(f"no result is named {baseline!r}; they are {', '.join(names)}")
    keys = _shared(subjects)
    if not keys:
        kinds = " and ".join(dict.fromkeys(subject.command for subject in subjects))
        raise UsageError(f"results of {kinds} share no figure that could be compared")
    rankable = [key for key in keys if split_key(key)[1] not in _SIGNED]
    if by is not None and by not in rankable:
        raise UsageError(f"no shared figure {by!r} to rank by; there are {', '.join(rankable)}")
    reference = names.index(baseline) if baseline is not None else 0
    engine = _Engine(subjects, confidence, seed)
    rows = tuple(_row(engine, key, reference) for key in keys)
    pairing = tuple(engine.paired(reference, i) for i in range(len(subjects)) if i != reference)
    ranked = by or (RANKED_BY if RANKED_BY in rankable else rankable[0])
    judged = None if wanted is None else scale or chosen_scale(subjects)
    found = () if judged is None or wanted is None else standings(subjects, judged, wanted, seed)
    tested = any(one is not None and one.p_value is not None for row in rows for one in row.differences)
    return ResultComparison(
        subjects=tuple(subjects),
        baseline=names[reference],
        confidence=confidence,
        rows=rows,
        pairing=pairing,
        ranking=_ranking(engine, ranked),
        scale=judged,
        wanted=wanted,
        standings=found,
        notes=notes(subjects, tested, found, judged),
        warnings=made_differently(subjects, [(one.first, one.second, one) for one in pairing]),
    )


def _shared(subjects: Sequence[ComparedResult]) -> list[str]:
    """Keys that every result has, in the first one's order; components only where their axes are the same."""
    frames = {subject.frame for subject in subjects}
    keys = [key for key in subjects[0].figures if all(key in other.figures for other in subjects[1:])]
    return [key for key in keys if len(frames) == 1 or split_key(key)[1] not in VECTORIAL]


@dataclass(frozen=True, slots=True, eq=False)
class _Engine:
    """Differences between results, each pair's poses matched once."""

    subjects: Sequence[ComparedResult]
    confidence: float
    seed: int
    _pairings: dict[tuple[int, int, str], Pairing] = field(init=False, default_factory=dict)

    def difference(self, key: str, first: int, second: int) -> Difference:
        """The figure of the second result less that of the first."""
        one, other = self.subjects[first], self.subjects[second]
        owner, statistic = split_key(key)
        a, b = one.figures[key], other.figures[key]
        if one.digest == other.digest:
            return Difference(0.0, 0.0, 0.0, self.confidence, 1.0, "one result twice", True, None)
        value = b.value - a.value
        if statistic in ("max", "max_radius95") and not owner.startswith("iso9283."):
            return Difference(value, None, None, self.confidence, None, "none", False, None, _LARGEST)
        if not (one.measured and other.measured):
            return Difference(value, None, None, self.confidence, None, "none", False, None, _PREDICTED)
        if statistic in RESAMPLED and owner in one.errors and owner in other.errors:
            matched = self.pairing(owner, first, second)
            return difference(
                statistic,
                matched.first,
                matched.second,
                paired=matched.paired,
                confidence=self.confidence,
                seed=self.seed,
            )
        return from_intervals(a, b, self.confidence)

    def pairing(self, owner: str, first: int, second: int) -> Pairing:
        """The errors of two results, matched."""
        place = (first, second, owner)
        if place not in self._pairings:
            self._pairings[place] = pair(self.subjects[first].errors[owner], self.subjects[second].errors[owner])
        return self._pairings[place]

    def paired(self, first: int, second: int) -> Paired:
        """Whether two results are of the same poses."""
        one, other = self.subjects[first], self.subjects[second]
        if "position" not in one.errors or "position" not in other.errors:
            return Paired(one.name, other.name, False, 0, one.n_poses, other.n_poses)
        found = self.pairing("position", first, second)
        shared = found.first.n_groups if found.paired else 0
        return Paired(one.name, other.name, found.paired, shared, found.n_first, found.n_second)


def _row(engine: _Engine, key: str, reference: int) -> Row:
    figures = tuple(subject.figures[key] for subject in engine.subjects)
    differences = tuple(
        None if i == reference else engine.difference(key, reference, i) for i in range(len(engine.subjects))
    )
    return Row(key, figures[0].unit, figures, differences)


def _ranking(engine: _Engine, key: str) -> Ranking:
    subjects = engine.subjects
    order = sorted(range(len(subjects)), key=lambda i: (abs(subjects[i].figures[key].value), i))
    pairs = [(i, j, engine.difference(key, order[i], order[j])) for i, j in combinations(range(len(order)), 2)]
    level = 1.0 - engine.confidence
    corrected, different = decided(pairs, level)
    names = [subjects[i].name for i in order]
    tested = any(p is not None for p in corrected)
    found = groups(len(order), different) if tested else []
    return Ranking(
        key=key,
        unit=subjects[0].figures[key].unit,
        level=level,
        names=tuple(names),
        values=tuple(subjects[i].figures[key].value for i in order),
        letters=tuple(letters(len(order), found)),
        groups=tuple(tuple(names[i] for i in group) for group in found),
        pairs=tuple(
            Pair(names[i], names[j], one, p, (i, j) in different)
            for (i, j, one), p in zip(pairs, corrected, strict=True)
        ),
    )


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"
