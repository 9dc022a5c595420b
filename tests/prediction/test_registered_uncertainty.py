"""Covariance of a model's errors after a registration, against repeated draws that are registered one by one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

from robacc.effects.frames import JointOffset
from robacc.errors import InputError
from robacc.fitting.parameters import apply_fit
from robacc.fitting.registration import registration_fit
from robacc.geometry import Array, compose, exp_so3
from robacc.measurements import Measurements
from robacc.modelling.model import predict, residuals
from robacc.prediction.model_uncertainty import ModelFit, coverage, model_uncertainty, registered_uncertainty
from robacc.robots.description import Robot

LOW, HIGH, SIZE = -0.6, 0.4, 3e-4
OFFSET_STD, UNEXPLAINED_STD = 4e-4, (3e-5, 5e-5)
FRAMES = ("base_frame", "tool_frame")


def model() -> tuple[Robot, ModelFit]:
    entry = {
        "effect": "transmission_error",
        "joints": ["j2"],
        "orders": [2.0],
        "values": {"j2.cos2": SIZE, "j2.sin2": 0.0},
        "validity": {"j2": [LOW, HIGH]},
    }
    robot = dataclasses.replace(arm("puma560").robot, effects=(entry,))
    fit = ModelFit(
        effects=(JointOffset(("j3",)),),
        coefficients=("joint_offset.j3",),
        covariance=np.array([[OFFSET_STD**2]]),
        nominal={},
        repeatability={},
        unexplained=np.diag(np.repeat(np.square(UNEXPLAINED_STD), 3)),
        noise=(0.0, 0.0),
        noise_is_separate=False,
        bound_factor=(1.0, 1.0),
        largest_correction=(1e-3, 1e-3),
        ranges={},
        n_poses=100,
    )
    return robot, fit


def drawn(robot: Robot, data: Measurements, rng: np.random.Generator) -> Measurements:
    """Measured poses of an arm whose errors are a draw of the model's uncertainty."""
    q = np.array(data.q)
    q[2] += OFFSET_STD * rng.standard_normal()
    # The error of joint 2 is a process of its angle with a correlation length of a twentieth of the range.
    second = data.q[1]  # type: ignore[index]
    places = np.concatenate((second, np.clip(second, LOW, HIGH)))
    kernel = np.exp(-0.5 * np.square((places[:, None] - places) / (0.05 * (HIGH - LOW))))
    values = np.linalg.cholesky(kernel + 1e-9 * np.eye(places.size)) @ rng.standard_normal(places.size)
    n = data.n
    step = (values[:n] - values[n:]) / np.sqrt(np.maximum(2.0 * (1.0 - np.diag(kernel[:n, n:])), 1e-12))
    excess = np.maximum(np.maximum(LOW - second, second - HIGH), 0.0) / (HIGH - LOW)
    growth = np.where(excess > 0.01, np.minimum(10 * excess, 1.0), 0.0)
    angles = np.linspace(LOW, HIGH, 1001)
    q[1] += np.sqrt(2.0 * np.mean(np.square(SIZE * np.cos(2 * angles)))) * growth * step
    # The known ripple stays that of the commanded joints.
    still = dataclasses.replace(robot, effects=())
    known = predict(robot, data)
    nominal, moved = predict(still, data), predict(still, dataclasses.replace(data, q=q))
    rotation = compose(moved.rotation, compose(nominal.rotation.transpose(1, 0, 2), known.rotation))
    position = known.translation + moved.translation - nominal.translation
    position = position + UNEXPLAINED_STD[0] * rng.standard_normal((3, n))
    turned = compose(rotation, exp_so3(UNEXPLAINED_STD[1] * rng.standard_normal((3, n))))
    return dataclasses.replace(data, position=position, rotation=turned)


def moments(error: list[Array]) -> Array:
    """Root mean square of every component over draws, ``(6, N)``."""
    return np.sqrt(np.mean(np.square(error), axis=0))


def test_covariance_after_a_registration_is_that_of_registered_draws() -> None:
    robot, fit = model()
    rng = np.random.default_rng(4)
    q = rng.uniform(-1.2, 1.2, (6, 48))
    empty = Measurements(np.zeros((3, 48)), q=q, rotation=np.tile(np.eye(3)[:, :, None], (1, 1, 48)))
    used, judged = np.arange(32), np.arange(32, 48)
    errors, bare = [], []
    for _ in range(70):
        data = drawn(robot, empty, rng)
        registration = registration_fit(robot, data.subset(used), FRAMES)
        part = data.subset(judged)
        errors.append(residuals(part, predict(apply_fit(registration), part)))
        bare.append(residuals(part, predict(robot, part)))
    position, orientation = registered_uncertainty(robot, fit, empty.subset(judged), registration, data.subset(used))
    predicted = np.sqrt(np.concatenate((np.einsum("iin->in", position), np.einsum("iin->in", orientation))))
    ratio = moments(errors) / predicted
    # A standard deviation of 70 draws is known within 8.5 %; the mean over 48 correlated ones within some 4 %. With
    # 1,500 draws the ratios are 0.90 to 1.04.
    assert 0.9 < np.sqrt(np.mean(np.square(ratio[:3]))) < 1.1
    assert 0.9 < np.sqrt(np.mean(np.square(ratio[3:]))) < 1.1
    assert 0.65 < ratio.min() < ratio.max() < 1.4
    # Without the registration, it is the covariance of the model alone, which is another one.
    alone = model_uncertainty(robot, fit, empty.subset(judged), measured=True)[0]
    expected = np.sqrt(np.concatenate([np.einsum("iin->in", part) for part in alone]))
    assert 0.9 < np.sqrt(np.mean(np.square(moments(bare) / expected))) < 1.1
    assert np.abs(predicted / expected - 1.0).max() > 0.3


def measured_at(robot: Robot, q: Array) -> Measurements:
    """Measured poses of the arm as the model has it, with noise."""
    random = np.random.default_rng(12)
    data = Measurements(np.zeros((3, q.shape[1])), q=q)
    poses = predict(robot, data)
    return dataclasses.replace(
        data,
        position=poses.translation + 1e-5 * random.standard_normal(poses.translation.shape),
        rotation=compose(exp_so3(2e-5 * random.standard_normal((3, q.shape[1]))), poses.rotation),
    )


def test_frames_cannot_be_fitted_to_a_half_of_a_single_pose() -> None:
    robot, fit = model()
    q = np.repeat(np.random.default_rng(5).uniform(LOW, HIGH, (6, 1)), 30, axis=1)
    with pytest.raises(InputError, match="cannot be fitted to one half of the poses: all are the same commanded pose"):
        coverage(robot, fit, measured_at(robot, q), 0, aligned=FRAMES)


def test_repeats_of_a_pose_stay_in_its_half() -> None:
    robot, fit = model()
    once = np.random.default_rng(5).uniform(LOW, HIGH, (6, 12))
    repeated = measured_at(robot, np.repeat(once, 10, axis=1))
    covered = coverage(robot, fit, repeated, 0, aligned=FRAMES, noise=(1e-5, 2e-5))
    # The bounds have the uncertainty of a joint's zero, ten times the noise of these poses.
    shares = [covered[name]["share"] for name in ("position", "orientation")]
    assert (shares, covered["registered"]) == ([1.0, 1.0], FRAMES)
