"""What recordings have in common: statements on them, and where the arm stands still."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from robacc.errors import Problem, UsageError, refuse
from robacc.geometry import Array

# Statements on a recording: the topics to read, and the samples to use.

_CHOICES: Mapping[str, tuple[str, ...]] = {"clock": ("stamp", "recorder"), "at": ("any", "rest")}
EXAMPLE = "joints=/joint_states,measured=/tracker/pose,at=rest"


@dataclass(frozen=True, slots=True)
class BagOptions:
    """Topics of a recording and how their samples are associated."""

    joints: str | None = None
    """Topic of joint states; likewise the next two."""
    measured: str | None = None
    commanded: str | None = None
    clock: str = "stamp"
    """Time of a sample: ``stamp`` of the message's header, or the time at which the ``recorder`` received it."""
    at: str | None = None
    """``rest``: one pose for each stand of the robot, the mean of its samples; ``any``: every sample."""
    images: str | None = None
    """Topic or camera of the images."""
    calibration: str | None = None
    """LeRobot's calibration file of the arm, where its joints are in percent of their ranges."""

    @classmethod
    def of(cls, text: str | None) -> BagOptions:
        """Return the statements of a text ``key=value,…``.

        Raises:
            UsageError: A key or a value is unknown.
        """
        stated: dict[str, str] = {}
        known = [field.name for field in fields(cls)]
        for part in (text or "").split(",") if text else ():
            key, sign, value = (item.strip() for item in part.partition("="))
            if not sign or not value or key not in known:
                near = difflib.get_close_matches(key, known, 1)
                hint = f"; did you mean {near[0]}?" if near and key not in known else ""
                raise UsageError(f"`bag`: expected {', '.join(known)} as in {EXAMPLE}, found {part!r}{hint}")
            if key in stated:
                raise UsageError(f"`bag`: {key} is given twice")
            if value not in _CHOICES.get(key, (value,)):
                raise UsageError(f"`bag`: expected {key}={' or '.join(_CHOICES[key])}, found {part!r}")
            stated[key] = value
        return cls(**stated)


# Stands of the arm, between its motions.

_LONGEST_GAP = 0.1
"""Time between neighbouring samples over which a moving joint is interpolated, s."""
_WINDOW = 0.1
"""The robot stands at a sample if nothing moves between this time before and after it, s."""
STANDING = 2e-4
"""Largest change in that time of a robot that stands, rad and m: 1 mrad/s, above the noise of encoders."""
MOST_IMAGES = 150
"""Images that are used: more of one campaign show little new."""
_REMEMBERED = 60.0
"""Time over which the motion before a stand decides from where a joint came, s."""


@dataclass(frozen=True, slots=True)
class Track:
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
        unknown = (distance > _LONGEST_GAP) & (outside | (moved > STANDING))
        return np.where(unknown, np.nan, result)

    def change(self, times: Array) -> Array:
        """Return the largest change ``(N,)`` of a value around ``times``."""
        rows = self.values[:3] if self.repeats_last else self.values
        sides = [
            np.array([np.interp(times + shift, self.times, row) for row in rows]) for shift in (-_WINDOW, 0.0, _WINDOW)
        ]
        change: Array = np.ptp(np.array(sides), axis=0).max(axis=0)
        return change


def stands_at(times: Array, tracks: Sequence[Track], standing: float = STANDING) -> NDArray[np.int64]:
    """Return the number ``(N,)`` of the stand in which each sample was measured, -1 in motion; empty without tracks.

    Nothing moves by more than ``standing`` around a sample of a stand.
    """
    if not tracks:
        return np.empty(0, dtype=np.int64)
    # Of an unknown change, which is NaN, nothing says that the robot stands.
    moving = ~(np.max([track.change(times) for track in tracks], axis=0) <= standing)
    order = np.argsort(times, kind="stable")
    places = np.nan_to_num(np.vstack([track.at(times) for track in tracks]), nan=np.inf)[:, order]
    with np.errstate(invalid="ignore"):
        moved = np.any(np.abs(np.diff(places, axis=1)) > standing, axis=0)
    starts = np.concatenate([[0], np.cumsum(moved | moving[order][1:] | moving[order][:-1])])
    numbers = np.full(times.size, -1)
    still = ~moving[order]
    numbers[order[still]] = np.unique(starts[still], return_inverse=True)[1]
    return numbers


def stops(path: str, times: Array, tracks: Sequence[Track], at: str | None, standing: float) -> NDArray[np.int64]:
    """Return the image in the middle of each stand, and of many stands those whose joints differ most, in their order.

    Args:
        path: The recording.
        times: ``(N,)`` s, of the images.
        tracks: The joints.
        at: ``any`` for images in motion too.
        standing: How far joints that stand still may move.

    Raises:
        InputError: The arm stands still at no image.
    """
    places = np.vstack([track.at(times) for track in tracks])
    numbers = np.arange(times.size) if at == "any" else stands_at(times, tracks, standing)
    numbers = np.where(np.isnan(places).any(axis=0), -1, numbers)
    of_stands = (np.flatnonzero(numbers == number) for number in range(int(numbers.max(initial=-1)) + 1))
    middle = np.array([samples[samples.size // 2] for samples in of_stands if samples.size], dtype=np.int64)
    fix = "stop at each pose for half a second; `bag` with at=any takes images in motion"
    refuse((not middle.size, Problem("the arm stands still at no image", path, fix=fix)))
    # The farthest from those chosen is next (T. F. Gonzalez 1985).
    chosen, distance = [0], np.full(middle.size, np.inf)
    while len(chosen) < min(middle.size, MOST_IMAGES):
        near = np.linalg.norm(places[:, middle] - places[:, middle[chosen[-1]], None], axis=0)
        distance = np.minimum(distance, near)
        distance[chosen] = -1.0
        chosen.append(int(np.argmax(distance)))
    return np.sort(middle[chosen])


def arrivals(track: Track, times: Array, least: float) -> Array:
    """Return the way ``(K, N)`` of the last motion beyond ``least`` of each value before each time; 0 if it stood."""
    result = np.zeros((len(track.values), times.size))
    for column, time in enumerate(times.tolist()):
        start, end = np.searchsorted(track.times, (time - _REMEMBERED, time))
        moved = track.at(np.array([time])) - track.values[:, start:end]
        for row in np.flatnonzero(np.any(np.abs(moved) > least, axis=1)).tolist():
            result[row, column] = np.sign(moved[row][np.abs(moved[row]) > least][-1])
    return result
