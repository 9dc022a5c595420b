"""Uncertainty beyond the ranges of a fit, profiles that fade there, and the covariance of held-out residuals."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from arms import arm

from robacc.effects.base import Beyond
from robacc.effects.periodic import TransmissionError
from robacc.geometry import log_between
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.modelling.validity import outside_validity
from robacc.prediction.model_uncertainty import ModelFit, beyond_columns, model_uncertainty
from robacc.prediction.predicting import outer_sums
from robacc.robots.description import Robot

COS, SIN = 2e-4, -1e-4
LOW, HIGH = -1.0, 0.6


def ripple() -> Robot:
    """An arm with a periodic error of its second joint, fitted between LOW and HIGH."""
    entry = {
        "effect": "transmission_error",
        "joints": ["j2"],
        "orders": [2.0],
        "values": {"j2.cos2": COS, "j2.sin2": SIN},
        "validity": {"j2": [LOW, HIGH]},
    }
    return dataclasses.replace(arm("puma560").robot, effects=(entry,))


def geared(ratio: float) -> Robot:
    """The arm with a periodic error of several orders, and a gear ratio of its second joint."""
    robot = ripple()
    joints = tuple(dataclasses.replace(j, gear_ratio=ratio) if j.name == "j2" else j for j in robot.joints)
    return dataclasses.replace(robot, joints=joints, effects=({**robot.effects[0], "orders": [2.0, 5.0]},))


def poses_at(second: np.ndarray | float, n: int = 5) -> Measurements:
    """Poses with these variables of the second joint."""
    q = np.random.default_rng(3).uniform(-1, 1, (6, np.size(second) if np.ndim(second) else n))
    q[1] = second
    return Measurements(np.zeros((3, q.shape[1])), q=q)


def test_no_pose_beyond_the_range_has_an_extrapolation() -> None:
    assert beyond_columns(Model.of(ripple()), poses_at(HIGH)).shape[1] == 0


def test_beyond_the_range_the_joint_is_uncertain_by_the_size_of_the_effect() -> None:
    robot = ripple()
    data = poses_at(HIGH + 0.5 * (HIGH - LOW))
    covariance = outer_sums(beyond_columns(Model.of(robot), data))
    step = 1e-6
    moved = dataclasses.replace(data, q=data.q + step * np.eye(6)[1][:, None])
    still = dataclasses.replace(robot, effects=())
    first, second = predict(still, data), predict(still, moved)
    slope = np.vstack(
        ((second.translation - first.translation) / step, log_between(second.rotation, first.rotation) / step)
    )
    angles = np.linspace(LOW, HIGH, 2001)
    square = np.mean((COS * np.cos(2 * angles) + SIN * np.sin(2 * angles)) ** 2)
    expected = 2.0 * square * np.einsum("in,jn->ijn", slope, slope)
    # 200 samples of the range against 2,001, and the ripple itself changes the slope by 1e-4.
    np.testing.assert_allclose(covariance, expected, rtol=2e-2, atol=1e-3 * float(np.abs(expected).max()))


@pytest.mark.parametrize("periodic", [True, False])
def test_the_uncertainty_grows_with_the_distance(periodic: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    model = Model.of(ripple())
    effect = type(model.known[0].effect)
    monkeypatch.setattr(effect, "traits", effect.traits._replace(is_bounded=periodic))
    if not periodic:
        monkeypatch.setattr(effect, "beyond", lambda *_: Beyond(is_held=True))
    sizes = []
    for share in (0.02, 0.05, 0.1, 0.9, 2.0):
        covariance = outer_sums(beyond_columns(model, poses_at(HIGH + share * (HIGH - LOW), 1)))
        reference = outer_sums(beyond_columns(model, poses_at(HIGH + 0.5 * (HIGH - LOW), 1)))
        sizes.append(float(np.trace(covariance[3:, 3:, 0])) / float(np.trace(reference[3:, 3:, 0])))
    expected = [0.04, 0.25, 1.0, 1.0, 4.0]
    if periodic:
        # Order 2 repeats after half a turn: 0.9 of the range is just before the next lower end, twice the range just
        # behind the next upper end.
        reach = HIGH - LOW
        beyond = (math.pi - 1.9 * reach, 3.0 * reach - reach - math.pi)
        expected[3:] = [(10.0 * excess / reach) ** 2 for excess in beyond]
    assert sizes == pytest.approx(expected, rel=1e-6)


def test_a_pose_whole_turns_away_is_where_the_gear_was() -> None:
    robot = geared(100.0)
    near, far = poses_at(0.5), poses_at(0.5 + 2.0 * math.pi)
    assert beyond_columns(Model.of(robot), far).shape[1] == 0
    np.testing.assert_allclose(predict(robot, near).translation, predict(robot, far).translation, atol=1e-12)
    assert outside_validity(robot, far) is None or outside_validity(robot, far).n_poses == 0  # type: ignore[union-attr]
    # Between the ends, the effect keeps the value of the nearest end, a turn away or not.
    between = LOW + 2.0 * math.pi - 0.1
    first, second = predict(robot, poses_at(between)), predict(robot, poses_at(between - 2.0 * math.pi))
    np.testing.assert_allclose(first.translation, second.translation, atol=1e-12)


def test_a_gear_of_a_ratio_that_is_not_whole_repeats_nothing() -> None:
    assert beyond_columns(Model.of(geared(107.815)), poses_at(0.5 + 2.0 * math.pi)).any()


ORDERS = tuple(float(order) for order in range(1, 21))
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


def joint_variance(second: np.ndarray, covariance: np.ndarray, values: np.ndarray | None = None) -> np.ndarray:
    """Variance of the second joint's error that the library states, from that of the orientation (a turn of 1)."""
    robot, record = fitted(np.zeros(covariance.shape[0]) if values is None else values, covariance)
    (_, orientation), _, _ = model_uncertainty(robot, record, poses_at(second), measured=True)
    return np.einsum("iin->n", orientation)


TRAINED = np.random.default_rng(1).uniform(LOW, HIGH, 150)
PLACES = np.array([-1.9, -1.1, LOW, -0.3, HIGH, 0.65, 0.8, 1.4, 0.2 + 2 * np.pi])


HERE, FADED = basis(PLACES), basis(PLACES) - left(PLACES)


def written_out(covariance: np.ndarray, values: np.ndarray) -> np.ndarray:
    """As :func:`joint_variance`: of the posterior, and the square of what fades."""
    return np.asarray(np.einsum("np,pq,nq->n", HERE, covariance, HERE) + np.square(FADED @ values))


def test_the_variance_is_that_of_the_posterior_and_of_what_fades() -> None:
    covariance, values = posterior(TRAINED), STD * np.random.default_rng(5).normal(size=2 * len(ORDERS))
    np.testing.assert_allclose(joint_variance(PLACES, covariance), written_out(covariance, 0.0 * values), rtol=1e-9)
    expected = written_out(covariance, values)
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


def turned_by(robot: Robot, second: np.ndarray) -> np.ndarray:
    """Angles ``(N,)`` by which the effects turn the target."""
    data = poses_at(second)
    still = dataclasses.replace(robot, effects=())
    return np.linalg.norm(log_between(predict(robot, data).rotation, predict(still, data).rotation), axis=0)


@pytest.mark.parametrize("beyond", [0.0, 0.02, 0.1, 0.5])
def test_the_profile_fades_to_its_level_within_a_quarter_of_its_finest_period(beyond: float) -> None:
    values = STD * np.random.default_rng(2).normal(size=2 * len(ORDERS))
    robot, _ = fitted(values, posterior(TRAINED))
    angle = np.array([LOW - beyond])
    assert turned_by(robot, angle) == pytest.approx(np.abs(left(angle) @ values), rel=1e-3)
    outside = outside_validity(robot, poses_at(angle))
    assert (outside.std_max > 0.0) is (beyond > 0.016)
    assert all(item["rule"] != "held" for item in outside.ranges)


def test_a_gear_that_does_not_repeat_itself_is_held() -> None:
    values = STD * np.ones(2 * len(ORDERS))
    robot, _ = fitted(values, posterior(TRAINED))
    joints = tuple(dataclasses.replace(j, gear_ratio=107.8) if j.name == "j2" else j for j in robot.joints)
    robot = dataclasses.replace(robot, joints=joints)
    at_the_end = abs(float((basis(np.array([HIGH])) @ values)[0]))
    assert turned_by(robot, np.array([HIGH, HIGH + 0.5])) == pytest.approx(at_the_end, rel=1e-6)
