"""Frames and tools of a VAL3 data file, each in its father, composed up to the world or the flange."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from robacc.geometry import Poses, rotation_from_rpy, rpy_from_rotation
from robacc.programs.assemble import frame_of
from robacc.programs.conventions import Convention
from robacc.robots.description import Frame

_ROOTS = {"frame": "world[0]", "tool": "flange[0]"}


@dataclass(frozen=True, slots=True)
class Entry:
    """Frame or tool in its father."""

    native: tuple[float, ...]
    """x, y, z, rx, ry, rz in m and rad; NaN where it is no number."""
    father: str
    """Name of the father, lower case; empty where it is not given."""


@dataclass(frozen=True, slots=True)
class FrameTree:
    """Frames and tools by name, lower case."""

    entries: Mapping[str, Mapping[str, Entry]]
    """``frame`` and ``tool`` to entries by name."""
    changed: Collection[str]
    """Names of the data that programs change, lower case."""

    def base(self, name: str) -> Frame | None:
        """Return a frame in the world; None where it is not known before run time."""
        return self._resolved("frame", name, 0)

    def tool(self, name: str) -> Frame | None:
        """Return a tool in the flange's frame; None where it is not known before run time."""
        return self._resolved("tool", name if "[" in name else f"{name}[0]", 0)

    def _resolved(self, kind: str, name: str, depth: int) -> Frame | None:
        if name == _ROOTS[kind]:
            return Frame()
        entry = self.entries[kind].get(name)
        # A frame that is its own father, over some others, has no place.
        if entry is None or depth > len(self.entries[kind]) or name.partition("[")[0] in self.changed:
            return None
        father = self._resolved(kind, entry.father, depth + 1)
        if father is None or any(math.isnan(number) for number in entry.native):
            return None
        return _composed(father, frame_of(Convention.moving_xyz, entry.native))


def _composed(father: Frame, child: Frame) -> Frame:
    pose = _pose(father) @ _pose(child)
    roll, pitch, yaw = (float(angle) for angle in rpy_from_rotation(pose.rotation)[:, 0])
    x, y, z = (float(value) for value in pose.translation[:, 0])
    return Frame((x, y, z), (roll, pitch, yaw))


def _pose(frame: Frame) -> Poses:
    return Poses(rotation_from_rpy(np.array(frame.rpy)[:, None]), np.array(frame.xyz)[:, None])
