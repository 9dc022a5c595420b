"""Status ``S`` of a KRL target: the side of the wrist centre on which a solution of the inverse kinematics lies.

Bit 0 is set where the wrist centre is behind axis 1 (overhead area), bit 1 where it is in front of the straight line
from axis 2 to axis 3, bit 2 where axis 5 is negative. Higher bits say nothing about the joints. Sources: KUKA System
Software 8, "Status and Turn"; in words, Beckhoff TF5200, "Status & Turn (IS, IT)". The signs of bits 1 and 2 agree with
the turn bits of axes 3 and 5 in recorded public programs.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.robots.arm import Arm

_STATUS = re.compile(r"\bS\s*'?(B[01]+|\d+)", re.IGNORECASE)
_N_AXES = 6
_SPHERICAL = 1e-4
"""m: distance from their common point up to which the wrist axes count as intersecting."""
_AT_BORDER = 1e-4
"""m or rad: distance from a border within which both values of a bit count."""


def allowed_by_status(arm: Arm, configuration: str, q: Array) -> NDArray[np.bool_]:
    """Return ``(N,)`` whether joints ``(J, N)`` have the status of a configuration; all, where it has none.

    Bits 0 and 1 need a wrist whose three axes intersect. Arms of other than six axes have no status.

    Args:
        arm: Nominal arm with the identity as its base frame, ``$ROBROOT``.
        configuration: ``S`` and ``T`` as the program writes them.
        q: Joints, rad.
    """
    status = status_number(configuration)
    if status is None or q.shape[0] != _N_AXES or not all(arm.is_revolute(name) for name in arm.names):
        return np.ones(q.shape[1], dtype=bool)
    measures = [(2, -q[4])]
    sides = _sides(arm, q)
    if sides is not None:
        measures += [(0, -sides[0]), (1, sides[1])]
    result = np.ones(q.shape[1], dtype=bool)
    for bit, value in measures:
        result &= (value > -_AT_BORDER) if status >> bit & 1 else (value < _AT_BORDER)
    return result


def status_number(configuration: str) -> int | None:
    """Return the number ``S``; None where it is not given."""
    match = _STATUS.search(configuration)
    if match is None:
        return None
    return int(match[1][1:], 2) if match[1][0] in "Bb" else int(match[1])


def _sides(arm: Arm, q: Array) -> tuple[Array, Array] | None:
    """Return the wrist centre's place ``(N,)`` m in front of axis 1, and of the line from axis 2 to axis 3.

    None for a wrist whose axes do not intersect.
    """
    points, axes = _lines(arm, q)
    across = np.eye(3)[:, :, None, None] - axes[:, None] * axes[None]
    matrix = across[:, :, 3:].sum(axis=2)
    right = np.einsum("abjn,bjn->an", across[:, :, 3:], points[:, 3:])
    # The axes of a wrist in its singular pose are still three lines, two of which coincide.
    solved = np.linalg.pinv(np.moveaxis(matrix, 2, 0), rcond=1e-9, hermitian=True) @ right.T[:, :, None]
    centre = solved[:, :, 0].T
    misses = np.einsum("abjn,bjn->ajn", across[:, :, 3:], centre[:, None] - points[:, 3:])
    if float(np.linalg.norm(misses, axis=0).max(initial=0.0)) > _SPHERICAL:
        return None
    second = axes[:, 1]
    # In front is where axis 2 turns the upright arm: along axis 2 crossed with the base's z.
    first = second[1] * (centre - points[:, 0])[0] - second[0] * (centre - points[:, 0])[1]
    # The component along axis 2 of a cross product has no part of the free places of the points along that axis.
    link, forearm = points[:, 2] - points[:, 1], centre - points[:, 2]
    moment = np.einsum("an,an->n", second, np.cross(link, forearm, axis=0))
    length = np.linalg.norm(link - second * np.einsum("an,an->n", second, link), axis=0)
    return first, moment / np.maximum(length, _SPHERICAL)


def _lines(arm: Arm, q: Array) -> tuple[Array, Array]:
    """Return a point and the positive direction of each joint's axis, each ``(3, J, N)``, base frame."""
    joints = arm.robot.variables
    sweep = arm.chain.sweep(arm.chain.scalars(q), q.shape[1], [arm.axis_motion(joint.name) for joint in joints])
    turning, moving = sweep.jacobian[3:], sweep.jacobian[:3]
    points = sweep.poses.translation[:, None] - np.cross(moving, turning, axis=0)
    signs = np.array([float(joint.sign) for joint in joints])
    return points, turning * signs[:, None]
