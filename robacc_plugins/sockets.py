"""A folder with a table of joints for each socket, as ``hole_0.csv`` and ``hole_1.csv`` of MUKCa, as one table.

The tip is in one socket in all rows of a table; its name is that of the file, with the folders below the one that is
read. A row is one pose; its numbers are the joints, named in a first line or in the order of the chain.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from robacc.errors import Problem, refuse
from robacc.geometry import Array
from robacc.io.column_table import ColumnTable
from robacc.io.table import TableOptions

_LARGEST = 1 << 24
"""Largest file, bytes: joints of a hundred thousand poses, which nobody drives to by hand."""
_FILES = 10_000
_FEWEST = 4
"""Joints of an arm; a list of points has fewer numbers in a row."""
_OTHERS = re.compile(r"(?i)(.*[^a-z])?([xyz]|kind|socket|plane|anchor|distance|u|v)([^a-z].*)?")
"""Names of columns that are no joints."""


class _Joints(NamedTuple):
    socket: str
    names: tuple[str, ...]
    values: Array
    """``(n, J)``, in the unit of the file."""
    lines: list[int]
    content: bytes


def takes(path: str, first: bytes) -> bool:
    """Return whether a folder has tables of joints alone."""
    return os.path.isdir(path) and next(_tables(path), None) is not None


def read(path: str, options: TableOptions) -> ColumnTable:
    """Return the joints of all tables, the socket of each row, and its place as the name of its pose.

    Raises:
        InputError: The tables have different joints.
    """
    found = list(_tables(path))
    poses = [table.socket for table in found if _are_poses(table.values)]
    tables = [table for table in found if table.socket not in poses]
    fix = "give each row of its pose the joints in which the tip was in the socket"
    refuse((not tables, Problem(f"{', '.join(poses)} hold poses of the hand, no joints", path, fix=fix)))
    names = tables[0].names
    for table in tables:
        message = f"has the columns {', '.join(table.names)}, expected {', '.join(names)} as {tables[0].socket} has"
        other = Problem(message, f"{path}/{table.socket}", fix="move what holds something else out of the folder")
        refuse((table.names != names, other))
    values = np.vstack([table.values for table in tables])
    columns = [*zip(names, values.T, strict=True)]
    columns.append(("socket", np.array([table.socket for table in tables for _ in table.lines])))
    columns.append(("pose", np.array([f"{table.socket}:{line}" for table in tables for line in table.lines])))
    rows = ", ".join(f"{table.socket} ({len(table.lines)} poses)" for table in tables)
    unread = f"; not read, because they hold poses of the hand: {', '.join(poses)}" if poses else ""
    digest = hashlib.sha256(b"".join(table.content for table in tables)).hexdigest()
    result = ColumnTable(columns, path, options.skip_gaps, digest, f"each file is a socket: {rows}{unread}")
    result.log.counted = "pose"
    return result


def _tables(path: str) -> Iterator[_Joints]:
    """Yield the tables of joints in a folder and in those below it, in the order of their names."""
    files = (file for end in ("csv", "txt") for file in Path(path).rglob(f"*.{end}"))
    for _, file in zip(range(_FILES), sorted(files), strict=False):
        if file.is_file() and file.stat().st_size <= _LARGEST:
            table = _joints(str(file.relative_to(path).with_suffix("")), file.read_bytes())
            if table is not None:
                yield table


def _joints(socket: str, content: bytes) -> _Joints | None:
    """Return the rows of a table of numbers, and the names above them; None for any other table."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return None
    lines = ((number, line.strip()) for number, line in enumerate(text.splitlines(), 1))
    cells = [(number, re.split(r"\s*[;,]\s*|\s+", line)) for number, line in lines if line and line[0] not in "#%"]
    names: tuple[str, ...] = ()
    if cells and not any(map(_is_number, cells[0][1])):
        names = tuple(cells.pop(0)[1])
    count = len(cells[0][1]) if cells else 0
    if count < _FEWEST or len(names) not in (0, count) or any(map(_OTHERS.fullmatch, names)):
        return None
    if not all(len(row) == count and all(map(_is_number, row)) for _, row in cells):
        return None
    values = np.array([[float(cell) for cell in row] for _, row in cells])
    names = names or tuple(f"q{i + 1}" for i in range(count))
    return _Joints(socket, names, values, [number for number, _ in cells], content)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _are_poses(values: Array) -> bool:
    """Return whether rows are positions and quaternions, which the controllers of some arms save beside the joints."""
    return values.shape[1] == 7 and bool(np.all(np.abs(np.linalg.norm(values[:, 3:], axis=1) - 1.0) < 1e-3))
