"""Videos and messages with images: the board where the arm stands still, in data sets of LeRobot and bags of ROS."""

import json
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from boards import BOARDS, CAMERA, cv2, photos
from commands import missing
from independent_arm import robot

import robacc
from robacc import InputError, Measurements

pyarrow = pytest.importorskip("pyarrow")
from pyarrow import parquet  # noqa: E402

STOPS, STILL, FPS = 6, 9, 30
"""Stops of the arm, and frames of each after five in motion."""
CAMERAS = ("observation.images.hand", "observation.images.side")
NAMES = [f"j{i}.pos" for i in range(1, 7)] + ["gripper.pos"]
RANGES = [(900 + 20 * i, 3100 + 40 * i) for i in range(7)]
"""Counts of each motor; in percent, the joints are from -100 to 100 between them."""
TAGS = "AprilTagDetectionArray"
TAG_MESSAGES = {
    "Point": "float64 x\nfloat64 y\n",
    "AprilTagDetection": "string family\nint32 id\napriltag_msgs/Point[4] corners\n",
    TAGS: "std_msgs/Header header\napriltag_msgs/AprilTagDetection[] detections\n",
}
"""Messages of ROS 2, without what is not read."""


@cache
def frames() -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Joints of each stop, joints ``(N, 6)`` of each frame, rad, and its frames, smaller than a photo."""
    stops, pictures = photos("apriltag", STOPS, (0.0,) * 6)
    joints, shown = [], []
    for number, (q, picture) in enumerate(zip(stops, pictures, strict=True)):
        before = stops[max(number - 1, 0)]
        joints += [before + part * (q - before) for part in np.linspace(0.1, 0.9, 5)] + [q] * STILL
        small = cv2.cvtColor(
            cv2.resize(picture, None, fx=0.625, fy=0.625, interpolation=cv2.INTER_AREA), cv2.COLOR_GRAY2BGR
        )
        shown += [cv2.blur(small, (61, 1)) if number else small] * 5 + [small] * STILL
    return stops, np.array(joints), shown


def video(path: Path, pictures: list[np.ndarray]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), FPS, (800, 600))
    for picture in pictures:
        writer.write(picture)
    writer.release()


def data_set(folder: Path, version: str = "v2.1", kind: str = "video", percent: bool = False) -> Path:
    """A data set of two episodes, with the files of the board and of the camera beside it."""
    _, joints, pictures = frames()
    root, half = folder / "set", len(pictures) // 2
    values = np.degrees(np.c_[joints, np.zeros(len(joints))])
    if percent:
        values *= 200.0 * 4095 / 360 / np.diff(RANGES).T
    episode, frame = np.divmod(np.arange(len(joints)), half)
    columns = {"observation.state": values.astype(np.float32).tolist(), "episode_index": episode, "frame_index": frame}
    is_new, hand = version == "v3.0", CAMERAS[0]
    if kind == "image":
        columns[hand] = [{"bytes": cv2.imencode(".png", each)[1].tobytes(), "path": None} for each in pictures]
    path = "chunk-{chunk_index:03d}/file-{file_index:03d}" if is_new else "chunk-{episode_chunk:03d}/{video_key}/"
    path = f"{{video_key}}/{path}.mp4" if is_new else path + "episode_{episode_index:06d}.mp4"
    features = {"observation.state": {"dtype": "float32", "shape": [7], "names": NAMES}}
    features |= {name: {"dtype": kind} for name in CAMERAS}
    info = {"codebase_version": version, "fps": FPS, "features": features, "chunks_size": 1000}
    for name in ("data/chunk-000", "meta/episodes/chunk-000"):
        (root / name).mkdir(parents=True)
    (root / "meta/info.json").write_text(json.dumps({**info, "video_path": f"videos/{path}"}))
    for number in (0, 1):
        table = pyarrow.table({name: list(column) for name, column in columns.items()})
        parquet.write_table(table.slice(number * half, half), root / f"data/chunk-000/file-00{number}.parquet")
        if kind == "video" and not is_new:
            video(root / f"videos/chunk-000/{hand}/episode_00000{number}.mp4", pictures[number * half :][:half])
    if is_new:
        video(root / f"videos/{hand}/chunk-000/file-000.mp4", pictures)
        places = {"chunk_index": [0, 0], "file_index": [0, 0], "from_timestamp": [0.0, half / FPS]}
        places = {f"videos/{hand}/{name}": column for name, column in places.items()}
        parquet.write_table(
            pyarrow.table({"episode_index": [0, 1], **places}), root / "meta/episodes/chunk-000/file-000.parquet"
        )
    motor = {"drive_mode": 0, "homing_offset": 0}
    motors = {
        name.removesuffix(".pos"): {"id": i, "range_min": low, "range_max": high, **motor}
        for i, (name, (low, high)) in enumerate(zip(NAMES, RANGES, strict=True), 1)
    }
    (folder / "arm.json").write_text(json.dumps(motors))
    return root


def bag(folder: Path, kind: str) -> Path:
    """A bag of ROS with joint states, and with images or the tags that a node of ROS found in them."""
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    time_of, header_of = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    package = "apriltag_msgs" if kind == TAGS else "sensor_msgs"
    for name, text in TAG_MESSAGES.items():
        store.register(get_types_from_msg(text, f"apriltag_msgs/msg/{name}"))
    image_of, none = store.types[f"{package}/msg/{kind}"], np.array([])
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {
            name: writer.add_connection(f"/{name}", message, typestore=store)
            for name, message in (("joint_states", "sensor_msgs/msg/JointState"), ("camera", f"{package}/msg/{kind}"))
        }
        for number, (q, picture) in enumerate(zip(*frames()[1:], strict=True)):
            header = header_of(time_of(1_700_000_000 + number // FPS, number % FPS * 10**9 // FPS), "")
            names = [f"j{i}" for i in range(1, 7)]
            messages = {"joint_states": store.types["sensor_msgs/msg/JointState"](header, names, q, none, none)}
            if kind == "Image":
                messages["camera"] = image_of(header, 600, 800, "bgr8", 0, 3 * 800, picture.ravel())
            elif kind == TAGS:
                messages["camera"] = image_of(header, [tag_of(store.types, *each) for each in tags(picture)])
            else:
                messages["camera"] = image_of(header, "png", cv2.imencode(".png", picture)[1])
            for name, message in messages.items():
                stamp = header.stamp.sec * 10**9 + header.stamp.nanosec
                writer.write(topics[name], stamp, store.serialize_cdr(message, message.__msgtype__))
    return folder / "bag"


def tags(picture: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Numbers and corners of the tags, in the order and with the half pixel of the library of AprilTag."""
    fine = cv2.aruco.DetectorParameters()
    fine.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
    known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, ids, _ = cv2.aruco.ArucoDetector(known, fine).detectMarkers(picture)
    return [
        (int(i), each[0][[1, 0, 3, 2]] + 0.5)
        for i, each in zip([] if ids is None else ids.ravel(), corners, strict=True)
    ]


def tag_of(types: Any, number: int, corners: np.ndarray) -> Any:
    points = [types["apriltag_msgs/msg/Point"](*map(float, each)) for each in corners]
    return types["apriltag_msgs/msg/AprilTagDetection"]("36h11", number, points)


def points_of(path: Path, statements: str | None) -> Measurements:
    folder = path.parent
    (folder / "board.yaml").write_text(BOARDS["apriltag"])
    (folder / "camera.yaml").write_text(
        CAMERA.replace("1000", "625").replace("639.5", "399.5").replace("479.5", "299.5")
    )
    files = {name: folder / f"{name}.yaml" for name in ("board", "camera")}
    return robacc.read_poses(path, robot=robot(), bag=statements, **files)


@pytest.mark.parametrize(
    ("make", "statements"),
    [
        (data_set, "images=hand"),
        (lambda folder: data_set(folder, "v3.0"), "images=observation.images.hand"),
        (lambda folder: data_set(folder, kind="image", percent=True), "images=hand,calibration={}/arm.json"),
        (lambda folder: bag(folder, "Image"), None),
        (lambda folder: bag(folder, "CompressedImage"), "images=/camera"),
        (lambda folder: bag(folder, TAGS), None),
    ],
)
def test_stops_of_a_recording_are_photos(make: Callable[[Path], Path], statements: str | None, tmp_path: Path) -> None:
    data, stops = points_of(make(tmp_path), statements and statements.format(tmp_path)), frames()[0]
    assert not missing("\n".join(data.warnings), f"{STOPS} stops", f"{STOPS} of {STOPS} photos")
    np.testing.assert_allclose(data.q.T, stops, atol=1e-6)
    if data.direction is not None:
        np.testing.assert_array_equal(data.direction.T[1:], np.sign(np.diff(stops, axis=0)))
    # Small compressed images show a distance to some mm; a frame of another stop would be 0.1 m off.
    assert robacc.estimate(data, robot=robot()).position.rms < 5e-3


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a data set and the calibration of its motors."""
    return data_set(tmp_path_factory.mktemp("recorded")).parent


@pytest.fixture
def copied(recorded: Path, tmp_path: Path) -> Path:
    """A copy of the folder, to be changed."""
    return Path(shutil.copytree(recorded, tmp_path, dirs_exist_ok=True))


@pytest.mark.parametrize(
    ("file", "content", "statements", "message"),
    [
        (None, "", None, "has several cameras; its cameras are hand, side; name one"),
        (None, "", "images=top", "has no camera top"),
        (None, "", "images=side", "episode_000000.mp4: does not exist; download the data set with its videos"),
        ("set/meta/info.json", "{}", "images=hand", "cannot be read as a data set of LeRobot (KeyError: 'features')"),
        ("set/meta/info.json", '{"codebase_version": "v1.6"}', "images=hand", "has format v1.6, expected 2 or 3"),
        ("arm.json", '{"j1": 4}', "images=hand,calibration={}/arm.json", "is no calibration of LeRobot"),
        ("set/data/chunk-000/file-001.parquet", "PAR1", "images=hand", "cannot be read as a data set of LeRobot"),
        ("set/videos/chunk-000/observation.images.hand/episode_000000.mp4", "x", "images=hand", "cannot be decoded"),
        ("fps", "", "images=hand", "has 30 frames per second, and meta/info.json says 60; one of them is wrong"),
        ("shorter", "", "images=hand", "has 20 frames, and the joints have one at"),
        ("names", "", "images=hand", "meta/info.json names 2 values of observation.state, and its frames have 7"),
    ],
)
def test_what_a_data_set_lacks_is_said(
    file: str | None, content: str, statements: str | None, message: str, copied: Path
) -> None:
    root = copied / "set"
    info = json.loads((root / "meta/info.json").read_text())
    if file == "shorter":
        video(root / f"videos/chunk-000/{CAMERAS[0]}/episode_000000.mp4", frames()[2][:20])
    elif file in ("fps", "names"):
        info |= {"fps": 60} if file == "fps" else {}
        info["features"]["observation.state"]["names"] = NAMES if file == "fps" else NAMES[:2]
        (root / "meta/info.json").write_text(json.dumps(info))
    elif file is not None:
        (copied / file).write_text(content)
    with pytest.raises(InputError) as caught:
        points_of(root, statements and statements.format(copied))
    assert message in str(caught.value)


def test_frames_without_joints_are_left_out_and_those_without_images_are_named(tmp_path: Path) -> None:
    root = data_set(tmp_path, kind="image")
    file = root / "data/chunk-000/file-000.parquet"
    table = parquet.read_table(file)
    states = table.column(0).to_pylist()
    states[30][2] = states[31][4] = float("nan")
    parquet.write_table(table.set_column(0, table.column_names[0], pyarrow.array(states)), file)
    data = points_of(root, "images=hand")
    said = "2 of 84 frames have no joints in observation.state", "may be degrees or percent; taken as degrees"
    assert not missing("\n".join(data.warnings), f"{STOPS} stops", *said)
    parquet.write_table(table.drop([CAMERAS[0]]), file)
    with pytest.raises(InputError, match=r"file-000.parquet: has no column observation.images.hand"):
        points_of(root, "images=hand")
