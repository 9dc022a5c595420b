"""``robacc show schema``: the JSON Schema of a command's result."""

from __future__ import annotations

from typing import Annotated

from robacc.api.parameters import Help
from robacc.cli.options import Output


def schema(
    name: Annotated[str | None, Help("Name of a command; without it, the names are listed.", "[NAME]")] = None,
    *,
    output: Output = "-",
) -> None:
    """Print the JSON Schema of a command's result: keys, units and required keys.

    Example: robacc show schema estimate -o estimate.schema.json
    """
    from robacc.api import schema as schemas
    from robacc.cli.output import write
    from robacc.io.json_text import json_text

    write(
        output,
        (json_text(schemas.schema(name)),)
        if name is not None
        else (f"{command}\n" for command in schemas.schema_names()),
    )
