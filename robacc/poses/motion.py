"""Direction, speed and time of the joints' last motion: as given, or derived from the order of visits."""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import Counted
from robacc.geometry import Array
from robacc.io.files import ProblemLog, clip
from robacc.measurements import commanded_groups, motion_between_rows
from robacc.poses.layout import COMMANDED_AXES, Values, listing

# Dates and times of day as seconds.

_DAY = 86400.0
_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?")
_CLOCK = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,:](\d{1,9}))?)?(?:\s*([AaPp])\.?[Mm]\.?)?")
_YEAR_FIRST = re.compile(r"(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})")
_YEAR_LAST = re.compile(r"(\d{1,2})([-/.])(\d{1,2})[-/.](\d{4}|\d{2})")
_ZONE = re.compile(r"\s*(Z|UTC|GMT|[+-]\d{2}:?\d{2})$")
_EPOCHS = ((1e17, 1e9), (1e14, 1e6), (1e11, 1e3), (1e8, 1.0))
"""Numbers above the first are times since 1970 in the unit of which the second make a second."""


@dataclass(frozen=True, slots=True)
class Times:
    """Times of the rows."""

    seconds: Array
    """``(N,)`` s; NaN where a problem was logged."""
    remark: str
    """Beginning of the count, for a message; empty for numbers that count by themselves."""


def read_times(
    texts: Mapping[str, NDArray[np.str_]], lines: NDArray[np.int64], names: Mapping[str, str], divisor: float,
    log: ProblemLog,
) -> Times:  # fmt: skip
    """Return the time of each row in s: since the midnight before the first row where the file has dates or clocks.

    Args:
        texts: Columns ``(N,)`` by key: ``time``, ``date``, ``seconds``, ``nanoseconds``.
        lines: ``(N,)`` lines of the rows.
        names: Name of each column in the file.
        divisor: Number of the unit of ``time`` that makes one second.
        log: Takes entries that are no times.
    """
    if "seconds" in texts:
        seconds = _numbers(texts["seconds"], lines, names["seconds"], log)
        if "nanoseconds" in texts:
            seconds = seconds + _numbers(texts["nanoseconds"], lines, names["nanoseconds"], log) / 1e9
        return _since_midnight(seconds)
    if "time" not in texts and "date" not in texts:
        log.add("nanoseconds without a column of seconds", None, names["nanoseconds"], "leave it out with `columns`")
        return Times(np.full(lines.size, np.nan), "")
    key = "time" if "time" in texts else "date"
    column = texts[key]
    if not column.size:
        return Times(np.empty(0), "")
    if "date" not in texts and all(_NUMBER.fullmatch(text) for text in column[:20]):
        values = _numbers(column, lines, names[key], log)
        typical = float(np.nanmedian(np.abs(values))) if np.isfinite(values).any() else 0.0
        scale = next((scale for limit, scale in _EPOCHS if typical > limit), None) if divisor == 1.0 else None
        return _since_midnight(values / scale) if scale else Times(values / divisor, "")
    if key == "time" and "date" in texts:
        column = np.array([f"{date} {clock}" for date, clock in zip(texts["date"], texts["time"], strict=True)])
    return _parsed(column, lines, names[key], log)


def _since_midnight(seconds: Array) -> Times:
    start = np.floor(seconds[0] / _DAY) * _DAY if seconds.size and np.isfinite(seconds[0]) else 0.0
    if start == 0.0:
        return Times(seconds, "")
    day = dt.datetime.fromtimestamp(start, dt.UTC).date() if start < 4e9 else None
    return Times(seconds - start, f"time_s counts from 00:00 UTC of {day}" if day else "time_s counts from a midnight")


def _numbers(texts: Sequence[str] | NDArray[np.str_], lines: NDArray[np.int64], name: str, log: ProblemLog) -> Array:
    values = np.full(len(texts), np.nan)
    for i, text in enumerate(texts):
        if _NUMBER.fullmatch(text):
            values[i] = float(text.replace(",", "."))
        elif text:
            log.add(f"found {clip(str(text))}, expected a time in numbers as in the first rows", int(lines[i]), name)
    return values


def _parsed(column: NDArray[np.str_], lines: NDArray[np.int64], name: str, log: ProblemLog) -> Times:
    day_first = _day_first(column)
    if day_first is None:
        line = int(lines[0])
        log.add(f"found {clip(str(column[0]))}, in which either number may be the day", line, name,
                "write dates as 2026-11-22, or leave the column out with `columns`")  # fmt: skip
        return Times(np.full(column.size, np.nan), "")
    values = np.full(column.size, np.nan)
    dated = False
    for i, text in enumerate(column.tolist()):
        value = _seconds(text, day_first)
        if value is None:
            if text:
                log.add(f"found {clip(text)}, expected a date and time, or a time of day", int(lines[i]), name)
            continue
        values[i], dated = value[0], dated or value[1]
    if dated:
        start = np.floor(values[0] / _DAY) * _DAY if np.isfinite(values[0]) else 0.0
        date = dt.date(1970, 1, 1) + dt.timedelta(days=start / _DAY)
        return Times(values - start, f"time_s counts from 00:00 of {date}")
    # A clock that falls by more than half a day has passed midnight.
    with np.errstate(invalid="ignore"):
        midnights = np.concatenate([[0], np.cumsum(np.diff(values) < -_DAY / 2)])
    return Times(values + _DAY * midnights, "time_s counts from midnight")


def _day_first(column: NDArray[np.str_]) -> bool | None:
    """Return whether the day stands before the month; None where both are possible."""
    day = month = False
    for text in column.tolist():
        match = _YEAR_LAST.match(text)
        if not match:
            continue
        if match[2] == ".":
            return True
        day, month = day or int(match[1]) > 12, month or int(match[3]) > 12
        if day or month:
            return day
    return None if any(_YEAR_LAST.match(text) for text in column.tolist()) else True


def _seconds(text: str, day_first: bool) -> tuple[float, bool] | None:
    """Return seconds since 1970 or since midnight, and whether the text has a date; None for another text."""
    clock_text = text.strip()
    offset = 0.0
    if (zone := _ZONE.search(clock_text)) and ":" in clock_text[: zone.start()]:
        clock_text = clock_text[: zone.start()]
        if zone[1][0] in "+-":
            digits = zone[1].replace(":", "")
            offset = (int(digits[:3]) * 60 + int(digits[0] + digits[3:])) * 60.0
    days = None
    if match := _YEAR_FIRST.match(clock_text):
        days = _days(int(match[1]), int(match[2]), int(match[3]))
    elif match := _YEAR_LAST.match(clock_text):
        day, month = (1, 3) if day_first else (3, 1)
        year = int(match[4])
        days = _days(year + 2000 if year < 100 else year, int(match[month]), int(match[day]))
    if match:
        if days is None:
            return None
        clock_text = clock_text[match.end() :].lstrip("T ,;")
    if not clock_text:
        return None if days is None else (days * _DAY, True)
    clock = _CLOCK.fullmatch(clock_text)
    if not clock or int(clock[1]) > 24 or int(clock[2]) > 59 or int(clock[3] or 0) > 60:
        return None
    hour = int(clock[1])
    if clock[5]:
        hour = hour % 12 + (12 if clock[5] in "pP" else 0)
    seconds = hour * 3600 + int(clock[2]) * 60 + int(clock[3] or 0) + float(f"0.{clock[4] or 0}")
    return (days or 0) * _DAY + seconds - offset, days is not None


def _days(year: int, month: int, day: int) -> int | None:
    try:
        return (dt.date(year, month, day) - dt.date(1970, 1, 1)).days
    except ValueError:
        return None


_SAME_VISIT = 1e-3
"""rad or m; largest difference between the commands of the rows of a visit, from joints that were read back."""

Texts = NDArray[Any] | None


def numbered(*columns: NDArray[Any]) -> NDArray[np.int64]:
    """Return the number ``(N,)`` of each row's combination of values."""
    codes = np.stack([np.unique(column, return_inverse=True)[1] for column in columns])
    return np.unique(codes, axis=1, return_inverse=True)[1].ravel().astype(np.int64)


def rank_among_equals(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how many rows before each row have the same number."""
    order = np.argsort(numbers, kind="stable")
    ordered = numbers[order]
    start = np.searchsorted(ordered, ordered)
    rank = np.empty(numbers.size, dtype=np.int64)
    rank[order] = np.arange(numbers.size) - start
    return rank


def visits_in_order(groups: NDArray[np.int64], visit: Texts, cycle: Texts, target: Texts) -> NDArray[np.int64]:
    """Return the visit ``(N,)`` of each row where rows are in the order measured.

    A column ``visit`` decides. Without it, consecutive rows of one commanded pose and cycle are one visit. Without
    cycles, a target that is measured again belongs to the next visit, and so does each row of a file without targets.

    Args:
        groups: ``(N,)`` commanded pose of each row.
        visit: ``(N,)`` ids, or None; likewise ``cycle`` and ``target``.
        cycle: See ``visit``.
        target: See ``visit``.
    """
    if visit is not None:
        return numbered(visit)
    if cycle is None and target is None:
        return np.arange(groups.size)
    starts = np.ones(groups.size, dtype=bool)
    starts[1:] = groups[1:] != groups[:-1]
    if cycle is not None:
        starts[1:] |= cycle[1:] != cycle[:-1]
    run = np.cumsum(starts)
    return run if cycle is not None or target is None else numbered(run, rank_among_equals(numbered(run, target)))


def motion_between_visits(q: Array, visits: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return direction and relative speed, both ``(J, N)``, of direct moves from each visit to the next.

    Every row has the motion that led to its visit. Visits follow each other in the order of their first rows.
    """
    _, first, number = np.unique(visits, return_index=True, return_inverse=True)
    if first.size == visits.size:
        return motion_between_rows(q)
    order = np.argsort(first)
    place = np.empty(order.size, dtype=np.int64)
    place[order] = np.arange(order.size)
    direction, speed = motion_between_rows(q[:, first[order]])
    return direction[:, place[number]], speed[:, place[number]]


def check_visits(values: Values, ordered: bool, log: ProblemLog) -> None:
    """Log each row that contradicts its ``visit``: other commands, or with ``ordered`` an earlier visit continued."""
    visit = values.texts.get("visit")
    if visit is None or visit.size < 2:
        return
    _, first, number = np.unique(visit, return_index=True, return_inverse=True)
    origin = first[number]
    commands = values.column_set(values.layout.joints())
    if commands is None:
        commands = values.column_set(COMMANDED_AXES)
    if commands is not None:
        distance = np.max(np.abs(commands - commands[:, origin]), axis=0)
        log.add_rows(
            distance > _SAME_VISIT,
            values.lines,
            "visit",
            lambda i: (
                f"visit {clip(str(visit[i]))} has another command than on {log.counted} {values.lines[origin[i]]}; "
                "a visit is one arrival of the arm, so number each arrival differently"
            ),
        )
    if ordered:
        returned = np.zeros(visit.size, dtype=bool)
        returned[1:] = (visit[1:] != visit[:-1]) & (origin[1:] < np.arange(1, visit.size))
        log.add_rows(
            returned,
            values.lines,
            "visit",
            lambda i: (
                f"visit {clip(str(visit[i]))} continues after another visit began, although rows are said to be in the "
                "order measured; number each arrival differently, or sort the rows"
            ),
        )


def motion_of(
    values: Values, ordered: bool, counted: Counted
) -> tuple[tuple[Array | None, Array | None], tuple[str, ...]]:
    """Return direction and speed ``(J, N)``: as given, derived from the order of visits, or 0 with a warning."""
    layout = values.layout
    warnings: list[str] = []
    derived = _derived(values) if ordered else None
    if ordered and derived is None:
        warnings.append("the file has no joint columns, so the order of rows does not give the joints' directions")
    if (time := values.column("time_s")) is not None and np.any(np.diff(time) < 0):
        line = values.lines[int(np.argmax(np.diff(time) < 0)) + 1]
        cause = "the clock was set back, or the rows are not in the order measured"
        warnings.append(f"time_s decreases at {counted} {line}: {cause}")
    result: list[Array | None] = []
    for number, prefix in enumerate(("dir_", "speed_")):
        keys = layout.joints(prefix)
        missing = [key for key in keys if key not in values.row_index]
        if not missing and keys:
            result.append(values.column_set(keys))
        elif derived is None and len(missing) == len(keys):
            result.append(None)
        else:
            table = np.zeros((len(keys), values.lines.size)) if derived is None else derived[number]
            for i, key in enumerate(keys):
                if (column := values.column(key)) is not None:
                    table[i] = column
            result.append(table)
            if derived is None:
                warnings.append(f"no column {listing(missing)}: 0 (not moving) is assumed")
    return (result[0], result[1]), (*warnings, *_opposite_sign_warnings(values, counted))


def _derived(values: Values) -> tuple[Array, Array] | None:
    """Return direction and speed from the order of visits; None without joint columns."""
    q = values.column_set(values.layout.joints())
    if q is None:
        return None
    visit, cycle, target, pose = (values.texts.get(name) for name in ("visit", "cycle", "target", "pose"))
    if visit is None and cycle is None and target is None:
        return motion_between_rows(q)
    grouping = commanded_groups(pose, q)
    groups = np.arange(values.lines.size) if grouping is None else grouping.numbers
    return motion_between_visits(q, visits_in_order(groups, visit, cycle, target))


def _opposite_sign_warnings(values: Values, counted: Counted) -> Iterator[str]:
    """Yield a warning for each joint whose given direction and speed have opposite signs."""
    for keys in zip(values.layout.joints("dir_"), values.layout.joints("speed_"), strict=True):
        direction, speed = (values.column(key) for key in keys)
        if direction is not None and speed is not None and (opposite := direction * speed < 0).any():
            place = f"{counted} {values.lines[np.argmax(opposite)]}"
            yield f"{' and '.join(keys)} have opposite signs at {place}: one of them is wrong"
