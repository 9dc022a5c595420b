"""Arm for computations: its description as a chain of elementary motions, and lookups by joint name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from robacc.chain import BASE, TOOL, Body, Chain, JointDrive, Motion
from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.robots.description import LENGTH_PARAMETERS, ZERO, BranchJoint, Frame, Joint, Robot, Vector

# Build the chain of elementary motions of a robot's description.

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

TURNS = ("turn_x", "turn_y", "turn_z")
"""Zero-valued rotations after those of the base, of the tool and of a URDF's origins: corrections about the frame's own
axes, which have full rank at any pitch."""
TURN_OF_ANGLE = dict(zip(("roll", "pitch", "yaw"), TURNS, strict=True))
"""Motion that a correction or an error called roll, pitch or yaw moves."""
FLEXURES = ("flex_x", "flex_y")
"""Zero-valued rotations across each joint's axis, in front of it: the bending of a bearing."""
_ROWS = {
    "standard": (*FLEXURES, "theta", "d", "a", "alpha", "beta"),
    "modified": ("alpha", "a", "beta", *FLEXURES, "theta", "d"),
}
"""Motions of a table's row, by its convention."""


def build_chain(robot: Robot) -> Chain:
    """Return the arm as elementary motions: base, joints in order, tool.

    Every joint gets two flexures in front of its axis. Joint variables drive the axis with the joint's sign; a mimic
    joint is driven by its master's variable, a coupled joint by those of its coupling too.
    """
    number = {joint.name: i for i, joint in enumerate(robot.variables)}
    motions, drives, bodies = _links(_frame_motions(robot.base, BASE), robot.joints, robot.convention, number)
    motions += _frame_motions(robot.tool, TOOL)
    index = {(motion.owner, motion.label): k for k, motion in enumerate(motions)}
    variables = ((owner, joint) for owner, joint in enumerate(robot.joints) if joint.is_variable)
    joint_axis = tuple(index[owner, joint.offset_parameter] for owner, joint in variables)
    return Chain(tuple(motions), tuple(drives), len(number), tuple(bodies), joint_axis)


def _links(
    motions: list[Motion], joints: Sequence[Joint], convention: str, number: Mapping[str, int]
) -> tuple[list[Motion], list[JointDrive], list[Body]]:
    """Return ``motions`` and those of joints behind them, what drives these, and the links' masses.

    Args:
        motions: Motions in front of the first joint.
        joints: Joints in order; their places are the owners of their motions.
        convention: Convention of the joints.
        number: Number of each joint variable, by the name of its joint.
    """
    drives: list[JointDrive] = []
    bodies: list[Body] = []
    for owner, joint in enumerate(joints):
        first = len(motions)
        motions += _joint_motions(joint, owner, convention)
        # Movement per unit of each joint variable that drives the joint, before its sign.
        ratios = ({joint.name: 1.0} if joint.is_variable else {}) | dict(joint.coupling)
        if joint.mimic is not None:
            ratios = {joint.mimic.master: joint.mimic.multiplier}
        for axis in range(first, len(motions)) if joint.type != "fixed" else ():
            if motions[axis].label == joint.offset_parameter:
                drives += [JointDrive(axis, number[name], joint.sign * c) for name, c in ratios.items()]
        if joint.mass:
            bodies.append(Body(len(motions), owner, joint.com or ZERO, joint.mass))
    return motions, drives, bodies


def _motions(labels: Iterable[str], values: Mapping[str, float], owner: int) -> list[Motion]:
    """Return the motions of some labels, zero without a value."""
    return [
        Motion(
            "translation" if label in LENGTH_PARAMETERS else "rotation",
            _AXIS_OF[label],
            float(values.get(label, 0.0)),
            owner,
            label,
        )
        for label in labels
    ]


def _frame_motions(frame: Frame, owner: int) -> list[Motion]:
    values = dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), (*frame.xyz, *frame.rpy), strict=True))
    return _motions((*_FRAME_ORDER, *TURNS), values, owner)


def _joint_motions(joint: Joint, owner: int, convention: str) -> list[Motion]:
    values = joint.parameters
    if convention != "urdf":
        return _motions(_ROWS[convention], values, owner)
    origin = _motions((*_FRAME_ORDER, *TURNS), values, owner)
    if joint.type == "fixed":
        return origin
    offset = values.get("offset", 0.0) + (joint.sign * joint.mimic.offset if joint.mimic else 0.0)
    x, y, z = joint.axis
    across = float(np.hypot(x, y))
    yaw, pitch = float(np.arctan2(y, x)) if across > 0 else 0.0, float(np.arctan2(across, z))
    # Rz(yaw) Ry(pitch) turns z onto the axis; a motion that never varies has no label.
    forth = [Motion("rotation", 2, yaw, owner, ""), Motion("rotation", 1, pitch, owner, "")]
    back = [Motion("rotation", 1, -pitch, owner, ""), Motion("rotation", 2, -yaw, owner, "")]
    variable = Motion("rotation" if joint.type == "revolute" else "translation", 2, offset, owner, "offset")
    return [*origin, *forth, *_motions(FLEXURES, {}, owner), variable, *back]


@dataclass(frozen=True)
class Arm:
    """Robot and the chain built from it. Joint variables are numbered from 0 in chain order."""

    robot: Robot
    chain: Chain

    @classmethod
    def of(cls, robot: Robot) -> Arm:
        """Build the chain of a robot."""
        return cls(robot, build_chain(robot))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the joint variables."""
        return self.robot.variable_names

    @cached_property
    def owners(self) -> tuple[int, ...]:
        """Index of each joint variable's joint in the robot's list, which also has fixed and mimic joints."""
        return tuple(i for i, joint in enumerate(self.robot.joints) if joint.is_variable)

    def number(self, name: str) -> int:
        """Return the number of the joint variable called ``name``.

        Raises:
            UsageError: No variable has this name; the message lists the names.
        """
        try:
            return self.names.index(name)
        except ValueError:
            raise UsageError(f"no joint {name!r}; this arm has {', '.join(self.names)}") from None

    def joint(self, name: str) -> Joint:
        """Return the joint of a variable."""
        return self.robot.joints[self.owners[self.number(name)]]

    def is_revolute(self, name: str) -> bool:
        """Return whether the joint is revolute."""
        return self.joint(name).type == "revolute"

    def unit(self, name: str) -> str:
        """Return the unit of the joint's variable: ``rad`` or ``m``."""
        return "rad" if self.is_revolute(name) else "m"

    def axis_motion(self, name: str) -> int:
        """Return the index of the motion that the joint's variable drives."""
        return self.chain.joint_axis[self.number(name)]

    def motion(self, name: str, label: str) -> int:
        """Return the index of the motion ``label`` of the joint's row."""
        return self.chain.index(self.owners[self.number(name)], label)

    @cached_property
    def lengths(self) -> tuple[int, ...]:
        """Motions that are lengths of the arm: every d and a, or every coordinate of a URDF's origins."""
        return tuple(k for k, m in enumerate(self.chain.motions) if m.owner >= 0 and m.label in LENGTH_PARAMETERS)

    @cached_property
    def flange(self) -> int:
        """Number of motions before the tool, which end at the last link's frame."""
        return next(k for k, motion in enumerate(self.chain.motions) if motion.owner == TOOL)

    @cached_property
    def branches(self) -> tuple[tuple[int, Chain], ...]:
        """Chains of joints beside the arm's that move mass, each with the number of motions up to its carrier.

        Every link beside the arm's is a body of one of them. Their joint variables are those of the branches, and then
        the arm's.
        """
        variables = (*(branch.joint.name for branch in self.robot.branch_variables), *self.names)
        number = {name: i for i, name in enumerate(variables)}
        paths: dict[str | None, tuple[BranchJoint, ...]] = {}
        for branch in self.robot.branches:
            paths[branch.joint.name] = (*paths.get(branch.parent, ()), branch)
        places = {joint.name: owner for owner, joint in enumerate(self.robot.joints)}
        counted: set[str] = set()
        chains = []
        for path in sorted(paths.values(), key=len, reverse=True):
            if (joints := [branch.joint for branch in path])[-1].name in counted:
                continue
            motions, drives, bodies = _links([], joints, "urdf", number)
            kept = tuple(body for body in bodies if joints[body.owner].name not in counted)
            counted.update(joint.name for joint in joints)
            carrier = places.get(path[0].parent or "", BASE)
            before = 1 + max(k for k, motion in enumerate(self.chain.motions) if motion.owner == carrier)
            chains.append((before, Chain(tuple(motions), tuple(drives), len(variables), kept)))
        return tuple(chains)

    @cached_property
    def payload_com(self) -> Vector:
        """Payload's centre of mass in the last link's frame, m: from the file, else at the tool."""
        if self.robot.payload_com is not None:
            return self.robot.payload_com
        if self.robot.targets:
            x, y, z = np.mean([frame.xyz for frame in self.robot.targets.values()], axis=0)
            return float(x), float(y), float(z)
        return self.robot.tool.xyz


def skeleton(arm: Arm, q: Array) -> Array:
    """Return corners ``(3, P)`` of the line from base to tool at joint variables ``q`` ``(J,)``, measuring frame, m.

    The line begins at the base, wherever the instrument stands.

    Every translation of the chain is a straight piece, so the corners include the shoulder and elbow of a DH table.
    """
    counts = list(range(sum(motion.owner == BASE for motion in arm.chain.motions), len(arm.chain.motions) + 1))
    frames = arm.chain.sweep(arm.chain.scalars(q[:, None]), 1, (), counts).frames
    points = np.concatenate([frame.translation for frame in frames], axis=1)
    is_new = np.any(np.abs(np.diff(points, axis=1)) > 1e-9, axis=0)
    return points[:, np.concatenate(([True], is_new))]


def typical_pose(q: Array) -> int:
    """Return the index of the pose nearest to the median of all poses ``(J, N)``, each joint scaled by its range."""
    median = np.median(q, axis=1, keepdims=True)
    ranges = np.ptp(q, axis=1, keepdims=True)
    ranges[ranges == 0] = 1.0
    return int(np.argmin(np.sum(np.square((q - median) / ranges), axis=0)))
