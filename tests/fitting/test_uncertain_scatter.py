"""Standard errors that allow for estimated scatter: against dense matrices, and by simulation."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm
from scipy import stats

from robacc.effects.request import build, parse_requests
from robacc.fitting.fit_repeatability import mixed_model
from robacc.fitting.fit_result import Options
from robacc.fitting.repeatability import MOST_ROWS, estimate
from robacc.fitting.restricted_likelihood import MixedModel, RestrictedLikelihood, Variances
from robacc.fitting.solver import fit
from robacc.fitting.uncertain_scatter import interval_factors, with_uncertain_scatter
from robacc.fitting.whitening import Scatter
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.robots.arm import Arm

POSES, CYCLES, JOINTS, COEFFICIENTS = 9, 6, 3, 10
NOISE, VISIT_STD, POSE_STD = 0.5, 0.2, 1.0


def sample(rng: np.random.Generator, targets: int = 1) -> MixedModel:
    """Rows whose coefficients are zero: the Jacobians of a pose are those of all its visits, as on an arm."""
    n = POSES * CYCLES * targets
    pose, visit = np.repeat(np.arange(POSES), CYCLES * targets), np.repeat(np.arange(POSES * CYCLES), targets)

    def at_poses(count: int) -> np.ndarray:
        return np.repeat(rng.normal(size=(3, count, POSES, 1, targets)), CYCLES, axis=3).reshape(3, count, n)

    columns, design = at_poses(JOINTS), at_poses(COEFFICIENTS)
    errors = POSE_STD * rng.normal(size=(JOINTS, POSES))[:, pose]
    errors += VISIT_STD * rng.normal(size=(JOINTS, POSES * CYCLES))[:, visit]
    residual = np.einsum("mjn,jn->mn", columns, errors) + NOISE * rng.normal(size=(3, n))
    return MixedModel(residual, design, np.zeros(COEFFICIENTS), columns, np.zeros((3, n)), visit, pose)


@pytest.mark.parametrize("pose_std", [POSE_STD, 0.0])
def test_factors_equal_those_of_dense_matrices(pose_std: float) -> None:
    model = sample(np.random.default_rng(1), targets=2)
    scatter = Scatter(np.full(JOINTS, VISIT_STD), pose_std * np.array([1.0, 0.0, 2.0]))
    numbers = np.tile(model.poses if pose_std else model.visits, 3)
    columns = np.moveaxis(model.columns, 1, 0).reshape(JOINTS, -1)
    shared = [np.outer(b, b) * (numbers[:, None] == numbers) for b in columns]
    covariance = NOISE**2 * np.eye(numbers.size)
    for group, stds in ((model.visits, scatter.visit_std), (model.poses, scatter.pose_std)):
        same = np.equal.outer(np.tile(group, 3), np.tile(group, 3))
        covariance += sum(std**2 * np.outer(b, b) * same for std, b in zip(stds, columns, strict=True))
    inverse = np.linalg.inv(covariance)
    design = np.moveaxis(model.design, 1, 0).reshape(COEFFICIENTS, -1).T
    phi = np.linalg.inv(design.T @ inverse @ design)
    gain = phi @ design.T @ inverse
    projected = inverse - inverse @ design @ gain
    information = [[0.5 * np.trace(projected @ v @ projected @ w) for w in shared] for v in shared]
    weight = np.linalg.inv(information)
    growth = sum(
        2.0 * weight[i, j] * np.diag(gain @ shared[i] @ projected @ shared[j] @ gain.T)
        for i in range(JOINTS)
        for j in range(JOINTS)
    )
    slopes = np.array([np.diag(gain @ v @ gain.T) for v in shared])
    dof = 2.0 * np.diag(phi) ** 2 / np.einsum("ik,ij,jk->k", slopes, weight, slopes)
    wanted = np.sqrt(1.0 + growth / np.diag(phi)) * stats.t.ppf(0.975, np.floor(dof)) / stats.norm.ppf(0.975)
    factors = interval_factors(model, Variances(scatter, (NOISE, NOISE)))
    np.testing.assert_allclose(factors, wanted, rtol=1e-7)
    assert np.all(factors > 1.0)


def test_intervals_hold_the_truth_where_few_poses_have_errors_of_their_own() -> None:
    rng, scores, factors = np.random.default_rng(2), [], []
    for _ in range(100):
        model = sample(rng)
        found = estimate(model)
        variances = Variances(found.scatter, found.noise)
        solution = RestrictedLikelihood.at(model, variances)
        theta = solution.covariance @ np.einsum("mkn,mn->k", solution.solved, model.residual)
        scores.append(np.abs(theta) / np.sqrt(np.diag(solution.covariance)))
        factors.append(interval_factors(model, variances))
    assert np.mean(np.array(scores) < 1.96) < 0.88
    assert 0.92 < np.mean(np.array(scores) < 1.96 * np.array(factors)) < 0.97


def repeated(n_poses: int, visits: int) -> tuple[Model, Measurements]:
    """Return visits of poses whose joints are off by 0.1 mrad at a pose and 0.01 mrad at a visit."""
    robot, rng = dataclasses.replace(arm("puma560").robot, effects=()), np.random.default_rng(3)
    pose = np.repeat(np.arange(n_poses), visits)
    q = rng.uniform(-1.5, 1.5, (6, n_poses))[:, pose]
    attained = q + 1e-4 * rng.standard_normal((6, n_poses))[:, pose] + 1e-5 * rng.standard_normal(q.shape)
    blank = Measurements(position=np.zeros((3, pose.size)), q=attained, pose=pose.astype(str))
    position = predict(robot, blank).translation + 1e-5 * rng.standard_normal((3, pose.size))
    data = dataclasses.replace(blank, q=q, position=position)
    return Model.of(robot, build(parse_requests("base_frame,joint_offset"), Arm.of(robot), data)), data


def test_scatter_is_estimated_from_all_poses_where_they_are_few() -> None:
    model, data = repeated(n_poses=20, visits=100)
    _, part = mixed_model(fit(model, data), data)
    assert 0.9 * MOST_ROWS < part.poses.size <= MOST_ROWS
    assert np.unique(part.poses).size == 20
    assert np.ptp(np.bincount(part.poses)[np.unique(part.poses)]) == 0


def test_many_poses_keep_visits_that_show_their_scatter() -> None:
    model, data = repeated(n_poses=500, visits=6)
    _, part = mixed_model(fit(model, data), data)
    assert 0.9 * MOST_ROWS < part.poses.size <= MOST_ROWS
    assert set(np.unique(part.poses, return_counts=True)[1].tolist()) == {3}


def test_standard_errors_grow_and_correlations_and_estimates_stay() -> None:
    model, data = repeated(n_poses=30, visits=3)
    plain = fit(model, data)
    assert with_uncertain_scatter(plain, data) is plain
    scatter = Scatter(np.full(6, 1e-5), np.full(6, 1e-4))
    weighted = fit(model, data, Options(scatter=scatter, misfit=(1e-5, 0.0)))
    wider = with_uncertain_scatter(weighted, data)
    columns = np.ix_(weighted.identifiability.columns, weighted.identifiability.columns)
    before, after = weighted.covariance[columns], wider.covariance[columns]
    factor = np.sqrt(np.diag(after) / np.diag(before))
    assert np.all((factor > 1.02) & (factor < 2.0))
    np.testing.assert_allclose(after, before * factor[:, None] * factor, rtol=1e-12)
    np.testing.assert_array_equal(wider.theta, weighted.theta)
