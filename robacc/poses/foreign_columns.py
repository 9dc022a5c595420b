"""Columns of a table that an instrument or a robot wrote: what each name is taken for, and why."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from robacc.io.files import ProblemLog
from robacc.io.table import Table
from robacc.poses.columns import (
    AXES,
    FIXED_KINDS,
    FOREIGN_UNITS,
    JOINT_COLUMN,
    QUATERNION,
    SIGMAS,
    TIME_KEYS,
    UNITS,
    Column,
    Heading,
    Kind,
    Meaning,
    Names,
    heading_of,
    is_of_ros,
    meaning_of,
)
from robacc.poses.reading import Reading

# Coordinates of a table that numbers its only point: ``x1, y1, z1``, and angles ``phix1, phiy1, phiz1``.

_NUMBERED = re.compile(r"(phi)?([xyz]) (\d+)")


def single_point(texts: Iterable[str]) -> Mapping[str, Meaning]:
    """Return what numbered coordinates stand for, by text of the heading; empty for no such point or for several.

    Args:
        texts: Texts of the headings of a table, such as ``x 1`` of ``X1``.
    """
    texts = frozenset(texts)
    matches = [match for text in texts if (match := _NUMBERED.fullmatch(text))]
    positions = sorted(match[2] for match in matches if not match[1])
    if len({match[3] for match in matches}) != 1 or positions != list(AXES) or texts & set(AXES):
        return {}
    return {match[0]: Meaning(f"r{match[2]}", family="axes") if match[1] else Meaning(match[2]) for match in matches}


# What the names of a foreign table's columns may stand for, and the choice among names that compete for a meaning.


@dataclass(frozen=True, slots=True)
class HeadingCandidate:
    """A column, and the documented column that its name may stand for."""

    heading: Heading
    index: int
    meaning: Meaning
    key: str


def choose(table: Table, known: Mapping[str, Column], names: Names, log: ProblemLog) -> dict[str, HeadingCandidate]:
    """Return the column for each key that the names stand for; what they leave open goes to ``log``.

    Args:
        table: Table whose names are taken.
        known: Columns whose names are documented; they stay as they are.
        names: The robot's joints.
        log: Takes questions.
    """
    used = {column.index for column in known.values()}
    candidates = [candidate for candidate in _candidates(table, names, log) if candidate.index not in used]
    candidates = _with_quaternion(candidates, known)
    candidates = [candidate for candidate in candidates if candidate.key not in known]
    return _without_conflicts(_renumbered(candidates), log, table.line)


def _candidates(table: Table, names: Names, log: ProblemLog) -> Iterator[HeadingCandidate]:
    headings = [_heading(i, table, log) for i in range(len(table.names))]
    siblings = frozenset(heading.text for heading in headings)
    numbered = single_point(siblings)
    for i, heading in enumerate(headings):
        joint = _named_joint(heading, names)
        known = meaning_of(heading, siblings) or numbered.get(heading.text)
        meaning = Meaning(joint, si=is_of_ros(heading)) if joint else known
        if meaning is None:
            continue
        key = meaning.key
        if meaning.commanded and key in FIXED_KINDS and f"cmd_{key}" in FIXED_KINDS:
            key = f"cmd_{key}"
        # One uncertainty may be of all axes.
        yield from (HeadingCandidate(heading, i, meaning, name) for name in (SIGMAS if key == "sigma" else (key,)))


def _heading(index: int, table: Table, log: ProblemLog) -> Heading:
    """Return a column's heading with the unit behind its numbers; log a unit that its name contradicts."""
    heading, unit = heading_of(table.names[index]), table.cell_units.get(index)
    if unit is None or heading.unit == unit:
        return heading
    if heading.unit is not None:
        log.add(f"the cells are in {unit}, but the name is of {heading.unit}", table.line, heading.name)
    return replace(heading, unit=unit)


def _named_joint(heading: Heading, names: Names) -> str | None:
    """Return the key of the robot's joint whose name stands in the heading."""
    text = heading.name.lower()
    for i, name in enumerate(names.joint_names):
        if len(name) > 2 and re.search(rf"(?<![a-z0-9_]){re.escape(name.lower())}(?![a-z0-9])", text):
            others = set(re.findall(r"[a-z]+", text.replace(name.lower(), " ")))
            if not others & {"velocity", "effort", "vel", "speed", "torque", "acceleration", "current", "error"}:
                return f"q{i + 1}"
    return None


def _with_quaternion(candidates: Sequence[HeadingCandidate], known: Mapping[str, Column]) -> list[HeadingCandidate]:
    """Return the candidates with Q1 … Q4 beside joints of other names as a quaternion, in an order that is open."""
    numbered = {item.heading.text: item for item in candidates if re.fullmatch(r"q \d", item.heading.text)}
    others = [item for item in candidates if item.heading.text not in numbered]
    has_joints = any(re.fullmatch(r"q\d+", key) for key in (*(item.key for item in others), *known))
    if not has_joints or sorted(numbered) != ["q 1", "q 2", "q 3", "q 4"] or {"qw", "qx"} & {i.key for i in others}:
        return list(candidates)
    pairs = zip(sorted(numbered), QUATERNION, strict=True)
    return others + [replace(numbered[text], key=key, meaning=Meaning(key, family="quaternion")) for text, key in pairs]


def _renumbered(candidates: Sequence[HeadingCandidate]) -> list[HeadingCandidate]:
    """Return the candidates with joints numbered from 1 where the file numbers them from 0."""
    numbers = {int(item.key[1:]) for item in candidates if re.fullmatch(r"q\d+", item.key)}
    if 0 not in numbers:
        return list(candidates)
    return [
        HeadingCandidate(item.heading, item.index, item.meaning, f"q{int(item.key[1:]) + 1}")
        if re.fullmatch(r"q\d+", item.key)
        else item
        for item in candidates
    ]


def _without_conflicts(
    candidates: Sequence[HeadingCandidate], log: ProblemLog, line: int | None
) -> dict[str, HeadingCandidate]:
    """Return one candidate a key; two that are equally good are a question."""
    by_key: dict[str, list[HeadingCandidate]] = {}
    for candidate in candidates:
        by_key.setdefault(candidate.key, []).append(candidate)
    result: dict[str, HeadingCandidate] = {}
    read_back: dict[str, HeadingCandidate] = {}
    for key, items in by_key.items():
        if re.fullmatch(r"q\d+", key):
            # The commanded joints are wanted; attained ones stand in where the file has no others, else beside them.
            if read := _read_back(items):
                read_back[f"read_{key}"] = read
            items = (
                [item for item in items if item.meaning.commanded]
                or [item for item in items if item.meaning.commanded is None]
                or items
            )
        if len(items) > 1 and FIXED_KINDS.get(key) != "text":
            listed = " or ".join(repr(item.heading.name) for item in items)
            log.add(f"found several columns for {key}: {listed}", line, fix="choose with `columns`")
        result[key] = items[0]
    joints = [key for key in result if re.fullmatch(r"q\d+", key)]
    return result | (read_back if len(read_back) == len(joints) else {})


def _read_back(items: Sequence[HeadingCandidate]) -> HeadingCandidate | None:
    """Return the attained joint of a commanded and an attained joint in the same unit; else None."""
    commanded = [item for item in items if item.meaning.commanded is not False]
    attained = [item for item in items if item.meaning.commanded is False]
    if len(commanded) != 1 or len(attained) != 1 or commanded[0].heading.unit != attained[0].heading.unit:
        return None
    return attained[0]


_CANDIDATES: Mapping[str, tuple[str, ...]] = {
    "axes": ("rotvec", "fixed-xyz", "moving-xyz"),
    "abc": ("kuka-abc", "fixed-xyz", "moving-xyz"),
    "wpr": ("fixed-xyz",),
    "oat": ("zyz",),
    "ur": ("rotvec",),
    "quaternion": ("wxyz", "xyzw"),
}
"""Conventions that a family of angle names may belong to; one alone is certain."""
_PREAMBLE_UNITS = re.compile(
    r"(?:\b(?:units?|einheit(?:en)?)\b\W*|^\W*(?=\w+\W*$))(?P<unit>mm|millimet\w+|met\w+|m|in|inch\w*)\b", re.IGNORECASE
)


_WITH_UNIT = ("length", "angle", "joint")
"""Kinds of columns that need a unit."""


@dataclass(slots=True)
class ForeignColumns:
    """Columns with a meaning, and the statements about them."""

    columns: dict[str, Column] = field(default_factory=dict)
    """By key; for times, the keys of :data:`~robacc.poses.columns.TIME_KEYS`."""
    unused: list[str] = field(default_factory=list)
    angles: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Conventions that the angles may belong to, by the prefix of their keys: ``""`` or ``cmd_``."""
    remarks: list[str] = field(default_factory=list)
    without_unit: tuple[Column, ...] = ()
    """Lengths and angles whose unit is stated nowhere."""
    wrong_unit: bool = False
    """Whether a heading states a unit of another quantity."""
    unit_of_position: tuple[str, ...] = ()
    """Keys of uncertainties whose unit is taken to be that of the position."""


def find_columns(
    table: Table, known: Mapping[str, Column], names: Names, reading: Reading, log: ProblemLog
) -> ForeignColumns:
    """Return the columns that the header's names stand for; ambiguous names and missing units go to ``log``.

    Args:
        table: Table whose names are taken.
        known: Columns whose names are documented; they stay as they are.
        names: The robot's joints.
        reading: Statements of the user.
        log: Takes questions.
    """
    result = ForeignColumns(dict(known))
    chosen = choose(table, known, names, log)
    units = _PreambleUnits.of(table)
    nameless: list[Column] = []
    for key, candidate in chosen.items():
        column = _column(key, candidate, names, reading, units, log, table.line)
        result.columns[key] = column
        if candidate.heading.unit is not None:
            result.wrong_unit |= column.unit is None and column.kind in _WITH_UNIT
        elif column.unit is None and column.kind in _WITH_UNIT:
            nameless.append(column)
        if candidate.meaning.family:
            prefix = "cmd_" if key.startswith("cmd_") else ""
            if not JOINT_COLUMN.fullmatch(key):
                result.angles[prefix] = _CANDIDATES[candidate.meaning.family]
        if candidate.meaning.commanded is False and JOINT_COLUMN.fullmatch(key):
            result.remarks.append("joint variables are attained values, used as commands")
    result.without_unit = tuple(_with_unit_of_position(nameless, result))
    _ask_coverage([item for item in chosen.values() if item.meaning.expanded], reading, log, table.line)
    taken = {column.index for column in result.columns.values()}
    result.unused = [name for i, name in enumerate(table.names) if i not in taken and name]
    result.remarks = [*dict.fromkeys(result.remarks), *units.remarks]
    return result


def _with_unit_of_position(nameless: Sequence[Column], result: ForeignColumns) -> list[Column]:
    """Give uncertainties without a unit the unit of the position; return the columns that stay without one."""
    units = {result.columns[axis].unit for axis in AXES if axis in result.columns}
    sigmas = [column for column in nameless if column.key in SIGMAS]
    unit = next(iter(units)) if len(units) == 1 else None
    if unit is None or not sigmas:
        return list(nameless)
    for column in sigmas:
        result.columns[column.key] = replace(column, unit=unit)
    result.unit_of_position = tuple(column.key for column in sigmas)
    names = compact([column.name for column in sigmas])
    result.remarks.append(f"{names} taken as {unit}, the unit of {result.columns['x'].name}; `units` states another")
    return [column for column in nameless if column not in sigmas]


def _column(
    key: str,
    candidate: HeadingCandidate,
    names: Names,
    reading: Reading,
    units: _PreambleUnits,
    log: ProblemLog,
    line: int | None,
) -> Column:
    heading, meaning = candidate.heading, candidate.meaning
    kind: Kind = "text" if key in TIME_KEYS else names.kind(key)
    unit = heading.unit
    quantity = {"joint": "angle"}.get(kind, kind)
    expected = {"temperature_c": "temperature", "payload_kg": "mass"}.get(key, "time" if key in TIME_KEYS else quantity)
    if unit is not None and expected in ("length", "angle", "time", "temperature", "mass"):
        stated = {**UNITS, **FOREIGN_UNITS}[unit][0]
        if stated != expected and not (kind == "joint" and stated == "length"):
            log.add(f"found unit {unit} for {key}, expected a unit of {expected}", line, heading.name)
            unit = None
    if unit is None and quantity in ("length", "angle"):
        unit = units.unit_of.get(quantity) or reading.unit_of.get(quantity)
        if unit is None and meaning.si:
            unit = "m" if quantity == "length" else "rad"
    if unit is not None and expected not in ("length", "angle", "time", "temperature", "mass"):
        unit = None
    coverage = (reading.coverage or 1.0) if meaning.expanded else meaning.coverage
    return Column(heading.name, candidate.index, key, kind, unit, coverage)


@dataclass(frozen=True, slots=True)
class _PreambleUnits:
    """Unit of length that a line above the table states."""

    unit_of: Mapping[str, str]
    remarks: tuple[str, ...]

    @classmethod
    def of(cls, table: Table) -> _PreambleUnits:
        for text in table.dialect.preamble:
            if match := _PREAMBLE_UNITS.search(text):
                word = match["unit"].lower()
                unit = {"mm": "mm", "mil": "mm", "m": "m", "met": "m"}.get(word[:3], "in")
                return cls({"length": unit}, (f"lengths in {unit}, as {match[0].strip(' ([')!r} says",))
        return cls({}, ())


def _ask_coverage(items: Sequence[HeadingCandidate], reading: Reading, log: ProblemLog, line: int | None) -> None:
    if items and reading.coverage is None:
        log.add(
            "an uncertainty U may be a standard uncertainty or an expanded one",
            line,
            compact([item.heading.name for item in items]),
            "give `coverage`: 1 for a standard uncertainty, 2 for an expanded one with coverage factor 2",
        )


def statement(columns: Mapping[str, Column], documented: Mapping[str, Column]) -> str:
    """Return which column was taken for what, without the columns whose names are documented."""
    taken = sorted((column for key, column in columns.items() if key not in documented), key=lambda item: item.index)
    parts = []
    run: list[Column] = []
    for column in (*taken, None):
        if column is not None and run and _continues(run[-1], column):
            run.append(column)
            continue
        if run:
            names, keys = [item.name for item in run], [_key_text(item) for item in run]
            if len(run) > 2:
                parts.append(f"{names[0]} … {names[-1]} -> {keys[0]} … {keys[-1]}")
            else:
                parts += [f"{name} -> {key}" for name, key in zip(names, keys, strict=True)]
        run = [] if column is None else [column]
    return ", ".join(parts)


def _continues(before: Column, column: Column) -> bool:
    """Return whether a joint's column follows that of the joint before it."""
    numbers = [re.fullmatch(r"(read_)?q(\d+)", item.key) for item in (before, column)]
    if numbers[0] is None or numbers[1] is None or numbers[0][1] != numbers[1][1]:
        return False
    return before.unit == column.unit and int(numbers[1][2]) == int(numbers[0][2]) + 1


def documented_name(name: str) -> str | None:
    """Return the documented name that another name stands for; None where it stands for none."""
    heading = heading_of(name)
    meaning = meaning_of(heading, frozenset())
    if meaning is None or meaning.key in TIME_KEYS or meaning.key not in FIXED_KINDS:
        return None
    key = f"cmd_{meaning.key}" if meaning.commanded and f"cmd_{meaning.key}" in FIXED_KINDS else meaning.key
    takes_unit = FIXED_KINDS[key] in ("length", "angle") and heading.unit in UNITS
    return f"{key}_{heading.unit}" if takes_unit else key


def _key_text(column: Column) -> str:
    if column.key in TIME_KEYS:
        return "time_s"
    if column.unit is None or column.key in ("temperature_c", "payload_kg"):
        return column.key
    return f"{column.key}_{column.unit}" + (f" times {column.coverage:g}" if column.coverage != 1 else "")


def compact(names: Sequence[str]) -> str:
    """Return the names, of many only the first and the last ones."""
    return ", ".join(names) if len(names) <= 9 else f"{', '.join(names[:4])}, …, {', '.join(names[-2:])}"
