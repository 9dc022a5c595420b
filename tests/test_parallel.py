"""Work in several processes: outcomes, order, deaths and signals."""

import os
import signal
from concurrent.futures.process import BrokenProcessPool

from robacc.cli.many import each


def doubled_or_dead(task: int) -> tuple[int, int]:
    """Die of task 2, crash at task 3, double every other task."""
    if task == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    if task == 3:
        raise ZeroDivisionError
    return 2 * task, os.getpid()


def test_a_process_that_dies_takes_one_task_with_it() -> None:
    outcomes = dict(each(doubled_or_dead, range(8), 2))
    assert isinstance(outcomes.pop(2), BrokenProcessPool)
    assert isinstance(outcomes.pop(3), ZeroDivisionError)
    values = {number: outcome for number, outcome in outcomes.items() if isinstance(outcome, tuple)}
    assert {number: value for number, (value, _) in values.items()} == {0: 0, 1: 2, 4: 8, 5: 10, 6: 12, 7: 14}
    assert len(values) == len(outcomes)
    # Two processes at first, and one for the one that died.
    processes = {process for _, process in values.values()}
    assert len(processes) <= 3
    assert os.getpid() not in processes


def test_one_job_is_done_in_this_process() -> None:
    assert list(each(doubled_or_dead, [5, 6], 1)) == [(0, (10, os.getpid())), (1, (12, os.getpid()))]
