"""Homogeneous matrices ``(..., 4, 4)`` in plain NumPy: what tests compare the package's kinematics with."""

from collections.abc import Sequence

import numpy as np

Matrix = np.ndarray


def turn(axis: int, angle: float | Matrix) -> Matrix:
    """Rotations about a coordinate axis, 0 to 2."""
    angle = np.asarray(angle)
    result = np.zeros((*angle.shape, 4, 4), np.result_type(angle, float))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    result[..., axis, axis] = result[..., 3, 3] = 1.0
    result[..., i, i] = result[..., j, j] = np.cos(angle)
    result[..., j, i] = np.sin(angle)
    result[..., i, j] = -result[..., j, i]
    return result


def shift(x: float | Matrix = 0.0, y: float | Matrix = 0.0, z: float | Matrix = 0.0) -> Matrix:
    """Translations."""
    result = np.zeros((*np.broadcast(x, y, z).shape, 4, 4), np.result_type(x, y, z, float))
    result[...] = np.eye(4)
    result[..., 0, 3], result[..., 1, 3], result[..., 2, 3] = x, y, z
    return result


def frame(xyz: Sequence[float | Matrix], rpy: Sequence[float | Matrix]) -> Matrix:
    """Translation and Rz(yaw) Ry(pitch) Rx(roll)."""
    return shift(*xyz) @ turn(2, rpy[2]) @ turn(1, rpy[1]) @ turn(0, rpy[0])


def dh(theta: float | Matrix, d: float | Matrix, a: float | Matrix, alpha: float | Matrix) -> Matrix:
    """Rz(theta) Tz(d) Tx(a) Rx(alpha), a row of a standard table, multiplied out."""
    theta, d, a, alpha = np.broadcast_arrays(theta, d, a, alpha)
    cos_t, sin_t, cos_a, sin_a = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    zero, one = np.zeros_like(cos_t), np.ones_like(cos_t)
    rows = (
        (cos_t, -sin_t * cos_a, sin_t * sin_a, a * cos_t),
        (sin_t, cos_t * cos_a, -cos_t * sin_a, a * sin_t),
        (zero, sin_a, cos_a, d),
        (zero, zero, zero, one),
    )
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))
