"""``robacc compare``: compare stored results."""

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
        typer.Option(
            "--baseline", metavar="NAME", help="Result that the others are compared with; default: the first."
        ),
    ] = None,
    by: Annotated[
        str | None,
        typer.Option(
            "--by", metavar="KEY", help="Figure for the ranking, such as position.p95; default: position.rms."
        ),
    ] = None,
    grade: Annotated[
        str | None, typer.Option("--grade", metavar="GRADE", help="Grade to check each result for.")
    ] = None,
    scale: Annotated[
        str | None,
        typer.Option("--scale", metavar="FILE", help="Grade scale (YAML) in place of the scale of the results."),
    ] = None,
    confidence: ConfidenceOption = 0.95,
    seed: SeedOption = 0,
    gate: GateOption = None,
    junit: JunitOption = None,
    report: ReportOption = None,
    form: FormatOption = Format.table,
    output: OutputOption = "-",
) -> None:
    """Compare stored results: significant differences, ranking and confirmed grades.

    Differences are paired if the results have the same poses.

    Example: robacc compare arm1.json arm2.json --grade D
    """
    from robacc.api.compare import compare as run_compare
    from robacc.cli.output import Outlets, deliver

    result = run_compare(*results, baseline=baseline, by=by, grade=grade, scale=scale, confidence=confidence, seed=seed)

    def table(stream: TextIO) -> None:
        from robacc.render.text.compare import draw_comparison

        draw_comparison(result, stream)

    deliver(Outlets(form, output, gate, junit, report), result, table)
