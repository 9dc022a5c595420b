"""Dates and times of day as seconds."""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.io.problem_log import ProblemLog, clip

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
