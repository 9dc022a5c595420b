"""Read a stored result, with a check of its values by the declarations of its keys, its poses, and an identity."""

from __future__ import annotations

import json
import math
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.documents.envelope import InputFile, result_kind, schema_version
from robacc.documents.keys import shortened
from robacc.errors import InputError, Problem, UsageError
from robacc.io.files import read_text, sha256_of
from robacc.robots.description import IDENTITY
from robacc.robots.description import read_identity as read_section

RESULT_LIMIT = 256 * 2**20
"""Largest result in bytes: enough for an estimate of half a million poses at some 480 bytes each."""
_SCHEMA = re.compile(r"robacc\.([a-z0-9][a-z0-9-]*)/([0-9]{1,6})")
_CUT_SHORT = re.compile(r"[-+.\w]*\s*")
"""Text after the error in a truncated file: nothing, or a part of a number or word."""


@dataclass(frozen=True, slots=True)
class StoredResult:
    """A stored result."""

    document: Mapping[str, Any]
    command: str
    """Command that made the result."""
    sha256: str
    """Digest of the file's bytes, hexadecimal."""
    name: str
    """Path of the file as given; ``-`` is standard input."""

    @property
    def record(self) -> InputFile:
        """Return the record of the file, for results computed from it."""
        return InputFile.at(self.name, self.sha256, "result")


def read_result(path: str) -> StoredResult:
    """Return the result in a JSON file.

    Args:
        path: File to read; ``-`` is standard input.

    Raises:
        InputError: The file cannot be read, is larger than :data:`RESULT_LIMIT`, is not JSON or is truncated, has a
            repeated key or a number that is not finite, is not a result of robacc, has another schema version, or has
            values that are not of the declared kinds.
    """
    name = "<stdin>" if path == "-" else path
    document = _parsed(read_text(path, RESULT_LIMIT), name)
    return StoredResult(document, _checked(document, name), sha256_of(path), path)


@contextmanager
def understood(name: str, command: str) -> Iterator[None]:
    """Turn errors from missing or unexpected values of a document into an input error of its file.

    Raises:
        InputError: The document differs from what the command writes.
    """
    try:
        yield
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        defect = (
            f"has no key {error.args[0]!r}" if isinstance(error, KeyError) else f"has an unexpected value ({error})"
        )
        fix = "compute the result again with this version of robacc"
        raise InputError(Problem(f"is a result of robacc {command}, but {defect}", name, fix=fix)) from error


def _parsed(text: str, name: str) -> Any:
    """Return the document, of any JSON type."""
    if not text.strip():
        raise InputError(Problem("is empty", name, fix="save the result as JSON"))
    try:
        document = json.loads(
            text, object_pairs_hook=_unique_keys, parse_constant=_refused, parse_float=_finite, parse_int=_whole
        )
        if "\\u" in text:
            # JSON can spell half of a surrogate pair, which is not a character and cannot be printed or written.
            json.dumps(document, ensure_ascii=False).encode()
    except json.JSONDecodeError as error:
        if _CUT_SHORT.fullmatch(text, error.pos) or error.msg.startswith("Unterminated string"):
            raise InputError(Problem("is incomplete; the file was truncated", name, error.lineno)) from None
        fix = None if text.lstrip()[0] in "{[" else "save the result as JSON"
        message = f"is not JSON: {error.msg} at character {error.colno}"
        raise InputError(Problem(message, name, error.lineno, fix=fix)) from None
    except RecursionError:
        raise InputError(Problem("is nested more deeply than any result", name)) from None
    except UnicodeEncodeError:
        raise InputError(Problem("contains half of a surrogate pair, which is not a character", name)) from None
    except ValueError as error:  # of the hooks
        raise InputError(Problem(f"is not a result: {error}", name)) from None
    return document


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        ((repeated, _),) = Counter(key for key, _ in pairs).most_common(1)
        raise ValueError(f"an object has the key {repeated[:60]!r} twice")
    return entries


def _refused(constant: str) -> float:
    raise ValueError(f"{constant} is not a number of JSON")


def _finite(text: str) -> float:
    if not math.isfinite(float(text)):
        raise ValueError(f"the number {text[:40]} is too large")
    return float(text)


def _whole(text: str) -> int:
    _finite(text)
    return int(text)


def _checked(document: Any, name: str) -> str:
    """Return the command of a result, after a check of its schema version and of every value that it declares.

    Raises:
        InputError: The document is not a result of this version of robacc; with every value that is not of its kind.
    """
    if not isinstance(document, Mapping) or "schema" not in document:
        reason = "it has no key 'schema'" if isinstance(document, Mapping) else "it is not a JSON object"
        raise InputError(Problem(f"is not a result of robacc: {reason}", name, fix="save the result as JSON"))
    match = _SCHEMA.fullmatch(document["schema"]) if isinstance(document["schema"], str) else None
    if match is None:
        message = f"found {shortened(document['schema'])}, expected robacc.COMMAND/VERSION"
        raise InputError(Problem(message, name, column="schema"))
    command, version = match[1], int(match[2])
    if version != schema_version(command):
        message = (
            f"has version {version} of the schema, from robacc {shortened(document.get('robacc', 'unknown'))}; this "
            f"robacc reads version {schema_version(command)}"
        )
        fix = "compute the result again with this robacc, or read it with the robacc that made it"
        raise InputError(Problem(message, name, column="schema", fix=fix))
    # Readers need some keys of every result.
    needed = dict.fromkeys(("robacc", "command", "options", "inputs"))
    problems = result_kind(command).problems({**needed, **document})
    if found := [Problem(message, name, column=path) for path, message in problems]:
        raise InputError(found)
    return command


# A result as columns with one entry for each row of the poses, for tables and arrays in a notebook.

Document = Mapping[str, Any]
Columns = dict[str, NDArray[Any]]
_LABELS = ("line", "pose", "cycle", "target", "time_s", "temperature_c", "payload_kg", "used")


def pose_columns(document: Document) -> Columns:
    """Return the columns of the poses: ids, circumstances, joints, positions in m, errors in m and rad.

    Every column has as many entries as there are rows. A result without poses gives no column.
    """
    poses = document.get("poses")
    if not isinstance(poses, Mapping) or poses.get("line") is None:
        return {}
    columns: Columns = {name: np.asarray(poses[name]) for name in _LABELS if poses.get(name) is not None}
    if poses.get("q") is not None:
        columns |= {f"q{i + 1}": values for i, values in enumerate(np.asarray(poses["q"], dtype=float).T)}
    for prefix, key in (("cmd_", "commanded_m"), ("", "attained_m")):
        columns |= _vector(f"{prefix}{{}}_m", poses.get(key))
    for unit, quantity, name in (("m", "position", "error"), ("rad", "orientation", "turn")):
        stages = poses.get(f"errors_{unit}")
        if isinstance(stages, Mapping):
            errors = {f"{stage}_error": rows for stage, rows in stages.items()}
        else:
            errors = {name: (document.get(quantity) or {}).get(f"errors_{unit}")}
        for own, rows in errors.items():
            columns |= _vector(f"{own}_{{}}_{unit}", rows)
            if rows is not None:
                columns[f"{own}_{unit}"] = np.linalg.norm(np.asarray(rows, dtype=float), axis=1)
    return columns


def _vector(pattern: str, rows: object) -> Columns:
    if rows is None:
        return {}
    return {pattern.format(axis): values for axis, values in zip("xyz", np.asarray(rows, dtype=float).T, strict=True)}


# Identity of what was tested, for a report: the arm's serial number, the instrument, who measured where and when.


def read_identity(sources: Sequence[str]) -> dict[str, str]:
    """Return the identity of YAML files and of texts ``key=value``; a later source replaces a key of an earlier one.

    Raises:
        InputError: A file cannot be read, has an unknown key or a value that is not one line of text.
        UsageError: A text has an unknown key.
    """
    from robacc.io.yaml_nodes import Source, compose, nearest

    identity: dict[str, str] = {}
    for source in sources:
        key, sign, value = (word.strip() for word in source.partition("="))
        if not sign or os.path.isfile(source):
            file = Source(source)
            top = file.section(compose(read_text(source), source), "", tuple(IDENTITY))
            stated = {} if top is None else read_section(top)
            file.finish()
            if not stated:
                fix = f"write at least one of {', '.join(IDENTITY)}"
                raise InputError(Problem("names nothing of what was tested", source, fix=fix))
            identity |= stated
        elif key not in IDENTITY:
            fix = nearest(key, tuple(IDENTITY)) or f"known keys: {', '.join(IDENTITY)}"
            raise UsageError(f"`identity`: unknown key {key!r}; {fix}")
        elif not value or not value.isprintable():
            raise UsageError(f"`identity`: expected one line of text for {key}, found {value!r}")
        else:
            identity[key] = value
    return {key: identity[key] for key in IDENTITY if key in identity}
