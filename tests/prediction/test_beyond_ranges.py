"""Uncertainty of coefficients beyond the joint ranges of their fit, where errors were shared by the fit's poses."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

import robacc
from robacc.errors import InputError
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.prediction.model_fit import ModelFit, model_fit
from robacc.prediction.model_uncertainty import model_uncertainty
from robacc.robots.description import Robot
from robacc.robots.yaml_robot import parse_robot

NOISE, LOW, HIGH = 2e-5, -1.5, 1.5
FACTOR = "standard_error_factor_beyond_ranges"


def calibrated(wave: float) -> robacc.Calibrated:
    """A nominal arm, fitted to poses with noise and a smooth error of joint 2 that the model lacks."""
    robot = arm("puma560").robot
    rng = np.random.default_rng(5)
    q = rng.uniform(LOW, HIGH, (6, 150))
    data = Measurements(np.zeros((3, q.shape[1])), q=q)
    error = NOISE * rng.standard_normal((3, q.shape[1])) + wave * np.cos(2.0 * q[1]) * np.array([[0.6], [0.0], [0.8]])
    data = dataclasses.replace(data, position=predict(robot, data).translation + error)
    return robacc.calibrate(data, robot=robot, fit="base_frame,tool_frame,joint_offset")


def record(robot: Robot) -> ModelFit:
    fit = model_fit(robot)
    assert fit is not None
    return fit


def spread(robot: Robot, fit: ModelFit, second: float) -> np.ndarray:
    """Standard deviation along each axis of positions with one angle of joint 2, from the coefficients alone."""
    bare = dataclasses.replace(fit, unexplained=0.0 * fit.unexplained, repeatability={}, bound_factor=(1.0, 1.0))
    q = np.random.default_rng(9).uniform(-1.2, 1.2, (6, 8))
    q[1] = second
    covariance = model_uncertainty(robot, bare, Measurements(np.zeros((3, 8)), q=q), measured=False).position
    return np.sqrt(np.einsum("iin->in", covariance))


def test_standard_errors_grow_beyond_the_ranges_only() -> None:
    robot = calibrated(3.0 * NOISE).robot
    fit = record(robot)
    plain = dataclasses.replace(fit, factor_beyond=np.ones_like(fit.factor_beyond))
    same = dataclasses.replace(fit, factor_beyond=np.full_like(fit.factor_beyond, 3.0))
    low, high = fit.ranges[robot.variable_names[1]]
    for angle, ratio in ((low, 1.0), (high, 1.0), (high + 0.05 * (high - low), 2.0), (low - 0.1 * (high - low), 3.0)):
        np.testing.assert_allclose(spread(robot, same, angle), ratio * spread(robot, plain, angle), rtol=1e-9)
    np.testing.assert_allclose(spread(robot, same, 2.5), 3.0 * spread(robot, plain, 2.5), rtol=1e-9)
    # The factors of the fit are those of single coefficients.
    assert 1.0 < fit.factor_beyond.max() < 20.0
    assert np.all(spread(robot, fit, 2.5) >= spread(robot, plain, 2.5))
    assert np.any(spread(robot, fit, 2.5) > 1.2 * spread(robot, plain, 2.5))


def test_the_model_file_keeps_the_factors() -> None:
    result = calibrated(3.0 * NOISE)
    read = record(parse_robot(result.model_yaml(), "model.yaml"))
    np.testing.assert_allclose(read.factor_beyond, record(result.robot).factor_beyond, rtol=1e-10)
    reported = np.array([result.fit.names.index(name) for name in read.coefficients])
    stds = np.sqrt(np.diag(result.fit.covariance)[reported])
    np.testing.assert_allclose(read.factor_beyond * np.sqrt(np.diag(read.covariance)), stds, rtol=1e-9)


def test_errors_that_poses_do_not_share_need_no_factors() -> None:
    result = calibrated(0.0)
    assert np.all(record(result.robot).factor_beyond == 1.0)
    assert FACTOR not in result.model_yaml()


@pytest.mark.parametrize("value", ["0.5", "nan", "1 1", "many"])
def test_a_wrong_list_of_factors_is_an_error(value: str) -> None:
    robot = calibrated(3.0 * NOISE).robot
    assert robot.fit is not None
    wrong = dataclasses.replace(robot, fit={**robot.fit, FACTOR: value})
    with pytest.raises(InputError, match="fit: cannot be read"):
        model_fit(wrong)
