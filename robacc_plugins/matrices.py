"""Reader of 4 x 4 matrices as text without names: below each other, or side by side in four lines.

Programs of hand-eye calibration write the poses of the hand and of the board so, a file of each.
"""

from __future__ import annotations

import hashlib
import io
import re
from typing import BinaryIO

import numpy as np

from robacc.geometry import Array
from robacc.io.column_table import ColumnTable
from robacc.io.table import Table, TableOptions, TextTable

_NUMBERS = re.compile(r"[-+.\deE,;\s]*")
_SIZE = 4
_LAST = (0.0, 0.0, 0.0, 1.0)
_WIDE = 1000
"""Characters of a line that may be the first of many matrices side by side."""


def takes(path: str, first: bytes) -> bool:
    """Return whether a text of numbers alone has matrices of four lines, or lines that are as long as those of many."""
    text = first.decode(errors="replace").lstrip("\ufeff")
    if not first or not _NUMBERS.fullmatch(text):
        return False
    # The last line may be cut off.
    lines = [line for line in f"{text}\n".splitlines() if line.strip()]
    matrix = _matrices("\n".join(lines[:_SIZE])) if len(lines) >= _SIZE else None
    return matrix is not None or (len(lines) <= _SIZE and len(lines[0]) >= _WIDE)


def read_stream(stream: BinaryIO, file: str, options: TableOptions) -> Table:
    """Return a row of 16 entries for each matrix; a table of numbers where the text has no matrices."""
    data = stream.read()
    matrices = _matrices(data.decode(errors="replace").lstrip("\ufeff"))
    if matrices is None:
        return TextTable(io.BytesIO(data), file, options)
    entries = [(f"m_{row}{column}", matrices[:, row, column]) for row in range(_SIZE) for column in range(_SIZE)]
    digest = hashlib.sha256(data).hexdigest()
    table = ColumnTable(entries, file, options.skip_gaps, digest, f"{len(matrices)} matrices of {_SIZE} lines")
    table.log.counted = "pose"
    return table


def _matrices(text: str) -> Array | None:
    """Return the matrices ``(N, 4, 4)``; None for other numbers."""
    lines = [re.split(r"[,;\s]+", line.strip(" \t,;")) for line in text.splitlines() if line.strip()]
    widths = {len(line) for line in lines}
    if len(lines) % _SIZE or len(widths) != 1 or widths.pop() % _SIZE or (len(lines) > _SIZE and len(lines[0]) > _SIZE):
        return None
    try:
        values = np.array(lines, dtype=float)
    except ValueError:
        return None
    matrices = values.reshape(len(lines) // _SIZE, _SIZE, -1, _SIZE).swapaxes(1, 2).reshape(-1, _SIZE, _SIZE)
    return matrices if (matrices[:, 3] == _LAST).all() else None
