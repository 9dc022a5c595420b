"""Recordings of messages as tables: ROS bags and MCAP files, a row for each measured pose or point of a board."""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem, UsageError, install_advice, refuse
from robacc.geometry import Array
from robacc.io.column_table import ColumnTable
from robacc.io.files import STANDARD_STREAM, sha256_of
from robacc.io.table import TableOptions
from robacc_plugins.photos import Shot, decoded, opencv, table_of
from robacc_plugins.recordings import EXAMPLE, STANDING, BagOptions, Track, stands_at, stops

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

_SIGNATURES = (b"\x89MCAP0\r\n", b"SQLite format 3\x00", b"#ROSBAG V")
"""First bytes of an MCAP file, of a ROS 2 bag in SQLite, and of a ROS 1 bag."""


def takes(path: str, first: bytes) -> bool:
    """Return whether a file is a recording, or a folder the one of a ROS 2 bag."""
    return first.startswith(_SIGNATURES) or (Path(path) / "metadata.yaml").is_file()


def read(path: str, options: TableOptions) -> ColumnTable:
    """Return the poses of a recording as a table with the names of ROS messages, in SI.

    Of a recording with a ``board``, the points of the board in the images of a camera.

    Raises:
        InputError: The recording cannot be read, or leaves a question open.
        UsageError: A statement of ``bag`` is wrong, or the extra ``ros`` is not installed.
    """
    if path == STANDARD_STREAM:
        raise InputError(
            Problem("is a recording, which is not read from a pipe", "<stdin>", fix="name the file instead")
        )
    stated = BagOptions.of(options.bag)
    if options.board is not None:
        return _points_of_images(path, stated, options)
    recording = read_recording(path, stated)
    measured = recording.measured
    if not measured.values:
        raise InputError(Problem(f"topic {measured.topic} has no measured poses", path))
    _check_clocks(path, recording, stated)
    origin = int(measured.times(stated.clock)[0])
    tracks = _tracks(recording, stated, origin)
    times = (measured.times(stated.clock) - origin) / 1e9
    stands = stands_at(times, tracks)
    are_stands = _use_rest(path, stands, stated)
    numbers = stands if are_stands else np.arange(times.size)
    groups = [np.flatnonzero(numbers == number) for number in range(int(numbers.max()) + 1)]
    columns = _columns(measured, tracks, times, groups)
    stamps = np.array([origin + round(1e9 * float(times[group].mean())) for group in groups])
    for name, part in zip(("sec", "nanosec"), np.divmod(stamps, 1_000_000_000), strict=True):
        columns.append((f"header.stamp.{name}", part))
    if not are_stands and stands.size and stands.min() >= 0 and np.unique(stands).size < stands.size:
        columns.append(("visit", (stands + 1).astype(str)))
    remark = _remark(recording, len(groups), int(np.sum(stands >= 0)), times.size, are_stands)
    return ColumnTable(columns, path, options.skip_gaps, _digest(path), remark)


# Joint states and poses of a recording: ROS 2 bags (SQLite or MCAP), MCAP files of ROS messages, and ROS 1 bags.

_JOINTS = frozenset({"JointState", "JointTrajectoryControllerState"})
_POSES = frozenset({"PoseStamped", "PoseWithCovarianceStamped", "PointStamped", "TransformStamped", "Pose", "Point"})
_TRANSFORMS = "TFMessage"
_IMAGES = frozenset({"Image", "CompressedImage", "AprilTagDetectionArray"})
_COMMAND_WORDS = ("command", "cmd", "target", "goal", "desired", "reference", "setpoint", "nominal")
_MOST_MESSAGES = 20_000_000
_SHOWN = 12


@dataclass(slots=True)
class Samples:
    """Values of one topic, in the order of the recording."""

    topic: str
    frame: str = ""
    """Frame that the first message names."""
    stamped: list[int] = field(default_factory=list)
    """Times of the messages' headers, ns; the time of recording where a header has none."""
    received: list[int] = field(default_factory=list)
    """Times of recording, ns."""
    values: list[tuple[float, ...]] = field(default_factory=list)

    def add(self, stamped: int, received: int, values: tuple[float, ...]) -> None:
        """Add a sample."""
        self.stamped.append(stamped)
        self.received.append(received)
        self.values.append(values)

    def times(self, clock: str) -> NDArray[np.int64]:
        """Return the times ``(N,)`` by the stated clock, ns."""
        return np.array(self.received if clock == "recorder" else self.stamped, dtype=np.int64)

    def array(self) -> Array:
        """Return the values ``(K, N)``."""
        return np.array(self.values, dtype=float).reshape(len(self.values), -1).T


@dataclass(slots=True)
class Recording:
    """Samples of the topics in use."""

    joints: dict[str, Samples]
    """By name of the joint; messages may have some of the joints only."""
    measured: Samples
    """x, y, z, qx, qy, qz, qw and standard deviations of x, y, z, NaN where the messages have none; or images."""
    commanded: Samples | None


def read_recording(path: str, options: BagOptions, of_images: bool = False) -> Recording:
    """Return the joint states of a recording, and its poses, or the times of its images.

    Raises:
        InputError: The recording is damaged, or it does not say which topics to take.
        UsageError: The extra ``ros`` is not installed.
    """
    with _opened(path) as bag:
        types = {topic: (info.msgtype or "").rpartition("/")[2] for topic, info in bag.topics.items()}
        counts = {topic: info.msgcount for topic, info in bag.topics.items()}
        roles = _roles(path, types, counts, options, "images" if of_images else "measured")
        recording = Recording({}, Samples(roles["images" if of_images else "measured"]), None)
        if "commanded" in roles:
            recording.commanded = Samples(roles["commanded"])
        topics = {topic.partition(":")[0]: role for role, topic in roles.items()}
        if sum(counts[topic] for topic in topics) > _MOST_MESSAGES:
            raise InputError(Problem("the recording is too long", path, fix="cut it with the tools of ROS"))
        for connection, received, data in bag.messages([c for c in bag.connections if c.topic in topics]):
            message = bag.deserialize(data, connection.msgtype)
            if topics[connection.topic] == "joints":
                _add_joints(recording.joints, connection.topic, message, received)
            elif topics[connection.topic] == "measured":
                _add_pose(recording.measured, message, received)
            elif topics[connection.topic] == "images":
                recording.measured.add(_stamp(message, received), received, ())
            elif recording.commanded is not None:
                _add_pose(recording.commanded, message, received)
        return recording


@contextmanager
def _opened(path: str) -> Iterator[AnyReader]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        message = f"{path} is a recording of ROS messages, which needs an optional package; run {install_advice('ros')}"
        raise UsageError(message) from error
    try:
        with AnyReader([Path(path)], default_typestore=get_typestore(Stores.LATEST)) as bag:
            yield bag
    except (InputError, UsageError, MemoryError):
        raise
    except Exception as error:  # the readers of rosbags, of SQLite and of the codecs share no base class
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        fix = "give the folder with metadata.yaml, or the .mcap file, complete and closed by the recorder"
        raise InputError(Problem(f"cannot be read as a ROS recording ({reason})", path, fix=fix)) from error


def _roles(
    path: str, types: Mapping[str, str], counts: Mapping[str, int], options: BagOptions, shown: str
) -> dict[str, str]:
    """Return the topic of each role, ``shown`` the measured one: those stated, else the only one that can have it."""
    stated = {"joints": options.joints, shown: getattr(options, shown), "commanded": options.commanded}
    roles = {role: topic for role, topic in stated.items() if topic}
    for role, topic in roles.items():
        _check_topic(path, role, topic, types)
    free = [topic for topic in types if counts[topic] and topic not in roles.values()]
    if "joints" not in roles and "commanded" not in roles:
        joints = [topic for topic in free if types[topic] == "JointState"] or [t for t in free if types[t] in _JOINTS]
        if len(joints) > 1:
            raise _question(path, "joints", joints, types, counts)
        roles |= {"joints": joints[0]} if joints else {}
    poses = [topic for topic in free if types[topic] in _POSES]
    orders = [topic for topic in poses if any(word in topic.lower() for word in _COMMAND_WORDS)]
    if shown not in roles:
        pictures = [topic for topic in free if types[topic] in _IMAGES]
        measured = pictures if shown == "images" else [topic for topic in poses if topic not in orders]
        if len(measured) != 1:
            raise _question(path, shown, measured or poses, types, counts)
        roles[shown] = measured[0]
    if "commanded" not in roles and "joints" not in roles:
        if len(orders) > 1:
            raise _question(path, "commanded", orders, types, counts)
        roles |= {"commanded": orders[0]} if orders else {}
    return roles


def _check_topic(path: str, role: str, topic: str, types: Mapping[str, str]) -> None:
    name = topic.partition(":")[0]
    expected = {"joints": _JOINTS, "images": _IMAGES}.get(role, _POSES | {_TRANSFORMS})
    if name not in types:
        near = difflib.get_close_matches(name, types, 1)
        hint = f"did you mean {near[0]}?" if near else f"it has {', '.join(list(types)[:_SHOWN])}"
        raise InputError(Problem(f"the recording has no topic {name}", path, fix=hint))
    if types[name] not in expected:
        message = f"topic {name} holds {types[name]}, expected {', '.join(sorted(expected))}"
        raise InputError(Problem(message, path, fix=f"choose another topic with `bag`, as in {EXAMPLE}"))
    if types[name] == _TRANSFORMS and ":" not in topic:
        fix = f"name the child frame, as in {role}={name}:tracker_target"
        raise InputError(Problem(f"topic {name} holds transforms of many frames", path, fix=fix))


def _question(
    path: str, role: str, candidates: Sequence[str], types: Mapping[str, str], counts: Mapping[str, int]
) -> InputError:
    shown = list(candidates) or [topic for topic in types if counts[topic]]
    listed = ", ".join(f"{topic} ({types[topic]}, {counts[topic]} messages)" for topic in shown[:_SHOWN])
    contents = {"joints": "joint states", "measured": "measured poses", "commanded": "commanded poses"}
    content = contents.get(role, "images of the board")
    message = f"the recording does not say which topic has the {content}: it has {listed or 'no messages'}"
    example = candidates[0] if candidates else "/tf:CHILD_FRAME" if _TRANSFORMS in types.values() else "/TOPIC"
    with_board = "; or state the `board` that its images show" * (
        role == "measured" and not _IMAGES.isdisjoint(types.values())
    )
    return InputError(Problem(message, path, fix=f"give `bag`, as in {role}={example}{with_board}"))


def _stamp(message: Any, received: int) -> int:
    """Return the time of a message's header, ns; the time of recording where it has none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    time = 0 if stamp is None else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    return time or received


def _add_joints(joints: dict[str, Samples], topic: str, message: Any, received: int) -> None:
    names = getattr(message, "name", None)
    if names is None:
        names = message.joint_names
        points = [getattr(message, key, None) for key in ("reference", "desired")]
        positions = next(point.positions for point in points if point is not None)
    else:
        positions = message.position
    stamp = _stamp(message, received)
    for name, value in zip(names, positions, strict=False):  # a message without positions has velocities only
        samples = joints.setdefault(str(name), Samples(topic))
        samples.add(stamp, received, (float(value),))


def _add_pose(samples: Samples, message: Any, received: int) -> None:
    child = samples.topic.partition(":")[2]
    messages = [part for part in message.transforms if part.child_frame_id == child] if child else [message]
    for part in messages:
        header = getattr(part, "header", None)
        samples.frame = samples.frame or str(getattr(header, "frame_id", ""))
        samples.add(_stamp(part, received), received, _pose_values(part))


def _pose_values(message: Any) -> tuple[float, ...]:
    """Return x, y, z, qx, qy, qz, qw and the standard deviations of x, y, z; NaN for what the message does not have."""
    spread = (np.nan,) * 3
    body = getattr(message, "pose", None) or getattr(message, "point", None) or getattr(message, "transform", message)
    if hasattr(body, "covariance"):
        variances = np.asarray(body.covariance, dtype=float).reshape(6, 6).diagonal()[:3]
        spread = tuple(np.sqrt(variances)) if np.all(variances > 0) else spread
        body = body.pose
    place = getattr(body, "position", None) or getattr(body, "translation", body)
    turn = getattr(body, "orientation", None) or getattr(body, "rotation", None)
    quaternion = (np.nan,) * 4 if turn is None else (turn.x, turn.y, turn.z, turn.w)
    return (float(place.x), float(place.y), float(place.z), *map(float, quaternion), *spread)


# Table of a recording: a row for each measured pose, with the joints or the command at its time.

_SAME_CLOCK = 0.25
"""Largest difference between the delays of two topics whose stamps are of one clock, s."""
_POSE = ("position.x", "position.y", "position.z", "orientation.x", "orientation.y", "orientation.z", "orientation.w")
_SPREAD = ("std x [m]", "std y [m]", "std z [m]")


def _tracks(recording: Recording, options: BagOptions, origin: int) -> list[Track]:
    tracks = []
    for name, samples in recording.joints.items():
        times, values = _sorted(samples, options, origin)
        tracks.append(Track((f"{samples.topic}/{name}/position",), times, np.unwrap(values), repeats_last=False))
    if recording.commanded is not None and recording.commanded.values:
        times, values = _sorted(recording.commanded, options, origin)
        n = 7 if np.isfinite(values[3:7]).all() else 3
        names = tuple(f"commanded/{name}" for name in _POSE[:n])
        tracks.append(Track(names, times, values[:n], repeats_last=True))
    return tracks


def _sorted(samples: Samples, options: BagOptions, origin: int) -> tuple[Array, Array]:
    """Return times (s, ascending) and values; of messages with one time, the last."""
    times = samples.times(options.clock) - origin
    order = np.argsort(times, kind="stable")
    last = np.append(np.diff(times[order]) > 0, True)
    return times[order][last] / 1e9, samples.array()[:, order][:, last]


def _check_clocks(path: str, recording: Recording, options: BagOptions) -> None:
    """Raise an error where the stamps of two topics are not of one clock, as the times of recording show."""
    if options.clock == "recorder":
        return
    others = list(recording.joints.values())[:1] + ([recording.commanded] if recording.commanded else [])
    topics = [samples for samples in (recording.measured, *others) if samples.values]
    delays = {s.topic: float(np.median(np.array(s.received) - np.array(s.stamped))) / 1e9 for s in topics}
    low, high = min(delays, key=delays.__getitem__), max(delays, key=delays.__getitem__)
    if delays[high] - delays[low] > _SAME_CLOCK:
        message = (
            f"the time stamps of {low} and {high} are not from the same clock: compared with the times of recording, "
            f"{high} is {delays[high] - delays[low]:.3g} s later than {low}"
        )
        fix = "synchronise the clocks, or use the times of recording: `bag` with clock=recorder"
        raise InputError(Problem(message, path, fix=fix))


def _use_rest(path: str, stands: NDArray[np.int64], options: BagOptions) -> bool:
    """Return whether each stand makes one row.

    Raises:
        InputError: The robot moved during some samples and nobody said whether to use them, or it never stood.
    """
    if not stands.size:
        return False
    moving = int(np.sum(stands < 0))
    if options.at is None and moving:
        message = f"the robot moved during {moving} of {stands.size} measured poses, where a delay makes large errors"
        fix = "give `bag` with at=rest for one pose at each stop, the mean of its samples, or at=any for every sample"
        raise InputError(Problem(message, path, fix=fix))
    if options.at == "rest" and moving == stands.size:
        raise InputError(
            Problem("the robot never stood still during a measured pose", path, fix="`bag`: at=any uses all")
        )
    return options.at == "rest"


def _columns(
    measured: Samples, tracks: list[Track], times: Array, groups: list[NDArray[np.int64]]
) -> list[tuple[str, NDArray[Any]]]:
    """Return the columns of numbers, the mean of each group in a row."""
    columns: list[tuple[str, NDArray[Any]]] = []
    for track in tracks:
        values = track.at(times)
        columns += [(name, _means(row, groups)) for name, row in zip(track.names, values, strict=True)]
    values = measured.array()
    columns += [(name, _means(row, groups)) for name, row in zip(_POSE[:3], values[:3], strict=True)]
    if np.isfinite(values[3:7]).all():
        columns += list(zip(_POSE[3:], _mean_turns(values[3:7], groups), strict=True))
    if np.isfinite(values[7:]).all():
        columns += [(name, _means(row, groups)) for name, row in zip(_SPREAD, values[7:], strict=True)]
    return columns


def _means(row: Array, groups: list[NDArray[np.int64]]) -> Array:
    return np.array([row[group].mean() for group in groups])


def _mean_turns(quaternions: Array, groups: list[NDArray[np.int64]]) -> Array:
    """Return mean unit quaternions ``(4, G)``: those nearest to all of a group (Markley et al., 2007)."""
    result = quaternions[:, [group[0] for group in groups]].copy()
    for i, group in enumerate(groups):
        if group.size > 1:
            members = quaternions[:, group] / np.linalg.norm(quaternions[:, group], axis=0)
            result[:, i] = np.linalg.eigh(members @ members.T)[1][:, -1]
    return result


def _digest(path: str) -> str:
    """Return the digest of the recording's bytes; a folder's is that of its files' names and bytes."""
    root = Path(path)
    files = sorted(item for item in root.iterdir() if item.is_file()) if root.is_dir() else [root]
    lines = [f"{item.name} {sha256_of(item)}\n" for item in files]
    return sha256_of(files[0]) if len(files) == 1 else hashlib.sha256("".join(lines).encode()).hexdigest()


def _remark(recording: Recording, n_rows: int, n_standing: int, n_samples: int, are_stands: bool) -> str:
    measured = recording.measured
    frame = f" in frame {measured.frame}" if measured.frame else ""
    parts = [f"measured poses of {measured.topic}{frame}"]
    if recording.joints:
        topic = next(iter(recording.joints.values())).topic
        parts.append(f"joints of {topic}, interpolated to their times, as commanded")
    if recording.commanded is not None:
        parts.append(f"commands of {recording.commanded.topic}")
    if are_stands:
        parts.append(f"{n_standing} of {n_samples} samples at {n_rows} stops, one pose each")
    return "; ".join(parts)


# Points of a board in the images of a recording.

_ENCODINGS = {
    **dict.fromkeys(("mono8", "8uc1"), (1, "")),
    **dict.fromkeys(("rgb8", "8uc3"), (3, "RGB")),
    **{"bgr8": (3, "BGR"), "rgba8": (4, "RGBA"), "bgra8": (4, "BGRA")},
    # OpenCV names the second row of the pattern.
    **{"bayer_rggb8": (1, "BayerBG"), "bayer_bggr8": (1, "BayerRG")},
    **{"bayer_gbrg8": (1, "BayerGR"), "bayer_grbg8": (1, "BayerGB")},
}
"""Bytes of a pixel, and name of the colours as OpenCV has it, of each encoding."""


def _points_of_images(path: str, stated: BagOptions, options: TableOptions) -> ColumnTable:
    """Return the points of the board in images at which the arm stands, with its joints."""
    cv2, recording = opencv(path), read_recording(path, stated, of_images=True)
    images = recording.measured
    lacking = "no images" if not images.values else "no joint states beside its images" if not recording.joints else ""
    if lacking:
        raise InputError(Problem(f"topic {images.topic}: {lacking}", path, fix="record both at the same time"))
    _check_clocks(path, recording, stated)
    stamps = images.times(stated.clock)
    times = (stamps - stamps[0]) / 1e9
    tracks = _tracks(recording, stated, int(stamps[0]))
    used = stops(path, times, tracks, stated.at, STANDING)
    names = [name for track in tracks for name in track.names]
    columns = [
        dict(zip(names, values, strict=True))
        for values in np.vstack([track.at(times[used]) for track in tracks]).T.tolist()
    ]
    for column, stamp in zip(columns, stamps[used].tolist(), strict=True):
        column["header.stamp.sec"], column["header.stamp.nanosec"] = divmod(stamp, 1_000_000_000)

    def shots() -> Iterator[Shot]:
        with _opened(path) as bag:
            messages = bag.messages([item for item in bag.connections if item.topic == images.topic])
            wanted = dict(zip(used.tolist(), columns, strict=True))
            for number, (connection, _, data) in enumerate(messages):
                if number in wanted:
                    message, name = bag.deserialize(data, connection.msgtype), f"image_{number + 1}"
                    if hasattr(message, "detections"):
                        tags = _tags(path, message)
                        size = np.max([np.zeros(2), *(each.max(axis=0) for each in tags.values())], axis=0) + 50
                        yield Shot(name, np.full(size[::-1].astype(int), 255, np.uint8), wanted[number], tags)
                    else:
                        yield Shot(name, _grey(path, message, cv2), wanted[number])

    how = "images" if stated.at == "any" else "stops of the robot"
    joints = next(iter(recording.joints.values())).topic
    remark = (
        f"{used.size} {how} in {times.size} images of {images.topic}; joints of {joints}, interpolated to their times"
    )
    return table_of(shots(), used.size, path, options, partial(_digest, path), remark)


def _tags(path: str, message: Any) -> dict[int, Array]:
    """Return the corners of detected AprilTags in the order and with the pixels of OpenCV, by their numbers.

    The library of AprilTag goes round the other way, and its pixels have their corners, not middles, at whole numbers.
    """
    without = Problem("the detected tags have no corners", path, fix="record the images, or the tags of ROS 2")
    refuse((not all(hasattr(tag, "corners") for tag in message.detections), without))
    corners = {int(tag.id): [(point.x, point.y) for point in tag.corners] for tag in message.detections}
    return {number: np.array(each, dtype=float)[[1, 0, 3, 2]] - 0.5 for number, each in corners.items()}


def _grey(path: str, message: Any, cv2: Any) -> Any:
    """Return the grey image of a message; None for a compressed one that cannot be read."""
    if not hasattr(message, "encoding"):
        return decoded(cv2, bytes(message.data))
    encoding = message.encoding.lower()
    unknown = Problem(f"images are encoded as {encoding}", path, fix=f"record them as {', '.join(_ENCODINGS)}")
    refuse((encoding not in _ENCODINGS, unknown))
    depth, colours = _ENCODINGS[encoding]
    rows = np.asarray(message.data, dtype=np.uint8).reshape(message.height, message.step)[:, : message.width * depth]
    pixels = np.ascontiguousarray(rows.reshape(message.height, message.width, *([depth] if depth > 1 else [])))
    return cv2.cvtColor(pixels, getattr(cv2, f"COLOR_{colours}2GRAY")) if colours else pixels
