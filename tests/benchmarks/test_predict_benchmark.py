"""What a prediction costs beside the Jacobian it rests on: ``pytest tests/benchmarks -m slow -s`` prints it."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from robacc.accuracy.grade import default_scale
from robacc.modelling.robot_file import read_robot
from robacc.prediction.predicting import pose_covariances, predict_accuracy, sampled_configurations
from robacc.prediction.tolerances import uncertain_parameters
from robacc.robots.arm import Arm

ROBOT = read_robot(Path(__file__).resolve().parents[2] / "configs" / "robots" / "irb1600.yaml")
N = 100_000

pytestmark = pytest.mark.slow


def fastest(call: Callable[[], object], times: int = 5) -> float:
    """Shortest wall time, s: what the work costs when nothing disturbs it."""
    elapsed = []
    for _ in range(times):
        begin = time.perf_counter()
        call()
        elapsed.append(time.perf_counter() - begin)
    return min(elapsed)


def test_covariances_and_budget_of_100000_poses(capsys: pytest.CaptureFixture[str]) -> None:
    arm, parameters = Arm.of(ROBOT), uncertain_parameters(ROBOT)
    where = sampled_configurations(ROBOT, N)
    wanted = [parameter.motion for parameter in parameters]
    jacobian = fastest(lambda: arm.chain.jacobian(where.q, wanted))
    budget = fastest(lambda: pose_covariances(arm.chain, where.scalars, N, parameters))
    whole = fastest(lambda: predict_accuracy(ROBOT, parameters, where, default_scale()), 2)
    with capsys.disabled():
        print(
            f"\n  {N} poses, {len(wanted)} parameters: Jacobian alone {jacobian:.3f} s, covariances and budget "
            f"{budget:.3f} s ({budget / jacobian:.2f} times), with radii, percentiles and grade {whole:.2f} s"
        )
    assert budget <= 4.0 * jacobian


def test_working_memory_does_not_grow_with_the_poses(capsys: pytest.CaptureFixture[str]) -> None:
    arm, parameters = Arm.of(ROBOT), uncertain_parameters(ROBOT)
    working = []
    for n in (10_000, 100_000):
        where = sampled_configurations(ROBOT, n)
        tracemalloc.start()
        found = pose_covariances(arm.chain, where.scalars, n, parameters)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        working.append(peak - found.position.nbytes - found.orientation.nbytes)
    with capsys.disabled():
        print(f"\n  working memory beside the results, 10,000 and 100,000 poses: {np.array(working) / 1e6} MB")
    # Ten times the poses, the same block: a Jacobian of all of them would be 115 MB.
    assert working[1] < 1.2 * working[0]
