"""Profiles beyond their ranges: they fade to their level there, and their variance grows to that of the prior."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

from robacc.effects.transmission_error import TransmissionError
from robacc.geometry import log_between
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.modelling.validity import outside_validity
from robacc.prediction.model_fit import ModelFit
from robacc.prediction.model_uncertainty import model_uncertainty
from robacc.robots.description import Robot

ORDERS = tuple(float(order) for order in range(1, 21))
LOW, HIGH = -1.0, 0.6
STD, NOISE = 3e-5, 2e-5
"""rad: prior of each coefficient, and noise of a measured angle."""


def basis(angle: np.ndarray) -> np.ndarray:
    """Cosine and sine ``(n, 2 Q)`` of each order, in the order of the effect's coefficients."""
    phase = np.multiply.outer(angle, ORDERS)
    return np.stack((np.cos(phase), np.sin(phase)), axis=-1).reshape(len(angle), -1)


PERIOD = 2.0 * np.pi / ORDERS[-1]
"""Of the finest order, rad."""


def left(angle: np.ndarray) -> np.ndarray:
    """Regressors ``(n, 2 Q)`` that are left of a profile: beyond the range, their mean over one period at its end."""
    image = angle - 2.0 * np.pi * np.round((angle - 0.5 * (LOW + HIGH)) / (2.0 * np.pi))
    beyond = np.maximum(np.maximum(LOW - image, image - HIGH), 0.0)
    share = np.exp(-0.5 * np.square(beyond / (PERIOD / 4.0)))[:, None]
    inside = PERIOD * (np.arange(4000) + 0.5) / 4000
    at_low, at_high = basis(LOW + inside).mean(axis=0), basis(HIGH - inside).mean(axis=0)
    of_other = (beyond / (2.0 * np.pi - (HIGH - LOW)))[:, None]
    of_low = np.where(image[:, None] < LOW, 1.0 - of_other, of_other)
    return np.asarray(share * basis(angle) + (1.0 - share) * (of_low * at_low + (1.0 - of_low) * at_high))


def posterior(angle: np.ndarray) -> np.ndarray:
    """Covariance of the coefficients from measured angles."""
    design = basis(angle)
    return np.linalg.inv(design.T @ design / NOISE**2 + np.eye(design.shape[1]) / STD**2)


def names() -> list[str]:
    return [f"{kind}{order:g}" for order in ORDERS for kind in ("cos", "sin")]


def fitted(values: np.ndarray, covariance: np.ndarray) -> tuple[Robot, ModelFit]:
    """A Puma with a fitted profile of its second joint, and the record of the fit."""
    effect = TransmissionError(("j2",), ORDERS, True)
    entry = {
        "effect": effect.name,
        "joints": ["j2"],
        "orders": list(ORDERS),
        "shrunk": True,
        "values": {f"j2.{name}": float(value) for name, value in zip(names(), values, strict=True)},
        "validity": {"j2": [LOW, HIGH]},
    }
    record = ModelFit(
        effects=(effect,),
        coefficients=tuple(f"{effect.name}.j2.{name}" for name in names()),
        covariance=covariance,
        nominal={},
        repeatability={},
        unexplained=np.zeros((6, 6)),
        noise=(0.0, 0.0),
        noise_is_separate=False,
        bound_factor=(1.0, 1.0),
        largest_correction=(1e-3, 1e-3),
        ranges={"j2": (LOW, HIGH)},
        n_poses=100,
    )
    robot = arm("puma560").robot
    joints = tuple(dataclasses.replace(joint, gear_ratio=100.0) for joint in robot.joints)
    return dataclasses.replace(robot, joints=joints, effects=(entry,)), record


def poses(second: np.ndarray) -> Measurements:
    q = np.random.default_rng(3).uniform(-1, 1, (6, len(second)))
    q[1] = second
    return Measurements(np.zeros((3, len(second))), q=q)


def joint_variance(second: np.ndarray, covariance: np.ndarray, values: np.ndarray | None = None) -> np.ndarray:
    """Variance of the second joint's error that the library states, from that of the orientation (a turn of 1)."""
    robot, record = fitted(np.zeros(covariance.shape[0]) if values is None else values, covariance)
    uncertainty = model_uncertainty(robot, record, poses(second), measured=True)
    return np.einsum("iin->n", uncertainty.orientation)


TRAINED = np.random.default_rng(1).uniform(LOW, HIGH, 150)
PLACES = np.array([-1.9, -1.1, LOW, -0.3, HIGH, 0.65, 0.8, 1.4, 0.2 + 2 * np.pi])


def test_the_variance_is_that_of_the_posterior_and_of_what_fades() -> None:
    covariance, values = posterior(TRAINED), STD * np.random.default_rng(5).normal(size=2 * len(ORDERS))
    here = basis(PLACES)
    expected = np.einsum("np,pq,nq->n", here, covariance, here)
    np.testing.assert_allclose(joint_variance(PLACES, covariance), expected, rtol=1e-9)
    expected += np.square((here - left(PLACES)) @ values)
    # The level is a mean over 32 places: of the order that changes most there it is 1e-4 of its size off.
    np.testing.assert_allclose(joint_variance(PLACES, covariance, values), expected, rtol=1e-3)
    # Far from the range the posterior is the prior, of all orders.
    prior = len(ORDERS) * STD**2
    assert joint_variance(PLACES, covariance)[0] == pytest.approx(prior, rel=0.1)
    assert expected[3] < 0.05 * prior


def test_errors_of_profiles_of_the_prior_have_the_posterior_variance() -> None:
    random = np.random.default_rng(8)
    design, covariance, n = basis(TRAINED), posterior(TRAINED), 4000
    truth = STD * random.normal(size=(n, design.shape[1]))
    measured = truth @ design.T + NOISE * random.normal(size=(n, len(TRAINED)))
    estimate = measured @ design @ covariance / NOISE**2
    error = (estimate - truth) @ basis(PLACES).T
    # The variance of a variance of 4,000 values is 2/4,000: five standard deviations are 11 %.
    np.testing.assert_allclose(np.mean(error**2, axis=0), joint_variance(PLACES, covariance), rtol=0.11)


@pytest.mark.parametrize("beyond", [0.0, 0.02, 0.1, 0.5])
def test_the_profile_fades_to_its_level_within_a_quarter_of_its_finest_period(beyond: float) -> None:
    values = STD * np.random.default_rng(2).normal(size=2 * len(ORDERS))
    robot, _ = fitted(values, posterior(TRAINED))
    angle = np.array([LOW - beyond])
    data = poses(angle)
    still = dataclasses.replace(robot, effects=())
    turned = np.linalg.norm(log_between(predict(robot, data).rotation, predict(still, data).rotation))
    expected = abs(float((left(angle) @ values)[0]))
    assert turned == pytest.approx(expected, rel=1e-3)
    outside = outside_validity(robot, data)
    assert outside is not None
    assert (outside.std_max > 0.0) is (beyond > 0.016)
    assert all(not item.is_held for item in outside.ranges)


def test_the_level_passes_from_end_to_end_without_a_jump() -> None:
    values = STD * np.random.default_rng(2).normal(size=2 * len(ORDERS))
    robot, _ = fitted(values, posterior(TRAINED))
    opposite = 0.5 * (LOW + HIGH) + np.pi
    data = poses(np.array([opposite - 1e-6, opposite + 1e-6]))
    still = dataclasses.replace(robot, effects=())
    below, above = np.linalg.norm(log_between(predict(robot, data).rotation, predict(still, data).rotation), axis=0)
    ends = np.abs(left(np.array([LOW - 0.5 * PERIOD, HIGH + 0.5 * PERIOD])) @ values)
    assert abs(ends[0] - ends[1]) > 1e-5
    assert below == pytest.approx(above, abs=1e-8)


@pytest.mark.parametrize("slope", [0.0, 0.5])
def test_bounds_hold_for_profiles_that_fade(slope: float) -> None:
    """Whether all orders are as large as each other, as the prior says, or low ones larger, as on real gears."""
    random = np.random.default_rng(9)
    design, covariance, n = basis(TRAINED), posterior(TRAINED), 300
    sizes = np.repeat(np.array(ORDERS) ** -slope, 2)
    held = np.zeros(len(PLACES))
    for _ in range(n):
        truth = STD * sizes / np.sqrt(np.mean(sizes**2)) * random.normal(size=sizes.size)
        measured = design @ truth + NOISE * random.normal(size=len(TRAINED))
        estimate = covariance @ design.T @ measured / NOISE**2
        error = left(PLACES) @ estimate - basis(PLACES) @ truth
        held += np.abs(error) < 1.96 * np.sqrt(joint_variance(PLACES, covariance, estimate))
    # Three standard errors of 95 % of 300 are 3.8 %.
    assert (held / n).min() > 0.91
    assert 0.935 < (held / n).mean() < 0.985


def test_a_gear_that_does_not_repeat_itself_is_held() -> None:
    robot, _ = fitted(np.ones(2 * len(ORDERS)) * STD, posterior(TRAINED))
    geared = tuple(dataclasses.replace(j, gear_ratio=107.8) if j.name == "j2" else j for j in robot.joints)
    robot = dataclasses.replace(robot, joints=geared)
    first, second = (predict(robot, dataclasses.replace(poses(np.array([angle])))) for angle in (HIGH, HIGH + 0.5))
    angle = basis(np.array([HIGH])) @ (np.ones(2 * len(ORDERS)) * STD)
    still = dataclasses.replace(robot, effects=())
    for pose, place in ((first, HIGH), (second, HIGH + 0.5)):
        turned = np.linalg.norm(log_between(pose.rotation, predict(still, poses(np.array([place]))).rotation))
        assert turned == pytest.approx(abs(float(angle[0])), rel=1e-6)
