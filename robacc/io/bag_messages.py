"""Joint states and poses of a recording: ROS 2 bags (SQLite or MCAP), MCAP files of ROS messages, and ROS 1 bags."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem, UsageError, install_advice
from robacc.geometry import Array
from robacc.io.bag_options import EXAMPLE, BagOptions

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

_JOINTS = frozenset({"JointState", "JointTrajectoryControllerState"})
_POSES = frozenset({"PoseStamped", "PoseWithCovarianceStamped", "PointStamped", "TransformStamped", "Pose", "Point"})
_TRANSFORMS = "TFMessage"
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
    """x, y, z, qx, qy, qz, qw and the standard deviations of x, y, z; NaN for what the messages do not have."""
    commanded: Samples | None


def read_recording(path: str, options: BagOptions) -> Recording:
    """Return the joint states and poses of a recording.

    Raises:
        InputError: The recording is damaged, or it does not say which topics to take.
        UsageError: The extra ``ros`` is not installed.
    """
    with _opened(path) as bag:
        types = {topic: (info.msgtype or "").rpartition("/")[2] for topic, info in bag.topics.items()}
        counts = {topic: info.msgcount for topic, info in bag.topics.items()}
        roles = _roles(path, types, counts, options)
        recording = Recording({}, Samples(roles["measured"]), None)
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
    except (InputError, UsageError):
        raise
    except (MemoryError, KeyboardInterrupt):
        raise
    except Exception as error:  # the readers of rosbags, of SQLite and of the codecs share no base class
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        fix = "give the folder with metadata.yaml, or the .mcap file, complete and closed by the recorder"
        raise InputError(Problem(f"cannot be read as a ROS recording ({reason})", path, fix=fix)) from error


def _roles(path: str, types: Mapping[str, str], counts: Mapping[str, int], options: BagOptions) -> dict[str, str]:
    """Return the topic of each role: those stated, else the only one that can have it."""
    stated = {"joints": options.joints, "measured": options.measured, "commanded": options.commanded}
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
    if "measured" not in roles:
        measured = [topic for topic in poses if topic not in orders]
        if len(measured) != 1:
            raise _question(path, "measured", measured or poses, types, counts)
        roles["measured"] = measured[0]
    if "commanded" not in roles and "joints" not in roles:
        if len(orders) > 1:
            raise _question(path, "commanded", orders, types, counts)
        roles |= {"commanded": orders[0]} if orders else {}
    return roles


def _check_topic(path: str, role: str, topic: str, types: Mapping[str, str]) -> None:
    import difflib

    name = topic.partition(":")[0]
    expected = _JOINTS if role == "joints" else _POSES | {_TRANSFORMS}
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
    content = {"joints": "joint states", "measured": "measured poses", "commanded": "commanded poses"}[role]
    message = f"the recording does not say which topic has the {content}: it has {listed or 'no messages'}"
    example = candidates[0] if candidates else "/tf:CHILD_FRAME" if _TRANSFORMS in types.values() else "/TOPIC"
    return InputError(Problem(message, path, fix=f"give `bag`, as in {role}={example}"))


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
        samples.stamped.append(stamp)
        samples.received.append(received)
        samples.values.append((float(value),))


def _add_pose(samples: Samples, message: Any, received: int) -> None:
    child = samples.topic.partition(":")[2]
    messages = [part for part in message.transforms if part.child_frame_id == child] if child else [message]
    for part in messages:
        header = getattr(part, "header", None)
        samples.frame = samples.frame or str(getattr(header, "frame_id", ""))
        samples.stamped.append(_stamp(part, received))
        samples.received.append(received)
        samples.values.append(_pose_values(part))


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


def is_recording_folder(path: str) -> bool:
    """Return whether a path is the folder of a ROS 2 bag."""
    return Path(path, "metadata.yaml").is_file()


def recorded_files(path: str) -> list[Path]:
    """Return the files of a recording in the order of their names."""
    root = Path(path)
    return sorted(item for item in root.iterdir() if item.is_file()) if root.is_dir() else [root]
