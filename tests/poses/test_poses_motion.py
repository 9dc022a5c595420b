"""Direction and speed of approach: from columns, or from the order of rows."""

from __future__ import annotations

import numpy as np
from pose_files import Reader

from robacc.measurements import motion_between_rows


def test_order_of_rows_gives_direction_and_speed(read: Reader) -> None:
    text = "q1,q2,x,y,z\n0,0,1,2,3\n0.5,-0.25,1,2,3\n0.5,-0.25,1,2,3\n0.5,0.75,1,2,3\n"
    data = read(text, ordered=True)
    assert data.direction is not None
    assert data.speed is not None
    assert data.ordered
    assert data.direction.tolist() == [[0, 1, 0, 0], [0, -1, 0, 1]]
    assert data.speed.tolist() == [[0, 1, 0, 0], [0, -0.5, 0, 1]]


def test_given_motion_goes_before_derived(read: Reader) -> None:
    text = "q1,q2,x,y,z,dir_q2,speed_q1\n0,0,1,2,3,1,0.5\n0.5,-0.25,1,2,3,1,0.25\n"
    data = read(text, ordered=True)
    assert data.direction is not None
    assert data.speed is not None
    assert data.direction.tolist() == [[0, 1], [1, 1]]
    assert data.speed.tolist() == [[0.5, 0.25], [0, -0.5]]
    assert data.warnings == ()


def test_motion_of_some_joints_only(read: Reader) -> None:
    data = read("q1,q2,x,y,z,dir_q2\n0,0,1,2,3,-1\n")
    assert data.direction is not None
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
        "rows should be in the order measured, but time_s decreases at line 4",
    ]
    assert read(text).warnings == ()


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
