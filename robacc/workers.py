"""Work on many files, or on the parts of one, in this process, in several, or on the workers of a Dask cluster.

The linear algebra of each process works in one thread.
"""

import functools
import os
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from importlib import import_module
from threading import Thread
from typing import Any, NamedTuple, NoReturn, ParamSpec, TypeVar

from robacc.errors import InputError, Problem, UsageError, install_advice

_ATTEMPTS = 3
"""Times that a task is tried whose process is ended from outside: the third time, the task is to blame."""
_TIMEOUT = 10.0
"""s to wait for a cluster's scheduler."""

Task = TypeVar("Task")
Outcome = TypeVar("Outcome")
Arguments = ParamSpec("Arguments")


class WorkerKilled(InputError):
    """The processes that had a task were ended from outside, for want of memory, for example."""

    def __init__(self) -> None:
        """Say what happened."""
        super().__init__("the process was killed, perhaps for lack of memory; try `jobs` 1")


class FileOutcome(NamedTuple):
    """Outcome of a file: its main figures, or the problems that prevented it."""

    name: str
    """Unique name: the file's, with as many of its folders as needed."""
    exit_status: int
    """Exit status of the command on this file alone."""
    summary: Mapping[str, Any] | None = None
    """Main figures of the estimate, by their keys in a document."""
    problems: tuple[Problem, ...] = ()
    n_problems: int = 0
    """Number of problems, of which ``problems`` are the first."""
    warnings: tuple[str, ...] = ()
    gate: Mapping[str, Any] | None = None
    written: str | None = None
    """Name of the file in the folder of results."""
    seconds: float = 0.0
    """Elapsed time of the work on this file."""

    @property
    def failed(self) -> bool:
        """True where there is no result."""
        return self.summary is None


class Workers(NamedTuple):
    """What does the work."""

    jobs: int | None = None
    """Number of processes; 1 is this process, None as many as cores for several files and this process for one."""
    cluster: str | None = None
    """Address of the scheduler of a Dask cluster, which takes precedence."""

    def each(
        self, work: Callable[[Task], Outcome], tasks: Sequence[Task]
    ) -> Generator[tuple[int, Outcome | BaseException], None, None]:
        """Yield the number of each task as it is done, and its outcome or error.

        ``work`` is a function of a module; its task and its outcome can be pickled. In this process, an error ends the
        work. Another process that is ended from outside costs nothing but time: another one does its task again, and
        only a task that ends three of them has the error :class:`WorkerKilled`.

        Raises:
            UsageError: The cluster cannot be reached, or the extra ``cluster`` is not installed.
        """
        if self.cluster is not None:
            yield from _on_cluster(work, tasks, self.cluster)
        elif min(self.jobs or 1, len(tasks)) <= 1:
            yield from ((number, work(task)) for number, task in enumerate(tasks))
        else:
            yield from _in_processes(work, tasks, self.jobs or 1)

    def in_order(
        self, work: Callable[[Task], Outcome], tasks: Sequence[Task], progress: Callable[[int, int], None]
    ) -> Iterator[Outcome]:
        """Yield the outcomes in the order of the tasks, so that sums of them round the same whoever did the work.

        Args:
            work: As in :meth:`each`.
            tasks: The tasks.
            progress: Called with the number of outcomes that were yielded, and the number of all tasks.

        Raises:
            UsageError: As :meth:`each`.
            WorkerKilled: A task ended every process that had it.
        """
        early: dict[int, Outcome | BaseException] = {}
        following = 0
        with closing(self.each(work, tasks)) as outcomes:  # An error ends the other processes at once.
            for number, outcome in outcomes:
                early[number] = outcome
                while following in early:
                    due = early.pop(following)
                    if isinstance(due, BaseException):
                        raise due
                    yield due
                    following += 1
                    progress(following, len(tasks))


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _in_processes(
    work: Callable[[Task], Outcome], tasks: Sequence[Task], jobs: int
) -> Iterator[tuple[int, Outcome | BaseException]]:
    """Work in ``jobs`` processes, each a pool of its own, so that one that is killed fails no other task.

    Processes are spawned, not forked, so they share no thread and no lock with this process.
    """
    from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import active_children, get_context

    waiting = deque((number, _ATTEMPTS) for number in range(len(tasks)))
    idle: list[ProcessPoolExecutor] = []
    running: dict[Future[Outcome], tuple[int, int, ProcessPoolExecutor]] = {}
    # Interrupts are blocked for processes that start meanwhile: only this process acts on them. Windows has no masks.
    has_masks = hasattr(signal, "pthread_sigmask")
    try:
        while waiting or running:
            before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if has_masks else set()
            try:
                while waiting and len(running) < jobs:
                    pool = idle.pop() if idle else ProcessPoolExecutor(1, get_context("spawn"), _prepare)
                    number, attempts = waiting.popleft()
                    running[pool.submit(work, tasks[number])] = number, attempts - 1, pool
            finally:
                if has_masks:
                    signal.pthread_sigmask(signal.SIG_SETMASK, before)
            for done in wait(running, return_when=FIRST_COMPLETED).done:
                number, attempts, pool = running.pop(done)
                error = done.exception()
                if not isinstance(error, BrokenProcessPool):
                    idle.append(pool)
                    yield number, error or done.result()
                elif attempts:
                    waiting.appendleft((number, attempts))
                else:
                    yield number, WorkerKilled()
    finally:
        for pool in (*idle, *(pool for _, _, pool in running.values())):
            # A process that ends while it sends leaves half a message; this process waits for the rest, even at its
            # exit, as long as it may write to the pipe itself.
            results: Any = pool._result_queue
            pool.shutdown(wait=False)
            results._writer.close()
        processes = active_children()
        for process in processes:
            process.terminate()
        for process in processes:
            process.join(5.0)  # s, to clean up
            process.kill()


def _prepare() -> None:
    """Make a process leave interrupts to its parent, and end when it is told or when its parent has ended."""
    from multiprocessing import parent_process

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave)
    Thread(target=_follow, args=(parent_process(),), daemon=True).start()


def _follow(parent: Any) -> NoReturn:
    parent.join()
    os._exit(1)


def _leave(number: int, frame: object) -> NoReturn:
    """Exit by an exception, so that half-written files are removed."""
    raise SystemExit(128 + number)


def _on_cluster(
    work: Callable[[Task], Outcome], tasks: Sequence[Task], address: str
) -> Iterator[tuple[int, Outcome | BaseException]]:
    try:
        dask: Any = import_module("distributed")
    except ImportError as error:
        raise UsageError(f"`cluster` needs an optional package; run {install_advice('cluster')}") from error
    try:
        client = dask.Client(address, timeout=_TIMEOUT)
    except (OSError, ValueError) as error:
        raise UsageError(f"`cluster`: no scheduler of Dask answers at {address}") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_TIMEOUT)
        except TimeoutError as error:
            raise UsageError(f"`cluster`: the scheduler at {address} has no workers; start some") from error
        numbers = {client.submit(work, task, pure=False): number for number, task in enumerate(tasks)}
        for future in dask.as_completed([*numbers]):
            failed = future.exception()
            yield (
                numbers.pop(future),
                WorkerKilled() if isinstance(failed, dask.KilledWorker) else failed or future.result(),
            )


# Threads of the linear algebra.

THREADS_VARIABLE = "OPENBLAS_NUM_THREADS"
"""Environment variable that OpenBLAS reads when NumPy is imported; the command line sets it to 1."""


def single_threaded(call: Callable[Arguments, Outcome]) -> Callable[Arguments, Outcome]:
    """Return ``call`` with the linear algebra of NumPy and SciPy in one thread while it runs.

    The matrices of a fit are small: threads spend more time waiting than computing, and a trace takes twice the
    processor time on two cores. One thread also rounds the same on every machine.
    """

    @functools.wraps(call)
    def limited(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Outcome:
        if os.environ.get(THREADS_VARIABLE) == "1":
            return call(*args, **kwargs)
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return call(*args, **kwargs)

    return limited
