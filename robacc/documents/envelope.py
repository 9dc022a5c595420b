"""Envelope of every result: what made it, numbers rounded so that all processors agree, and CSV text from columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.documents.keys import Key, Kind, Later, array, constant, count, part, table, text
from robacc.documents.parts import INPUT
from robacc.io.dialect import for_spreadsheet
from robacc.poses.reading import PoseFile
from robacc.quantities import SIGNIFICANT_DIGITS, number_text, significant
from robacc.version import __version__

# Rounding of a document's numbers to significant digits, so that documents agree on all processors.

_LARGEST_EXACT_POWER = 22
"""10^22 is the largest power of ten that a double holds exactly."""
_POWERS = 10.0 ** np.arange(_LARGEST_EXACT_POWER + 1)


def significant_document(value: Any) -> Any:
    """Return the document with every float rounded to :data:`SIGNIFICANT_DIGITS` significant digits."""
    # The types of most values come first, since the test of others is slow.
    if isinstance(value, float | np.floating):
        return significant(float(value))
    if isinstance(value, str | int | None):
        return value
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        return _significant_array(value)
    if isinstance(value, Later):
        return value.map(significant_document)
    if isinstance(value, Mapping):
        return {key: significant_document(item) for key, item in value.items()}
    return [significant_document(item) for item in value] if isinstance(value, Sequence) else value


def _significant_array(array: NDArray[Any]) -> NDArray[np.float64]:
    """Round each finite number of an array to :data:`SIGNIFICANT_DIGITS` significant digits, -0.0 to 0.0.

    An integer below 10^12 and 10^k up to k = 22 are exact, so their quotient is the double nearest to the decimal
    number and is written with no more digits than that. Numbers that need a larger power are rounded in a loop.
    """
    values = np.asarray(array, dtype=np.float64)
    size = np.abs(np.where(np.isfinite(values), values, 0.0))
    with np.errstate(divide="ignore"):
        places = SIGNIFICANT_DIGITS - 1 - np.floor(np.log10(size))
    exact = (places >= 0) & (places <= _LARGEST_EXACT_POWER)
    power = _POWERS[np.where(exact, places, 0.0).astype(np.int64)]
    rounded: NDArray[np.float64] = np.where(exact, np.rint(values * power) / power, values) + 0.0
    inexact = ~exact & (size > 0.0)
    rounded[inexact] = [significant(value) for value in values[inexact].tolist()]
    return rounded


# CSV text from columns.


def csv_text(columns: Mapping[str, Iterable[Any] | None]) -> str:
    """Return a header and a line for each row of columns by name; a column that is None is left out."""
    present = {name: map(_cell, column) for name, column in columns.items() if column is not None}
    return "".join(f"{','.join(row)}\n" for row in (present, *zip(*present.values(), strict=True)))


def _cell(value: Any) -> str:
    """Return a number as in results, or a text, in quotes where a reader would split it; a spreadsheet runs none."""
    if isinstance(value, float):
        return number_text(float(value))
    text = for_spreadsheet(str(value))
    return '"' + text.replace('"', '""') + '"' if any(sign in text for sign in ',"\n\r') else text


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
        stated = {"reading": self.reading, "identity": self.identity}
        own = {key: dict(texts) for key, texts in stated.items() if texts}
        return {"name": self.name, "sha256": self.sha256, "kind": self.kind, **own}


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


# The JSON Schema of a result, made from the declarations of its keys.

MODULES = {
    "calibrate": "fit",
    "check": "gate",
    "compare": "compare",
    "compare-paired": "compare",
    "correct": "expected",
    "effects": "descriptions",
    "estimate": "accuracy",
    "estimate-many": "accuracy",
    "export": "descriptions",
    "iso9283": "accuracy",
    "iso9283-poses": "accuracy",
    "plan": "expected",
    "predict": "expected",
    "robots": "descriptions",
    "show": "descriptions",
    "simulate": "descriptions",
    "trace": "fit",
}
"""Module of :mod:`robacc.documents` that declares a result, by the result's name, which is the declaration's too."""


def result_kind(name: str) -> Kind:
    """Return the declaration of a result: its envelope, then its own keys, of which an unknown command has none."""
    own = part({})
    if name in MODULES:
        own = getattr(import_module(f"robacc.documents.{MODULES[name]}"), name.upper().replace("-", "_"))
    envelope = {
        "schema": Key(constant(f"robacc.{name}/{schema_version(name)}"), "Name and version of this schema."),
        "robacc": Key(text, "Version of robacc that made the result."),
        "command": Key(constant(name), "Command that made the result."),
        "options": Key(table(), "Options that the figures depend on, by their names on the command line with _ for -."),
        "inputs": Key(array(INPUT), "Every input file."),
        "seed": Key(count | None, "Seed of all random numbers; null if there are none."),
    }
    return part({**envelope, **(own.keys or {})}, about=own.about)


def result_schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a result."""
    kind, version = result_kind(name), schema_version(name)
    shared: dict[str, Any] = {}
    schema = kind.schema(shared)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:robacc:schema:{name}:{version}",
        "title": f"robacc.{name}/{version}",
        "description": f"{kind.about} Lengths in m, angles in rad; missing numbers are null. Keys may be added.",
        **schema,
        "$defs": shared,
    }
