"""Measurements: repetitions, close poses, what is written and read back."""

import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import document, one_line, run
from hypothesis import HealthCheck, given, settings, strategies as st
from pose_files import Reader
from sample_files import ROOT
from scipy.spatial.transform import Rotation

from robacc.measurements import Measurements
from robacc.poses.csv_file import format_poses, read_poses
from robacc.poses.reading import KnownRobot

# Rows of the same commanded pose.

N = 40_000
"""More than are hashed at a time."""


def measured(**columns: np.ndarray) -> Measurements:
    n = next(iter(columns.values())).shape[-1]
    return Measurements(position=np.zeros((3, n)), **columns)


def repeated(data: Measurements) -> np.ndarray | None:
    return data.repetitions()


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
    assert repeated(measured(q=joints, pose=np.array(["a", "b", "a", "d"]))).tolist() == [0, 1, 0, 2]


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


# Writing pose files: what is written is read back.

finite = st.floats(-1e8, 1e8)  # what a file of poses may hold
ids = st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1, max_size=8)


@st.composite
def measurements(draw: st.DrawFn) -> Measurements:
    """Any measurements that a file can hold."""
    n, joints = draw(st.integers(0, 4)), draw(st.integers(1, 3))

    def array(elements: st.SearchStrategy[Any], *shape: int) -> Any:
        count = math.prod(shape)
        return np.array(draw(st.lists(elements, min_size=count, max_size=count)), dtype=float).reshape(shape)

    def maybe(make: Callable[[], Any]) -> Any:
        return make() if draw(st.booleans()) else None

    def rotation() -> Any:
        seed = draw(st.integers(0, 2**32 - 1))
        return np.moveaxis(Rotation.random(n, rng=np.random.default_rng(seed)).as_matrix(), 0, -1).reshape(3, 3, n)

    def text() -> Any:
        return np.array(draw(st.lists(ids, min_size=n, max_size=n)), dtype=str)

    positive = st.floats(1e-12, 1e6)
    return Measurements(
        position=array(finite, 3, n),
        rotation=maybe(rotation),
        q=array(finite, joints, n),
        commanded_position=array(finite, 3, n),
        commanded_rotation=maybe(rotation),
        sigma_position=maybe(lambda: array(positive, 3, n)),
        sigma_rotation=maybe(lambda: array(positive, n)),
        pose=maybe(text),
        cycle=maybe(text),
        target=maybe(text),
        time=maybe(lambda: array(finite, n)),
        temperature=maybe(lambda: array(st.floats(-273.15, 1e9), n)),
        payload=maybe(lambda: array(st.floats(0, 1e9), n)),
        direction=maybe(lambda: array(st.sampled_from([-1, 0, 1]), joints, n)),
        speed=maybe(lambda: array(st.floats(-1, 1), joints, n)),
    )


EXACT = ("position", "q", "commanded_position", "sigma_position", "sigma_rotation", "pose", "cycle", "target")

EXACT += ("time", "temperature", "payload", "direction", "speed")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)
@given(data=measurements())
def test_what_is_written_is_read_back(read: Reader, data: Measurements) -> None:
    text = format_poses(data)
    back = read(text, units_check=False)
    for name in EXACT:
        expected, values = getattr(data, name), getattr(back, name)
        if name == "pose" and expected is None and values is not None:
            # Joints that differ by less than readings do are visits of one pose, and a warning says so.
            assert any("and their repetitions" in warning for warning in back.warnings)
            continue
        assert (expected is None) == (values is None), name
        if expected is not None:
            np.testing.assert_array_equal(values, expected, err_msg=name)
    for expected, values in ((data.rotation, back.rotation), (data.commanded_rotation, back.commanded_rotation)):
        assert (expected is None) == (values is None)
        if expected is not None and values is not None:
            np.testing.assert_allclose(values, expected, atol=2e-15)  # through a quaternion and back
    assert format_poses(data) == text


def test_written_columns() -> None:
    data = Measurements(
        position=np.array([[0.1], [1 / 3], [-2e-7]]),
        rotation=np.eye(3)[..., None],
        q=np.array([[0.5], [1e22]]),
        pose=np.array(["#1"]),
        direction=np.array([[1.0], [-1.0]]),
        speed=np.array([[1.0], [-0.25]]),
    )
    row = "0.5,1e+22,0.1,0.3333333333333333,-2e-07,1.0,0.0,0.0,0.0,1,-1,1.0,-0.25,#1\n"
    numbered = "q1,q2,x,y,z,qw,qx,qy,qz,dir_q1,dir_q2,speed_q1,speed_q2,pose\n"
    assert format_poses(data) == numbered + row


# Repetitions of a commanded pose, from files to results.


def test_a_pose_id_that_the_joints_contradict_is_no_repetition(tmp_path: Path) -> None:
    """Ids P0 … P9 over poses that were each measured once: nothing in them is pure error."""
    data = read_poses(ROOT / "sample_data" / "poses.csv")
    data = dataclasses.replace(data, pose=np.array([f"P{i % 10}" for i in range(data.n)]))
    (tmp_path / "poses.csv").write_text(format_poses(data), encoding="utf-8")
    arguments = (tmp_path / "poses.csv", "--robot", ROOT / "sample_data" / "robot.yaml")
    warning = "10 of 10 pose ids have rows with different commands, for example P0 on line 2 and line "
    found = document("calibrate", *arguments, "--folds", "2")
    assert found["noise"]["source"] == "residual"
    assert len(set(found["poses"]["group"])) == data.n
    assert any(warning in text for text in found["warnings"])
    estimated = run("estimate", *arguments, "--format", "json")
    assert warning in one_line(estimated.stderr)
    assert sum(warning in text for text in json.loads(estimated.stdout)["warnings"]) == 1
    # Cycles of ISO 9283 are by their ids all the same, with a warning of their own.
    judged = document("iso9283", *arguments)
    assert judged["n_commanded_poses"] == 10
    assert ["differs by" in text for text in judged["warnings"]] == [True]


# Repetitions whose joints were logged as read, in files without a pose column.

JOINTS = [f"q{i + 1}" for i in range(6)]


def written(path: Path, q: np.ndarray, more: dict[str, list[str]] | None = None) -> Path:
    xyz = np.random.default_rng(5).uniform(0.2, 0.9, (len(q), 3))
    columns = more or {}
    lines = [",".join([*JOINTS, "x", "y", "z", *columns])]
    for i, row in enumerate(np.hstack((q, xyz))):
        lines.append(",".join([*(f"{value:.9f}" for value in row), *(values[i] for values in columns.values())]))
    path.write_text("\n".join(lines) + "\n")
    return path


def jittered(jitter: float, count: int = 12, cycles: int = 5) -> np.ndarray:
    rng = np.random.default_rng(1)
    q = np.tile(rng.uniform(-2.0, 2.0, (count, 6)), (cycles, 1))
    return q + rng.uniform(-jitter, jitter, q.shape)


def test_joints_as_read_give_the_repetitions(tmp_path: Path) -> None:
    data = read_poses(written(tmp_path / "poses.csv", jittered(1e-4)), robot=KnownRobot(joint_names=JOINTS))
    assert np.array_equal(data.groups(), np.tile(data.groups()[:12], 5))
    assert np.unique(data.groups()).size == 12
    (warning,) = data.warnings
    assert "60 rows are read as 12 commanded poses" in warning
    assert data.contradicted_ids() == ()


@pytest.mark.parametrize("jitter", [0.0, 5e-3])
def test_equal_joints_and_distant_poses_stay_as_they_are(tmp_path: Path, jitter: float) -> None:
    data = read_poses(written(tmp_path / "poses.csv", jittered(jitter)), robot=KnownRobot(joint_names=JOINTS))
    assert data.pose is None
    assert np.unique(data.groups()).size == (60 if jitter else 12)


def test_a_slow_sweep_has_no_repetitions(tmp_path: Path) -> None:
    q = np.zeros((100, 6)) + 0.3
    q[:, 1] = np.linspace(0.0, 0.04, 100)
    assert read_poses(written(tmp_path / "poses.csv", q), robot=KnownRobot(joint_names=JOINTS)).pose is None


def test_a_pose_column_decides(tmp_path: Path) -> None:
    ids = {"pose": [f"N{i}" for i in range(60)]}
    data = read_poses(written(tmp_path / "poses.csv", jittered(1e-4), ids), robot=KnownRobot(joint_names=JOINTS))
    assert np.unique(data.groups()).size == 60
