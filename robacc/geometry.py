"""Rigid-body geometry in structure-of-arrays form: components first, poses last.

Conventions of the project:

- a rotation is an array ``(3, 3, ...)``: ``R[i, j]`` over any batch axes, columns are the axes of the rotated frame;
- a vector is an array ``(3, ...)``;
- a quaternion is ``(4, ...)`` in the order w, x, y, z, of unit length;
- a rotation vector is axis times angle in rad, ``(3, ...)``;
- ``rpy`` are rotations about the fixed axes x, y, z: ``R = Rz(yaw) Ry(pitch) Rx(roll)``.

Every function is pure and broadcasts over the batch axes. With poses last each component is contiguous, which NumPy
vectorises best.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as NDArray

Array = NDArray[np.float64]


def cross(a: Array, b: Array) -> Array:
    """Return the cross product of vectors ``(3, ...)`` and ``(3, ...)``."""
    return np.array((a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]))


def vector_lengths(vectors: Array) -> Array:
    """Return the lengths ``(N,)`` of vectors ``(K, N)``, in their unit."""
    return np.asarray(np.sqrt(np.einsum("in,in->n", vectors, vectors)))


def rms_length(vectors: Array) -> float:
    """Return the root mean square length of vectors ``(3, N)``, in their unit."""
    return float(np.sqrt(np.mean(np.sum(np.square(vectors), axis=0))))


def rotate(rotation: Array, vector: Array) -> Array:
    """Return ``R v`` for ``(3, 3, ...)`` and ``(3, ...)``."""
    return np.asarray(np.einsum("ij...,j...->i...", rotation, vector))


def rotate_back(rotation: Array, vector: Array) -> Array:
    """Return ``R^T v`` for ``(3, 3, ...)`` and ``(3, ...)``."""
    return np.asarray(np.einsum("ji...,j...->i...", rotation, vector))


def compose(first: Array, second: Array) -> Array:
    """Return ``R1 R2`` for two rotations ``(3, 3, ...)``."""
    return np.asarray(np.einsum("ij...,jk...->ik...", first, second))


def transpose(rotation: Array) -> Array:
    """Return ``R^T`` of ``(3, 3, ...)``."""
    return np.swapaxes(rotation, 0, 1)


def rotation_about(axis: int, angle: Array | float) -> Array:
    """Return the rotation ``(3, 3, ...)`` by ``angle`` (rad) about coordinate axis 0, 1 or 2."""
    angle = np.asarray(angle, dtype=float)
    result = np.zeros((3, 3, *angle.shape))
    j, k = (axis + 1) % 3, (axis + 2) % 3
    result[axis, axis] = 1.0
    result[j, j] = result[k, k] = np.cos(angle)
    result[k, j] = np.sin(angle)
    result[j, k] = -result[k, j]
    return result


def rotation_from_rpy(rpy: Array) -> Array:
    """Return ``Rz(yaw) Ry(pitch) Rx(roll)`` from ``rpy`` ``(3, ...)`` in rad."""
    roll, pitch, yaw = np.asarray(rpy, dtype=float)
    return compose(compose(rotation_about(2, yaw), rotation_about(1, pitch)), rotation_about(0, roll))


def rpy_from_rotation(rotation: Array) -> Array:
    """Return roll, pitch, yaw ``(3, ...)`` in rad; at a pitch of 90 degrees, where they are not unique, roll is 0.

    Roll is computed after removing yaw and pitch, so that the product reproduces the rotation to rounding even near 90
    degrees, where roll and yaw are ill-determined.
    """
    across = np.hypot(rotation[0, 0], rotation[1, 0])
    pitch = np.arctan2(-rotation[2, 0], across)
    pole = across < 1e-15
    yaw = np.where(pole, np.arctan2(-rotation[0, 1], rotation[1, 1]), np.arctan2(rotation[1, 0], rotation[0, 0]))
    # Second and third column of (Rz(yaw) Ry(pitch))^T R, along its second axis.
    sine, cosine = np.sin(yaw), np.cos(yaw)
    roll = np.arctan2(
        -(cosine * rotation[1, 2] - sine * rotation[0, 2]), cosine * rotation[1, 1] - sine * rotation[0, 1]
    )
    return np.stack((np.where(pole, 0.0, roll), pitch, yaw))


def rotation_from_quaternion(quaternion: Array) -> Array:
    """Return the rotation ``(3, 3, ...)`` of a quaternion w, x, y, z ``(4, ...)``, normalised first."""
    w, x, y, z = quaternion / np.sqrt(np.sum(np.square(quaternion), axis=0))
    return np.stack(
        (
            np.stack((1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y))),
            np.stack((2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x))),
            np.stack((2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))),
        )
    )


def quaternion_from_rotation(rotation: Array) -> Array:
    """Return the quaternion w, x, y, z ``(4, ...)`` with w >= 0, by Shepperd's method (stable at any angle).

    Source: S. W. Shepperd, "Quaternion from rotation matrix", J. Guidance and Control 1(3), 1978.
    """
    m = rotation
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    # The four squared components times four; the largest is the divisor, which avoids division by small numbers.
    squares = np.stack((1 + trace, 1 + 2 * m[0, 0] - trace, 1 + 2 * m[1, 1] - trace, 1 + 2 * m[2, 2] - trace))
    candidates = np.stack(
        (
            np.stack((squares[0], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1])),
            np.stack((m[2, 1] - m[1, 2], squares[1], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0])),
            np.stack((m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], squares[2], m[1, 2] + m[2, 1])),
            np.stack((m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], squares[3])),
        )
    )
    best = np.argmax(squares, axis=0)
    quaternion = np.take_along_axis(candidates, best[None, None, ...], axis=0)[0]
    quaternion = quaternion / np.sqrt(np.sum(np.square(quaternion), axis=0))
    return np.asarray(np.where(quaternion[0] < 0, -quaternion, quaternion))


def skew(vector: Array) -> Array:
    """Return the matrix ``(3, 3, ...)`` with ``skew(v) u = v x u``."""
    zero = np.zeros_like(vector[0])
    return np.stack(
        (
            np.stack((zero, -vector[2], vector[1])),
            np.stack((vector[2], zero, -vector[0])),
            np.stack((-vector[1], vector[0], zero)),
        )
    )


def nearest_rotation(matrix: Array) -> Array:
    """Return the rotations nearest to ``(..., 3, 3)`` matrices (polar factor by SVD; Kabsch 1976)."""
    u, _, vt = np.linalg.svd(matrix)
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    result: Array = u @ vt
    return result


def _size(vector: Array) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return the length of vectors, where it is so small that closed forms lose digits, and the length or 1 there."""
    length = np.sqrt(np.sum(np.square(vector), axis=0))
    small = length < 1e-4  # rad; below it series such as that of sin(x)/x are exact to 1e-16
    return length, small, np.where(small, 1.0, length)


def exp_so3(rotation_vector: Array) -> Array:
    """Return the rotation ``(3, 3, ...)`` of a rotation vector ``(3, ...)`` (Rodrigues' formula)."""
    vector = np.asarray(rotation_vector, dtype=float)
    angle, small, safe = _size(vector)
    sinc = np.where(small, 1 - np.square(angle) / 6, np.sin(safe) / safe)
    cosc = np.where(small, 0.5 - np.square(angle) / 24, (1 - np.cos(safe)) / np.square(safe))
    matrix = skew(vector)
    identity = np.eye(3).reshape(3, 3, *(1,) * (vector.ndim - 1))
    return np.asarray(identity + sinc * matrix + cosc * compose(matrix, matrix))


def log_so3(rotation: Array) -> Array:
    """Return the rotation vector ``(3, ...)`` in rad of length at most pi; exact near zero and near pi.

    The quaternion formula 2 atan2(|v|, w) v/|v| has no cancellation at either end.
    """
    quaternion = quaternion_from_rotation(rotation)
    vector = quaternion[1:]
    length, small, safe = _size(vector)
    # Near zero: 2 asin(l)/l = 2 (1 + l^2/6 + ...), where w = sqrt(1 - l^2).
    factor = np.where(small, 2 + np.square(length) / 3, 2 * np.arctan2(safe, quaternion[0]) / safe)
    return np.asarray(factor * vector)


def log_between(first: Array, second: Array) -> Array:
    """Return the rotation vector ``(3, ...)`` of ``first second^T`` in rad, for rotations ``(3, 3, ...)``.

    Below 90 degrees it follows from the sine and cosine of the angle, 2 sin v = sum_k second_k x first_k over columns,
    without a product of matrices; the angle's tangent has no cancellation there.
    """
    cosine = 0.5 * (np.sum(first * second, axis=(0, 1)) - 1.0)
    if np.any(cosine < 0):
        return log_so3(compose(first, transpose(second)))
    vector = 0.5 * cross(second, first).sum(axis=1)
    sine, small, safe = _size(vector)
    # Near zero: asin(s)/s = 1 + s^2/6 + ...
    factor = np.where(small, 1 + np.square(sine) / 6, np.arctan2(safe, cosine) / safe)
    return np.asarray(factor * vector)


def left_jacobian_inverse(rotation_vector: Array) -> Array:
    """Return the inverse left Jacobian of SO(3), ``(3, 3, ...)``: d log(exp(e) R) = J_l^-1(log R) e for small e.

    Source: T. D. Barfoot, State Estimation for Robotics (2017), eq. (7.79).
    """
    vector = np.asarray(rotation_vector, dtype=float)
    angle, small, safe = _size(vector)
    half = safe / 2
    factor = np.where(small, 1 / 12 + np.square(angle) / 720, (1 - half / np.tan(half)) / np.square(safe))
    matrix = skew(vector)
    identity = np.eye(3).reshape(3, 3, *(1,) * (vector.ndim - 1))
    return np.asarray(identity - 0.5 * matrix + factor * compose(matrix, matrix))


@dataclass(frozen=True, slots=True)
class Poses:
    """Rigid transforms T = [R p; 0 1] over the batch axes."""

    rotation: Array
    """``(3, 3, ...)``"""
    translation: Array
    """``(3, ...)``, m"""

    @classmethod
    def identity(cls, *batch: int) -> "Poses":
        """Return unit transforms over the given batch shape."""
        eye = np.eye(3).reshape(3, 3, *(1,) * len(batch))
        return cls(np.broadcast_to(eye, (3, 3, *batch)).copy(), np.zeros((3, *batch)))

    @classmethod
    def from_xyz_rpy(cls, xyz: Array, rpy: Array) -> "Poses":
        """Return ``T(xyz) Rz(yaw) Ry(pitch) Rx(roll)`` from ``(3, ...)`` in m and rad."""
        return cls(rotation_from_rpy(rpy), np.asarray(xyz, dtype=float))

    def matrices(self) -> Array:
        """Return homogeneous matrices ``(..., 4, 4)``."""
        result = np.zeros((4, 4, *self.translation.shape[1:]))
        result[:3, :3] = self.rotation
        result[:3, 3] = self.translation
        result[3, 3] = 1.0
        return np.moveaxis(result, (0, 1), (-2, -1))

    def __matmul__(self, other: "Poses") -> "Poses":
        """Return ``T1 T2``, broadcasting over the batch axes; a single transform applies to every one of many."""
        moved = rotate(self.rotation, other.translation)
        shift = self.translation[(..., *(None,) * (moved.ndim - self.translation.ndim))]
        return Poses(compose(self.rotation, other.rotation), moved + shift)

    def inverse(self) -> "Poses":
        """Return ``T^-1``."""
        return Poses(transpose(self.rotation), -rotate_back(self.rotation, self.translation))
