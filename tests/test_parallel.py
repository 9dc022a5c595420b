"""Work in several processes: outcomes, order, deaths and signals."""

from __future__ import annotations

import multiprocessing
import os
import signal

import numpy as np
import pytest

from robacc.parallel import Died, each, fork_map, usable_cores


def doubled_or_dead(task: int) -> tuple[int, int]:
    """Die of task 2, crash at task 3, double every other task."""
    if task == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    if task == 3:
        raise ZeroDivisionError
    return 2 * task, os.getpid()


def test_a_process_that_dies_takes_one_task_with_it(capfd: pytest.CaptureFixture[str]) -> None:
    outcomes = dict(each(doubled_or_dead, range(8), 2))
    assert "ZeroDivisionError" in capfd.readouterr().err
    assert (outcomes.pop(2), outcomes.pop(3)) == (Died(-signal.SIGKILL), Died(1))
    values = {number: outcome for number, outcome in outcomes.items() if not isinstance(outcome, Died)}
    assert {number: value for number, (value, _) in values.items()} == {0: 0, 1: 2, 4: 8, 5: 10, 6: 12, 7: 14}
    assert len(values) == len(outcomes)
    # Two processes at first, and one for each that died.
    processes = {process for _, process in values.values()}
    assert len(processes) <= 4
    assert os.getpid() not in processes


def test_one_job_is_done_in_this_process() -> None:
    assert list(each(doubled_or_dead, [5, 6], 1)) == [(0, (10, os.getpid())), (1, (12, os.getpid()))]
    assert usable_cores() >= 1


def test_forked_processes_inherit_the_work_and_keep_the_order() -> None:
    table = np.arange(8.0)
    lambdas_cannot_be_pickled = lambda i: (table[i] ** 2, os.getpid())  # noqa: E731
    outcomes = list(fork_map(lambdas_cannot_be_pickled, range(8), 2))
    assert [value for value, _ in outcomes] == [i**2 for i in range(8)]
    processes = {process for _, process in outcomes}
    assert len(processes) <= 2
    assert os.getpid() not in processes


def test_forked_processes_leave_signals_to_their_parent() -> None:
    def handlers(_: int) -> tuple[object, object]:
        return signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)

    before = handlers(0)
    assert list(fork_map(handlers, [0, 1], 2)) == [(signal.SIG_IGN, signal.SIG_DFL)] * 2
    assert handlers(0) == before


def test_an_error_of_a_forked_process_is_raised_here() -> None:
    def divided(number: int) -> float:
        return 1 / number

    outcomes = fork_map(divided, [2, 0, 1], 2)
    assert next(outcomes) == 0.5
    with pytest.raises(ZeroDivisionError):
        next(outcomes)


def test_fork_map_nests() -> None:
    def total(number: int) -> int:
        return sum(fork_map(lambda item: item * number, range(4), 1))

    assert list(fork_map(total, [1, 2, 3], 2)) == [6, 12, 18]


@pytest.mark.parametrize("processes", [0, 1])
def test_fewer_than_two_processes_do_the_work_in_this_one(processes: int) -> None:
    assert list(fork_map(lambda item: (item, os.getpid()), "ab", processes)) == [("a", os.getpid()), ("b", os.getpid())]


def test_without_fork_this_process_does_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multiprocessing, "get_all_start_methods", lambda: ["spawn"])
    assert list(fork_map(lambda item: (item, os.getpid()), "ab", 2)) == [("a", os.getpid()), ("b", os.getpid())]
