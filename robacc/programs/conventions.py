"""Conventions of robot programs for orientations, converted to unit quaternions and back.

Numbers are batched ``(components, N)`` in m and rad. The way back chooses, among the numbers of one orientation, those
nearest to the numbers in the program, so that a small correction changes them little.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from robacc.geometry import (
    Array,
    compose,
    exp_so3,
    log_so3,
    quaternion_from_rotation,
    rotation_about,
    rotation_from_quaternion,
    rotation_from_rpy,
    rpy_from_rotation,
    transpose,
)


class Convention(StrEnum):
    """Components of a target, in the order of the program."""

    joints = "joints"
    """Joint variables."""
    zyx = "zyx"
    """x, y, z, A, B, C with R = Rz(A) Ry(B) Rx(C) (KUKA)."""
    fixed_xyz = "fixed_xyz"
    """x, y, z, W, P, R with R = Rz(R) Ry(P) Rx(W) (FANUC)."""
    quaternion = "quaternion"
    """x, y, z, q1 … q4 with q1 the scalar part (ABB)."""
    moving_xyz = "moving_xyz"
    """x, y, z, rx, ry, rz with R = Rx(rx) Ry(ry) Rz(rz) (Staubli)."""
    rotation_vector = "rotation_vector"
    """x, y, z, rx, ry, rz with the rotation vector (Universal Robots)."""

    @property
    def components(self) -> int:
        """Numbers of a Cartesian target."""
        return 7 if self is Convention.quaternion else 6


def to_values(convention: Convention, native: Array) -> Array:
    """Return x, y, z and the unit quaternion ``(7, N)`` of a program's numbers; joint variables as they are."""
    if convention is Convention.joints:
        return native
    return np.concatenate((native[:3], quaternion_from_rotation(rotation_of(convention, native[3:]))))


def rotation_of(convention: Convention, angles: Array) -> Array:
    """Return the rotations ``(3, 3, N)`` of the numbers that follow x, y, z."""
    if convention is Convention.zyx:
        return rotation_from_rpy(angles[::-1])
    if convention is Convention.fixed_xyz:
        return rotation_from_rpy(angles)
    if convention is Convention.moving_xyz:
        # The inverse of the rotation by the opposite angles about fixed axes.
        return transpose(rotation_from_rpy(-angles))
    if convention is Convention.rotation_vector:
        return exp_so3(angles)
    return rotation_from_quaternion(angles)


def to_native(convention: Convention, values: Array, near: Array) -> Array:
    """Return a program's numbers of ``values`` (as of :func:`to_values`), nearest to the numbers ``near``."""
    if convention is Convention.joints:
        return values
    rotation = rotation_from_quaternion(values[3:])
    if convention is Convention.quaternion:
        turned = _nearest_quaternion(values[3:], near[3:])
    elif convention is Convention.rotation_vector:
        turned = _nearest_vector(log_so3(rotation), near[3:])
    elif convention is Convention.moving_xyz:
        turned = -_nearest_angles(transpose(rotation), -near[3:])
    elif convention is Convention.zyx:
        turned = _nearest_angles(rotation, near[:2:-1])[::-1]
    else:
        turned = _nearest_angles(rotation, near[3:])
    return np.concatenate((values[:3], turned))


def rotation_distance(first: Array, second: Array) -> Array:
    """Return the angle ``(N,)`` in rad between orientations given as unit quaternions ``(4, N)``."""
    difference = np.minimum(
        np.sqrt(np.sum(np.square(first - second), axis=0)), np.sqrt(np.sum(np.square(first + second), axis=0))
    )
    angle: Array = 4 * np.arcsin(np.minimum(difference / 2, 1.0))
    return angle


def _nearest_quaternion(quaternion: Array, near: Array) -> Array:
    unit = quaternion / np.sqrt(np.sum(np.square(quaternion), axis=0))
    nearest: Array = np.where(np.sum(unit * near, axis=0) < 0, -unit, unit)
    return nearest


def _nearest_vector(vector: Array, near: Array) -> Array:
    angle = np.sqrt(np.sum(np.square(vector), axis=0))
    unit = vector / np.where(angle > 0, angle, 1.0)
    # The axis of a zero rotation is free: a whole turn about the program's own axis.
    length = np.sqrt(np.sum(np.square(near), axis=0))
    unit = np.where(angle > 0, unit, near / np.where(length > 0, length, 1.0))
    candidates = np.stack([vector + 2 * np.pi * turns * unit for turns in (0, -1, 1)])
    best = np.argmin(np.sum(np.square(candidates - near), axis=1), axis=0)
    chosen: Array = np.take_along_axis(candidates, best[None, None], axis=0)[0]
    return chosen


def _nearest_angles(rotation: Array, near: Array) -> Array:
    """Return roll, pitch, yaw ``(3, N)`` of the solution nearest to ``near``, in the range that ``near`` is in."""
    first = rpy_from_rotation(rotation)
    pole = np.abs(np.abs(first[1]) - np.pi / 2) < 1e-9
    if np.any(pole):
        # Only yaw -+ roll is determined: keep the program's roll.
        upright = compose(rotation, np.swapaxes(rotation_about(0, near[0]), 0, 1))
        yaw = np.arctan2(-upright[0, 1], upright[1, 1])
        first = np.where(pole, np.stack((near[0], first[1], yaw)), first)
    second = np.stack((first[0] + np.pi, np.pi - first[1], first[2] + np.pi))
    distances = [np.sum(np.square(_wrapped(angles - near)), axis=0) for angles in (first, second)]
    chosen = np.where(distances[1] < distances[0], second, first)
    inside = np.abs(near) <= np.pi + 1e-9
    return np.where(inside, _wrapped(chosen), near + _wrapped(chosen - near))


def _wrapped(angle: Array) -> Array:
    """Return angles in [-pi, pi]."""
    return angle - 2 * np.pi * np.round(angle / (2 * np.pi))
