"""Targets of a program for an arm: poses of the flange, joints, and the configurations that programs write.

KRL writes ``S s,T t``: bit i of T is set where axis i + 1 is negative (KUKA, Expert Programming, "Status and Turn");
for S see below.
RAPID writes ``[cf1,cf4,cf6,cfx]``: the quarter turns of axes 1, 4 and 6, 0 from 0 to 90 degrees and -1 from -90 to 0
degrees (ABB, Technical reference manual, "confdata"). Both count the axes of a six-axis arm, so they are not read for
other chains, such as an arm on a rail. cfx is not read.

A FANUC ``CONFIG`` ends with three turn numbers: 0 from -180 to 180 degrees, 1 from 180 degrees on. Public sources agree
that the third is that of axis 6; the first two are those of axes 1 and 4, or 4 and 5, so equal ones are that of axis 4
in both readings. The joints behind the letters of ``CONFIG``, and behind the words of a Staubli point, depend on the
arm and are not read.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array, Poses, quaternion_from_rotation, rotation_from_quaternion, rotation_from_rpy
from robacc.programs.program import Dialect, Program, ProgramFrame
from robacc.robots.arm import Arm

# Cartesian targets as poses of the flange in the robot's base frame, and back, through each target's tool and base.


def flange_targets(program: Program) -> tuple[tuple[int, ...], Poses, tuple[tuple[int, str], ...]]:
    """Return the Cartesian targets of a program whose tool and base are known, and the flange's poses at them.

    Returns:
        Index of each of these targets in ``Program.targets``; the flange's poses over them in the robot's base frame;
        index of each other Cartesian target, with the reason.
    """
    reasons = {
        i: _unknown(target.tool, "tool") or _unknown(target.base, "base")
        for i, target in enumerate(program.targets)
        if target.kind == "cartesian"
    }
    numbers = tuple(i for i, reason in reasons.items() if not reason)
    targets = [program.targets[i] for i in numbers]
    values = np.array([target.values for target in targets], dtype=float).reshape(-1, 7).T
    poses = Poses(rotation_from_quaternion(values[3:]), values[:3])
    base, tool = _poses(target.base for target in targets), _poses(target.tool for target in targets)
    return numbers, base @ poses @ tool.inverse(), tuple((i, reason) for i, reason in reasons.items() if reason)


def values_at(program: Program, numbers: Sequence[int], flange: Poses) -> list[tuple[float, ...]]:
    """Return the values of targets (x, y, z and quaternion) that bring the flange to poses in the robot's base frame.

    Args:
        program: Program of the targets.
        numbers: Index of each target.
        flange: Poses over the same targets.
    """
    base, tool = _poses(program.targets[i].base for i in numbers), _poses(program.targets[i].tool for i in numbers)
    poses = base.inverse() @ flange @ tool
    columns = np.concatenate((poses.translation, quaternion_from_rotation(poses.rotation)))
    return [tuple(column) for column in columns.T.tolist()]


def joint_targets(program: Program) -> tuple[tuple[int, ...], Array]:
    """Return the indices of a program's joint targets, and their joint variables ``(J, N)``, rad and m.

    Raises:
        ValueError: Targets have different numbers of joints.
    """
    numbers = tuple(i for i, target in enumerate(program.targets) if target.kind == "joint")
    rows = [program.targets[i].values for i in numbers]
    if len({len(row) for row in rows}) > 1:
        raise ValueError("the joint targets have different numbers of joints")
    return numbers, np.array(rows, dtype=float).T if rows else np.empty((0, 0))


def _unknown(frame: ProgramFrame | None, kind: str) -> str:
    """Return why a frame is unknown; empty where it is known."""
    if frame is None:
        return f"the program names no {kind}, or several, for this target"
    return f"the {kind} {frame.name} is in none of the files read" if frame.frame is None else ""


def _poses(frames: Iterable[ProgramFrame | None]) -> Poses:
    """Return known frames as poses over N."""
    known = [frame.frame for frame in frames if frame and frame.frame]
    coordinates = np.array([(frame.xyz, frame.rpy) for frame in known], dtype=float).reshape(-1, 2, 3).T
    return Poses(rotation_from_rpy(coordinates[:, 1]), coordinates[:, 0])


# Status ``S`` of a KRL target: the side of the wrist centre on which a solution of the inverse kinematics lies.
#
# Bit 0 is set where the wrist centre is behind axis 1 (overhead area), bit 1 where it is in front of the straight
# line from axis 2 to axis 3, bit 2 where axis 5 is negative. Higher bits say nothing about the joints. Sources: KUKA
# System Software 8, "Status and Turn"; in words, Beckhoff TF5200, "Status & Turn (IS, IT)". The signs of bits 1 and 2
# agree with the turn bits of axes 3 and 5 in recorded public programs.

_STATUS = re.compile(r"\bS\s*'?(B[01]+|\d+)", re.IGNORECASE)
_N_AXES = 6
_SPHERICAL = 1e-4
"""m: distance from their common point up to which the wrist axes count as intersecting."""
_BESIDE_BORDER = 1e-4
"""m or rad: distance from a border within which both values of a bit count."""


def allowed_by_status(arm: Arm, configuration: str, q: Array) -> NDArray[np.bool_]:
    """Return ``(N,)`` whether joints ``(J, N)`` have the status of a configuration; all, where it has none.

    Bits 0 and 1 need a wrist whose three axes intersect. Arms of other than six axes have no status.

    Args:
        arm: Nominal arm with the identity as its base frame, ``$ROBROOT``.
        configuration: ``S`` and ``T`` as the program writes them.
        q: Joints, rad.
    """
    status = _bits(_STATUS, configuration)
    if status is None or q.shape[0] != _N_AXES or not all(arm.is_revolute(name) for name in arm.names):
        return np.ones(q.shape[1], dtype=bool)
    measures = [(2, -q[4])]
    if (sides := _sides(arm, q)) is not None:
        measures += [(0, -sides[0]), (1, sides[1])]
    signed = [value if status >> bit & 1 else -value for bit, value in measures]
    return np.asarray(np.all(np.array(signed) > -_BESIDE_BORDER, axis=0))


def _bits(pattern: re.Pattern[str], configuration: str) -> int | None:
    """Return a number that is written in binary digits, ``'B010'``, or in decimal ones; None where it is not given."""
    match = pattern.search(configuration)
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


_TURN = re.compile(r"\bT\s*'?(B[01]+|\d+)", re.IGNORECASE)
_NUMBERS = re.compile(r"-?\d+")
_READ_WHOLE = (Dialect.krl, Dialect.rapid)
"""Dialects whose configuration is read as a whole; others name the side of axis 5 by a letter or a word."""
_AT_BORDER = 1e-3
"""rad: distance from a border within which both sides count."""


def joint_window(dialect: str, configuration: str, n_joints: int) -> Array | None:
    """Return the least and the largest value ``(2, J)`` of each joint that a configuration allows, rad.

    They are infinite where it says nothing; None where it is not given, or not read.
    """
    low, high = window = np.repeat([[-np.inf], [np.inf]], _N_AXES, axis=1)
    numbers = [int(number) for number in _NUMBERS.findall(configuration)]
    if n_joints != _N_AXES:
        return None
    if dialect == Dialect.krl and (turn := _bits(_TURN, configuration)) is not None:
        is_negative = np.array([turn >> i & 1 for i in range(_N_AXES)], dtype=bool)
        low[~is_negative] = high[is_negative] = 0.0
    elif dialect == Dialect.fanuc and len(numbers) == 3:
        window[:, 5] = _turn_range(numbers[2])
        if numbers[0] == numbers[1]:
            window[:, 3] = _turn_range(numbers[0])
    elif dialect == Dialect.rapid and len(numbers) >= 3:
        # Quarter turns of the axes 1, 4 and 6.
        window[:, [0, 3, 5]] = 0.5 * np.pi * np.add(numbers[:3], [[0], [1]])
    elif dialect != Dialect.krl or _bits(_STATUS, configuration) is None:
        return None
    return window


def allowed_by_window(window: Array, q: Array) -> NDArray[np.bool_]:
    """Return ``(N,)`` whether each column of joints ``(J, N)``, rad, lies in the window of a configuration."""
    low, high = window[:, :, None]
    return np.asarray(np.all((q > low - _AT_BORDER) & (q < high + _AT_BORDER), axis=0))


def turned_into(window: Array, q: Array, limits: tuple[Array, Array], revolute: NDArray[np.bool_]) -> Array:
    """Return joints ``(J, N)`` with whole turns added where these bring a revolute joint into a window.

    Args:
        window: From :func:`joint_window`.
        q: Joints, rad.
        limits: Lower and upper joint limits, each ``(J,)``, rad or m.
        revolute: ``(J,)`` whether a joint turns.
    """
    low, high = window[:, :, None] + _AT_BORDER * np.array([-1, 1])[:, None, None]
    up, down = (np.maximum(np.ceil(gap / (2.0 * np.pi)), 0.0) for gap in (low - q, q - high))
    moved = q + 2.0 * np.pi * (up - down)
    fits = (moved > low) & (moved < high) & (moved >= limits[0][:, None]) & (moved <= limits[1][:, None])
    return np.where(fits & revolute[:, None], moved, q)


def is_read(dialect: str, configuration: str, n_joints: int) -> bool:
    """Return whether a configuration is given and read as a whole, letters and words too."""
    return dialect in _READ_WHOLE and joint_window(dialect, configuration, n_joints) is not None


def leaves_configuration(dialect: str, configuration: str, before: Array, after: Array) -> bool:
    """Return whether corrected joints have another configuration than the one that a target states.

    Joints that were on a border already leave nothing.

    Args:
        dialect: Language of the program.
        configuration: Configuration as written.
        before: Joints ``(J,)`` of the target, rad.
        after: Corrected joints ``(J,)``, rad.
    """
    window = joint_window(dialect, configuration, before.size)
    if window is not None:
        inside = (before > window[0]) & (before < window[1])
        if np.any(inside & ((after < window[0]) | (after > window[1]))):
            return True
    is_flipped = before.size == _N_AXES and before[4] * after[4] < 0
    return bool(dialect not in _READ_WHOLE and configuration and is_flipped)


def _turn_range(turn: int) -> tuple[float, float]:
    """Return the range (rad) of an axis of a turn number; sources differ on turns beyond the first."""
    first, last = {0: (-np.pi, np.pi), 1: (np.pi, 3.0 * np.pi)}.get(abs(turn), (2.0 * np.pi, np.inf))
    return (first, last) if turn >= 0 else (-last, -first)
