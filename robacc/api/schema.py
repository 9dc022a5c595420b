"""JSON Schemas of the results, which are files of the package."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from robacc.documents.envelope import schema_version
from robacc.errors import UsageError

_FOLDER = Path(__file__).parents[1] / "schemas"


def schema_names() -> tuple[str, ...]:
    """The commands whose results have a schema."""
    return tuple(sorted(path.stem.removeprefix("robacc.").rpartition("-")[0] for path in _FOLDER.glob("robacc.*.json")))


def schema_text(name: str) -> str:
    """The schema of a command's result as its file has it.

    Raises:
        UsageError: There is none of that name.
    """
    if name not in schema_names():
        raise UsageError(f"no schema {name!r}; there are {', '.join(schema_names())}")
    return (_FOLDER / f"robacc.{name}-{schema_version(name)}.json").read_text(encoding="utf-8")


def schema(name: str) -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a command's result.

    Args:
        name: Of the command, as in ``estimate``.

    Raises:
        UsageError: There is none of that name.

    Example:
        >>> import robacc
        >>> robacc.schema("estimate")["properties"]["n_poses"]["description"]
        'Measured poses (rows).'
    """
    found: dict[str, Any] = json.loads(schema_text(name))
    return found
