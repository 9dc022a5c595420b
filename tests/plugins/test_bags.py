"""Recordings of ROS: topics, clocks, stands of the robot, and the association of joints with measured poses."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sample_files import SAMPLES

import robacc
from robacc.errors import InputError, UsageError
from robacc.geometry import quaternion_from_rotation

pytest.importorskip("rosbags")
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

ROBOT = robacc.read_robot(SAMPLES / "robot.yaml")
DATA = robacc.read_poses(SAMPLES / "poses.csv", robot=ROBOT).subset(slice(0, 6))
STORE = get_typestore(Stores.ROS2_HUMBLE)
NOON = 1_700_049_600  # 12:00 UTC of 2023-11-15
PERIOD = 0.04


@dataclass
class Bag:
    """A recording of joint states; the robot moves for a second to each pose and stands there for one."""

    path: Path
    plugin: StoragePlugin = StoragePlugin.MCAP
    joints: str = "/joint_states"
    tracker: str = "/tracker/pose"
    kind: str = "PoseStamped"
    tracker_clock: float = 0.0
    in_motion: bool = False
    names: tuple[str, ...] = ("q1", "q2", "q3", "q4", "q5", "q6")

    def write(self) -> Path:
        messages = [(t, "joints", self._joint_state(t)) for t in np.arange(0, 2 * DATA.n, PERIOD)]
        for k in range(DATA.n):
            times = [2 * k + 1.2 + 0.1 * j for j in range(4)] + ([2 * k + 0.5] if self.in_motion and k else [])
            messages += [(t, "tracker", self._pose(t, k, j)) for j, t in enumerate(times)]
        with Writer(self.path, version=9, storage_plugin=self.plugin) as writer:
            topics = {
                "joints": writer.add_connection(self.joints, "sensor_msgs/msg/JointState", typestore=STORE),
                "tracker": writer.add_connection(self.tracker, f"geometry_msgs/msg/{self.kind}", typestore=STORE),
            }
            for t, topic, message in sorted(messages, key=lambda item: item[0]):
                data = STORE.serialize_cdr(message, message.__msgtype__)
                writer.write(topics[topic], round((NOON + t) * 1e9), data)
        return self.path

    def _joint_state(self, t: float) -> Any:
        k = int(t // 2)
        before = DATA.q[:, max(k - 1, 0)]
        q = before + (DATA.q[:, k] - before) * min(t - 2 * k, 1.0)
        positions = q[[int(name[1:]) - 1 for name in self.names]]
        none = np.array([])
        return STORE.types["sensor_msgs/msg/JointState"](header(t, ""), list(self.names), positions, none, none)

    def _pose(self, t: float, k: int, j: int) -> Any:
        """The samples of a stand differ by 10 um along x, around the measured position."""
        assert DATA.rotation is not None
        x, y, z = DATA.position[:, k]
        point = STORE.types["geometry_msgs/msg/Point"](x + (j - 1.5) * 1e-5, y, z)
        stamp = header(t + self.tracker_clock, "tracker")
        if self.kind == "PointStamped":
            return STORE.types["geometry_msgs/msg/PointStamped"](stamp, point)
        w, *vector = quaternion_from_rotation(DATA.rotation)[:, k]
        turn = STORE.types["geometry_msgs/msg/Quaternion"](*vector, w)
        pose = STORE.types["geometry_msgs/msg/Pose"](point, turn)
        if self.kind == "PoseStamped":
            return STORE.types["geometry_msgs/msg/PoseStamped"](stamp, pose)
        covariance = np.diag([1e-10, 4e-10, 9e-10, 1, 1, 1]).ravel()
        body = STORE.types["geometry_msgs/msg/PoseWithCovariance"](pose, covariance)
        return STORE.types["geometry_msgs/msg/PoseWithCovarianceStamped"](stamp, body)


def header(t: float, frame: str) -> Any:
    time = STORE.types["builtin_interfaces/msg/Time"](NOON + int(t // 1), round((t % 1) * 1e9))
    return STORE.types["std_msgs/msg/Header"](time, frame)


@pytest.mark.parametrize(("plugin", "whole_folder"), [(StoragePlugin.MCAP, False), (StoragePlugin.SQLITE3, True)])
def test_stands_of_a_bag_are_its_poses(tmp_path: Path, plugin: StoragePlugin, whole_folder: bool) -> None:
    folder = Bag(tmp_path / "bag", plugin, in_motion=True).write()
    path = folder if whole_folder else next(file for file in folder.iterdir() if file.suffix in (".mcap", ".db3"))
    data = robacc.read_poses(path, robot=ROBOT, bag="at=rest")
    assert data.n == DATA.n
    # The mean of a stand: the samples' offsets along x cancel.
    np.testing.assert_allclose(data.position, DATA.position, atol=1e-9)
    np.testing.assert_allclose(data.q, DATA.q, atol=1e-9)
    np.testing.assert_allclose(data.rotation, DATA.rotation, atol=1e-9)
    np.testing.assert_allclose(data.time, 43200 + 2 * np.arange(DATA.n) + 1.35, atol=1e-3)
    assert any("24 of 29 samples at 6 stops" in text for text in data.warnings)


def test_samples_of_one_stand_are_one_visit(tmp_path: Path) -> None:
    data = robacc.read_poses(Bag(tmp_path / "bag").write(), robot=ROBOT)
    assert data.n == 4 * DATA.n
    assert data.visit.tolist() == [str(k + 1) for k in range(DATA.n) for _ in range(4)]


def test_joints_in_motion_are_interpolated_to_the_times_of_the_poses(tmp_path: Path) -> None:
    path = Bag(tmp_path / "bag", in_motion=True).write()
    with pytest.raises(InputError, match="the robot moved during 5 of 29 measured poses") as caught:
        robacc.read_poses(path, robot=ROBOT)
    assert "at=rest" in str(caught.value)
    halfway = robacc.read_poses(path, robot=ROBOT, bag="at=any").q[:, 4 + 5 * np.arange(DATA.n - 1)]
    np.testing.assert_allclose(halfway, (DATA.q[:, :-1] + DATA.q[:, 1:]) / 2, atol=1e-6)


def test_stamps_of_two_clocks_are_refused(tmp_path: Path) -> None:
    path = Bag(tmp_path / "bag", tracker_clock=3.0).write()
    with pytest.raises(InputError, match=r"not from the same clock: .* 3 s later"):
        robacc.read_poses(path, robot=ROBOT)
    data = robacc.read_poses(path, robot=ROBOT, bag="clock=recorder")
    assert DATA.q is not None
    np.testing.assert_allclose(data.q, np.repeat(DATA.q, 4, axis=1), atol=1e-9)


def test_covariances_become_standard_deviations(tmp_path: Path) -> None:
    data = robacc.read_poses(Bag(tmp_path / "bag", kind="PoseWithCovarianceStamped").write(), robot=ROBOT)
    np.testing.assert_allclose(data.sigma_position, np.outer([1e-5, 2e-5, 3e-5], np.ones(data.n)))


def test_points_have_no_orientation(tmp_path: Path) -> None:
    data = robacc.read_poses(Bag(tmp_path / "bag", kind="PointStamped").write(), robot=ROBOT)
    assert data.rotation is None


def test_joints_are_known_by_their_names(tmp_path: Path) -> None:
    path = Bag(tmp_path / "bag", names=("q3", "q2", "q1", "q4", "q5", "q6")).write()
    data = robacc.read_poses(path, robot=ROBOT)
    assert DATA.q is not None
    np.testing.assert_allclose(data.q, np.repeat(DATA.q, 4, axis=1), atol=1e-9)


@pytest.mark.parametrize(
    ("bag", "error", "message"),
    [
        ("joints=/joint_state", InputError, "no topic /joint_state.*did you mean /joint_states"),
        ("measured=/joint_states", InputError, "topic /joint_states holds JointState, expected"),
        ("at=rests", UsageError, "expected at=any or rest, found 'at=rests'"),
        ("joint=/joint_states", UsageError, "did you mean joints"),
    ],
)
def test_wrong_statements_on_a_bag(tmp_path: Path, bag: str, error: type[Exception], message: str) -> None:
    path = Bag(tmp_path / "bag").write()
    with pytest.raises(error, match=f"(?s){message}"):
        robacc.read_poses(path, robot=ROBOT, bag=bag)


def test_a_topic_must_be_chosen_where_several_could_be_meant(tmp_path: Path) -> None:
    path = Bag(tmp_path / "bag", tracker="/cmd_pose").write()
    with pytest.raises(InputError, match=r"which topic has the measured poses: it has /cmd_pose \(PoseStamped, 24"):
        robacc.read_poses(path, robot=ROBOT)
    assert robacc.read_poses(path, robot=ROBOT, bag="measured=/cmd_pose").n == 24


def test_damaged_recordings_are_one_message(tmp_path: Path) -> None:
    file = next(Bag(tmp_path / "bag").write().glob("*.mcap"))
    content = file.read_bytes()
    rng = np.random.default_rng(3)
    for cut in rng.integers(9, len(content), 5):
        file.write_bytes(content[:cut])
        with pytest.raises(InputError, match="cannot be read as a ROS recording"):
            robacc.read_poses(file, robot=ROBOT)


def test_another_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is a folder, expected a file(?s:.*)metadata.yaml"):
        robacc.read_poses(tmp_path)
