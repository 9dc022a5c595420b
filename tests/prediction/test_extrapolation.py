"""Uncertainty beyond the ranges of a fit, and the covariance of held-out residuals."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from arms import arm

from robacc.effects.base import Beyond
from robacc.geometry import log_between
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.modelling.validity import outside_validity
from robacc.prediction.covariances import outer_sums
from robacc.prediction.extrapolation import beyond_columns
from robacc.prediction.fit_record import _scatter
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


def poses(second: float, n: int = 5) -> Measurements:
    q = np.random.default_rng(3).uniform(-1, 1, (6, n))
    q[1] = second
    return Measurements(np.zeros((3, n)), q=q)


def test_no_pose_beyond_the_range_has_an_extrapolation() -> None:
    assert beyond_columns(Model.of(ripple()), poses(HIGH)).shape[1] == 0


def test_beyond_the_range_the_joint_is_uncertain_by_the_size_of_the_effect() -> None:
    robot = ripple()
    data = poses(HIGH + 0.5 * (HIGH - LOW))
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
    monkeypatch.setattr(effect, "traits", dataclasses.replace(effect.traits, is_bounded=periodic))
    if not periodic:
        monkeypatch.setattr(effect, "beyond", lambda *_: Beyond(is_held=True))
    sizes = []
    for share in (0.02, 0.05, 0.1, 0.9, 2.0):
        covariance = outer_sums(beyond_columns(model, poses(HIGH + share * (HIGH - LOW), 1)))
        reference = outer_sums(beyond_columns(model, poses(HIGH + 0.5 * (HIGH - LOW), 1)))
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
    near, far = poses(0.5), poses(0.5 + 2.0 * math.pi)
    assert beyond_columns(Model.of(robot), far).shape[1] == 0
    np.testing.assert_allclose(predict(robot, near).translation, predict(robot, far).translation, atol=1e-12)
    assert outside_validity(robot, far) is None or outside_validity(robot, far).n_poses == 0  # type: ignore[union-attr]
    # Between the ends, the effect keeps the value of the nearest end, a turn away or not.
    between = LOW + 2.0 * math.pi - 0.1
    first, second = predict(robot, poses(between)), predict(robot, poses(between - 2.0 * math.pi))
    np.testing.assert_allclose(first.translation, second.translation, atol=1e-12)


def test_a_gear_of_a_ratio_that_is_not_whole_repeats_nothing() -> None:
    assert beyond_columns(Model.of(geared(107.815)), poses(0.5 + 2.0 * math.pi)).any()


def test_a_gross_residual_does_not_widen_the_covariance() -> None:
    residual = np.random.default_rng(0).normal(size=(6, 500))
    spread = np.diag(_scatter(residual))
    # The variance of a variance of 500 values is 2/500.
    np.testing.assert_allclose(spread, np.mean(residual**2, axis=1), rtol=0.03)
    gross = residual.copy()
    gross[:3, 7] = 100.0
    np.testing.assert_allclose(np.diag(_scatter(gross)), spread, rtol=0.06)
