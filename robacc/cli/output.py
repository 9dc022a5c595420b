"""Hand a finished result to standard output or to a file, whole or not at all: the end that commands share."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TextIO

from robacc.cli.options import Format
from robacc.results import InputFile, envelope


class Outlets(NamedTuple):
    """Where a result goes, and in which forms: what the shared options say."""

    form: Format
    output: str
    gate: str | None = None
    junit: str | None = None
    report: str | None = None


def deliver(
    outlets: Outlets,
    command: str,
    *,
    payload: Callable[[], Mapping[str, Any]],
    table: Callable[[TextIO], None],
    options: Mapping[str, Any],
    inputs: Sequence[InputFile],
    seed: int | None,
    warnings: Sequence[str] = (),
) -> None:
    """Say the warnings and write the result in the form that is wanted.

    Args:
        outlets: What is wanted, and where.
        command: The command's name, which is its schema's too.
        payload: Makes the result's own keys; called only where the document is needed.
        table: Draws the result onto a stream; called only where a table is wanted.
        options: Those that the figures depend on, by their names on the command line.
        inputs: The record of every file that was read.
        seed: Of what was drawn at random.
        warnings: Lines for standard error.

    Raises:
        InputError: a file cannot be written.
    """
    from robacc.report.console import say_warnings

    say_warnings(warnings)
    emit(
        outlets.form,
        outlets.output,
        table=table,
        document=lambda: envelope(command, payload(), options=options, inputs=inputs, seed=seed),
    )


def emit(
    form: Format, output: str, *, table: Callable[[TextIO], None], document: Callable[[], Mapping[str, Any]]
) -> None:
    """Write what is no result to judge as ``form`` to ``output`` (``-`` is standard output).

    Only the form that is wanted is made: ``table`` draws onto a stream, ``document`` builds the JSON document.

    Raises:
        InputError: the file cannot be written.
    """
    if form is Format.json:
        from robacc.io.result_json import json_pieces

        _write(output, json_pieces(document()))
    elif output == "-":
        table(sys.stdout)
        sys.stdout.flush()
    else:
        page = io.StringIO()
        table(page)
        _write(output, (page.getvalue(),))


def _write(output: str, pieces: Iterable[str]) -> None:
    if output == "-":
        sys.stdout.writelines(pieces)
        sys.stdout.flush()
        return
    from robacc.io.files import write_text

    write_text(output, "".join(pieces))
