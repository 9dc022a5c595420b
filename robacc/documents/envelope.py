"""What every result carries: which tool made it, from what, and how, and nothing that changes from run to run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

from robacc.documents.digits import significant_document
from robacc.version import __version__

_SCHEMA_VERSIONS = {"calibrate": 2, "trace": 2}
"""Versions of the schemas that are not at their first; one goes up when a key of the result changes its name or
meaning, and stays when keys are added."""


@dataclass(frozen=True, slots=True)
class InputFile:
    """One file that a result was computed from."""

    name: str
    """File name without its folder, so that the same data give the same result wherever they lie; ``-`` for a pipe."""
    sha256: str
    """Of the file's bytes, hexadecimal."""
    kind: str
    """``poses``, ``robot``, ``scale`` …"""

    @classmethod
    def at(cls, path: str, sha256: str, kind: str) -> InputFile:
        """The record of the file at ``path``."""
        return cls(path if path == "-" else PurePath(path).name, sha256, kind)


def schema_version(command: str) -> int:
    """Return the version of the schema that results of ``command`` follow."""
    return _SCHEMA_VERSIONS.get(command, 1)


def envelope(
    command: str,
    payload: Mapping[str, Any],
    *,
    options: Mapping[str, Any],
    inputs: Sequence[InputFile],
    seed: int | None,
) -> dict[str, Any]:
    """The whole document of a result: how it was made, then the keys of ``payload`` beside it.

    There is no clock in it and no path of a machine: on one machine the same call on the same files
    gives the same bytes. ``options``
    are those that the figures depend on, by their names on the command line.
    """
    return {
        "schema": f"robacc.{command}/{schema_version(command)}",
        "robacc": __version__,
        "command": command,
        "options": dict(options),
        "inputs": [{"name": file.name, "sha256": file.sha256, "kind": file.kind} for file in inputs],
        "seed": seed,
        **significant_document(payload),
    }
