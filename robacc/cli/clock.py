"""Time of the command that runs: when it started and how long it has run, for JUnit files; no figure depends on it."""

from __future__ import annotations

import time

_started: dict[str, float] = {"time": time.time(), "clock": time.perf_counter()}


def start() -> None:
    """Note the start of a command."""
    _started.update(time=time.time(), clock=time.perf_counter())


def started() -> float:
    """Return the time of the start in seconds since 1970."""
    return _started["time"]


def elapsed() -> float:
    """Return the seconds since the start."""
    return time.perf_counter() - _started["clock"]
