"""JSON Schemas of the results, made from the declarations of their keys."""

from __future__ import annotations

from typing import Any

from robacc.errors import UsageError


def schema_names() -> tuple[str, ...]:
    """Return the commands whose results have a schema."""
    from robacc.documents.envelope import MODULES

    return tuple(sorted(MODULES))


def schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a command's result.

    Args:
        name: Name of the command, such as ``estimate``.

    Raises:
        UsageError: No command of that name has a schema.

    Example:
        >>> import robacc
        >>> robacc.schema("estimate")["properties"]["n_poses"]["description"]
        'Measured poses (rows).'
    """
    from robacc.documents.envelope import MODULES, result_schema

    if name not in MODULES:
        raise UsageError(f"no schema {name!r}; choose one of {', '.join(schema_names())}")
    return result_schema(name)
