"""``robacc schema``: the JSON Schema of a command's result."""

from __future__ import annotations

from typing import Annotated

import typer

from robacc.cli.options import OutputOption


def schema(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Command whose result it is of; without one, their names.")
    ] = None,
    output: OutputOption = "-",
) -> None:
    """The JSON Schema of a command's result: every key, its unit, and which keys are always there.

    Example: robacc schema estimate -o estimate.schema.json
    """
    from robacc.api.schema import schema_names, schema_text
    from robacc.cli.output import write

    write(output, (schema_text(name),) if name is not None else (f"{one}\n" for one in schema_names()))
