"""Stages of a fit: the gain and the registration of the nominal model."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

from robacc.accuracy.error_statistics import paired_gain
from robacc.fitting.fit_result import HoldOut
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.calibrating import registered_residuals

T = {3: 4.302652729911275, 5: 2.7764451051977987, 40: 2.0226909200367604}
"""Student's quantile of 0.975 with n - 1 degrees of freedom, from tables."""


def gain_per_pose(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """First-order influence of each pose on the fall of the RMS, ``(N,)``."""
    squares = [np.sum(residual[:3] ** 2, axis=0) for residual in (before, after)]
    rms = [np.sqrt(square.mean()) for square in squares]
    return squares[0] / (2 * rms[0]) - squares[1] / (2 * rms[1])


@pytest.mark.parametrize("n", [3, 5, 40])
def test_half_width_is_the_sample_standard_error(n: int) -> None:
    rng = np.random.default_rng(n)
    before, after = 1e-3 * rng.standard_normal((6, n)), 2e-4 * rng.standard_normal((6, n))
    gain = paired_gain(before, after, np.arange(n))
    standard_error = np.std(gain_per_pose(before, after), ddof=1) / np.sqrt(n)
    assert gain.value == pytest.approx(
        np.sqrt(np.mean(np.sum(before[:3] ** 2, axis=0))) - np.sqrt(np.mean(np.sum(after[:3] ** 2, axis=0)))
    )
    # Both are sums of the same n numbers: rounding only.
    assert gain.high - gain.value == pytest.approx(T[n] * standard_error, rel=1e-9)
    assert gain.value - gain.low == pytest.approx(T[n] * standard_error, rel=1e-9)


@pytest.mark.parametrize("numbers", [np.arange(8), 3 * np.arange(8)], ids=["all", "with gaps"])
def test_repeats_of_a_pose_count_once_and_absent_poses_not_at_all(numbers: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    before, after = 1e-3 * rng.standard_normal((3, 8)), 2e-4 * rng.standard_normal((3, 8))
    single = paired_gain(before, after, np.arange(8))
    repeated = paired_gain(np.repeat(before, 3, axis=1), np.repeat(after, 3, axis=1), np.repeat(numbers, 3))
    assert (repeated.value, repeated.low, repeated.high) == pytest.approx((single.value, single.low, single.high))


def test_two_poses_have_a_gain_without_interval() -> None:
    gain = paired_gain(np.full((3, 2), 1e-3), np.full((3, 2), 1e-4), np.arange(2))
    assert gain.value == pytest.approx(np.sqrt(3) * 9e-4)
    assert np.isnan(gain.low)
    assert np.isnan(gain.high)


def test_folds_that_cannot_be_fitted_do_not_undo_the_registration() -> None:
    robot = dataclasses.replace(arm("irb1600").robot, effects=())
    data = simulate(robot, Plan(6, seed=1, noise_position=1e-5, orientation=False)).data
    data = dataclasses.replace(data, position=data.position + np.array([[0.3], [-0.2], [0.1]]))
    rms = [
        float(
            np.sqrt(
                np.mean(np.sum(registered_residuals(robot, data, HoldOut.of(data, None, folds, 0))[0] ** 2, axis=0))
            )
        )
        for folds in (2, 6)
    ]
    assert rms[0] == pytest.approx(rms[1], rel=1e-6)
    assert rms[0] < 1e-3
