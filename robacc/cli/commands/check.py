"""``robacc check``: a stored result held against a gate."""

from __future__ import annotations

from typing import Annotated

import typer

from robacc.cli.options import Format, FormatOption, JunitOption, OutputOption, ReportOption


def check(
    result: Annotated[
        str, typer.Argument(metavar="RESULT", help="Result of any command as JSON; - reads standard input.")
    ],
    gate: Annotated[str, typer.Option("--gate", metavar="FILE", help="Gate file (YAML): what the result must meet.")],
    junit: JunitOption = None,
    report: ReportOption = None,
    form: FormatOption = Format.table,
    output: OutputOption = "-",
) -> None:
    """Hold a stored result against a gate: exit 0 where it passes, 4 where it fails, 5 where it is undecided.

    Example: robacc check result.json --gate gate.yaml
    """
    from robacc.api.check import check as checked
    from robacc.cli.output import Outlets, conclude
    from robacc.render.text.console import say_warnings

    found = checked(result, gate)
    say_warnings(found.warnings)
    conclude(Outlets(form, output, gate, junit, report), "check", found.document(), None, found)
