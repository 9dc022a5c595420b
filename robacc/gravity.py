"""Weights of an arm and its payload, and what gravity does with them: generalised forces and exact derivatives.

For loads of total mass M and first moment of mass S = sum m_i c_i behind a motion of spatial twist (v, w), the power of
gravity per unit rate of the motion is

    f = g . (M v + w x S) = M g . v + w . (S x g),

the torque about a rotation's axis or the force along a translation. A motion k of twist (v_k, w_k) in front of it
turns the whole force with the chain, p = M v + w x S; a motion k behind it moves only the loads further out:

    k in front:  df = g . (w_k x p) = w_k . (p x g)
    k behind:    df = (M_k v_k + w_k x S_k) . (g x w)   (loads behind k only).

Source of the twist algebra: R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 2.
"""

import math
import operator
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from robacc.geometry import Array, NDArray, Poses, cross
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


class Load(NamedTuple):
    """Weight in the frame after motion ``after - 1``: mass (kg) and first moment of mass, mass x com (kg m)."""

    after: int
    mass: float | Array
    """Scalar, or ``(N,)`` where it differs between poses."""
    first_moment: tuple[float | Array, float | Array, float | Array]


def combined(shares: Iterable[tuple[float, Sequence[Load]]]) -> tuple[Load, ...]:
    """Return a sum of loads, each with a factor, as one load for each frame."""
    totals: dict[int, list[float | Array]] = {}
    for share, loads in shares:
        for after, mass, first_moment in loads:
            values = zip(totals.get(after, [0.0] * 4), (mass, *first_moment), strict=True)
            totals[after] = [total + share * value for total, value in values]
    return tuple(Load(after, mass, (x, y, z)) for after, (mass, x, y, z) in totals.items())


def own_weight(arm: Arm, data: Measurements | None = None) -> tuple[Load, ...]:
    """Return the loads of the arm's own links, and of the branches that they carry.

    Branches stand as in ``data``; where it does not have their joints, at the positions of the robot file. Joints of
    branches that follow joints of the chain stand as those, at zero without ``data``. Branches of an arm without masses
    do not count.
    """
    loads = [
        Load(body.after, body.mass, (body.mass * x, body.mass * y, body.mass * z))
        for body in arm.chain.bodies
        for x, y, z in (body.com,)
    ]
    return (*loads, *_branch_loads(arm, data)) if loads and arm.branches else tuple(loads)


def _branch_loads(arm: Arm, data: Measurements | None) -> Iterator[Load]:
    """Yield the load of each branch in the frame of the link that carries it."""
    # The variables (B + J, N) of the branches and of the chain; one column if none of them counts.
    at_rest = np.array([branch.position for branch in arm.robot.branch_variables])[:, None]
    positions = at_rest if data is None or data.branches is None else data.branches
    follow = any(drive.joint >= len(at_rest) for _, chain in arm.branches for drive in chain.drives)
    q = data.q if data is not None and follow else None
    q = np.zeros((len(arm.names), positions.shape[1])) if q is None else q
    n = q.shape[1]
    positions = np.vstack((np.broadcast_to(positions, (len(positions), n)), q))
    for after, chain in arm.branches:
        frames = chain.sweep(chain.scalars(positions), n, (), [body.after for body in chain.bodies]).frames
        first_moment = np.zeros((3, n))
        for body, frame in zip(chain.bodies, frames, strict=True):
            first_moment += body.mass * (np.einsum("ijn,j->in", frame.rotation, np.array(body.com)) + frame.translation)
        mass = sum(body.mass for body in chain.bodies)
        x, y, z = first_moment if n > 1 else first_moment[:, 0].tolist()
        yield Load(after, mass, (x, y, z))


def payload(arm: Arm, mass: Array) -> tuple[Load, ...]:
    """Return the load of a payload of ``mass`` ``(N,)`` kg at its centre of mass."""
    x, y, z = arm.payload_com
    return (Load(arm.flange, mass, (mass * x, mass * y, mass * z)),)


UNIT_LOADS = {
    "hx": (0.0, (1.0, 0.0, 0.0)),
    "hy": (0.0, (0.0, 1.0, 0.0)),
    "hz": (0.0, (0.0, 0.0, 1.0)),
    "m": (1.0, (0.0, 0.0, 0.0)),
}
"""Mass and first moment of each base regressor of a link, by label."""


def unit_loads(arm: Arm, first: int) -> dict[str, tuple[Load, ...]]:
    """Return the base regressors of unknown weights: unit mass and unit first moments of each link from ``first`` on.

    Keys are ``m3``, ``hx3``, ``hy3``, ``hz3`` for the link that joint 3 of the robot's list (counted from 1) moves.
    The fit determines which of them the poses identify.
    """
    ends = {motion.owner: k + 1 for k, motion in enumerate(arm.chain.motions)}
    return {
        f"{label}{owner + 1}": (Load(ends[owner], mass, moment),)
        for owner in range(first, len(arm.robot.joints))
        for label, (mass, moment) in UNIT_LOADS.items()
    }


LEVEL = math.radians(1.0)
"""Angle within which a direction counts as vertical or horizontal, rad: bases and frames are levelled to some tenths of
a degree."""


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
    varying: list[tuple[int, Load]] = []
    for k, load in ((k, load) for k, (motion, loads) in enumerate(weighted) for load in loads if load.after > motion):
        parts, at = (*load.first_moment, load.mass), row[load.after]
        if any(isinstance(part, np.ndarray) for part in parts):
            varying.append((k, load))
        else:
            constants[k, at : at + 4] += np.array(parts, dtype=np.float64)
    axes = np.empty((4 * len(counts), 3, n), dtype=linear.dtype)
    for count, at in row.items():
        axes[at : at + 3] = frames[count].rotation.transpose(1, 0, 2)
        axes[at + 3] = frames[count].translation
    first_moments = (constants @ axes.reshape(len(axes), 3 * n)).reshape(len(weighted), 3, n)
    total_masses = np.repeat(constants[:, 3::4].sum(axis=1, keepdims=True), n, axis=1)
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
    gravity: Array,
    weighted: Weighted,
    frames: Mapping[int, Poses],
    wanted: Sequence[int],
    linear: Array,
    angular: Array,
) -> Array:
    """Return the derivative ``(W, N)`` of a force of :func:`forces` to the scalar of each wanted motion.

    ``linear`` and ``angular`` ``(3, W, N)`` are the twists of the wanted motions, of which the weighted one is one.
    """
    motion, loads = weighted
    placed = []
    for load in loads:
        turn, (x, y, z) = frames[load.after].rotation, load.first_moment
        moment = turn[:, 0] * x + turn[:, 1] * y + turn[:, 2] * z + load.mass * frames[load.after].translation
        placed.append((load.after, load.mass, moment))

    def moved_by(motion: int) -> tuple[Any, Any]:
        """Return total mass and first moment, in the measuring frame, of the loads that a motion moves."""
        moved = [(mass, moment) for after, mass, moment in placed if after > motion]
        return sum(mass for mass, _ in moved), sum((moment for _, moment in moved), np.zeros((3, linear.shape[-1])))

    slot, down = list(wanted).index(motion), gravity[:, None]
    v, w = linear[:, slot], angular[:, slot]
    mass, first_moment = moved_by(motion)
    result = np.asarray(np.einsum("ikn,in->kn", angular, cross(mass * v + cross(w, first_moment), down)))
    # Behind the motion the loads change only where a body is in between: motions with the same next body are grouped.
    following = [min((load.after for load in loads if load.after > k), default=-1) for k in wanted]
    behind = [i for i, k in enumerate(wanted) if k >= motion]
    lever = -cross(w, down)
    for body in {following[i] for i in behind}:
        at = [i for i in behind if following[i] == body]
        mass, first_moment = moved_by(wanted[at[0]])
        result[at] = mass * np.einsum("ikn,in->kn", linear[:, at], lever)
        result[at] += np.einsum("ikn,in->kn", angular[:, at], cross(first_moment, lever))
    return result


def bears_weight(arm: Arm, q: Array) -> tuple[bool, ...]:
    """Return for each joint whether a weight can load it at any of the nominal poses of ``q`` ``(J, N)``.

    It cannot if the axis of a rotary joint stays vertical, or that of a slide horizontal, within
    :data:`LEVEL` at all poses.
    """
    gravity = np.array(arm.robot.gravity)
    least = math.sin(LEVEL) * float(np.linalg.norm(gravity))
    twists = arm.chain.jacobian(q, arm.chain.joint_axis)
    levers = (
        cross(twist[3:], gravity[:, None]) if arm.is_revolute(joint) else gravity @ twist[:3]
        for joint, twist in zip(arm.names, twists.transpose(1, 0, 2), strict=True)
    )
    return tuple(bool(np.abs(lever).max(initial=0.0) > least) for lever in levers)


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
    if not all(map(operator.is_, inputs, _last)):
        torques = gravity_torques(arm, data.q, own_weight(arm, data))
        torques.flags.writeable = False
        _last[:] = (*inputs, torques)
    return np.asarray(_last[-1])


_last: list[Any] = [None] * 4
"""Arm, joints and branches of the last call of :func:`weight_torques`, and its result."""


def moments(arm: Arm, q: Array, motions: Sequence[int], loads: Sequence[Load]) -> Array:
    """Return the generalised force ``(K, N)`` of loads along each of ``motions`` at the nominal poses."""
    counts = sorted({load.after for load in loads})
    sweep = arm.chain.sweep(arm.chain.scalars(q), q.shape[1], tuple(motions), counts)
    weighted = [Weighted(motion, tuple(loads)) for motion in motions]
    frames = dict(zip(counts, sweep.frames, strict=True))
    return forces(np.array(arm.robot.gravity), weighted, frames, *sweep.twists())
