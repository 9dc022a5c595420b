"""Names of a pose file's columns: the documented names, units, and the robot's joint names."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from robacc.io.problem_log import ProblemLog
from robacc.io.table_parts import Header
from robacc.poses.headings import TIME_KEYS

Kind = Literal["length", "angle", "joint", "ratio", "number", "text"]

UNITS: Mapping[str, tuple[str, float]] = {
    "m": ("length", 1.0),
    "mm": ("length", 1e3),
    "um": ("length", 1e6),
    "rad": ("angle", 1.0),
    "mrad": ("angle", 1e3),
    "deg": ("angle", 180.0 / math.pi),
}
"""Quantity of each unit, and how many make one SI unit (x / 1e3 rounds once, x * 1e-3 twice)."""

FOREIGN_UNITS: Mapping[str, tuple[str, float]] = {
    "in": ("length", 1.0 / 0.0254),
    "s": ("time", 1.0),
    "ms": ("time", 1e3),
    "us": ("time", 1e6),
    "ns": ("time", 1e9),
    "min": ("time", 1.0 / 60.0),
    "h": ("time", 1.0 / 3600.0),
    "kg": ("mass", 1.0),
    "g": ("mass", 1e3),
    "degC": ("temperature", 1.0),
}
"""The same for units that only names of instruments carry: no documented name ends in them."""

AXES = ("x", "y", "z")
QUATERNION = ("qw", "qx", "qy", "qz")
ROTATION_VECTOR = ("rx", "ry", "rz")
RPY = ("roll", "pitch", "yaw")
ORIENTATIONS = (QUATERNION, ROTATION_VECTOR, RPY)
SIGMAS = tuple(f"sigma_{axis}" for axis in AXES)
TEXTS = ("pose", "cycle", "visit", "target", "payload_group")
CIRCUMSTANCES = ("time_s", "temperature_c", "payload_kg")


def _fixed_kinds() -> dict[str, Kind]:
    kinds: dict[str, Kind] = dict.fromkeys(TEXTS, "text") | dict.fromkeys(CIRCUMSTANCES, "number")  # type: ignore[assignment]
    for prefix in ("", "cmd_"):
        kinds |= {f"{prefix}{name}": "length" for name in AXES}
        kinds |= {f"{prefix}{name}": "angle" for name in (*ROTATION_VECTOR, *RPY)}
        kinds |= {f"{prefix}{name}": "ratio" for name in QUATERNION}
    kinds |= dict.fromkeys(SIGMAS, "length")
    kinds["sigma_r"] = "angle"
    return kinds


FIXED_KINDS: Mapping[str, Kind] = _fixed_kinds()
"""Kind of every column name without a joint's number."""
JOINT_COLUMN = re.compile(r"(dir_|speed_|read_)?q([1-9]\d{0,2})", re.ASCII)
BRANCH_KEY = re.compile(r"branch_q(\d+)", re.ASCII)
"""Key of a joint outside the chain."""
COMMANDED_JOINT = re.compile(r"cmd_q[1-9]\d{0,2}", re.ASCII)
"""Another name of a commanded joint."""


@dataclass(frozen=True, slots=True)
class Column:
    """Column of the file that robacc reads."""

    name: str
    """Name in the file."""
    index: int
    """Position in the file, from 0."""
    key: str
    """Documented name without a unit: ``q1``, ``cmd_x``, ``dir_q2``."""
    kind: Kind
    unit: str | None
    """Unit in the name, or as stated by the user; None for a bare name, which is SI."""
    coverage: float = 1.0
    """Coverage factor of an uncertainty."""

    @property
    def divisor(self) -> float:
        """Number of the column's unit that makes one SI unit."""
        factor = 1.0 if self.unit is None else (UNITS.get(self.unit) or FOREIGN_UNITS[self.unit])[1]
        return factor * self.coverage


@dataclass(frozen=True, slots=True)
class BranchColumn:
    """Joint outside the robot's chain that moves mass, and may have a column."""

    name: str
    type: str
    """``revolute`` or ``prismatic``."""
    position: float
    """Its variable where there is no column, rad or m."""
    loads_joints: bool
    """True if a joint of the chain carries its mass."""


@dataclass(frozen=True, slots=True)
class Names:
    """Names that a column may have in one file, for one robot."""

    joint_names: tuple[str, ...]
    joint_types: tuple[str, ...]
    keys_by_joint_name: dict[str, str] = field(default_factory=dict)
    """Key of each joint's name, also behind ``dir_``, ``speed_`` and ``read_``; of a joint outside the chain too."""
    branches: tuple[BranchColumn, ...] = ()
    """Joints outside the chain, whose keys are ``branch_q1 …``."""

    @classmethod
    def of(
        cls,
        header_names: Sequence[str],
        joint_names: Sequence[str] | None,
        joint_types: Sequence[str] | None,
        branches: Sequence[BranchColumn] = (),
    ) -> Names:
        """Return the names for a robot's joints and their types, None where unknown, in a file with this header."""
        names = tuple(joint_names or ())
        # A robot whose joints are called q0 … q5 has a q1 that is the second of them. The documented numbering goes
        # first where the file has all of it; then the joints' names, where the file has all of those.
        bare = {split_unit(name)[0] for name in header_names} | set(header_names)
        numbered = {f"q{i + 1}" for i in range(len(names))}
        by_name = set(names) <= bare and not numbered <= bare
        keys = {branch.name: f"branch_q{i + 1}" for i, branch in enumerate(branches) if _may_name_branch(branch.name)}
        for i, name in enumerate(names):
            for prefix in ("", "dir_", "speed_", "read_"):
                label = f"{prefix}{name}"
                if label not in FIXED_KINDS and (by_name or not JOINT_COLUMN.fullmatch(label)):
                    keys[label] = f"{prefix}q{i + 1}"
        return cls(names, tuple(joint_types or ()), keys, tuple(branches))

    def key(self, name: str) -> str | None:
        """Return the key of a name without unit; None for an unknown name."""
        if name in self.keys_by_joint_name:
            return self.keys_by_joint_name[name]
        if COMMANDED_JOINT.fullmatch(name):
            return name.removeprefix("cmd_")
        return name if name in FIXED_KINDS or JOINT_COLUMN.fullmatch(name) else None

    def kind(self, key: str) -> Kind:
        """Return the kind of a key's column; a joint of unknown type may be an angle or a length."""
        if branch := BRANCH_KEY.fullmatch(key):
            return "length" if self.branches[int(branch[1]) - 1].type == "prismatic" else "angle"
        match = JOINT_COLUMN.fullmatch(key)
        if match is None:
            return FIXED_KINDS[key]
        if match[1] in ("dir_", "speed_"):
            return "ratio"
        number = int(match[2])
        if number > len(self.joint_types):
            return "joint"
        return "length" if self.joint_types[number - 1] == "prismatic" else "angle"

    def nearest(self, name: str) -> str:
        """Return the known name most similar to ``name``, with or without a unit."""
        import difflib

        joints = self.joint_names or tuple(f"q{i + 1}" for i in range(6))
        bare = {**FIXED_KINDS, **{joint: "joint" for joint in joints}}
        units = [(unit, quantity) for unit, (quantity, _) in UNITS.items()]
        suffixed = [
            f"{stem}_{unit}" for stem, kind in bare.items() for unit, quantity in units if _fits(kind, quantity)
        ]
        motions = [f"{prefix}{joint}" for prefix in ("dir_", "speed_", "read_") for joint in joints]
        # The start of the name is enough: the cost of the comparison grows with the length of both names.
        return difflib.get_close_matches(name[:64].lower(), [*bare, *motions, *suffixed], n=1, cutoff=0.0)[0]


def _may_name_branch(name: str) -> bool:
    """Return whether a name means nothing else in a pose file."""
    return name not in FIXED_KINDS and not JOINT_COLUMN.fullmatch(name)


def split_unit(name: str) -> tuple[str, str | None]:
    """Return a name without its unit, and the unit; the name and None where it has no unit."""
    stem, _, unit = name.rpartition("_")
    return (stem, unit) if stem and unit in UNITS else (name, None)


def _fits(kind: str, quantity: str) -> bool:
    return kind == quantity or kind == "joint"


def parse_column(name: str, index: int, names: Names, log: ProblemLog, line: int | None) -> Column | None:
    """Return the column of a name, None for an unknown name; log a unit that does not fit."""
    key, unit = names.key(name), None
    if key is None:
        stem, unit = split_unit(name)
        key = names.key(stem) if unit else None
    if key is None:
        return None
    kind = names.kind(key)
    if unit is not None and not _fits(kind, UNITS[unit][0]):
        expected = {"angle": "an angle (rad, mrad, deg)", "length": "a length (m, mm, um)"}.get(kind, "no unit")
        log.add(f"found unit {unit} in the name, expected {expected}", line, name)
        unit = None
    return Column(name, index, key, kind, unit)


_UNIT_OF_KEY = {"time_s": "s", "temperature_c": "degC", "payload_kg": "kg"}


def with_cell_unit(column: Column, header: Header, log: ProblemLog) -> Column:
    """Return a column with the unit behind its numbers; log a unit that its name contradicts or that does not fit."""
    unit = header.cell_units.get(column.index)
    if unit is None or column.kind == "text":
        return column
    stated = column.unit or _UNIT_OF_KEY.get(column.key)
    quantity = {**UNITS, **FOREIGN_UNITS}[unit][0]
    if stated is not None:
        if stated != unit:
            log.add(f"the cells are in {unit}, but the name is of {stated}", header.line, column.name)
        return column
    if not _fits(column.kind, quantity) or quantity not in ("length", "angle"):
        expected = {"angle": "an angle", "length": "a length"}.get(column.kind, "a plain number")
        log.add(f"the cells are in {unit}, expected {expected}", header.line, column.name)
        return column
    return replace(column, unit=unit)


def is_documented(name: str) -> bool:
    """Return whether a name, with or without its unit, is a documented one."""
    return any(
        text in FIXED_KINDS or JOINT_COLUMN.fullmatch(text.removeprefix("cmd_")) for text in (name, split_unit(name)[0])
    )


def time_column(name: str, index: int) -> Column | None:
    """Return the column of a time that a column map names ``time``, ``date`` or ``time_ms``; None for another name."""
    stem, _, unit = name.rpartition("_")
    if name in TIME_KEYS:
        return Column(name, index, name, "text", None)
    known = stem == "time" and FOREIGN_UNITS.get(unit, ("", 0.0))[0] == "time"
    return Column(name, index, "time", "text", unit) if known else None
