"""Proposal of a column map: what the reader takes each column of an export for, as a file to correct."""

from __future__ import annotations

import os
from collections.abc import Collection
from dataclasses import dataclass, replace

from robacc.io.open_table import open_table
from robacc.io.table import Table, TableOptions
from robacc.poses.columns import JOINT_COLUMN, TIME_KEYS, Column, is_documented
from robacc.poses.layout import Layout, Names, documented_columns, find_columns
from robacc.poses.reading import AS_NAMED, OPEN, UNKNOWN_ROBOT
from robacc.poses.reshaped_tables import with_known_names, with_poses_of_matrices

_RPY = {"rx": "roll", "ry": "pitch", "rz": "yaw"}
"""Documented names of angles about fixed axes."""


@dataclass(frozen=True, slots=True)
class ColumnProposal:
    """A column map, as text, and what it leaves open."""

    text: str
    open_statements: tuple[str, ...]
    """Keys that the user has to fill in."""
    open_columns: tuple[str, ...]
    """What the names of columns leave open, such as Q1 … Q4 beside joints, and what to do about it."""
    n_columns: int
    """Columns with a meaning."""
    n_named: int
    """All columns with a name."""
    has_commands: bool
    """Whether the file has joint variables or commanded poses beside the measured ones."""


def propose_columns(path: str | os.PathLike[str], map_name: str) -> ColumnProposal:
    """Return a column map for an export; statements that its names leave open stand as ``unknown``.

    Raises:
        InputError: The file cannot be read as a table.
    """
    name = os.fspath(path)
    with open_table(name, TableOptions(is_documented)) as plain:
        plain.names = with_known_names(plain, required=False)
        table = with_poses_of_matrices(plain)
    known = documented_columns(table, Names.of(table.names, UNKNOWN_ROBOT))
    # The map itself asks for the coverage factor, so that it is not a question of columns.
    foreign = find_columns(table, known, replace(AS_NAMED, coverage=1.0))
    statements = _statements(foreign)
    questions = _questions(table, foreign)
    lines = [
        f"# Column map of {os.path.basename(name)} for robacc: a column's name in the file, and its documented name.",
        "# Correct it where it is wrong, then add to any command:",
        f"#   --columns {map_name}",
        "",
        "robacc_columns: 1",
        *(f"{key}: {value:<22} # {comment}" for key, (value, comment) in statements.items()),
        *(f"# open: {question}" for question in questions),
        *(["columns:", *_entries(table, foreign)] if table is plain else [f"# {table.description()}"]),
    ]
    unanswered = tuple(key for key, (value, _) in statements.items() if value == OPEN)
    return ColumnProposal(
        "\n".join(lines) + "\n",
        unanswered,
        questions,
        len(foreign.columns),
        sum(map(bool, table.names)),
        _has_commands(foreign),
    )


def _questions(table: Table, foreign: Layout) -> tuple[str, ...]:
    """Return what the names leave open: the questions of the log, and joints under the robot's own names."""
    texts = [
        f"{problem.column}: {problem.message}" if problem.column else problem.message for problem in table.log.problems
    ]
    result = [f"{text}; name them, or leave them empty" for text in texts]
    if not foreign.columns and all(name.startswith("column ") for name in table.names):
        result.append(
            "the file has no names; name its columns, in their units, as in q1_deg, q2_deg … (joints in the order of "
            "the chain) and x_mm, y_mm, z_mm"
        )
    elif foreign.unused and not _has_commands(foreign):
        result.append("no column is taken for a joint; name the columns of joints q1 … qN, in the order of the chain")
    return tuple(result)


def _statements(foreign: Layout) -> dict[str, tuple[str, str]]:
    """Return the value and the comment of each statement that the names leave open."""
    result: dict[str, tuple[str, str]] = {}
    candidates = [options for options in foreign.angles.values() if options != ("fixed-xyz",)]
    if candidates:
        options = candidates[0]
        value = options[0] if len(options) == 1 else OPEN
        result["angles"] = (value, f"convention of the angles: {', '.join(options)}")
    if foreign.without_unit:
        result["units"] = (OPEN, "of the names below without a unit, for example mm,deg")
    if any(column.key.startswith("sigma") and not is_documented(column.name) for column in foreign.columns.values()):
        result["coverage"] = (OPEN, "of the uncertainties: 1 if standard, 2 if expanded")
    return result


def _has_commands(foreign: Layout) -> bool:
    return any(JOINT_COLUMN.fullmatch(key) or key.startswith("cmd_") for key in foreign.columns)


def _entries(table: Table, foreign: Layout) -> list[str]:
    by_index = {column.index: column for column in foreign.columns.values()}
    fixed = {prefix for prefix, options in foreign.angles.items() if options == ("fixed-xyz",)}

    lines = []
    for index, name in enumerate(table.names):
        if not name:
            continue
        quoted = '"' + name.replace("\\", "\\\\").replace('"', '\\"') + '"'
        column = by_index.get(index)
        meaning = "" if column is None else _meaning(column, fixed)
        lines.append(f"  {quoted}: {meaning}" if meaning else f"  {quoted}:    # not read")
    return lines


def _meaning(column: Column, fixed: Collection[str]) -> str:
    """Return the documented name; ``fixed`` has the prefixes of angles that are certainly about fixed axes."""
    key = column.key
    prefix = "cmd_" if key.startswith("cmd_") else ""
    if prefix in fixed and key.removeprefix(prefix) in _RPY:
        key = prefix + _RPY[key.removeprefix(prefix)]
    if key in TIME_KEYS:
        return key if column.unit is None else f"{key}_{column.unit}"
    plain = column.unit is None or key in ("temperature_c", "payload_kg")
    return key if plain else f"{key}_{column.unit}"
