"""Work in several processes, on a cluster, or in one thread: outcomes, order, deaths."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from robacc.errors import UsageError
from robacc.workers import WorkerKilled, Workers


def doubled_or_dead(task: int) -> tuple[int, int]:
    """Die of task 2, crash at task 3, double every other task."""
    if task == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    if task == 3:
        raise ZeroDivisionError
    return 2 * task, os.getpid()


def dead_at_first(path: str) -> str:
    """Die where there is no file yet, after making it; else return its name, the later ones sooner."""
    mark = Path(path)
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.05 * (5 - int(mark.name)))
    return mark.name


def test_a_task_that_ends_every_process_fails_alone() -> None:
    outcomes = dict(Workers(2).each(doubled_or_dead, range(8)))
    assert isinstance(outcomes.pop(2), WorkerKilled)
    assert isinstance(outcomes.pop(3), ZeroDivisionError)
    values = {number: outcome for number, outcome in outcomes.items() if isinstance(outcome, tuple)}
    assert {number: value for number, (value, _) in values.items()} == {0: 0, 1: 2, 4: 8, 5: 10, 6: 12, 7: 14}
    assert len(values) == len(outcomes)
    assert os.getpid() not in {process for _, process in values.values()}


@pytest.mark.parametrize("where", ["processes", "cluster"])
def test_a_killed_worker_loses_nothing_and_the_order_stays(tmp_path: Path, where: str) -> None:
    tasks = [str(tmp_path / str(number)) for number in range(5)]
    for path in (tasks[0], tasks[2]):
        Path(path).touch()
    if where == "processes":
        done: list[tuple[int, int]] = []
        in_order = Workers(2).in_order(dead_at_first, tasks, lambda *counts: done.append(counts))
        assert list(in_order) == ["0", "1", "2", "3", "4"]
        assert done == [(number, 5) for number in (1, 2, 3, 4, 5)]
        return
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        workers = Workers(cluster=cluster.scheduler_address)
        assert list(workers.in_order(dead_at_first, tasks, print)) == ["0", "1", "2", "3", "4"]


def test_a_scheduler_without_workers_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr("robacc.workers._TIMEOUT", 1.0)
    with distributed.LocalCluster(n_workers=0, dashboard_address=None) as cluster:
        workers = Workers(cluster=cluster.scheduler_address)
        with pytest.raises(UsageError, match="has no workers; start some"):
            list(workers.each(doubled_or_dead, [5, 6]))


def test_one_job_is_done_in_this_process() -> None:
    assert list(Workers(1).each(doubled_or_dead, [5, 6])) == [(0, (10, os.getpid())), (1, (12, os.getpid()))]


def test_an_error_in_the_first_part_is_the_one_that_is_raised() -> None:
    with pytest.raises(ZeroDivisionError):
        list(Workers(2).in_order(doubled_or_dead, [0, 3, 2], print))


SCRIPT = """
import numpy
from threadpoolctl import threadpool_info

from robacc.workers import single_threaded


def threads():
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


before = threads()
inside = single_threaded(threads)()
assert all(count == 1 for count in inside), inside
assert threads() == before, (before, threads())
print(*before)
"""


def test_a_call_uses_one_thread_and_gives_the_others_back() -> None:
    environment = {"OPENBLAS_NUM_THREADS": "2", "PATH": ""}
    done = subprocess.run([sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    if "2" not in done.stdout:
        pytest.skip("the linear algebra of this machine has one thread only")
