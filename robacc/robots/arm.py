"""Arm for computations: its description, its chain, and lookups by joint name."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from robacc.chain import BASE, TOOL, Chain
from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.robots.assembly import branch_chain, build_chain
from robacc.robots.description import LENGTH_PARAMETERS, BranchJoint, Joint, Robot, Vector


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
        position = {joint.name: i for i, joint in enumerate(self.robot.joints)}
        return tuple(position[name] for name in self.names)

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
        counted: set[str] = set()
        paths = []
        for path in sorted(map(self._branch_path, self.robot.branches), key=len, reverse=True):
            if path[-1].joint.name not in counted:
                paths.append((path, {branch.joint.name for branch in path} - counted))
                counted |= paths[-1][1]
        chains = []
        for path, new in paths:
            chain = branch_chain(path, variables)
            bodies = tuple(body for body in chain.bodies if path[body.owner].joint.name in new)
            chains.append((self._motions_before(path[0].parent), replace(chain, bodies=bodies)))
        return tuple(chains)

    @cached_property
    def branches_follow(self) -> bool:
        """Return whether a joint outside the chain follows a joint of the chain."""
        first = len(self.robot.branch_variables)
        return any(drive.joint >= first for _, chain in self.branches for drive in chain.drives)

    def _branch_path(self, last: BranchJoint) -> list[BranchJoint]:
        """Return the joints outside the chain up to ``last``."""
        beside = {branch.joint.name: branch for branch in self.robot.branches}
        path = [last]
        while path[0].parent in beside:
            path.insert(0, beside[path[0].parent])
        return path

    def _motions_before(self, carrier: str | None) -> int:
        """Return the number of motions up to the frame of a joint's link, or of the base."""
        names = [joint.name for joint in self.robot.joints]
        owner = BASE if carrier is None else names.index(carrier)
        return 1 + max(k for k, motion in enumerate(self.chain.motions) if motion.owner == owner)

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

    Every translation of the chain is a straight piece, so the corners include the shoulder and elbow of a DH table.
    """
    counts = list(range(len(arm.chain.motions) + 1))
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
