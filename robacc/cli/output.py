"""Write a result to standard output or to files; commands share it."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

from robacc.cli.options import OUTPUTS, Format, PlainFormat

if TYPE_CHECKING:
    from robacc.api.fitting import FitResult
    from robacc.api.result import Result
    from robacc.gates.evaluate import GateOutcome


class Outlets(NamedTuple):
    """Forms and files of a result, from the options that commands share."""

    form: Format
    output: str
    gate: str | None = None
    junit: str | None = None
    report: str | None = None


def deliver(outlets: Outlets, result: Result, table: Callable[[TextIO], None]) -> None:
    """Write the warnings of a result, check it against the gate if there is one, and write it in the requested form.

    Args:
        outlets: Forms and files.
        result: The result; its document is built only if it is needed.
        table: Draws the result onto a stream; called only for a table.

    Raises:
        InputError: a file cannot be written, or the gate cannot be read.
        typer.Exit: the gate did not pass: status 4 or 5.
    """
    from robacc.render.text.console import say_warnings

    say_warnings(result.warnings)
    if outlets.gate is None:
        document = cache(result.document)
        write_result(outlets, result.command, document=document, table=table, outcome=None, warnings=result.warnings)
        return
    from robacc.documents.gate_files import read_gate

    gated_document, outcome = result.gated(read_gate(outlets.gate))
    say_warnings(outcome.warnings)
    conclude(outlets, result.command, gated_document, table, outcome, result.warnings)


def deliver_fit(write_model: str | None, outlets: Outlets, result: FitResult, table: Callable[[TextIO], None]) -> None:
    """Write the model of a fit and deliver the result; a fit that did not converge ends with status 5, without a model.

    Args:
        write_model: File for the model; None for none.
        outlets: Forms and files.
        result: Result of a fit.
        table: Draws the result onto a stream.

    Raises:
        InputError: a file cannot be written, or the gate cannot be read.
        typer.Exit: the gate did not pass (status 4 or 5), or the fit did not converge (status 5).
    """
    import typer

    if write_model is not None and result.converged:
        result.write_model(write_model)
    deliver(outlets, result, table)
    if not result.converged:
        raise typer.Exit(5)


def conclude(
    outlets: Outlets,
    command: str,
    document: Mapping[str, Any],
    table: Callable[[TextIO], None] | None,
    outcome: GateOutcome,
    warnings: Sequence[str] = (),
) -> None:
    """Write a result with a gate, and exit with the status of the gate.

    Args:
        outlets: Forms and files.
        command: Name of the command.
        document: JSON document with the gate.
        table: Draws the result; None to write the outcome of the gate only.
        outcome: Outcome of the gate.
        warnings: Warnings of the result, which were written already.

    Raises:
        InputError: a file cannot be written.
        typer.Exit: the gate did not pass: status 4 or 5.
    """
    import typer

    if outlets.junit is not None:
        from robacc.io.files import write_text
        from robacc.render.text.junit import junit

        write_text(outlets.junit, junit(command, outcome))
    write_result(
        outlets,
        command,
        document=lambda: document,
        table=with_gate(table, outcome, outlets.form),
        outcome=outcome,
        warnings=(*warnings, *outcome.warnings),
    )
    if outcome.exit_status:
        if outlets.form is Format.json or outlets.output != "-":
            from robacc.render.text.gate import say_gate

            say_gate(outcome)
        raise typer.Exit(outcome.exit_status)


def with_gate(table: Callable[[TextIO], None] | None, outcome: GateOutcome, form: Format) -> Callable[[TextIO], None]:
    """Return a function that draws a result and, for a table, its gate below; other forms write the gate themselves."""
    from robacc.render.text.gate import draw_gate

    def draw(stream: TextIO) -> None:
        if table is not None:
            table(stream)
        if form is Format.table:
            stream.write("\n" if table is not None else "")
            draw_gate(outcome, stream)

    return draw


def write_result(
    outlets: Outlets,
    command: str,
    *,
    document: Callable[[], Mapping[str, Any]],
    table: Callable[[TextIO], None],
    outcome: GateOutcome | None,
    warnings: Sequence[str],
) -> None:
    """Write a result; the HTML page comes first, so that its failure leaves nothing on standard output.

    Args:
        outlets: Forms and files.
        command: Name of the command.
        document: Makes the JSON document, with the gate; called only if it is needed.
        table: Draws the result onto a stream.
        outcome: Outcome of the gate.
        warnings: Warnings of the result and the gate, which were written already.

    Raises:
        InputError: a file cannot be written.
    """
    if outlets.report is not None:
        from robacc.cli.pages import page_of_document
        from robacc.io.files import write_text

        write_text(outlets.report, page_of_document(document()))
    from robacc.render.text.parameter_names import as_options

    texts = tuple(map(as_options, warnings))
    if outlets.form is Format.markdown:
        from robacc.render.text.markdown import markdown

        write(outlets.output, (markdown(command, page_text(table), outcome, texts),))
    elif outlets.form is Format.github:
        from robacc.render.text.annotations import github_annotations

        write(outlets.output, (github_annotations(command, page_text(table), outcome, texts),))
    else:
        emit(PlainFormat(outlets.form.value), outlets.output, table=table, document=document)


def emit(
    form: PlainFormat, output: str, *, table: Callable[[TextIO], None], document: Callable[[], Mapping[str, Any]]
) -> None:
    """Write a table or a JSON document to ``output`` (``-`` is standard output).

    Only the requested form is made: ``table`` draws onto a stream, ``document`` builds the JSON document.

    Raises:
        InputError: the file cannot be written.
    """
    if form is PlainFormat.json:
        from robacc.io.json_text import json_pieces

        write(output, json_pieces(document()))
    elif output == "-":
        table(sys.stdout)
        sys.stdout.flush()
    else:
        write(output, (page_text(table),))


def check_call(parameters: Mapping[str, Any]) -> None:
    """Raise an error for options that cannot work, before anything is computed.

    Raises:
        UsageError: an output has no name or would overwrite an input or another output, standard input is named twice,
            ``--junit`` is given without ``--gate``, or a library that ``--report`` needs is not installed.
        InputError: the gate cannot be read, or an output is a folder or in a folder that does not exist.
    """
    from robacc.errors import UsageError

    if parameters.get("junit") is not None and parameters.get("gate") is None:
        raise UsageError("--junit writes the outcome of a gate, so it needs --gate")
    if parameters.get("report") is not None:
        from robacc.render.plots.optional_dependencies import need

        need("matplotlib", "plotly", "jinja2")
    texts = [text for name, value in parameters.items() if name not in OUTPUTS for text in _texts(value)]
    if texts.count("-") > 1:
        raise UsageError("standard input can be read only once, but - is given more than once; name files")
    inputs = [text for text in texts if _is_file(text)]
    # A gate from a pipe can be read only once, which happens when there is a result to check.
    if (gate := parameters.get("gate")) is not None and not _is_stream(gate):
        from robacc.documents.gate_files import baseline_path, read_gate

        inputs += [baseline_path(gate, name) for name in read_gate(gate).gate.baselines]
    _check_outputs(parameters, inputs)


def refuse_json_beside_csv(form: PlainFormat, output: str) -> None:
    """Refuse a JSON document where the command's CSV would go to standard output too.

    Raises:
        UsageError: ``form`` is JSON and the CSV has no file.
    """
    from robacc.errors import UsageError

    if form is PlainFormat.json and output == "-":
        raise UsageError("--format json needs --output, the CSV that it describes")


def _check_outputs(parameters: Mapping[str, Any], inputs: Sequence[str]) -> None:
    from robacc.errors import UsageError
    from robacc.io.files import target_of

    is_folder_allowed = len(_texts(parameters.get("poses"))) > 1
    written: dict[str, str] = {}
    for name in sorted(OUTPUTS & parameters.keys()):
        option = f"--{name.replace('_', '-')}"
        for path in _texts(parameters[name]):
            if not path:
                raise UsageError(f"{option}: expected the name of a file, found nothing")
            if path == "-":
                other = written.setdefault(path, option)
                if other != option:
                    raise UsageError(f"{other} and {option} both name standard output; name a file for one of them")
                continue
            if _is_file(path) and any(os.path.samefile(path, file) for file in inputs):
                raise UsageError(f"{option} {path} is also an input and would be overwritten; name another file")
            other = written.setdefault(os.path.realpath(path), option)
            if other != option:
                raise UsageError(f"{other} and {option} both name {path}; name two files")
            # With several files of poses, each result is a file in a folder, which is made.
            if not (is_folder_allowed and (path.endswith(("/", os.sep)) or os.path.isdir(path))):
                target_of(path)


def _texts(value: Any) -> tuple[str, ...]:
    if isinstance(value, str):
        return (value,)
    return tuple(item for item in value if isinstance(item, str)) if isinstance(value, list | tuple) else ()


def _is_stream(path: str) -> bool:
    return path == "-" or (os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path))


def _is_file(path: str) -> bool:
    try:
        return os.path.isfile(path)
    except ValueError:  # a NUL in the name
        return False


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
