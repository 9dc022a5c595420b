"""An arm ready to be computed with: its description and its chain side by side, and names looked up in both."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from robacc.chain import TOOL, Chain
from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.robots.assembly import build_chain
from robacc.robots.description import LENGTH_PARAMETERS, Joint, Robot, Vector


@dataclass(frozen=True)
class Arm:
    """A robot and the chain built from it. Joint variables are numbered from 0 in chain order."""

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
        """For each joint variable, the index of its joint in the robot's list (fixed and mimic joints count there)."""
        position = {joint.name: i for i, joint in enumerate(self.robot.joints)}
        return tuple(position[name] for name in self.names)

    def number(self, name: str) -> int:
        """Number of the joint variable called ``name``.

        Raises:
            UsageError: there is none; the message lists those there are.
        """
        try:
            return self.names.index(name)
        except ValueError:
            raise UsageError(f"no joint {name!r}; this arm has {', '.join(self.names)}") from None

    def joint(self, name: str) -> Joint:
        """The joint of a variable."""
        return self.robot.joints[self.owners[self.number(name)]]

    def is_revolute(self, name: str) -> bool:
        """Whether the joint turns."""
        return self.joint(name).type == "revolute"

    def axis_motion(self, name: str) -> int:
        """The motion that the joint's variable drives."""
        return self.chain.joint_axis[self.number(name)]

    def motion(self, name: str, label: str) -> int:
        """The motion ``label`` of the joint's row."""
        return self.chain.index(self.owners[self.number(name)], label)

    @cached_property
    def lengths(self) -> tuple[int, ...]:
        """Motions that are lengths of the arm's structure: every d and a, or every coordinate of a URDF's origins."""
        return tuple(k for k, m in enumerate(self.chain.motions) if m.owner >= 0 and m.label in LENGTH_PARAMETERS)

    @cached_property
    def flange(self) -> int:
        """Number of motions before the tool: the last link's frame stands after them."""
        return next(k for k, motion in enumerate(self.chain.motions) if motion.owner == TOOL)

    @cached_property
    def payload_com(self) -> Vector:
        """Where a payload sits in the last link's frame, m: as the file says, else at the tool."""
        if self.robot.payload_com is not None:
            return self.robot.payload_com
        if self.robot.targets:
            x, y, z = np.mean([frame.xyz for frame in self.robot.targets.values()], axis=0)
            return float(x), float(y), float(z)
        return self.robot.tool.xyz


def skeleton(arm: Arm, q: Array) -> Array:
    """``(3, P)`` corners of the line from the base to the tool at joint variables ``q`` ``(J,)``, measuring frame, m.

    Every translation of the chain is one straight piece, so the shoulder and elbow of a DH table are seen where the
    table has them.
    """
    counts = list(range(len(arm.chain.motions) + 1))
    frames = arm.chain.sweep(arm.chain.scalars(q[:, None]), 1, (), counts).frames
    points = np.concatenate([frame.translation for frame in frames], axis=1)
    moved = np.any(np.abs(np.diff(points, axis=1)) > 1e-9, axis=0)
    return points[:, np.concatenate(([True], moved))]


def typical_pose(q: Array) -> int:
    """The pose nearest to the middle of all poses ``(J, N)``, each joint counted by its own spread."""
    middle = np.median(q, axis=1, keepdims=True)
    spread = np.ptp(q, axis=1, keepdims=True)
    spread[spread == 0] = 1.0
    return int(np.argmin(np.sum(np.square((q - middle) / spread), axis=0)))
