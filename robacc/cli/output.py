"""Hand a finished result to standard output or to a file, whole or not at all: the end that commands share."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

from robacc.cli.options import OUTPUTS, Format, PlainFormat

if TYPE_CHECKING:
    from robacc.api.result import Result
    from robacc.gates.evaluate import GateOutcome


class Outlets(NamedTuple):
    """Where a result goes, and in which forms: what the shared options say."""

    form: Format
    output: str
    gate: str | None = None
    junit: str | None = None
    report: str | None = None


def deliver(outlets: Outlets, found: Result, table: Callable[[TextIO], None]) -> None:
    """Say a result's warnings, judge it where a gate is given, and write it in the form that is wanted.

    Args:
        outlets: What is wanted, and where.
        found: The result; its document is made only where it is needed.
        table: Draws the result onto a stream; called only where a table is wanted.

    Raises:
        InputError: a file cannot be written, or the gate cannot be read.
        typer.Exit: the gate was not passed: status 4 or 5.
    """
    from robacc.render.text.console import say_warnings

    say_warnings(found.warnings)
    if outlets.gate is None:
        document = cache(found.document)
        write_result(outlets, found.command, document=document, table=table, found=None, warnings=found.warnings)
        return
    from robacc.documents.gate_files import read_gate

    judged_document, outcome = found.gated(read_gate(outlets.gate))
    say_warnings(outcome.warnings)
    conclude(outlets, found.command, judged_document, table, outcome, found.warnings)


def conclude(
    outlets: Outlets,
    command: str,
    document: Mapping[str, Any],
    table: Callable[[TextIO], None] | None,
    found: GateOutcome,
    warnings: Sequence[str] = (),
) -> None:
    """Write a judged result, and end the command with the gate's exit status.

    Args:
        outlets: What is wanted, and where.
        command: The command's name.
        document: The result with its gate.
        table: Draws the result itself; None where the gate's outcome is all there is.
        found: The gate's outcome.
        warnings: Of the result, said already.

    Raises:
        InputError: a file cannot be written.
        typer.Exit: the gate was not passed: status 4 or 5.
    """
    import typer

    if outlets.junit is not None:
        from robacc.io.files import write_text
        from robacc.render.text.junit import junit

        write_text(outlets.junit, junit(command, found))
    every = (*warnings, *found.warnings)
    shown = with_gate(table, found, outlets.form)
    write_result(outlets, command, document=lambda: document, table=shown, found=found, warnings=every)
    if found.exit_status:
        raise typer.Exit(found.exit_status)


def with_gate(table: Callable[[TextIO], None] | None, found: GateOutcome, form: Format) -> Callable[[TextIO], None]:
    """Draws a result's report with its gate below; forms other than the table show the gate in a way of their own."""
    from robacc.render.text.gate import draw_gate

    def shown(stream: TextIO) -> None:
        if table is not None:
            table(stream)
        if form is Format.table:
            stream.write("\n" if table is not None else "")
            draw_gate(found, stream)

    return shown


def write_result(
    outlets: Outlets,
    command: str,
    *,
    document: Callable[[], Mapping[str, Any]],
    table: Callable[[TextIO], None],
    found: GateOutcome | None,
    warnings: Sequence[str],
) -> None:
    """Write a result, judged or not: the page first, so that what fails there leaves nothing on standard output.

    Args:
        outlets: What is wanted, and where.
        command: The command's name.
        document: Makes the result's JSON document, with its gate; called only where it is needed.
        table: Draws the result onto a stream.
        found: The gate's outcome.
        warnings: Of the result and its gate, said already.

    Raises:
        InputError: a file cannot be written.
    """
    if outlets.report is not None:
        from robacc.cli.pages import page_of_document
        from robacc.io.files import write_text

        write_text(outlets.report, page_of_document(document()))
    if outlets.form is Format.markdown:
        from robacc.render.text.markdown import markdown

        write(outlets.output, (markdown(command, page_text(table), found, tuple(warnings)),))
    elif outlets.form is Format.github:
        from robacc.render.text.annotations import github_annotations

        write(outlets.output, (github_annotations(command, page_text(table), found, tuple(warnings)),))
    else:
        emit(PlainFormat(outlets.form.value), outlets.output, table=table, document=document)


def emit(
    form: PlainFormat, output: str, *, table: Callable[[TextIO], None], document: Callable[[], Mapping[str, Any]]
) -> None:
    """Write what is no result to judge as ``form`` to ``output`` (``-`` is standard output).

    Only the form that is wanted is made: ``table`` draws onto a stream, ``document`` builds the JSON document.

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
    """Refuse a call that would end badly before it computes anything: by its parameters' names and values.

    Raises:
        UsageError: an output has no name, or would overwrite an input or another output, standard input is named twice,
            ``--junit`` stands without ``--gate``, or ``--report`` without the libraries it takes.
        InputError: the gate cannot be read, or an output is a folder or in one that does not exist.
    """
    from robacc.errors import UsageError

    if parameters.get("junit") is not None and parameters.get("gate") is None:
        raise UsageError("--junit writes the outcome of a gate, so it needs --gate")
    if parameters.get("report") is not None:
        from robacc.render.plots.optional_dependencies import need

        need("matplotlib", "plotly", "jinja2")
    named = [one for name, value in parameters.items() if name not in OUTPUTS for one in _texts(value)]
    if named.count("-") > 1:
        raise UsageError("standard input can be read once, and - names it twice; name files")
    inputs = [one for one in named if _is_file(one)]
    # A gate that comes through a pipe can be read once: later, when there is a result to judge.
    if (gate := parameters.get("gate")) is not None and not _is_stream(gate):
        from robacc.documents.gate_files import baseline_path, read_gate

        inputs += [baseline_path(gate, name) for name in read_gate(gate).gate.baselines]
    _check_outputs(parameters, inputs)


def _check_outputs(parameters: Mapping[str, Any], inputs: Sequence[str]) -> None:
    from robacc.errors import UsageError
    from robacc.io.files import target_of

    several = len(_texts(parameters.get("poses"))) > 1
    written: dict[str, str] = {}
    for name in sorted(OUTPUTS & parameters.keys()):
        option = f"--{name.replace('_', '-')}"
        for path in _texts(parameters[name]):
            if not path:
                raise UsageError(f"{option} names no file")
            if path == "-":
                other = written.setdefault(path, option)
                if other != option:
                    raise UsageError(f"{other} and {option} both name standard output; name a file for one of them")
                continue
            if _is_file(path) and any(os.path.samefile(path, one) for one in inputs):
                raise UsageError(f"{option} {path} is an input too, and would be overwritten; name another file")
            other = written.setdefault(os.path.realpath(path), option)
            if other != option:
                raise UsageError(f"{other} and {option} both name {path}; name two files")
            # Of several files of poses each has a file of its own in a folder, which is made.
            if not (several and (path.endswith(("/", os.sep)) or os.path.isdir(path))):
                target_of(path)


def _texts(value: Any) -> tuple[str, ...]:
    if isinstance(value, str):
        return (value,)
    return tuple(one for one in value if isinstance(one, str)) if isinstance(value, list | tuple) else ()


def _is_stream(path: str) -> bool:
    return path == "-" or (os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path))


def _is_file(path: str) -> bool:
    try:
        return os.path.isfile(path)
    except ValueError:  # a NUL in the name
        return False


def page_text(table: Callable[[TextIO], None]) -> str:
    """What a report draws, as plain text."""
    page = io.StringIO()
    table(page)
    return page.getvalue()


def write(output: str, pieces: Iterable[str]) -> None:
    """Write text to a file, whole or not at all, or to standard output where ``output`` is ``-``.

    Raises:
        InputError: the file cannot be written.
    """
    if output == "-":
        sys.stdout.writelines(pieces)
        sys.stdout.flush()
        return
    from robacc.io.files import write_pieces

    write_pieces(output, pieces)
