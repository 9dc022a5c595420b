"""Columns of a table that an instrument or a robot wrote: what each name is taken for, and why."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

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
    is_pose_word,
    meaning_of,
)
from robacc.poses.reading import Reading

# Coordinates of a table that names or numbers its only body: ``Model1 Tx``, ``x1``, and angles ``phix1``.

_NUMBERED = re.compile(r"(?P<axis>(?:phi)?[xyz]) (?P<body>\d+)")
_OF_BODY = re.compile(r"(?P<body>.*\w\w.*) (?P<axis>t?[xyz]|q[wxyz])")


def without_body(headings: Sequence[Heading]) -> list[Heading]:
    """Return headings without the name or number of the only body that is measured."""
    texts = [item.text for item in headings]
    for form in (_NUMBERED, _OF_BODY):
        matches = [match for text in texts if (match := form.fullmatch(text))]
        axes = sorted(match["axis"][-1] for match in matches if match["axis"] in (*AXES, "tx", "ty", "tz"))
        bodies = {match["body"] for match in matches}
        if len(bodies) == 1 and axes == [*AXES] and not {*texts} & {*AXES} and not any(map(is_pose_word, bodies)):
            axis_of = {match[0]: match["axis"].replace("phi", "r") for match in matches}
            return [replace(item, words=(axis_of[item.text],)) if item.text in axis_of else item for item in headings]
    return [*headings]


# What the names of a foreign table's columns may stand for, and the choice among names that compete for a meaning.

_JOINT = re.compile(r"q\d+")
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


class _Candidate(NamedTuple):
    """A column, and what its name may stand for."""

    place: int
    """Index in the file."""
    heading: Heading
    meaning: Meaning


def _candidates(table: Table, names: Names) -> Iterator[_Candidate]:
    """Yield what the names stand for, by keys; a unit behind the numbers that a name contradicts goes to the log."""
    headings = without_body([heading_of(name) for name in table.names])
    siblings = frozenset(heading.text for heading in headings)
    for i, heading in enumerate(headings):
        unit = table.cell_units.get(i, heading.unit)
        if heading.unit not in (None, unit):
            message = f"the cells are in {unit}, but the name is of {heading.unit}"
            table.log.add(message, table.line, heading.name)
        joint = _named_joint(heading, names)
        meaning = Meaning(joint, si=is_of_ros(heading)) if joint else meaning_of(heading, siblings)
        if meaning is None:
            continue
        is_command = meaning.commanded and meaning.key in FIXED_KINDS and f"cmd_{meaning.key}" in FIXED_KINDS
        key = f"cmd_{meaning.key}" if is_command else meaning.key
        # One uncertainty may be of all axes.
        for name in SIGMAS if key == "sigma" else (key,):
            yield _Candidate(i, replace(heading, unit=unit), replace(meaning, key=name))


def _named_joint(heading: Heading, names: Names) -> str | None:
    """Return the key of the robot's joint whose name stands in the heading."""
    text = heading.name.lower()
    for i, name in enumerate(names.joint_names):
        if len(name) > 2 and re.search(rf"(?<![a-z0-9_]){re.escape(name.lower())}(?![a-z0-9])", text):
            others = set(re.findall(r"[a-z]+", text.replace(name.lower(), " ")))
            if not others & {"velocity", "effort", "vel", "speed", "torque", "acceleration", "current", "error"}:
                return f"q{i + 1}"
    return None


def _by_key(candidates: list[_Candidate], known: Mapping[str, Column]) -> dict[str, list[_Candidate]]:
    """Return the columns that may be those of a key, with joints counted from 1."""
    keys = [item.meaning.key for item in candidates]
    counted = {item.heading.text: i for i, item in enumerate(candidates) if re.fullmatch(r"q \d", item.heading.text)}
    others = {*(key for i, key in enumerate(keys) if i not in counted.values()), *known}
    is_quaternion = sorted(counted) == ["q 1", "q 2", "q 3", "q 4"] and not {"qw", "qx"} & (others - {*known})
    if is_quaternion and any(map(_JOINT.fullmatch, others)):
        # Q1 … Q4 beside joints of other names are a quaternion, in an order that is open.
        for name, key in zip(sorted(counted), QUATERNION, strict=True):
            candidates[counted[name]] = candidates[counted[name]]._replace(meaning=Meaning(key, family="quaternion"))
    candidates = [item for item in candidates if item.meaning.key not in known]
    from_zero = any(item.meaning.key == "q0" for item in candidates)
    result: dict[str, list[_Candidate]] = {}
    for item in candidates:
        key = item.meaning.key
        key = f"q{int(key[1:]) + 1}" if from_zero and _JOINT.fullmatch(key) else key
        result.setdefault(key, []).append(item)
    return result


def _chosen(table: Table, known: Mapping[str, Column], names: Names) -> dict[str, _Candidate]:
    """Return the column for each key that the names stand for; two that are equally good are a question."""
    used = {column.index for column in known.values()}
    candidates = [item for item in _candidates(table, names) if item.place not in used]
    result: dict[str, _Candidate] = {}
    read_back: dict[str, _Candidate] = {}
    for key, items in _by_key(candidates, known).items():
        if _JOINT.fullmatch(key):
            # The commanded joints are wanted; attained ones stand in where the file has no others, else beside them.
            attained = [item for item in items if item.meaning.commanded is False]
            others = [item for item in items if item.meaning.commanded is not False]
            if len(attained) == len(others) == 1 and attained[0].heading.unit == others[0].heading.unit:
                read_back[f"read_{key}"] = attained[0]
            items = [item for item in others if item.meaning.commanded] or others or items
        if len(items) > 1 and FIXED_KINDS.get(key) != "text":
            listed = " or ".join(repr(item.heading.name) for item in items)
            message = f"found several columns for {key}: {listed}"
            table.log.add(message, table.line, fix="choose with `columns`")
        result[key] = items[0]
    return result | (read_back if len(read_back) == sum(map(bool, map(_JOINT.fullmatch, result))) else {})


@dataclass(slots=True)
class ForeignColumns:
    """Columns with a meaning, and the statements about them."""

    columns: dict[str, Column] = field(default_factory=dict)
    """By key; for times, the keys of :data:`~robacc.poses.columns.TIME_KEYS`."""
    unused: list[str] = field(default_factory=list)
    angles: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Conventions that the angles may belong to, by the prefix of their keys: ``""`` or ``cmd_``; without an entry they
    are documented."""
    remarks: list[str] = field(default_factory=list)
    without_unit: tuple[Column, ...] = ()
    """Lengths and angles whose unit is stated nowhere."""
    wrong_unit: bool = False
    """Whether a heading states a unit of another quantity."""
    unit_of_position: tuple[str, ...] = ()
    """Keys of uncertainties whose unit is taken to be that of the position."""


def find_columns(table: Table, known: Mapping[str, Column], names: Names, reading: Reading) -> ForeignColumns:
    """Return the columns that the names of a table stand for; ambiguous names and missing units go to its log.

    Args:
        table: Table whose names are taken.
        known: Columns whose names are documented; they stay as they are.
        names: The robot's joints.
        reading: Statements of the user.
    """
    result = ForeignColumns(dict(known))
    chosen = _chosen(table, known, names)
    open_keys = [key for key, item in chosen.items() if item.meaning.expanded and reading.coverage is None]
    expanded = dict.fromkeys(chosen.pop(key).heading.name for key in open_keys)
    of_preamble, remark = _unit_of_preamble(table)
    nameless: list[Column] = []
    for key, candidate in chosen.items():
        column = _column(key, candidate, names, reading, of_preamble, table)
        result.columns[key] = column
        if column.unit is None and column.kind in _WITH_UNIT:
            result.wrong_unit |= candidate.heading.unit is not None
            nameless += [column] if candidate.heading.unit is None else []
        is_joint = JOINT_COLUMN.fullmatch(key) is not None
        if candidate.meaning.family and not is_joint:
            result.angles["cmd_" if key.startswith("cmd_") else ""] = _CANDIDATES[candidate.meaning.family]
        if candidate.meaning.commanded is False and is_joint:
            result.remarks = ["joint variables are attained values, used as commands"]
    units = {result.columns[axis].unit for axis in AXES if axis in result.columns}
    sigmas = [column for column in nameless if column.key in SIGMAS]
    if sigmas and len(units) == 1 and (unit := next(iter(units))) is not None:
        # Uncertainties without a unit have that of the position.
        result.columns |= {column.key: replace(column, unit=unit) for column in sigmas}
        result.unit_of_position = tuple(column.key for column in sigmas)
        text = compact([column.name for column in sigmas])
        result.remarks.append(f"{text} taken as {unit}, the unit of {result.columns['x'].name}; `units` states another")
        nameless = [column for column in nameless if column not in sigmas]
    result.without_unit = tuple(nameless)
    taken = {column.index for column in result.columns.values()}
    result.unused = [name for i, name in enumerate(table.names) if i not in taken and name]
    result.remarks += [remark] if remark else []
    if expanded:
        ways = "1 for a standard uncertainty, 2 for an expanded one with coverage factor 2"
        result.remarks.append(f"to use the uncertainties {compact([*expanded])}, give `coverage`: {ways}")
    return result


def _column(
    key: str, candidate: _Candidate, names: Names, reading: Reading, of_preamble: str | None, table: Table
) -> Column:
    heading, meaning = candidate.heading, candidate.meaning
    kind: Kind = "text" if key in TIME_KEYS else names.kind(key)
    unit = heading.unit
    quantity = {"joint": "angle"}.get(kind, kind)
    expected = {"temperature_c": "temperature", "payload_kg": "mass"}.get(key, "time" if key in TIME_KEYS else quantity)
    if expected not in ("length", "angle", "time", "temperature", "mass"):
        unit = None
    elif unit is not None:
        stated = {**UNITS, **FOREIGN_UNITS}[unit][0]
        if stated != expected and not (kind == "joint" and stated == "length"):
            table.log.add(f"found unit {unit} for {key}, expected a unit of {expected}", table.line, heading.name)
            unit = None
    if unit is None and quantity in ("length", "angle"):
        unit = (of_preamble if quantity == "length" else None) or reading.unit_of.get(quantity)
        if unit is None and meaning.si:
            unit = "m" if quantity == "length" else "rad"
    coverage = (reading.coverage or 1.0) if meaning.expanded else meaning.coverage
    return Column(heading.name, candidate.place, key, kind, unit, coverage)


def _unit_of_preamble(table: Table) -> tuple[str | None, str]:
    """Return the unit of length that a line above the table states, and a remark."""
    match = next(filter(None, map(_PREAMBLE_UNITS.search, table.dialect.preamble)), None)
    if match is None:
        return None, ""
    unit = {"mm": "mm", "mil": "mm", "m": "m", "met": "m"}.get(match["unit"].lower()[:3], "in")
    return unit, f"lengths in {unit}, as {match[0].strip(' ([')!r} says"


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
