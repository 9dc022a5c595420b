"""Table of a recording: a row for each measured pose, with the joints or the command at its time."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem
from robacc.geometry import Array
from robacc.io.bag_messages import Recording, Samples, read_recording, recorded_files
from robacc.io.bag_options import BagOptions
from robacc.io.column_table import ColumnTable
from robacc.io.table_parts import TableOptions

_LONGEST_GAP = 0.1
"""Time between neighbouring samples over which a moving joint is interpolated, s."""
_WINDOW = 0.1
"""The robot stands at a sample if nothing moves between this time before and after it, s."""
_STANDING = 2e-4
"""Largest change in that time of a robot that stands, rad and m: 1 mrad/s, above the noise of encoders."""
_SAME_CLOCK = 0.25
"""Largest difference between the delays of two topics whose stamps are of one clock, s."""
_POSE = ("position.x", "position.y", "position.z", "orientation.x", "orientation.y", "orientation.z", "orientation.w")
_SPREAD = ("std x [m]", "std y [m]", "std z [m]")


def bag_table(path: str, options: TableOptions) -> ColumnTable:
    """Return the poses of a recording as a table with the names of ROS messages, in SI.

    Raises:
        InputError: The recording cannot be read, or leaves a question open.
        UsageError: The extra ``ros`` is not installed.
    """
    recording = read_recording(path, options.bag)
    measured = recording.measured
    if not measured.values:
        raise InputError(Problem(f"topic {measured.topic} has no measured poses", path))
    _check_clocks(path, recording, options.bag)
    origin = int(measured.times(options.bag.clock)[0])
    tracks = _tracks(recording, options.bag, origin)
    times = (measured.times(options.bag.clock) - origin) / 1e9
    stands = _stands(times, tracks)
    are_stands = _use_rest(path, stands, options.bag)
    groups = _groups(stands) if are_stands else [np.array([i]) for i in range(times.size)]
    columns = _columns(measured, tracks, times, groups)
    columns += _time_columns(origin, times, groups)
    if not are_stands and stands.size and stands.min() >= 0 and np.unique(stands).size < stands.size:
        columns.append(("visit", (stands + 1).astype(str)))
    return ColumnTable(
        columns,
        path,
        options,
        _digest(path),
        _remark(recording, len(groups), int(np.sum(stands >= 0)), times.size, are_stands),
    )


@dataclass(frozen=True, slots=True)
class _Track:
    """Values over time of a joint, or of the coordinates of a command."""

    names: tuple[str, ...]
    times: Array
    """``(M,)`` s, ascending."""
    values: Array
    """``(K, M)``"""
    repeats_last: bool
    """A command is valid until the next; a joint moves from sample to sample."""

    def at(self, times: Array) -> Array:
        """Return the values ``(K, N)`` at ``times``, NaN where the recording does not show them."""
        if self.repeats_last:
            before = np.searchsorted(self.times, times, side="right") - 1
            return np.where(before >= 0, self.values[:, np.maximum(before, 0)], np.nan)
        result = np.array([np.interp(times, self.times, row) for row in self.values])
        after = np.clip(np.searchsorted(self.times, times), 0, self.times.size - 1)
        before = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, self.times.size - 1)
        distance = np.maximum(np.abs(self.times[after] - times), np.abs(times - self.times[before]))
        moved = np.abs(self.values[:, after] - self.values[:, before]).max(axis=0)
        outside = (times < self.times[0]) | (times > self.times[-1])
        unknown = (distance > _LONGEST_GAP) & (outside | (moved > _STANDING))
        return np.where(unknown, np.nan, result)

    def change(self, times: Array) -> Array:
        """Return the largest change ``(N,)`` of a value around ``times``."""
        rows = self.values[:3] if self.repeats_last else self.values
        sides = [
            np.array([np.interp(times + shift, self.times, row) for row in rows]) for shift in (-_WINDOW, 0.0, _WINDOW)
        ]
        change: Array = np.ptp(np.array(sides), axis=0).max(axis=0)
        return change


def _tracks(recording: Recording, options: BagOptions, origin: int) -> list[_Track]:
    tracks = []
    for name, samples in recording.joints.items():
        times, values = _sorted(samples, options, origin)
        tracks.append(_Track((f"{samples.topic}/{name}/position",), times, np.unwrap(values), repeats_last=False))
    if recording.commanded is not None and recording.commanded.values:
        times, values = _sorted(recording.commanded, options, origin)
        n = 7 if np.isfinite(values[3:7]).all() else 3
        names = tuple(f"commanded/{name}" for name in _POSE[:n])
        tracks.append(_Track(names, times, values[:n], repeats_last=True))
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


def _stands(times: Array, tracks: list[_Track]) -> NDArray[np.int64]:
    """Return the number ``(N,)`` of the stand in which each sample was measured, -1 in motion; empty without tracks."""
    if not tracks:
        return np.empty(0, dtype=np.int64)
    moving = np.max([track.change(times) for track in tracks], axis=0) > _STANDING
    order = np.argsort(times, kind="stable")
    places = np.nan_to_num(np.vstack([track.at(times) for track in tracks]), nan=np.inf)[:, order]
    with np.errstate(invalid="ignore"):
        moved = np.any(np.abs(np.diff(places, axis=1)) > _STANDING, axis=0)
    starts = np.concatenate([[0], np.cumsum(moved | moving[order][1:] | moving[order][:-1])])
    numbers = np.full(times.size, -1)
    still = ~moving[order]
    numbers[order[still]] = np.unique(starts[still], return_inverse=True)[1]
    return numbers


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


def _groups(stands: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    return [np.flatnonzero(stands == number) for number in range(int(stands.max()) + 1)]


def _columns(
    measured: Samples, tracks: list[_Track], times: Array, groups: list[NDArray[np.int64]]
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


def _time_columns(origin: int, times: Array, groups: list[NDArray[np.int64]]) -> list[tuple[str, NDArray[Any]]]:
    nanoseconds = [origin + round(1e9 * float(times[group].mean())) for group in groups]
    return [
        ("header.stamp.sec", np.array([value // 1_000_000_000 for value in nanoseconds])),
        ("header.stamp.nanosec", np.array([value % 1_000_000_000 for value in nanoseconds])),
    ]


def _digest(path: str) -> str:
    """Return the digest of the recording's bytes; a folder's is that of its files' names and bytes."""
    files = recorded_files(path)
    digests: Mapping[str, str] = {item.name: _file_digest(str(item)) for item in files}
    if len(digests) == 1:
        return next(iter(digests.values()))
    return hashlib.sha256("".join(f"{name} {digest}\n" for name, digest in digests.items()).encode()).hexdigest()


def _file_digest(path: str) -> str:
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


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
