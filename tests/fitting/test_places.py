"""Poses that lie close together are held out together; random poses, sweeps and repetitions by id are as before."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from arms import arm

from robacc.effects.specification import build, parse_requests
from robacc.error_model.structure import with_error_structure
from robacc.fitting.fit_result import HoldOut, Options
from robacc.fitting.solver import fit
from robacc.fitting.visits import places, places_warning
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.robots.arm import Arm


def poses(q: np.ndarray) -> Measurements:
    return Measurements(position=np.zeros((3, q.shape[1])), q=q, rows=np.arange(2, q.shape[1] + 2), source="poses.csv")


def random_poses(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-2.5, 2.5, (6, count))


@pytest.mark.parametrize("jitter", [1e-6, 1e-4, 0.03])
def test_repetitions_with_measured_joints_are_one_place(jitter: float) -> None:
    rng = np.random.default_rng(1)
    q = np.repeat(random_poses(25), 4, axis=1) + rng.normal(scale=jitter, size=(6, 100))
    order = rng.permutation(100)
    data = poses(q[:, order])
    truth = np.repeat(np.arange(25), 4)[order]
    place = places(data)
    assert [len(set(place[truth == k])) for k in range(25)] == [1] * 25
    assert len(set(place)) == 25
    assigned = HoldOut.of(data, None, 5, 0).groups
    assert all(len(set(assigned[truth == k])) == 1 for k in range(25))
    (warning,) = places_warning(data)
    assert warning.startswith("poses.csv: 100 poses lie in 25 places")


SWEEP = random_poses(1).repeat(200, axis=1)
SWEEP[2] = np.linspace(-1.5, 1.5, 200)


@pytest.mark.parametrize(
    "q",
    [
        random_poses(2000),
        np.repeat(random_poses(12), 5, axis=1),
        SWEEP,
        # Of four places, five folds would leave no pose to fit.
        np.repeat(random_poses(4), 20, axis=1) + np.random.default_rng(2).normal(scale=0.01, size=(6, 80)),
    ],
    ids=["random", "repetitions of equal joints", "a sweep of one joint", "few places"],
)
def test_poses_that_do_not_lie_in_places_are_held_out_as_their_joints_say(q: np.ndarray) -> None:
    data = poses(q)
    assert np.array_equal(places(data), data.groups())
    assert places_warning(data) == ()


def test_the_order_of_rows_and_the_unit_do_not_matter() -> None:
    rng = np.random.default_rng(3)
    q = np.repeat(random_poses(15), 3, axis=1) + rng.normal(scale=0.02, size=(6, 45))
    order = rng.permutation(45)
    first, second = places(poses(q)), places(poses(q[:, order] * np.array([1, 1, 1, 1, 1, 1000.0])[:, None]))
    same = first[:, None] == first
    assert np.array_equal(second[:, None] == second, same[np.ix_(order, order)])


def test_errors_that_poses_of_a_place_share_widen_the_intervals() -> None:
    """16 groups of six poses, joints wrong by 50 urad in each: joint zeros are right within their standard errors."""
    robot, rng = arm("puma560").robot, np.random.default_rng(4)
    model_arm = Arm.of(robot)
    scores: dict[bool, list[float]] = {True: [], False: []}
    for _ in range(12):
        q = np.repeat(rng.uniform(-1.5, 1.5, (6, 16)), 6, axis=1) + rng.normal(scale=0.02, size=(6, 96))
        arrived = q + np.repeat(rng.normal(scale=5e-5, size=(6, 16)), 6, axis=1)
        exact = predict(robot, poses(arrived)).translation
        data = dataclasses.replace(poses(q), position=exact + rng.normal(scale=1e-5, size=exact.shape))
        model = Model.of(robot, build(parse_requests("base_frame,tool_frame,joint_offset"), model_arm, data))
        plain = fit(model, data)
        allowed = with_error_structure(plain, data, Options(), functools.partial(fit, model, data)).fit
        for shared, answer in ((False, plain), (True, allowed)):
            zeros = [i for i in answer.identifiability.columns if answer.names[i].startswith("joint_offset")]
            scores[shared].extend(answer.theta[zeros] / np.sqrt(np.diag(answer.covariance)[zeros]))
    # Of 48 scores, the root mean square of standard Gaussians lies between 0.8 and 1.2 with 95 % probability.
    assert np.sqrt(np.mean(np.square(scores[False]))) > 2.0
    assert 0.7 < np.sqrt(np.mean(np.square(scores[True]))) < 1.4
