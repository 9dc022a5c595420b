"""``robacc report``: stored results as one HTML page, to be looked at, printed and signed."""

from __future__ import annotations

from typing import Annotated

import typer


def report(
    results: Annotated[
        list[str],
        typer.Argument(metavar="RESULT [RESULT …]", help="Results of any command as JSON; several stand side by side."),
    ],
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="FILE", help="Write the page there; - is standard output.")
    ],
) -> None:
    """Stored results as one HTML page: story, pictures, tables, to be looked at, printed and signed.

    The page is one file that opens without a network and prints on A4. It needs an extra: pip install 'robacc[report]'.

    Example: robacc report result.json --output report.html
    """
    from robacc.cli.output import write
    from robacc.cli.pages import page_of_results
    from robacc.documents.read_result import read_result
    from robacc.errors import UsageError
    from robacc.render.plots.optional_dependencies import need

    need("matplotlib", "plotly", "jinja2")
    if results.count("-") > 1:
        raise UsageError("standard input can be read once")
    write(output, (page_of_results([read_result(path) for path in results]),))
