"""A robot written as URDF, with a list of what a URDF cannot say."""

from __future__ import annotations

from dataclasses import dataclass, field
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from robacc.geometry import Array, Poses, exp_so3, rotate, rotation_about, rotation_from_rpy, rpy_from_rotation
from robacc.robots.description import STANDARD_GRAVITY, ZERO, Frame, Joint, Robot

MEASURING_FRAME = "measuring_frame"
TOOL_LINK = "tool0"


def robot_to_urdf(robot: Robot) -> tuple[str, tuple[str, ...]]:
    """The robot as URDF, and a line for each thing of it that a URDF cannot carry.

    A base frame other than zero becomes a fixed joint from a link :data:`MEASURING_FRAME`, a tool one to a link
    :data:`TOOL_LINK`, each target one to a link of its name. The fixed part of a DH row behind its variable goes into
    the next joint's origin, and the link's centre of mass with it. A joint whose sign is -1 has its axis turned round.
    """
    names = [name for joint in robot.joints for name in (joint.name, joint.link) if name]
    writer = _Writer(Element("robot", name=robot.name), {*names, robot.base_link or ""})
    writer.place_base(robot)
    for joint in robot.joints:
        writer.place_joint(joint, robot.convention)
    writer.place_tools(robot)
    indent(writer.root)
    text = tostring(writer.root, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n', _losses(robot)


@dataclass(slots=True)
class _Writer:
    """The URDF written so far, and what is to come in front of the next joint."""

    root: Element
    taken: set[str]
    """Names that the robot itself uses; those that are made up here keep clear of them."""
    link: str = ""
    """The last link written."""
    tail: Poses = field(default_factory=Poses.identity)
    """From that link's frame to the frame that the description has there."""

    def fresh(self, name: str) -> str:
        """The name, with a number behind it where it is taken."""
        unique, number = name, 2
        while unique in self.taken:
            unique, number = f"{name}_{number}", number + 1
        self.taken.add(unique)
        return unique

    def connect(self, name: str, kind: str, origin: Poses, child: str) -> tuple[Element, Element]:
        """A joint and the link it moves, which is the last one from now on."""
        link = SubElement(self.root, "link", name=child)
        joint = SubElement(self.root, "joint", name=name, type=kind)
        _add_origin(joint, origin)
        SubElement(joint, "parent", link=self.link)
        SubElement(joint, "child", link=child)
        self.link = child
        return joint, link

    def place_base(self, robot: Robot) -> None:
        """The root link, and the base where it does not stand at the root."""
        name = robot.base_link or self.fresh("base_link")
        if robot.base == Frame():
            self.link = SubElement(self.root, "link", name=name).get("name", "")
            return
        self.link = self.fresh(MEASURING_FRAME)
        SubElement(self.root, "link", name=self.link)
        self.connect(self.fresh(f"{MEASURING_FRAME}_to_base"), "fixed", _frame(robot.base), name)

    def place_joint(self, joint: Joint, convention: str) -> None:
        """A joint of the robot, and its link with its mass."""
        origin, tail = _parts(joint, convention)
        kind = "continuous" if joint.type == "revolute" and joint.limits is None else joint.type
        element, link = self.connect(
            joint.name, kind, self.tail @ origin, joint.link or self.fresh(f"{joint.name}_link")
        )
        if joint.type != "fixed":
            SubElement(element, "axis", xyz=_numbers(np.multiply(joint.axis, joint.sign)))
        if joint.limits is not None:
            lower, upper = (repr(float(limit)) for limit in joint.limits)
            # The format wants effort and velocity; zero is what simulators take for unknown.
            SubElement(element, "limit", lower=lower, upper=upper, effort="0", velocity="0")
        if joint.mimic is not None:
            multiplier, offset = repr(float(joint.mimic.multiplier)), repr(float(joint.mimic.offset))
            SubElement(element, "mimic", joint=joint.mimic.master, multiplier=multiplier, offset=offset)
        if joint.mass is not None:
            _add_inertial(link, joint, tail)
        self.tail = tail

    def place_tools(self, robot: Robot) -> None:
        """The tool or the targets, side by side on the last link."""
        frames = dict(robot.targets) or {TOOL_LINK: robot.tool}
        if not robot.targets and robot.tool == Frame() and _is_identity(self.tail):
            return
        flange = self.link
        for name, frame in frames.items():
            self.link = flange
            self.connect(self.fresh(f"to_{name}"), "fixed", self.tail @ _frame(frame), self.fresh(name))


def _parts(joint: Joint, convention: str) -> tuple[Poses, Poses]:
    """What stands in front of the joint's variable, its zero included, and what stands behind it."""
    values = joint.parameters

    def along(axis: int, length: float) -> Poses:
        return Poses(np.eye(3), np.eye(3)[axis] * length)

    def about(axis: int, angle: float) -> Poses:
        return Poses(rotation_about(axis, angle), np.zeros(3))

    if convention == "urdf":
        xyz = np.array([values["x"], values["y"], values["z"]])
        origin = Poses.from_xyz_rpy(xyz, np.array([values["roll"], values["pitch"], values["yaw"]]))
        offset = np.multiply(joint.axis, values.get("offset", 0.0))
        if joint.type == "revolute":
            origin = origin @ Poses(exp_so3(offset), np.zeros(3))
        elif joint.type == "prismatic":
            origin = origin @ Poses(np.eye(3), offset)
        return origin, Poses.identity()
    variable = about(2, values["theta"]) @ along(2, values["d"])
    lean = about(1, values.get("beta", 0.0))
    twist = about(0, values["alpha"])
    if convention == "standard":
        return variable, along(0, values["a"]) @ twist @ lean
    return twist @ along(0, values["a"]) @ lean @ variable, Poses.identity()


def _frame(frame: Frame) -> Poses:
    return Poses.from_xyz_rpy(np.array(frame.xyz), np.array(frame.rpy))


def _is_identity(poses: Poses) -> bool:
    return bool(np.array_equal(poses.rotation, np.eye(3)) and not np.any(poses.translation))


def _add_origin(element: Element, poses: Poses) -> None:
    SubElement(element, "origin", xyz=_numbers(poses.translation), rpy=_numbers(_exact_rpy(poses.rotation)))


def _exact_rpy(rotation: Array) -> Array:
    """Roll, pitch, yaw that give the rotation to rounding at any pitch.

    Near 90 degrees roll and yaw are each badly determined and only their sum is not, so roll is taken from what is
    left once yaw and pitch, however they were rounded, are undone.
    """
    _, pitch, yaw = rpy_from_rotation(rotation)
    rest = rotation_from_rpy(np.array([0.0, pitch, yaw])).T @ rotation
    return np.array([np.arctan2(rest[2, 1], rest[1, 1]), pitch, yaw])


def _add_inertial(link: Element, joint: Joint, tail: Poses) -> None:
    com = rotate(tail.rotation, np.array(joint.com or ZERO)) + tail.translation
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=_numbers(com), rpy="0.0 0.0 0.0")
    SubElement(inertial, "mass", value=repr(float(joint.mass or 0.0)))
    # The format wants moments of inertia; a robot file has none.
    SubElement(inertial, "inertia", dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0.0"))


def _numbers(values: Array) -> str:
    # Adding zero turns -0.0 into 0.0.
    return " ".join(repr(float(value) + 0.0) for value in values)


def _losses(robot: Robot) -> tuple[str, ...]:
    def named(condition: str, joints: list[str]) -> list[str]:
        return [f"{condition} of {', '.join(joints)}"] if joints else []

    lines = [f"effect {effect.get('effect', effect.get('name', '?'))}" for effect in robot.effects]
    lines += named("tolerances", [joint.name for joint in robot.joints if joint.tolerance])
    lines += ["tolerances of the base"] if robot.base_tolerance else []
    lines += ["tolerances of the tool"] if robot.tool_tolerance else []
    lines += named("gear ratio", [joint.name for joint in robot.joints if joint.gear_ratio is not None])
    lines += ["that targets are targets: each is a link"] if robot.targets else []
    lines += ["gravity other than 9.81 m/s^2 downwards"] if robot.gravity != STANDARD_GRAVITY else []
    lines += ["where a payload sits"] if robot.payload_com is not None else []
    unlimited = [joint.name for joint in robot.joints if joint.type == "prismatic" and joint.limits is None]
    return tuple(lines + named("that there are no limits (a URDF wants some)", unlimited))
