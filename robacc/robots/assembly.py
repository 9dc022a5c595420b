"""Build the chain of elementary motions of a robot's description."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from robacc.chain import BASE, TOOL, Body, Chain, JointDrive, Motion
from robacc.robots.description import BranchJoint, Frame, Joint, Robot

_FRAME_ORDER = ("x", "y", "z", "yaw", "pitch", "roll")
_AXIS_OF = {
    "x": 0,
    "y": 1,
    "z": 2,
    "roll": 0,
    "pitch": 1,
    "yaw": 2,
    "theta": 2,
    "d": 2,
    "a": 0,
    "alpha": 0,
    "beta": 1,
    "offset": 2,
    "flex_x": 0,
    "flex_y": 1,
    "turn_x": 0,
    "turn_y": 1,
    "turn_z": 2,
}
_LENGTHS = frozenset({"x", "y", "z", "d", "a"})

TURNS = ("turn_x", "turn_y", "turn_z")
"""Zero-valued rotations after those of the base, of the tool and of a URDF's origins: corrections about the frame's own
axes, which have full rank at any pitch."""
TURN_OF_ANGLE = dict(zip(("roll", "pitch", "yaw"), TURNS, strict=True))
"""Motion that a correction or an error called roll, pitch or yaw moves."""
FLEXURES = ("flex_x", "flex_y")
"""Zero-valued rotations across each joint's axis, in front of it: the bending of a bearing."""


def build_chain(robot: Robot) -> Chain:
    """Return the arm as elementary motions: base, joints in order, tool.

    Every joint gets two flexures in front of its axis. Joint variables drive the axis with the joint's sign; a mimic
    joint is driven by its master's variable, a coupled joint by those of its coupling too.
    """
    motions = _frame_motions(robot.base, BASE)
    drives: list[JointDrive] = []
    bodies: list[Body] = []
    joint_axis: list[int] = [0] * len(robot.variables)
    number = {joint.name: i for i, joint in enumerate(robot.variables)}
    for owner, joint in enumerate(robot.joints):
        first = len(motions)
        motions.extend(_joint_motions(joint, owner, robot.convention))
        if joint.type != "fixed":
            axis = next(k for k in range(first, len(motions)) if motions[k].label == variable_label(joint))
            if joint.is_variable:
                joint_axis[number[joint.name]] = axis
            drives += [JointDrive(axis, number[name], joint.sign * c) for name, c in _ratios(joint).items()]
        if joint.mass:
            bodies.append(Body(len(motions), owner, joint.com or (0.0, 0.0, 0.0), joint.mass))
    motions.extend(_frame_motions(robot.tool, TOOL))
    return Chain(tuple(motions), tuple(drives), len(robot.variables), tuple(bodies), tuple(joint_axis))


def branch_chain(path: Sequence[BranchJoint], variables: Sequence[str]) -> Chain:
    """Return the chain of joints beside the arm's, from the link that carries the first of them.

    Its joint variables are numbered as the names ``variables``, of the branches first and then of the arm, which joints
    of a branch may follow. Each link with a mass is a body.
    """
    motions: list[Motion] = []
    drives: list[JointDrive] = []
    bodies: list[Body] = []
    for owner, branch in enumerate(path):
        joint, first = branch.joint, len(motions)
        motions.extend(_joint_motions(joint, owner, "urdf"))
        if joint.type != "fixed":
            axis = next(k for k in range(first, len(motions)) if motions[k].label == variable_label(joint))
            drives += [JointDrive(axis, variables.index(name), joint.sign * c) for name, c in _ratios(joint).items()]
        if joint.mass:
            bodies.append(Body(len(motions), owner, joint.com or (0.0, 0.0, 0.0), joint.mass))
    return Chain(tuple(motions), tuple(drives), len(variables), tuple(bodies))


def _ratios(joint: Joint) -> dict[str, float]:
    """Return the movement of a joint per unit of each joint variable that drives it, before its sign."""
    if joint.mimic is not None:
        return {joint.mimic.master: joint.mimic.multiplier}
    return ({joint.name: 1.0} if joint.is_variable else {}) | dict(joint.coupling)


def variable_label(joint: Joint) -> str:
    """Return the label of the motion that a joint's variable drives."""
    if "offset" in joint.parameters:
        return "offset"
    return "theta" if joint.type == "revolute" else "d"


def _motion(label: str, value: float, owner: int) -> Motion:
    kind = "translation" if label in _LENGTHS else "rotation"
    return Motion(kind, _AXIS_OF[label], float(value), owner, label)  # type: ignore[arg-type]


def _frame_motions(frame: Frame, owner: int) -> list[Motion]:
    values = dict(zip(("x", "y", "z"), frame.xyz, strict=True))
    values |= dict(zip(("roll", "pitch", "yaw"), frame.rpy, strict=True))
    motions = [_motion(label, values[label], owner) for label in _FRAME_ORDER]
    return motions + [_motion(label, 0.0, owner) for label in TURNS]


def _joint_motions(joint: Joint, owner: int, convention: str) -> Iterable[Motion]:
    values = joint.parameters

    def table(*labels: str) -> list[Motion]:
        return [_motion(label, values.get(label, 0.0), owner) for label in labels]

    if convention == "standard":
        return table(*FLEXURES, "theta", "d", "a", "alpha", "beta")
    if convention == "modified":
        return table("alpha", "a", "beta", *FLEXURES, "theta", "d")
    origin = table(*_FRAME_ORDER, *TURNS)
    if joint.type == "fixed":
        return origin
    kind = "rotation" if joint.type == "revolute" else "translation"
    offset = values.get("offset", 0.0) + (joint.sign * joint.mimic.offset if joint.mimic else 0.0)
    yaw, pitch = _align_z(joint.axis)
    # Rz(yaw) Ry(pitch) turns z onto the axis; a motion that never varies has no label.
    forth = [Motion("rotation", 2, yaw, owner, ""), Motion("rotation", 1, pitch, owner, "")]
    back = [Motion("rotation", 1, -pitch, owner, ""), Motion("rotation", 2, -yaw, owner, "")]
    return [*origin, *forth, *table(*FLEXURES), Motion(kind, 2, offset, owner, "offset"), *back]  # type: ignore[arg-type]


def _align_z(axis: Iterable[float]) -> tuple[float, float]:
    x, y, z = axis
    across = float(np.hypot(x, y))
    yaw = float(np.arctan2(y, x)) if across > 0 else 0.0
    return yaw, float(np.arctan2(across, z))
