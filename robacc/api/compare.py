"""The call behind ``robacc compare``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any, ClassVar

from robacc.api.inputs import STDIN, StrPath, path_of, scale_of
from robacc.api.result import Made, Result, parts, within
from robacc.api.stored import stored
from robacc.comparison.compared_result import ComparedResult
from robacc.comparison.comparing import ResultComparison
from robacc.comparison.comparing import compare as compared
from robacc.comparison.reading import subject
from robacc.documents.envelope import InputFile
from robacc.documents.read_result import StoredResult
from robacc.errors import InputError, Problem, UsageError

Source = StrPath | Result | StoredResult


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Compared(Result, ResultComparison):
    """Results side by side, with what they were read from."""

    command: ClassVar[str] = "compare"
    made: Made

    def payload(self) -> dict[str, Any]:
        """The result's own keys."""
        from robacc.documents.compare import payload

        return payload(self)


def compare(
    *results: Source,
    baseline: str | None = None,
    by: str | None = None,
    grade: str | None = None,
    scale: StrPath | None = None,
    confidence: float = 0.95,
    seed: int = 0,
) -> Compared:
    """Results side by side: every shared figure, which differences are real, and which results have a grade.

    Differences are tested in pairs where the poses are the same.

    Args:
        results: At least two: stored as JSON (``-`` is standard input), or what calls returned. A stored one has the
            name of its file without the ending, another that of its command; a number is added where names are alike.
        baseline: Name of the one that the others are held against; None is the first.
        by: Key of the figure that ranks them, as in ``position.p95``; None is ``position.rms``.
        grade: Says which of the results demonstrate this grade.
        scale: Grade scale (YAML) that ``grade`` is of; None is the results' own.
        confidence: Of the intervals.
        seed: Of the bootstrap.

    Returns:
        Every shared figure with its differences, the ranking, the grades, and what the results differ in otherwise.

    Raises:
        InputError: A result cannot be read; with the problems of all.
        UsageError: Names, keys or grades that are not there, or nothing to compare.

    Example:
        >>> import robacc
        >>> plain = robacc.estimate("sample_data/poses.csv", robot="sample_data/robot.yaml")
        >>> aligned = robacc.estimate("sample_data/poses.csv", robot="sample_data/robot.yaml", align="base_frame")
        >>> robacc.compare(plain, aligned).ranking.names
        ('estimate (2)', 'estimate')
    """
    within("seed", seed, 0)
    if scale is not None and grade is None:
        raise UsageError("`scale` needs `grade`, the grade to check the results for")
    subjects, inputs = _load(results)
    scale_read, scale_record = scale_of(scale)
    found = compared(
        subjects,
        baseline=_named(baseline, results, subjects),
        by=by,
        wanted=grade,
        scale=scale_read,
        confidence=confidence,
        seed=seed,
    )
    options = {"baseline": found.baseline, "by": found.ranking.key, "grade": grade, "confidence": confidence}
    return Compared(**parts(found), made=Made(options, (*inputs, *scale_record), seed))


def _load(results: Sequence[Source]) -> tuple[list[ComparedResult], list[InputFile]]:
    """What is to be compared, and the record of its files; what is wrong with any of them is said at once.

    Raises:
        InputError: With the problems of every file.
        UsageError: Standard input is named twice, or there is one result alone.
    """
    if len(results) < 2:
        raise UsageError("a comparison takes at least two results")
    if [path_of(one) for one in results].count(STDIN) > 1:
        raise UsageError("standard input can be read once")
    problems: list[Problem] = []
    subjects: list[ComparedResult] = []
    inputs: list[InputFile] = []
    for source, name in zip(results, _names(results), strict=True):
        try:
            one = stored(source)
            subjects.append(subject(one.document, name, one.name, one.sha256))
            inputs.append(one.record)
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(problems)
    return subjects, inputs


def _names(results: Sequence[Source]) -> list[str]:
    """A short name for each, no two alike: the file's, with its folder's where files are named alike, or a number."""
    paths = [_path(one) for one in results]
    names = ["standard input" if path == STDIN else PurePath(path).stem for path in paths]
    if len(set(names)) < len(names):
        places = [PurePath(path) for path in paths]
        names = [
            f"{place.parent.name}/{name}" if names.count(name) > 1 and place.parent.name else name
            for place, name in zip(places, names, strict=True)
        ]
    seen: dict[str, int] = {}
    unique = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        unique.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return unique


def _path(source: Source) -> str:
    """The path of a file; of a result that is none, its command."""
    if isinstance(source, StoredResult):
        return source.name
    return source.command if isinstance(source, Result) else os.fspath(source)


def _named(baseline: str | None, results: Sequence[Source], subjects: Sequence[ComparedResult]) -> str | None:
    """The baseline's short name, which may be given as its path."""
    paths = [_path(one) for one in results]
    return subjects[paths.index(baseline)].name if baseline in paths else baseline
