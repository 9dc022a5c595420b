"""Tables with a pose as the entries of a matrix, as hand-eye calibrations write it: ``m_00 … m_23``, ``r11 … r33``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array, quaternion_from_rotation
from robacc.io.open_table import Table
from robacc.io.problem_log import ProblemLog
from robacc.io.table_parts import Header, TableBody

_ENTRY = re.compile(r"(?P<stem>.*?[a-zA-Z])[_.\[(, ]*(?P<row>[0-4])[_., \])\[(]*(?P<column>[0-4])[\])]*")
_ORTHONORMAL = 1e-3
"""Largest difference of the product of a rotation matrix and its transpose from the identity."""


@dataclass(frozen=True, slots=True)
class _MatrixPlaces:
    """Columns of a matrix's entries."""

    rotation: tuple[int, ...]
    """Nine columns, row by row."""
    translation: tuple[int, ...]
    """Columns of x, y, z; empty where the matrix has three columns."""
    others: tuple[int, ...]
    """Further entries: the last row of a homogeneous matrix."""


def _places(names: Sequence[str]) -> _MatrixPlaces | None:
    """Return the columns of the only matrix among the names; None where there is none."""
    found: dict[str, dict[tuple[int, int], int]] = {}
    for index, name in enumerate(names):
        if match := _ENTRY.fullmatch(name.strip()):
            found.setdefault(match["stem"], {})[int(match["row"]), int(match["column"])] = index
    for entries in found.values():
        for first in (0, 1):
            at = {(row - first, column - first): index for (row, column), index in entries.items()}
            rotation = [at.get((row, column)) for row in range(3) for column in range(3)]
            if None in rotation or len(at) not in (9, 12, 16):
                continue
            translation = [at.get((row, 3)) for row in range(3)]
            if len(at) > 9 and None in translation:
                continue
            used = {*rotation, *translation}
            return _MatrixPlaces(
                tuple(i for i in rotation if i is not None),
                tuple(i for i in translation if i is not None),
                tuple(i for i in at.values() if i not in used),
            )
    return None


class MatrixTable:
    """A table with quaternions, and positions, in place of the entries of matrices."""

    def __init__(self, table: Table, header: Header, places: _MatrixPlaces) -> None:
        """Take the matrix's columns."""
        self._table, self._old, self._places = table, header, places
        used = {*places.rotation, *places.translation, *places.others}
        self._kept = [i for i in range(len(header.names)) if i not in used]
        self._new = [*(("X", "Y", "Z") if places.translation else ()), "qw", "qx", "qy", "qz"]
        self.log: ProblemLog = table.log
        self.file = table.file

    @classmethod
    def of(cls, table: Table, header: Header) -> MatrixTable | None:
        """Return the table, or None where its names are of no matrix."""
        places = _places(header.names)
        return None if places is None else cls(table, header, places)

    @property
    def sha256(self) -> str:
        """Digest of the file's bytes."""
        return self._table.sha256

    def header(self) -> Header:
        """Return the names of the other columns, then those of the pose."""
        units = {k: self._old.cell_units[i] for k, i in enumerate(self._kept) if i in self._old.cell_units}
        return replace(self._old, names=(*(self._old.names[i] for i in self._kept), *self._new), cell_units=units)

    def description(self) -> str:
        """Return what the matrix was taken for."""
        entries = (*self._places.rotation, *self._places.translation)
        first, last = self._old.names[min(entries)], self._old.names[max(entries)]
        what = "X, Y, Z and the orientation" if self._places.translation else "the orientation"
        return ", ".join(filter(None, (self._table.description(), f"{first} … {last} as a matrix: {what}")))

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return the numbers of these columns, converted where they are the pose's."""
        n = len(self._kept)
        plain = [self._kept[i] for i in numbers if i < n]
        wanted = [*self._places.translation, *self._places.rotation] if any(i >= n for i in numbers) else []
        old = self._table.body([*plain, *wanted], [self._kept[i] for i in texts])
        pose = self._pose(old.numbers[len(plain) :], old.lines) if wanted else np.zeros((0, 0))
        place = {index: row for row, index in enumerate(plain)}
        table = [old.numbers[place[self._kept[i]]] if i < n else pose[i - n] for i in numbers]
        return replace(old, numbers=np.array(table).reshape(len(numbers), -1))

    def _pose(self, entries: Array, lines: NDArray[np.int64]) -> Array:
        """Return ``(4 or 7, N)`` positions and quaternions; matrices that are no rotations go to the log."""
        split = len(self._places.translation)
        matrix = entries[split:].reshape(3, 3, -1)
        product = np.einsum("ijn,kjn->ikn", matrix, matrix) - np.eye(3)[:, :, None]
        off = np.abs(product).max(axis=(0, 1), initial=0.0)
        # Entries that could not be read are in the log already.
        read = np.isfinite(entries).all(axis=0)
        wrong = read & ((off > _ORTHONORMAL) | (np.linalg.det(np.moveaxis(matrix, 2, 0)) < 0))
        name = self._old.names[self._places.rotation[0]]
        self.log.add_rows(wrong, lines, name, lambda i: "the entries are not those of a rotation matrix")
        matrix = np.where(wrong | ~read, np.eye(3)[:, :, None], matrix)
        # The nearest rotation: entries are rounded.
        left, _, right = np.linalg.svd(np.moveaxis(matrix, 2, 0))
        return np.concatenate((entries[:split], quaternion_from_rotation(np.moveaxis(left @ right, 0, 2))))
