"""Direction, speed and time of the joints' last motion: as given, or derived from the order of visits."""

from __future__ import annotations

import datetime as dt
import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import Note
from robacc.geometry import Array
from robacc.io.files import ProblemLog, clip
from robacc.measurements import commanded_groups, motion_between_rows, numbered
from robacc.poses.layout import Values, listing
from robacc.poses.reading import COMMANDED_AXES, Column

# Dates and times of day as seconds.

_DAY = 86400.0
_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?")
_STAMP = re.compile(
    r"\s*(?:(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})|(\d{1,2})[-/.](\d{1,2})[-/.](\d{4}|\d{2})|)[T ,;]*"
    r"(?:(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,:](\d{1,9}))?)?(?:\s*([AaPp])\.?[Mm]\.?)?"
    r"\s*(?:Z|UTC|GMT|([+-]\d{2}):?(\d{2}))?)?\s*"
)
"""Date with the year first or last, and time of day with its zone."""


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
        for i in [i for i, value in enumerate(found) if value is None]:
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
    column = texts[key]
    if "date" not in texts and all(_NUMBER.fullmatch(text) for text in column[:20]):
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
    return float(text.replace(",", ".")) if _NUMBER.fullmatch(text) else None


def _seconds(text: str, day_first: bool) -> float | None:
    """Return seconds since 1970, or since midnight where the text has no date; None for another text."""
    if (match := _STAMP.fullmatch(text)) is None:
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


Texts = NDArray[Any] | None


def numbered_visits(
    groups: NDArray[np.int64], visit: Texts, cycle: Texts, target: Texts, *, ordered: bool = True
) -> NDArray[np.int64]:
    """Return the visit ``(N,)`` of each row.

    A column ``visit`` decides. Without it, rows with the same commanded pose and cycle are a visit. Without cycles, a
    target that is measured again belongs to the next visit, and so does each row of a file without targets.

    Args:
        groups: ``(N,)`` commanded pose of each row.
        visit: ``(N,)`` ids, or None; likewise ``cycle`` and ``target``.
        cycle: See ``visit``.
        target: See ``visit``.
        ordered: Rows are in the order measured: only consecutive rows share a visit.
    """
    if visit is not None:
        return numbered(visit)
    runs = groups if cycle is None else numbered(groups, cycle)
    runs = np.cumsum(np.diff(runs, prepend=-1) != 0) if ordered else runs
    if cycle is not None:
        return runs
    if target is None:
        return np.arange(groups.size)
    # A row's visit is the number of rows of the same target before it.
    numbers = numbered(runs, target)
    order, before = np.argsort(numbers, kind="stable"), np.empty_like(numbers)
    before[order] = np.arange(numbers.size) - np.searchsorted(numbers[order], numbers[order])
    return numbered(runs, before)


def motion_between_visits(q: Array, visits: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return direction and relative speed, both ``(J, N)``, of direct moves from each visit to the next.

    Every row has the motion that led to its visit. Visits follow each other in the order of their first rows.
    """
    _, first, number = np.unique(visits, return_index=True, return_inverse=True)
    rows = np.sort(first)
    direction, speed = motion_between_rows(q[:, rows])
    place = np.searchsorted(rows, first)[number]
    return direction[:, place], speed[:, place]


def check_visits(values: Values, ordered: bool) -> None:
    """Log each row that contradicts its ``visit``: other commands, or with ``ordered`` an earlier visit continued."""
    visit = values.texts.get("visit")
    if visit is None or visit.size < 2:
        return
    _, first, number = np.unique(visit, return_index=True, return_inverse=True)
    origin = first[number]
    sets = (values.column_set(keys) for keys in (values.layout.joints(), COMMANDED_AXES))
    if (commands := next((commands for commands in sets if commands is not None), None)) is not None:
        values.log.add_rows(
            # rad or m; largest difference between the commands of the rows of a visit, from joints that were read back.
            np.max(np.abs(commands - commands[:, origin]), axis=0) > 1e-3,
            values.lines,
            "visit",
            lambda i: (
                f"visit {clip(str(visit[i]))} has another command than on {values.log.counted} "
                f"{values.lines[origin[i]]}; a visit is one arrival of the arm, so number each arrival differently"
            ),
        )
    if ordered:
        values.log.add_rows(
            np.append(False, visit[1:] != visit[:-1]) & (origin < np.arange(visit.size)),
            values.lines,
            "visit",
            lambda i: (
                f"visit {clip(str(visit[i]))} continues after another visit began, although rows are said to be in the "
                "order measured; number each arrival differently, or sort the rows"
            ),
        )


def motion_of(values: Values, ordered: bool) -> tuple[Array | None, Array | None]:
    """Return direction and speed ``(J, N)``: as given, derived from the order of visits, or 0 with a warning."""
    layout, log = values.layout, values.log
    q, time = values.column_set(layout.joints()), values.column("time_s")
    derived: Sequence[Array | None] = (None, None)
    if ordered and q is None:
        text = "the file has no joint columns, so the order of rows does not give the joints' directions"
        log.warn(text, of_file=True)
    elif ordered and q is not None:
        visit, cycle, target, pose = (values.texts.get(name) for name in ("visit", "cycle", "target", "pose"))
        grouping = None if cycle is None and target is None else commanded_groups(pose, q)
        groups = np.arange(values.lines.size) if grouping is None else grouping.numbers
        derived = motion_between_visits(q, numbered_visits(groups, visit, cycle, target))
    if time is not None and np.any(np.diff(time) < 0):
        line = values.lines[int(np.argmax(np.diff(time) < 0)) + 1]
        cause = "the clock was set back, or the rows are not in the order measured"
        log.warn(f"time_s decreases at {log.counted} {line}: {cause}", of_file=True)
    result: list[Array | None] = []
    for keys, motion in zip((layout.joints("dir_"), layout.joints("speed_")), derived, strict=True):
        missing = [key for key in keys if key not in values.row_index]
        table = values.column_set(keys)
        if missing and (motion is not None or len(missing) < len(keys)):
            table = np.zeros((len(keys), values.lines.size)) if motion is None else motion
            for row, key in zip(table, keys, strict=True):
                row[:] = values.numbers[values.row_index[key]] if key in values.row_index else row
            if motion is None:
                log.warn(f"no column {listing(missing)}: 0 (not moving) is assumed", of_file=True)
        result.append(table)
    for names in zip(layout.joints("dir_"), layout.joints("speed_"), strict=True):
        pair = values.numbers[[values.row_index[key] for key in names if key in values.row_index]]
        if len(pair) == 2 and (opposite := pair[0] * pair[1] < 0).any():
            place = f"{log.counted} {values.lines[np.argmax(opposite)]}"
            text = f"{' and '.join(names)} have opposite signs at {place}: one of them is wrong"
            log.warn(text, of_file=True)
    return result[0], result[1]
