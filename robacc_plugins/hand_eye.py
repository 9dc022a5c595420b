"""Reader of what programs of hand-eye calibration write without the names of columns.

Poses are 4 x 4 matrices below each other, or side by side in four lines, a file of the hand and one of the board; in a
log, below lines that say which they are of; or lines of the hand and of the eye in turn, ``hand,x,y,z,rx,ry,rz`` and
``eye,…``, in m and degrees about fixed axes. A table may have the entries of matrices as columns, ``m_00 … m_23``.
"""

from __future__ import annotations

import hashlib
import io
import itertools
import re
from collections.abc import Sequence
from functools import partial
from typing import BinaryIO

import numpy as np

from robacc.errors import Problem, refuse
from robacc.geometry import Array, nearest_rotation, quaternion_from_rotation
from robacc.io.column_table import ColumnTable
from robacc.io.dialect import NUMBER, number_of
from robacc.io.files import ProblemLog, bytes_of, decode
from robacc.io.table import Table, TableBody, TableOptions, TextTable
from robacc.poses.reading import QUATERNION, source_of
from robacc.poses.reshaped_tables import MATRIX_ENTRY, ReshapedTable, Rows

_NUMBERS = re.compile(r"[-+.\deE,;\s]*")
_SIZE = 4
_LAST = (0.0, 0.0, 0.0, 1.0)
_PAIR = re.compile(rf"^(hand|eye)((?:\s*,\s*{NUMBER.pattern}){{6}})\s*$", re.MULTILINE)
_BETWEEN = r"(?:[ \t]++(?:[,;][ \t]++)?|[,;][ \t]++)"
_LINE = rf"[ \t\[]*+(?>{NUMBER.pattern})(?:{_BETWEEN}(?>{NUMBER.pattern})){{3}}[ \t\],;]*+\n"
_CAPTIONED = re.compile(rf"^(?=[^\n]*?[A-Za-z]{{3}})(?P<caption>[^\n]*+)\n(?P<matrix>(?:{_LINE}){{4}})", re.MULTILINE)
"""A matrix in four lines below the line that says what it is of."""
_PARTS_OF = {0: "robot", 3: "camera"}
"""Words of the names of columns, by how surely an instrument measured the poses."""
_PARTS = {"hand": "robot", "eye": "camera"}
"""Words of the names of columns for the parts of a pair."""
_COORDINATES = ("X [m]", "Y [m]", "Z [m]", "roll [deg]", "pitch [deg]", "yaw [deg]")
_WIDE = 1000
"""Characters of a line that may be the first of many matrices side by side."""


def takes(path: str, first: bytes) -> bool:
    """Return whether a text has pairs, or numbers alone: matrices of four lines, or lines as long as those of many."""
    text = first.decode(errors="replace").lstrip("\ufeff")
    if _PAIR.match(text) or _named_matrices(text):
        return True
    if not first or not _NUMBERS.fullmatch(text):
        return False
    # The last line may be cut off.
    lines = [line for line in f"{text}\n".splitlines() if line.strip()]
    matrix = _matrices("\n".join(lines[:_SIZE])) if len(lines) >= _SIZE else None
    return matrix is not None or (len(lines) <= _SIZE and len(lines[0]) >= _WIDE)


def read_stream(stream: BinaryIO, file: str, options: TableOptions) -> Table:
    """Return a row for each pair, or of 16 entries for each matrix; a table of numbers where the text has neither.

    Raises:
        InputError: A line is of none of the two parts of a pair, or a part is missing.
    """
    data = bytes_of(stream, file)
    text = decode(data, file)
    if _PAIR.match(text):
        return _pairs(text, file, options, hashlib.sha256(data).hexdigest())
    if named := _named_matrices(text):
        return _table_of(named, file, options, hashlib.sha256(data).hexdigest())
    matrices = _matrices(text)
    if matrices is None:
        return TextTable(io.BytesIO(data), file, options)
    entries = [(f"m_{row}{column}", matrices[:, row, column]) for row in range(_SIZE) for column in range(_SIZE)]
    digest = hashlib.sha256(data).hexdigest()
    table = ColumnTable(entries, file, options.skip_gaps, digest, f"{len(matrices)} matrices of {_SIZE} lines")
    table.log.counted = "pose"
    return table


def _named_matrices(text: str) -> dict[str, list[Array]]:
    """Return the matrices below each caption of a log: the robot's, those of a camera or another instrument, others."""
    found: dict[str, list[Array]] = {}
    for match in _CAPTIONED.finditer(text):
        matrix = _matrices(re.sub(r"[\[\]]", " ", match["matrix"]))
        caption = " ".join(re.findall(r"[^\W\d_]+", match["caption"].lower()))
        name = _PARTS_OF.get(source_of(caption.split()), caption)
        if matrix is not None:
            found.setdefault(name, []).append(matrix[0])
    return found


def _table_of(named: dict[str, list[Array]], file: str, options: TableOptions, digest: str) -> ColumnTable:
    counts = [len(matrices) for matrices in named.values()]
    message = f"has {' and '.join(f'{len(matrices)} matrices of {name}' for name, matrices in named.items())}"
    fix = "leave out the poses without a partner"
    refuse((len({*counts}) > 1, Problem(message, file, fix=fix)))
    entries = [
        (f"{name}_{row}{column}", np.array([matrix[row, column] for matrix in matrices]))
        for name, matrices in named.items()
        for row in range(_SIZE)
        for column in range(_SIZE)
    ]
    table = ColumnTable(
        entries, file, options.skip_gaps, digest, f"matrices of {', '.join(named)} in the text of a log"
    )
    table.log.counted = "pose"
    return table


def _pairs(text: str, file: str, options: TableOptions, digest: str) -> ColumnTable:
    lines = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip()]
    found = [(i, _PAIR.fullmatch(line.strip())) for i, line in lines]
    expected = [*_PARTS] * (len(lines) // 2 + 1)
    wrong = next((i for (i, pair), part in zip(found, expected, strict=False) if not pair or pair[1] != part), None)
    wrong = lines[-1][0] if wrong is None and len(lines) % 2 else wrong
    form = "expected hand,x,y,z,rx,ry,rz and eye,x,y,z,rx,ry,rz in turn"
    refuse((wrong is not None, Problem("the line is not one of a pair", file, wrong, fix=form)))
    names = [f"{word} {name}" for word in _PARTS.values() for name in _COORDINATES]
    values = np.array([[float(cell) for cell in pair[2].split(",")[1:]] for _, pair in found if pair])
    columns = [*zip(names, values.reshape(-1, len(names)).T, strict=True)]
    table = ColumnTable(columns, file, options.skip_gaps, digest, "lines of hand and eye in turn")
    table.log.counted = "pose"
    return table


def _matrices(text: str) -> Array | None:
    """Return the matrices ``(N, 4, 4)``; None for other numbers."""
    lines = [re.split(r"[,;\s]+", line.strip(" \t,;")) for line in text.splitlines() if line.strip()]
    widths = {len(line) for line in lines}
    if len(lines) % _SIZE or len(widths) != 1 or widths.pop() % _SIZE or (len(lines) > _SIZE and len(lines[0]) > _SIZE):
        return None
    try:
        values = np.array(lines, dtype=float)
    except ValueError:
        return None
    matrices = values.reshape(len(lines) // _SIZE, _SIZE, -1, _SIZE).swapaxes(1, 2).reshape(-1, _SIZE, _SIZE)
    return matrices if (matrices[:, 3] == _LAST).all() else None


# Tables with a pose as the entries of a matrix: ``m_00 … m_23``, ``r11 … r33``.

_NO_POSE = r"(?i)intrinsic|camera_?matrix|covariance|(.*_)?k$"
"""Matrices that are no poses."""
_COUNTED = re.compile(r"(.*[A-Za-z])[_\[ (]*(\d\d?)[\])]?")
"""Name of an entry of a matrix with its place in a list."""


def _with_places(names: Sequence[str], sample: Sequence[str]) -> tuple[str, ...]:
    """Return names in which the 16 columns of a matrix that are counted, ``O_T_EE[0] …``, have their row and column.

    Where the entries 0, 0, 0, 1 of the first row are shows whether a matrix is by rows or, as of Franka, by columns.
    """
    result = [*names]
    for start in range(min(len(names), len(sample)) - _SIZE**2 + 1):
        parts = [_COUNTED.fullmatch(name.strip()) for name in names[start : start + _SIZE**2]]
        counts = [int(part[2]) if part else -1 for part in parts]
        stems = {part[1] if part else "" for part in parts}
        values = np.array([number_of(cell, False) for cell in sample[start : start + _SIZE**2]], dtype=float)
        entries = values.reshape(_SIZE, _SIZE)
        is_by_columns = (entries[:, -1] == _LAST).all()
        if len(stems) == 1 and counts == [*range(counts[0], counts[0] + 16)] and counts[0] in (0, 1):
            for i in range(_SIZE**2) if is_by_columns or (entries[-1] == _LAST).all() else ():
                row, column = divmod(i, _SIZE)[:: -1 if is_by_columns else 1]
                result[start + i] = re.sub("_d$", "_desired", f"{next(iter(stems))}") + f"_{row}_{column}"
    return tuple(result)


def _matrix_entries(names: Sequence[str]) -> tuple[str, dict[tuple[int, int], int]] | None:
    """Return the name of the first matrix among the names, and the column of each entry; None without a matrix."""
    found: dict[str, dict[tuple[int, int], int]] = {}
    for index, name in enumerate(names):
        if match := MATRIX_ENTRY.fullmatch(name.strip()):
            found.setdefault(match["stem"], {})[int(match["row"]), int(match["column"])] = index
    for (stem, entries), first in itertools.product(found.items(), (0, 1)):
        at = {(row - first, column - first): index for (row, column), index in entries.items()}
        needed = itertools.product(range(3), range(3 + (len(at) > 9)))
        if len(at) in (9, 12, 16) and at.keys() >= {*needed} and not re.search(_NO_POSE, stem):
            return stem if len(stem) > 2 else "", at
    return None


def with_poses(table: Table) -> Table:
    """Return a table with quaternions, and positions, in place of the entries of matrices."""
    table.names = _with_places(table.names, next(iter(table.dialect.sample), ()))
    while (found := _matrix_entries(table.names)) is not None:
        stem, at = found
        translation = [at[row, 3] for row in range(3)] if len(at) > 9 else []
        entries = [*translation, *(at[place] for place in itertools.product(range(3), range(3)))]
        new = [f"{stem} {name}".strip() for name in (*("X", "Y", "Z") * bool(translation), *QUATERNION)]
        what = "X, Y, Z and the orientation" if translation else "the orientation"
        remark = f"{table.names[min(entries)]} … {table.names[max(entries)]} as a matrix: {what}"
        make = partial(_poses_of_matrices, table.log, table.names[at[0, 0]])
        table = ReshapedTable(table, at.values(), dict.fromkeys(new), (entries, []), make, remark)
    return table


def _poses_of_matrices(log: ProblemLog, name: str, old: TableBody) -> Rows:
    """Return positions and quaternions; matrices that are no rotations go to the log."""
    split, entries, identity = len(old.numbers) - 9, old.numbers, np.eye(3)[:, :, None]
    # Entries that could not be read are in the log already.
    matrix = np.where(np.isfinite(entries).all(axis=0), entries[split:].reshape(3, 3, -1), identity)
    off = np.abs(np.einsum("ijn,kjn->ikn", matrix, matrix) - identity).max(axis=(0, 1), initial=0.0)
    # Largest difference of the product of a rotation matrix and its transpose from the identity.
    wrong = (off > 1e-3) | (np.linalg.det(np.moveaxis(matrix, 2, 0)) < 0)
    log.add_rows(wrong, old.lines, name, lambda i: "the entries are not those of a rotation matrix")
    # Entries are rounded.
    rotation = nearest_rotation(np.moveaxis(np.where(wrong, identity, matrix), 2, 0))
    return (np.arange(old.lines.size)[None], [*entries[:split], *quaternion_from_rotation(np.moveaxis(rotation, 0, 2))])
