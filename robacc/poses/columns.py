"""What one column of a pose file may be called: the contract's names, units, and the joints' own names."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from robacc.io.problem_log import ProblemLog

Kind = Literal["length", "angle", "joint", "ratio", "number", "text"]

UNITS: Mapping[str, tuple[str, float]] = {
    "m": ("length", 1.0),
    "mm": ("length", 1e3),
    "um": ("length", 1e6),
    "rad": ("angle", 1.0),
    "mrad": ("angle", 1e3),
    "deg": ("angle", 180.0 / math.pi),
}
"""Unit in a column's name: what it measures, and how many make one SI unit (x / 1e3 rounds once, x * 1e-3 twice)."""

AXES = ("x", "y", "z")
QUATERNION = ("qw", "qx", "qy", "qz")
ROTATION_VECTOR = ("rx", "ry", "rz")
RPY = ("roll", "pitch", "yaw")
ORIENTATIONS = (QUATERNION, ROTATION_VECTOR, RPY)
SIGMAS = tuple(f"sigma_{axis}" for axis in AXES)
TEXTS = ("pose", "cycle", "target")
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
"""Every column name without a joint's number in it."""
JOINT_COLUMN = re.compile(r"(dir_|speed_)?q([1-9]\d{0,2})", re.ASCII)


@dataclass(frozen=True, slots=True)
class Column:
    """One column of the file that robacc reads."""

    name: str
    """As the file has it."""
    index: int
    """Its place in the file, from 0."""
    key: str
    """Name of the contract without a unit: ``q1``, ``cmd_x``, ``dir_q2``."""
    kind: Kind
    unit: str | None
    """Unit in the name; None for a bare name, which is SI."""

    @property
    def divisor(self) -> float:
        """How many of the column's unit make one SI unit."""
        return 1.0 if self.unit is None else UNITS[self.unit][1]


@dataclass(frozen=True, slots=True)
class Names:
    """What a column may be called in one file, for one robot."""

    joint_names: tuple[str, ...]
    joint_types: tuple[str, ...]
    own: dict[str, str] = field(default_factory=dict)
    """Joint's own name, also behind ``dir_`` and ``speed_``, to key."""

    @classmethod
    def of(
        cls, header_names: Sequence[str], joint_names: Sequence[str] | None, joint_types: Sequence[str] | None
    ) -> Names:
        """Names for a robot's joints and their types, either of which may be unknown, in a file of this header."""
        names = tuple(joint_names or ())
        # A robot whose joints are called q0 … q5 has a q1 that is the second of them. The contract's own numbering
        # goes first where the file has all of it; then the joints' names, where it has all of those.
        bare = {split_unit(name)[0] for name in header_names} | set(header_names)
        numbered = {f"q{i + 1}" for i in range(len(names))}
        trusted = set(names) <= bare and not numbered <= bare
        own = {}
        for i, name in enumerate(names):
            for prefix in ("", "dir_", "speed_"):
                word = f"{prefix}{name}"
                if word not in FIXED_KINDS and (trusted or not JOINT_COLUMN.fullmatch(word)):
                    own[word] = f"{prefix}q{i + 1}"
        return cls(names, tuple(joint_types or ()), own)

    def key(self, word: str) -> str | None:
        """Key of a name without unit, or None where it is not known."""
        if word in self.own:
            return self.own[word]
        return word if word in FIXED_KINDS or JOINT_COLUMN.fullmatch(word) else None

    def kind(self, key: str) -> Kind:
        """What the column of a key holds; a joint of unknown type may be an angle or a length."""
        match = JOINT_COLUMN.fullmatch(key)
        if match is None:
            return FIXED_KINDS[key]
        if match[1]:
            return "ratio"
        number = int(match[2])
        if number > len(self.joint_types):
            return "joint"
        return "length" if self.joint_types[number - 1] == "prismatic" else "angle"

    def nearest(self, word: str) -> str:
        """The known name that is spelt most like ``word``, with or without a unit."""
        import difflib

        joints = self.joint_names or tuple(f"q{i + 1}" for i in range(6))
        bare = {**FIXED_KINDS, **{name: "joint" for name in joints}}
        units = [(unit, quantity) for unit, (quantity, _) in UNITS.items()]
        suffixed = [f"{name}_{unit}" for name, kind in bare.items() for unit, what in units if _fits(kind, what)]
        motions = [f"{prefix}{name}" for prefix in ("dir_", "speed_") for name in joints]
        # The beginning will do: the comparison's cost grows with the length of both.
        return difflib.get_close_matches(word[:64].lower(), [*bare, *motions, *suffixed], n=1, cutoff=0.0)[0]


def split_unit(name: str) -> tuple[str, str | None]:
    """A name without its unit, and the unit; the name itself and None where it has none."""
    word, _, unit = name.rpartition("_")
    return (word, unit) if word and unit in UNITS else (name, None)


def _fits(kind: str, quantity: str) -> bool:
    return kind == quantity or kind == "joint"


def parse_column(name: str, index: int, names: Names, log: ProblemLog, line: int | None) -> Column | None:
    """The column of that name, None where it is unknown; a unit that cannot be is logged."""
    key, unit = names.key(name), None
    if key is None:
        word, unit = split_unit(name)
        key = names.key(word) if unit else None
    if key is None:
        return None
    kind = names.kind(key)
    if unit is not None and not _fits(kind, UNITS[unit][0]):
        wanted = {"angle": "an angle (rad, mrad, deg)", "length": "a length (m, mm, um)"}.get(kind, "no unit")
        log.add(f"found unit {unit} in the name, expected {wanted}", line, name)
        unit = None
    return Column(name, index, key, kind, unit)
