"""Write a result to standard output or to files, as a page too, with a progress bar meanwhile; commands share it."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any, TextIO

from robacc.cli import clock
from robacc.cli.options import Call, CsvOutlets, Format, Outlets, PlainFormat

if TYPE_CHECKING:
    from robacc.api.estimate import Estimate
    from robacc.api.fitting import FitResult
    from robacc.api.result import Result
    from robacc.documents.envelope import StoredResult
    from robacc.gates.evaluate import GateOutcome


# HTML page of results, for the command ``report`` and the option ``--report``.


def page_of_results(results: Sequence[StoredResult], identity: Mapping[str, str] | None = None) -> str:
    """Return the page of stored results, with the identity of what was tested if it is given.

    Raises:
        InputError: a result does not follow the schema of its command.
        UsageError: the extra ``report`` is not installed.
    """
    from robacc.documents.envelope import understood
    from robacc.render.page import page_of, result_of

    sections = []
    for number, result in enumerate(results, 1):
        with understood(result.name, result.command):
            sections.append(result_of(result.document, number))
    names = [result.record.name for result in results]
    # A number after each repeated name.
    unique = [
        name if names.count(name) == 1 else f"{name} ({names[: i + 1].count(name)})" for i, name in enumerate(names)
    ]
    return page_of(sections, unique, identity or {})


def page_of_document(document: Mapping[str, Any]) -> str:
    """Return the page of a result that was just computed, from the JSON text that would be stored."""
    import json

    from robacc.io.json_text import json_text
    from robacc.render.page import render

    return render([json.loads(json_text(document))], [str(document["command"])])


# Progress bar on standard error.


@contextmanager
def progress_bar() -> Iterator[Callable[[str, int, int], None]]:
    """Yield a function that shows progress on a terminal: label of the work, steps done, all steps."""
    if not sys.stderr.isatty() or os.environ.get("TERM") == "dumb":
        yield lambda label, done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    # The spinner and the clock move while a search, the longest step of all, is at work.
    shown = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*shown, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None)

        def show(label: str, done: int, total: int) -> None:
            bar.update(task, description=label, completed=done, total=total)

        yield show


def deliver(outlets: Outlets, result: Result, table: Callable[[TextIO], None]) -> None:
    """Check a result against the gate if there is one, and write it in the requested form, with its warnings below.

    Args:
        outlets: Forms and files.
        result: The result; its document is built only if it is needed.
        table: Draws the result onto a stream; called only for a table.

    Raises:
        InputError: a file cannot be written, or the gate cannot be read.
        typer.Exit: the gate did not pass: status 4 or 5.
    """
    from robacc.render.text import warnings_below

    if outlets.gate is None:
        with warnings_below(result.warnings):
            document = cache(result.document)
            write_result(outlets, result.command, document=document, table=table, gate=None, warnings=result.warnings)
        return
    from robacc.documents.gate import read_gate

    gated_document, outcome = result.gated(read_gate(outlets.gate))
    conclude(outlets, result.command, gated_document, table, outcome, result.warnings)


def deliver_fit(call: Call, write_model: str | None, outlets: Outlets, full: bool) -> None:
    """Run the call of a fit with a progress bar, write its model and deliver the result.

    A fit that did not converge ends with status 5, without a model. A fit that makes a data mistake likely ends with
    status 5 too; its model says so.

    Args:
        call: Call that gives the result of a fit.
        write_model: File for the model; None for none.
        outlets: Forms and files.
        full: A table has all that was computed.

    Raises:
        InputError: a file cannot be written, or the gate cannot be read.
        typer.Exit: the gate did not pass (status 4 or 5), or the fit did not converge or makes a data mistake
            likely (status 5).
    """
    import typer

    from robacc.render.text import say_warnings

    with progress_bar() as progress:
        result: FitResult = call(progress=progress)
    if write_model is not None and result.converged:
        result.write_model(write_model)
    deliver(outlets, result, lambda stream: result.draw(stream, full, write_model))
    if result.suspicions and write_model is not None:
        say_warnings((f"{write_model} must not be used until the suspected data mistake is resolved",))
    if result.suspicions or not result.converged:
        raise typer.Exit(5)


def conclude(
    outlets: Outlets,
    command: str,
    document: Mapping[str, Any],
    table: Callable[[TextIO], None] | None,
    outcome: GateOutcome,
    warnings: Sequence[str] = (),
) -> None:
    """Write a result with a gate, with the warnings of both below, and exit with the status of the gate.

    Args:
        outlets: Forms and files.
        command: Name of the command.
        document: JSON document with the gate.
        table: Draws the result; None to write the outcome of the gate only.
        outcome: Outcome of the gate.
        warnings: Warnings of the result.

    Raises:
        InputError: a file cannot be written.
        typer.Exit: the gate did not pass: status 4 or 5.
    """
    import typer

    from robacc.render.text import warnings_below

    warnings = (*warnings, *outcome.warnings)
    with warnings_below(warnings):
        if outlets.junit is not None:
            from robacc.io.files import write_text
            from robacc.outcomes import FileOutcome
            from robacc.render.views.gate import junit

            gate = document["gate"]
            checked = FileOutcome(gate["name"], outcome.exit_status, gate=gate, seconds=clock.elapsed())
            write_text(outlets.junit, junit(command, [checked], clock.started()))
        write_result(
            outlets,
            command,
            document=lambda: document,
            table=with_gate(table, document["gate"], outlets.form),
            gate=document["gate"],
            warnings=warnings,
        )
        if outcome.exit_status and (outlets.form == "json" or outlets.output != "-"):
            from robacc.render.views.gate import say_gate

            say_gate(document["gate"])
    if outcome.exit_status:
        raise typer.Exit(outcome.exit_status)


def with_gate(
    table: Callable[[TextIO], None] | None, gate: Mapping[str, Any], form: Format
) -> Callable[[TextIO], None]:
    """Return a function that draws a result and, for a table, its gate below; other forms write the gate themselves."""
    from robacc.render.views.elements import draw
    from robacc.render.views.gate import gate_view

    def drawn(stream: TextIO) -> None:
        if table is not None:
            table(stream)
        if form == "table":
            stream.write("\n" if table is not None else "")
            draw(gate_view(gate), stream)

    return drawn


def write_result(
    outlets: Outlets,
    command: str,
    *,
    document: Callable[[], Mapping[str, Any]],
    table: Callable[[TextIO], None],
    gate: Mapping[str, Any] | None,
    warnings: Sequence[str],
) -> None:
    """Write a result; the HTML page comes first, so that its failure leaves nothing on standard output.

    Args:
        outlets: Forms and files.
        command: Name of the command.
        document: Makes the JSON document, with the gate; called only if it is needed.
        table: Draws the result onto a stream.
        gate: The gate's part of the document.
        warnings: Warnings of the result and the gate, for the forms that contain them.

    Raises:
        InputError: a file cannot be written.
    """
    if outlets.report is not None:
        from robacc.io.files import write_text

        write_text(outlets.report, page_of_document(document()))
    if outlets.form in ("table", "json"):
        emit(outlets.form, outlets.output, table=table, document=document)
        return
    from robacc.render.text import as_options
    from robacc.render.views.gate import github_annotations, markdown

    text_of = markdown if outlets.form == "markdown" else github_annotations
    write(outlets.output, (text_of(command, page_text(table), gate, tuple(map(as_options, warnings))),))


def emit(
    form: PlainFormat, output: str, *, table: Callable[[TextIO], None], document: Callable[[], Mapping[str, Any]]
) -> None:
    """Write a table or a JSON document to ``output`` (``-`` is standard output).

    Only the requested form is made: ``table`` draws onto a stream, ``document`` builds the JSON document.

    Raises:
        InputError: the file cannot be written.
    """
    if form == "json":
        from robacc.io.json_text import json_pieces

        write(output, json_pieces(document()))
    elif output == "-":
        table(sys.stdout)
        sys.stdout.flush()
    else:
        write(output, (page_text(table),))


def write_plan(
    outlets: CsvOutlets, csv: str, table: Callable[[TextIO], None], document: Callable[[], Mapping[str, Any]]
) -> None:
    """Write the CSV of planned poses if it has a file, then the summary unless the CSV is on standard output.

    Raises:
        InputError: the file cannot be written.
    """
    if outlets.output is not None:
        write(outlets.output, (csv,))
    if outlets.output != "-":
        emit(outlets.format, "-", table=table, document=document)


def table_of(result: Estimate, path: str, robot: str | None, full: bool) -> Callable[[TextIO], None]:
    """Return what draws an estimate onto a stream, in one screen unless ``full``."""
    from robacc.documents.accuracy import ESTIMATE_ITSELF
    from robacc.render.views.accuracy import estimate_view
    from robacc.render.views.elements import Form, draw

    form: Form = "full" if full else "short"
    return lambda stream: draw(estimate_view(ESTIMATE_ITSELF.write(result), path, robot, form), stream)


def page_text(table: Callable[[TextIO], None]) -> str:
    """Return the drawing as plain text."""
    page = io.StringIO()
    table(page)
    return page.getvalue()


def write(output: str, pieces: Iterable[str]) -> None:
    """Write text to a file, or to standard output if ``output`` is ``-``; a failure leaves no partial file.

    Raises:
        InputError: the file cannot be written.
    """
    if output == "-":
        sys.stdout.writelines(pieces)
        sys.stdout.flush()
        return
    from robacc.io.files import write_pieces

    write_pieces(output, pieces)
