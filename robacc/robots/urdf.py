"""Read a URDF into a :class:`~robacc.robots.description.Robot`: one serial chain of its tree of links."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, cast

from robacc.errors import InputError, Problem, UsageError
from robacc.robots.description import MAX_JOINTS, ORIGIN_PARAMETERS, ZERO, Joint, JointType, Mimic, Robot, Vector
from robacc.robots.urdf_branches import with_branches
from robacc.robots.urdf_chain import UrdfTree, choose_chain
from robacc.robots.urdf_mimics import resolve_branch_mimics, resolve_mimics
from robacc.robots.urdf_sizes import check_sizes
from robacc.robots.urdf_writer import robot_to_urdf
from robacc.robots.urdf_xml import UrdfDocument, read_document
from robacc.robots.yaml_units import finite_limits

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

__all__ = ["parse_urdf", "robot_to_urdf"]

_TYPES: dict[str, JointType] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": "fixed",
}
_MIN_AXIS = 1e-9
"""An axis shorter than this has no direction."""
_UNIT_AXIS = 1e-12
"""An axis this near to unit length keeps its written numbers."""


def parse_urdf(
    text: str,
    file: str,
    base_link: str | None = None,
    tip_link: str | None = None,
    joint_columns: Callable[[], Sequence[str]] | None = None,
) -> Robot:
    """Return one serial chain of a URDF, without opening a mesh or any other file.

    Args:
        text: The URDF.
        file: Its name, for messages.
        base_link: Link that the chain starts at; default: the root.
        tip_link: Link that the chain ends at; default: the link that ``joint_columns`` imply, else the only leaf with
            the most moving joints before it, then with the most joints.
        joint_columns: Returns the names of a pose file's columns, by which
            :func:`~robacc.robots.urdf_chain.choose_chain` chooses the chain.

    A joint that follows a joint outside the chain becomes a joint variable, because nothing in the chain moves it.
    Masses of links outside the chain, such as a gripper's, count with the link of the chain that carries them; joints
    that move much of it, such as those of another arm, are branches.

    Raises:
        InputError: The URDF has a problem, its chain is not serial, or the choice of a chain is ambiguous.
        UsageError: ``base_link`` or ``tip_link`` is not a link of the URDF, or the tip is not behind the base.
    """
    document = read_document(text, file)
    tree = _read_tree(document)
    base, tip = choose_chain(tree, base_link, tip_link, joint_columns)
    path = tree.path(base, tip)
    if not path:
        raise UsageError(f"{file}: link {tip!r} is not behind link {base!r}")
    if len(path) > MAX_JOINTS:
        message = f"there are {len(path)} joints from {base!r} to {tip!r}, expected at most {MAX_JOINTS}"
        raise InputError(Problem(message, file, fix="choose a shorter chain with `base_link` and `tip_link`"))
    joints, branches = with_branches(
        tree, base, [_read_joint(tree, joint) for joint in path], lambda joint: _read_joint(tree, joint)
    )
    check_sizes(document, tree.elements, [*joints, *(branch.joint for branch in branches)])
    document.finish()
    branches = resolve_branch_mimics(document, tree.elements, tree.robot.joints, joints, branches)
    joints = resolve_mimics(document, tree.elements, tree.robot.joints, joints)
    if not any(joint.is_variable for joint in joints):
        document.report(None, "", f"no joint between {base!r} and {tip!r} moves", "choose a longer chain")
    document.finish()
    return Robot(tree.robot.name, "urdf", tuple(joints), base_link=base, tip_link=tip, branches=branches)


def _read_tree(document: UrdfDocument) -> UrdfTree:
    from yourdfpy import URDF

    model = URDF.load(
        io.BytesIO(document.text()),
        build_scene_graph=False,
        build_collision_scene_graph=False,
        load_meshes=False,
        load_collision_meshes=False,
    )
    elements = {element.get("name", ""): element for element in document.root.iter("joint")}
    links = {link.name for link in model.robot.links}
    parent_joint: dict[str, Any] = {}
    for joint in model.robot.joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                document.report(elements[joint.name], joint.name, f"its {role} link {link!r} does not exist")
        if joint.child in parent_joint:
            message = f"moves the link {joint.child!r}, as {parent_joint[joint.child].name!r} does: not a serial chain"
            document.report(elements[joint.name], joint.name, message)
        parent_joint.setdefault(joint.child, joint)
    document.finish()
    return UrdfTree(document, model.robot, parent_joint, elements)


def _read_joint(tree: UrdfTree, joint: Any) -> Joint:
    document, element = tree.document, tree.elements[joint.name]
    kind = _TYPES.get(joint.type)
    if kind is None:
        known = joint.type in ("floating", "planar")
        message = (
            f"a {joint.type} joint cannot be part of a serial chain" if known else f"unknown joint type {joint.type!r}"
        )
        fix = "choose a chain without it with `base_link` and `tip_link`"
        document.report(element, joint.name, message, fix)
    mass, com = _read_inertial(tree, joint.child)
    return Joint(
        name=joint.name,
        type=kind or "fixed",
        parameters=_read_origin(element),
        axis=(0.0, 0.0, 1.0) if joint.type == "fixed" else _read_axis(document, element, joint),
        limits=None if joint.type in ("fixed", "continuous") else _read_limits(document, element, joint),
        is_continuous=joint.type == "continuous",
        mass=mass,
        com=com,
        mimic=_read_mimic(joint),
        link=joint.child,
    )


def _read_mimic(joint: Any) -> Mimic | None:
    # A fixed joint does not move, whatever it follows; reduced URDFs leave the element in place.
    if joint.mimic is None or joint.type == "fixed":
        return None
    return Mimic(joint.mimic.joint, joint.mimic.multiplier, joint.mimic.offset)


def _read_origin(element: Element) -> dict[str, float]:
    # From the attributes: yourdfpy stores an origin as a matrix only, and near a pitch of 90 degrees the roll and yaw
    # computed from it lose most of their digits.
    origin = element.find("origin")
    values = dict.fromkeys(ORIGIN_PARAMETERS, 0.0)
    if origin is not None:
        numbers = [float(part) for key in ("xyz", "rpy") for part in origin.get(key, "0 0 0").split()]
        values |= dict(zip(ORIGIN_PARAMETERS, numbers, strict=False))
    return values


def _read_axis(document: UrdfDocument, element: Element, joint: Any) -> Vector:
    x, y, z = (float(value) for value in joint.axis)
    length = math.hypot(x, y, z)
    if length < _MIN_AXIS:
        document.report(element, joint.name, "the joint's axis is zero and has no direction")
        return (0.0, 0.0, 1.0)
    return (x, y, z) if abs(length - 1) < _UNIT_AXIS else (x / length, y / length, z / length)


def _read_limits(document: UrdfDocument, element: Element, joint: Any) -> tuple[float, float] | None:
    limit = joint.limit
    if limit is None or (limit.lower is None and limit.upper is None):
        return None
    # Where one limit is missing, the format's default for it is zero.
    lower, upper = (0.0 if value is None else float(value) for value in (limit.lower, limit.upper))
    if math.isinf(lower) and math.isinf(upper):
        return None
    if math.isinf(lower) or math.isinf(upper):
        document.report(element, joint.name, f"one limit is infinite, the other is not ({lower:g}, {upper:g})")
    elif lower > upper:
        document.report(element, joint.name, f"the lower limit {lower:g} is above the upper limit {upper:g}")
    elif joint.type in ("revolute", "prismatic"):
        limits, problem = finite_limits(joint.type, (lower, upper))
        if problem is not None:
            document.report(element, joint.name, problem, "make them infinite for a joint without limits")
        return limits
    return lower, upper


def _read_inertial(tree: UrdfTree, link_name: str) -> tuple[float | None, Vector | None]:
    link = next(link for link in tree.robot.links if link.name == link_name)
    if link.inertial is None or link.inertial.mass is None:
        return None, None
    mass = float(link.inertial.mass)
    if mass < 0:
        element = next(item for item in tree.document.root.iter("link") if item.get("name") == link_name)
        tree.document.report(element, link_name, f"the link's mass is negative ({mass:g} kg)")
    origin = link.inertial.origin
    com = ZERO if origin is None else cast(Vector, tuple(float(value) for value in origin[:3, 3]))
    return mass, com
