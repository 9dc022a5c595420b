"""Poses that lie close together are held out together; random poses, sweeps and repetitions by id are as before."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from robacc.fitting.cross_validation import folds
from robacc.fitting.places import places, places_warning
from robacc.measurements import Measurements


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
    assigned = folds(data, 5, 0)
    assert assigned is not None
    assert all(len(set(assigned[truth == k])) == 1 for k in range(25))
    (warning,) = places_warning(data)
    assert warning.startswith("poses.csv: 100 poses lie in 25 places")


def test_random_poses_are_places_of_their_own() -> None:
    data = poses(random_poses(2000))
    assert np.array_equal(places(data), data.groups())
    assert places_warning(data) == ()


def test_repetitions_of_equal_joints_stay_as_they_are() -> None:
    data = poses(np.repeat(random_poses(12), 5, axis=1))
    assert np.array_equal(places(data), data.groups())
    assert places_warning(data) == ()


def test_a_sweep_of_one_joint_is_no_place() -> None:
    q = random_poses(1).repeat(200, axis=1)
    q[2] = np.linspace(-1.5, 1.5, 200)
    assert places_warning(poses(q)) == ()


def test_poses_in_few_places_are_held_out_one_by_one() -> None:
    # Of four places, five folds would leave no pose to fit.
    q = np.repeat(random_poses(4), 20, axis=1) + np.random.default_rng(2).normal(scale=0.01, size=(6, 80))
    data = poses(q)
    assert np.array_equal(places(data), data.groups())


def test_the_order_of_rows_and_the_unit_do_not_matter() -> None:
    rng = np.random.default_rng(3)
    q = np.repeat(random_poses(15), 3, axis=1) + rng.normal(scale=0.02, size=(6, 45))
    order = rng.permutation(45)
    first, second = places(poses(q)), places(poses(q[:, order] * np.array([1, 1, 1, 1, 1, 1000.0])[:, None]))
    same = first[:, None] == first
    assert np.array_equal(second[:, None] == second, same[np.ix_(order, order)])


def test_a_pose_column_joins_what_lies_close() -> None:
    q = np.repeat(random_poses(20), 2, axis=1)
    data = dataclasses.replace(poses(q), pose=np.repeat(np.arange(20).astype(str), 2))
    assert len(set(places(data))) == 20
