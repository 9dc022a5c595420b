"""A stored result, read back: the JSON document that a command wrote, checked as far as every reader relies on it."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from robacc.documents.envelope import InputFile, schema_version
from robacc.errors import InputError, Problem
from robacc.io.files import read_text, sha256_of

RESULT_LIMIT = 256 * 2**20
"""Largest result that is read, bytes: an estimate of half a million poses, some 480 bytes each, fits."""
_SCHEMA = re.compile(r"robacc\.([a-z0-9][a-z0-9-]*)/([0-9]{1,6})")
_CUT_SHORT = re.compile(r"[-+.\w]*\s*")
"""What is left from the place of the error on where a file was cut short: nothing, or a piece of a number or word."""
_ENVELOPE: tuple[tuple[str, type, str], ...] = (
    ("robacc", str, "the version that made it"),
    ("options", Mapping, "its options"),
    ("inputs", list, "the list of its input files"),
)
"""What every result carries (:func:`robacc.documents.envelope.envelope`) and readers rely on."""


@dataclass(frozen=True, slots=True)
class StoredResult:
    """A result as it was stored."""

    document: Mapping[str, Any]
    command: str
    """That made it."""
    sha256: str
    """Of the file's bytes, hexadecimal."""
    name: str
    """The file, as it was named; ``-`` is standard input."""

    @property
    def record(self) -> InputFile:
        """Of the file, for what is computed from it."""
        return InputFile.at(self.name, self.sha256, "result")


def read_result(path: str) -> StoredResult:
    """The result in a JSON file.

    Args:
        path: File to read; ``-`` is standard input.

    Raises:
        InputError: The file cannot be read, is larger than :data:`RESULT_LIMIT`, is no JSON (or cut short), holds a
            key twice or a number that is none, is no result of robacc, or one of another version of its schema.
    """
    name = "<stdin>" if path == "-" else path
    document = _parsed(read_text(path, RESULT_LIMIT), name)
    return StoredResult(document, _checked(document, name), sha256_of(path), path)


@contextmanager
def understood(name: str, command: str) -> Iterator[None]:
    """Turn what a document lacks, or has of another kind than its command writes, into an error of the file.

    Raises:
        InputError: the document is not what the command writes.
    """
    try:
        yield
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        told = f"has no key {error.args[0]!r}" if isinstance(error, KeyError) else f"is not as expected ({error})"
        message = f"is a result of robacc {command}, but {told}"
        fix = "make it again with this version of robacc"
        raise InputError(Problem(message, name, fix=fix)) from error


def _parsed(text: str, name: str) -> Any:
    """The document, of any type."""
    if not text.strip():
        raise InputError(Problem("is empty", name, fix="make it with --format json --output FILE"))
    try:
        document = json.loads(text, object_pairs_hook=_once, parse_constant=_refused, parse_float=_finite)
        if "\\u" in text:
            # Half of a surrogate pair, which JSON can spell, is no character: nothing could print or write it again.
            json.dumps(document, ensure_ascii=False).encode()
    except json.JSONDecodeError as error:
        if _CUT_SHORT.fullmatch(text, error.pos) or error.msg.startswith("Unterminated string"):
            raise InputError(Problem("ends in the middle: it was cut short", name, error.lineno)) from None
        fix = None if text.lstrip()[0] in "{[" else "results are stored with --format json"
        message = f"is not JSON: {error.msg} at character {error.colno}"
        raise InputError(Problem(message, name, error.lineno, fix=fix)) from None
    except RecursionError:
        raise InputError(Problem("is nested more deeply than any result", name)) from None
    except UnicodeEncodeError:
        raise InputError(Problem("holds half of a surrogate pair, which is no character", name)) from None
    except ValueError as error:  # of the hooks, or an integer of thousands of digits
        raise InputError(Problem(f"is no result: {error}", name)) from None
    return document


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [key for key, _ in pairs]
        twice = next(key for key in names if names.count(key) > 1)
        raise ValueError(f"the key {twice[:60]!r} stands twice in one object")
    return found


def _refused(constant: str) -> float:
    raise ValueError(f"{constant} is no number, and JSON does not have it")


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"the number {text[:40]} is too large")
    return number


def _checked(document: Any, name: str) -> str:
    """The command of a document that is a result of this schema's version.

    Raises:
        InputError: It is none.
    """
    if not isinstance(document, Mapping) or "schema" not in document:
        found = "it has no key 'schema'" if isinstance(document, Mapping) else "it is no JSON object"
        raise InputError(Problem(f"is no result of robacc: {found}", name, fix="make it with --format json"))
    match = _SCHEMA.fullmatch(document["schema"]) if isinstance(document["schema"], str) else None
    if match is None:
        message = f"found {_short(document['schema'])}, expected robacc.COMMAND/VERSION"
        raise InputError(Problem(message, name, column="schema"))
    command, version = match[1], int(match[2])
    if version != schema_version(command):
        maker = _short(document.get("robacc", "unknown"))
        message = (
            f"is version {version} of the schema, made by robacc {maker}; this robacc reads {schema_version(command)}"
        )
        fix = "make the result again with this robacc, or read it with the one that made it"
        raise InputError(Problem(message, name, column="schema", fix=fix))
    problems = []
    if document.get("command") != command:
        message = f"found {_short(document.get('command'))}, but the schema is of {command!r}"
        problems.append(Problem(message, name, column="command"))
    for key, kind, meaning in _ENVELOPE:
        if not isinstance(document.get(key), kind):
            problems.append(Problem(f"{meaning} is expected here, found {_short(document.get(key))}", name, column=key))
    inputs = document.get("inputs")
    for i, record in enumerate(inputs if isinstance(inputs, list) else []):
        good = isinstance(record, Mapping) and all(isinstance(record.get(k), str) for k in ("name", "sha256", "kind"))
        if not good:
            problems.append(Problem("name, sha256 and kind of a file are expected here", name, column=f"inputs[{i}]"))
    if problems:
        raise InputError(problems)
    return command


def _short(value: Any) -> str:
    """What was found, at a length that a message takes."""
    text = "nothing" if value is None else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}…"
