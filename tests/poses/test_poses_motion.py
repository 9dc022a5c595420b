"""Direction and speed of approach: from columns, or from the order of rows."""

from __future__ import annotations

import numpy as np
import pytest
from pose_files import Reader

from robacc.fitting.visits import visit_numbers
from robacc.measurements import motion_between_rows


def test_motion_is_that_of_each_step() -> None:
    q = np.random.default_rng(3).normal(size=(4, 30))
    direction, speed = motion_between_rows(q)
    for k in range(1, 30):
        step = q[:, k] - q[:, k - 1]
        np.testing.assert_array_equal(direction[:, k], np.sign(step))
        np.testing.assert_array_equal(speed[:, k], step / max(abs(step)))


SMRS = "q1,q2,x,y,z,target\n"
ROWS = (("0,0", "ab"), ("0.5,-0.25", "ab"), ("0.5,0.75", "abab"), ("0,0", "ba"))
"""Joints of each arrival, and the targets measured there in turn: the third pose is measured twice."""


def test_every_target_of_a_visit_has_the_motion_of_the_visit(read: Reader) -> None:
    text = SMRS + "".join(
        f"{q},1,2,{i}.{j},{target}\n" for i, (q, ts) in enumerate(ROWS) for j, target in enumerate(ts)
    )
    data = read(text, ordered=True)
    # The second reading of both targets at the third pose is a visit that the arm did not move to.
    assert data.direction.tolist() == [[0, 0, 1, 1, 0, 0, 0, 0, -1, -1], [0, 0, -1, -1, 1, 1, 0, 0, -1, -1]]
    np.testing.assert_allclose(data.speed[1], [0, 0, -0.5, -0.5, 1, 1, 0, 0, -1, -1])
    # The last arrival is at the joints of the first: consecutive rows alone are a visit.
    assert visit_numbers(data).tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4]


@pytest.mark.parametrize(
    ("columns", "rows"),
    [
        ("visit,q1", "7,0 7,0.0002 8,1 8,1 9,1 9,1 3,0 3,0"),
        ("pose,cycle,q1", "a,1,0 a,1,0.0002 b,1,1 b,1,1 b,2,1 b,2,1 a,2,0 a,2,0"),
        ("pose,target,q1", "a,s,0 a,t,0.0002 b,s,1 b,t,1 b,s,1 b,t,1 a,s,0 a,t,0"),
    ],
)
def test_visits_are_named_by_their_column_or_by_pose_and_cycle_or_by_targets(
    read: Reader, columns: str, rows: str
) -> None:
    text = f"{columns},x,y,z\n" + "".join(f"{row},1,2,{i}\n" for i, row in enumerate(rows.split()))
    data = read(text, ordered=True)
    assert data.direction[0].tolist() == [0, 0, 1, 1, 0, 0, -1, -1]
    numbers = visit_numbers(data)
    pairs = numbers.reshape(4, 2)
    assert (pairs[:, 0] == pairs[:, 1]).all()
    assert np.unique(numbers).size == 4


def test_motion_of_a_file_with_one_row_a_visit_is_that_of_its_rows(read: Reader) -> None:
    q = np.random.default_rng(5).normal(size=(2, 40))
    q[:, 10] = q[:, 9]
    rows = [f"{v},{a!r},{b!r},1,2,{v}" for v, (a, b) in enumerate(q.T.tolist())]
    with_visits = read("\n".join(["visit,q1,q2,x,y,z", *rows]), ordered=True)
    direction, speed = motion_between_rows(q)
    np.testing.assert_array_equal(with_visits.direction, direction)
    np.testing.assert_array_equal(with_visits.speed, speed)
