"""Write a robot as URDF, with a list of the information that a URDF cannot carry."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from robacc.geometry import Array, Poses, exp_so3, rotate, rpy_from_rotation
from robacc.robots.description import STANDARD_GRAVITY, ZERO, Frame, Joint, Mimic, Robot

MEASURING_FRAME = "measuring_frame"
TOOL_LINK = "tool0"
TURN_LIMITS = (-2 * math.pi, 2 * math.pi)
"""Limits of a revolute joint whose file has none: the range that most arms without stated limits have.

A URDF's revolute joint needs limits. ``continuous`` would need none, but it says that the joint turns without end, and
some readers then represent its angle by cosine and sine: the configuration gets two numbers for the joint.
"""


def robot_to_urdf(robot: Robot) -> tuple[str, tuple[str, ...]]:
    """Return the robot as URDF, and a line for each piece of information that a URDF cannot carry.

    A base frame other than zero becomes a fixed joint from a link :data:`MEASURING_FRAME`, a tool frame one to a link
    :data:`TOOL_LINK`, each target one to a link of its name. The fixed part of a DH row behind its
    variable goes into the next joint's origin, and the link's centre of mass with it. A joint with sign -1 has its axis
    reversed. Each term of a coupling becomes a mimic joint about the same axis, in front of the joint.
    """
    joints = [*robot.joints, *(branch.joint for branch in robot.branches)]
    names = [name for joint in joints for name in (joint.name, joint.link) if name]
    writer = _Writer(Element("robot", name=robot.name), {*names, robot.base_link or ""})
    writer.place_base(robot)
    for joint in robot.joints:
        writer.place_joint(joint, robot.convention)
    writer.place_branches(robot)
    writer.place_tools(robot)
    indent(writer.root)
    text = tostring(writer.root, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n', _losses(robot)


@dataclass(slots=True)
class _Writer:
    """URDF written so far, and the transform to put in front of the next joint."""

    root: Element
    used_names: set[str]
    """Names of the robot and of the URDF so far, which new names must not repeat."""
    link: str = ""
    """Name of the last link written."""
    tail: Poses = field(default_factory=Poses.identity)
    """Transform from that link's frame to the description's frame of the same link."""
    carriers: dict[str | None, tuple[str, Poses]] = field(default_factory=dict)
    """Link and transform of each joint of the description, and of the base."""

    def unused_name(self, name: str) -> str:
        """Return the name, with a number behind it where the name is in use."""
        unique, number = name, 2
        while unique in self.used_names:
            unique, number = f"{name}_{number}", number + 1
        self.used_names.add(unique)
        return unique

    def connect(self, name: str, kind: str, origin: Poses, child: str) -> tuple[Element, Element]:
        """Add a joint and the link it moves, which becomes the last link."""
        link = SubElement(self.root, "link", name=child)
        joint = SubElement(self.root, "joint", name=name, type=kind)
        SubElement(joint, "origin", xyz=_numbers(origin.translation), rpy=_numbers(rpy_from_rotation(origin.rotation)))
        SubElement(joint, "parent", link=self.link)
        SubElement(joint, "child", link=child)
        self.link = child
        return joint, link

    def place_base(self, robot: Robot) -> None:
        """Add the root link, and the base where it is not at the root."""
        name = robot.base_link or self.unused_name("base_link")
        self.carriers[None] = (name, Poses.identity())
        if robot.base == Frame():
            self.link = SubElement(self.root, "link", name=name).get("name", "")
            return
        self.link = self.unused_name(MEASURING_FRAME)
        SubElement(self.root, "link", name=self.link)
        self.connect(self.unused_name(f"{MEASURING_FRAME}_to_base"), "fixed", robot.base.pose, name)

    def place_joint(self, joint: Joint, convention: str) -> None:
        """Add a joint of the robot, and its link with its mass."""
        origin, tail = _parts(joint, convention)
        origin = self.tail @ origin
        *first, last = self.uncoupled(joint)
        for piece in first:
            self.place_axis(piece, origin, Poses.identity())
            origin = Poses.identity()
        self.place_axis(last, origin, tail)
        self.tail = tail
        self.carriers[joint.name] = (self.link, tail)

    def uncoupled(self, joint: Joint) -> list[Joint]:
        """Return joints about one axis that together move as a coupled joint does; the last has its name and link."""
        if not joint.coupling:
            return [joint]
        plain = replace(joint, coupling={}, is_passive=False)
        bare = replace(plain, limits=None, mass=None, com=None, link=None)
        pieces = [
            replace(bare, name=self.unused_name(f"{joint.name}_by_{master}"), mimic=Mimic(master, ratio))
            for master, ratio in joint.coupling.items()
        ]
        return [*pieces[:-1], replace(plain, mimic=pieces[-1].mimic)] if joint.is_passive else [*pieces, plain]

    def place_axis(self, joint: Joint, origin: Poses, tail: Poses) -> None:
        """Add one joint of the URDF, and its link with its mass."""
        kind = "continuous" if joint.is_continuous else joint.type
        limits = TURN_LIMITS if kind == "revolute" and joint.limits is None else joint.limits
        element, link = self.connect(joint.name, kind, origin, joint.link or self.unused_name(f"{joint.name}_link"))
        if joint.type != "fixed":
            SubElement(element, "axis", xyz=_numbers(np.multiply(joint.axis, joint.sign)))
        if limits is not None:
            lower, upper = (repr(float(limit)) for limit in limits)
            # The format requires effort and velocity; simulators read zero as unknown.
            SubElement(element, "limit", lower=lower, upper=upper, effort="0", velocity="0")
        if joint.mimic is not None:
            multiplier, offset = repr(float(joint.mimic.multiplier)), repr(float(joint.mimic.offset))
            SubElement(element, "mimic", joint=joint.mimic.master, multiplier=multiplier, offset=offset)
        if joint.mass is not None:
            com = rotate(tail.rotation, np.array(joint.com or ZERO)) + tail.translation
            inertial = SubElement(link, "inertial")
            SubElement(inertial, "origin", xyz=_numbers(com), rpy="0.0 0.0 0.0")
            SubElement(inertial, "mass", value=repr(float(joint.mass)))
            # The format requires moments of inertia; a robot file has none.
            SubElement(inertial, "inertia", dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0.0"))

    def place_branches(self, robot: Robot) -> None:
        """Add the joints outside the chain, each on the link that carries it; the chain's last link stays the last."""
        last = self.link
        for branch in robot.branches:
            self.link, tail = self.carriers[branch.parent]
            origin, _ = _parts(branch.joint, "urdf")
            self.place_axis(branch.joint, tail @ origin, Poses.identity())
            self.carriers[branch.joint.name] = (self.link, Poses.identity())
        self.link = last

    def place_tools(self, robot: Robot) -> None:
        """Add the tool or the targets, side by side on the last link."""
        is_flange = np.array_equal(self.tail.matrices(), np.eye(4))
        frames = {} if robot.tool == Frame() and is_flange else {TOOL_LINK: robot.tool}
        flange = self.link
        for name, frame in (robot.targets or frames).items():
            self.link = flange
            self.connect(self.unused_name(f"to_{name}"), "fixed", self.tail @ frame.pose, self.unused_name(name))


def _parts(joint: Joint, convention: str) -> tuple[Poses, Poses]:
    """Return the transforms before the joint's variable, including its zero, and after it."""
    values = joint.parameters
    if convention == "urdf":
        coordinates = np.array([values[label] for label in ("x", "y", "z", "roll", "pitch", "yaw")])
        origin = Poses.from_xyz_rpy(coordinates[:3], coordinates[3:])
        offset = np.multiply(joint.axis, values.get("offset", 0.0))
        zero = {"revolute": Poses(exp_so3(offset), np.zeros(3)), "prismatic": Poses(np.eye(3), offset)}.get(joint.type)
        return origin if zero is None else origin @ zero, Poses.identity()
    variable = Poses.from_xyz_rpy(np.array([0.0, 0.0, values["d"]]), np.array([0.0, 0.0, values["theta"]]))
    twist = Poses.from_xyz_rpy(np.array([values["a"], 0.0, 0.0]), np.array([values["alpha"], 0.0, 0.0]))
    fixed = twist @ Poses.from_xyz_rpy(np.zeros(3), np.array([0.0, values.get("beta", 0.0), 0.0]))
    return (variable, fixed) if convention == "standard" else (fixed @ variable, Poses.identity())


def _numbers(values: Array) -> str:
    # Adding zero turns -0.0 into 0.0.
    return " ".join(repr(float(value) + 0.0) for value in values)


def _losses(robot: Robot) -> tuple[str, ...]:
    """Return a line for each piece of information that a URDF cannot carry, with the joints that have it."""
    joints = robot.joints
    losses: list[tuple[str, bool | list[str]]] = [
        *((f"effect {effect.get('effect', effect.get('name', '?'))}", True) for effect in robot.effects),
        ("tolerances", [joint.name for joint in joints if joint.tolerance]),
        ("tolerances of the base", bool(robot.base_tolerance)),
        ("tolerances of the tool", bool(robot.tool_tolerance)),
        ("gear ratio", [joint.name for joint in joints if joint.gear_ratio is not None]),
        ("targets: each becomes a link", bool(robot.targets)),
        ("gravity other than 9.81 m/s^2 downwards", robot.gravity != STANDARD_GRAVITY),
        ("the payload's centre of mass", robot.payload_com is not None),
        (
            "missing limits (one turn either way is written)",
            [it.name for it in joints if it.type == "revolute" and it.limits is None and not it.is_continuous],
        ),
        (
            "an unlimited range (a URDF requires limits)",
            [joint.name for joint in joints if joint.type == "prismatic" and joint.limits is None],
        ),
    ]
    return tuple(f"{loss} of {', '.join(of)}" if isinstance(of, list) else loss for loss, of in losses if of)
