"""``robacc plan``: the poses worth measuring, in an order to drive, and the expected result."""

from __future__ import annotations

from typing import Annotated

from robacc.api.parameters import Help
from robacc.cli.options import Call, CsvOutlets, Report


def plan(
    call: Call,
    *,
    validation_output: Annotated[str | None, Help("File for the validation poses.", "FILE", holds="output")] = None,
    program: Annotated[
        str | None, Help("File for a robot program: .src, .mod, .ls or .script.", "FILE", holds="output")
    ] = None,
    report: Report = None,
    outlets: CsvOutlets,
) -> None:
    """Plan a measurement: choose the poses worth measuring, order them, and predict the result.

    The CSV lists the visits in order. With --output, a summary is written to standard output.

    Example: robacc plan robot.yaml --for calibrate --poses 30 --output plan.csv
    """
    from robacc.cli.output import emit, page_of_document, write
    from robacc.errors import UsageError
    from robacc.io.files import write_text
    from robacc.render.text.console import warnings_below
    from robacc.render.views.elements import draw
    from robacc.render.views.plan import plan_view

    outlets.check()
    if (validation_output is None) != (call.keywords["validation"] == 0):
        raise UsageError("--validation N and --validation-output FILE belong together")
    result = call()
    with warnings_below(result.warnings):
        programs = {} if program is None else result.programs(program)
        if validation_output is not None:
            write_text(validation_output, result.validation_csv())
        for path, text in programs.items():
            write_text(path, text)
        if report is not None:
            write_text(report, page_of_document(result.document()))
        write(outlets.output, (result.csv(),))
        if outlets.output != "-":
            emit(
                outlets.format,
                "-",
                table=lambda stream: draw(plan_view(result.document()), stream),
                document=result.document,
            )
