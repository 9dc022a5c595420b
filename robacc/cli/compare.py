"""``robacc compare``: stored results side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePath
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

from robacc.cli.options import (
    ConfidenceOption,
    Format,
    FormatOption,
    GateOption,
    JunitOption,
    OutputOption,
    ReportOption,
    SeedOption,
)
from robacc.results import InputFile

if TYPE_CHECKING:
    from robacc.comparison.comparing import Comparison
    from robacc.comparison.subject import Subject
    from robacc.errors import Problem
    from robacc.grade_scale import Scale


def compare(
    results: Annotated[
        list[str], typer.Argument(metavar="RESULT", help="Results stored as JSON; - reads standard input.")
    ],
    baseline: Annotated[
        str | None,
        typer.Option("--baseline", metavar="NAME", help="Hold the others against this one; default is the first."),
    ] = None,
    by: Annotated[
        str | None,
        typer.Option("--by", metavar="KEY", help="Rank by this figure, as in position.p95; default is position.rms."),
    ] = None,
    grade: Annotated[
        str | None, typer.Option("--grade", metavar="GRADE", help="Say which of the results demonstrate this grade.")
    ] = None,
    scale: Annotated[
        str | None, typer.Option("--scale", metavar="FILE", help="Grade scale (YAML); default is the results' own.")
    ] = None,
    confidence: ConfidenceOption = 0.95,
    seed: SeedOption = 0,
    gate: GateOption = None,
    junit: JunitOption = None,
    report: ReportOption = None,
    form: FormatOption = Format.table,
    output: OutputOption = "-",
) -> None:
    """Results side by side: every shared figure, which differences are real, and which results have a grade.

    Differences are tested in pairs where the poses are the same. Example: robacc compare arm1.json arm2.json --grade B
    """
    from robacc.cli.output import Outlets, deliver
    from robacc.comparison.comparing import compare as compared
    from robacc.errors import UsageError

    if scale is not None and grade is None:
        raise UsageError("--scale is of the grade that --grade names")
    subjects, inputs = _load(results)
    found = compared(
        subjects,
        baseline=_named(baseline, results, subjects),
        by=by,
        wanted=grade,
        scale=_scale(scale, inputs),
        confidence=confidence,
        seed=seed,
    )
    options: dict[str, Any] = {"baseline": found.baseline, "by": found.ranking.key, "grade": grade}

    deliver(
        Outlets(form, output, gate, junit, report),
        "compare",
        payload=lambda: _payload(found),
        table=lambda stream: _draw(found, stream),
        options={**options, "confidence": confidence},
        inputs=inputs,
        seed=seed,
        warnings=found.warnings,
    )


def _payload(found: Comparison) -> dict[str, Any]:
    from robacc.io.compare_json import payload

    return payload(found)


def _draw(found: Comparison, stream: TextIO) -> None:
    from robacc.report.compare import draw_comparison

    draw_comparison(found, stream)


def _load(paths: Sequence[str]) -> tuple[list[Subject], list[InputFile]]:
    """What is to be compared, and the record of its files; what is wrong with any of them is said at once.

    Raises:
        InputError: With the problems of every file.
        UsageError: Standard input is named twice, or there is one result alone.
    """
    from robacc.comparison.reading import subject
    from robacc.errors import InputError, UsageError
    from robacc.io.read_result import read_result

    if len(paths) < 2:
        raise UsageError("a comparison takes at least two results")
    if paths.count("-") > 1:
        raise UsageError("standard input can be read once")
    problems: list[Problem] = []
    subjects: list[Subject] = []
    inputs: list[InputFile] = []
    for path, name in zip(paths, _names(paths), strict=True):
        try:
            stored = read_result(path)
            subjects.append(subject(stored.document, name, path, stored.sha256))
            inputs.append(stored.record)
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(problems)
    return subjects, inputs


def _names(paths: Sequence[str]) -> list[str]:
    """A short name for each, no two alike: the file's, with its folder's where files are named alike, or a number."""
    names = ["standard input" if path == "-" else PurePath(path).stem for path in paths]
    if len(set(names)) < len(names):
        parts = [PurePath(path) for path in paths]
        names = [
            f"{part.parent.name}/{name}" if names.count(name) > 1 and part.parent.name else name
            for part, name in zip(parts, names, strict=True)
        ]
    seen: dict[str, int] = {}
    unique = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        unique.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return unique


def _named(baseline: str | None, paths: Sequence[str], subjects: Sequence[Subject]) -> str | None:
    """The baseline's short name, which may be given as its path."""
    if baseline in paths:
        return subjects[list(paths).index(str(baseline))].name
    return baseline


def _scale(path: str | None, inputs: list[InputFile]) -> Scale | None:
    """The scale of a file, whose record is added."""
    if path is None:
        return None
    from robacc.grade_scale import load_scale
    from robacc.io.files import read_text, sha256_of

    inputs.append(InputFile.at(path, sha256_of(path), "scale"))
    return load_scale(read_text(path), path)
