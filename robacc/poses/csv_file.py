"""Measured poses from and to a CSV file: SI arrays, components first, poses last."""

from __future__ import annotations

import csv
import dataclasses
import io
import os
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.errors import Counted
from robacc.geometry import Array, exp_so3, quaternion_from_rotation, rotation_from_quaternion, rotation_from_rpy
from robacc.io.open_table import Table, open_table
from robacc.measurements import Measurements, motion_between_rows
from robacc.poses.checks import COMMANDED_AXES, Limits, RowChecks, UnitChecks, Values
from robacc.poses.columns import (
    AXES,
    CIRCUMSTANCES,
    FIXED_KINDS,
    JOINT_COLUMN,
    QUATERNION,
    ROTATION_VECTOR,
    RPY,
    SIGMAS,
    TEXTS,
)
from robacc.poses.duplicate_rows import copies
from robacc.poses.layout import Layout, listing, read_layout
from robacc.poses.plausibility import lengths_too_large

_CONVERSIONS: Mapping[str, Callable[[Array], Array]] = {
    QUATERNION[0]: rotation_from_quaternion,
    ROTATION_VECTOR[0]: exp_so3,
    RPY[0]: rotation_from_rpy,
}
"""Rotation from each representation, by its first column."""
_BLOCK = 4096
"""Rotations made at a time: the working arrays of a block stay in the cache."""


def read_poses(
    path: str | os.PathLike[str],
    *,
    joint_names: Sequence[str] | None = None,
    joint_types: Sequence[str] | None = None,
    limits: Limits | None = None,
    target_names: Sequence[str] | None = None,
    ordered: bool = False,
    units_check: bool = True,
    attained: bool = True,
) -> Measurements:
    """The poses of a CSV file, validated.

    Args:
        path: File to read; ``-`` is standard input.
        joint_names: The robot's joints in chain order, whose names are taken for ``q1 … qN``; None: no robot is known.
        joint_types: ``revolute`` or ``prismatic`` of each; None: a joint's unit may be an angle or a length.
        limits: Lowest and highest value of each joint (rad or m), None for a joint without.
        target_names: The targets that the robot file has, empty for a robot with one tool; None: no robot is known, and
            any name will do.
        ordered: Rows are in the order measured, and the robot went straight from each to the next: direction and
            speed are derived for the joints whose columns are missing. The first row, to which nobody knows the way,
            and a row that repeats the joints of the one before get 0.
        units_check: Refuse bare columns whose values look like degrees or millimetres.
        attained: Whether the poses were measured; planned ones may lack x, y, z, which are zero then.

    Raises:
        InputError: Everything that is wrong with the file, with line and column.
    """
    with open_table(os.fspath(path)) as reader:
        header = reader.header()
        log = reader.log
        layout = read_layout(header, log, joint_names, joint_types, attained)
        values = _read_values(reader, layout)
        _check_target_column(layout, target_names or (), reader, header.line)
        rows = RowChecks(values, log)
        rows.sizes()
        units = UnitChecks(values.complete() if log.total else values, log, header.line)
        doubtful = units.run(limits) if units_check else frozenset()
        rows.run(limits, target_names, doubtful)
        log.raise_if_any()
        data = _measurements(values, ordered, log.counted)
        found = (*layout.warnings, *units.warnings, *(f"{reader.file}: {text}" for text in data.warnings))
        found = (*found, *copies(values, reader.file))
        return dataclasses.replace(data, source=reader.file, sha256=reader.sha256, warnings=found)


def _read_values(reader: Table, layout: Layout) -> Values:
    columns = layout.columns
    keys = [key for key in _numeric_order(layout) if key in columns]
    texts = [key for key in TEXTS if key in columns]
    body = reader.body([columns[key].index for key in keys], [columns[key].index for key in texts])
    for row, key in zip(body.numbers, keys, strict=True):
        if columns[key].divisor != 1.0:
            row /= columns[key].divisor
    place = {key: i for i, key in enumerate(keys)}
    return Values(layout, body.numbers, place, dict(zip(texts, body.texts, strict=True)), body.lines)


def _numeric_order(layout: Layout) -> Iterator[str]:
    """Keys of all columns of numbers, the members of a set next to each other."""
    yield from layout.joints()
    for prefix in ("", "cmd_"):
        yield from (f"{prefix}{name}" for name in (*AXES, *QUATERNION, *ROTATION_VECTOR, *RPY))
    yield from (*SIGMAS, "sigma_r", *CIRCUMSTANCES)
    yield from layout.joints("dir_")
    yield from layout.joints("speed_")


def _check_target_column(layout: Layout, target_names: Sequence[str], reader: Table, line: int | None) -> None:
    if len(target_names) > 1 and "target" not in layout.columns and layout.group(layout.joints()) is not None:
        message = f"column target is missing: the robot file has {len(target_names)} targets ({listing(target_names)})"
        reader.log.add(message, line, fix="say in each row which one was measured")


def _measurements(values: Values, ordered: bool, counted: Counted) -> Measurements:
    layout = values.layout
    position = values.several(AXES)
    if position is None:  # of planned poses; else read_layout logged its absence, and the log was raised
        position = np.zeros((3, values.lines.size))
    motion, warnings = _motion(values, ordered, counted)
    return Measurements(
        position=position,
        rotation=_rotation(values, layout.orientation),
        q=values.several(layout.joints()),
        commanded_position=values.several(COMMANDED_AXES),
        commanded_rotation=_rotation(values, layout.commanded_orientation),
        sigma_position=values.several(SIGMAS),
        sigma_rotation=values.one("sigma_r"),
        pose=values.texts.get("pose"),
        cycle=values.texts.get("cycle"),
        target=values.texts.get("target"),
        time=values.one("time_s"),
        temperature=values.one("temperature_c"),
        payload=values.one("payload_kg"),
        direction=motion[0],
        speed=motion[1],
        rows=values.lines,
        counted=counted,
        ordered=ordered,
        warnings=tuple(warnings),
    )


def _rotation(values: Values, keys: tuple[str, ...] | None) -> Array | None:
    """``(3, 3, N)`` from whichever representation the file has."""
    if keys is None or (columns := values.several(keys)) is None:
        return None
    convert = _CONVERSIONS[keys[0].removeprefix("cmd_")]
    result = np.empty((3, 3, columns.shape[1]))
    for start in range(0, columns.shape[1], _BLOCK):
        result[..., start : start + _BLOCK] = convert(columns[:, start : start + _BLOCK])
    return result


def _motion(values: Values, ordered: bool, counted: Counted) -> tuple[tuple[Array | None, Array | None], list[str]]:
    """Direction and speed ``(J, N)``: as given, as derived from the order of rows, or 0 with a warning."""
    layout = values.layout
    q = values.several(layout.joints())
    warnings: list[str] = []
    derived: tuple[Array, Array] | None = None
    if ordered and q is not None:
        derived = motion_between_rows(q)
    elif ordered:
        warnings.append("without joint columns the order of rows does not say how the joints moved")
    if ordered and (time := values.one("time_s")) is not None and np.any(np.diff(time) < 0):
        line = values.lines[int(np.argmax(np.diff(time) < 0)) + 1]
        warnings.append(f"rows are said to be in the order measured, but time_s goes back at {counted} {line}")
    result: list[Array | None] = []
    for number, prefix in enumerate(("dir_", "speed_")):
        keys = layout.joints(prefix)
        missing = [key for key in keys if key not in values.place]
        if not missing and keys:
            result.append(values.several(keys))
        elif derived is None and len(missing) == len(keys):
            result.append(None)
        else:
            table = np.zeros((len(keys), values.lines.size)) if derived is None else derived[number]
            for i, key in enumerate(keys):
                if (column := values.one(key)) is not None:
                    table[i] = column
            result.append(table)
            if derived is None:
                warnings.append(f"no column {listing(missing)}: taken as 0, not moving")
    return (result[0], result[1]), [*warnings, *_opposite(values, counted)]


def _opposite(values: Values, counted: Counted) -> Iterator[str]:
    """A warning for each joint whose direction and speed, both as given, say the opposite of each other."""
    for keys in zip(values.layout.joints("dir_"), values.layout.joints("speed_"), strict=True):
        direction, speed = (values.one(key) for key in keys)
        if direction is not None and speed is not None and (wrong := direction * speed < 0).any():
            place = f"{counted} {values.lines[np.argmax(wrong)]}"
            yield f"{' and '.join(keys)} say the opposite of each other at {place}: one of the two has the wrong sign"


def format_poses(measurements: Measurements, joint_names: Sequence[str] | None = None, *, attained: bool = True) -> str:
    """CSV text that :func:`read_poses` reads back: every number in the fewest digits that give the same float.

    Bare SI columns, but for positions that need their unit to be believed; orientation as a quaternion with w >= 0. A
    joint's name stands for ``q_i`` where ``joint_names`` are given and none of them means something else in a pose
    file. Without ``attained`` the poses are planned, and no attained pose is among the columns.
    """
    return "".join(pose_pieces(measurements, joint_names, attained=attained))


def pose_pieces(
    measurements: Measurements, joint_names: Sequence[str] | None = None, *, attained: bool = True
) -> Iterator[str]:
    """The text of :func:`format_poses` in pieces of some thousand rows, so that no more of it is held at once."""
    for start in range(0, max(measurements.n, 1), _BLOCK):
        columns = _columns(measurements.subset(slice(start, start + _BLOCK)), joint_names, attained)
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        if start == 0:
            far = _too_far_for_bare_names(measurements)
            writer.writerow([f"{name}_m" if name in far else name for name, _ in columns])
        writer.writerows(zip(*(column for _, column in columns), strict=True))
        yield out.getvalue()


def _too_far_for_bare_names(measurements: Measurements) -> tuple[str, ...]:
    """Columns whose metres a reader would take for millimetres, did their names not say the unit."""
    positions = ((AXES, measurements.position), (COMMANDED_AXES, measurements.commanded_position))
    return tuple(
        name for keys, at in positions if at is not None and at.size and lengths_too_large(at) for name in keys
    )


def _columns(
    measurements: Measurements, joint_names: Sequence[str] | None, attained: bool
) -> list[tuple[str, Sequence[str]]]:
    columns: list[tuple[str, Sequence[str]]] = []
    numbered = [f"q{i + 1}" for i in range(_joint_count(measurements))]
    joints = list(joint_names) if joint_names and all(map(_is_free, joint_names)) else numbered
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
    # Text goes last: an id that begins with # would make a comment of its row.
    for name, texts in zip(TEXTS, (measurements.pose, measurements.cycle, measurements.target), strict=True):
        if texts is not None:
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


def _is_free(name: str) -> bool:
    """Whether a joint's name can head its column: it says nothing else there, and survives trimming."""
    taken = name in FIXED_KINDS or JOINT_COLUMN.fullmatch(name)
    return not taken and name == name.strip() and bool(name) and not name.startswith("#") and name.isprintable()
