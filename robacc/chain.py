"""Kinematic chain of elementary motions: poses, and the exact Jacobian to every scalar.

A chain is a product of elementary motions, each a rotation or a translation along a coordinate axis by one scalar:

    T = E_1(s_1) E_2(s_2) … E_K(s_K).

A DH row is Rz(theta) Tz(d) Tx(a) Rx(alpha), a modified one Rx(alpha) Tx(a) Rz(theta) Tz(d), a URDF joint
Tx Ty Tz Rz Ry Rx and its axis; base and tool are motions too. Equation (6) of Wu and Lee (1984) then needs no case
distinction: the column of scalar k is the twist of motion k transformed to the tool,

    rotation:     dp = z_k x (p - o_k),  dphi = z_k
    translation:  dp = z_k,              dphi = 0

with z_k the motion's axis and o_k a point on it, both in the measuring frame, from a single forward sweep.

A scalar is a float where it is the same for all poses and an ``(N,)`` array where it varies; constant runs stay
``(3, 1)`` until the first varying scalar.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array, Poses, cross

BLOCK = 4096
"""Poses per block: the working arrays of a block stay in the second-level cache."""

_ROW_SIZE = 2048
"""Numbers per row in a NumPy call: with fewer, the call takes longer than the computation."""

BASE = -1
TOOL = -2

Scalar = float | NDArray[Any]


@dataclass(frozen=True, slots=True)
class Motion:
    """Elementary motion along or about coordinate ``axis`` of the preceding frame."""

    kind: Literal["rotation", "translation"]
    axis: int
    value: float
    """Nominal scalar, m or rad."""
    owner: int
    """Index of the joint in the robot's list, or :data:`BASE` or :data:`TOOL`."""
    label: str
    """``theta``, ``d``, ``alpha``, ``flex_x`` …; unique within the owner, or empty if it never varies."""

    @property
    def unit(self) -> str:
        """Unit of the scalar."""
        return "rad" if self.kind == "rotation" else "m"


@dataclass(frozen=True, slots=True)
class JointDrive:
    """Joint variable ``joint`` added to the scalar of motion ``motion`` with a coefficient (sign or mimic ratio)."""

    motion: int
    joint: int
    coefficient: float


@dataclass(frozen=True, slots=True)
class Body:
    """Mass on the chain, at ``com`` in the frame after motion ``after - 1``."""

    after: int
    """Number of motions before the body's frame: motions ``0 … after - 1`` move the body."""
    owner: int
    com: tuple[float, float, float]
    mass: float


@dataclass(frozen=True, slots=True)
class Sweep:
    """Results of a forward sweep, in the measuring frame."""

    poses: Poses
    """Tool poses over N."""
    jacobian: Array
    """``(6, W, N)``: rows dp (m), dphi (rad) of the tool per unit of each wanted scalar."""
    frames: tuple[Poses, ...]
    """The frame after each of the wanted motion counts (link frames), over N."""

    def twists(self) -> tuple[Array, Array]:
        """Return spatial twists (v, w), each ``(3, W, N)``: a point c behind the motion has the velocity v + w x c."""
        linear, angular = self.jacobian[:3], self.jacobian[3:]
        return linear - cross(angular, self.poses.translation[:, None, :]), angular


@dataclass(frozen=True)
class Chain:
    """Serial arm as elementary motions. Immutable; every method is a pure function of its arguments."""

    motions: tuple[Motion, ...]
    drives: tuple[JointDrive, ...]
    n_joints: int
    """Number of joint variables."""
    bodies: tuple[Body, ...] = ()
    joint_axis: tuple[int, ...] = ()
    """Index of the motion that each joint variable drives."""

    @cached_property
    def _index(self) -> dict[tuple[int, str], int]:
        """Index of each motion by owner and label."""
        return {(motion.owner, motion.label): k for k, motion in enumerate(self.motions) if motion.label}

    def find(self, owner: int, label: str) -> int | None:
        """Return the index of a motion, or None where the chain has no such motion."""
        return self._index.get((owner, label))

    def index(self, owner: int, label: str) -> int:
        """Return the index of a motion that must exist."""
        return self._index[owner, label]

    def scalars(self, q: NDArray[Any]) -> list[Scalar]:
        """Return nominal scalars at joint variables ``q`` ``(J, N)``: floats where constant, ``(N,)`` where driven."""
        values: list[Scalar] = [motion.value for motion in self.motions]
        for drive in self.drives:
            values[drive.motion] = values[drive.motion] + drive.coefficient * q[drive.joint]
        return values

    def forward(self, q: NDArray[Any]) -> Poses:
        """Return nominal tool poses in the measuring frame for joint variables ``q`` ``(J, N)`` in rad or m."""
        return self.poses(self.scalars(q), q.shape[1])

    def poses(self, scalars: Sequence[Scalar], n: int) -> Poses:
        """Return tool poses for any scalars."""
        return self.sweep(scalars, n, ()).poses

    def sweep(
        self,
        scalars: Sequence[Scalar],
        n: int,
        wanted: Sequence[int] | None = None,
        frames: Sequence[int] = (),
    ) -> Sweep:
        """Return poses, Jacobian columns of the ``wanted`` motions (default all) and frames, in one pass.

        ``frames`` are motion counts after which the frame is stored (a body's ``after``).
        """
        wanted = tuple(range(len(self.motions))) if wanted is None else tuple(wanted)
        dtype = np.result_type(np.float64, *(scalar.dtype for scalar in scalars if not isinstance(scalar, float)))
        jacobian = np.empty((6, len(wanted), n), dtype=dtype)
        stored = {count: _empty_poses(n, dtype) for count in frames}
        tip = _empty_poses(n, dtype)
        slots: dict[int, list[int]] = {}
        for slot, k in enumerate(wanted):
            slots.setdefault(k, []).append(slot)
        rotations = [slot for slot, k in enumerate(wanted) if self.motions[k].kind == "rotation"]
        for block in self.blocks(n):
            columns, origin = [np.eye(3)[:, [axis]] for axis in range(3)], np.zeros((3, 1))
            for k, motion in enumerate(self.motions):
                if k in stored:
                    _store(stored[k], columns, origin, block)
                for slot in slots.get(k, ()):
                    _store_axis(jacobian[:, slot, block], motion, columns, origin)
                scalar = scalars[k]
                if isinstance(scalar, float):
                    if scalar != 0.0:
                        origin = _advance(columns, origin, motion, scalar)
                else:
                    origin = _advance(columns, origin, motion, scalar[block])
            if len(self.motions) in stored:
                _store(stored[len(self.motions)], columns, origin, block)
            _store(tip, columns, origin, block)
            _transform_to_tool(jacobian[:, :, block], rotations, origin)
        return Sweep(tip, jacobian, tuple(stored[count] for count in frames))

    def jacobian(self, q: NDArray[Any], wanted: Sequence[int] | None = None) -> Array:
        """Return the nominal Jacobian ``(6, W, N)``, rows dp, dphi, to ``wanted`` scalars (default all K)."""
        return self.sweep(self.scalars(q), q.shape[1], wanted).jacobian

    def blocks(self, n: int) -> Iterator[slice]:
        """Return slices of at most :data:`BLOCK` poses that cover ``n``."""
        return (slice(start, min(start + BLOCK, n)) for start in range(0, n, BLOCK))


def _empty_poses(n: int, dtype: np.dtype[Any]) -> Poses:
    return Poses(np.empty((3, 3, n), dtype=dtype), np.empty((3, n), dtype=dtype))


def _store_axis(column: NDArray[Any], motion: Motion, columns: list[NDArray[Any]], origin: NDArray[Any]) -> None:
    """Store a rotation's origin and axis until the tool is known, or a translation's axis and zeros."""
    column[:3] = origin if motion.kind == "rotation" else columns[motion.axis]
    column[3:] = columns[motion.axis] if motion.kind == "rotation" else 0.0


def _transform_to_tool(jacobian: NDArray[Any], rotations: Sequence[int], tip: NDArray[Any]) -> None:
    """Replace rotations' origins ``jacobian[:3, rotations]`` by the displacement of the tool, z x (p - o)."""
    n = jacobian.shape[-1]
    # Few poses: many motions per call; many poses: a motion at a time, which fits the first-level cache.
    step = max(1, _ROW_SIZE // max(n, 1))
    for first in range(0, len(rotations), step):
        chunk = rotations[first : first + step]
        columns: Any = chunk if step > 1 else slice(chunk[0], chunk[0] + 1)
        x, y, z = tip[:, None] - jacobian[:3, columns]
        u, v, w = jacobian[3:, columns]
        jacobian[0, columns] = v * z - w * y
        jacobian[1, columns] = w * x - u * z
        jacobian[2, columns] = u * y - v * x


def _store(target: Poses, columns: list[NDArray[Any]], origin: NDArray[Any], block: slice) -> None:
    for axis in range(3):
        target.rotation[:, axis, block] = columns[axis]
    target.translation[:, block] = origin


def _advance(columns: list[NDArray[Any]], origin: NDArray[Any], motion: Motion, value: Scalar) -> NDArray[Any]:
    """Apply a motion: turn two of the frame's axes in place, or return the moved origin."""
    if motion.kind == "translation":
        return origin + columns[motion.axis] * value
    cosine, sine = _cos_sin(value)
    j, k = (motion.axis + 1) % 3, (motion.axis + 2) % 3
    first, second = columns[j], columns[k]
    columns[j] = cosine * first + sine * second
    columns[k] = cosine * second - sine * first
    return origin


def _cos_sin(angle: Scalar) -> tuple[Scalar, Scalar]:
    """Return cosine and sine; for arrays from the tangent of the half angle, which NumPy vectorises better.

    The absolute error is below 4e-16, also at pi, where the tangent is about 1e16 and both quotients are still exact.
    Complex arrays use the functions themselves, because a complex step at pi needs them.
    """
    if isinstance(angle, float):
        return math.cos(angle), math.sin(angle)
    if np.iscomplexobj(angle):
        return np.cos(angle), np.sin(angle)
    tangent = np.tan(0.5 * angle)
    square = tangent * tangent
    divisor = 1.0 / (1.0 + square)
    return (1.0 - square) * divisor, 2.0 * tangent * divisor
