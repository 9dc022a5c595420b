"""Tables of another shape: without a header, poses as matrices, one row an axis, or several targets a row."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Note, Problem
from robacc.geometry import Array, quaternion_from_rotation
from robacc.io.dialect import PLAIN, TableDialect
from robacc.io.files import ProblemLog, clip
from robacc.io.open_table import Table
from robacc.io.table import Header, TableBody
from robacc.poses.columns import AXES, QUATERNION, axis_and_label, heading_of, is_point_name

# Tables without a header whose form is known: TUM trajectories, and point lists of SpatialAnalyzer.

_TUM = ("time", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
_UNIT_LENGTH = 1e-3
_POINT = ("X", "Y", "Z")
_UNCERTAINTY = ("Ux", "Uy", "Uz")


def with_known_names(header: Header, file: str | None) -> Header:
    """Return the header with the names that the rows themselves show.

    Raises:
        InputError: The rows have no known form; without ``file`` their columns stay numbered.
    """
    dialect = header.dialect
    is_named = dialect is PLAIN or not dialect.headerless
    names = _tum(dialect) or _matrix(dialect) or _spatial_analyzer(dialect)
    if is_named or names is not None or file is None:
        return header if is_named or names is None else Header(names, header.line, dialect)
    fix = (
        "begin the file with the columns' names, or name them with `columns`: a file with entries such as "
        "'column 1: x_mm', which the command init writes"
    )
    raise InputError(Problem("found numbers, expected a header row", file, header.line, fix=fix))


def _tum(dialect: TableDialect) -> tuple[str, ...] | None:
    """Return the names of a TUM trajectory: eight numbers, the last four a unit quaternion with w last."""
    rows = [_numbers(fields) for fields in dialect.sample]
    if not rows or dialect.separator is not None or any(row is None or len(row) != len(_TUM) for row in rows):
        return None
    lengths = [math.hypot(*row[4:]) for row in rows if row is not None]
    return _TUM if all(abs(length - 1) < _UNIT_LENGTH for length in lengths) else None


def _matrix(dialect: TableDialect) -> tuple[str, ...] | None:
    """Return the names of a homogeneous matrix, row by row, at the end of each row; joints stand before it."""
    rows = [_numbers(fields) for fields in dialect.sample]
    if not rows or any(row is None or len(row) < 16 or row[-4:] != [0, 0, 0, 1] for row in rows):
        return None
    return (
        *(f"J{i + 1}" for i in range(len(dialect.sample[0]) - 16)),
        *(f"m_{row}{column}" for row in range(4) for column in range(4)),
    )


def _spatial_analyzer(dialect: TableDialect) -> tuple[str, ...] | None:
    """Return the names of a point list: collection, group and point, of which some may be missing, then x, y, z."""
    first = dialect.sample[0] if dialect.sample else ()
    texts = next((i for i, text in enumerate(first) if dialect.is_number(text)), 0)
    numbers = len(first) - texts
    if not 1 <= texts <= 3 or not any("spatialanalyzer" in line.lower().replace(" ", "") for line in dialect.preamble):
        return None
    labels = ("Collection", "Group", "Point")[3 - texts :]
    if numbers == 3:
        return (*labels, *_POINT)
    return (*labels, *_POINT, *_UNCERTAINTY) if numbers == 6 else None


def _numbers(fields: Sequence[str]) -> list[float] | None:
    try:
        return [float(text) for text in fields]
    except ValueError:
        return None


# Tables with a pose as the entries of a matrix, as hand-eye calibrations write it: ``m_00 … m_23``, ``r11 … r33``.

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
    stem: str
    """Name of the matrix."""
    others: tuple[int, ...]
    """Further entries: the last row of a homogeneous matrix."""


def _places(names: Sequence[str]) -> _MatrixPlaces | None:
    """Return the columns of the only matrix among the names; None where there is none."""
    found: dict[str, dict[tuple[int, int], int]] = {}
    for index, name in enumerate(names):
        if match := _ENTRY.fullmatch(name.strip()):
            found.setdefault(match["stem"], {})[int(match["row"]), int(match["column"])] = index
    for stem, entries in found.items():
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
                stem if len(stem) > 2 else "",
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
        self._new = [
            f"{places.stem} {name}".strip() for name in ("X Y Z " * bool(places.translation) + "qw qx qy qz").split()
        ]
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


_AXIS_NAMES = frozenset({"axis", "achse", "coordinate", "koordinate", "coord", "component", "komponente"})
_COUNTED = dict(zip(("q0", "q1", "q2", "q3"), QUATERNION, strict=True))
_MEASURED = frozenset({"value", "wert", "measured", "actual", "ist", "messwert", "istwert", "act", "meas", "result"})
_NOMINAL = frozenset({"nominal", "nom", "soll", "sollwert", "commanded", "cmd", "reference", "ref"})


def reshaped(table: Table, header: Header, target_names: Sequence[str] | None) -> tuple[Table, Header]:
    """Return a table with one row a measured target, and its header; the given ones where they have this shape.

    Args:
        table: Table whose header was read.
        header: That header.
        target_names: Targets of the robot file; None: any label of columns is a target.
    """
    header = _with_joint_names(with_known_names(header, table.file))
    while matrices := MatrixTable.of(table, header):
        table, header = matrices, matrices.header()
    new: _AxisRows | _TargetsInRows | None = _AxisRows.of(table, header)
    if new is None:
        new = _TargetsInRows.of(table, header, target_names)
    return (table, header) if new is None else (new, new.header())


def quaternion_named(header: Header) -> tuple[Header, list[Note]]:
    """Return the header with Q0 … Q3 beside no Q4 as a quaternion, and a note."""
    lower = [name.lower() for name in header.names]
    if not {*_COUNTED} <= {*lower} or "q4" in lower:
        return header, []
    names = tuple(_COUNTED.get(key, name) for key, name in zip(lower, header.names, strict=True))
    return replace(header, names=names), [Note("q0 … q3 are taken as a quaternion, scalar part first")]


def _with_joint_names(header: Header) -> Header:
    """Return names of joint states as rostopic prints them, with the joints that the first row names.

    The columns ``field.name0`` and ``field.position0`` are of one joint; messages list joints in any order.
    """
    if not header.dialect.sample:
        return header
    first = dict(zip(header.names, header.dialect.sample[0], strict=False))
    names = tuple(
        f"joint_states/{first[f'field.name{match[1]}']}/position"
        if (match := re.fullmatch(r"field\.position(\d+)", name)) and f"field.name{match[1]}" in first
        else name
        for name in header.names
    )
    return replace(header, names=names)


def points_in_rows(names: Sequence[str]) -> dict[str, dict[str, int]]:
    """Return the columns ``X1, Y1, Z1, X2 …`` by label and axis; empty unless two labels have an axis."""
    points: dict[str, dict[str, int]] = {}
    for index, name in enumerate(names):
        axis, label = axis_and_label(heading_of(name))
        if axis is not None and label is not None:
            points.setdefault(label, {}).setdefault(axis, index)
    return {} if "" in points or len(points) < 2 else points


def advice_on_points(names: Sequence[str]) -> str | None:
    """Return what to do about a file with several points in each row; None for another file."""
    points = points_in_rows(names)
    if not points:
        return None
    for label, columns in points.items():
        if missing := [axis.upper() for axis in AXES if axis not in columns]:
            return f"the rows hold the points {', '.join(points)}, but point {label} has no {' and no '.join(missing)}"
    labels = ", ".join(points)
    return (
        f"each row holds the points {labels}: for several targets at one pose, the robot file names them under "
        f"targets ({labels}); for a single target, choose its columns with `columns`"
    )


class _Reshaped:
    """Common part: a table whose rows are formed from those of another."""

    def __init__(self, table: Table, header: Header) -> None:
        self._table = table
        self._old = header
        self.log: ProblemLog = table.log
        self.file = table.file

    @property
    def sha256(self) -> str:
        """Digest of the file's bytes."""
        return self._table.sha256

    def _described(self, text: str) -> str:
        return ", ".join(part for part in (self._table.description(), text) if part)


class _AxisRows(_Reshaped):
    """Table with one row for each axis of a point: point, axis, value."""

    def __init__(self, table: Table, header: Header, axis: int, values: Mapping[str, int]) -> None:
        """Take the columns of the axis, and of the coordinates by ``""`` and ``Nominal``."""
        super().__init__(table, header)
        self._axis, self._values = axis, values
        used = {axis, *values.values()}
        self._others = [i for i in range(len(header.names)) if i not in used]
        self._point = next((i for i in self._others if is_point_name(header.names[i])), None)
        self._unused: dict[str, None] = {}

    @classmethod
    def of(cls, table: Table, header: Header) -> _AxisRows | None:
        words = [heading_of(name).words for name in header.names]
        axis = [i for i, texts in enumerate(words) if len(texts) == 1 and texts[0] in _AXIS_NAMES]
        measured = [i for i, texts in enumerate(words) if texts and set(texts) <= _MEASURED]
        nominal = [i for i, texts in enumerate(words) if _NOMINAL & set(texts) and set(texts) <= _NOMINAL | _MEASURED]
        if len(axis) != 1 or len(measured) != 1 or len(nominal) > 1 or {("x",), ("y",), ("z",)} & set(words):
            return None
        return cls(table, header, axis[0], {"": measured[0], **({"Nominal": nominal[0]} if nominal else {})})

    def header(self) -> Header:
        """Return the names of the other columns, then those of X, Y and Z."""
        names = [self._old.names[i] for i in self._others]
        units = {k: self._old.cell_units[i] for k, i in enumerate(self._others) if i in self._old.cell_units}
        for group, index in self._values.items():
            unit = heading_of(self._old.names[index]).unit
            for axis in AXES:
                if index in self._old.cell_units:
                    units[len(names)] = self._old.cell_units[index]
                names.append(f"{group} {axis.upper()}".strip() + (f" [{unit}]" if unit else ""))
        return replace(self._old, names=tuple(names), cell_units=units)

    def description(self) -> str:
        """Return how the rows were joined."""
        names = {group: self._old.names[index] for group, index in self._values.items()}
        text = f"one row for each axis joined: {self._old.names[self._axis]} is the axis, {names['']} the measured"
        text += f" and {names['Nominal']} the commanded value" if "Nominal" in names else " value"
        if self._unused:
            text += f"; rows of {', '.join(self._unused)} not used"
        return self._described(text)

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return one row for each point."""
        n = len(self._others)
        plain = [self._others[i] for i in numbers if i < n]
        coordinates = list(self._values.values())
        ids = [self._axis] if self._point is None else [self._axis, self._point]
        old = self._table.body([*plain, *coordinates], [*ids, *(self._others[i] for i in texts)])
        rows, gaps = self._points(old)
        table = np.empty((len(numbers), rows.shape[1]))
        place = {index: row for row, index in enumerate(plain)}
        for row, i in zip(table, numbers, strict=True):
            if i < n:
                row[:] = self._constant(old, place[self._others[i]], rows, self._old.names[self._others[i]])
            else:
                row[:] = old.numbers[len(plain) + (i - n) // 3][rows[(i - n) % 3]]
        columns = tuple(text[rows[0]] for text in old.texts[len(ids) :])
        return TableBody(table, columns, old.lines[rows[0]], tuple(sorted({*old.gaps, *gaps})))

    def _points(self, old: TableBody) -> tuple[NDArray[np.int64], list[int]]:
        """Return the rows ``(3, P)`` of the x, y and z of each point, and lines of points with a gap."""
        axes = [text.strip().lower() for text in old.texts[0].tolist()]
        labels = old.texts[1].tolist() if self._point is not None else [""] * len(axes)
        points: list[tuple[str, dict[str, int]]] = []
        for row, (axis, label) in enumerate(zip(axes, labels, strict=True)):
            if axis not in AXES:
                self._unused[clip(axis.upper())] = None
            elif points and points[-1][0] == label and axis not in points[-1][1]:
                points[-1][1][axis] = row
            else:
                points.append((label, {axis: row}))
        complete, gaps = [], []
        for label, by_axis in points:
            missing = [axis.upper() for axis in AXES if axis not in by_axis]
            line = int(old.lines[min(by_axis.values())])
            if not missing:
                complete.append([by_axis[axis] for axis in AXES])
            elif old.gaps:
                gaps.append(line)
            else:
                name = f"point {clip(label)}" if label else "the point"
                fix = "the rows of one point stand below each other, one for each of X, Y and Z"
                self.log.add(f"{name} has no row for {' and '.join(missing)}", line, fix=fix)
        if not points:
            found = ", ".join(self._unused) or "no rows"
            self.log.add(f"found {found}, expected rows for X, Y and Z", None, self._old.names[self._axis])
        return np.array(complete, dtype=np.int64).reshape(-1, 3).T, gaps

    def _constant(self, old: TableBody, index: int, rows: NDArray[np.int64], name: str) -> Array:
        """Return a column that is the same in the three rows of each point; log points where it is not."""
        values = old.numbers[index][rows]
        first: Array = values[0]
        differs = np.any(np.abs(values - first) > 1e-9 * np.maximum(1.0, np.abs(first)), axis=0)
        self.log.add_rows(differs, old.lines[rows[0]], name, lambda i: "the rows of one point have different values")
        return first


@dataclass(frozen=True, slots=True)
class _Point:
    """Columns of one target in each row."""

    target: str
    columns: tuple[int, ...]
    """Indices of x, y and z."""


class _TargetsInRows(_Reshaped):
    """Table with several targets in each row: ``X1, Y1, Z1, X2, Y2, Z2``."""

    def __init__(self, table: Table, header: Header, points: Sequence[_Point]) -> None:
        """Take the columns of each target."""
        super().__init__(table, header)
        self._points = points
        used = {index for point in points for index in point.columns}
        self._others = [i for i in range(len(header.names)) if i not in used]
        self._has_visits = any(name.lower() in ("visit", "arrival") for name in header.names)

    @classmethod
    def of(cls, table: Table, header: Header, target_names: Sequence[str] | None) -> _TargetsInRows | None:
        by_label = points_in_rows(header.names)
        targets = {label: label if target_names is None else _target_of(label, target_names) for label in by_label}
        complete = all(set(AXES) <= columns.keys() for columns in by_label.values())
        units = [{_unit(header, columns[axis]) for columns in by_label.values()} for axis in AXES] if complete else []
        is_matched = None not in targets.values() and len(set(targets.values())) == len(targets)
        if not by_label or not complete or not is_matched or any(len(names) > 1 for names in units):
            return None
        if any(heading_of(name).text in ("target", "smr", "reflector") for name in header.names):
            return None
        points = [
            _Point(str(targets[label]), tuple(columns[axis] for axis in AXES)) for label, columns in by_label.items()
        ]
        return cls(table, header, points)

    def header(self) -> Header:
        """Return the names of the other columns, then X, Y, Z, target and visit."""
        names = [self._old.names[i] for i in self._others]
        units = {k: self._old.cell_units[i] for k, i in enumerate(self._others) if i in self._old.cell_units}
        for axis, index in zip(AXES, self._points[0].columns, strict=True):
            unit = heading_of(self._old.names[index]).unit
            if index in self._old.cell_units:
                units[len(names)] = self._old.cell_units[index]
            names.append(axis.upper() + (f" [{unit}]" if unit else ""))
        names += ["target"] if self._has_visits else ["target", "visit"]
        return replace(self._old, names=tuple(names), cell_units=units)

    def description(self) -> str:
        """Return which columns are of which target."""
        names = self._old.names
        parts = (f"{', '.join(names[i] for i in point.columns)} of target {point.target}" for point in self._points)
        return self._described(f"several targets in each row: {'; '.join(parts)}")

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return one row for each target of each row."""
        n, count = len(self._others), len(self._points)
        plain = [self._others[i] for i in numbers if i < n]
        coordinates = [index for point in self._points for index in point.columns]
        old_texts = [self._others[i] for i in texts if i < n]
        old = self._table.body([*plain, *coordinates], old_texts)
        place = {index: row for row, index in enumerate(plain)}
        table = np.empty((len(numbers), count * old.lines.size))
        for row, i in zip(table, numbers, strict=True):
            if i < n:
                row[:] = np.repeat(old.numbers[place[self._others[i]]], count)
            else:
                axis = i - n
                row[:] = old.numbers[[len(plain) + 3 * k + axis for k in range(count)]].T.ravel()
        columns = tuple(self._texts(old, old_texts, i) for i in texts)
        return TableBody(table, columns, np.repeat(old.lines, count), old.gaps)

    def _texts(self, old: TableBody, old_texts: Sequence[int], index: int) -> NDArray[np.str_]:
        n = len(self._others)
        if index < n:
            return np.repeat(old.texts[old_texts.index(self._others[index])], len(self._points))
        if index == n + 3:
            return np.tile(np.array([point.target for point in self._points]), old.lines.size)
        return np.repeat(old.lines.astype(str), len(self._points))


def _unit(header: Header, index: int) -> str | None:
    return header.cell_units.get(index) or heading_of(header.names[index]).unit


def _target_of(label: str, names: Sequence[str]) -> str | None:
    """Return the robot's target that a label stands for: its name, or the target with the same number."""
    for name in names:
        if name.lower() == label:
            return name
    numbers = [re.search(r"\d+$", text) for text in (label, *names)]
    first = numbers[0]
    matches = [
        name
        for name, number in zip(names, numbers[1:], strict=True)
        if first is not None and number is not None and int(first[0]) == int(number[0])
    ]
    return matches[0] if len(matches) == 1 and (label.isdecimal() or matches[0].isdecimal()) else None
