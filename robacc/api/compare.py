"""Call of the command ``robacc compare``."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any, ClassVar

from robacc.api.inputs import STDIN, StrPath, load_grade_scale, load_result, path_of
from robacc.api.result import Provenance, Result, check_range, fields_of, options_of
from robacc.comparison.compared_result import ComparedResult
from robacc.comparison.comparing import ResultComparison
from robacc.comparison.comparing import compare as compare_results
from robacc.comparison.reading import read_compared_result
from robacc.documents.envelope import InputFile
from robacc.documents.read_result import StoredResult
from robacc.errors import InputError, Problem, UsageError

Source = StrPath | Result | StoredResult


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Compared(Result, ResultComparison):
    """Comparison of results, with the files that they were read from."""

    command: ClassVar[str] = "compare"
    made: Provenance

    @classmethod
    def of(cls, body: ResultComparison, made: Provenance) -> Compared:
        """Return ``body`` with its inputs."""
        return cls(**fields_of(body), made=made)

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys."""
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
    """Compare results: every shared figure, the significant differences, and the grades that are confirmed.

    Differences are paired if the results have the same poses.

    Args:
        results: Two or more, stored as JSON (``-`` is standard input) or returned by calls. A stored result is named
            after its file, another after its command; equal names get a number.
        baseline: Name of the result that the others are compared with; None for the first.
        by: Key of the figure for the ranking, such as ``position.p95``; None for ``position.rms``.
        grade: Grade to check each result for.
        scale: Grade scale (YAML) of ``grade``; None for the scale of the results.
        confidence: Confidence level of the intervals.
        seed: Seed of the bootstrap.

    Returns:
        Every shared figure with its differences, the ranking, the grades, and other differences between the results.

    Raises:
        InputError: A result cannot be read; with the problems of every file.
        UsageError: A name, key or grade does not exist, or there is one result only.

    Example:
        >>> import robacc
        >>> plain = robacc.estimate("sample_data/poses.csv", robot="sample_data/robot.yaml")
        >>> aligned = robacc.estimate("sample_data/poses.csv", robot="sample_data/robot.yaml", align="base_frame")
        >>> robacc.compare(plain, aligned).ranking.names
        ('estimate (2)', 'estimate')
    """
    arguments = locals()
    check_range("seed", seed, 0)
    if scale is not None and grade is None:
        raise UsageError("`scale` needs `grade`, the grade to check the results for")
    compared_results, inputs = _load(results)
    grades, scale_record = load_grade_scale(scale)
    comparison = compare_results(
        compared_results,
        baseline=_baseline_name(baseline, results, compared_results),
        by=by,
        required_grade=grade,
        scale=grades,
        confidence=confidence,
        seed=seed,
    )
    options = options_of(compare, arguments, baseline=comparison.baseline, by=comparison.ranking.key)
    return Compared.of(comparison, Provenance(options, (*inputs, *scale_record), seed))


def _load(results: Sequence[Source]) -> tuple[list[ComparedResult], list[InputFile]]:
    """Return the results to compare and the record of their files.

    Raises:
        InputError: A file cannot be used; with the problems of every file.
        UsageError: Standard input is named twice, or there is one result only.
    """
    if len(results) < 2:
        raise UsageError("a comparison takes at least two results")
    if [path_of(source) for source in results].count(STDIN) > 1:
        raise UsageError("standard input can be read only once")
    problems: list[Problem] = []
    compared_results: list[ComparedResult] = []
    inputs: list[InputFile] = []
    for source, name in zip(results, _names(results), strict=True):
        try:
            result = load_result(source)
            compared_results.append(read_compared_result(result.document, name, result.name, result.sha256))
            inputs.append(result.record)
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(problems)
    return compared_results, inputs


def _names(results: Sequence[Source]) -> list[str]:
    """Return short unique names: the file's, with its folder or a number where files have the same name."""
    paths = [_path(source) for source in results]
    names = ["standard input" if path == STDIN else PurePath(path).stem for path in paths]
    if len(set(names)) < len(names):
        places = [PurePath(path) for path in paths]
        names = [
            f"{place.parent.name}/{name}" if names.count(name) > 1 and place.parent.name else name
            for place, name in zip(places, names, strict=True)
        ]
    counts: Counter[str] = Counter()
    unique = []
    for name in names:
        counts[name] += 1
        unique.append(name if counts[name] == 1 else f"{name} ({counts[name]})")
    return unique


def _path(source: Source) -> str:
    """Return the path of a file, or the command of a result without one."""
    if isinstance(source, StoredResult):
        return source.name
    return source.command if isinstance(source, Result) else os.fspath(source)


def _baseline_name(
    baseline: str | None, results: Sequence[Source], compared_results: Sequence[ComparedResult]
) -> str | None:
    """Return the short name of the baseline, which may be given as a path."""
    paths = [_path(source) for source in results]
    return compared_results[paths.index(baseline)].name if baseline in paths else baseline
