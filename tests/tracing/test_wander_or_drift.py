"""Errors that wander over some poses are no drift, and a drift over the whole run is no wander."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

import robacc
from robacc.geometry import Array
from robacc.simulation.simulate import Plan, simulate

NOISE = 2e-5


def found_with(error: Array) -> list[str]:
    """Return the effects that a trace finds on poses of a nominal arm with ``error`` ``(3, N)`` in m."""
    robot = dataclasses.replace(arm("irb1600").robot, effects=())
    plan = Plan(error.shape[1], seed=6, noise_position=0.0, orientation=False, time_step=30.0)
    data = simulate(robot, plan).data
    data = dataclasses.replace(data, position=data.position + error)
    result = robacc.trace(data, robot=robot, declared="base_frame,tool_frame,joint_offset", folds=3)
    return [finding.effect for finding in result.findings]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_wander_over_six_poses_is_no_drift(seed: int) -> None:
    rng, n = np.random.default_rng(seed), 120
    wander = rng.standard_normal((3, n))
    memory = np.exp(-1.0 / 6.0)
    for i in range(1, n):
        wander[:, i] = memory * wander[:, i - 1] + np.sqrt(1.0 - memory**2) * wander[:, i]
    assert "frame_drift" not in found_with(NOISE * (wander + rng.standard_normal((3, n))) / np.sqrt(2.0))


def test_a_drift_over_the_run_is_named_beside_noise() -> None:
    n = 120
    drift = np.outer([6e-5, -4e-5, 3e-5], np.linspace(-1.0, 1.0, n))
    assert found_with(drift + NOISE * np.random.default_rng(5).standard_normal((3, n))) == ["frame_drift"]
