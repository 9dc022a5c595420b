"""Cost of the statistics of a million poses as a ratio to sorting; ``pytest tests/benchmarks -m slow -s`` prints it."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
from costs import report

from robacc.accuracy.error_statistics import error_statistics

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("offset", [0.0, 1e-3])
def test_a_million_poses_against_sorting(offset: float, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(1)
    errors = rng.normal(scale=1e-4, size=(3, 1_000_000)) + offset
    shuffled = rng.permutation(2_000_000.0 + np.arange(2_000_000))
    statistics = [_seconds(lambda: error_statistics(errors, "m")) for _ in range(5)]
    sorting = [_seconds(lambda: np.sort(shuffled, kind="stable")) for _ in range(5)]
    report(capsys, f"statistics of 1 M poses: {min(statistics) / min(sorting):.2f} times sorting 2 M numbers")


def _seconds(call: Callable[[], object]) -> float:
    start = time.process_time()
    call()
    return time.process_time() - start
