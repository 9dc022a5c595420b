"""Hand a finished result to standard output or to a file, whole or not at all."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TextIO

from robacc.cli.options import Format


def emit(
    form: Format, output: str, *, table: Callable[[TextIO], None], document: Callable[[], Mapping[str, Any]]
) -> None:
    """Write a result as ``form`` to ``output`` (``-`` is standard output).

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
