"""JSON Schemas of the results, which are files of the package."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from robacc.errors import UsageError
from robacc.results import SCHEMA_VERSION

_FOLDER = Path(__file__).parents[1] / "schemas"


def schema_names() -> tuple[str, ...]:
    """The commands whose results have a schema."""
    ending = f"-{SCHEMA_VERSION}.json"
    return tuple(sorted(path.name[len("robacc.") : -len(ending)] for path in _FOLDER.glob(f"robacc.*{ending}")))


def schema_text(name: str) -> str:
    """The schema of a command's result as its file has it.

    Raises:
        UsageError: There is none of that name.
    """
    if name not in schema_names():
        raise UsageError(f"no schema {name!r}; there are {', '.join(schema_names())}")
    return (_FOLDER / f"robacc.{name}-{SCHEMA_VERSION}.json").read_text(encoding="utf-8")


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
