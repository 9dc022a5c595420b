"""Read a URDF into a robot: one serial chain, its mimic joints, and the masses of links outside it."""

from __future__ import annotations

import dataclasses
import io
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, cast
from xml.etree.ElementTree import Element

import numpy as np

from robacc.errors import InputError, Problem, UsageError
from robacc.geometry import Array, rpy_from_rotation
from robacc.robots.description import (
    MAX_JOINTS,
    ORIGIN_PARAMETERS,
    ZERO,
    BranchJoint,
    Joint,
    JointType,
    Mimic,
    Robot,
    Vector,
    unit_axis,
)
from robacc.robots.urdf_chain import UrdfDocument, UrdfTree, check_sizes, choose_chain, read_document
from robacc.robots.yaml_units import finite_limits

# Resolve the mimic joints of a URDF's chain, and of its branches.


def _resolve_mimics(
    tree: UrdfTree, joints: Sequence[Joint], branches: Sequence[BranchJoint]
) -> tuple[list[Joint], list[BranchJoint]]:
    """Return the joints with every mimic made to follow, directly, a joint variable of the chain or of a branch.

    Of the joints of the chain that follow a joint outside of it, the first becomes the variable, and any other, in the
    chain or outside, follows it: ``q_b = m_b / m_a (q_a - o_a) + o_b``. A joint that follows one which stands at zero
    keeps a variable.
    """
    inside = {joint.name for joint in joints}
    known = inside | {branch.joint.name for branch in branches}
    chain = [_direct_mimic(tree, joint) for joint in joints]
    leaders: dict[str, tuple[str, Mimic]] = {}
    for joint in chain:
        if joint.mimic is not None and joint.mimic.master not in inside and joint.mimic.multiplier != 0.0:
            leaders.setdefault(joint.mimic.master, (joint.name, joint.mimic))

    def follower(joint: Joint, rule: Mimic) -> Joint:
        leader, first = leaders[rule.master]
        ratio = rule.multiplier / first.multiplier
        return replace(joint, mimic=Mimic(leader, ratio, rule.offset - ratio * first.offset))

    for i, joint in enumerate(chain):
        rule = joint.mimic
        if rule is None or rule.master in inside:
            continue
        if rule.multiplier == 0.0:
            chain[i] = replace(joint, mimic=None)
        elif leaders[rule.master][0] == joint.name:
            chain[i] = replace(joint, mimic=None, outside=rule)
        else:
            chain[i] = follower(joint, rule)
    beside = []
    for branch in branches:
        joint = _direct_mimic(tree, branch.joint)
        rule = joint.mimic or Mimic(joint.name)
        if rule.master in leaders:
            joint = follower(joint, rule)
        elif rule.master not in known:
            joint = replace(joint, mimic=None)
        beside.append(replace(branch, joint=joint))
    return chain, beside


def _direct_mimic(tree: UrdfTree, joint: Joint) -> Joint:
    """Return the joint with its mimic made to follow, directly, a joint that moves by itself, in the chain or not."""
    by_name = {other.name: other for other in tree.robot.joints}
    mimic, visited = joint.mimic, {joint.name}
    while mimic is not None:
        master = by_name.get(mimic.master)
        problem = None
        if master is None:
            problem = "which is not a joint of this file"
        elif master.type == "fixed":
            problem = "which is fixed"
        elif master.name in visited:
            problem = "which follows it in turn: none of these joints moves by itself"
        if problem or master is None:
            tree.document.report(tree.elements[joint.name], joint.name, f"follows {mimic.master!r}, {problem}")
            return joint
        if master.mimic is None:
            return replace(joint, mimic=mimic)
        visited.add(master.name)
        # q = m1 (m2 q' + o2) + o1
        inner = master.mimic
        offset = mimic.multiplier * inner.offset + mimic.offset
        mimic = Mimic(inner.joint, mimic.multiplier * inner.multiplier, offset)
    return joint


# Masses of a URDF's links outside the chain: grippers, hoses' clamps, cameras, a second arm.

_LEAST_MOMENT = 0.05
"""kg m: a joint that moves mass by less, such as a gripper's finger, counts as fixed; a gear of 1e-5 rad/(N m) yields
by 5 um at 1 m to it."""
_MOVING = ("revolute", "continuous", "prismatic")


def with_branches(
    tree: UrdfTree, base: str, joints: Sequence[Joint], read_joint: Callable[[Any], Joint]
) -> tuple[list[Joint], list[BranchJoint]]:
    """Return the joints of a chain, each link with the mass that it carries rigidly, and the joints of branches.

    A joint outside the chain that moves little mass stands at zero, as if it were fixed. Joints that follow others are
    not resolved yet. A chain without any mass stays without.

    Args:
        tree: The URDF's tree.
        base: First link of the chain.
        joints: Joints of the chain.
        read_joint: Returns the description of a joint of the tree.
    """
    if not any(joint.mass for joint in joints):
        return list(joints), []
    beside = _Beside(tree, frozenset(joint.link for joint in joints))
    loaded = []
    branches = list(_branches(beside, beside.carried(base), None, read_joint))
    for joint in joints:
        carried = list(beside.carried(joint.link))
        loaded.append(_loaded(joint, carried))
        branches += _branches(beside, carried, joint.name, read_joint)
    return loaded, branches


class _Link(NamedTuple):
    """Link that another carries rigidly, or the joint of a link that moves against it."""

    frame: Array
    """``(4, 4)`` of the link, or of the joint at zero, in the frame of the carrier."""
    mass: float
    com: Array
    joint: Any | None
    """Joint that moves the link; None for a link that is carried rigidly."""


@dataclass(frozen=True)
class _Beside:
    """Links of a tree beside a chain."""

    tree: UrdfTree
    on_chain: frozenset[str | None]

    @cached_property
    def joints(self) -> dict[str, list[Any]]:
        """Joints off the chain, by the link that carries them."""
        joints: dict[str, list[Any]] = {}
        for joint in self.tree.robot.joints:
            if joint.child not in self.on_chain:
                joints.setdefault(joint.parent, []).append(joint)
        return joints

    @cached_property
    def inertials(self) -> dict[str, tuple[float, Array]]:
        """Mass and centre of mass of each link that has them, in its own frame."""
        return {
            link.name: (float(link.inertial.mass), _transform(link.inertial.origin)[:3, 3])
            for link in self.tree.robot.links
            if link.inertial is not None and link.inertial.mass is not None
        }

    def inertial(self, link: str) -> tuple[float, Array]:
        """Return mass and centre of mass of a link, in its own frame; zeros if it has none."""
        return self.inertials.get(link, (0.0, np.zeros(3)))

    def carried(self, link: str | None, frame: Array | None = None) -> Iterator[_Link]:
        """Yield the links that ``link`` carries rigidly, and those that a joint moves against it."""
        for joint in self.joints.get(link or "", ()):
            child = _transform(joint.origin) if frame is None else frame @ _transform(joint.origin)
            if joint.type in _MOVING and self._movable_moment(joint) > _LEAST_MOMENT:
                yield _Link(child, 0.0, np.zeros(3), joint)
            else:
                yield _Link(child, *self.inertial(joint.child), None)
                yield from self.carried(joint.child, child)

    def _movable_moment(self, joint: Any) -> float:
        """Return the most by which a joint can move the first moment of the mass behind it, kg m."""
        behind = list(self._behind(joint.child, 0.0))
        if joint.type != "prismatic":
            return sum(mass * distance for mass, distance in behind)
        limit = joint.limit
        travel = 0.0 if limit is None else abs((limit.upper or 0.0) - (limit.lower or 0.0))
        return travel * sum(mass for mass, _ in behind)

    def _behind(self, link: str, distance: float) -> Iterator[tuple[float, float]]:
        """Yield mass, and greatest distance from a joint at ``distance`` from ``link``, of the links from it on."""
        mass, com = self.inertial(link)
        yield mass, distance + float(np.linalg.norm(com))
        for joint in self.joints.get(link, ()):
            yield from self._behind(joint.child, distance + float(np.linalg.norm(_transform(joint.origin)[:3, 3])))


def _loaded(joint: Joint, carried: Sequence[_Link]) -> Joint:
    """Return the joint with the masses of its link and of the links on it as a single mass."""
    rigid = [link for link in carried if link.joint is None and link.mass > 0]
    if not rigid:
        return joint
    link_mass, link_com = (joint.mass or 0.0, np.array(joint.com or (0.0, 0.0, 0.0)))
    total = link_mass + sum(link.mass for link in rigid)
    moments = [link.mass * (link.frame @ np.append(link.com, 1.0))[:3] for link in rigid]
    moment = link_mass * link_com + sum(moments, np.zeros(3))
    return dataclasses.replace(joint, mass=total, com=cast(Vector, tuple(float(value) for value in moment / total)))


def _branches(
    beside: _Beside, carried: Iterator[_Link] | Sequence[_Link], parent: str | None, read_joint: Callable[[Any], Joint]
) -> Iterator[BranchJoint]:
    """Yield the moving joints among links that ``parent`` carries, and those behind them."""
    for link in carried:
        if link.joint is None:
            continue
        joint = dataclasses.replace(read_joint(link.joint), limits=None)
        if not np.array_equal(link.frame, _transform(link.joint.origin)):
            joint = dataclasses.replace(joint, parameters=_origin(link.frame))
        behind = list(beside.carried(joint.link))
        yield BranchJoint(_loaded(joint, behind), parent)
        yield from _branches(beside, behind, joint.name, read_joint)


def _origin(frame: Array) -> dict[str, float]:
    """Return the parameters of a joint's origin ``(4, 4)``."""
    values = [float(value) for value in (*frame[:3, 3], *rpy_from_rotation(frame[:3, :3]))]
    return dict.fromkeys(ORIGIN_PARAMETERS, 0.0) | dict(zip(ORIGIN_PARAMETERS, values, strict=False))


def _transform(origin: Any) -> Array:
    """Return an origin of yourdfpy ``(4, 4)``; the identity for None."""
    return np.eye(4) if origin is None else np.asarray(origin, dtype=float)


_TYPES: dict[str, JointType] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": "fixed",
}


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
    joints, branches = _resolve_mimics(tree, joints, branches)
    if not any(joint.is_variable for joint in joints):
        document.report(None, "", f"no joint between {base!r} and {tip!r} moves", "choose a longer chain")
    document.finish()
    return Robot(tree.robot.name, "urdf", tuple(joints), base_link=base, tip_link=tip, branches=tuple(branches))


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
    axis = None if joint.type == "fixed" else unit_axis([float(value) for value in joint.axis])
    if axis is None and joint.type != "fixed":
        document.report(element, joint.name, "the joint's axis is zero and has no direction")
    mass, com = _read_inertial(tree, joint.child)
    mimic = joint.mimic
    return Joint(
        name=joint.name,
        type=kind or "fixed",
        parameters=_read_origin(element),
        axis=axis or (0.0, 0.0, 1.0),
        limits=None if joint.type in ("fixed", "continuous") else _read_limits(document, element, joint),
        is_continuous=joint.type == "continuous",
        mass=mass,
        com=com,
        # A fixed joint does not move, whatever it follows; reduced URDFs leave the element in place.
        mimic=Mimic(mimic.joint, mimic.multiplier, mimic.offset) if mimic and joint.type != "fixed" else None,
        link=joint.child,
    )


def _read_origin(element: Element) -> dict[str, float]:
    # From the attributes: yourdfpy stores an origin as a matrix only, and near a pitch of 90 degrees the roll and yaw
    # computed from it lose most of their digits.
    origin = element.find("origin")
    values = dict.fromkeys(ORIGIN_PARAMETERS, 0.0)
    if origin is not None:
        numbers = [float(part) for key in ("xyz", "rpy") for part in origin.get(key, "0 0 0").split()]
        values |= dict(zip(ORIGIN_PARAMETERS, numbers, strict=False))
    return values


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
