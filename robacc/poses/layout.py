"""Which columns a pose file has, and whether each set of them is whole."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from robacc.io.problem_log import ProblemLog, clip
from robacc.io.table import Header
from robacc.poses.columns import AXES, JOINT_COLUMN, ORIENTATIONS, SIGMAS, Column, Names, parse_column

_MAX_NAMED = 6
"""Columns listed in one message before it says how many more there are."""
_MAX_WARNINGS = 20


@dataclass(frozen=True, slots=True)
class Layout:
    """The columns in use, by key."""

    columns: Mapping[str, Column]
    n_joints: int
    """Number of the robot's joints, or of joint columns where no robot is known; 0 where there are none."""
    orientation: tuple[str, ...] | None
    """Keys of the attained orientation's three or four columns."""
    commanded_orientation: tuple[str, ...] | None
    warnings: tuple[str, ...]

    def group(self, keys: Sequence[str]) -> tuple[Column, ...] | None:
        """The columns of ``keys``, or None where the file does not have every one of them."""
        if not keys or any(key not in self.columns for key in keys):
            return None
        return tuple(self.columns[key] for key in keys)

    def joints(self, prefix: str = "") -> tuple[str, ...]:
        """Keys of all joints' columns, ``q1 … qN``, or with ``dir_`` or ``speed_`` in front."""
        return tuple(f"{prefix}q{i + 1}" for i in range(self.n_joints))


def read_layout(
    header: Header,
    log: ProblemLog,
    joint_names: Sequence[str] | None,
    joint_types: Sequence[str] | None,
    attained: bool = True,
) -> Layout:
    """Which column of the file is what. Every problem goes to ``log``, the columns without one are returned.

    Args:
        header: Names as the file has them.
        log: Takes duplicates, wrong units, and columns that are missing from a set.
        joint_names: The robot's joints in chain order; None where no robot is known.
        joint_types: ``revolute`` or ``prismatic`` for each of them; None: q may be an angle or a length.
        attained: Whether the attained position must be among them.
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
            log.add("the column is a duplicate", header.line, name, "keep one of the two")
        else:
            message = f"the column is a duplicate: {columns[column.key].name} says the same"
            log.add(message, header.line, name, "keep one of the two")
    for name, count in Counter(unknown).items():
        if name and count > 1:
            log.add("the column is a duplicate", header.line, clip(name), "keep one of the two")
    return _Completeness(columns, unknown, names, log, header.line, attained).layout()


@dataclass(frozen=True, slots=True)
class _Completeness:
    """What is missing among the columns found, said to the log."""

    columns: Mapping[str, Column]
    unknown: Sequence[str]
    names: Names
    log: ProblemLog
    line: int | None
    attained: bool

    def layout(self) -> Layout:
        self._whole(AXES, "the attained position", required=self.attained)
        commanded = any(key.startswith("cmd_") for key in self.columns)
        self._whole(tuple(f"cmd_{axis}" for axis in AXES), "the commanded position", required=commanded)
        self._whole(SIGMAS, "the measuring uncertainty of a position")
        orientation = self._orientation("")
        commanded_orientation = self._orientation("cmd_")
        n_joints = self._joints(commanded)
        return Layout(self.columns, n_joints, orientation, commanded_orientation, tuple(self._warnings()))

    def _whole(self, keys: Sequence[str], what: str, required: bool = False) -> None:
        missing = [key for key in keys if key not in self.columns]
        if missing and (required or len(missing) < len(keys)):
            self._missing(missing, f"expected {', '.join(keys)}: {what}")

    def _missing(self, keys: Sequence[str], fix: str, message: str = "") -> None:
        ignored = [name for name in self.unknown if name]
        hint = f" (unknown in this file: {listing(ignored)})" if ignored else ""
        text = f"column {keys[0]} is missing" if len(keys) == 1 else f"columns {listing(keys)} are missing"
        self.log.add(message + text, self.line, fix=fix + hint)

    def _orientation(self, prefix: str) -> tuple[str, ...] | None:
        """Keys of the one representation that is there; a second one or a part of one is logged."""
        what = "the commanded orientation" if prefix else "the attained orientation"
        begun = [
            tuple(f"{prefix}{name}" for name in group)
            for group in ORIENTATIONS
            if any(f"{prefix}{name}" in self.columns for name in group)
        ]
        for keys in begun:
            self._whole(keys, what)
        if len(begun) > 1:
            given = " and ".join(", ".join(keys) for keys in begun)
            self.log.add(f"{what} is given more than once: {given}", self.line, fix="keep one of them")
        whole = [keys for keys in begun if all(key in self.columns for key in keys)]
        return whole[0] if whole else None

    def _joints(self, commanded: bool) -> int:
        """Number of joints, after checking that q, dir and speed columns fit it."""
        robot = self.names.joint_names
        matches = [match for key in self.columns if (match := JOINT_COLUMN.fullmatch(key))]
        found = sorted(int(match[2]) for match in matches if not match[1])
        others = [int(match[2]) for match in matches if match[1]]
        count = len(robot) or max(found or others, default=0)
        if found:
            self._every_joint(found, count)
        elif not commanded and (robot or "pose" not in self.columns):
            wanted = f"q1 … q{count}" if robot else "q1 … qN"
            fix = f"expected {wanted} (joint variables), or cmd_x, cmd_y, cmd_z (commanded pose)"
            self._missing(["q1"], fix, "nothing says where the robot was sent: ")
        for match in matches:
            if int(match[2]) > count:
                column = self.columns[match[0]].name
                whose = f"the robot has {count} joints" if robot else f"the last joint column is q{count}"
                self.log.add(f"the column belongs to joint {match[2]}, {whose}", self.line, column)
        return count

    def _every_joint(self, found: Sequence[int], count: int) -> None:
        robot = self.names.joint_names
        missing = [f"q{i}" for i in range(1, count + 1) if i not in found]
        if not missing:
            return
        there = f"the robot has {count} joints, the file has columns for {len(found)}: " if robot else ""
        own = f", or the joints' names {listing(robot)}" if robot else ""
        self._missing(missing, f"expected q1 … q{count} without a gap{own}", there)

    def _warnings(self) -> list[str]:
        named = [name for name in dict.fromkeys(self.unknown) if name]
        texts = [
            f"{self.log.at(self.line)}: unknown column {clip(name)} is ignored; "
            f"the nearest known one is {self.names.nearest(name)!r}"
            for name in named[:_MAX_WARNINGS]
        ]
        if len(named) > _MAX_WARNINGS:
            texts.append(f"{self.log.at(self.line)}: … and {len(named) - _MAX_WARNINGS} more unknown columns")
        unnamed = sum(not name for name in self.unknown)
        if unnamed:
            texts.append(f"{self.log.at(self.line)}: columns without a name are ignored: {unnamed}")
        return texts


def listing(names: Sequence[str]) -> str:
    """The names in a row, cut after a few."""
    rest = len(names) - _MAX_NAMED
    return ", ".join(names[:_MAX_NAMED]) + (f" and {rest} more" if rest > 0 else "")
