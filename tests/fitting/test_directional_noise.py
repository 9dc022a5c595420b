"""Noise of an instrument that is larger along its line of sight, and scatter of the joints that is not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm
from slow_parameters import some_fast

import robacc
from robacc.measurements import Measurements
from robacc.modelling.model import predict

NOISE = 1e-4
"""m; root mean square of the three standard deviations."""
FIT = "base_frame,tool_frame,joint_offset,link_geometry"
ALONG = {"z": (0.0, 0.0, 1.0), "oblique": (0.6, 0.0, 0.8)}
DIRECTIONS = some_fast(sorted(ALONG), 2)
"""The oblique one by default: it is along no axis."""
SEEDS = {"z": 5, "oblique": 7}
"""Draws in which equal noise with scatter of the joints is more likely than equal noise alone."""


def measured(direction: tuple[float, float, float], ratio: float, scatter: float, seed: int) -> Measurements:
    """Poses with noise ``ratio`` times as large along a direction as across it, of joints that scatter (rad)."""
    robot, rng, n = arm("puma560").robot, np.random.default_rng(seed), 150
    limits = np.array([joint.limits for joint in robot.variables])
    q = rng.uniform(0.7 * limits[:, :1], 0.7 * limits[:, 1:], size=(len(limits), n))
    attained = Measurements(np.zeros((3, n)), q=q + scatter * rng.normal(size=q.shape))
    across = NOISE / np.sqrt((2.0 + ratio**2) / 3.0)
    along = np.array(direction)[:, None]
    noise = across * rng.normal(size=(3, n))
    noise += (ratio - 1.0) * along * (along * noise).sum(axis=0)
    return Measurements(predict(robot, attained).translation + noise, q=q)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_noise_along_a_line_of_sight_is_no_scatter_of_the_joints(direction: str) -> None:
    """It was reported as scatter of 0.08 and 0.12 mm; the latter is more than an arm's repeatability: unexplained."""
    data = measured(ALONG[direction], 3.0, 0.0, SEEDS[direction])
    robot = arm("puma560").robot
    traced = robacc.trace(data, robot=robot, declared=FIT, folds=2)
    calibrated = robacc.calibrate(data, robot=robot, fit=FIT, folds=2)
    assert traced.verdict == "clean"
    for result in (traced, calibrated):
        assert result.repeatability is None
        # 150 poses give the largest of the three variances to 12 %, and so the noise to 5 %.
        assert result.noise.noise.position == pytest.approx(NOISE, rel=0.1)
        texts = [warning for warning in result.warnings if "error that remains" in warning]
        assert len(texts) == 1
        named = np.array([float(value) for value in texts[0].split("(")[1].split(")")[0].split(",")])
        assert abs(named @ ALONG[direction]) > 0.98


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_direction_with_more_noise_has_less_weight(direction: str) -> None:
    """Errors of the model are those of a fit that is told the noise, and a third less than with equal weights.

    The fit that is told has poses in a frame whose z axis is along the noise.
    """
    along = np.array(ALONG[direction])
    turn = np.stack((np.cross([0.0, 1.0, 0.0], along), [0.0, 1.0, 0.0], along))
    data, across = measured(ALONG[direction], 5.0, 0.0, 11), NOISE / np.sqrt(27.0 / 3.0)
    stated = np.array([1.0, 1.0, 5.0])[:, None] * across * np.ones(data.n)
    robot = arm("puma560").robot
    fresh = Measurements(np.zeros((3, 400)), q=np.random.default_rng(3).uniform(-1.0, 1.0, (6, 400)))
    truth = predict(robot, fresh).translation

    def errors(poses: Measurements, frame: np.ndarray) -> float:
        poses = dataclasses.replace(poses, position=frame @ data.position)
        result = robacc.calibrate(poses, robot=robot, fit=FIT, folds=2, shrink=False)
        return float(np.sqrt(np.mean(np.square(predict(result.robot, fresh).translation - frame @ truth))))

    result = robacc.calibrate(data, robot=robot, fit=FIT, folds=2)
    expected = across * np.sqrt(1.0 + 24.0 * np.square(along))
    assert result.noise.noise.along_axes == pytest.approx(tuple(expected), rel=0.2)
    assert result.noise.noise.source == "residual"
    told = errors(dataclasses.replace(data, sigma_position=stated), turn)
    assert errors(data, np.eye(3)) == pytest.approx(told, rel=0.1)
    equal = dataclasses.replace(data, sigma_position=np.full((3, data.n), NOISE))
    assert errors(data, np.eye(3)) < 0.75 * errors(equal, np.eye(3))


def test_repeats_decide_whether_an_error_along_an_axis_is_noise() -> None:
    """An error of the poses along z that repeats do not show is no noise of the instrument."""
    rng = np.random.default_rng(4)
    once = measured(ALONG["z"], 1.0, 0.0, 12)
    n, again = once.n, np.arange(2 * once.n) % once.n
    position = once.position[:, again] + 1e-5 * rng.normal(size=(3, 2 * n))
    position[2] += 3.0 * NOISE * rng.normal(size=n)[again]
    data = Measurements(position, q=once.q[:, again], pose=np.array([f"P{i}" for i in again]))
    result = robacc.calibrate(data, robot=arm("puma560").robot, fit=FIT, folds=2)
    assert not any("error that remains" in warning for warning in result.warnings)


def test_scatter_of_the_joints_beside_noise_stays_scatter() -> None:
    data = measured(ALONG["z"], 1.0, 3e-4, 3)
    result = robacc.calibrate(data, robot=arm("puma560").robot, fit=FIT, folds=2)
    assert result.repeatability is not None
    assert not any("error that remains" in warning for warning in result.warnings)
