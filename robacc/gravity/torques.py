"""Gravity on a chain: generalised forces and their exact derivatives.

For loads of total mass M and first moment of mass S = sum m_i c_i behind a motion of spatial twist (v, w), the power of
gravity per unit rate of the motion is

    f = g . (M v + w x S) = M g . v + w . (S x g),

the torque about a rotation's axis or the force along a translation. A motion k of twist (v_k, w_k) in front of it
turns the whole force with the chain, p = M v + w x S; a motion k behind it moves only the loads further out:

    k in front:  df = g . (w_k x p) = w_k . (p x g)
    k behind:    df = (M_k v_k + w_k x S_k) . (g x w)   (loads behind k only).

Source of the twist algebra: R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 2.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array, Poses, cross
from robacc.gravity.loads import Load, own_weight
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

LEVEL = math.radians(1.0)
"""Angle within which a direction counts as vertical or horizontal, rad: bases and frames are levelled to some tenths of
a degree."""


@dataclass(frozen=True, slots=True)
class Weights:
    """Loads of the same kind, placed in the measuring frame."""

    after: tuple[int, ...]
    masses: tuple[Array, ...]
    """Each ``(N,)`` or a scalar array, kg."""
    first_moments: tuple[Array, ...]
    """Each ``(3, N)``: mass x position, kg m."""

    @classmethod
    def place(cls, loads: Sequence[Load], frames: dict[int, Poses]) -> Weights:
        """Transform loads from their link frames to the measuring frame."""
        first_moments = []
        for load in loads:
            frame = frames[load.after]
            x, y, z = load.first_moment
            turn = frame.rotation
            first_moments.append(turn[:, 0] * x + turn[:, 1] * y + turn[:, 2] * z + load.mass * frame.translation)
        masses = tuple(np.asarray(load.mass, dtype=float) for load in loads)
        return cls(tuple(load.after for load in loads), masses, tuple(first_moments))

    def moved_by(self, motion: int) -> tuple[Any, Any]:
        """Return total mass and first moment of the loads that ``motion`` moves; zeros where it moves none."""
        total_mass: Any = 0.0
        total_moment: Any = np.zeros((3, 1))
        for after, mass, first_moment in zip(self.after, self.masses, self.first_moments, strict=True):
            if after > motion:
                total_mass = total_mass + mass
                total_moment = total_moment + first_moment
        return total_mass, total_moment


class Weighted(NamedTuple):
    """A motion and the loads of which gravity's force along it is sought; those in front of the motion do not count."""

    motion: int
    loads: tuple[Load, ...]


def forces(
    gravity: Array,
    weighted: Sequence[Weighted],
    frames: Mapping[int, Poses],
    linear: NDArray[Any],
    angular: NDArray[Any],
) -> NDArray[Any]:
    """Return the generalised forces ``(K, N)`` of gravity ``(3,)`` along K motions of spatial twists ``(3, K, N)``.

    First moments of all motions are one product of the loads' constants with the axes and origins of the frames.
    """
    counts = sorted(frames)
    row = {count: 4 * i for i, count in enumerate(counts)}
    n = linear.shape[-1]
    constants = np.zeros((len(weighted), 4 * len(counts)))
    masses = np.zeros((len(weighted), 1))
    varying: list[tuple[int, Load]] = []
    for k, (motion, loads) in enumerate(weighted):
        for load in loads:
            if load.after <= motion:
                continue
            parts = (*load.first_moment, load.mass)
            if any(isinstance(part, np.ndarray) for part in parts):
                varying.append((k, load))
                continue
            at = row[load.after]
            constants[k, at : at + 4] += np.array(parts, dtype=np.float64)
            masses[k] += load.mass
    axes = np.empty((4 * len(counts), 3, n), dtype=linear.dtype)
    for count, at in row.items():
        axes[at : at + 3] = frames[count].rotation.transpose(1, 0, 2)
        axes[at + 3] = frames[count].translation
    first_moments = (constants @ axes.reshape(len(axes), 3 * n)).reshape(len(weighted), 3, n)
    total_masses = np.broadcast_to(masses, (len(weighted), n))
    if varying:
        total_masses = total_masses.copy()
        for k, load in varying:
            at = row[load.after]
            for part, axis in zip((*load.first_moment, load.mass), axes[at : at + 4], strict=True):
                first_moments[k] += part * axis
            total_masses[k] += load.mass
    result: NDArray[Any] = total_masses * np.einsum("i,ikn->kn", gravity, linear)
    for i, component in enumerate(gravity.tolist()):
        if component:
            j, k = (i + 1) % 3, (i + 2) % 3
            result += component * (angular[j] * first_moments[:, k] - angular[k] * first_moments[:, j])
    return result


def force_derivatives(
    gravity: Array, weights: Weights, motion: int, wanted: Sequence[int], linear: Array, angular: Array
) -> Array:
    """Return the derivative ``(W, N)`` of :func:`forces` along ``motion`` to the scalar of each wanted motion.

    ``linear`` and ``angular`` ``(3, W, N)`` are the twists of the wanted motions, of which ``motion`` must be one.
    """
    slot = list(wanted).index(motion)
    v, w = linear[:, slot], angular[:, slot]
    mass, first_moment = weights.moved_by(motion)
    across = _cross(mass * v + cross(w, first_moment + np.zeros_like(w)), gravity)
    result: Array = np.einsum("ikn,in->kn", angular, across)
    # Behind the motion the loads change only where a body is in between, so motions with equal loads are grouped.
    behind = [i for i, k in enumerate(wanted) if k >= motion]
    lever = -_cross(w, gravity)
    for after in sorted({_next_body(weights, wanted[i]) for i in behind}):
        at = [i for i in behind if _next_body(weights, wanted[i]) == after]
        mass, first_moment = weights.moved_by(wanted[at[0]])
        turning = cross(first_moment + np.zeros_like(lever), lever)
        result[at] = mass * np.einsum("ikn,in->kn", linear[:, at], lever)
        result[at] += np.einsum("ikn,in->kn", angular[:, at], turning)
    return result


def _cross(vectors: NDArray[Any], constant: Array) -> NDArray[Any]:
    """Return the cross product of vectors ``(3, N)`` and a constant vector ``(3,)``."""
    return cross(vectors, constant[:, None])


def _next_body(weights: Weights, motion: int) -> int:
    """Return the first body that ``motion`` moves; motions with the same first body move the same loads."""
    return min((after for after in weights.after if after > motion), default=-1)


def bears_weight(arm: Arm, q: Array) -> tuple[bool, ...]:
    """Return for each joint whether a weight can load it at any of the nominal poses of ``q`` ``(J, N)``.

    It cannot if the axis of a rotary joint stays vertical, or that of a slide horizontal, within
    :data:`LEVEL` at all poses.
    """
    gravity = np.array(arm.robot.gravity)
    size = float(np.linalg.norm(gravity))
    twists = arm.chain.jacobian(q, arm.chain.joint_axis)
    shares = []
    for number, motion in enumerate(arm.chain.joint_axis):
        is_rotation = arm.chain.motions[motion].kind == "rotation"
        axis = twists[3:, number] if is_rotation else twists[:3, number]
        lever = cross(axis, np.broadcast_to(gravity[:, None], axis.shape)) if is_rotation else gravity @ axis
        shares.append(np.abs(lever).max(initial=0.0) > math.sin(LEVEL) * size)
    return tuple(map(bool, shares))


def gravity_torques(arm: Arm, q: Array, loads: Sequence[Load] | None = None) -> Array:
    """Return the torque (N m) or force (N) ``(J, N)`` of loads along each joint's axis at its nominal pose.

    The default loads are the arm's own links.
    """
    return moments(arm, q, arm.chain.joint_axis, own_weight(arm) if loads is None else loads)


def weight_torques(arm: Arm, data: Measurements) -> Array:
    """Return the torque (N m) or force (N) ``(J, N)`` of the arm's own weight along each joint's axis.

    It is that of the nominal poses, with branches as they stand in ``data``, which must have joint variables. The last
    result is kept, read-only: hundreds of candidates ask for the same one.
    """
    assert data.q is not None
    inputs = (arm, data.q, data.branches)
    *kept, torques = _last
    if not all(map(operator.is_, inputs, kept)):
        torques = gravity_torques(arm, data.q, own_weight(arm, data))
        torques.flags.writeable = False
        _last[:] = (*inputs, torques)
    result: Array = torques
    return result


_last: list[Any] = [None] * 4
"""Arm, joints and branches of the last call of :func:`weight_torques`, and its result."""


def moments(arm: Arm, q: Array, motions: Sequence[int], loads: Sequence[Load] | None = None) -> Array:
    """Return the generalised force ``(K, N)`` of loads along each of ``motions`` at the nominal poses.

    The default loads are the arm's own links.
    """
    loads = own_weight(arm) if loads is None else loads
    counts = sorted({load.after for load in loads})
    sweep = arm.chain.sweep(arm.chain.scalars(q), q.shape[1], tuple(motions), counts)
    linear, angular = sweep.twists()
    weighted = [Weighted(motion, tuple(loads)) for motion in motions]
    frames = dict(zip(counts, sweep.frames, strict=True))
    return forces(np.array(arm.robot.gravity), weighted, frames, linear, angular)
