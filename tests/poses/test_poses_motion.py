"""Direction and speed of approach: from columns, or from the order of rows."""

from __future__ import annotations

import numpy as np
import pytest
from pose_files import Reader, problem_texts

from robacc.fitting.visits import visit_numbers
from robacc.measurements import motion_between_rows


def test_order_of_rows_gives_direction_and_speed(read: Reader) -> None:
    text = "q1,q2,x,y,z\n0,0,1,2,3\n0.5,-0.25,1,2,3\n0.5,-0.25,1,2,3\n0.5,0.75,1,2,3\n"
    data = read(text, ordered=True)
    assert data.ordered
    assert data.direction.tolist() == [[0, 1, 0, 0], [0, -1, 0, 1]]
    assert data.speed.tolist() == [[0, 1, 0, 0], [0, -0.5, 0, 1]]


def test_given_motion_goes_before_derived(read: Reader) -> None:
    text = "q1,q2,x,y,z,dir_q2,speed_q1\n0,0,1,2,3,1,0.5\n0.5,-0.25,1,2,3,1,0.25\n"
    data = read(text, ordered=True)
    assert data.direction.tolist() == [[0, 1], [1, 1]]
    assert data.speed.tolist() == [[0.5, 0.25], [0, -0.5]]
    assert data.warnings == ()


def test_motion_of_some_joints_only(read: Reader) -> None:
    data = read("q1,q2,x,y,z,dir_q2\n0,0,1,2,3,-1\n")
    assert data.direction.tolist() == [[0], [-1]]
    assert data.speed is None
    assert len(data.warnings) == 1
    assert data.warnings[0].endswith("no column dir_q1: 0 (not moving) is assumed")


def test_order_that_says_nothing_or_contradicts_itself(read: Reader) -> None:
    text = "x,y,z,cmd_x,cmd_y,cmd_z,time_s\n1,2,3,1,2,3,5\n1,2,3,1,2,3,7\n1,2,3,1,2,3,6\n"
    data = read(text, ordered=True)
    assert data.direction is None
    assert [text.partition("poses.csv: ")[2] for text in data.warnings] == [
        "the file has no joint columns, so the order of rows does not give the joints' directions",
        "time_s decreases at line 4: the clock was set back, or the rows are not in the order measured",
    ]
    (warning,) = read(text).warnings
    assert "time_s decreases at line 4: the clock was set back" in warning


def test_motion_is_that_of_each_step() -> None:
    q = np.random.default_rng(3).normal(size=(4, 30))
    direction, speed = motion_between_rows(q)
    for k in range(1, 30):
        step = q[:, k] - q[:, k - 1]
        np.testing.assert_array_equal(direction[:, k], np.sign(step))
        np.testing.assert_array_equal(speed[:, k], step / max(abs(step)))


def test_a_direction_and_a_speed_that_contradict_each_other_are_warned_of(read: Reader) -> None:
    head = "q1,x,y,z,dir_q1,speed_q1\n0,1,2,3,1,0.5\n0,1,2,4,0,0.5\n0,1,2,5,1,0\n"
    assert read(head).warnings == ()
    (warning,) = read(head + "0,1,2,6,-1,0.5\n").warnings
    assert "dir_q1 and speed_q1 have opposite signs at line 5: one of them is wrong" in warning


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


def test_rows_that_contradict_their_visit_are_refused(read: Reader) -> None:
    text = "visit,q1,x,y,z\n1,0,1,2,3\n2,0.5,1,2,4\n1,0.5,1,2,5\n"
    (problem,) = problem_texts(read, text)
    assert problem == (
        "4, visit: visit '1' has another command than on line 2; a visit is one arrival of the arm, so number each "
        "arrival differently"
    )
    (problem,) = problem_texts(read, text.replace("1,0.5,1,2,5", "1,0,1,2,5"), ordered=True)
    assert problem.startswith("4, visit: visit '1' continues after another visit began, although rows are said to be")
    assert read(text.replace("1,0.5,1,2,5", "1,0,1,2,5")).visit.tolist() == ["1", "2", "1"]  # type: ignore[union-attr]
