"""Screening of hypotheses on data mistakes: base and target registered for many hypotheses at once, on a few rows."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.diagnostics.batch_registration import (
    BatchFit,
    orientation_errors,
    register_orientations,
    register_positions,
)
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.robots.description import Frame, Robot

_ROWS = 60
"""Rows that the screening uses at most."""
_ROUGH_ROWS = 30
"""The same of the rough fits."""
_BATCH = 400
"""Hypotheses per batch, which bounds the memory."""
_MOST_ANGLE = 0.5
"""rad; orientation error beyond which a hypothesis is as bad as any."""


@dataclass(frozen=True, slots=True)
class Sample:
    """Rows of the measured poses that the screening uses."""

    data: Measurements
    target: NDArray[np.int64]
    """``(N,)`` number of each row's target."""
    n_targets: int

    @classmethod
    def of(cls, robot: Robot, data: Measurements, most: int = _ROWS) -> Sample:
        """Return up to ``most`` rows, spread evenly over the data."""
        rows = np.unique(np.linspace(0, data.n - 1, min(data.n, most)).astype(int))
        sample = data.subset(rows)
        target, n_targets = target_numbers(robot, sample)
        return cls(sample, target, n_targets)


def target_numbers(robot: Robot, data: Measurements) -> tuple[NDArray[np.int64], int]:
    """Return the number of each row's target, and of targets that occur."""
    if data.target is None or not robot.targets:
        return np.zeros(data.n, dtype=np.int64), 1
    _, number = np.unique(data.target, return_inverse=True)
    return number.astype(np.int64).ravel(), int(number.max()) + 1


def arm_poses(robot: Robot, data: Measurements, q: Array) -> tuple[Array, Array]:
    """Return the last link's rotations ``(H, N, 3, 3)`` and positions ``(H, N, 3)`` at joints ``(H, J, N)``."""
    h, joints, n = q.shape
    bare = dataclasses.replace(robot, tool=Frame(), targets={})
    rows = data.subset(np.tile(np.arange(n), h))
    rows = dataclasses.replace(rows, q=q.transpose(1, 0, 2).reshape(joints, h * n))
    poses: Poses = predict(bare, rows)
    rotation = np.moveaxis(poses.rotation, 2, 0).reshape(h, n, 3, 3)
    return rotation, poses.translation.T.reshape(h, n, 3)


@dataclass(frozen=True, slots=True)
class Screen:
    """Registered misfit of H hypotheses."""

    position: Array
    """``(H,)`` median position error with base and target registered to the positions, m."""
    position_rotation: Array
    """``(H, 3, 3)`` rotation from the measuring frame to the base, of the positions."""
    orientation: Array | None
    """``(H,)`` median orientation error with base and target registered, rad."""
    orientation_rotation: Array | None
    """``(H, 3, 3)`` the same of the orientations."""
    joint_position: Array
    """``(H,)`` median position error with a base that the orientations have in common, m; else :attr:`position`."""
    spread: float
    """Standard deviation of the measured positions, m."""

    @property
    def total(self) -> Array:
        """Return the misfit ``(H,)``: position error over the spread, plus orientation error in rad."""
        if self.orientation is None:
            return self.position / self.spread
        return np.asarray(self.joint_position / self.spread + self.orientation)

    @property
    def rank(self) -> Array:
        """Return ``(H,)`` what orders hypotheses: tolerant of orientations that are wrong in themselves."""
        if self.orientation is None:
            return self.position / self.spread
        return np.asarray(self.position / self.spread + 0.3 * np.minimum(self.orientation, _MOST_ANGLE))

    def rotations(self, i: int) -> tuple[Array, Array] | None:
        """Return the base's rotations of positions and of orientations of hypothesis ``i``; None without the latter."""
        if self.orientation_rotation is None:
            return None
        return self.position_rotation[i], self.orientation_rotation[i]


def screen(robot: Robot, sample: Sample, q: Sequence[Array], position: Array, rotation: Array | None) -> Screen:
    """Return the misfit of each set of joint variables against measured poses.

    Args:
        robot: Robot, whose base and targets are registered.
        sample: Rows.
        q: Joint variables ``(J, N)`` of each hypothesis.
        position: ``(3, N)`` measured positions, m.
        rotation: ``(3, 3, N)`` measured orientations, or None.
    """
    parts = [
        _screened(robot, sample, np.stack(q[i : i + _BATCH]), position, rotation) for i in range(0, len(q), _BATCH)
    ]
    if len(parts) == 1:
        return parts[0]

    def joined(name: str) -> Array | None:
        values = [getattr(part, name) for part in parts]
        return None if values[0] is None else np.concatenate(values)

    changes = {field.name: joined(field.name) for field in dataclasses.fields(Screen) if field.name != "spread"}
    return dataclasses.replace(parts[0], **changes)  # type: ignore[arg-type]


def most_likely(robot: Robot, sample: Sample, q: Sequence[Array], position: Array, count: int) -> NDArray[np.int64]:
    """Return the indices of the ``count`` hypotheses that fit the positions of some rows best, by a rough fit."""
    rows = np.linspace(0, sample.data.n - 1, min(sample.data.n, _ROUGH_ROWS)).astype(int)
    data, point = sample.data.subset(rows), position.T[None, rows]
    medians = []
    for i in range(0, len(q), _BATCH):
        poses = arm_poses(robot, data, np.stack(q[i : i + _BATCH])[..., rows])
        medians.append(register_positions(*poses, point, sample.target[rows], sample.n_targets, passes=1).median)
    return np.argsort(np.concatenate(medians), kind="stable")[:count]


def _screened(robot: Robot, sample: Sample, q: Array, position: Array, rotation: Array | None) -> Screen:
    arm_rotation, arm_position = arm_poses(robot, sample.data, q)
    point = position.T[None]
    targets = (sample.target, sample.n_targets)
    free: BatchFit = register_positions(arm_rotation, arm_position, point, *targets)
    spread = max(float(np.sqrt(np.var(position, axis=1).sum())), 1e-12)
    if rotation is None:
        return Screen(free.median, free.rotation, None, None, free.median, spread)
    measured = np.moveaxis(rotation, 2, 0)[None]
    turned: BatchFit = register_orientations(arm_rotation, measured)
    common = register_positions(arm_rotation, arm_position, point, *targets, turn=turned.rotation).median
    # Orientations that hardly vary do not show the base, which the positions then show.
    other = orientation_errors(arm_rotation, measured, free.rotation)
    by_positions = free.median / spread + other < common / spread + turned.median
    return Screen(
        free.median,
        free.rotation,
        np.where(by_positions, other, turned.median),
        turned.rotation,
        np.where(by_positions, free.median, common),
        spread,
    )
