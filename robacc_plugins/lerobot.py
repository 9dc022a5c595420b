"""Data sets of LeRobot as tables: frames of a camera in which the arm stands still, and the board that each shows.

A data set (format 2 or 3) is a folder with ``meta/info.json``, the joints of each frame as ``observation.state`` in
Parquet files, and images: videos, or pictures in the Parquet files. The joints are in degrees, in rad, or in percent of
the range of each motor (-100 to 100), of which the arm's calibration file makes degrees.

Source: huggingface/lerobot, ``datasets/utils.py`` and ``motors/motors_bus.py``.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem, UsageError, install_advice, refuse
from robacc.geometry import Array
from robacc.io.column_table import ColumnTable
from robacc.io.files import read_text, sha256_of
from robacc.io.table import TableOptions
from robacc_plugins.joint_zeros import COUNTS, read_calibration
from robacc_plugins.photos import Shot, decoded, opencv, table_of
from robacc_plugins.recordings import BagOptions, Track, arrivals, stops

_INFO = "meta/info.json"
_STATE, _IMAGES = "observation.state", "observation.images."
_COUNT = math.degrees(1.0 / COUNTS)
"""degrees, of a servo."""
_FLICKER, _MOVED = 1.5, 3.0
"""Counts within which a servo stands still, and beyond which it moved."""
_APART = 1e6
"""s between two episodes on one clock."""
_OTHER_RATE = 0.05
"""Share by which the rate of a video differs from that of its data set only by mistake."""
_ASSUMED = "taken as degrees (for percent, give their calibration in `bag`)"
_MOST_PERCENT = 100.0
Place = tuple[Path, float]
"""File of an image, and its time in the video, s, or its row."""


def takes(path: str, first: bytes) -> bool:
    """Return whether a folder is a data set."""
    return Path(path, _INFO).is_file()


def read(path: str, options: TableOptions) -> ColumnTable:
    """Return the points of the board in the frames of a data set, with the joints of each.

    Raises:
        InputError: A file cannot be read, the data set leaves a question open, or no frame shows the board.
        UsageError: A statement is wrong, or an extra is not installed.
    """
    try:
        from pyarrow import ArrowException
    except ImportError:
        raise UsageError(f"{path} has Parquet files; run {install_advice('parquet')}") from None
    cv2, stated = opencv(path), BagOptions.of(options.bag)
    try:
        info = json.loads(read_text(Path(path, _INFO)))
        version = str(info.get("codebase_version", "v3.0"))
        other = Problem(f"has format {version}, expected 2 or 3", path, fix="convert it with LeRobot")
        refuse((not version.startswith(("v2.", "v3.")), other))
        camera, fps = _camera(path, info["features"], stated), float(info["fps"])
        if not fps > 0.0:
            raise ValueError(f"fps is {fps:g}")
        state, _, prefix = (stated.joints or _STATE).partition(":")
        has = f"it has {', '.join(info['features'])}"
        refuse((state not in info["features"], Problem(f"the data set has no {state}", path, fix=has)))
        files, columns = _columns(path, "data", (state, "episode_index", "frame_index"))
        episode, frame = columns["episode_index"], columns["frame_index"]
        if not episode.size or columns[state].size % episode.size:
            raise ValueError(f"{state} has {columns[state].size} values in {episode.size} frames")
        names, q, unit = _joints(path, info, state, prefix, columns[state].reshape(episode.size, -1).T, stated)
        times = episode * _APART + frame / fps
        if not np.all(np.diff(times) > 0):
            raise ValueError("its frames are not in the order of time")
        has_joints = np.flatnonzero(np.isfinite(q).all(axis=0))
        refuse((not has_joints.size, Problem(f"no frame has all joints in {state}", path)))
        track = Track((), times[has_joints], q[:, has_joints], repeats_last=False)
        used = has_joints[stops(path, track.times, [track], stated.at, _FLICKER * _COUNT)]
        places = _places(path, info, camera, files, columns)
        at = [places(row) for row in used.tolist()]
    except (LookupError, TypeError, ValueError, AttributeError, ZeroDivisionError, ArrowException) as error:
        reason = f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
        fix = "download it whole; other formats than 2.0, 2.1 and 3.0 are converted by LeRobot"
        raise InputError(Problem(f"cannot be read as a data set of LeRobot ({reason})", path, fix=fix)) from error
    keys = [*(f"q{i}_deg" for i in range(1, len(q) + 1)), *(f"dir_q{i}" for i in range(1, len(q) + 1))]
    values = np.vstack((q[:, used], arrivals(track, times[used], _MOVED * _COUNT))).T.tolist()
    shots = (
        Shot(f"episode_{int(episode[i])}_frame_{int(frame[i])}", image, dict(zip(keys, row, strict=True)))
        for i, image, row in zip(used.tolist(), _images(at, camera, fps, cv2), values, strict=True)
    )
    lost = [file for file, _ in at if not file.is_file()]
    refuse(
        *((True, Problem("does not exist", str(file), fix="download the data set with its videos")) for file in lost)
    )
    read_files = dict.fromkeys((Path(path, _INFO), *files, *(file for file, _ in at)))
    digest = hashlib.sha256("".join(f"{file.name} {sha256_of(file)}\n" for file in read_files).encode())
    how = "frames" if stated.at == "any" else "stops of the arm"
    remark = f"{used.size} {how} before {camera}; joints {', '.join(names)} of {state}, {unit}"
    table = table_of(shots, used.size, path, options, digest.hexdigest, remark)
    if unit == _ASSUMED and np.nanmax(np.abs(q)) <= _MOST_PERCENT:
        fix = "if LeRobot recorded without use_degrees, state the arm's calibration with `bag`: calibration=my_arm.json"
        text = f"no joint goes beyond 100, which may be degrees or percent; taken as degrees: {fix}"
        table.log.warn(text, of_file=True)
    if gaps := episode.size - has_joints.size:
        table.log.warn(f"{gaps} of {episode.size} frames have no joints in {state} and are left out", of_file=True)
    return table


def _columns(path: str, folder: str, names: Sequence[str]) -> tuple[list[Path], dict[str, Any]]:
    """Return the Parquet files of a folder, and columns of all of them as arrays; lists of numbers are flat."""
    from pyarrow import parquet

    files = sorted(Path(path, folder).rglob("*.parquet"))
    refuse((not files, Problem(f"has no Parquet files in {folder}", path, fix="download the data set whole")))
    tables = [parquet.read_table(file, columns=[*names]) for file in files]
    chunks = {name: [chunk for table in tables for chunk in table.column(name).chunks] for name in names}
    columns = {
        name: np.concatenate([(each.flatten() if hasattr(each, "flatten") else each).to_numpy(False) for each in parts])
        for name, parts in chunks.items()
    }
    return files, {**columns, "file": np.repeat(np.arange(len(files)), [table.num_rows for table in tables])}


def _camera(path: str, features: Mapping[str, Any], stated: BagOptions) -> str:
    """Return the key of the images to read: those stated, else the only ones."""
    cameras = [key for key, feature in features.items() if feature["dtype"] in ("video", "image")]
    named = [key for key in cameras if stated.images in (None, key, key.removeprefix(_IMAGES))]
    listed = ", ".join(key.removeprefix(_IMAGES) for key in cameras)
    wrong = f"has no camera {stated.images}" if stated.images else "has several cameras" if cameras else "has no images"
    fix = f"name one with `bag`, as in images={listed.partition(',')[0]}" if cameras else "record it with a camera"
    refuse((len(named) != 1, Problem(f"{wrong}{f'; its cameras are {listed}' * bool(cameras)}", path, fix=fix)))
    return named[0]


def _joints(
    path: str, info: Mapping[str, Any], state: str, prefix: str, values: Array, stated: BagOptions
) -> tuple[list[str], Array, str]:
    """Return names and values ``(J, N)`` of the arm's joints, degrees, and what they were in; without the gripper."""
    listed = info["features"][state].get("names") or [f"joint {i + 1}" for i in range(len(values))]
    flat = listed if isinstance(listed, list) else [name for names in listed.values() for name in names]
    if len(flat) != len(values):
        raise ValueError(f"{_INFO} names {len(flat)} values of {state}, and its frames have {len(values)}")
    kept = [i for i, name in enumerate(flat) if "gripper" not in name and name.startswith(prefix)]
    kept = [i for i in kept if flat[i].endswith(".pos")] or kept
    names, q = [flat[i].removesuffix(".pos").removeprefix(prefix) for i in kept], values[kept].astype(float)
    two = any(name.startswith("left") for name in names) and any(name.startswith("right") for name in names)
    arms = Problem(f"{state} has the joints of two arms", path, fix=f"name one with `bag`, as in joints={state}:left_")
    refuse((not names, Problem(f"{state} has no joints {prefix}", path, fix=f"it has {', '.join(flat)}")), (two, arms))
    if stated.calibration is not None:
        try:
            motors = read_calibration(read_text(stated.calibration), stated.calibration)
        except UsageError as error:
            raise InputError(str(error)) from None
        missing = [name for name in names if name not in motors]
        unknown = Problem(f"has no motor {', '.join(missing)}", stated.calibration, fix=f"{path} has these joints")
        refuse((missing, unknown))
        # LeRobot applies the drive mode to motors of Feetech only.
        is_turned = any(arm in str(info.get("robot_type")) for arm in ("so10", "so_follower", "lekiwi"))
        signs = [-1.0 if motors[name]["drive_mode"] and is_turned else 1.0 for name in names]
        spans = [motors[name]["range_max"] - motors[name]["range_min"] for name in names]
        return names, q * (np.array(signs) * spans * _COUNT / 200.0)[:, None], f"percent by {stated.calibration}"
    largest = np.nan_to_num(np.abs(q)).max(axis=1)
    if largest.max() <= 2.0 * math.pi:
        return names, np.degrees(q), "in rad"
    cut = [name for name, most in zip(names, largest.tolist(), strict=True) if most == 100.0]
    fix = "state the arm's calibration file with `bag`, as in calibration=my_arm.json"
    percent = f"{', '.join(cut)} ends at 100 exactly: the joints are in percent of their ranges"
    refuse((cut and largest.max() == 100.0, Problem(percent, path, fix=fix)))
    return names, q, _ASSUMED


def _places(path: str, info: Mapping[str, Any], camera: str, files: Sequence[Path], columns: Mapping[str, Any]) -> Any:
    """Return a function that gives the place of the image of a row."""
    episode, time = columns["episode_index"], columns["frame_index"] / float(info["fps"])
    if info["features"][camera]["dtype"] == "image":
        starts = np.searchsorted(columns["file"], columns["file"])
        return lambda row: (files[columns["file"][row]], float(row - starts[row]))
    if "file_index" not in info["video_path"]:
        chunks = int(info["chunks_size"])

        def of_episode(row: int) -> Place:
            number = int(episode[row])
            parts = {"episode_chunk": number // chunks, "episode_index": number, "video_key": camera}
            return Path(path, info["video_path"].format(chunk_index=number // chunks, **parts)), float(time[row])

        return of_episode
    keys = [f"videos/{camera}/{name}" for name in ("chunk_index", "file_index", "from_timestamp")]
    _, videos = _columns(path, "meta/episodes", ("episode_index", *keys))
    of = {int(number): at for number, *at in zip(videos["episode_index"], *(videos[key] for key in keys), strict=True)}

    def of_file(row: int) -> Place:
        number = int(episode[row])
        if number not in of:
            raise ValueError(f"meta/episodes has no episode {number}")
        chunk, file, start = of[number]
        parts = {"chunk_index": int(chunk), "file_index": int(file), "video_key": camera}
        return Path(path, info["video_path"].format(**parts)), float(start + time[row])

    return of_file


def _images(at: Sequence[Place], camera: str, fps: float, cv2: Any) -> Iterator[NDArray[np.uint8] | None]:
    """Yield the grey images at places."""
    from pyarrow import parquet

    for file, places in groupby(at, lambda place: place[0]):
        times = [time for _, time in places]
        if file.suffix == ".parquet":
            missing = camera not in parquet.read_schema(file).names
            refuse(
                (missing, Problem(f"has no column {camera}", str(file), fix="download the data set with its images"))
            )
            rows = parquet.read_table(file, columns=[camera]).column(0).take([int(time) for time in times]).to_pylist()
            yield from (decoded(cv2, (image or {}).get("bytes") or b"") for image in rows)
        else:
            yield from _frames(file, times, fps, cv2)


def _frames(video: Path, times: Sequence[float], fps: float, cv2: Any) -> Iterator[NDArray[np.uint8]]:
    """Yield the grey frames of a video at times, s: by PyAV if it is installed, else by OpenCV, which reads no AV1.

    Raises:
        InputError: The video cannot be decoded.
    """
    try:
        av: Any = importlib.import_module("av")
    except ImportError:
        av = None
    fix = (
        f"AV1, in which LeRobot writes, needs PyAV; run {install_advice('lerobot')}"
        if av is None
        else "download it again"
    )
    if av is None:
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # This error says what the library would.
        capture = cv2.VideoCapture(str(video))
        _check(video, capture.get(cv2.CAP_PROP_FPS), int(capture.get(cv2.CAP_PROP_FRAME_COUNT)), fps, times)
        for time in times:
            capture.set(cv2.CAP_PROP_POS_FRAMES, round(time * fps))
            is_read, image = capture.read()
            refuse((not is_read, Problem(f"cannot be decoded at {time:.3f} s", str(video), fix=fix)))
            yield cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        return
    try:
        with av.open(str(video)) as container:
            stream = container.streams.video[0]
            _check(video, float(stream.average_rate or 0.0), stream.frames, fps, times)
            for time in times:
                container.seek(max(int((time - 0.5 / fps) / stream.time_base), 0), stream=stream)
                frames = (each for each in container.decode(stream) if each.time > time - 0.5 / fps)
                yield next(frames).to_ndarray(format="gray")
    except (av.error.FFmpegError, StopIteration, IndexError) as error:
        raise InputError(Problem(f"cannot be decoded ({error})", str(video), fix=fix)) from error


def _check(video: Path, rate: float, count: int, fps: float, times: Sequence[float]) -> None:
    """Refuse a video whose frames per second, where it states them, are not those of its data set, or that is shorter.

    Raises:
        InputError: It is.
    """
    message = f"has {rate:.4g} frames per second, and {_INFO} says {fps:.4g}"
    is_other = rate > 0.0 and abs(rate - fps) > _OTHER_RATE * fps
    short = f"has {count} frames, and the joints have one at {max(times):.3f} s"
    refuse(
        (is_other, Problem(message, str(video), fix="one of them is wrong; correct fps")),
        (0 < count <= round(max(times) * fps), Problem(short, str(video), fix="download it again")),
    )
