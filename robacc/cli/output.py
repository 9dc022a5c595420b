"""Where results go: the options that commands add to those of their calls, and writing a result as they say.

Nothing here imports NumPy or its users before there is a result.
"""

import io
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, partial
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import typer

from robacc.api.parameters import Help
from robacc.render.text import Section, as_options, draw, warnings_below
from robacc.workers import FileOutcome

if TYPE_CHECKING:
    from robacc.api.result import Result

Call = partial[Any]
"""Call of a command with the arguments of its options."""


View = Callable[[], Iterable[Section]]
"""Makes the sections of a result."""


Document = Callable[[], Mapping[str, Any]]
"""Makes the JSON document of a result."""
Format = Literal["table", "json", "markdown", "github"]
_FORM = "Form of the output: github writes annotations of a run, markdown a job summary."
_OUTPUT = ("output", "o")

SummaryFormat = Annotated[Format, Help(_FORM)]
"""Form of the summary of a command whose ``--output`` is a file of targets."""
PlainFormat = Annotated[
    Literal["table", "json"] | None, Help("Form of the output; default: json if `output` ends in .json, else table.")
]
"""Form of output that no gate applies to."""
CsvFormat = Annotated[Literal["table", "json"], Help("Form of the output.")]
"""Form of the summary of a command that writes a CSV."""
Output = Annotated[str, Help("File to write; - is standard output.", "FILE", names=_OUTPUT, holds="output")]
CsvOutput = Annotated[
    str | None,
    Help("CSV to write; - is standard output, without the summary.", "FILE", names=_OUTPUT, holds="output"),
]
Report = Annotated[str | None, Help("HTML page to write, with charts and tables.", "FILE", holds="output")]
WriteModel = Annotated[str | None, Help("Robot file to write, with the fitted model.", "FILE", holds="output")]

started = time.time()
"""Start of the command that runs, seconds since 1970, for JUnit files; no figure depends on it."""


class Outlets(NamedTuple):
    """Forms and files of a result."""

    gate: Annotated[str | None, Help("Gate file (YAML) with criteria; exit 4: fail, 5: inconclusive.", "FILE")] = None
    junit: Annotated[str | None, Help("JUnit XML to write, with the outcome of the gate.", "FILE", holds="output")] = (
        None
    )
    report: Report = None
    format: Annotated[Format | None, Help(f"{_FORM} Default: by the ending of `output`, .json or .md, else table.")] = (
        None
    )
    output: Output = "-"

    @property
    def form(self) -> Format:
        """Form of the result: that of ``--format``, else JSON or Markdown if the output's name ends so."""
        ending = os.path.splitext(self.output)[1].lower()
        return self.format or ("json" if ending == ".json" else "markdown" if ending == ".md" else "table")


@contextmanager
def progress_bar() -> Iterator[Callable[[str, int, int], None]]:
    """Yield a function that shows progress on a terminal: label of the work, steps done, all steps; 0 is unknown.

    There is no bar before the first call.
    """
    if not sys.stderr.isatty() or os.environ.get("TERM") == "dumb":
        yield lambda label, done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    # The spinner and the clock move while a search, the longest step of all, is at work.
    shown = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    bar = Progress(*shown, console=Console(stderr=True), transient=True)
    task = bar.add_task("", total=None)

    def show(label: str, done: int, total: int) -> None:
        bar.start()
        bar.update(task, description=label, completed=done, total=total or None)

    try:
        yield show
    finally:
        bar.stop()


def deliver(outlets: Outlets, result: "Result", view: View | None = None) -> None:
    """Write a result in the requested form, with its gate if there is one, and with the warnings of both below.

    Args:
        outlets: Forms and files.
        result: The result; its document is built only if it is needed.
        view: Makes the sections of a table; called only for one. None is that of the result.

    Raises:
        InputError: a file cannot be written, or the gate cannot be read.
        typer.Exit: the gate did not pass: status 4 or 5.
    """
    document, gate, warnings = with_gate(result, outlets.gate)
    status = 0 if gate is None else gate["exit_status"]
    with warnings_below(warnings):
        if gate is not None:
            checked = FileOutcome(gate["name"], status, gate=gate, seconds=time.time() - started)
            write_junit(outlets.junit, result.command, [checked])
        write_result(outlets, result.command, document, view or result.view, gate, warnings)
        if gate is not None and status and (outlets.form == "json" or outlets.output != "-"):
            from robacc.render.views.compare import say_gate

            say_gate(gate)
    if status:
        raise typer.Exit(status)


def with_gate(result: "Result", gate: str | None) -> tuple[Document, Mapping[str, Any] | None, tuple[str, ...]]:
    """Return what makes the document of a result, the gate's part of it if there is one, and the warnings of both."""
    document = cache(partial(result.document, gate=gate))
    outcome = document()["gate"] if gate is not None or result.command == "check" else None
    return document, outcome, tuple(dict.fromkeys((*result.warnings, *(outcome or {"warnings": ()})["warnings"])))


def write_extra(
    command: str, result: Any, extra: str | None, full: bool, poses: str, robot: str | None
) -> tuple[View, int]:
    """Write the errors of each pose of an estimate, or the model of a fit; return the view and the exit status.

    A fit that did not converge ends with status 5, without a model. A fit that makes a data mistake likely ends with
    status 5 too; its model says so.
    """
    if command == "estimate":
        write(extra, result.per_pose_pieces)
        return partial(result.view, full, poses, robot), 0
    if extra is not None and result.converged:
        result.write_model(extra)
    return partial(result.view, full, extra), 5 * bool(result.suspicions or not result.converged)


def write_junit(path: str | None, command: str, outcomes: Sequence[FileOutcome]) -> None:
    """Write the outcomes of a gate as JUnit XML."""
    from robacc.render.views.compare import junit

    write(path, partial(junit, command, outcomes, started))


def write_result(
    outlets: Outlets,
    command: str,
    document: Document,
    view: View,
    gate: Mapping[str, Any] | None,
    warnings: Sequence[str],
) -> None:
    """Write a result; the HTML page comes first, so that its failure leaves nothing on standard output.

    Args:
        outlets: Forms and files.
        command: Name of the command.
        document: Makes the JSON document, with the gate; called only if it is needed.
        view: Makes the sections above the gate.
        gate: The gate's part of the document, which stands below the table.
        warnings: Warnings of the result and the gate, for the forms that contain them.

    Raises:
        InputError: a file cannot be written.
    """
    if outlets.report is not None:
        from robacc.io.json_text import json_text
        from robacc.render.page import render

        write(outlets.report, render([json.loads(json_text(document()))], [command]))
    from robacc.render.views import compare as gates

    if outlets.form in ("table", "json"):
        return emit(
            outlets.form, outlets.output, lambda: [*view(), *([] if gate is None else gates.gate_view(gate))], document
        )
    text_of = gates.markdown if outlets.form == "markdown" else gates.github_annotations
    write(outlets.output, text_of(command, _page(view()), gate, tuple(map(as_options, warnings))))


def emit(form: Format | None, output: str, view: View, document: Document) -> None:
    """Write a table or a JSON document to ``output`` (``-`` is standard output); only the one that is written is made.

    Without a form, a name that ends in .json gets the document.

    Raises:
        InputError: the file cannot be written.
    """
    if (form or ("json" if output.lower().endswith(".json") else "table")) == "json":
        from robacc.io.json_text import json_pieces

        write(output, json_pieces(document()))
    elif output == "-":
        draw(view())
    else:
        write(output, _page(view()))


def _page(sections: Iterable[Section]) -> str:
    """Return the sections of a view as plain text."""
    page = io.StringIO()
    draw(sections, page)
    return page.getvalue()


def write(output: str | None, text: str | bytes | Iterable[str] | Callable[[], str | Iterable[str]]) -> None:
    """Write text to a file, or to standard output if ``output`` is ``-``; a failure leaves no partial file.

    Args:
        output: The file; None, of an option that was not given, writes nothing.
        text: The text, its pieces, or a function that makes them if there is a file; bytes of a file only.

    Raises:
        InputError: the file cannot be written.
    """
    from robacc.io.files import write_file

    if output is not None:
        write_file(output, text() if callable(text) else text)
