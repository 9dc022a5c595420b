"""Campaigns with the target in sockets: places to reach, and poses in sockets of unknown place."""

from pathlib import Path

import numpy as np
import pytest
from independent_arm import robot, target
from sample_files import saved

import robacc
from robacc.errors import UsageError

PLACES = np.array([[0.9, 0.45, 0.25], [0.9, -0.45, 0.25], [0.5, 0.55, 0.3], [0.85, 0.0, 0.85]])
FIT = "base_frame,tool_frame,joint_offset"
JOINTS = ",".join(f"q{i}" for i in range(1, 7))


def places(tmp_path: Path, rows: np.ndarray = PLACES) -> str:
    """A file of places of sockets, mm."""
    lines = (f"{name},{x},{y},{z}" for name, (x, y, z) in zip("abcd", 1e3 * rows, strict=False))
    return saved(tmp_path / "places.csv", "\n".join(["pose,x_mm,y_mm,z_mm", *lines, ""]))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> robacc.Measurements:
    """Planned poses that reach the places, read back."""
    tmp_path = tmp_path_factory.mktemp("sockets")
    region = "x=0.3:1.2,y=-0.7:0.7,z=0.1:1.1"
    found = places(tmp_path)
    result = robacc.plan(robot(), candidates=found, poses=24, fit=FIT, noise="0.05mm", region=region, repeats=0)
    path = saved(tmp_path / "plan.csv", result.csv())
    assert result.candidates.in_sockets
    planned, free = result.accuracy["planned"], result.accuracy["of_tracker"]
    assert planned["n_poses"] == free["n_poses"] == 24
    assert free["total_rms_m"] < planned["total_rms_m"] < 2.0 * free["total_rms_m"]
    return robacc.read_poses(path, robot=robot())


def test_joints_are_found_that_reach_the_sockets(data: robacc.Measurements) -> None:
    sockets = [str(name).partition("-")[0] for name in data.pose]
    assert len({*sockets}) > 2
    for q, position, socket in zip(data.q.T, data.position.T, sockets, strict=True):
        np.testing.assert_allclose(position, PLACES["abcd".index(socket)], atol=1e-9)
        # Joints are rounded to 1e-6 rad.
        np.testing.assert_allclose(target(q), position, atol=5e-6)


def test_places_that_cannot_be_reached_are_named(tmp_path: Path) -> None:
    far = PLACES.copy()
    far[2] = [4.0, 0.0, 0.0]
    with pytest.raises(UsageError, match="no joints within the limits bring the target to socket c"):
        robacc.plan(robot(), candidates=places(tmp_path, far), poses=12)
    with pytest.raises(UsageError, match="only a tool has places in sockets: give a robot without targets"):
        robacc.plan(robot({"a": np.zeros(3)}), candidates=places(tmp_path), poses=12)
    nothing = saved(tmp_path / "nothing.csv", "pose,note\na,1\nb,2\n")
    with pytest.raises(UsageError, match="neither joint columns nor places x, y, z of sockets"):
        robacc.plan(robot(), candidates=nothing)


def test_a_column_socket_means_points_of_unknown_place(data: robacc.Measurements, tmp_path: Path) -> None:
    names = {str(name).partition("-")[0] for name in data.pose}
    rows = [
        f"{','.join(map(repr, q))},{name},{str(name).partition('-')[0]}"
        for q, name in zip(data.q.T.tolist(), data.pose, strict=True)
    ]
    path = saved(tmp_path / "points.csv", "\n".join([f"{JOINTS},pose,socket", *rows, ""]))
    result = robacc.plan(robot(), candidates=path, poses=20, fit=FIT, noise="0.05mm", check_every=0, repeats=0)
    stds = {entry["name"]: entry["std"] for entry in result.coefficients}
    assert {f"base_frame.{name}.{axis}" for name in names for axis in "xyz"} <= stds.keys()
    assert stds["joint_offset.j1"] is None  # the turn of everything
    assert "no row measures a length" in " ".join(result.warnings)
    text = result.csv()
    assert text.splitlines()[3].endswith("pose,cycle,kind,socket")
    again = robacc.calibrate(saved(tmp_path / "measured.csv", text), robot=robot(), fit=FIT)
    assert {*again.fit_inputs.data.fixture} <= names
    # The information of rows measured already counts with their kind, too.
    more = robacc.plan(robot(), candidates=path, already=path, poses=5, fit=FIT, noise="0.05mm")
    assert more.sufficiency["n_already"] == data.n
    with pytest.raises(UsageError, match="`candidates` and `already` are two files with a column socket each"):
        robacc.plan(robot(), already=path, poses=5, fit=FIT)
    planes = saved(tmp_path / "planes.csv", f"{JOINTS},plane\n0,0,0,0,0,0,p\n0.1,0,0,0,0,0,p\n")
    with pytest.raises(UsageError, match="positions and points in sockets, but rows are of kind plane"):
        robacc.plan(robot(), candidates=planes, poses=1)
