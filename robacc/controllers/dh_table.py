"""Denavit-Hartenberg table of any arm: its joint axes as frames, and the same poses with four numbers a joint.

Two axes that are not exactly parallel have one common normal, and with it one row. For nearly parallel axes the normal
lies far away: d is then hundreds of metres, as in the calibration files of Universal Robots. The poses are the same.

Source: J. Denavit and R. S. Hartenberg, "A kinematic notation for lower-pair mechanisms based on matrices", J. Applied
Mechanics 22, 1955; J. J. Craig, Introduction to Robotics (1986), for the modified form.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from robacc.chain import BASE
from robacc.errors import UsageError
from robacc.geometry import Array, Poses, exp_so3, rotation_about
from robacc.robots.arm import Arm
from robacc.robots.description import ORIGIN_PARAMETERS, Frame, Joint, JointType, Robot

FULL_TURN = (-2 * np.pi, 2 * np.pi)
"""Limits of the joints of files that state none, rad."""

# Arm as frames on its joint axes, whatever the convention of its description.


@dataclass(frozen=True, slots=True)
class JointFrames:
    """Joint frames of an arm with all joint variables at zero, in the robot's base frame.

    The tool pose is ``M_1(q_1) M_2(q_2) … F`` with ``M_i`` the motion by q_i along or about the z axis of frame i.
    """

    joints: tuple[Joint, ...]
    frames: tuple[Poses, ...]
    """Frame of each joint variable; z is its axis, in the positive direction."""
    flange: Poses
    """Last link's frame, which the tool is attached to."""

    def steps(self) -> list[Poses]:
        """Return each frame in the one before it, the first in the base frame, the flange last."""
        chain = [Poses.identity(), *self.frames, self.flange]
        return [before.inverse() @ after for before, after in itertools.pairwise(chain)]


def joint_frames(robot: Robot) -> JointFrames:
    """Return the joint frames of an arm, without the effects of its file.

    Raises:
        UsageError: A joint follows others, which controllers' parameters cannot describe.
    """
    arm = Arm.of(robot)
    chain = arm.chain
    simple = {(k, i) for i, k in enumerate(chain.joint_axis)}
    coupled = [drive for drive in chain.drives if (drive.motion, drive.joint) not in simple]
    if coupled:
        names = sorted({robot.joints[chain.motions[drive.motion].owner].name for drive in coupled})
        raise UsageError(f"{', '.join(names)} follows other joints; the format has no joint that does")
    counts = []
    for k in chain.joint_axis:
        count = k + 1
        # A DH row's d lies on the axis too: the frame behind it is the one that drawings show.
        while count < len(chain.motions) and chain.motions[count].axis == 2 and chain.motions[count].label == "d":
            count += 1
        counts.append(count)
    first = next((k for k, motion in enumerate(chain.motions) if motion.owner != BASE), 0)
    wanted = sorted({first, *counts, arm.flange})
    scalars = chain.scalars(np.zeros((chain.n_joints, 1)))
    stored = chain.sweep(scalars, 1, (), wanted).frames
    at = {count: Poses(p.rotation[..., 0], p.translation[..., 0]) for count, p in zip(wanted, stored, strict=True)}
    base = at[first].inverse()
    turned = Poses(exp_so3(np.array([np.pi, 0.0, 0.0])), np.zeros(3))
    frames = []
    for joint, count in zip(robot.variables, counts, strict=True):
        frame = base @ at[count]
        frames.append(frame @ turned if joint.sign < 0 else frame)
    return JointFrames(robot.variables, tuple(frames), base @ at[arm.flange])


def joint_at(
    origin: Frame, name: str, kind: JointType = "revolute", limits: tuple[float, float] | None = FULL_TURN
) -> Joint:
    """Return a joint in the URDF convention that turns about, or moves along, the z axis of its origin."""
    parameters = dict(zip(ORIGIN_PARAMETERS, (*origin.xyz, *origin.rpy, 0.0), strict=True))
    return Joint(name, kind, parameters, limits=limits)


def robot_of(frames: JointFrames, like: Robot) -> Robot:
    """Return a robot in the URDF convention with these joint frames; name, base, tool and gravity as in ``like``."""
    joints = [
        joint_at(Frame.of(step), joint.name, joint.type, joint.limits)
        for joint, step in zip(frames.joints, frames.steps()[:-1], strict=True)
    ]
    last = Frame.of(frames.steps()[-1] @ like.tool.pose)
    return Robot(like.name, "urdf", tuple(joints), base=like.base, tool=last, gravity=like.gravity)


_NEARLY_PARALLEL = 0.03
"""Sine of the angle between axes below which Hayati's parameter describes them better."""
_PARALLEL = 1e-8
"""Sine of the angle between axes, rad, below which they count as parallel."""


class DhRow(NamedTuple):
    """Row of a standard table: Rz(theta + q) Tz(d) Tx(a) Rx(alpha) Ry(beta); q is added to d in a prismatic joint."""

    theta: float
    d: float
    a: float
    alpha: float
    beta: float = 0.0
    """Hayati's rotation, zero in a plain table."""

    def pose(self) -> Poses:
        """Return the transform of the row with the joint variable at zero."""
        turn = rotation_about(2, self.theta)
        offset = turn[:, 0] * self.a + np.array([0.0, 0.0, self.d])
        return Poses(turn @ rotation_about(0, self.alpha) @ rotation_about(1, self.beta), offset)


@dataclass(frozen=True, slots=True)
class DhTable:
    """Table of an arm: ``base Row_1 … Row_n tool`` is the flange's pose in the robot's base frame."""

    rows: tuple[DhRow, ...]
    base: Poses
    tool: Poses
    """Flange in the last row's frame."""


def dh_table(
    frames: JointFrames, hints: Sequence[DhRow] | None = None, *, last_is_axis: bool = False, hayati: bool = False
) -> DhTable:
    """Return the standard table of an arm.

    Args:
        frames: The arm.
        hints: Table that the result resembles where the arm leaves a choice: the sign of a normal, d of parallel axes.
        last_is_axis: Keep a and alpha of the last row at zero; what differs is in ``tool``.
        hayati: Describe nearly parallel axes by beta instead of a distant common normal.
    """
    base = _first_frame(frames.frames[0])
    current = base
    rows = []
    n = len(frames.frames)
    for i in range(n):
        hint = hints[i] if hints is not None else None
        is_last = i == n - 1
        # A flange that is meant to stand on the last axis has no common normal with it that is worth a row.
        on_axis = last_is_axis or _is_nearly_parallel(frames.frames[i], frames.flange)
        last = frames.frames[i] if on_axis else frames.flange
        following = last if is_last else frames.frames[i + 1]
        # The last frame is free about and along its axis: it stands at the flange.
        place = frames.flange if is_last else following
        if hayati and not is_last and _is_nearly_parallel(current, following):
            row = _hayati_row(current, following, hint)
        else:
            row = _row(current, following, place, hint, is_last)
        rows.append(row)
        current = current @ row.pose()
    return DhTable(tuple(rows), base, current.inverse() @ frames.flange)


def modified_rows(table: DhTable) -> tuple[list[DhRow], Poses]:
    """Return Craig's rows, Rx(alpha) Tx(a) Ry(beta) Rz(theta) Tz(d), and the flange behind the last."""
    before = [DhRow(0.0, 0.0, 0.0, 0.0), *table.rows[:-1]]
    rows = [
        DhRow(row.theta, row.d, previous.a, previous.alpha, previous.beta)
        for previous, row in zip(before, table.rows, strict=True)
    ]
    last = table.rows[-1]
    return rows, DhRow(0.0, 0.0, last.a, last.alpha, last.beta).pose() @ table.tool


def _first_frame(axis: Poses) -> Poses:
    """Return the frame of the first row: the robot's base where the first axis is its z axis, else one on the axis."""
    z, point = axis.rotation[:, 2], axis.translation
    if np.hypot(z[0], z[1]) < 1e-12 and z[2] > 0 and np.hypot(point[0], point[1]) < 1e-12:
        return Poses.identity()
    foot = point - z * (z @ point)
    x = _across(np.array([1.0, 0.0, 0.0]), z)
    return Poses(np.stack((x, np.cross(z, x), z), axis=1), foot)


def _across(vector: Array, axis: Array) -> Array:
    """Return the unit vector across ``axis`` nearest to ``vector``, or nearest to y where ``vector`` lies along it."""
    for candidate in (vector, np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])):
        across = candidate - axis * (axis @ candidate)
        length = float(np.linalg.norm(across))
        if length > 1e-6:
            unit: Array = across / length
            return unit
    raise AssertionError("one of two axes lies across any third")


def _is_nearly_parallel(current: Poses, following: Poses) -> bool:
    sine = float(np.linalg.norm(np.cross(current.rotation[:, 2], following.rotation[:, 2])))
    return _PARALLEL < sine < _NEARLY_PARALLEL


def _hayati_row(current: Poses, following: Poses, hint: DhRow | None) -> DhRow:
    """Return the row whose x axis meets the next axis in the plane across the current one, at the hint's d.

    Source: S. Hayati, "Robot arm geometric link parameter estimation", 22nd IEEE Conf. Decision and Control, 1983.
    """
    z = current.rotation[:, 2]
    d = 0.0 if hint is None else hint.d
    origin = current.translation + d * z
    point, direction = following.translation, following.rotation[:, 2]
    meeting = point + direction * ((origin - point) @ z) / (direction @ z)
    across = meeting - origin
    a = float(np.linalg.norm(across))
    x = across / a if a > 1e-12 else current.rotation[:, 0]
    theta = float(np.arctan2(x @ current.rotation[:, 1], x @ current.rotation[:, 0]))
    aim = 0.0 if hint is None else hint.theta
    if np.cos(theta - aim) < 0:
        theta, a, x = theta + np.pi, -a, -x
    u = np.array([x @ direction, np.cross(z, x) @ direction, z @ direction])
    theta = aim + _wrapped(theta - aim)
    # The z axis behind the row is (sin beta, -sin alpha cos beta, cos alpha cos beta).
    return DhRow(theta, d, a, float(np.arctan2(-u[1], u[2])), float(np.arcsin(np.clip(u[0], -1.0, 1.0))))


def _row(current: Poses, following: Poses, place: Poses, hint: DhRow | None, is_last: bool) -> DhRow:
    """Return the row from a frame to the next, whose z axis is that of ``following``."""
    origin, z = current.translation, current.rotation[:, 2]
    point, direction = following.translation, following.rotation[:, 2]
    normal = np.cross(z, direction)
    sine = float(np.linalg.norm(normal))
    between = point - origin
    if sine > _PARALLEL:
        x = normal / sine
        # Feet of the common normal: origin + d z and point + t direction.
        d = float(np.cross(between, direction) @ normal) / sine**2
        along = float(np.cross(between, z) @ normal) / sine**2
        a = float((between + along * direction - d * z) @ x)
        alpha = float(np.arctan2(sine, z @ direction))
    else:
        across = between - z * (z @ between)
        a = float(np.linalg.norm(across))
        x = across / a if a > 1e-12 else _across(place.rotation[:, 0] if is_last else current.rotation[:, 0], z)
        a = a if a > 1e-12 else 0.0
        d = float((place.translation - origin) @ z) if is_last or hint is None else hint.d
        alpha = 0.0 if z @ direction > 0 else np.pi
    theta = float(np.arctan2(x @ current.rotation[:, 1], x @ current.rotation[:, 0]))
    return _nearest(DhRow(theta, d, a, alpha), hint)


def _wrapped(angle: float) -> float:
    """Return the angle within half a turn of zero."""
    return float(angle - 2 * np.pi * np.round(angle / (2 * np.pi)))


def _nearest(row: DhRow, hint: DhRow | None) -> DhRow:
    """Return the row with the direction of the normal that gives a theta near the hint's, or near zero."""
    aim = 0.0 if hint is None else hint.theta
    other = DhRow(row.theta + np.pi, row.d, -row.a, -row.alpha)
    chosen = row if abs(_wrapped(row.theta - aim)) <= abs(_wrapped(other.theta - aim)) else other
    alpha = chosen.alpha if hint is None else hint.alpha + _wrapped(chosen.alpha - hint.alpha)
    return DhRow(aim + _wrapped(chosen.theta - aim), chosen.d, chosen.a, alpha)
