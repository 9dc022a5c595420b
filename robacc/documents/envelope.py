"""Envelope of every result: the version, command, options and inputs that made it, and nothing that varies by run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

from robacc.documents.digits import significant_document
from robacc.poses.reading import PoseFile
from robacc.version import __version__

_SCHEMA_VERSIONS = {"calibrate": 2, "trace": 2}
"""Schema versions other than 1. A version goes up when a key changes its name or meaning, not when keys are added."""


@dataclass(frozen=True, slots=True)
class InputFile:
    """One input file of a result."""

    name: str
    """File name without its folder, so that a result does not depend on the folder; ``-`` for a pipe."""
    sha256: str
    """Digest of the file's bytes, hexadecimal."""
    kind: str
    """``poses``, ``robot``, ``scale`` …"""
    reading: Mapping[str, Any] | None = None
    """Statements of the user on names of the file, such as units."""
    identity: Mapping[str, str] | None = None
    """Identity of the arm that a robot file states."""

    @classmethod
    def at(cls, path: str, sha256: str, kind: str, identity: Mapping[str, str] | None = None) -> InputFile:
        """Return the record of the file at ``path``."""
        reading = path.reading.document() if isinstance(path, PoseFile) else None
        return cls(str(path) if path == "-" else PurePath(path).name, sha256, kind, reading, identity)

    def document(self) -> dict[str, Any]:
        """Return the record as it stands in a result."""
        reading = {"reading": dict(self.reading)} if self.reading else {}
        identity = {"identity": dict(self.identity)} if self.identity else {}
        return {"name": self.name, "sha256": self.sha256, "kind": self.kind, **reading, **identity}


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
    """Return the complete document of a result: its envelope, then the keys of ``payload``.

    The document has no time and no path. On one machine, the same call on the same files gives the same bytes.

    Args:
        command: Name of the command.
        payload: Keys of the command's result.
        options: Options that the figures depend on, by their names on the command line.
        inputs: Input files.
        seed: Seed of random numbers, if the command uses any.
    """
    return {
        "schema": f"robacc.{command}/{schema_version(command)}",
        "robacc": __version__,
        "command": command,
        "options": dict(options),
        "inputs": [file.document() for file in inputs],
        "seed": seed,
        **significant_document(payload),
    }
