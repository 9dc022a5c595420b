"""Layout of a pose file: its columns, and whether each set of columns is complete."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from robacc.io.problem_log import ProblemLog, clip
from robacc.io.table import Header
from robacc.poses.columns import AXES, JOINT_COLUMN, ORIENTATIONS, SIGMAS, Column, Names, parse_column

_MAX_LISTED = 6
"""Columns that a message lists; it counts the others."""
_MAX_WARNINGS = 20


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

    def group(self, keys: Sequence[str]) -> tuple[Column, ...] | None:
        """Return the columns of ``keys``; None where one of them is missing."""
        if not keys or any(key not in self.columns for key in keys):
            return None
        return tuple(self.columns[key] for key in keys)

    def joints(self, prefix: str = "") -> tuple[str, ...]:
        """Return the keys of all joints' columns, ``q1 … qN``, with a prefix ``dir_`` or ``speed_`` for motions."""
        return tuple(f"{prefix}q{i + 1}" for i in range(self.n_joints))


def read_layout(
    header: Header,
    log: ProblemLog,
    joint_names: Sequence[str] | None,
    joint_types: Sequence[str] | None,
    attained: bool = True,
) -> Layout:
    """Return the columns of a file; every problem goes to ``log``, and a column with a problem is left out.

    Args:
        header: Names in the file.
        log: Takes duplicates, wrong units, and columns that are missing from a set.
        joint_names: The robot's joints in chain order; None where no robot is known.
        joint_types: ``revolute`` or ``prismatic`` for each of them; None: q may be an angle or a length.
        attained: Whether the attained position is required.
    """
    names = Names.of(header.names, joint_names, joint_types)
    columns: dict[str, Column] = {}
    unknown: list[str] = []
    for index, name in enumerate(header.names):
        column = parse_column(name, index, names, log, header.line)
        if column is None:
            unknown.append(name)
        elif column.key not in columns:
            columns[column.key] = column
        elif columns[column.key].name == name:
            log.add("the column is a duplicate", header.line, name, "keep one of them")
        else:
            log.add(f"the column is a duplicate of {columns[column.key].name}", header.line, name, "keep one of them")
    for name, count in Counter(unknown).items():
        if name and count > 1:
            log.add("the column is a duplicate", header.line, clip(name), "keep one of them")
    return _Completeness(columns, unknown, names, log, header.line, attained).layout()


@dataclass(frozen=True, slots=True)
class _Completeness:
    """Checks that sets of columns are complete; missing columns go to the log."""

    columns: Mapping[str, Column]
    unknown: Sequence[str]
    names: Names
    log: ProblemLog
    line: int | None
    attained: bool

    def layout(self) -> Layout:
        self._check_set(AXES, "the attained position", required=self.attained)
        commanded = any(key.startswith("cmd_") for key in self.columns)
        self._check_set(tuple(f"cmd_{axis}" for axis in AXES), "the commanded position", required=commanded)
        self._check_set(SIGMAS, "the measuring uncertainty of a position")
        orientation = self._orientation("")
        commanded_orientation = self._orientation("cmd_")
        n_joints = self._joints(commanded)
        return Layout(self.columns, n_joints, orientation, commanded_orientation, tuple(self._warnings()))

    def _check_set(self, keys: Sequence[str], set_name: str, required: bool = False) -> None:
        missing = [key for key in keys if key not in self.columns]
        if missing and (required or len(missing) < len(keys)):
            self._report_missing(missing, f"expected {', '.join(keys)}: {set_name}")

    def _report_missing(self, keys: Sequence[str], fix: str, message: str = "") -> None:
        ignored = [name for name in self.unknown if name]
        hint = f" (unknown in this file: {listing(ignored)})" if ignored else ""
        text = f"column {keys[0]} is missing" if len(keys) == 1 else f"columns {listing(keys)} are missing"
        self.log.add(message + text, self.line, fix=fix + hint)

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
        if joint_numbers:
            self._check_joints(joint_numbers, count)
        elif not commanded and (joint_names or "pose" not in self.columns):
            keys = f"q1 … q{count}" if joint_names else "q1 … qN"
            fix = f"expected {keys} (joint variables), or cmd_x, cmd_y, cmd_z (commanded pose)"
            self._report_missing(["q1"], fix, "the file has neither joint variables nor commanded poses: ")
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
        self._report_missing(missing, f"expected q1 … q{count} without a gap{names}", counts if joint_names else "")

    def _warnings(self) -> list[str]:
        unknown_names = [name for name in dict.fromkeys(self.unknown) if name]
        texts = [
            f"{self.log.at(self.line)}: unknown column {clip(name)} is ignored; "
            f"the nearest known name is {self.names.nearest(name)!r}"
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
