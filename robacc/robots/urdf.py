"""Read a URDF into a :class:`~robacc.robots.description.Robot`: one serial chain of its tree of links."""

from __future__ import annotations

import difflib
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from robacc.errors import InputError, Problem, UsageError
from robacc.robots.description import MAX_JOINTS, ORIGIN_PARAMETERS, ZERO, Joint, JointType, Mimic, Robot, Vector
from robacc.robots.urdf_mimics import resolve_mimics
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


@dataclass(frozen=True, slots=True)
class _Tree:
    """Links and joints of the file, as yourdfpy reads them."""

    document: UrdfDocument
    robot: Any
    """yourdfpy's Robot."""
    parent_joint: dict[str, Any]
    """Joint that moves each link."""
    elements: dict[str, Element]
    """Element of each joint, by name."""

    @property
    def roots(self) -> list[str]:
        """Links that no joint moves."""
        return [link.name for link in self.robot.links if link.name not in self.parent_joint]

    def leaves(self, base: str) -> list[str]:
        """Return the links behind ``base`` that no joint follows."""
        parents = {joint.parent for joint in self.robot.joints}
        leaves = [link.name for link in self.robot.links if link.name not in parents]
        return [name for name in leaves if name != base and self.path(base, name) is not None]

    def path(self, base: str, tip: str) -> list[Any] | None:
        """Return the joints from ``base`` to ``tip`` in order; None where ``tip`` is not behind ``base``."""
        path: list[Any] = []
        link = tip
        while link != base:
            joint = self.parent_joint.get(link)
            # The length guards against a circle of joints, which has no root to stop at.
            if joint is None or len(path) > len(self.parent_joint):
                return None
            path.append(joint)
            link = joint.parent
        return path[::-1]


def parse_urdf(text: str, file: str, base_link: str | None = None, tip_link: str | None = None) -> Robot:
    """Return one serial chain of a URDF, without opening a mesh or any other file.

    Args:
        text: The URDF.
        file: Its name, for messages.
        base_link: Link that the chain starts at; default: the root.
        tip_link: Link that the chain ends at; default: the only leaf with the most moving joints before it, then with
            the most joints.

    A joint that follows a joint outside the chain becomes a joint variable, because nothing in the chain moves it.

    Raises:
        InputError: The URDF has a problem, its chain is not serial, or the choice of a chain is ambiguous.
        UsageError: ``base_link`` or ``tip_link`` is not a link of the URDF, or the tip is not behind the base.
    """
    document = read_document(text, file)
    tree = _read_tree(document)
    base = _choose_base(tree, base_link)
    tip = _choose_tip(tree, base, tip_link)
    path = tree.path(base, tip)
    if not path:
        raise UsageError(f"{file}: link {tip!r} is not behind link {base!r}")
    if len(path) > MAX_JOINTS:
        message = f"there are {len(path)} joints from {base!r} to {tip!r}, expected at most {MAX_JOINTS}"
        raise InputError(Problem(message, file, fix="choose a shorter chain with `base_link` and `tip_link`"))
    joints = [_read_joint(tree, joint) for joint in path]
    check_sizes(document, tree.elements, joints)
    document.finish()
    joints = resolve_mimics(document, tree.elements, tree.robot.joints, joints)
    if not any(joint.is_variable for joint in joints):
        document.report(None, "", f"no joint between {base!r} and {tip!r} moves", "choose a longer chain")
    document.finish()
    return Robot(tree.robot.name, "urdf", tuple(joints), base_link=base, tip_link=tip)


def _read_tree(document: UrdfDocument) -> _Tree:
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
    return _Tree(document, model.robot, parent_joint, elements)


def _choose_base(tree: _Tree, base_link: str | None) -> str:
    if base_link is not None:
        return _known_link(tree, base_link, "`base_link`")
    roots = tree.roots
    if len(roots) == 1:
        return roots[0]
    if not roots:
        message = (
            "the joints form a loop: there is no link to start from" if tree.parent_joint else "the file has no links"
        )
        raise InputError(Problem(message, tree.document.file))
    message = f"{len(roots)} links could be the base: {_listing(roots)}"
    raise InputError(Problem(message, tree.document.file, fix="choose one with `base_link`"))


def _choose_tip(tree: _Tree, base: str, tip_link: str | None) -> str:
    if tip_link is not None:
        return _known_link(tree, tip_link, "`tip_link`")
    ranks: dict[tuple[int, int], list[str]] = {}
    for leaf in tree.leaves(base):
        path = tree.path(base, leaf) or []
        moving = sum(joint.type != "fixed" and joint.mimic is None for joint in path)
        ranks.setdefault((moving, len(path)), []).append(leaf)
    if not ranks:
        raise InputError(Problem(f"no joint follows the link {base!r}", tree.document.file))
    best = ranks[max(ranks)]
    if len(best) == 1:
        return best[0]
    leaves = [leaf for rank in sorted(ranks, reverse=True) for leaf in ranks[rank]]
    message = f"{len(best)} chains are equally long; the tree ends at {_listing(leaves)}"
    raise InputError(Problem(message, tree.document.file, fix="choose one with `tip_link`"))


def _known_link(tree: _Tree, name: str, parameter: str) -> str:
    names = [link.name for link in tree.robot.links]
    if name in names:
        return name
    suggestions = difflib.get_close_matches(name, names, 3, 0.5) or names
    raise UsageError(f"{parameter}: {tree.document.file} has no link {name!r}; it has {_listing(suggestions)}")


def _listing(names: Sequence[str]) -> str:
    text = ", ".join(names[:12])
    return f"{text} and {len(names) - 12} more" if len(names) > 12 else text


def _read_joint(tree: _Tree, joint: Any) -> Joint:
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


def _read_inertial(tree: _Tree, link_name: str) -> tuple[float | None, Vector | None]:
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
