"""Kinematics files of ROS drivers: one origin (x, y, z, roll, pitch, yaw) for each joint.

``ur_description`` reads such a file for an arm of Universal Robots (``default_kinematics.yaml``, or the file that
``ur_calibration`` extracts), ``xarm_description`` one for an arm of UFACTORY. The numbers are the origins of URDF
joints that turn about z: R = Rz(yaw) Ry(pitch) Rx(roll).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import yaml

from robacc.controllers.joint_frames import JointFrames, frame_of_poses
from robacc.controllers.ur_models import UR_JOINTS
from robacc.errors import InputError, Problem, UsageError
from robacc.io.yaml_nodes import Source, compose
from robacc.robots.description import Frame, Joint, Robot

UR_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
_TURN = 2 * math.pi


def parse_links(text: str, file: str) -> Robot:
    """Return the arm of a kinematics file.

    Raises:
        InputError: The file has no ``kinematics``, its joints are neither UR's nor joint1 to jointN, or a number is
            missing.
    """
    source = Source(file)
    root = compose(text, file)
    node = _kinematics(root)
    if node is None:
        fix = "give default_kinematics.yaml, the file of ur_calibration, or a kinematics file of xarm_description"
        raise InputError(Problem("has no key kinematics with an origin for each joint", file, fix=fix))
    origins = {}
    for name, _, value in source.entries(node, "kinematics"):
        if name == "hash":
            continue
        section = source.section(value, f"kinematics.{name}", _KEYS)
        nodes = [section.require(key) for key in _KEYS] if section is not None else []
        numbers = [
            source.number(item, f"kinematics.{name}.{key}") for key, item in zip(_KEYS, nodes, strict=False) if item
        ]
        origins[name] = tuple(number for number in numbers if number is not None)
    source.finish()
    names = _names(tuple(origins), file)
    joints = []
    for link, name in names.items():
        x, y, z, roll, pitch, yaw = origins[link]
        values = {"x": x, "y": y, "z": z, "roll": roll, "pitch": pitch, "yaw": yaw, "offset": 0.0}
        joints.append(Joint(name, "revolute", values, limits=(-_TURN, _TURN)))
    is_ur = tuple(names.values()) == UR_JOINTS
    return Robot("Universal Robots arm" if is_ur else f"{len(joints)}-axis arm", "urdf", tuple(joints))


def links_text(frames: JointFrames, names: Sequence[str], header: str = "", hash_line: str = "") -> tuple[str, Frame]:
    """Return the kinematics file of an arm, and the flange in the last joint's frame, which the file cannot hold."""
    steps = frames.steps()
    lines = [f"# {line}" for line in header.splitlines()] + ["kinematics:"]
    for name, step in zip(names, steps[:-1], strict=True):
        frame = frame_of_poses(step)
        lines.append(f"  {name}:")
        lines += [f"    {key}: {float(value)!r}" for key, value in zip(_KEYS, (*frame.xyz, *frame.rpy), strict=True)]
    if hash_line:
        lines.append(f"  {hash_line}")
    return "\n".join([*lines, ""]), frame_of_poses(steps[-1])


def link_names(frames: JointFrames, form: str) -> tuple[str, ...]:
    """Return the names of an arm's joints in the file of ``form``, ``ur-kinematics`` or ``xarm``.

    Raises:
        UsageError: The arm has a prismatic joint, or for ``ur-kinematics`` other than six joints.
    """
    if any(joint.type != "revolute" for joint in frames.joints):
        raise UsageError(f"the format {form} has revolute joints only")
    if form == "xarm":
        return tuple(f"joint{i + 1}" for i in range(len(frames.joints)))
    if len(frames.joints) != len(UR_LINKS):
        raise UsageError(f"the format {form} is for arms with six joints; this one has {len(frames.joints)}")
    return UR_LINKS


def hash_line_of(text: str) -> str:
    """Return the line ``hash: …`` of a kinematics file, by which the driver knows the arm; empty without one."""
    return next((line.strip() for line in text.splitlines() if line.strip().startswith("hash:")), "")


def _kinematics(root: yaml.Node) -> yaml.MappingNode | None:
    if not isinstance(root, yaml.MappingNode):
        return None
    for key, value in root.value:
        if isinstance(key, yaml.ScalarNode) and key.value == "kinematics" and isinstance(value, yaml.MappingNode):
            return value
    return None


def _names(links: tuple[str, ...], file: str) -> dict[str, str]:
    """Return the joint of each link, in the order of the arm."""
    if set(links) == set(UR_LINKS):
        return dict(zip(UR_LINKS, UR_JOINTS, strict=True))
    numbered = [f"joint{i + 1}" for i in range(len(links))]
    if links and set(links) == set(numbered):
        return {name: name for name in numbered}
    fix = f"expected {', '.join(UR_LINKS)}, or joint1, joint2 …"
    raise InputError(Problem(f"the joints are {', '.join(links) or 'missing'}", file, column="kinematics", fix=fix))
