"""Reader of the positions of Yaskawa's jobs (``.JBI``), as commands in the order of the moves."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from typing import BinaryIO, NamedTuple

import numpy as np

from robacc.errors import Problem, refuse
from robacc.io.column_table import ColumnTable
from robacc.io.dialect import NUMBER
from robacc.io.files import bytes_of, decode
from robacc.io.table import TableOptions

_NAMES = {
    "ANGLE": tuple(f"q{i}_deg" for i in range(1, 7)),
    "RECTAN": ("cmd_x_mm", "cmd_y_mm", "cmd_z_mm", "cmd_roll_deg", "cmd_pitch_deg", "cmd_yaw_deg"),
}
"""Columns of the positions below a line."""
_LINE = re.compile(r"^(?:///(PULSE|ANGLE|RECTAN|TOOL|USER|POSTYPE)\b[ \t]*([\w,]*)|(B?[CP]X?\d+)=(\S+))", re.M)
_MOVE = re.compile(r"^[SE]?MOV\w*\s+(B?[CP]X?\d+)\b[^'\n]*'?[ \t]*(\S*)", re.M)


class _Point(NamedTuple):
    """Position of a job, and what the lines above it say of it."""

    cells: list[str]
    form: str
    """Key of :data:`_NAMES`, or ``PULSE``."""
    frame: str
    """Frame of a pose, and its tool."""


def _points(text: str) -> dict[str, _Point]:
    """Return the positions of a job by name, each with the frame and the tool in force at its line."""
    points, form, state = {}, "", {"TOOL": "0", "USER": "0", "POSTYPE": ""}
    for word, value, name, cells in _LINE.findall(text):
        if name:
            user = f" {state['USER']}" if state["POSTYPE"] == "USER" else ""
            frame = f"{state['POSTYPE']}{user} with TOOL {state['TOOL']}" if form == "RECTAN" else ""
            points[name] = _Point(cells.split(","), form, frame)
        elif word in state:
            state[word] = value
        else:
            form = word
    return points


def _are_numbers(cells: Sequence[str]) -> bool:
    """Return whether cells are the numbers of a position; those of outer axes may follow."""
    return len(cells) >= 6 and all(map(NUMBER.fullmatch, cells[:6]))


def takes(path: str, first: bytes) -> bool:
    """Return whether a file is a job, by its name."""
    return path.lower().endswith(".jbi")


def read_stream(stream: BinaryIO, file: str, options: TableOptions) -> ColumnTable:
    """Return the positions of the moves of a job; a comment behind a move names its pose.

    Raises:
        InputError: The positions count pulses, or are of several kinds, frames or tools, or the job has no moves.
    """
    data = bytes_of(stream, file)
    text = decode(data, file)
    points = _points(text)
    moves = [move for move in _MOVE.findall(text) if move[0] in points]
    used = [points[name] for name, _ in moves] or list(points.values())
    forms = sorted({point.form for point in used})
    frames = sorted({point.frame for point in used})
    wrong = next((name for name, _ in moves if forms[0] in _NAMES and not _are_numbers(points[name].cells)), None)
    line = text.count("\n", 0, text.find(f"\n{wrong}=") + 1) + 1
    fix = "list the joint angles in degrees, or the poses, in a CSV"
    several = "a job of Yaskawa with moves to positions of several kinds"
    refuse(
        (
            not forms or not {*forms} & _NAMES.keys(),
            Problem("is a job of Yaskawa, whose positions count pulses of the motors", file, fix=fix),
        ),
        (len(forms) > 1, Problem(f"is {several}: {', '.join(forms)}", file, fix=fix)),
        (
            len(frames) > 1,
            Problem(f"is {several}: {', '.join(frames)}", file, fix="write one job for each frame and tool"),
        ),
        (wrong is not None, Problem(f"expected six numbers for position {wrong}", file, line, fix=fix)),
        (not moves, Problem("is a job of Yaskawa without a move to one of its positions", file, fix=fix)),
    )
    columns = [("pose", np.array([label or name for name, label in moves]))]
    for i, name in enumerate(_NAMES[forms[0]]):
        columns.append((name, np.array([float(points[point].cells[i]) for point, _ in moves])))
    remark = f"positions are in the frame {frames[0]}" if frames[0] else ""
    return ColumnTable(columns, file, options.skip_gaps, hashlib.sha256(data).hexdigest(), remark)
