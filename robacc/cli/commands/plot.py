"""``robacc plot``: one picture of a stored result as a file, for a paper or a job's summary."""

from __future__ import annotations

from pathlib import PurePath
from typing import Annotated

import typer

FORMS = ("svg", "png", "pdf")


def plot(
    result: Annotated[
        str, typer.Argument(metavar="RESULT", help="Result of any command as JSON; - reads standard input.")
    ],
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="FILE", help="Write there; its ending (svg, png, pdf) is the form.")
    ],
    kind: Annotated[
        str,
        typer.Option("--kind", metavar="KIND", help="Which picture; a kind that is not there lists those that are."),
    ],
    number: Annotated[
        int,
        typer.Option("--number", metavar="N", min=1, help="Of several of a kind, the one; findings in their order."),
    ] = 1,
) -> None:
    """One picture of a stored result as SVG, PNG or PDF.

    It is the picture that the report has. It needs the extra: pip install 'robacc[report]'.

    Example: robacc plot trace.json --kind effect --number 2 --output backlash.pdf
    """
    from robacc.documents.read_result import read_result, understood
    from robacc.errors import UsageError
    from robacc.io.files import write_bytes
    from robacc.render.plots.canvas import as_file
    from robacc.render.plots.catalogue import chart_of
    from robacc.render.plots.optional_dependencies import need

    form = PurePath(output).suffix.removeprefix(".").lower()
    if form not in FORMS:
        raise UsageError(f"--output {output}: a picture's name ends in .svg, .png or .pdf, which says its form")
    need("matplotlib")
    stored = read_result(result)
    with understood(stored.name, stored.command):
        picture = chart_of(stored.document, kind, number)
        drawn = as_file(picture.draw, picture.size, form)
    write_bytes(output, drawn)
