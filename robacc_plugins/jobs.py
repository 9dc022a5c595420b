"""Reader of the positions of Yaskawa's jobs (``.JBI``), as commands in the order of the moves."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from typing import BinaryIO

import numpy as np

from robacc.errors import Problem, refuse
from robacc.io.column_table import ColumnTable
from robacc.io.dialect import NUMBER
from robacc.io.files import bytes_of, decode
from robacc.io.table import TableOptions

_NAMES = {
    "///ANGLE": tuple(f"q{i}_deg" for i in range(1, 7)),
    "///RECTAN": ("cmd_x_mm", "cmd_y_mm", "cmd_z_mm", "cmd_roll_deg", "cmd_pitch_deg", "cmd_yaw_deg"),
}
"""Columns of the positions below a line."""


def _are_numbers(cells: Sequence[str]) -> bool:
    """Return whether cells are the numbers of a position; those of outer axes may follow."""
    return len(cells) >= 6 and all(map(NUMBER.fullmatch, cells[:6]))


def takes(path: str, first: bytes) -> bool:
    """Return whether a file is a job, by its name."""
    return path.lower().endswith(".jbi")


def read_stream(stream: BinaryIO, file: str, options: TableOptions) -> ColumnTable:
    """Return the positions of the moves of a job; a comment behind a move names its pose.

    Raises:
        InputError: The positions count pulses, or the job has no moves.
    """
    data = bytes_of(stream, file)
    text = decode(data, file)
    form = next((form for form in _NAMES if form in text), None)
    points = {name: values.split(",") for name, values in re.findall(r"^(C\d+)=(\S+)", text, re.M)}
    moves = [move for move in re.findall(r"^MOV\w*\s+(C\d+)\b[^'\n]*'?[ \t]*(\S*)", text, re.M) if move[0] in points]
    wrong = next((name for name, _ in moves if form and not _are_numbers(points[name])), None)
    line = text.count("\n", 0, text.find(f"\n{wrong}=") + 1) + 1
    fix = "list the joint angles in degrees, or the poses, in a CSV"
    refuse(
        (
            form is None,
            Problem("is a job of Yaskawa, whose positions count pulses of the motors", file, fix=fix),
        ),
        (wrong is not None, Problem(f"expected six numbers for position {wrong}", file, line, fix=fix)),
        (not moves, Problem("is a job of Yaskawa without a move to one of its positions", file, fix=fix)),
    )
    columns = [("pose", np.array([label or name for name, label in moves]))]
    for i, name in enumerate(_NAMES[form or ""]):
        columns.append((name, np.array([float(points[point][i]) for point, _ in moves])))
    return ColumnTable(columns, file, options.skip_gaps, hashlib.sha256(data).hexdigest())
