"""Proposal of a column map: what the reader takes each column of an export for, as a file to correct."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

from robacc.io.column_table import open_table
from robacc.io.table import TableOptions
from robacc.poses.columns import JOINT_COLUMN, Column, is_documented
from robacc.poses.layout import Layout, Names, documented_columns, find_columns
from robacc.poses.reading import AS_NAMED, OPEN, UNKNOWN_ROBOT
from robacc.poses.reshaped_tables import with_known_names, with_poses_of_matrices

_RPY = {"rx": "roll", "ry": "pitch", "rz": "yaw"}
"""Documented names of angles about fixed axes."""
_CERTAIN = ("fixed-xyz",)
"""Conventions of angles whose names leave no other."""


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
    found = find_columns(table, known, replace(AS_NAMED, coverage=1.0))
    columns = found.columns
    has_commands = any(JOINT_COLUMN.fullmatch(key) or key.startswith("cmd_") for key in columns)
    conventions_left = next((options for options in found.angles.values() if options != _CERTAIN), ())
    convention = conventions_left[0] if len(conventions_left) == 1 else OPEN
    is_uncertain = any(key.startswith("sigma") and not is_documented(column.name) for key, column in columns.items())
    statements = {
        "angles": (conventions_left, convention, f"convention of the angles: {', '.join(conventions_left)}"),
        "units": (found.without_unit, OPEN, "of the names below without a unit, for example mm,deg"),
        "coverage": (is_uncertain, OPEN, "of the uncertainties: 1 if standard, 2 if expanded"),
    }
    stated = {key: (value, comment) for key, (applies, value, comment) in statements.items() if applies}
    questions = [
        f"{f'{problem.column}: ' if problem.column else ''}{problem.message}; name them, or leave them empty"
        for problem in table.log.problems
    ]
    if not columns and all(text.startswith("column ") for text in table.names):
        questions.append(
            "the file has no names; name its columns, in their units, as in q1_deg, q2_deg … (joints in the order of "
            "the chain) and x_mm, y_mm, z_mm"
        )
    elif found.unused and not has_commands:
        joints = "name the columns of joints q1 … qN, in the order of the chain"
        questions.append(f"no column is taken for a joint; {joints}")
    meanings = {column.index: _meaning(column, found) for column in columns.values()}
    escaped = [text.replace("\\", "\\\\").replace('"', '\\"') for text in table.names]
    entries = [f'  "{text}": {meanings.get(i) or "   # not read"}' for i, text in enumerate(escaped) if text]
    lines = [
        f"# Column map of {os.path.basename(name)} for robacc: a column's name in the file, and its documented name.",
        "# Correct it where it is wrong, then add to any command:",
        f"#   --columns {map_name}",
        "",
        "robacc_columns: 1",
        *(f"{key}: {value:<22} # {comment}" for key, (value, comment) in stated.items()),
        *(f"# open: {question}" for question in questions),
        *(["columns:", *entries] if table is plain else [f"# {table.log.remark}"]),
    ]
    unanswered = tuple(key for key, (value, _) in stated.items() if value == OPEN)
    n_named = sum(map(bool, table.names))
    return ColumnProposal("\n".join(lines) + "\n", unanswered, tuple(questions), len(columns), n_named, has_commands)


def _meaning(column: Column, found: Layout) -> str:
    """Return the documented name with its unit; angles that are certainly about fixed axes are roll, pitch, yaw."""
    prefix = "cmd_" if column.key.startswith("cmd_") else ""
    stem = column.key.removeprefix(prefix)
    is_certain = found.angles.get(prefix) == _CERTAIN
    return replace(column, key=prefix + _RPY.get(stem, stem)).label if is_certain else column.label
