"""Cost of choosing poses: seconds for ten thousand candidates, and linear in their number."""

from __future__ import annotations

import time

import numpy as np
import pytest

from robacc.planning.design import DesignProblem, FitCriterion, choose


@pytest.mark.slow
def test_ten_thousand_candidates_take_seconds_and_grow_linearly() -> None:
    rng = np.random.default_rng(0)
    region = rng.normal(size=(3, 400, 40))
    costs = {}
    for n in (2_500, 10_000):
        case = DesignProblem(rng.normal(size=(n, 3, 40)), np.eye(40), FitCriterion("I", region))
        start = time.process_time()
        choose(case, case.best(60), 0)
        costs[n] = time.process_time() - start
    # The demand is 3 s of a quiet core, and 2 s are usual; processor time on a busy machine may double. Four times the
    # candidates cost at most five times as much.
    assert costs[10_000] < 6.0
    assert costs[10_000] < 5.0 * costs[2_500] + 0.2
