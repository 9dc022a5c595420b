"""Reader of the records of JSON, JSON Lines and YAML documents, and of arrays that NumPy saved by name."""

from __future__ import annotations

import hashlib
import io
import itertools
import json
import re
import zipfile
from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np

from robacc.errors import InputError, Problem, refuse
from robacc.io.column_table import ColumnTable
from robacc.io.files import TEXT_LIMIT, decode
from robacc.io.table import TableOptions

_SOCKET = re.compile(r"(?i)(hole|socket|cone|nest)s?[_ -]?\w*$")
"""Names of lists of the joints at which the tip was in one socket."""


def takes(path: str, first: bytes) -> bool:
    """Return whether a file is such a document, by its name or its first bytes."""
    text, name = first.removeprefix(b"\xef\xbb\xbf").lstrip(), path.lower()
    is_document = name.endswith((".yaml", ".yml")) or re.match(rb"\{|\[\s*[\[{]|(---\s+)?header:", text)
    return bool(first) and (bool(is_document) or _are_arrays(name, first))


def _are_arrays(file: str, first: bytes) -> bool:
    return first.startswith(b"\x93NUMPY") or (file.lower().endswith(".npz") and first.startswith(b"PK"))


def read_stream(stream: BinaryIO, file: str, options: TableOptions) -> ColumnTable:
    """Return the records of a document, which are its longest list, as a table.

    A record gives one row. Its columns are named by its keys, then the place in a list, then a unit at a key's end.

    Raises:
        InputError: The text is no such document, or has no records.
    """
    import yaml

    document: Any
    data = stream.read(TEXT_LIMIT)
    fix = "give a list of records, such as {joints: [...], position: [x, y, z]}, or export the poses as CSV"
    if is_of_arrays := _are_arrays(file, data[:6]):
        fix = "save arrays by name with a row for each pose, as numpy.savez(file, joints=…, position=…) does"
    text = "" if is_of_arrays else decode(data, file)
    try:
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        if len(lines) > 1 and all(line[0] + line[-1] == "{}" for line in lines):
            document = [json.loads(line) for line in lines]
        elif is_of_arrays:
            document = _arrays(data)
        elif text.lstrip()[:1] in ("{", "[") and not file.lower().endswith((".yaml", ".yml")):
            document = json.loads(text)
        elif any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, Loader=yaml.CSafeLoader)):
            raise ValueError("it has aliases")  # they could stand for more records than the memory holds
        else:
            # Messages of ros2 topic echo are a document each.
            documents = [item for item in yaml.load_all(text, Loader=yaml.CSafeLoader) if item is not None]
            document = documents[0] if len(documents) == 1 else documents
    except (ValueError, RecursionError, yaml.YAMLError, zipfile.BadZipFile, EOFError, OSError) as error:
        kind, why = "arrays" if is_of_arrays else "JSON or YAML", " ".join(str(error).split())[:200]
        raise InputError(Problem(f"cannot be read as {kind} ({why})", file, fix="export it again")) from None
    values: list[Any] = list(document.values()) if isinstance(document, dict) else []
    if values and all(isinstance(items, list) for items in values) and all(map(_SOCKET.match, map(str, document))):
        document = [{"socket": name, "joints": joints} for name, rows in document.items() for joints in rows]
    elif len(values) > 1 and all(isinstance(items, list) and len(items) == len(values[0]) for items in values):
        document = [dict(zip(document, items, strict=True)) for items in zip(*values, strict=True)]
    for keys, items in itertools.permutations((each for each in values if isinstance(each, list) and each), 2):
        # A list of names and one of rows, as MoveIt's joint states.
        if all(isinstance(n, str) for n in keys) and all(isinstance(r, list) and len(r) == len(keys) for r in items):
            values = [[dict(zip(keys, row, strict=True)) for row in items]]
    lists = [items for items in ([document] if isinstance(document, list) else values) if isinstance(items, list)]
    longest = max(lists, key=len, default=[])
    rows = [dict(_leaves(record, ())) for record in longest if isinstance(record, dict)]
    no_list = Problem("has no list of records, expected a table of poses", file, fix=fix)
    refuse((not rows or len(rows) < len(longest), no_list))
    names = dict.fromkeys(name for row in rows for name in row)
    columns = [(name, np.array([row.get(name) for row in rows], dtype=object)) for name in names]
    return ColumnTable(columns, file, options.skip_gaps, hashlib.sha256(data).hexdigest())


def _arrays(data: bytes) -> dict[str, Any]:
    """Return the rows of each array of a ``.npz`` file, or of each field of a ``.npy`` file, by its name.

    Raises:
        ValueError: An array has Python objects.
    """
    loaded = np.load(io.BytesIO(data), allow_pickle=False)
    names = loaded.dtype.names or () if isinstance(loaded, np.ndarray) else loaded.files
    arrays = {name: np.asarray(loaded[name]) for name in names}
    return {name: array.tolist() for name, array in arrays.items() if array.ndim}


def _leaves(value: Any, path: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    """Yield the name and value of each number and text in a record."""
    if isinstance(value, dict):
        names = value.get("name")
        for key, item in value.items():
            if isinstance(names, list) and isinstance(item, list) and item is not names and len(item) == len(names):
                # Lists beside one of names, as in joint states of ROS, have a value for each name.
                yield from ((f"{name}/{key}", entry) for name, entry in zip(names, item, strict=True))
            else:
                yield from _leaves(item, (*path, str(key)))
    elif isinstance(value, list):
        in_matrix = any(isinstance(item, list) for item in value) or (path and path[-1].isdecimal())
        for i, item in enumerate(value):
            yield from _leaves(item, (*path, str(i) if in_matrix else "xyz"[i] if len(value) == 3 else str(i + 1)))
    else:
        # A unit goes last.
        words = sorted("_".join(path).split("_"), key={"m", "mm", "um", "rad", "mrad", "deg"}.__contains__)
        yield "_".join(words), value
