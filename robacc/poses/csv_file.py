"""Pose files: read into SI arrays, of every kind of measurement, written as CSV, and a column map for an export."""

import datetime as dt
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from robacc.errors import Note, listing
from robacc.geometry import Array, NDArray, quaternion_from_rotation, vector_lengths
from robacc.io.column_table import open_table
from robacc.io.dialect import NUMBER, cell, from_spreadsheet, number_of
from robacc.io.files import ProblemLog, clip
from robacc.io.table import Table, TableBody
from robacc.measurements import Measurements
from robacc.plug_ins import plug_in
from robacc.poses.cameras import BOARDS
from robacc.poses.checks import (
    BLOCK,
    READ_BACK_TOLERANCE,
    SMALLEST_SIGMA,
    check_rows,
    check_sizes,
    check_units,
    check_visits,
    conventions,
    duplicate_rows,
    lengths_too_large,
    motion_of,
    rotations,
    with_repetitions,
    with_units,
)
from robacc.poses.layout import Layout, Names, Values, documented_columns, find_columns, read_layout
from robacc.poses.reading import (
    AS_NAMED,
    AXES,
    BY_SIGHT,
    CIRCUMSTANCES,
    COMMANDED_AXES,
    COMMANDED_QUATERNION,
    CORRELATIONS,
    FIXED_KINDS,
    INSTRUMENT,
    JOINT_COLUMN,
    OPEN,
    QUATERNION,
    ROTATION_VECTOR,
    RPY,
    SIGMAS,
    TEXTS,
    TIME_KEYS,
    UNITS,
    UNKNOWN_ROBOT,
    Column,
    Heading,
    KnownPoses,
    KnownRobot,
    Reading,
    heading_of,
    is_documented,
    labelled,
    reading_of,
    source_of,
)
from robacc.poses.reshaped_tables import (
    ReshapedTable,
    Rows,
    reshaped,
    with_known_names,
    with_named_quaternion,
    with_poses_of_matrices,
)

# Write poses as CSV text in SI units, which :func:`robacc.poses.csv_file.read_poses` reads back.


def format_poses(measurements: Measurements, *, attained: bool = True) -> str:
    """Return the poses as CSV text, each number in the fewest digits that give the same float.

    Columns are SI without a unit in their names, except for positions that would look like mm; orientation is a
    quaternion with w >= 0. Without ``attained`` the poses are planned and have no attained columns.
    """
    return "".join(pose_pieces(measurements, attained=attained))


def pose_pieces(measurements: Measurements, *, attained: bool = True) -> Iterator[str]:
    """Yield the text of :func:`format_poses` in pieces of some thousand rows, to limit the memory used."""
    for start in range(0, max(measurements.n, 1), BLOCK):
        columns = _columns(measurements.subset(slice(start, start + BLOCK)), attained)
        if start == 0:
            # Metres that would be read as millimetres have a unit in the name.
            positions = ((AXES, measurements.position), (COMMANDED_AXES, measurements.commanded_position))
            far = [
                name for names, p in positions if p is not None and p.size and lengths_too_large(p) for name in names
            ]
            yield ",".join(f"{name}_m" if name in far else name for names in columns for name in names) + "\n"
        yield "".join(f"{','.join(row)}\n" for row in zip(*columns.values(), strict=True))


def _columns(m: Measurements, attained: bool) -> dict[tuple[str, ...], list[str]]:
    """Return the fields of each row, joined, by the names of the columns that they are of."""
    of_joints = next((values for values in (m.q, m.direction, m.speed) if values is not None), np.empty((0, 0)))
    joints = [f"q{i + 1}" for i in range(len(of_joints))]
    rotation, cmd_rotation = (
        None if rotation is None else quaternion_from_rotation(rotation)
        for rotation in (m.rotation, m.commanded_rotation)
    )
    sigma, noise = m.sigma_position, m.noise_covariance
    correlation = None if sigma is None or noise is None else noise / (sigma[:, None] * sigma)
    sets: tuple[tuple[Sequence[str], Array | None], ...] = (
        (joints, m.q),
        (AXES, m.position if attained else None),
        (QUATERNION, rotation if attained else None),
        (COMMANDED_AXES, m.commanded_position),
        (COMMANDED_QUATERNION, cmd_rotation),
        (SIGMAS, m.sigma_position),
        (CORRELATIONS, None if correlation is None else correlation[np.triu_indices(3, 1)]),
        (("sigma_r",), m.sigma_rotation),
        *zip(((name,) for name in CIRCUMSTANCES), (m.time, m.temperature, m.payload), strict=True),
        ([f"dir_{name}" for name in joints], None if m.direction is None else m.direction.astype(np.int64)),
        ([f"speed_{name}" for name in joints], m.speed),
        ([f"read_{name}" for name in joints], m.read_back),
        (m.branch_names, m.branches),
    )
    numbers = {
        tuple(names): _joined(values.reshape(len(names), m.n).T)
        for names, values in sets
        if names and values is not None
    }
    # Text goes last: an id that begins with # would make a comment of its row.
    texts = {name: column for name in TEXTS if (column := getattr(m, name)) is not None}
    if m.kind is not None and m.fixture is not None and np.isin(m.kind, ("position", "point")).all():
        texts |= {"kind": m.kind, "socket": m.fixture}
    return {**numbers, **{(name,): [cell(str(text)) for text in column.tolist()] for name, column in texts.items()}}


def _joined(numbers: NDArray[Any]) -> list[str]:
    """Return each row of ``(N, K)`` with its numbers in the fewest digits that give the same floats.

    A file of few rows does without orjson, whose import takes longer.
    """
    if len(numbers) < BLOCK:
        return [",".join(map(repr, row)) for row in numbers.tolist()]
    import orjson

    rows = orjson.dumps(np.ascontiguousarray(numbers), option=orjson.OPT_SERIALIZE_NUMPY).decode()[2:-2].split("],[")
    size = np.abs(numbers)
    # It writes others than Python does: without an exponent, or null.
    is_alike = (size == 0.0) | ((size >= 1e-4) & (size < 1e16))
    for i in np.flatnonzero(~is_alike.all(axis=1)).tolist():
        rows[i] = ",".join(map(repr, numbers[i].tolist()))
    return rows


def read_poses(
    path: str | os.PathLike[str],
    *,
    robot: KnownRobot = UNKNOWN_ROBOT,
    ordered: bool = False,
    ignore_limits: bool = False,
    units_check: bool = True,
    attained: bool = True,
    commands: bool = True,
    planned_kinds: bool = False,
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
        planned_kinds: Other kinds of measurement count in planned poses, too.
        known_poses: Poses that another file gives to the rows; like those of the robot, they show units and the
            convention of angles that names leave open.

    Raises:
        InputError: Every problem of the file, with line and column.
    """
    reading = reading_of(path)
    with open_table(os.fspath(path), reading) as source:
        table: Table = source
        log, targets = table.log, robot.targets
        of_kinds = KindTable.of(table, reading) if attained or planned_kinds else None
        if of_kinds is not None:
            table, attained = of_kinds, False
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
            values = with_units(values, robot, known_poses, is_touched=of_kinds is not None)
            wrong_joints, _ = check_units(
                values.rows(np.flatnonzero(np.isfinite(values.numbers).all(axis=0))) if log.total else values,
                robot.limits,
            )
        check_rows(values, robot, wrong_joints, ignore_limits)
        check_visits(values, ordered)
        angles = conventions(values, reading, robot, known_poses)
        log.raise_if_any()
        data = _measurements(values, ordered, angles)
        data = with_repetitions(data, log) if attained else data
        copies = None if of_kinds is not None else duplicate_rows(values)
        data = replace(data, copies=copies, source=table.file, sha256=table.sha256, warnings=log.warnings)
        return data if of_kinds is None else of_kinds.measured(data)


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
        if key in SIGMAS and not is_documented(columns[key].name) and 0 < (above := row > 0.0).sum() < row.size:
            # An instrument rounds: 0.000 mm.
            row[row == 0.0] = row[above].min()
            log.warn(Note(f"{columns[key].name} counts as its smallest value above 0 where it is 0"), of_file=True)
    by_key = {
        key: np.array([from_spreadsheet(text) for text in column]) if "'" in column.astype("U1") else column
        for key, column in zip(texts, body.texts, strict=True)
    }
    if times:
        stamps = {columns[key]: np.char.lstrip(by_key.pop(key), "'") for key in times}  # as Excel marks a text
        numbers = np.vstack([numbers, read_times(stamps, body.lines, log)])
        keys.append("time_s")
    row_index = {key: i for i, key in enumerate(keys)}
    return Values(layout, numbers, row_index, by_key, body.lines, log, table.line)


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
    return values._replace(texts={"pose" if key == "target" else key: column for key, column in values.texts.items()})


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
        one, many = ("has", "counts", f"add the column {names}"), ("have", "count", "add a column for each")
        has, counts, fix = many if len(lacking) > 1 else one
        text = f"{names} outside the chain {has} no column and {counts} as fixed at {where}"
        log.warn(f"{text}; if the arm moved them, {fix}", of_file=True)
    branches = [np.full(n, branch.position) if column is None else column for branch, column in columns.items()]
    texts: dict[str, Any] = {key: values.texts.get(key) for key in TEXTS}
    sigma, covariance = _noise(values, position)
    return Measurements(
        position=np.zeros((3, n)) if position is None else position,  # planned poses have none
        rotation=rotations(values, layout.orientation(), angles.get("", "")),
        q=q,
        commanded_position=values.column_set(COMMANDED_AXES),
        commanded_rotation=rotations(values, layout.orientation("cmd_"), angles.get("cmd_", "")),
        sigma_position=sigma,
        noise_covariance=covariance,
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
        gaps=tuple(log.gaps),
        counted=log.counted,
        ordered=ordered,
    )


def _noise(values: Values, position: Array | None) -> tuple[Array | None, Array | None]:
    """Return standard deviations ``(3, N)`` and covariance ``(3, 3, N)`` of the noise of positions, None if unknown."""
    sigma, correlations, by_sight = map(values.column_set, (SIGMAS, CORRELATIONS, BY_SIGHT))
    if by_sight is not None and position is not None:
        instrument = values.column_set(INSTRUMENT)
        sight = position - (np.zeros((3, 1)) if instrument is None else instrument)
        sight /= np.maximum(vector_lengths(sight), 1e-9)
        in_range, across = np.square(by_sight)
        covariance = across * np.eye(3)[..., None] + (in_range - across) * sight[:, None] * sight
        return np.sqrt(np.einsum("iin->in", covariance)), covariance
    if sigma is None or correlations is None:
        return sigma, None
    matrix = np.vstack((correlations, np.ones(values.lines.size)))[np.array([[3, 0, 1], [0, 3, 2], [1, 2, 3]])]
    return sigma, matrix * sigma[:, None] * sigma


# Dates and times of day as seconds.

_DAY = 86400.0
_STAMP = (
    r"\s*(?:(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})|(\d{1,2})[-/.](\d{1,2})[-/.](\d{4}|\d{2})|)[T ,;]*"
    r"(?:(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,:_](\d{1,9}))?)?(?:\s*([AaPp])\.?[Mm]\.?)?"
    r"\s*(?:Z|UTC|GMT|([+-]\d{2}):?(\d{2}))?)?\s*"
)
"""Date with the year first or last, and time of day with its zone."""
_COMPACT = r"^((?:19|20)\d\d)(\d\d)(\d\d)[_T -]?(\d\d)(\d\d)(\d\d)(?!\d)"
"""Date and time without signs between their numbers, as programs name files: ``20261122_100005``."""


def read_times(stamps: Mapping[Column, NDArray[np.str_]], lines: NDArray[np.int64], log: ProblemLog) -> Array:
    """Return the time ``(N,)`` of each row in s, NaN where a problem was logged; a note says where it begins.

    Times count from the midnight before the first row where the file has dates or clocks; numbers that count by
    themselves have no beginning.

    Args:
        stamps: Texts ``(N,)`` of the columns with the keys ``time``, ``date``, ``seconds``, ``nanoseconds``.
        lines: ``(N,)`` lines of the rows.
        log: Takes entries that are no times.
    """
    columns = {column.key: column for column in stamps}
    texts = {column.key: text for column, text in stamps.items()}

    def each(key: str, column: NDArray[np.str_], value_of: Callable[[str], float | None], expected: str) -> Array:
        found = [value_of(text) if text else math.nan for text in column.tolist()]
        # Nanoseconds since 1970 are some 2e18.
        for i in [i for i, value in enumerate(found) if value is None or abs(value) > 1e20]:
            log.add(f"found {clip(str(column[i]))}, expected {expected}", int(lines[i]), columns[key].name)
        return np.array([math.nan if value is None else value for value in found])

    of_numbers = "a time in numbers as in the first rows"
    if "seconds" in texts:
        seconds = each("seconds", texts["seconds"], _number, of_numbers)
        if "nanoseconds" in texts:
            seconds += each("nanoseconds", texts["nanoseconds"], _number, of_numbers) / 1e9
        return _since_midnight(seconds, log)
    key = next((key for key in ("time", "date") if key in texts), None)
    if key is None:
        log.add(
            "nanoseconds without a column of seconds", None, columns["nanoseconds"].name, "leave it out with `columns`"
        )
        return np.full(lines.size, np.nan)
    column = np.array([re.sub(_COMPACT, r"\1-\2-\3 \4:\5:\6", text) for text in texts[key].tolist()], dtype=str)
    if "date" not in texts and all(_number(text) is not None for text in column[:20]):
        values = each(key, column, _number, of_numbers)
        typical = float(np.nanmedian(np.abs(values))) if np.isfinite(values).any() else 0.0
        scale = (
            # Numbers above the first are times since 1970 in the unit of which the second make a second.
            next(
                (scale for limit, scale in ((1e17, 1e9), (1e14, 1e6), (1e11, 1e3), (1e8, 1.0)) if typical > limit), None
            )
            if columns[key].divisor == 1.0
            else None
        )
        return _since_midnight(values / scale, log) if scale else values / columns[key].divisor
    if key == "time" and "date" in texts:
        column = np.array([f"{date} {clock}" for date, clock in zip(texts["date"], texts["time"], strict=True)])
    year_last = r"(\d{1,2})([-/.])(\d{1,2})[-/.](\d{4}|\d{2})"
    dates = [match for text in column.tolist() if (match := re.match(year_last, text))]
    day_first = not dates or any(match[2] == "." or int(match[1]) > 12 for match in dates)
    if not day_first and all(int(match[3]) <= 12 for match in dates):
        log.add(
            f"found {clip(str(column[0]))}, in which either number may be the day",
            int(lines[0]),
            columns[key].name,
            "write dates as 2026-11-22, or leave the column out with `columns`",
        )
        return np.full(lines.size, np.nan)
    values = each(key, column, partial(_seconds, day_first=day_first), "a date and time, or a time of day")
    if any(re.match(r"\s*\d+[-/.]\d+[-/.]\d", text) for text in column.tolist()):
        return _since_midnight(values, log, zone="")
    log.warn(Note("time_s counts from midnight"), of_file=True)
    # A clock that falls by more than half a day has passed midnight.
    with np.errstate(invalid="ignore"):
        midnights = np.concatenate([[0], np.cumsum(np.diff(values) < -_DAY / 2)])
    return values + _DAY * midnights[: values.size]


def _since_midnight(seconds: Array, log: ProblemLog, zone: str = " UTC") -> Array:
    start = np.floor(seconds[0] / _DAY) * _DAY if seconds.size and np.isfinite(seconds[0]) else 0.0
    if start == 0.0 and zone:
        return seconds
    day = dt.date(1970, 1, 1) + dt.timedelta(days=start / _DAY) if not zone or start < 4e9 else None
    log.warn(Note(f"time_s counts from 00:00{zone} of {day}" if day else "time_s counts from a midnight"), of_file=True)
    return seconds - start


def _number(text: str) -> float | None:
    return float(text) if NUMBER.fullmatch(text := text.replace(",", ".")) else None


def _seconds(text: str, day_first: bool) -> float | None:
    """Return seconds since 1970, or since midnight where the text has no date; None for another text."""
    if (match := re.fullmatch(_STAMP, text)) is None:
        return None
    year, month, day, first, second, last, *clock, fraction, half, zone_h, zone_min = match.groups()
    hour, minute, second_ = (int(part or 0) for part in clock)
    if not (year or last or clock[0]) or hour > 24 or minute > 59 or second_ > 60:
        return None
    days = 0
    if year or last:
        numbers = (year, month, day) if year else (last, *((second, first) if day_first else (first, second)))
        y, m, d = map(int, numbers)
        try:
            days = (dt.date(y + 2000 if y < 100 else y, m, d) - dt.date(1970, 1, 1)).days
        except ValueError:
            return None
    if half:
        hour = hour % 12 + (12 if half in "pP" else 0)
    offset = (int(zone_h) * 60 + int(zone_h[0] + zone_min)) * 60.0 if zone_h else 0.0
    return days * _DAY + hour * 3600 + minute * 60 + second_ + float(f"0.{fraction or 0}") - offset


# Other kinds of measurement in a pose file: the target in a socket, on a plane, a line or a sphere, at a distance, and
# points in photos.
#
# A row has the joints of its pose, a column ``kind`` where the file has several kinds, and the columns of its kind:
#
# - ``point``: ``socket``, the name of a socket in which the target rests at the same unknown point;
# - ``plane``: ``plane``, the name of an unknown plane, and ``reading``, the height of the target above it (default 0);
# - ``line``: ``line``, the name of an unknown straight line that the target is on;
# - ``sphere``: ``sphere``, the name of a sphere around an unknown centre, ``reading``, the height of the target above
#   it (default 0), and ``radius`` where it is known: such a sphere is an anchor at that distance;
# - ``distance``: ``distance``, and either ``anchor``, the name of an unknown fixed point, or ``from``, the pose of an
#   earlier row (one without any of the three is such a pose alone);
# - ``image``: ``u_px`` and ``v_px``, the pixel at which a ``camera`` shows the point ``board_x``, ``board_y``,
#   ``board_z`` (default 0) of a board: one row for each point of a photo;
# - ``position``: ``x``, ``y``, ``z``.
#
# ``sigma`` is the standard deviation of the measured number. Lengths have a unit in the name, or are in m.

_NAMES = ("socket", "plane", "line", "sphere")
_NAMED_BY = {"point": _NAMES[:1], **{kind: (kind,) for kind in _NAMES[1:]}, "distance": ("anchor", "from")}
"""Columns that name what a row of each kind is measured from."""
_SOCKETS = frozenset({"hole", "hole_id", "cone", "nest", "socket_id", "socket_name"})
"""Other names of the column socket."""
_PIXELS = ("u_px", "v_px")
_BOARD = ("board_x", "board_y", "board_z")
_LENGTHS = ("distance", "reading", "radius", "sigma", *AXES, *_BOARD)


def _key(heading: Heading) -> str:
    """Return the key of a column: its name without capitals, and without the unit of a length."""
    text, name = heading.text.replace(" ", "_"), heading.name.lower()
    return text if text in _LENGTHS else "socket" if name.replace(" ", "_") in _SOCKETS else name


class KindTable(ReshapedTable):
    """Table without the columns of other kinds of measurement, whose cells it keeps."""

    def __init__(self, table: Table, apart: Mapping[str, int], unit: str, cameras: str | None) -> None:
        """Take the columns ``apart``, by their keys, out of a table; lengths without a unit are in ``unit``."""
        super().__init__(table, apart.values(), {}, ([], [*apart.values()]), self._keep, "")
        table.sparse = apart.values()
        self._units = dict.fromkeys(_LENGTHS, unit)
        for index, heading in enumerate(map(heading_of, table.names)):
            if (key := _key(heading)) in apart and apart[key] != index:
                self.log.add("the column is a duplicate", self.line, heading.name, "keep one of them")
            elif key in apart and heading.unit is not None and key in _LENGTHS:
                self._units[key] = heading.unit
                if UNITS[heading.unit][0] != "length":
                    self.log.add("expected a unit of length (m, mm, um)", self.line, heading.name)
        self.cameras, self.image_sizes = cameras, table.image_sizes
        self.headings = {key: table.names[index] for key, index in apart.items()}
        self.cells: dict[str, list[str]] = {}

    @classmethod
    def of(cls, table: Table, reading: Reading) -> "KindTable | None":
        """Return the table without its columns of other kinds of measurement; None if it has none."""
        headings = [*map(heading_of, table.names)]
        keys = {_key(heading): i for i, heading in enumerate(headings)}
        apart = {
            key: keys[key] for key in ("kind", "camera", *_NAMES, "anchor", "from", *_PIXELS, *_LENGTHS) if key in keys
        }
        is_other = not {"distance", *_NAMES, *_PIXELS}.isdisjoint(apart)
        others = [each for each in headings if _key(each) not in (*_BOARD, *_PIXELS)]
        parts = [part for each in others if (part := labelled(each)) and source_of(each.words) >= 0]
        if not is_other or (any(axis != "turn" for _, axis in parts) and "kind" not in apart):
            return None
        return cls(table, apart, reading.unit_of.get("length", "m"), reading.camera)

    def _keep(self, old: TableBody) -> Rows:
        self.cells = {key: column.tolist() for key, column in zip(self.headings, old.texts, strict=True)}
        return np.arange(old.lines.size)[None], []

    def measured(self, data: Measurements) -> Measurements:
        """Return the commanded poses with what was measured at them.

        Raises:
            InputError: A row lacks what its kind needs; with every problem.
        """
        n, cells = data.n, self.cells
        kinds = self._kinds(data)
        position, fixture, earlier = np.zeros((3, n)), [""] * n, list(range(n))
        of_distance = [self.column_of(key) for key in ("distance", "anchor", "from")]
        is_start = np.array([not any(row) for row in zip(*of_distance, strict=True)], dtype=bool) & (
            kinds == "distance"
        )
        owners: dict[str, str] = {}
        poses = np.full(n, "") if data.pose is None else data.pose
        for row in np.flatnonzero(np.isin(kinds, [*_NAMED_BY]) & ~is_start).tolist():
            names = _NAMED_BY[str(kinds[row])]
            given = [key for key in names if key in cells and cells[key][row]]
            if len(given) != 1:
                found = "both" if given else "none"
                self.report(data, f"a row of kind {kinds[row]} needs {' or '.join(names)}, found {found}", row)
            elif given == ["from"]:
                before = np.flatnonzero(poses[:row] == cells["from"][row])
                earlier[row] = int(before[-1]) if before.size else row
                if not before.size:
                    fix = "name the rows in a column pose" if data.pose is None else None
                    self.report(data, f"no earlier row is of the pose {clip(cells['from'][row])}", row, "from", fix)
            elif owners.setdefault(cells[given[0]][row], given[0]) != given[0]:
                name, fix = cells[given[0]][row], "give everything that is measured from its own name"
                self.report(data, f"{name} is also the name of a {owners[name]}", row, given[0], fix)
            else:
                fixture[row] = cells[given[0]][row]
        for axis, key in enumerate(AXES):
            position[axis] = self.numbers(key, kinds == "position", data)
        position[2] += self.numbers("distance", (kinds == "distance") & ~is_start, data, least=0.0)
        position[2] += self.numbers("reading", np.isin(kinds, ("plane", "sphere")), data, 0.0)
        has_radius = (kinds == "sphere") & np.array([cell != "" for cell in self.column_of("radius")], dtype=bool)
        position[2] += self.numbers("radius", has_radius, data, least=0.0)
        kinds = np.where(has_radius, "distance", kinds)
        for row in np.flatnonzero((kinds == "sphere") & np.isin(fixture, np.array(fixture)[has_radius])).tolist():
            self.report(data, f"other rows of sphere {fixture[row]} have a radius", row, "radius", "give all or none")
        sigma = (
            self.numbers("sigma", ~is_start & (kinds != "image"), data, least=SMALLEST_SIGMA)
            if "sigma" in cells
            else None
        )
        if data.sigma_position is not None:
            self.log.add("sigma_x, sigma_y and sigma_z are of positions", self.line, fix="give one column sigma")
        if data.rotation is not None:
            self.log.warn("orientation is not used beside other kinds of measurement", of_file=True)
        self.log.raise_if_any()
        data = replace(
            data,
            rotation=None,
            sigma_rotation=None,
            position=position,
            sigma_position=None if sigma is None else np.tile(sigma, (3, 1)),
            kind=kinds,
            fixture=np.array(fixture),
            reference=None if earlier == list(range(n)) else data.subset(np.array(earlier)),
            copies=None,
        )
        data = self._with_images(data.subset(~is_start))
        self.log.raise_if_any()
        return replace(data, warnings=self.log.warnings)

    def _kinds(self, data: Measurements) -> NDArray[np.str_]:
        """Return the kind of each row."""
        named = {**_NAMED_BY, "image": _PIXELS}
        found = [kind for kind, names in named.items() if not self.cells.keys().isdisjoint((kind, *names))]
        if "kind" not in self.cells and len(found) > 1:
            self.log.add(f"the file has columns of the kinds {' and '.join(found)}", self.line, fix="add a column kind")
            self.log.raise_if_any()
        known = ("position", *named)
        kinds = [kind.lower() for kind in self.cells.get("kind", [found[0]] * data.n)]
        for row, kind in enumerate(kinds):
            if kind not in known:
                fix = (
                    "beside other kinds, name the row position: its orientation is not used" if kind == "pose" else None
                )
                self.report(data, f"found {kind!r}, expected one of {', '.join(known)}", row, "kind", fix)
        return np.array(kinds, dtype=str)

    def _with_images(self, data: Measurements) -> Measurements:
        """Return the data with what rows of kind image show, and with the photos they are from as visits."""
        if data.counted == "row" and data.pose is not None:  # Of photos themselves, nobody sees a table.
            data = replace(data, counted="photo")
        assert data.kind is not None
        assert data.fixture is not None
        rows = data.kind == "image"
        if not rows.any():
            return data
        of_poses: Measurements = plug_in(BOARDS, "images")(data, self)
        return of_poses

    def column_of(self, key: str) -> list[str]:
        """Return the cells of a column, empty ones where the file has none."""
        return self.cells.get(key) or [""] * len(next(iter(self.cells.values())))

    def numbers(
        self,
        key: str,
        rows: NDArray[np.bool_],
        data: Measurements,
        default: float | None = None,
        least: float = -np.inf,
        unit: str = "m",
    ) -> Array:
        """Return the numbers ``(N,)`` of a column in m or px, 0 outside the ``rows``; ``default`` is of empty cells."""
        values, cells = np.zeros(data.n), self.column_of(key)
        unit = "px" if key in _PIXELS else unit
        # px; no sensor is wider. m; a larger length is in another unit.
        divisor, most = (1.0, 1e5) if unit == "px" else (UNITS[self._units[key]][1], 100.0)
        for row in np.flatnonzero(rows).tolist():
            value = number_of(cells[row], self.dialect.decimal_comma) if cells[row] else default
            if value is None or not np.isfinite(value):
                found = f"found {clip(cells[row])}" if cells[row] else "the value is missing"
                self.report(data, f"{found}, expected a number", row, key)
            elif not max(least, -most) <= value / divisor <= most:
                is_bare = unit == "m" and divisor == 1.0 and value > 0.0
                fix = f"name the column {key}_mm if it is in mm" if is_bare else None
                found = f"found {value / divisor:.4g} {unit}, expected {max(least, -most):g} to {most:g} {unit}"
                self.report(data, found, row, key, fix)
            else:
                values[row] = value / divisor
        return values

    def report(
        self, data: Measurements, message: str, row: int, key: str | None = None, fix: str | None = None
    ) -> None:
        """Add a problem of a row to the log."""
        self.log.add(message, data.line(row), None if key is None else self.headings.get(key, key), fix)


# Proposal of a column map: what the reader takes each column of an export for, as a file to correct.

_CERTAIN = ("fixed-xyz",)
"""Conventions of angles whose names leave no other."""


def propose_columns(path: str | os.PathLike[str], map_path: str) -> tuple[str, list[str]]:
    """Return a column map for an export, to be written to ``map_path``, and lines that say what it has and leaves open.

    Statements that the names of the columns leave open stand as ``unknown``.

    Raises:
        InputError: The file cannot be read as a table.
    """
    name = os.fspath(path)
    with open_table(name, AS_NAMED) as plain:
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
        f"#   --columns {os.path.basename(map_path)}",
        "",
        "robacc_columns: 1",
        *(f"{key}: {value:<22} # {comment}" for key, (value, comment) in stated.items()),
        *(f"# open: {question}" for question in questions),
        *(["columns:", *entries] if table is plain else [f"# {table.log.remark}"]),
    ]
    unanswered = [key for key, (value, _) in stated.items() if value == OPEN]
    commands = "" if has_commands else " --commanded PROGRAM_OR_TABLE"
    return "\n".join(lines) + "\n", [
        f"wrote {map_path} (reads {len(columns)} of {sum(map(bool, table.names))} columns of {name})",
        "next:",
        *([f"  fill in {' and '.join(unanswered)} in {map_path}"] if unanswered else []),
        *(f"  decide in {map_path}: {question}" for question in questions),
        f"  robacc estimate {name} --columns {map_path} --robot robot.yaml{commands}",
    ]


def _meaning(column: Column, found: Layout) -> str:
    """Return the documented name with its unit; angles that are certainly about fixed axes are roll, pitch, yaw."""
    prefix = "cmd_" if column.key.startswith("cmd_") else ""
    stem = column.key.removeprefix(prefix)
    named = dict(zip(ROTATION_VECTOR, RPY, strict=True)) if found.angles.get(prefix) == _CERTAIN else {}
    return replace(column, key=prefix + named.get(stem, stem)).label
