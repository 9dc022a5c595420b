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

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array, Poses, cross
from robacc.gravity.loads import Load, own_weight
from robacc.robots.arm import Arm


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


def force(gravity: Array, weights: Weights, motion: int, linear: NDArray[Any], angular: NDArray[Any]) -> NDArray[Any]:
    """Return the generalised force ``(N,)`` of gravity ``(3,)`` along ``motion`` of spatial twist ``(3, N)`` twice."""
    mass, first_moment = weights.moved_by(motion)
    result: NDArray[Any] = mass * (gravity @ linear)
    for i, component in enumerate(gravity.tolist()):
        if component:
            j, k = (i + 1) % 3, (i + 2) % 3
            result = result + component * (angular[j] * first_moment[k] - angular[k] * first_moment[j])
    return result


def force_derivatives(
    gravity: Array, weights: Weights, motion: int, wanted: Sequence[int], linear: Array, angular: Array
) -> Array:
    """Return the derivative ``(W, N)`` of :func:`force` along ``motion`` to the scalar of each wanted motion.

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


def gravity_torques(arm: Arm, q: Array, loads: Sequence[Load] | None = None) -> Array:
    """Return the torque (N m) or force (N) ``(J, N)`` of loads along each joint's axis at its nominal pose.

    The default loads are the arm's own links.
    """
    return moments(arm, q, arm.chain.joint_axis, own_weight(arm) if loads is None else loads)


def moments(arm: Arm, q: Array, motions: Sequence[int], loads: Sequence[Load] | None = None) -> Array:
    """Return the generalised force ``(K, N)`` of loads along each of ``motions`` at the nominal poses.

    The default loads are the arm's own links.
    """
    loads = own_weight(arm) if loads is None else loads
    counts = sorted({load.after for load in loads})
    sweep = arm.chain.sweep(arm.chain.scalars(q), q.shape[1], tuple(motions), counts)
    weights = Weights.place(loads, dict(zip(counts, sweep.frames, strict=True)))
    linear, angular = sweep.twists()
    gravity = np.array(arm.robot.gravity)
    return np.stack([force(gravity, weights, k, linear[:, i], angular[:, i]) for i, k in enumerate(motions)])
