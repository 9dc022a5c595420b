"""Files and commands of ROS: kinematics of the drivers' arms, and the frames of a cell.

``ur_description`` reads a kinematics file for an arm of Universal Robots (``default_kinematics.yaml``, or the file that
``ur_calibration`` extracts), ``xarm_description`` one for an arm of UFACTORY. It has one origin (x, y, z, roll, pitch,
yaw) for each joint, that of a URDF joint that turns about z: R = Rz(yaw) Ry(pitch) Rx(roll).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from shlex import quote

import yaml

from robacc.errors import Problem, refuse
from robacc.exporters import Written
from robacc.geometry import quaternion_from_rotation
from robacc.io.yaml_nodes import Source, compose
from robacc.robots.description import FRAME_PARAMETERS, Frame, Joint, Robot
from robacc.robots.yaml_robot import read_fields
from robacc.version import __version__
from robacc_plugins.denavit_hartenberg import FULL_TURN, joint_frames, steps
from robacc_plugins.universal_robots import UR_JOINTS
from robacc_plugins.urdf import MEASURING_FRAME, TOOL_LINK

# Kinematics files.

UR_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")


def read(text: str, file: str) -> Robot | None:
    """Return the arm of a kinematics file; None for a text without ``kinematics``.

    Raises:
        InputError: The joints are neither UR's nor joint1 to jointN, or a number is missing.
    """
    if not re.search(r"^kinematics[ \t]*:", text, re.M):
        return None
    source = Source(file)
    root = compose(text, file)
    pairs = root.value if isinstance(root, yaml.MappingNode) else []
    nodes = [value for key, value in pairs if key.value == "kinematics" and isinstance(value, yaml.MappingNode)]
    fix = "give default_kinematics.yaml, the file of ur_calibration, or a kinematics file of xarm_description"
    refuse((not nodes, Problem("has no key kinematics with an origin for each joint", file, fix=fix)))
    origins: dict[str, dict[str, float]] = {}
    for name, _, value in source.entries(nodes[0], "kinematics"):
        if name != "hash" and (section := source.section(value, f"kinematics.{name}", FRAME_PARAMETERS)):
            origins[name] = read_fields(section, dict.fromkeys(FRAME_PARAMETERS, Source.number), FRAME_PARAMETERS)
    source.raise_if_any()
    numbered = [f"joint{i + 1}" for i in range(len(origins))]
    # The joint of each link, in the order of the arm.
    is_ur = set(origins) == set(UR_LINKS)
    names = dict(zip(UR_LINKS, UR_JOINTS, strict=True)) if is_ur else {name: name for name in numbered}
    message, fix = (
        f"the joints are {', '.join(origins) or 'missing'}",
        f"expected {', '.join(UR_LINKS)}, or joint1, joint2 …",
    )
    refuse((not origins or set(names) != set(origins), Problem(message, file, column="kinematics", fix=fix)))
    joints = [
        Joint(name, "revolute", {**origins[link], "offset": 0.0}, limits=FULL_TURN) for link, name in names.items()
    ]
    return Robot("Universal Robots arm" if is_ur else f"{len(joints)}-axis arm", "urdf", tuple(joints))


def write_ur(robot: Robot, *, template: str | None = None) -> Written:
    """Return the kinematics file of ``ur_description``.

    Of ``template``, the arm's own file, the line ``hash: …`` is kept: the driver knows the arm by it.

    Raises:
        UsageError: The arm has a prismatic joint, or other than six joints.
    """
    return _origins(robot, "ur-kinematics", UR_LINKS, template or "")


def write_xarm(robot: Robot) -> Written:
    """Return the kinematics file of ``xarm_description``.

    Raises:
        UsageError: The arm has a prismatic joint.
    """
    return _origins(robot, "xarm", [f"joint{i + 1}" for i in range(len(robot.variables))], "")


def _origins(robot: Robot, form: str, names: Sequence[str], template: str) -> Written:
    """Return a kinematics file, and the tool in the last joint's frame, which the file cannot hold."""
    *origins, flange = steps(joint_frames(robot))
    is_revolute = all(joint.type == "revolute" for joint in robot.variables)
    refuse(
        (not is_revolute, f"the format {form} has revolute joints only"),
        (len(origins) != len(names), f"the format {form} is for arms with six joints; this one has {len(origins)}"),
    )
    lines = [f"# written by robacc {__version__} from {robot.name}", "kinematics:"]
    for link, origin in zip(names, origins, strict=True):
        numbers = zip(FRAME_PARAMETERS, (*origin.xyz, *origin.rpy), strict=True)
        lines += [f"  {link}:", *(f"    {key}: {float(value)!r}" for key, value in numbers)]
    lines += [f"  {line.strip()}" for line in template.splitlines() if line.strip().startswith("hash:")][:1]
    return Written("\n".join([*lines, ""]), tool=Frame.of(flange.pose @ robot.tool.pose))


# Frames of a cell.

CAMERA = "camera_optical_frame"


def write_transforms(robot: Robot) -> Written:
    """Return commands that publish where the base stands and where the targets are on the last link.

    In a model that was fitted to photos, the board is the measuring frame and the camera the target, or the other way
    round for a camera beside the arm. The z axis of a camera's frame points ahead, its x axis to the right.
    """
    coefficients = (name.split(".") for name in (robot.fit or {}).get("coefficients", ()))
    seen_from = {parts[1] for parts in coefficients if parts[0] == "base_frame" and len(parts) == 3}
    pairs = {("board",): ("board", CAMERA), ("camera",): (CAMERA, "board")}
    world, target = pairs.get(tuple(seen_from), (MEASURING_FRAME, TOOL_LINK))
    flange = robot.tip_link or "flange"
    frames = [(world, robot.base_link or "base_link", robot.base)]
    frames += [(flange, name, frame) for name, frame in (robot.targets or {target: robot.tool}).items()]
    lines = [f"# written by robacc {__version__} from {' '.join(robot.name.split())}"]
    for parent, child, frame in frames:
        w, *imaginary = quaternion_from_rotation(frame.pose.rotation)
        numbers = zip(("x", "y", "z", "qx", "qy", "qz", "qw"), (*frame.xyz, *imaginary, w), strict=True)
        options = " ".join(f"--{name} {float(number):.9f}" for name, number in numbers)
        command = "ros2 run tf2_ros static_transform_publisher"
        lines.append(f"{command} {options} --frame-id {quote(parent)} --child-frame-id {quote(child)}")
    return Written("\n".join([*lines, ""]), ["joint zeros and link geometry, which the format urdf has"])
