"""Robots written as URDF, with a list of the information that a URDF cannot carry."""

import itertools
import math
from dataclasses import replace
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from robacc.geometry import Array, Poses, exp_so3, rotate, rpy_from_rotation
from robacc.robots.description import STANDARD_GRAVITY, ZERO, Frame, Joint, Mimic, Robot
from robacc.robots.urdf import origin_of

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
    writer = _Writer(robot)
    for joint in robot.joints:
        writer.place_joint(joint, robot.convention)
    flange, tail = writer.link, writer.tail
    for branch in robot.branches:
        writer.link, writer.tail = writer.carriers[branch.parent]
        writer.place_joint(branch.joint, "urdf")
    frames = {} if robot.tool == Frame() and np.array_equal(tail.matrices(), np.eye(4)) else {TOOL_LINK: robot.tool}
    for name, frame in (robot.targets or frames).items():
        writer.link = flange
        writer.connect(writer.unused_name(f"to_{name}"), "fixed", tail @ frame.pose, writer.unused_name(name))
    indent(writer.root)
    text = tostring(writer.root, encoding="unicode")
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
    lost = (f"{loss} of {', '.join(of)}" if isinstance(of, list) else loss for loss, of in losses if of)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n', tuple(lost)


class _Writer:
    """URDF written so far."""

    def __init__(self, robot: Robot) -> None:
        """Write the root link, and the base where it is not at the root."""
        joints = [*robot.joints, *(branch.joint for branch in robot.branches)]
        self.root = Element("robot", name=robot.name)
        self.used_names = {robot.base_link, *(joint.name for joint in joints), *(joint.link for joint in joints)}
        """Names of the robot and of the URDF so far, which new names must not repeat."""
        name = robot.base_link or self.unused_name("base_link")
        self.link, self.tail = name, Poses.identity()
        """Name of the last link, and the transform from its frame to the description's frame of the same link."""
        self.carriers: dict[str | None, tuple[str, Poses]] = {None: (self.link, self.tail)}
        """Link and transform of each joint of the description, and of the base."""
        if robot.base != Frame():
            self.link = self.unused_name(MEASURING_FRAME)
        SubElement(self.root, "link", name=self.link)
        if robot.base != Frame():
            self.connect(self.unused_name(f"{MEASURING_FRAME}_to_base"), "fixed", robot.base.pose, name)

    def unused_name(self, name: str) -> str:
        """Return the name, with a number behind it where the name is in use."""
        numbered = (f"{name}_{number}" for number in itertools.count(2))
        unique = next(each for each in itertools.chain([name], numbered) if each not in self.used_names)
        self.used_names.add(unique)
        return unique

    def connect(self, name: str, kind: str, origin: Poses, child: str) -> tuple[Element, Element]:
        """Add a joint and the link it moves, which becomes the last link."""
        link = SubElement(self.root, "link", name=child)
        joint = SubElement(self.root, "joint", name=name, type=kind)
        SubElement(joint, "origin", xyz=_texts(origin.translation), rpy=_texts(rpy_from_rotation(origin.rotation)))
        SubElement(joint, "parent", link=self.link)
        SubElement(joint, "child", link=child)
        self.link = child
        return joint, link

    def place_joint(self, joint: Joint, convention: str) -> None:
        """Add a joint of the robot, and its link with its mass."""
        origin, tail = _parts(joint, convention)
        origin = self.tail @ origin
        # Joints about one axis that together move as a coupled joint does; the last has its name and link.
        plain = replace(joint, coupling={}, is_passive=False)
        bare = replace(plain, limits=None, mass=None, com=None, link=None)
        pieces = [
            replace(bare, name=self.unused_name(f"{joint.name}_by_{master}"), mimic=Mimic(master, ratio))
            for master, ratio in joint.coupling.items()
        ]
        last = replace(plain, mimic=pieces.pop().mimic) if joint.is_passive else plain
        for piece in pieces:
            self.place_axis(piece, origin, Poses.identity())
            origin = Poses.identity()
        self.place_axis(last, origin, tail)
        self.tail = tail
        self.carriers[joint.name] = (self.link, tail)

    def place_axis(self, joint: Joint, origin: Poses, tail: Poses) -> None:
        """Add one joint of the URDF, and its link with its mass."""
        kind = "continuous" if joint.is_continuous else joint.type
        limits = TURN_LIMITS if kind == "revolute" and joint.limits is None else joint.limits
        element, link = self.connect(joint.name, kind, origin, joint.link or self.unused_name(f"{joint.name}_link"))
        if joint.type != "fixed":
            SubElement(element, "axis", xyz=_texts(np.multiply(joint.axis, joint.sign)))
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
            SubElement(inertial, "origin", xyz=_texts(com), rpy="0.0 0.0 0.0")
            SubElement(inertial, "mass", value=repr(float(joint.mass)))
            # The format requires moments of inertia; a robot file has none.
            SubElement(inertial, "inertia", dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0.0"))


def _parts(joint: Joint, convention: str) -> tuple[Poses, Poses]:
    """Return the transforms before the joint's variable, including its zero, and after it."""
    values = joint.parameters
    if convention == "urdf":
        origin = origin_of(joint)
        offset = np.multiply(joint.axis, values.get("offset", 0.0))
        zero = {"revolute": Poses(exp_so3(offset), np.zeros(3)), "prismatic": Poses(np.eye(3), offset)}.get(joint.type)
        return origin if zero is None else origin @ zero, Poses.identity()
    variable = Poses.from_xyz_rpy(np.array([0.0, 0.0, values["d"]]), np.array([0.0, 0.0, values["theta"]]))
    twist = Poses.from_xyz_rpy(np.array([values["a"], 0.0, 0.0]), np.array([values["alpha"], 0.0, 0.0]))
    fixed = twist @ Poses.from_xyz_rpy(np.zeros(3), np.array([0.0, values.get("beta", 0.0), 0.0]))
    return (variable, fixed) if convention == "standard" else (fixed @ variable, Poses.identity())


def _texts(values: Array) -> str:
    # Adding zero turns -0.0 into 0.0.
    return " ".join(repr(float(value) + 0.0) for value in values)
