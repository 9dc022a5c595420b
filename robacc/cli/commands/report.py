"""``robacc report``: stored results as an HTML page."""

from __future__ import annotations

from typing import Annotated

from robacc.api.parameters import Help


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
    output: Annotated[str, Help("Page to write; - is standard output.", "FILE", names=("output", "o"), holds="output")],
) -> None:
    """Write stored results as an HTML page with charts and tables, to read, print and sign.

    The page is a single file that needs no network and prints on A4. Needs an extra: pip install '.[report]'
    in a checkout, or pip install 'robacc[report] @ git+URL' with the repository's URL.

    Example: robacc report result.json --identity cell7.yaml --output report.html
    """
    from robacc.cli.output import page_of_results, write
    from robacc.documents.identity import read_identity
    from robacc.documents.read_result import read_result
    from robacc.errors import UsageError
    from robacc.render.plots.canvas import need

    need("matplotlib", "plotly", "jinja2")
    if results.count("-") > 1:
        raise UsageError("standard input can be read only once")
    tested = read_identity(identity or ())
    write(output, (page_of_results([read_result(path) for path in results], tested),))
