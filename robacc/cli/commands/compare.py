"""``robacc compare``: compare stored results."""

from __future__ import annotations

from collections.abc import Mapping
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
        list[str],
        typer.Argument(
            metavar="RESULT RESULT …", help="Results stored as JSON, or two CSVs with --paired; - reads standard input."
        ),
    ],
    paired: Annotated[
        bool,
        typer.Option("--paired", help="Compare two CSVs of the same targets, before and after a correction."),
    ] = False,
    model: Annotated[
        str | None, typer.Option("--model", metavar="FILE", help="With --paired: model of the correction.")
    ] = None,
    nominal: Annotated[
        str | None,
        typer.Option("--nominal", metavar="FILE", help="With --paired: nominal robot, for CSVs without cmd_ columns."),
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option("--noise", metavar="SIZE", help="With --paired: measurement noise along each axis."),
    ] = None,
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

    Differences are paired if the results have the same poses. --paired compares two CSVs of the same targets, measured
    before and after a correction: the gain, what remains, and whether the correction was loaded.

    Example: robacc compare arm1.json arm2.json --grade D
    """
    options = {"baseline": baseline, "by": by, "grade": grade, "scale": scale, "gate": gate, "report": report}
    if _is_paired(paired, results, {"model": model, "nominal": nominal, "noise": noise}, options):
        _compare_paired(results, model, nominal, noise, form, output)
        return
    from robacc.api.compare import compare as run_compare
    from robacc.cli.output import Outlets, deliver

    result = run_compare(*results, baseline=baseline, by=by, grade=grade, scale=scale, confidence=confidence, seed=seed)

    def table(stream: TextIO) -> None:
        from robacc.render.views.compare import comparison_view
        from robacc.render.views.elements import draw

        draw(comparison_view(result.payload()), stream)

    deliver(Outlets(form, output, gate, junit, report), result, table)


def _is_paired(
    paired: bool, results: list[str], paired_options: Mapping[str, str | None], stored_options: Mapping[str, str | None]
) -> bool:
    """Return whether the call compares targets before and after a correction.

    Raises:
        UsageError: The options do not fit together.
    """
    from robacc.errors import UsageError

    if not paired:
        for name, value in paired_options.items():
            if value is not None:
                raise UsageError(f"--{name} needs --paired")
        return False
    if len(results) != 2:
        raise UsageError(f"--paired compares two CSVs, before and after a correction, found {len(results)}")
    for name, value in stored_options.items():
        if value is not None:
            raise UsageError(f"--{name} compares stored results; leave it out with --paired")
    return True


def _compare_paired(
    results: list[str], model: str | None, nominal: str | None, noise: str | None, form: Format, output: str
) -> None:
    """Compare two CSVs of the same targets."""
    from robacc.api.compare import compare_paired
    from robacc.cli.output import Outlets, deliver
    from robacc.render.views.compare import paired_view
    from robacc.render.views.elements import draw

    before, after = results
    result = compare_paired(before, after, model=model, nominal=nominal, noise=noise)
    deliver(Outlets(form, output), result, lambda stream: draw(paired_view(result.payload(), (before, after)), stream))
