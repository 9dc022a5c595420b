"""``robacc report``: stored results as an HTML page, or a chart of one."""

from __future__ import annotations

from pathlib import PurePath
from typing import Annotated

from robacc.api.parameters import Help

_PICTURES = (".svg", ".png", ".pdf")


def report(
    results: Annotated[list[str], Help("Results of any command as JSON; - reads standard input.", "RESULT [RESULT …]")],
    *,
    identity: Annotated[
        list[str] | None,
        Help(
            "What was tested, as a YAML file or as serial_number=12345, customer=…; may be repeated. It replaces what "
            "the robot file states under identity.",
            "FILE|KEY=TEXT",
        ),
    ] = None,
    chart: Annotated[
        str | None,
        Help(
            "Kind of the chart to write in place of the page; default for `output` .svg, .png, .pdf: the main chart, "
            "and a note of others.",
            "KIND",
            names=("chart", "kind"),
        ),
    ] = None,
    number: Annotated[int, Help("Number of the chart among several of its kind.", "N", least=1)] = 1,
    output: Annotated[
        str | None,
        Help(
            "File to write; - is standard output; default: RESULT.html, or report.html for several results.",
            "FILE",
            names=("output", "o"),
            holds="output",
        ),
    ] = None,
) -> None:
    """Write stored results as an HTML page with charts and tables, or one chart as SVG, PNG or PDF.

    The page is a single file that needs no network, to read, print on A4 and sign. A chart is the one on the page.
    Needs an extra: pip install '.[report]' in a checkout, or pip install 'robacc[report] @ git+URL' with the
    repository's URL.

    Example: robacc report result.json --identity cell7.yaml --output report.html
    """
    from robacc.cli.output import page_of_results, write
    from robacc.documents.envelope import read_identity, read_result
    from robacc.errors import UsageError
    from robacc.render.plots.canvas import need

    if chart is not None or PurePath(output or "").suffix.lower() in _PICTURES:
        _write_chart(results, chart or "", number, output or "")
        return
    need("matplotlib", "plotly", "jinja2")
    if results.count("-") > 1:
        raise UsageError("standard input can be read only once")
    page = page_of_results([read_result(path) for path in results], read_identity(identity or ()))
    if output is None:
        is_named = len(results) == 1 and results[0] != "-"
        output = f"{results[0].removesuffix('.json')}.html" if is_named else "report.html"
        print(f"wrote {output}")
    write(output, (page,))


def _write_chart(results: list[str], kind: str, number: int, output: str) -> None:
    """Write a chart of the one result; without a kind the main chart, and a note of others."""
    from robacc.documents.envelope import read_result, understood
    from robacc.errors import Note, UsageError
    from robacc.io.files import write_bytes
    from robacc.render.plots.canvas import as_file, need
    from robacc.render.plots.results import chart_of, charts_of, kinds_of
    from robacc.render.text import say_warnings

    form = PurePath(output).suffix.lower()
    if form not in _PICTURES:
        raise UsageError(f"--output {output}: expected a name that ends in .svg, .png or .pdf")
    if len(results) > 1:
        raise UsageError(f"a chart is of one result, found {len(results)}")
    need("matplotlib")
    stored = read_result(results[0])
    with understood(stored.name, stored.command):
        chart = chart_of(stored.document, kind, number)
        image = as_file(chart, form.removeprefix("."))
    write_bytes(output, image)
    if not kind:
        others = ", ".join(kinds_of(charts_of(stored.document))[1:]) or "none"
        say_warnings([Note(f"drew the main chart, {chart.kind}; other charts by `chart`: {others}")])
