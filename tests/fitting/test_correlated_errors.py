"""Errors correlated in time: their likelihood against dense matrices, standard errors against simulated sets."""

from __future__ import annotations

import dataclasses
import re
from functools import cache

import numpy as np
import pytest
from arms import arm
from scipy.spatial.transform import Rotation

from robacc.api.calibrate import calibrate
from robacc.api.trace import trace
from robacc.effects.request import build, parse_requests
from robacc.fitting.correlated_errors import correlated_errors, with_correlated_errors
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.robots.arm import Arm

NOISE = 2e-5
DECLARED = "base_frame,tool_frame,joint_offset"


@cache
def path_of_poses(n: int = 50) -> tuple[np.ndarray, np.ndarray]:
    """Joints ``(J, n)`` on a path through their ranges, and positions ``(3, n)`` of the nominal arm."""
    robot = arm("puma560").robot
    remaining = list(np.random.default_rng(0).uniform(-1.5, 1.5, (n, len(robot.variables))))
    path = [remaining.pop()]
    while remaining:
        path.append(remaining.pop(int(np.argmin([np.abs(q - path[-1]).max() for q in remaining]))))
    q = np.array(path).T
    return q, predict(robot, Measurements(position=np.zeros((3, n)), q=q)).translation


def measured(rng: np.random.Generator, wander: float) -> Measurements:
    """Poses with independent noise, and with noise that wanders; unequal times."""
    q, position = path_of_poses()
    n = q.shape[1]
    time = np.cumsum(rng.uniform(20.0, 40.0, n))
    lag = np.abs(time[:, None] - time)
    root = np.linalg.cholesky(np.exp(-lag / 300.0) + 1e-12 * np.eye(n))
    error = NOISE * rng.standard_normal((3, n)) + wander * NOISE * rng.standard_normal((3, n)) @ root.T
    return Measurements(position=position + error, q=q, time=time)


def fitted(data: Measurements, priors: float | None = None) -> Fit:
    chosen = Arm.of(arm("puma560").robot)
    model = Model.of(chosen.robot, build(parse_requests(DECLARED), chosen, data))
    if priors is None:
        return fit(model, data)
    names = [term.name for effect in model.free for term in effect.terms(chosen, data)]
    stds = np.array([priors if name.startswith("joint_offset") else np.inf for name in names])
    return fit(model, data, Options(priors=stds))


@pytest.mark.parametrize("priors", [None, 3e-5])
def test_likelihood_and_covariance_are_those_of_dense_matrices(priors: float | None) -> None:
    data = measured(np.random.default_rng(1), 2.0)
    result = fitted(data, priors)
    errors = correlated_errors(result, data)
    assert errors is not None
    assert errors.in_seconds
    assert re.search(r"time constant about [\d.]+ (s|min)\)", errors.warning)
    columns = result.identifiability.columns
    _, jacobian = result.model.bind(data).linearise(result.theta, columns)
    scale = np.sqrt(np.diag(result.gram))
    design = np.moveaxis(jacobian[:3] * result.weight[:, None], 1, 2).reshape(-1, columns.size) / scale
    shrunk = np.where(result.precision > 0, result.theta[columns], 0) * scale
    y = (result.residual * result.weight).ravel() + design @ shrunk
    prior = np.diag(result.precision / scale**2)

    def likelihood(covariance: np.ndarray) -> tuple[float, float]:
        solved = np.linalg.solve(covariance, np.column_stack((design, y)))
        normal = design.T @ solved[:, :-1] + prior
        square = y @ solved[:, -1] - solved[:, -1] @ design @ np.linalg.solve(normal, design.T @ solved[:, -1])
        dof = y.size - np.count_nonzero(result.precision == 0)
        total = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(normal)[1] + dof * np.log(square / dof)
        return -0.5 * total, square / dof

    lag = np.abs(data.time[:, None] - data.time)
    wander = np.kron(np.eye(3), np.exp(-lag / errors.time_constant))
    covariance = (1 - errors.share) * np.eye(y.size) + errors.share * wander
    (best, c), (first, _) = likelihood(covariance), likelihood(np.eye(y.size))
    assert errors.gain == pytest.approx(2 * (best - first), rel=1e-6)
    # Weights of the last step of the fit may differ from those of the step before by a thousandth.
    np.testing.assert_allclose(design.T @ design, result.gram / np.outer(scale, scale), rtol=1e-2, atol=1e-2)
    inverse = np.linalg.inv(result.gram / np.outer(scale, scale) + prior)
    expected = inverse @ (c * design.T @ covariance @ design + prior) @ inverse / np.outer(scale, scale)
    np.testing.assert_allclose(errors.covariance, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    assert 0.4 < errors.share < 0.95


def test_intervals_hold_the_truth_where_errors_wander_and_where_not() -> None:
    """60 sets of joint zeros that are right in the robot file."""
    rng = np.random.default_rng(2)
    usual, corrected, chance = [], [], []
    for _ in range(60):
        data = measured(rng, 3.0)
        result = fitted(data)
        errors = correlated_errors(result, data)
        assert errors is not None
        for answer, inside in ((result, usual), (with_correlated_errors(result, errors), corrected)):
            zeros = [i for i in answer.identifiability.columns if answer.names[i].startswith("joint_offset")]
            inside.extend(np.abs(answer.theta[zeros]) < 1.96 * np.sqrt(np.diag(answer.covariance)[zeros]))
        white = measured(rng, 0.0)
        chance.append(correlated_errors(fitted(white), white) is not None)
    assert np.mean(usual) < 0.88
    assert 0.92 <= np.mean(corrected) <= 0.98
    assert sum(chance) <= 2


def test_position_wanders_beside_orientations_that_do_not() -> None:
    """Orientations add to what is known of the joints: standard errors widen, less than with positions alone."""
    rng = np.random.default_rng(7)
    data = measured(rng, 3.0)
    rotation = predict(arm("puma560").robot, data).rotation
    noise = Rotation.from_rotvec(2e-5 * rng.standard_normal((data.n, 3))).as_matrix()
    data = dataclasses.replace(data, rotation=np.einsum("nij,jkn->ikn", noise, rotation))
    result = fitted(data)
    errors = correlated_errors(result, data)
    assert errors is not None
    assert 0.7 < errors.share < 0.97
    columns = result.identifiability.columns
    wider = np.sqrt(np.diag(with_correlated_errors(result, errors).covariance) / np.diag(result.covariance))[columns]
    assert wider.min() >= 1.0 - 1e-12  # the root of a ratio of equal variances, rounded
    assert wider.max() > 1.5
    white = measured(np.random.default_rng(8), 0.0)
    white = dataclasses.replace(white, rotation=np.einsum("nij,jkn->ikn", noise, rotation))
    assert correlated_errors(fitted(white), white) is None


def test_rows_of_a_visit_share_the_wander() -> None:
    rng = np.random.default_rng(3)
    data = measured(rng, 3.0)
    rows = np.repeat(np.arange(data.n), 3)
    offset = 3 * NOISE * rng.standard_normal((3, rows.size))
    repeated = dataclasses.replace(
        data.subset(rows), position=data.position[:, rows] + offset, visit=np.char.mod("v%d", rows)
    )
    errors, single = correlated_errors(fitted(repeated), repeated), correlated_errors(fitted(data), data)
    assert errors is not None
    assert single is not None
    ratio = np.sqrt(np.diag(errors.covariance) / np.diag(single.covariance))
    assert np.all((ratio > 0.6) & (ratio < 1.7))


def test_rows_may_come_in_any_order() -> None:
    data = measured(np.random.default_rng(4), 2.0)
    mixed = data.subset(np.random.default_rng(5).permutation(data.n))
    first, second = correlated_errors(fitted(data), data), correlated_errors(fitted(mixed), mixed)
    assert first is not None
    assert second is not None
    assert second.gain == pytest.approx(first.gain, rel=1e-6)
    np.testing.assert_allclose(second.covariance, first.covariance, rtol=1e-5, atol=1e-9 * first.covariance.max())


def test_calibrate_and_trace_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    import robacc.fitting.error_structure

    data, robot = measured(np.random.default_rng(6), 3.0), arm("puma560").robot
    traced = trace(data, robot=robot, declared=DECLARED)
    calibrated = calibrate(data, robot=robot, fit=DECLARED)
    for result in (traced, calibrated):
        assert sum("the remaining errors are correlated in time" in text for text in result.warnings) == 1
    monkeypatch.setattr(robacc.fitting.error_structure, "correlated_errors", lambda *_: None)
    without = calibrate(data, robot=robot, fit=DECLARED)
    wider = [a.std / b.std for a, b in zip(calibrated.parameters, without.parameters, strict=True) if a.std and b.std]
    assert min(wider) >= 1.0 - 1e-9
    assert max(wider) > 1.3
