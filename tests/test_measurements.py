"""Which rows are of one commanded pose."""

from __future__ import annotations

import numpy as np
import pytest

from robacc.measurements import Measurements

N = 40_000
"""More than are hashed at a time."""


def measured(**columns: np.ndarray) -> Measurements:
    n = next(iter(columns.values())).shape[-1]
    return Measurements(position=np.zeros((3, n)), **columns)


@pytest.mark.parametrize("column", ["q", "commanded_position"])
def test_poses_of_their_own_have_no_repetitions(column: str) -> None:
    assert measured(**{column: np.random.default_rng(1).normal(size=(3, N))}).repetitions() is None


@pytest.mark.parametrize(("first", "second"), [(0, 1), (0, N - 1), (17_000, 39_000)])
def test_one_pose_measured_twice_is_found_wherever_its_rows_are(first: int, second: int) -> None:
    q = np.random.default_rng(2).normal(size=(6, N))
    q[:, second] = q[:, first] + 1e-12
    groups = measured(q=q).repetitions()
    assert groups is not None
    assert np.unique(groups).size == N - 1
    assert groups[first] == groups[second]


def test_repetitions_are_those_of_sorting_whole_columns() -> None:
    q = np.random.default_rng(3).integers(-2, 3, size=(3, N)) * 0.25
    q[q == 0.0] *= np.random.default_rng(4).choice([-1.0, 1.0], size=np.count_nonzero(q == 0.0))  # -0.0 is 0.0 too
    data = measured(q=q)
    groups = data.repetitions()
    assert groups is not None
    np.testing.assert_array_equal(groups, data.groups())
    expected = np.unique(q + 0.0, axis=1, return_inverse=True)[1].ravel()
    pairs = np.unique(np.stack((groups, expected)), axis=1)
    assert pairs.shape[1] == np.unique(expected).size == np.unique(groups).size == 125


def test_the_pose_column_goes_first() -> None:
    same = np.zeros((6, 4))
    assert measured(q=same, pose=np.array(["a", "b", "c", "d"])).repetitions() is None
    found = measured(q=same, pose=np.array(["a", "b", "a", "d"])).repetitions()
    assert found is not None
    assert found.tolist() == [0, 1, 0, 2]


def test_nothing_to_tell_poses_by() -> None:
    assert Measurements(position=np.zeros((3, 4))).repetitions() is None
    assert Measurements(position=np.zeros((3, 0)), q=np.zeros((6, 0))).repetitions() is None
