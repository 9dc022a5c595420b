"""Write poses as CSV text in SI units, which :func:`robacc.poses.csv_file.read_poses` reads back."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array, quaternion_from_rotation
from robacc.measurements import Measurements
from robacc.poses.columns import AXES, CIRCUMSTANCES, QUATERNION, SIGMAS, TEXTS
from robacc.poses.plausibility import lengths_too_large
from robacc.poses.values import COMMANDED_AXES

_BLOCK = 4096
"""Rows written at a time."""


def format_poses(measurements: Measurements, *, attained: bool = True) -> str:
    """Return the poses as CSV text, each number in the fewest digits that give the same float.

    Columns are SI without a unit in their names, except for positions that would look like mm; orientation is a
    quaternion with w >= 0. Without ``attained`` the poses are planned and have no attained columns.
    """
    return "".join(pose_pieces(measurements, attained=attained))


def pose_pieces(measurements: Measurements, *, attained: bool = True) -> Iterator[str]:
    """Yield the text of :func:`format_poses` in pieces of some thousand rows, to limit the memory used."""
    for start in range(0, max(measurements.n, 1), _BLOCK):
        columns = _columns(measurements.subset(slice(start, start + _BLOCK)), attained)
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        if start == 0:
            with_unit = _names_that_need_a_unit(measurements)
            writer.writerow([f"{name}_m" if name in with_unit else name for name, _ in columns])
        writer.writerows(zip(*(column for _, column in columns), strict=True))
        yield out.getvalue()


def _names_that_need_a_unit(measurements: Measurements) -> tuple[str, ...]:
    """Return the columns whose metres would be read as millimetres without a unit in the name."""
    positions = ((AXES, measurements.position), (COMMANDED_AXES, measurements.commanded_position))
    return tuple(
        name
        for names, position in positions
        if position is not None and position.size and lengths_too_large(position)
        for name in names
    )


def _columns(measurements: Measurements, attained: bool) -> list[tuple[str, Sequence[str]]]:
    columns: list[tuple[str, Sequence[str]]] = []
    joints = [f"q{i + 1}" for i in range(_joint_count(measurements))]
    _add(columns, joints, measurements.q)
    if attained:
        _add(columns, AXES, measurements.position)
        _add(columns, QUATERNION, _quaternion(measurements.rotation))
    _add(columns, COMMANDED_AXES, measurements.commanded_position)
    _add(columns, [f"cmd_{name}" for name in QUATERNION], _quaternion(measurements.commanded_rotation))
    _add(columns, SIGMAS, measurements.sigma_position)
    _add(columns, ["sigma_r"], measurements.sigma_rotation)
    circumstances = (measurements.time, measurements.temperature, measurements.payload)
    for name, values in zip(CIRCUMSTANCES, circumstances, strict=True):
        _add(columns, [name], values)
    if measurements.direction is not None:
        for name, row in zip(joints, measurements.direction, strict=True):
            columns.append((f"dir_{name}", [str(int(value)) for value in row]))
    _add(columns, [f"speed_{name}" for name in joints], measurements.speed)
    _add(columns, [f"read_{name}" for name in joints], measurements.read_back)
    _add(columns, measurements.branch_names, measurements.branches)
    # Text goes last: an id that begins with # would make a comment of its row.
    for name in TEXTS:
        if (texts := getattr(measurements, name)) is not None:
            columns.append((name, [str(text) for text in texts]))
    return columns


def _add(columns: list[tuple[str, Sequence[str]]], names: Sequence[str], values: NDArray[np.float64] | None) -> None:
    if values is not None:
        rows = values.reshape(len(names), -1) if values.size else np.empty((len(names), 0))
        columns.extend((name, [repr(value) for value in row.tolist()]) for name, row in zip(names, rows, strict=True))


def _quaternion(rotation: Array | None) -> Array | None:
    return None if rotation is None else quaternion_from_rotation(rotation)


def _joint_count(measurements: Measurements) -> int:
    for values in (measurements.q, measurements.direction, measurements.speed):
        if values is not None:
            return int(values.shape[0])
    return 0
