"""Number of threads of the linear algebra."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
Result = TypeVar("Result")

VARIABLE = "OPENBLAS_NUM_THREADS"
"""Environment variable that OpenBLAS reads when NumPy is imported; the command line sets it to 1."""


def single_threaded(call: Callable[P, Result]) -> Callable[P, Result]:
    """Return ``call`` with the linear algebra of NumPy and SciPy in one thread while it runs.

    The matrices of a fit are small: threads spend more time waiting than computing, and a trace takes twice the
    processor time on two cores. One thread also rounds the same on every machine.
    """

    @functools.wraps(call)
    def limited(*args: P.args, **kwargs: P.kwargs) -> Result:
        if os.environ.get(VARIABLE) == "1":
            return call(*args, **kwargs)
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return call(*args, **kwargs)

    return limited
