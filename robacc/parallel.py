"""Work on several things at once, in processes of their own: bounded, interruptible, and one's death is its own.

Written for what :mod:`concurrent.futures` does not give: a process that is ended from outside (for want of memory, say)
fails the one thing that it was at, and an interrupt ends all of them without a word of theirs.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, NamedTuple, NoReturn, TypeVar

Task = TypeVar("Task")
Outcome = TypeVar("Outcome")

_PATIENCE = 5.0
"""s that a process has to clean up after it was asked to end."""


class Died(NamedTuple):
    """What is left of a task whose process ended before it was done."""

    exit_code: int
    """Of the process: negative for the signal that ended it, positive where it crashed and said why itself."""


def usable_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def each(work: Callable[[Task], Outcome], tasks: Sequence[Task], jobs: int) -> Iterator[tuple[int, Outcome | Died]]:
    """``work`` on every task, at most ``jobs`` at a time; the number of each with its outcome, as they are done.

    With one job the work is done here, without another process. ``work`` is a function of a module; its task and its
    outcome can be pickled. Processes are started afresh, not forked: no thread or lock of this one is theirs.
    """
    if min(jobs, len(tasks)) <= 1:
        yield from ((number, work(task)) for number, task in enumerate(tasks))
        return
    waiting = list(enumerate(tasks))[::-1]
    processes: dict[Connection, BaseProcess] = {}
    at: dict[Connection, int] = {}
    try:
        while waiting or at:
            while waiting and len(at) < jobs:
                connection = next((one for one in processes if one not in at), None) or _started(work, processes)
                at[connection], task = waiting.pop()
                with suppress(OSError):  # it has died; that is noticed where its outcome is read
                    connection.send(task)
            ready = wait(list(at))
            for connection in [one for one in at if one in ready]:
                number = at.pop(connection)
                try:
                    outcome: Outcome | Died = connection.recv()
                except (EOFError, OSError):
                    process = processes.pop(connection)
                    process.join()
                    outcome = Died(process.exitcode or 0)
                yield number, outcome
    finally:
        _end(processes)


def _started(work: Callable[[Any], Any], processes: dict[Connection, BaseProcess]) -> Connection:
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(work, there), daemon=True)
    with _interrupts_held_back():
        process.start()
    there.close()
    processes[here] = process
    return here


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """What is started meanwhile never sees an interrupt, which is this process's to act on."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(work: Callable[[Any], Any], connection: Connection) -> None:
    """One process: tasks in, outcomes out, until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave)
    with suppress(EOFError, OSError):
        while True:
            connection.send(work(connection.recv()))


def _leave(number: int, frame: object) -> NoReturn:
    """As an exception, so that files that are half written are taken away."""
    raise SystemExit(128 + number)


def _end(processes: dict[Connection, BaseProcess]) -> None:
    for process in processes.values():
        process.terminate()
    for process in processes.values():
        process.join(_PATIENCE)
        if process.is_alive():
            process.kill()
            process.join()
    for connection in processes:
        connection.close()
