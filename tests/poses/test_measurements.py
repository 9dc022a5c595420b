"""Rows of the same commanded pose."""

from __future__ import annotations

import numpy as np
import pytest

from robacc.measurements import Measurements

N = 40_000
"""More than are hashed at a time."""


def measured(**columns: np.ndarray) -> Measurements:
    n = next(iter(columns.values())).shape[-1]
    return Measurements(position=np.zeros((3, n)), **columns)


def repeated(data: Measurements) -> np.ndarray | None:
    groups = data.repetitions()
    return None if groups is None else groups.repeated


@pytest.mark.parametrize("column", ["q", "commanded_position"])
def test_poses_of_their_own_have_no_repetitions(column: str) -> None:
    assert measured(**{column: np.random.default_rng(1).normal(size=(3, N))}).repetitions() is None


@pytest.mark.parametrize(("first", "second"), [(0, 1), (0, N - 1), (17_000, 39_000)])
def test_one_pose_measured_twice_is_found_wherever_its_rows_are(first: int, second: int) -> None:
    q = np.random.default_rng(2).normal(size=(6, N))
    q[:, second] = q[:, first] + 1e-12
    groups = repeated(measured(q=q))
    assert np.unique(groups).size == N - 1
    assert groups[first] == groups[second]


def test_repetitions_are_those_of_sorting_whole_columns() -> None:
    q = np.random.default_rng(3).integers(-2, 3, size=(3, N)) * 0.25
    q[q == 0.0] *= np.random.default_rng(4).choice([-1.0, 1.0], size=np.count_nonzero(q == 0.0))  # -0.0 is 0.0 too
    data = measured(q=q)
    groups = repeated(data)
    np.testing.assert_array_equal(groups, data.groups())
    expected = np.unique(q + 0.0, axis=1, return_inverse=True)[1].ravel()
    pairs = np.unique(np.stack((groups, expected)), axis=1)
    assert pairs.shape[1] == np.unique(expected).size == np.unique(groups).size == 125


def test_the_pose_column_goes_first() -> None:
    joints = np.zeros((6, 4))
    assert repeated(measured(q=joints, pose=np.array(["a", "b", "c", "d"]))) is None
    groups = repeated(measured(q=joints, pose=np.array(["a", "b", "a", "d"])))
    assert groups.tolist() == [0, 1, 0, 2]


def test_nothing_to_tell_poses_by() -> None:
    assert Measurements(position=np.zeros((3, 4))).repetitions() is None
    assert Measurements(position=np.zeros((3, 0)), q=np.zeros((6, 0))).repetitions() is None


@pytest.mark.parametrize("column", ["q", "commanded_position"])
def test_an_id_of_rows_that_went_to_different_places_is_not_believed(column: str) -> None:
    sent = np.random.default_rng(5).normal(size=(3, 8))
    sent[:, 3] = sent[:, 1]  # of the id that is wrong, two rows are one pose all the same
    sent[:, 7] = sent[:, 6] + 5e-4  # as read back
    data = measured(**{column: sent}, pose=np.array(["b", "a", "a", "a", "a", "b", "c", "c"]))
    data = data.subset(np.array([1, 2, 3, 4, 6, 7, 0]))
    groups = data.groups()
    assert groups[0] == groups[2]
    assert groups[4] == groups[5]
    assert np.unique(groups).size == groups.max() + 1 == 5
    np.testing.assert_array_equal(repeated(data), groups)
    far = 1 + int(np.argmax(np.abs(sent[:, [2, 3, 4]] - sent[:, [1]]).max(axis=0)))
    assert data.contradicted_ids() == (
        f"1 of 3 pose ids has rows with different commands, for example a on line 1 and line {far + 1}; "
        "only rows with equal commands count as repetitions",
    )


def test_ids_that_agree_with_the_commands_are_believed() -> None:
    at = np.random.default_rng(6).normal(size=(6, 5))
    ids = np.array(["c", "a", "b", "e", "d"])
    data = measured(q=np.repeat(at, 3, axis=1), pose=np.repeat(ids, 3))
    assert data.contradicted_ids() == ()
    assert data.groups().tolist() == np.repeat([2, 0, 1, 4, 3], 3).tolist()
    unknown = measured(pose=np.array(["a", "a"]))
    assert unknown.contradicted_ids() == ()
    assert unknown.groups().tolist() == [0, 0]
    assert measured(q=np.zeros((6, 0)), pose=np.array([], dtype=str)).contradicted_ids() == ()
    assert measured(q=np.zeros((6, 0)), pose=np.array([], dtype=str)).groups().size == 0
