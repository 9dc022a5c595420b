"""Loads on the joints: the arm's own links, a payload, and unit loads where masses are unknown."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@dataclass(frozen=True, slots=True)
class Load:
    """Weight in the frame after motion ``after - 1``: mass (kg) and first moment of mass, mass x com (kg m)."""

    after: int
    mass: float | Array
    """Scalar, or ``(N,)`` where it differs between poses."""
    first_moment: tuple[float | Array, float | Array, float | Array]


def combined(shares: Iterable[tuple[float, Sequence[Load]]]) -> tuple[Load, ...]:
    """Return a sum of loads, each with a factor, as one load for each frame."""
    totals: dict[int, list[float | Array]] = {}
    for share, loads in shares:
        for load in loads:
            total = totals.setdefault(load.after, [0.0] * 4)
            for i, value in enumerate((load.mass, *load.first_moment)):
                total[i] = total[i] + share * value
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
    return (*loads, *_branch_loads(arm, data)) if loads else ()


def _branch_loads(arm: Arm, data: Measurements | None) -> Iterator[Load]:
    """Yield the load of each branch in the frame of the link that carries it."""
    if not arm.branches:
        return
    positions = _branch_positions(arm, data)
    for after, chain in arm.branches:
        counts = [body.after for body in chain.bodies]
        n = positions.shape[1]
        frames = chain.sweep(chain.scalars(positions), n, (), counts).frames
        first_moment = np.zeros((3, n))
        for body, frame in zip(chain.bodies, frames, strict=True):
            com = np.array(body.com)
            first_moment += body.mass * (np.einsum("ijn,j->in", frame.rotation, com) + frame.translation)
        mass = sum(body.mass for body in chain.bodies)
        x, y, z = first_moment if n > 1 else first_moment[:, 0].tolist()
        yield Load(after, mass, (x, y, z))


def _branch_positions(arm: Arm, data: Measurements | None) -> Array:
    """Return the variables ``(B + J, N)`` of the branches and of the chain; ``(B + J, 1)`` if none of them counts."""
    at_rest = np.array([branch.position for branch in arm.robot.branch_variables])[:, None]
    positions = at_rest if data is None or data.branches is None else data.branches
    follow = any(drive.joint >= len(at_rest) for _, chain in arm.branches for drive in chain.drives)
    q = data.q if data is not None and follow else None
    q = np.zeros((len(arm.names), positions.shape[1])) if q is None else q
    return np.vstack((np.broadcast_to(positions, (len(positions), q.shape[1])), q))


def payload(arm: Arm, mass: Array) -> tuple[Load, ...]:
    """Return the load of a payload of ``mass`` ``(N,)`` kg at its centre of mass."""
    x, y, z = arm.payload_com
    return (Load(arm.flange, mass, (mass * x, mass * y, mass * z)),)


def unit_loads(arm: Arm, first: int) -> dict[str, tuple[Load, ...]]:
    """Return the base regressors of unknown weights: unit mass and unit first moments of each link from ``first`` on.

    Keys are ``m3``, ``hx3``, ``hy3``, ``hz3`` for the link that joint 3 of the robot's list (counted from 1) moves.
    The fit determines which of them the poses identify.
    """
    loads: dict[str, tuple[Load, ...]] = {}
    ends = {motion.owner: k + 1 for k, motion in enumerate(arm.chain.motions)}
    for owner in range(first, len(arm.robot.joints)):
        after = ends[owner]
        for axis, label in enumerate(("hx", "hy", "hz")):
            first_moment = tuple(1.0 if i == axis else 0.0 for i in range(3))
            loads[f"{label}{owner + 1}"] = (Load(after, 0.0, first_moment),)  # type: ignore[arg-type]
        loads[f"m{owner + 1}"] = (Load(after, 1.0, (0.0, 0.0, 0.0)),)
    return loads
