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
    full: Annotated[
        bool, Help("Summary with all predicted errors, standard errors, detection limits and similar effects.")
    ] = False,
    report: Report = None,
    outlets: CsvOutlets,
) -> None:
    """Plan a measurement: choose the poses worth measuring, order them, and predict the result.

    The CSV of --output lists the visits in order. --for iso9283 plans the cube of ISO 9283 and its five poses, with
    options of its own: robacc plan --for iso9283 --help.

    Example: robacc plan robot.yaml --for calibrate --poses 30 --output plan.csv
    """
    from robacc.cli.output import page_of_document, write_plan
    from robacc.errors import UsageError
    from robacc.io.files import write_text
    from robacc.render.text import warnings_below
    from robacc.render.views.elements import Form, draw
    from robacc.render.views.expected import plan_view

    outlets.check()
    if (validation_output is None) != (call.keywords["validation"] == 0):
        raise UsageError("--validation N and --validation-output FILE belong together")
    result = call()
    form: Form = "full" if full else "short"
    with warnings_below(result.warnings):
        programs = {} if program is None else result.programs(program)
        if validation_output is not None:
            write_text(validation_output, result.validation_csv())
        for path, text in programs.items():
            write_text(path, text)
        if report is not None:
            write_text(report, page_of_document(result.document()))
        names = str(call.keywords["model"] or call.keywords["robot"]), outlets.output
        write_plan(
            outlets,
            result.csv(),
            lambda stream: draw(plan_view(result.document(), form, *names), stream),
            result.document,
        )
