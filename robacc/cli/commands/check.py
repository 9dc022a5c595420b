"""``robacc check``: check a stored result against a gate."""

from __future__ import annotations

from typing import Annotated

import typer

from robacc.cli.options import Format, FormatOption, JunitOption, OutputOption, ReportOption


def check(
    result: Annotated[
        str, typer.Argument(metavar="RESULT", help="Result of any command as JSON; - reads standard input.")
    ],
    gate: Annotated[str, typer.Option("--gate", metavar="FILE", help="Gate file (YAML) with the criteria.")],
    junit: JunitOption = None,
    report: ReportOption = None,
    form: FormatOption = Format.table,
    output: OutputOption = "-",
) -> None:
    """Check a stored result against a gate; exit 0: pass, 4: fail, 5: inconclusive.

    Example: robacc check result.json --gate gate.yaml
    """
    from robacc.api.check import check as run_check
    from robacc.cli.output import Outlets, conclude

    outcome = run_check(result, gate)
    conclude(Outlets(form, output, gate, junit, report), "check", outcome.document(), None, outcome)
