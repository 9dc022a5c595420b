"""Checks of the values of a pose file row by row, of repeated rows, and of poses close together."""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.io.files import ProblemLog, clip
from robacc.measurements import Measurements
from robacc.poses.columns import AXES, COMMANDED_QUATERNION, QUATERNION, ROTATION_VECTOR, RPY, Column
from robacc.poses.layout import Values, listing
from robacc.poses.reading import KnownRobot
from robacc.poses.units import EXCESS_TOLERANCE, degrees_likely, excess_beyond_limits

# Poses that lie close together; repetitions of one commanded pose whose joints were logged as read.

MOST_POSES = 5000
"""Largest number of poses that are compared; more are close to others in any case."""
_NEAR = 5e-4
"""rad or m; distance of two readings of a joint at one commanded pose at most. Servo errors are smaller, and the error
of an arm hardly changes over it."""
_EVIDENT = 0.25
"""Share of the rows that repeat a pose from which a file has repetitions."""


def with_repetitions(data: Measurements, log: ProblemLog) -> Measurements:
    """Return data without ids of poses with ids of those that were repeated, and log a remark.

    Joints that were logged as read differ a little from visit to visit of one commanded pose.
    """
    if data.pose is not None or data.q is None or not 2 <= data.n <= MOST_POSES:
        return data
    if np.unique(data.groups()).size < data.n:
        return data
    place = close_groups(data.q, _NEAR, 2.0 * _NEAR)
    count = np.bincount(place)
    if np.mean(count[place] > 1) < _EVIDENT:
        return data
    names, number = np.unique(place, return_inverse=True)
    ids = np.array([f"P{k + 1}" for k in range(names.size)])[number]
    log.warn(
        f"{data.n} rows are read as {names.size} commanded poses and their repetitions, because joints differ "
        f"by less than {1e3 * _NEAR:g} mrad (mm); a pose column states repetitions",
        of_file=True,
    )
    return dataclasses.replace(data, pose=ids)


def close_groups(values: Array, near: float, widest: float) -> NDArray[np.int64]:
    """Return ``(P,)`` a number that columns of ``(K, P)`` share if they are linked by steps of at most ``near``.

    A group that extends over more than ``widest`` in a row of ``values``, such as a sweep of a joint, is none.
    """
    order = np.argsort(values[0], kind="stable")
    ends = np.searchsorted(values[0, order], values[0, order] + near, side="right")
    place = np.arange(values.shape[1])
    pairs = []
    for i, end in enumerate(ends):
        others = order[i + 1 : end]
        close = others[np.abs(values[:, others] - values[:, order[i], None]).max(axis=0, initial=0.0) <= near]
        pairs.append(np.stack([np.full(close.size, order[i]), close]))
    first, second = np.concatenate(pairs, axis=1)
    before = None
    while before is None or not np.array_equal(place, before):
        # The lowest number spreads along the pairs.
        before, lowest = place.copy(), np.minimum(place[first], place[second])
        np.minimum.at(place, first, lowest)
        np.minimum.at(place, second, lowest)
    low, high = (np.full(values.shape, start) for start in (np.inf, -np.inf))
    for row, lower, upper in zip(values, low, high, strict=True):
        np.minimum.at(lower, place, row)
        np.maximum.at(upper, place, row)
    wide = (high - low).max(axis=0) > widest
    return np.where(wide[place], np.arange(place.size), place)


# Rows of a pose file that repeat an earlier row to the last digit.

_OF_VISIT = frozenset(("pose", "cycle", "visit"))
"""Columns that number the visits; a measurement is a copy whatever its visit is called."""
_FEW = 0.1
"""Largest share of rows that repeat the measurement of another visit for these to be called copies."""


_MEASURED = (*AXES, *QUATERNION, *ROTATION_VECTOR, *RPY)
_COARSE = 1e-5
"""m; positions rounded to this repeat by chance, since arms repeat within it."""
_CELL = 5e-6
"""m; size of the cells in which positions that nearly agree are counted."""
_NEAR_PER_EQUAL = 25.0
"""Pairs of a cell that differ, for each that is equal, from which equal ones are chance: five times fewer than noise
gives, at a resolution of 1 um."""


def duplicate_rows(values: Values) -> NDArray[np.bool_] | None:
    """Return the rows ``(N,)`` that repeat an earlier row or its measured values, which noise hardly ever does.

    A warning names them; None without such rows.
    """
    n, counted = values.lines.size, values.log.counted
    measured = values.numbers[[values.row_index[key] for key in _MEASURED if key in values.row_index]]
    same_measured = _equal_pairs(measured if len(measured) else values.numbers)
    first, second = _equal_pairs(values.numbers) if same_measured.size else same_measured
    equal, same_visit = np.ones((2, first.size), dtype=bool)
    for name, text in values.texts.items():
        (same_visit if name in _OF_VISIT else equal)[text[first] != text[second]] = False
    duplicate = equal & same_visit
    if duplicate.any():
        first, second = first[duplicate], second[duplicate]
        where = "an earlier row in every column"
    # Rounded values of many visits repeat by chance; a few to the last digit are copies.
    elif 0 < np.count_nonzero(equal) <= _FEW * n:
        first, second = first[equal], second[equal]
        where = "an earlier row of another visit to the last digit"
    elif same_measured.size and "x" in values.row_index and _are_copies(measured[:3], same_measured.shape[1]):
        first, second = same_measured
        where = "the measured values of an earlier row to the last digit"
    else:
        return None
    i = int(np.argmin(values.lines[second]))  # the copy that comes first is the example
    rows = f"{first.size} row{'s repeat' if first.size > 1 else ' repeats'} {where}"
    example = f"{counted} {values.lines[second[i]]} repeats {counted} {int(values.lines[first[i]])}"
    values.log.warn(f"{rows} ({example}); every row counts as a measurement, so delete copies", of_file=True)
    copies = np.zeros(n, dtype=bool)
    copies[second] = True
    return copies


def _equal_pairs(numbers: Array) -> NDArray[np.int64]:
    """Return the numbers ``(2, P)`` of rows with equal ``numbers`` ``(C, N)`` in pairs, the earlier first."""
    # Equal rows have equal sums, term by term; only rows with equal sums are compared in full.
    sums = np.zeros(numbers.shape[1])
    for number, row in enumerate(numbers, 2):
        sums += math.sqrt(number) * row
    ordered = np.sort(sums)
    if not np.any(ordered[1:] == ordered[:-1]):
        return np.empty((2, 0), dtype=np.int64)
    order = np.argsort(sums, kind="stable")
    pairs = np.stack([order[:-1], order[1:]])[:, ordered[1:] == ordered[:-1]]
    return pairs[:, (numbers[:, pairs[0]] == numbers[:, pairs[1]]).all(axis=0)]


def _are_copies(position: Array, equal: int) -> bool:
    """Return whether ``equal`` pairs of equal positions ``(3, N)`` are too many for chance.

    By chance, many more pairs differ in the last digits than agree in all of them.
    """
    steps = position / _COARSE
    if np.count_nonzero(np.abs(steps - np.round(steps)) > 1e-4) < 0.5 * position.size:
        return False
    cells = np.unique(np.floor(np.unique(position, axis=1) / _CELL), axis=1, return_counts=True)[1]
    near = float(np.sum(cells * (cells - 1)) / 2)
    return near < _NEAR_PER_EQUAL * equal


QUATERNION_TOLERANCE = 1e-3
SPEED_TOLERANCE = 1e-6
ABSOLUTE_ZERO = -273.15
READ_BACK_TOLERANCE = 0.1
"""rad or m; an arm that stands is never as far from its command."""
LARGEST_PAYLOAD = 5000.0
"""kg; twice that of the strongest arm."""
SMALLEST_SIGMA = 1e-12
"""m or rad; below it a weight 1/sigma^2 makes the other rows negligible."""
_LARGEST: Mapping[str, float] = {"length": 1e8, "angle": 1e6, "joint": 1e8, "number": 1e12}
"""m (geocentric coordinates are 6.4e6), rad, m or rad for a joint, and the units of circumstances."""


_RULES: tuple[tuple[str, Callable[[Array], NDArray[np.bool_]], str], ...] = (
    ("dir_", lambda v: ~np.isin(v, (-1.0, 0.0, 1.0)), "expected -1, 0 or 1"),
    ("speed_", lambda v: np.abs(v) > 1 + SPEED_TOLERANCE, "expected a fraction of full speed, -1 to 1"),
    ("sigma_", lambda v: v <= 0, "expected a standard deviation above 0"),
    ("sigma_", lambda v: (v > 0) & (v < SMALLEST_SIGMA), f"expected at least {SMALLEST_SIGMA:g} m or rad"),
    ("payload_kg", lambda v: v < 0, "expected 0 kg or more"),
    ("temperature_c", lambda v: v < ABSOLUTE_ZERO, f"expected {ABSOLUTE_ZERO} degrees Celsius or more"),
)
"""Start of the keys of columns, what is wrong with a value, and what is expected."""


def check_sizes(values: Values) -> None:
    """Log numbers that are too large to compute with, and set them to NaN."""
    for key, column in values.layout.columns.items():
        limit, value = _LARGEST.get(column.kind), values.column(key)
        if limit is not None and value is not None:
            _report(values, key, np.abs(value) > limit, f"expected at most {limit * column.divisor:g}{_unit(column)}")
            value[np.abs(value) > limit] = np.nan


def check_rows(values: Values, robot: KnownRobot, skip_limits: frozenset[str], ignore_limits: bool) -> None:
    """Log values of rows that are wrong; small excesses of limits are warnings.

    Args:
        values: The values, of which :func:`check_sizes` set too large ones to NaN.
        robot: Limits of its joints, and its targets.
        skip_limits: Joints whose unit is wrong; a limit check of every row would repeat that problem.
        ignore_limits: All excesses of limits are warnings.

    Where the file lacks joints, its columns may belong to others: no limit is checked.
    """
    layout, log = values.layout, values.log
    for keys in (QUATERNION, COMMANDED_QUATERNION):
        _check_length(values, keys)
    if layout.has(layout.joints()):
        for key, limit in zip(layout.joints(), robot.limits or (), strict=False):
            if limit is not None and key not in skip_limits:
                _check_limits(values, key, limit, ignore_limits)
    for start, test, expected in _RULES:
        for key in values.row_index:
            if key.startswith(start):
                _report(values, key, test(values.numbers[values.row_index[key]]), expected)
    for key in layout.joints():
        _check_read_back(values, key)
    if (payload := values.column("payload_kg")) is not None and (heavy := payload > LARGEST_PAYLOAD).any():
        log.warn(
            f"payload_kg is {payload[heavy][0]:g} kg, more than an arm carries", int(values.lines[np.argmax(heavy)])
        )
    target, known = values.texts.get("target"), None if robot.target_names in (None, "any") else robot.targets
    if target is not None and known:
        log.add_rows(
            ~np.isin(target, known) & (target != ""),
            values.lines,
            "target",
            lambda i: (
                f"found {clip(str(target[i]))}, expected a target of the robot file ({listing(known)}); the nearest is "
                f"{difflib.get_close_matches(str(target[i]), known, n=1, cutoff=0.0)[0]}"
            ),
        )
    # The robot's tool is not used where the file has commanded poses; it would be wrong for all targets but one.
    elif target is not None and known is not None and layout.has(layout.joints()):
        names = list(dict.fromkeys(target[target != ""].tolist()))
        message = f"found several targets ({listing([*map(clip, names)])}), but the robot has one tool and no targets"
        fix = (
            "fit tool_frame, which finds their places (`align` of estimate, `fit` of calibrate; a trace does), "
            "list each target under targets: in the robot file instead of tool, or keep the rows of one target"
        )
        if len(names) > 1:
            log.add(message, int(values.lines[np.argmax(target == names[1])]), "target", fix)


def _check_length(values: Values, keys: Sequence[str]) -> None:
    """Log quaternions that are not of unit length."""
    if (quaternion := values.column_set(keys)) is None:
        return
    with np.errstate(over="ignore"):
        length = np.sqrt(np.einsum("in,in->n", quaternion, quaternion))
    values.log.add_rows(
        np.abs(length - 1) > QUATERNION_TOLERANCE,
        values.lines,
        ", ".join(values.layout.columns[key].name for key in keys),
        lambda i: f"found a quaternion of length {length[i]:.6g}, expected 1 within {QUATERNION_TOLERANCE:g}",
    )


def _check_read_back(values: Values, key: str) -> None:
    """Log a joint that was read back far from its command: another unit, another order, or another row."""
    command, value, column = values.column(key), values.column(f"read_{key}"), values.layout.columns.get(f"read_{key}")
    if command is None or value is None or column is None or not column.name.startswith("read_"):
        return
    values.log.add_rows(
        np.abs(value - command) > READ_BACK_TOLERANCE,
        values.lines,
        column.name,
        lambda i: (
            f"found {value[i]:.6g}, but the commanded joint is {command[i]:.6g} (rad or m); check the unit and "
            "the order of the columns read back"
        ),
    )


def _check_limits(values: Values, key: str, limits: tuple[float, float], ignore: bool) -> None:
    column, value = values.layout.columns[key], values.numbers[values.row_index[key]]
    unit, factor = _unit(column), column.divisor
    limits_text = f"the joint's limits {limits[0] * factor:.6g} to {limits[1] * factor:.6g}{unit}"
    tolerance = np.inf if ignore else EXCESS_TOLERANCE.get(column.kind, EXCESS_TOLERANCE["length"])
    excess = excess_beyond_limits(value, limits)
    if count := np.count_nonzero(small := (excess > 0) & (excess <= tolerance)):
        rows = "1 row, which is used" if count == 1 else f"{count} rows, which are used"
        most = f"{excess[small].max() * factor:.3g}{unit}"
        values.log.warn(
            f"{column.name} exceeds {limits_text} by at most {most} in {rows}", int(values.lines[np.argmax(small)])
        )
    fix = "`ignore_limits` uses these rows all the same"
    if column.unit == "rad" and degrees_likely(value, limits):
        fix = "if the joints are in degrees, name the columns as in q1_deg, or give `units` with deg; else " + fix
    _report(values, key, excess > tolerance, f"expected a value within {limits_text}", fix)


def _report(values: Values, key: str, failed: NDArray[np.bool_], expected: str, fix: str | None = None) -> None:
    """Log the values of a column that fail a test; NaN is in the log already."""
    column, value = values.layout.columns[key], values.numbers[values.row_index[key]]
    values.log.add_rows(
        failed & ~np.isnan(value),
        values.lines,
        column.name,
        lambda i: f"found {value[i] * column.divisor:.10g}{_unit(column)}, {expected}",
        fix,
    )


def _unit(column: Column) -> str:
    """Return the unit of a column behind a blank, for a message."""
    return f" {column.unit}" if column.unit else ""
