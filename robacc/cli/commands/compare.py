"""``robacc compare``: stored results side by side."""

from __future__ import annotations

from typing import Annotated, TextIO

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
    """Stored results side by side: which differences are real, and which results demonstrate a grade.

    Differences are tested in pairs where the poses are the same.

    Example: robacc compare arm1.json arm2.json --grade D
    """
    from robacc.api.compare import compare as compared
    from robacc.cli.output import Outlets, deliver

    found = compared(*results, baseline=baseline, by=by, grade=grade, scale=scale, confidence=confidence, seed=seed)

    def table(stream: TextIO) -> None:
        from robacc.render.text.compare import draw_comparison

        draw_comparison(found, stream)

    deliver(Outlets(form, output, gate, junit, report), found, table)
