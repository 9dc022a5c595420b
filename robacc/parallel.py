"""Work in several processes: bounded in number, interruptible, and safe when one of them dies.

:func:`each` does what :mod:`concurrent.futures` does not: a process that is ended from outside (for want of memory, for
example) fails only the task it was doing, and an interrupt ends every process without a message of its own.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, NamedTuple, NoReturn, TypeVar

Task = TypeVar("Task")
Outcome = TypeVar("Outcome")

_GRACE_PERIOD = 5.0
"""s that a process has to clean up after it was asked to end."""


class Died(NamedTuple):
    """Outcome of a task whose process ended before the task was done."""

    exit_code: int
    """Exit code of the process: minus the signal that ended it; positive where it crashed and printed why."""


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def each(work: Callable[[Task], Outcome], tasks: Sequence[Task], jobs: int) -> Iterator[tuple[int, Outcome | Died]]:
    """Yield the number and the outcome of each task as it is done, with at most ``jobs`` tasks at a time.

    With one job, this process does the work. ``work`` is a function of a module; its task and its outcome can be
    pickled. Processes are spawned, not forked, so they share no thread and no lock with this process.
    """
    if min(jobs, len(tasks)) <= 1:
        yield from ((number, work(task)) for number, task in enumerate(tasks))
        return
    waiting = list(enumerate(tasks))[::-1]
    processes: dict[Connection, BaseProcess] = {}
    task_numbers: dict[Connection, int] = {}
    try:
        while waiting or task_numbers:
            while waiting and len(task_numbers) < jobs:
                idle = (connection for connection in processes if connection not in task_numbers)
                connection = next(idle, None) or _start(work, processes)
                task_numbers[connection], task = waiting.pop()
                with suppress(OSError):  # the process died; reading its outcome notices that
                    connection.send(task)
            ready = wait(list(task_numbers))
            for connection in [busy for busy in task_numbers if busy in ready]:
                number = task_numbers.pop(connection)
                try:
                    outcome: Outcome | Died = connection.recv()
                except (EOFError, OSError):
                    process = processes.pop(connection)
                    process.join()
                    outcome = Died(process.exitcode or 0)
                yield number, outcome
    finally:
        _end(processes)


def _start(work: Callable[[Any], Any], processes: dict[Connection, BaseProcess]) -> Connection:
    context = multiprocessing.get_context("spawn")
    parent_end, child_end = context.Pipe()
    process = context.Process(target=_serve, args=(work, child_end), daemon=True)
    # Interrupts are blocked for processes that start meanwhile: only this process acts on them. Windows has no masks.
    has_masks = hasattr(signal, "pthread_sigmask")
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if has_masks else set()
    try:
        process.start()
    finally:
        if has_masks:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
    child_end.close()
    processes[parent_end] = process
    return parent_end


def _serve(work: Callable[[Any], Any], connection: Connection) -> None:
    """Receive tasks and send outcomes until the other end of the connection is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave)
    with suppress(EOFError, OSError):
        while True:
            connection.send(work(connection.recv()))


def _leave(number: int, frame: object) -> NoReturn:
    """Exit by an exception, so that half-written files are removed."""
    raise SystemExit(128 + number)


def _end(processes: dict[Connection, BaseProcess]) -> None:
    for process in processes.values():
        process.terminate()
    for process in processes.values():
        process.join(_GRACE_PERIOD)
        if process.is_alive():
            process.kill()
            process.join()
    for connection in processes:
        connection.close()
