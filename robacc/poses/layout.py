"""Layout of a pose file: its columns, whether each set of columns is complete, and their values."""

from __future__ import annotations

import dataclasses
import difflib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import Note
from robacc.geometry import Array
from robacc.io.dialect import PLAIN
from robacc.io.files import ProblemLog, clip
from robacc.io.table import Table
from robacc.poses.columns import (
    AXES,
    JOINT_COLUMN,
    ORIENTATIONS,
    QUATERNION,
    SIGMAS,
    BranchColumn,
    Column,
    Names,
    heading_of,
    parse_column,
    split_unit,
    time_column,
    with_cell_unit,
)
from robacc.poses.foreign_columns import ForeignColumns, documented_name, find_columns, statement
from robacc.poses.reading import AS_NAMED, KnownRobot, Reading
from robacc.poses.reshaped_tables import advice_on_points

_MAX_LISTED = 6
"""Columns that a message lists; it counts the others."""
_MAX_WARNINGS = 20
_ANGLES_OF_SIGHT = frozenset({"az", "azimuth", "hz", "horizontal", "theta"})
_SIMILAR = 0.8
"""Similarity of two names (0 to 1) from which one may be a slip of the other."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Columns in use, by key."""

    columns: Mapping[str, Column]
    n_joints: int
    """Number of the robot's joints, or of joint columns where no robot is known; 0 without joint columns."""
    orientation: tuple[str, ...] | None
    """Keys of the attained orientation's three or four columns."""
    commanded_orientation: tuple[str, ...] | None
    warnings: tuple[str, ...]
    branches: tuple[BranchColumn, ...]
    """Joints outside the chain; those with a column have the keys ``branch_q1 …``."""
    foreign: ForeignColumns
    """What the names of an export leave open."""

    def group(self, keys: Sequence[str]) -> tuple[Column, ...] | None:
        """Return the columns of ``keys``; None where one of them is missing."""
        if not keys or any(key not in self.columns for key in keys):
            return None
        return tuple(self.columns[key] for key in keys)

    def joints(self, prefix: str = "") -> tuple[str, ...]:
        """Return the keys of all joints' columns, ``q1 … qN``, with a prefix ``dir_``, ``speed_`` or ``read_``."""
        return tuple(f"{prefix}q{i + 1}" for i in range(self.n_joints))


def read_layout(
    table: Table,
    robot: KnownRobot,
    attained: bool = True,
    reading: Reading = AS_NAMED,
    commands: bool = True,
) -> Layout:
    """Return the columns of a table; every problem goes to its log, and a column with a problem is left out.

    Args:
        table: Table whose names are known; its log takes duplicates, wrong units, and columns missing from a set.
        robot: The robot's joints, and those beside its chain, which may have columns.
        attained: Whether the attained position is required.
        reading: Statements of the user on names that leave a question open.
        commands: Whether joints or commanded poses are required.
    """
    log, line, mapping = table.log, table.line, reading.columns or {}
    for stated in mapping:
        if stated not in table.names:
            nearest = difflib.get_close_matches(stated, table.names, n=1, cutoff=0.6)
            hint = f"; did you mean {clip(nearest[0])}?" if nearest else ""
            log.add(f"the map names a column {clip(stated)}, which the file does not have{hint}", line)
    mapped = [mapping.get(name, name) for name in table.names]
    names = Names.of([name for name in mapped if name], robot.joint_names, robot.joint_types, robot.branches)
    columns: dict[str, Column] = {}
    unknown: list[str] = []
    for index, name in enumerate(mapped):
        if name is None:
            continue
        column = parse_column(name, index, names, table)
        if reading.columns is not None and (column := column or time_column(name, index)) is not None:
            coverage = (reading.coverage or 1.0) if column.key in (*SIGMAS, "sigma_r") else 1.0
            column = dataclasses.replace(column, name=table.names[index], coverage=coverage)
        if column is None:
            unknown.append(name)
            continue
        column = with_cell_unit(column, table)
        if column.unit is None and column.kind in ("length", "angle", "joint"):
            column = dataclasses.replace(
                column, unit=reading.unit_of.get("length" if column.kind == "length" else "angle")
            )
        if (first := columns.setdefault(column.key, column)) is not column:
            of = "" if first.name == name else f" of {first.name}"
            log.add(f"the column is a duplicate{of}", line, name, "keep one of them")
    for text, count in Counter(unknown).items():
        if text and count > 1:
            log.add("the column is a duplicate", line, clip(text), "keep one of them")
    sets = _Completeness(columns, unknown, names, log, line, attained, commands, robot.outside)
    if reading.columns is not None or not (table.dialect is not PLAIN or sets.lacks_a_pose()):
        return sets.layout(ForeignColumns())
    # The names are not all documented: notes say what each was taken for.
    foreign = find_columns(table, columns, names, reading)
    layout = dataclasses.replace(sets, columns=foreign.columns, unknown=foreign.unused).layout(foreign)
    taken = statement(foreign.columns, columns)
    unused = ", ".join(_with_suggestion(name, names) for name in foreign.unused)
    texts = [f"columns: {taken}" if taken else "", f"not used: {unused}" if unused else "", *foreign.remarks]
    return dataclasses.replace(layout, warnings=tuple(Note(f"{log.at(line)}: {text}") for text in texts if text))


def _with_suggestion(name: str, names: Names) -> str:
    """Return a name in quotes, with the documented name that it resembles."""
    nearest = names.nearest(name)
    is_similar = difflib.SequenceMatcher(None, name[:64].lower(), nearest).ratio() >= _SIMILAR
    return f"{clip(name)} (did you mean {nearest}?)" if is_similar else clip(name)


@dataclass(frozen=True, slots=True)
class _Completeness:
    """Checks that sets of columns are complete; missing columns go to the log."""

    columns: Mapping[str, Column]
    unknown: Sequence[str]
    names: Names
    log: ProblemLog
    line: int | None
    attained: bool
    commands: bool
    outside: Mapping[str, str]
    """Rules of joint variables that follow a joint outside the chain, by the name of that joint."""

    def lacks_a_pose(self) -> bool:
        """Return whether the attained position or any command is missing, so that other names may stand for them."""
        position = not self.attained or set(AXES) <= self.columns.keys()
        commands = any(
            key.startswith("cmd_") or (JOINT_COLUMN.fullmatch(key) and not key.startswith("read_"))
            for key in self.columns
        )
        is_repeated = "pose" in self.columns and not self.names.joint_names
        return not (position and (commands or not self.commands or is_repeated))

    def layout(self, foreign: ForeignColumns) -> Layout:
        """Return the layout; log sets that are incomplete."""
        self._check_set(AXES, "the attained position", required=self.attained)
        commanded = any(key.startswith("cmd_") for key in self.columns)
        self._check_set(tuple(f"cmd_{axis}" for axis in AXES), "the commanded position", required=commanded)
        self._check_set(SIGMAS, "the measuring uncertainty of a position")
        orientation = self._orientation("")
        commanded_orientation = self._orientation("cmd_")
        n_joints = self._joints(commanded)
        warnings = tuple(self._warnings())
        return Layout(
            self.columns, n_joints, orientation, commanded_orientation, warnings, self.names.branches, foreign
        )

    def _check_set(self, keys: Sequence[str], set_name: str, required: bool = False) -> None:
        missing = [key for key in keys if key not in self.columns]
        if missing and (required or len(missing) < len(keys)):
            fix = f"expected {', '.join(keys)}: {set_name}"
            words = {word for name in self.unknown for word in (name.lower(), *heading_of(name).words)}
            if required and words & {"axis", "achse", "coordinate"} and words & {"actual", "measured", "ist"}:
                fix = "the file has one row for each axis; export one row for each point, with its X, Y and Z"
            if required and words & _ANGLES_OF_SIGHT and words & {"dist", "distance", "range", "d", "r"}:
                fix = "the file has angles and distances of an instrument; export X, Y and Z"
            if required and keys == AXES and (text := advice_on_points(self.unknown)) is not None:
                fix = text
            self._report_missing(missing, fix)

    def _report_missing(self, keys: Sequence[str], fix: str, message: str = "") -> None:
        text = f"column {keys[0]} is missing" if len(keys) == 1 else f"columns {listing(keys)} are missing"
        self.log.add(message + text, self.line, fix=fix + self._ignored())

    def _ignored(self) -> str:
        """Return the names of the file that are not used, for the end of a fix, and rules that replace some of them."""
        ignored = [name for name in self.unknown if name]
        rules = "".join(
            f"; {clip(name)} is outside the robot's chain, so write the column {rule}"
            for name in ignored
            if (rule := self.outside.get(name) or self.outside.get(split_unit(name)[0]))
        )
        return f" (unknown in this file: {listing(ignored)}){rules}" if ignored else ""

    def _orientation(self, prefix: str) -> tuple[str, ...] | None:
        """Return the keys of the file's representation of an orientation; log a second or incomplete one."""
        set_name = "the commanded orientation" if prefix else "the attained orientation"
        present = [
            tuple(f"{prefix}{name}" for name in group)
            for group in ORIENTATIONS
            if any(f"{prefix}{name}" in self.columns for name in group)
        ]
        for keys in present:
            self._check_set(keys, set_name)
        if len(present) > 1:
            sets_text = " and ".join(", ".join(keys) for keys in present)
            self.log.add(f"{set_name} is given more than once: {sets_text}", self.line, fix="keep one of them")
        complete = [keys for keys in present if all(key in self.columns for key in keys)]
        return complete[0] if complete else None

    def _joints(self, commanded: bool) -> int:
        """Return the number of joints; log q, dir and speed columns that do not fit it."""
        joint_names = self.names.joint_names
        matches = [match for key in self.columns if (match := JOINT_COLUMN.fullmatch(key))]
        joint_numbers = sorted(int(match[2]) for match in matches if not match[1])
        motion_numbers = [int(match[2]) for match in matches if match[1]]
        count = len(joint_names) or max(joint_numbers or motion_numbers, default=0)
        read_back = tuple(f"read_q{i + 1}" for i in range(count))
        self._check_set(read_back, "the joint variables as read back")
        # Without the attained position, which is required, that is the problem of the file.
        has_position = not self.attained or set(AXES) <= self.columns.keys()
        if joint_numbers:
            self._check_joints(joint_numbers, count)
        elif self.commands and not commanded and has_position and (joint_names or "pose" not in self.columns):
            keys = f"q1 … q{count}" if joint_names else "q1 … qN"
            fix = (
                "give the commands with `commanded`: the robot program, or a table of joints or poses; "
                f"or add columns {keys} (joint variables) or cmd_x, cmd_y, cmd_z (commanded pose)"
            )
            message = "the file has measured poses only: neither joint variables nor commanded poses"
            self.log.add(message, self.line, fix=fix + self._ignored())
        for match in matches:
            if int(match[2]) > count:
                column = self.columns[match[0]].name
                last = f"the robot has {count} joints" if joint_names else f"the last joint column is q{count}"
                self.log.add(f"the column belongs to joint {match[2]}, but {last}", self.line, column)
        return count

    def _check_joints(self, joint_numbers: Sequence[int], count: int) -> None:
        joint_names = self.names.joint_names
        missing = [f"q{i}" for i in range(1, count + 1) if i not in joint_numbers]
        if not missing:
            return
        counts = f"the robot has {count} joints, the file has columns for {len(joint_numbers)}: "
        names = f", or the joints' names {listing(joint_names)}" if joint_names else ""
        fix = f"expected q1 … q{count} without a gap{names}"
        if joint_numbers == [1, 2, 3, 4]:
            fix += "; if q1 … q4 are a quaternion, as ABB writes it, name them qw, qx, qy, qz or use `columns`"
        self._report_missing(missing, fix, counts if joint_names else "")

    def _warnings(self) -> list[str]:
        unknown_names = [name for name in dict.fromkeys(self.unknown) if name]
        texts = [
            f"{self.log.at(self.line)}: unknown column {clip(name)} is ignored; "
            f"the nearest known name is {documented_name(name) or self.names.nearest(name)!r}"
            for name in unknown_names[:_MAX_WARNINGS]
        ]
        if len(unknown_names) > _MAX_WARNINGS:
            texts.append(f"{self.log.at(self.line)}: … and {len(unknown_names) - _MAX_WARNINGS} more unknown columns")
        n_unnamed = sum(not name for name in self.unknown)
        if n_unnamed:
            texts.append(f"{self.log.at(self.line)}: columns without a name are ignored: {n_unnamed}")
        return texts


def listing(names: Sequence[str]) -> str:
    """Return the names separated by commas, cut after six."""
    n_more = len(names) - _MAX_LISTED
    return ", ".join(names[:_MAX_LISTED]) + (f" and {n_more} more" if n_more > 0 else "")


# Values of the columns of a pose file.

COMMANDED_QUATERNION = tuple(f"cmd_{name}" for name in QUATERNION)
COMMANDED_AXES = tuple(f"cmd_{axis}" for axis in AXES)


@dataclass(frozen=True, slots=True)
class Values:
    """Values of the columns in use, SI."""

    layout: Layout
    numbers: Array
    """``(C, N)``; NaN where a value could not be read."""
    row_index: Mapping[str, int]
    """Row of ``numbers`` by key; the keys of a set are adjacent."""
    texts: Mapping[str, NDArray[np.str_]]
    lines: NDArray[np.int64]
    """``(N,)`` line of the file, from 1."""

    def column(self, key: str) -> Array | None:
        """Return one column ``(N,)``; None where the file does not have it."""
        return self.numbers[self.row_index[key]] if key in self.row_index else None

    def column_set(self, keys: Sequence[str]) -> Array | None:
        """Return a set of columns ``(len(keys), N)`` without copying; None where one of them is missing."""
        if not keys or any(key not in self.row_index for key in keys):
            return None
        start = self.row_index[keys[0]]
        return self.numbers[start : start + len(keys)]

    def complete(self) -> Values:
        """Return the rows in which every number could be read."""
        return self.rows(np.flatnonzero(np.isfinite(self.numbers).all(axis=0)))

    def rows(self, index: NDArray[Any]) -> Values:
        """Return some of the rows."""
        texts = {key: text[index] for key, text in self.texts.items()}
        return Values(self.layout, self.numbers[:, index], self.row_index, texts, self.lines[index])
