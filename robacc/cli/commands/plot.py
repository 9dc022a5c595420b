"""``robacc plot``: a chart of a stored result as a file."""

from __future__ import annotations

from pathlib import PurePath
from typing import Annotated

from robacc.api.parameters import Help

FORMS = ("svg", "png", "pdf")


def plot(
    result: Annotated[str, Help("Result of any command as JSON; - reads standard input.", "RESULT")],
    *,
    output: Annotated[
        str,
        Help("File to write; its suffix is .svg, .png or .pdf.", "FILE", names=("output", "o"), holds="output"),
    ],
    kind: Annotated[str, Help("Kind of chart; without it, the main chart, and a note of others.", "KIND")] = "",
    number: Annotated[int, Help("Number of the chart among several of its kind.", "N", least=1)] = 1,
) -> None:
    """Write a chart of a stored result as SVG, PNG or PDF.

    The chart is the one in the report. Needs an extra: pip install '.[report]'
    in a checkout, or pip install 'robacc[report] @ git+URL' with the repository's URL.

    Example: robacc plot trace.json --kind effect --number 2 --output backlash.pdf
    """
    from robacc.documents.read_result import read_result, understood
    from robacc.errors import Note, UsageError
    from robacc.io.files import write_bytes
    from robacc.render.plots.canvas import as_file, need
    from robacc.render.plots.catalogue import chart_of, charts_of, kinds_of
    from robacc.render.text.console import say_warnings

    form = PurePath(output).suffix.removeprefix(".").lower()
    if form not in FORMS:
        raise UsageError(f"--output {output}: expected a name that ends in .svg, .png or .pdf")
    need("matplotlib")
    stored = read_result(result)
    with understood(stored.name, stored.command):
        chart = chart_of(stored.document, kind, number)
        image = as_file(chart.draw, chart.size, form)
    write_bytes(output, image)
    if not kind:
        others = ", ".join(kinds_of(charts_of(stored.document))[1:]) or "none"
        say_warnings([Note(f"drew the main chart, {chart.kind}; other charts by `kind`: {others}")])
