"""Read poses from a CSV or Parquet file into SI arrays, and write poses as CSV."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import Note
from robacc.geometry import Array, quaternion_from_rotation
from robacc.io.column_table import open_table
from robacc.io.dialect import cell, from_spreadsheet
from robacc.io.table import Table
from robacc.measurements import Measurements
from robacc.poses.columns import (
    AXES,
    CIRCUMSTANCES,
    COMMANDED_AXES,
    COMMANDED_QUATERNION,
    FIXED_KINDS,
    QUATERNION,
    SIGMAS,
    TEXTS,
    TIME_KEYS,
)
from robacc.poses.kinds import KindTable
from robacc.poses.layout import Layout, Values, listing, read_layout
from robacc.poses.motion import check_visits, motion_of, read_times
from robacc.poses.reading import UNKNOWN_ROBOT, KnownPoses, KnownRobot, reading_of, table_options
from robacc.poses.reshaped_tables import reshaped, with_named_quaternion
from robacc.poses.row_checks import READ_BACK_TOLERANCE, check_rows, check_sizes, duplicate_rows, with_repetitions
from robacc.poses.units import check_units, conventions, lengths_too_large, rotations, with_units

# Write poses as CSV text in SI units, which :func:`robacc.poses.csv_file.read_poses` reads back.

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
        if start == 0:
            # Metres that would be read as millimetres have a unit in the name.
            positions = ((AXES, measurements.position), (COMMANDED_AXES, measurements.commanded_position))
            far = [
                name for names, p in positions if p is not None and p.size and lengths_too_large(p) for name in names
            ]
            yield ",".join(f"{name}_m" if name in far else name for name in columns) + "\n"
        yield "".join(f"{','.join(row)}\n" for row in zip(*columns.values(), strict=True))


def _columns(m: Measurements, attained: bool) -> dict[str, Iterable[str]]:
    of_joints = next((values for values in (m.q, m.direction, m.speed) if values is not None), np.empty((0, 0)))
    joints = [f"q{i + 1}" for i in range(len(of_joints))]
    rotation, cmd_rotation = (
        None if rotation is None else quaternion_from_rotation(rotation)
        for rotation in (m.rotation, m.commanded_rotation)
    )
    sets: tuple[tuple[Sequence[str], Array | None], ...] = (
        (joints, m.q),
        (AXES, m.position if attained else None),
        (QUATERNION, rotation if attained else None),
        (COMMANDED_AXES, m.commanded_position),
        (COMMANDED_QUATERNION, cmd_rotation),
        (SIGMAS, m.sigma_position),
        (("sigma_r",), m.sigma_rotation),
        *zip(((name,) for name in CIRCUMSTANCES), (m.time, m.temperature, m.payload), strict=True),
        ([f"dir_{name}" for name in joints], None if m.direction is None else m.direction.astype(np.int64)),
        ([f"speed_{name}" for name in joints], m.speed),
        ([f"read_{name}" for name in joints], m.read_back),
        (m.branch_names, m.branches),
    )
    numbers = {
        name: _texts(row)
        for names, values in sets
        if values is not None
        for name, row in zip(names, values.reshape(len(names), m.n), strict=True)
    }
    # Text goes last: an id that begins with # would make a comment of its row.
    texts = {name: column for name in TEXTS if (column := getattr(m, name)) is not None}
    return {**numbers, **{name: [cell(str(text)) for text in column.tolist()] for name, column in texts.items()}}


def _texts(numbers: NDArray[Any]) -> Iterable[str]:
    """Return the numbers in the fewest digits that give the same floats; those of a whole block in a fifth of the time.

    A file of few rows does without orjson, whose import takes longer.
    """
    if numbers.size < _BLOCK:
        return map(repr, numbers.tolist())
    import orjson

    texts = orjson.dumps(np.ascontiguousarray(numbers), option=orjson.OPT_SERIALIZE_NUMPY).decode()[1:-1].split(",")
    size = np.abs(numbers)
    # It writes others than Python does: without an exponent, or null.
    for i in np.flatnonzero(~((size == 0.0) | ((size >= 1e-4) & (size < 1e16)))).tolist():
        texts[i] = repr(numbers[i].item())
    return texts


def read_poses(
    path: str | os.PathLike[str],
    *,
    robot: KnownRobot = UNKNOWN_ROBOT,
    ordered: bool = False,
    ignore_limits: bool = False,
    units_check: bool = True,
    attained: bool = True,
    commands: bool = True,
    known_poses: KnownPoses | None = None,
) -> Measurements:
    """Return the validated poses of a CSV or Parquet file.

    Args:
        path: File to read; ``-`` is standard input. A :class:`~robacc.poses.reading.PoseFile` also states units,
            angles and columns that the file's names leave open.
        robot: Names, limits and targets that the columns are checked against.
        ordered: Rows are in the order measured, and the robot moved straight from each visit to the next: direction
            and speed are derived for the joints whose columns are missing. All rows of a visit have its motion. It is 0
            for the first visit, whose approach is unknown, and for a visit that repeats the joints of the one before.
        ignore_limits: A joint outside its limits is a warning, however far; by default it is an error where it is
            outside by more than 0.05 degree or 0.5 mm, and a warning below.
        units_check: Raise an error for bare columns whose values look like degrees or millimetres.
        attained: Whether the poses were measured; planned poses may lack x, y, z, which are then zero.
        commands: Whether joints or commanded poses are required; without, they come from another file.
        known_poses: Poses that another file gives to the rows; like those of the robot, they show units and the
            convention of angles that names leave open.

    Raises:
        InputError: Every problem of the file, with line and column.
    """
    reading = reading_of(path)
    with open_table(os.fspath(path), table_options(path)) as source:
        table: Table = source
        log, targets = table.log, robot.targets
        kinds = KindTable.of(table, reading) if attained else None
        if kinds is not None:
            table, attained = kinds, False
        elif reading.columns is None:
            table = reshaped(table, robot, attained, commands)
            # An arm of four joints may count them from 0.
            counts_joints = commands and len(robot.joint_names or ()) == len(QUATERNION)
            table.names = table.names if counts_joints else with_named_quaternion(table)
        layout = read_layout(table, robot, attained, reading, commands)
        values = _with_named_poses(_read_values(table, layout), targets)
        if len(targets) > 1 and "target" not in layout.columns and layout.has(layout.joints()):
            log.add(
                f"column target is missing: the robot file has {len(targets)} targets ({listing(targets)})",
                table.line,
                fix="add it with the measured target of each row",
            )
        check_sizes(values)
        wrong_joints: frozenset[str] = frozenset()
        if units_check:
            values = with_units(values, robot, known_poses)
            wrong_joints, _ = check_units(
                values.rows(np.flatnonzero(np.isfinite(values.numbers).all(axis=0))) if log.total else values,
                robot.limits,
            )
        check_rows(values, robot, wrong_joints, ignore_limits)
        check_visits(values, ordered)
        angles = conventions(values, reading, robot.pose_at, known_poses)
        log.raise_if_any()
        data = _measurements(values, ordered, angles)
        data = with_repetitions(data, log) if attained else data
        copies = None if kinds is not None else duplicate_rows(values)
        data = replace(data, copies=copies, source=table.file, sha256=table.sha256, warnings=log.warnings)
        return data if kinds is None else kinds.measured(data)


def _read_values(table: Table, layout: Layout) -> Values:
    """Return the values of the columns in use."""
    columns, log = layout.columns, table.log
    # The members of a set are adjacent.
    numeric = [*layout.joints(), *(key for key, kind in FIXED_KINDS.items() if kind != "text")]
    numeric += [key for prefix in ("dir_", "speed_", "read_") for key in layout.joints(prefix)]
    numeric += [f"branch_q{i + 1}" for i in range(len(layout.names.robot.branches))]
    keys = [key for key in numeric if key in columns]
    times = [key for key in TIME_KEYS if key in columns]
    texts = [*(key for key in TEXTS if key in columns), *times]
    table.times = frozenset(columns[key].index for key in times)
    body = table.body([columns[key].index for key in keys], [columns[key].index for key in texts])
    numbers = body.numbers
    for row, key in zip(numbers, keys, strict=True):
        if columns[key].divisor != 1.0:
            row /= columns[key].divisor
    by_key = {
        key: np.array([from_spreadsheet(text) for text in column]) if "'" in column.astype("U1") else column
        for key, column in zip(texts, body.texts, strict=True)
    }
    if times:
        stamps = {columns[key]: by_key.pop(key) for key in times}
        numbers = np.vstack([numbers, read_times(stamps, body.lines, log)])
        keys.append("time_s")
    row_index = {key: i for i, key in enumerate(keys)}
    return Values(layout, numbers, row_index, by_key, body.lines, log, table.line, tuple(log.gaps))


def _with_named_poses(values: Values, target_names: Sequence[str]) -> Values:
    """Return the values with a column Target as names of the poses, where each row of an export has another name."""
    column, names = values.layout.columns.get("target"), values.texts.get("target")
    if column is None or names is None or column.name == "target" or "pose" in values.texts:
        return values
    different = set(names.tolist())
    if len(different) < max(names.size, 2) or different & set(target_names):
        return values
    text = f"{column.name} is used as the names of the poses, because it differs in every row"
    values.log.warn(Note(text), of_file=True)
    texts = {"pose" if key == "target" else key: text for key, text in values.texts.items()}
    return values._replace(texts=texts)


def _measurements(values: Values, ordered: bool, angles: Mapping[str, str]) -> Measurements:
    layout, log, n = values.layout, values.log, values.lines.size
    position, q, read_back = map(values.column_set, (AXES, layout.joints(), layout.joints("read_")))
    direction, speed = motion_of(values, ordered)
    largest = 0.0 if read_back is None or q is None else float(np.max(np.abs(read_back - q), initial=0.0))
    if largest > READ_BACK_TOLERANCE:
        # They are those of an arm that moved.
        text = f"the attained joints are up to {largest:.3g} (rad or m) off the commanded joints, so they are not used"
        log.warn(text, of_file=True)
        read_back = None
    columns = {branch: values.column(f"branch_q{i + 1}") for i, branch in enumerate(layout.names.robot.branches)}
    if lacking := [branch for branch, column in columns.items() if column is None and branch.loads_joints]:
        names = listing([branch.name for branch in lacking])
        where = "the robot file's positions" if any(branch.position for branch in lacking) else "zero"
        has, counts, fix = ("has", "counts", f"add the column {names}")
        if len(lacking) > 1:
            has, counts, fix = ("have", "count", "add a column for each")
        text = f"{names} outside the chain {has} no column and {counts} as fixed at {where}"
        log.warn(f"{text}; if the arm moved them, {fix}", of_file=True)
    branches = [np.full(n, branch.position) if column is None else column for branch, column in columns.items()]
    texts: dict[str, Any] = {key: values.texts.get(key) for key in TEXTS}
    return Measurements(
        position=np.zeros((3, n)) if position is None else position,  # planned poses have none
        rotation=rotations(values, layout.orientation(), angles.get("", "")),
        q=q,
        commanded_position=values.column_set(COMMANDED_AXES),
        commanded_rotation=rotations(values, layout.orientation("cmd_"), angles.get("cmd_", "")),
        sigma_position=values.column_set(SIGMAS),
        sigma_rotation=values.column("sigma_r"),
        **texts,
        time=values.column("time_s"),
        temperature=values.column("temperature_c"),
        payload=values.column("payload_kg"),
        direction=direction,
        speed=speed,
        read_back=read_back,
        branches=np.array(branches) if branches else None,
        branch_names=tuple(branch.name for branch in columns),
        rows=values.lines,
        gaps=values.gaps,
        counted=log.counted,
        ordered=ordered,
    )
