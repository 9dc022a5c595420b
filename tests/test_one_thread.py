"""Calls from Python compute in one thread of linear algebra, whatever NumPy was started with."""

import subprocess
import sys

import pytest

SCRIPT = """
import numpy
from threadpoolctl import threadpool_info

from robacc.threads import single_threaded


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
