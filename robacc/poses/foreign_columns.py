"""Columns of a table that an instrument or a robot wrote: what each name is taken for, and what must be asked."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from robacc.io.problem_log import ProblemLog
from robacc.io.table_parts import Header
from robacc.poses.columns import AXES, FIXED_KINDS, FOREIGN_UNITS, SIGMAS, UNITS, Column, Kind, Names
from robacc.poses.heading_candidates import HeadingCandidate, choose
from robacc.poses.headings import TIME_KEYS, heading_of, meaning_of
from robacc.poses.reading import Reading

_CANDIDATES: Mapping[str, tuple[str, ...]] = {
    "axes": ("rotvec", "fixed-xyz", "moving-xyz"),
    "abc": ("kuka-abc", "fixed-xyz", "moving-xyz"),
    "wpr": ("fixed-xyz",),
    "oat": ("zyz",),
    "ur": ("rotvec",),
}
"""Conventions that a family of angle names may belong to; one alone is certain."""
_PREAMBLE_UNITS = re.compile(
    r"\b(?:units?|einheit(?:en)?)\b\W*(?P<unit>mm|millimet\w+|met\w+|m|in|inch\w*)\b", re.IGNORECASE
)


_WITH_UNIT = ("length", "angle", "joint")
"""Kinds of columns that need a unit."""


@dataclass(slots=True)
class ForeignColumns:
    """Columns with a meaning, and the statements about them."""

    columns: dict[str, Column] = field(default_factory=dict)
    """By key; for times, the keys of :data:`~robacc.poses.headings.TIME_KEYS`."""
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
    header: Header, known: Mapping[str, Column], names: Names, reading: Reading, log: ProblemLog
) -> ForeignColumns:
    """Return the columns that the header's names stand for; ambiguous names and missing units go to ``log``.

    Args:
        header: Names in the file.
        known: Columns whose names are documented; they stay as they are.
        names: The robot's joints.
        reading: Statements of the user.
        log: Takes questions.
    """
    result = ForeignColumns(dict(known))
    chosen = choose(header, known, names, log)
    units = _PreambleUnits.of(header)
    nameless: list[Column] = []
    for key, candidate in chosen.items():
        column = _column(key, candidate, names, reading, units, log, header.line)
        result.columns[key] = column
        if candidate.heading.unit is not None:
            result.wrong_unit |= column.unit is None and column.kind in _WITH_UNIT
        elif column.unit is None and column.kind in _WITH_UNIT:
            nameless.append(column)
        if candidate.meaning.family:
            prefix = "cmd_" if key.startswith("cmd_") else ""
            if not key.removeprefix(prefix).startswith("q"):
                result.angles[prefix] = _CANDIDATES[candidate.meaning.family]
        if candidate.meaning.commanded is False and key.startswith("q"):
            result.remarks.append("joint variables are attained values, used as commands")
    result.without_unit = tuple(_with_unit_of_position(nameless, result))
    _ask_coverage([item for item in chosen.values() if item.meaning.expanded], reading, log, header.line)
    taken = {column.index for column in result.columns.values()}
    result.unused = [name for i, name in enumerate(header.names) if i not in taken and name]
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
    coverage = (reading.coverage or 1.0) if meaning.expanded else 1.0
    return Column(heading.name, candidate.index, key, kind, unit, coverage)


@dataclass(frozen=True, slots=True)
class _PreambleUnits:
    """Unit of length that a line above the table states."""

    unit_of: Mapping[str, str]
    remarks: tuple[str, ...]

    @classmethod
    def of(cls, header: Header) -> _PreambleUnits:
        for text in header.dialect.preamble:
            if match := _PREAMBLE_UNITS.search(text):
                word = match["unit"].lower()
                unit = {"mm": "mm", "mil": "mm", "m": "m", "met": "m"}.get(word[:3], "in")
                return cls({"length": unit}, (f"lengths in {unit}, as {match[0].strip()!r} says",))
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
    return f"{column.key}_{column.unit}"


def compact(names: Sequence[str]) -> str:
    """Return the names, of many only the first and the last ones."""
    return ", ".join(names) if len(names) <= 9 else f"{', '.join(names[:4])}, …, {', '.join(names[-2:])}"
