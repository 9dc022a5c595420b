"""JSON Schemas of the results, stored as files of the package."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from robacc.documents.envelope import schema_version
from robacc.errors import UsageError

_FOLDER = Path(__file__).parents[1] / "schemas"


def schema_names() -> tuple[str, ...]:
    """Return the commands whose results have a schema."""
    return tuple(sorted(path.stem.removeprefix("robacc.").rpartition("-")[0] for path in _FOLDER.glob("robacc.*.json")))


def schema_text(name: str) -> str:
    """Return the text of the schema file of a command.

    Raises:
        UsageError: No command of that name has a schema.
    """
    if name not in schema_names():
        raise UsageError(f"no schema {name!r}; choose one of {', '.join(schema_names())}")
    return (_FOLDER / f"robacc.{name}-{schema_version(name)}.json").read_text(encoding="utf-8")


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
    document: dict[str, Any] = json.loads(schema_text(name))
    return document
