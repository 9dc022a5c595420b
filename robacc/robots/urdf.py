"""Read a URDF into a robot: one serial chain of its links, mimic joints, and the masses of links outside it."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, cast
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from robacc.errors import InputError, Problem, UsageError
from robacc.geometry import Array, Poses
from robacc.robots.description import (
    LENGTH_PARAMETERS,
    MAX_JOINTS,
    MAX_LENGTH,
    ORIGIN_PARAMETERS,
    TRAVEL_IN_MM,
    TURN,
    ZERO,
    BranchJoint,
    Frame,
    Joint,
    JointType,
    Mimic,
    Robot,
    Vector,
    finite_limits,
    limits_likely_degrees,
    unit_axis,
)

# Links and joints of a URDF: its XML read safely, each number checked, each problem with its line.

_ELEMENTS: Mapping[str, tuple[str, ...]] = {
    "": ("robot",),
    "robot": ("link", "joint"),
    "link": ("inertial",),
    "inertial": ("origin", "mass"),
    "joint": ("origin", "parent", "child", "axis", "limit", "mimic"),
}
"""Elements read below each element; meshes, colours, transmissions and simulator data do not affect the chain."""
_NAMES: Mapping[str, tuple[str, ...]] = {
    "link": ("name",),
    "joint": ("name", "type"),
    "parent": ("link",),
    "child": ("link",),
    "mimic": ("joint",),
}
"""Attributes that an element must have."""
_NUMBERS: Mapping[str, Mapping[str, int]] = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "limit": {"lower": 1, "upper": 1},
    "mimic": {"multiplier": 1, "offset": 1},
}
"""Count of numbers in each numeric attribute."""
_OTHER_MODELS = {"sdf": "an SDF model", "mujoco": "a MuJoCo model", "COLLADA": "a mesh", "robot_model": "not a URDF"}


def numbers(element: Element | None, attribute: str, default: str = "0 0 0") -> list[float]:
    """Return the numbers of an attribute that was checked, or of its default."""
    return [float(part) for part in (default if element is None else element.get(attribute, default)).split()]


class UrdfJoint(NamedTuple):
    """Joint of the file, between its two links."""

    element: Element
    name: str
    type: str
    parent: str
    child: str
    mimic: Mimic | None
    """Joint that it follows; None for a fixed joint, which reduced URDFs let follow others."""

    @property
    def moves(self) -> bool:
        """Whether the joint moves by itself."""
        return self.type != "fixed" and self.mimic is None

    @classmethod
    def of(cls, element: Element) -> UrdfJoint:
        """Return the joint of an element that was checked."""
        links = (element.find(tag) for tag in ("parent", "child"))
        parent, child = (str(link.get("link")) for link in links if link is not None)
        kind, rule = str(element.get("type")), element.find("mimic")
        mimic = None
        if rule is not None and kind != "fixed":
            mimic = Mimic(str(rule.get("joint")), *numbers(rule, "multiplier", "1"), *numbers(rule, "offset", "0"))
        return cls(element, str(element.get("name")), kind, parent, child, mimic)


@dataclass(frozen=True)
class UrdfTree:
    """Tree of links and joints, and the problems found in it so far."""

    file: str
    root: Element
    lines: Mapping[Element, int]
    """1-based line of each element's opening tag."""
    problems: list[Problem] = field(default_factory=list)

    @cached_property
    def links(self) -> Mapping[str, Element]:
        """Element of each link, by name."""
        return {element.get("name", ""): element for element in self.root.iter("link")}

    @cached_property
    def joints(self) -> tuple[UrdfJoint, ...]:
        """Joints of elements that were checked."""
        return tuple(map(UrdfJoint.of, self.root.iter("joint")))

    def report(self, element: Element | None, name: str, message: str, fix: str | None = None) -> None:
        """Add a problem of the joint or link ``name``."""
        line = None if element is None else self.lines[element]
        self.problems.append(Problem(message, self.file, line, name or None, fix))

    def finish(self) -> None:
        """Raise an error where there is a problem.

        Raises:
            InputError: Every problem, in the order of the file.
        """
        if self.problems:
            raise InputError(sorted(self.problems, key=lambda problem: problem.line or 0))

    @cached_property
    def below(self) -> Mapping[str, list[UrdfJoint]]:
        """Joints on each link, by its name."""
        below: dict[str, list[UrdfJoint]] = {name: [] for name in self.links}
        for joint in self.joints:
            below[joint.parent].append(joint)
        return below

    def paths(self, base: str) -> dict[str, list[UrdfJoint]]:
        """Return the joints from ``base`` to each link behind it, by the link's name."""
        paths: dict[str, list[UrdfJoint]] = {base: []}
        open_ = [base]
        for link in open_:
            for joint in self.below[link]:
                if joint.child not in paths:  # a circle of joints comes back to the base
                    paths[joint.child] = [*paths[link], joint]
                    open_.append(joint.child)
        return paths


def read_tree(text: str, file: str) -> UrdfTree:
    """Return the links and joints of a URDF, with every name and number checked.

    A document type is an error before anything is expanded: a URDF has none, and entities can exhaust the memory or
    read other files.

    Raises:
        InputError: The text is not well-formed XML, is not a URDF, is xacro, has wrong names or numbers, or two joints
            move one link.
    """
    reader = _XmlReader(file)
    try:
        reader.parser.Parse(text, True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise InputError(Problem(f"not well-formed XML: {reason}", file, error.lineno)) from None
    tree = UrdfTree(file, reader.builder.close(), reader.lines)
    _check(tree)
    tree.finish()
    movers: dict[str, str] = {}
    for joint in tree.joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in tree.links:
                tree.report(joint.element, joint.name, f"its {role} link {link!r} does not exist")
        if movers.setdefault(joint.child, joint.name) != joint.name:
            message = f"moves the link {joint.child!r}, as {movers[joint.child]!r} does: not a serial chain"
            tree.report(joint.element, joint.name, message)
    tree.finish()
    return tree


class _XmlReader:
    """Expat's handlers: selected elements go to a tree, with their lines."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.lines: dict[Element, int] = {}
        self.builder = TreeBuilder()
        self.selected: list[tuple[str, ...] | None] = [_ELEMENTS[""]]
        """Elements read below each open element; None below one that is not read itself."""
        self.parser = expat.ParserCreate()
        self.parser.StartDoctypeDeclHandler = self._doctype
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end

    def _refuse(self, message: str, fix: str | None = None) -> None:
        raise InputError(Problem(message, self.file, self.parser.CurrentLineNumber, fix=fix))

    def _doctype(self, name: str, *_: object) -> None:
        self._refuse(f"a document type (<!DOCTYPE {name}>) is not allowed in a URDF", "remove it and its entities")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        is_root, is_read = len(self.selected) == 1, tag in (self.selected[-1] or ())
        if tag.startswith("xacro:") or (
            is_read and any("${" in value or "$(" in value for value in attributes.values())
        ):
            self._refuse("this is xacro, not URDF", "run xacro first: xacro robot.xacro > robot.urdf")
        if is_root and not is_read:
            model = _OTHER_MODELS.get(tag, "not a URDF")
            self._refuse(f"the root element is <{tag}>, so this is {model}; a URDF's root is <robot>")
        self.selected.append(_ELEMENTS.get(tag, ()) if is_read else None)
        if is_read:
            self.lines[self.builder.start(tag, attributes)] = self.parser.CurrentLineNumber

    def _end(self, tag: str) -> None:
        if self.selected.pop() is not None:
            self.builder.end(tag)


def _check(tree: UrdfTree) -> None:
    """Report wrong names and numbers, and names that stand twice."""
    if not (robot_name := tree.root.get("name", "robot")).isprintable():
        tree.report(tree.root, "", f"<robot name>: expected a name, found {robot_name!r}")
    first_lines: dict[tuple[str, str], int] = {}
    for owner in tree.root:
        name = owner.get("name", "")
        if name and (owner.tag, name) in first_lines:
            message = f"there is already a {owner.tag} {name!r} in line {first_lines[owner.tag, name]}"
            tree.report(owner, name, message)
        first_lines.setdefault((owner.tag, name), tree.lines[owner])
        for element in owner.iter():
            _check_element(tree, name, element)
        for tag in ("parent", "child") if owner.tag == "joint" else ():
            if owner.find(tag) is None:
                tree.report(owner, name, f"the joint has no <{tag}>")


def _check_element(tree: UrdfTree, name: str, element: Element) -> None:
    for attribute in _NAMES.get(element.tag, ()):
        value = element.get(attribute, "")
        if not value.strip():
            tree.report(element, name, f"<{element.tag}> needs the attribute {attribute!r}")
        elif not value.isprintable():
            tree.report(element, name, f"<{element.tag} {attribute}>: expected a name, found {value!r}")
    for attribute, count in _NUMBERS.get(element.tag, {}).items():
        text = element.get(attribute, " ".join("0" * count))
        try:
            # float() also accepts 1_000 and digits of other scripts, which no other reader of URDF does.
            values = [float(part) for part in text.split()] if text.isascii() and "_" not in text else []
        except ValueError:
            values = []
        # An infinite limit means no limit.
        finite = all(math.isfinite(value) or (element.tag == "limit" and math.isinf(value)) for value in values)
        if len(values) != count or not finite:
            expected = "a number" if count == 1 else f"{count} numbers"
            tree.report(element, name, f"<{element.tag} {attribute}>: expected {expected}, found {text[:60]!r}")


# Choose one serial chain in the tree of links.

_NUMBERED = re.compile(r"(?i)[qja]_?([1-9]\d?)")
"""Column of a joint without a name: q1, J1, A1."""
_UNIT = re.compile(r"(_(m|mm|um|rad|deg|mrad)|\s*[\[(].*[\])])$")
"""Unit at the end of a column's name."""
_FLANGES = ("tool0", "flange")
"""Links that stand for the flange (ROS REP 199), the preferred first."""


def _choose_chain(
    tree: UrdfTree, base_link: str | None, tip_link: str | None, joint_columns: Callable[[], Sequence[str]] | None
) -> tuple[str, str]:
    """Return the first and the last link of the chain.

    A chain's tip that the caller does not name follows from the columns of the pose file. Where they name joints, the
    chain ends behind the last of them. Where they number joints, ``q1 … qN``, the longest chain ends behind its
    N-th joint. Fixed joints behind it belong to the chain up to the flange, but a gripper does not.
    """
    columns = [_UNIT.sub("", name.strip()) for name in joint_columns()] if joint_columns and tip_link is None else []
    base = _choose_base(tree, base_link)
    paths = tree.paths(base)
    named = {joint for joint in tree.joints if joint.moves and joint.name in columns}
    # The joint with all others before it; there is none where they are on several branches.
    last = next((joint for joint in tree.joints if joint in named and named <= {*paths.get(joint.child, ())}), None)
    if last is not None:
        moving = [joint for joint in paths[last.child] if joint.moves]
        first = next(joint for joint in moving if joint in named)
        # Joints in front that the file does not have, such as wheels, only place the base.
        return first.parent if moving[0] is not first and base_link is None else base, _flange(tree, last.child)
    leaves = {link: paths[link] for link in tree.links if link in paths and link != base and not tree.below[link]}
    count = len({match[1] for name in columns if (match := _NUMBERED.fullmatch(name))})
    if count and not named:
        moving_paths = [[joint for joint in path if joint.moves] for path in leaves.values()]
        longest = max(map(len, moving_paths), default=0)
        links = {path[count - 1].child for path in moving_paths if len(path) == longest > count}
        if len(links) == 1:
            return base, _flange(tree, links.pop())
    return base, _choose_tip(tree, base, tip_link, leaves)


def _flange(tree: UrdfTree, link: str) -> str:
    """Return the link behind the fixed joints that follow ``link``, in front of a gripper and of a fork."""
    while True:
        joints = tree.below[link]
        fixed = [
            joint.child
            for joint in joints
            if joint.type == "fixed" and all(behind.type == "fixed" for behind in tree.below[joint.child])
        ]
        named = [name for name in _FLANGES if name in fixed]
        if named:
            return named[0]
        if len(fixed) != 1 or len(joints) > 1:
            return link
        link = fixed[0]


def _choose_base(tree: UrdfTree, base_link: str | None) -> str:
    if base_link is not None:
        return _known_link(tree, base_link, "`base_link`")
    moved = {joint.child for joint in tree.joints}
    roots = [link for link in tree.links if link not in moved]
    if len(roots) == 1:
        return roots[0]
    message = "the joints form a loop: there is no link to start from" if moved else "the file has no links"
    if roots:
        message = f"{len(roots)} links could be the base: {_listing(roots)}"
    raise InputError(Problem(message, tree.file, fix="choose one with `base_link`" if roots else None))


def _choose_tip(tree: UrdfTree, base: str, tip_link: str | None, leaves: Mapping[str, Sequence[UrdfJoint]]) -> str:
    if tip_link is not None:
        return _known_link(tree, tip_link, "`tip_link`")
    if not leaves:
        raise InputError(Problem(f"no joint follows the link {base!r}", tree.file))
    ranks = {leaf: (sum(joint.moves for joint in path), len(path)) for leaf, path in leaves.items()}
    names = sorted(ranks, key=ranks.__getitem__, reverse=True)
    n_best = sum(rank == ranks[names[0]] for rank in ranks.values())
    if n_best == 1:
        return names[0]
    message = f"{n_best} chains are equally long; the tree ends at {_listing(names)}"
    raise InputError(Problem(message, tree.file, fix="choose one with `tip_link`"))


def _known_link(tree: UrdfTree, name: str, parameter: str) -> str:
    if name in tree.links:
        return name
    names = difflib.get_close_matches(name, tree.links, 3, 0.5) or list(tree.links)
    raise UsageError(f"{parameter}: {tree.file} has no link {name!r}; it has {_listing(names)}")


def _listing(names: Sequence[str]) -> str:
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


# Joints of the chain, and their sizes: a URDF is in m and rad.

_TYPES: dict[str, JointType] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": "fixed",
}
_LENGTH_FIX, _ANGLE_FIX = "a URDF's lengths are in m", "a URDF's angles are in rad"


def _read_joint(tree: UrdfTree, joint: UrdfJoint) -> Joint:
    element, kind = joint.element, _TYPES.get(joint.type)
    axis = unit_axis(numbers(element.find("axis"), "xyz", "1 0 0"))
    if kind is None:
        message = f"unknown joint type {joint.type!r}"
        if joint.type in ("floating", "planar"):
            message = f"a {joint.type} joint cannot be part of a serial chain"
        tree.report(element, joint.name, message, "choose a chain without it with `base_link` and `tip_link`")
    if axis is None and joint.type != "fixed":
        tree.report(element, joint.name, "the joint's axis is zero and has no direction")
    mass, com = _inertial(tree, joint.child)
    if mass is not None and mass < 0:
        tree.report(tree.links[joint.child], joint.child, f"the link's mass is negative ({mass:g} kg)")
    # Not through a rotation: near a pitch of 90 degrees the roll and yaw computed from it lose most of their digits.
    origin = [value for key in ("xyz", "rpy") for value in numbers(element.find("origin"), key)]
    return Joint(
        name=joint.name,
        type=kind or "fixed",
        parameters=dict(zip(ORIGIN_PARAMETERS, (*origin, 0.0), strict=True)),
        axis=axis if axis and joint.type != "fixed" else (0.0, 0.0, 1.0),
        limits=_read_limits(tree, joint) if joint.type in ("revolute", "prismatic") else None,
        is_continuous=joint.type == "continuous",
        mass=mass,
        com=None if mass is None else com,
        mimic=joint.mimic,
        link=joint.child,
    )


def _read_limits(tree: UrdfTree, joint: UrdfJoint) -> tuple[float, float] | None:
    limit = joint.element.find("limit")
    if limit is None or limit.attrib.keys().isdisjoint(("lower", "upper")):
        return None
    # Where one limit is missing, the format's default for it is zero.
    lower, upper = numbers(limit, "lower", "0") + numbers(limit, "upper", "0")
    if math.isinf(lower) and math.isinf(upper):
        return None
    limits, problem = finite_limits(joint.type, (lower, upper))
    if math.isinf(lower) or math.isinf(upper):
        tree.report(joint.element, joint.name, f"one limit is infinite, the other is not ({lower:g}, {upper:g})")
    elif lower > upper:
        tree.report(joint.element, joint.name, f"the lower limit {lower:g} is above the upper limit {upper:g}")
    elif problem is not None:
        tree.report(joint.element, joint.name, problem, "make them infinite for a joint without limits")
    return limits


def _inertial(tree: UrdfTree, link: str) -> tuple[float | None, Vector]:
    """Return mass, None where it has none, and centre of mass of a link, in its own frame."""
    mass = tree.links[link].find("inertial/mass")
    if mass is None:
        return None, ZERO
    return numbers(mass, "value", "0")[0], cast(Vector, tuple(numbers(tree.links[link].find("inertial/origin"), "xyz")))


def _check_sizes(tree: UrdfTree, joints: Sequence[Joint]) -> None:
    """Report lengths and angles that are too large for an arm."""
    elements = {joint.name: joint.element for joint in tree.joints}
    for joint in joints:
        far = max(map(abs, joint.com or ZERO))
        longest = max(map(abs, joint.limits)) if joint.limits and joint.type == "prismatic" else 0.0
        is_travel_in_mm = TRAVEL_IN_MM[0] < longest < TRAVEL_IN_MM[1]
        problems = [
            (abs(value) > MAX_LENGTH, f"{name} of {value:g} m is too long for an arm", _LENGTH_FIX)
            if name in LENGTH_PARAMETERS
            else (abs(value) > TURN, f"{name} of {value:g} rad is more than a turn", _ANGLE_FIX)
            for name, value in joint.parameters.items()
        ]
        problems += [
            (far > MAX_LENGTH, f"the centre of mass of its link is {far:g} m away, too far for an arm", _LENGTH_FIX),
            (is_travel_in_mm, f"a travel of {longest:g} m is too long for an arm", _LENGTH_FIX),
        ]
        for is_wrong, message, fix in problems:
            if is_wrong:
                tree.report(elements[joint.name], joint.name, message, fix)
    if limits_likely_degrees(joints):
        tree.report(None, "", "the limits of every joint are more than two turns", _ANGLE_FIX)


# Masses of links outside the chain: grippers, hoses' clamps, cameras, a second arm.

_LEAST_MOMENT = 0.05
"""kg m: a joint that moves mass by less, such as a gripper's finger, counts as fixed; a gear of 1e-5 rad/(N m) yields
by 5 um at 1 m to it."""
_MOVING = ("revolute", "continuous", "prismatic")


class _Carried(NamedTuple):
    """Link that another carries rigidly, or the joint of a link that moves against it."""

    frame: Poses
    """Frame of the link, or of the joint at zero, in the frame of the carrier."""
    mass: float
    com: Vector
    joint: UrdfJoint | None
    """Joint that moves the link; None for a link that is carried rigidly."""


def _with_branches(tree: UrdfTree, path: Sequence[UrdfJoint]) -> tuple[list[Joint], list[BranchJoint]]:
    """Return the joints of a chain, each link with the mass that it carries rigidly, and the joints of branches.

    A joint outside the chain that moves little mass stands at zero, as if it were fixed. Joints that follow others are
    not resolved yet. A chain without any mass stays without.
    """
    joints = [_read_joint(tree, joint) for joint in path]
    if not any(joint.mass for joint in joints):
        return joints, []
    on_chain = {joint.child for joint in path}
    branches = list(_branches(tree, list(_carried(tree, path[0].parent, on_chain)), None))
    for i, joint in enumerate(joints):
        carried = list(_carried(tree, path[i].child, on_chain))
        joints[i] = _loaded(joint, carried)
        branches += _branches(tree, carried, joint.name)
    return joints, branches


def _origin(joint: UrdfJoint) -> Poses:
    origin = joint.element.find("origin")
    return Poses.from_xyz_rpy(*(np.array(numbers(origin, key)) for key in ("xyz", "rpy")))


def _carried(tree: UrdfTree, link: str, on_chain: Iterable[str] = (), frame: Poses | None = None) -> Iterator[_Carried]:
    """Yield the links that ``link`` carries rigidly, and those that a joint moves against it."""
    for joint in tree.below[link]:
        if joint.child in on_chain:
            continue
        child = _origin(joint) if frame is None else frame @ _origin(joint)
        if joint.type in _MOVING and _movable_moment(tree, joint) > _LEAST_MOMENT:
            yield _Carried(child, 0.0, ZERO, joint)
        else:
            mass, com = _inertial(tree, joint.child)
            yield _Carried(child, mass or 0.0, com, None)
            yield from _carried(tree, joint.child, (), child)


def _movable_moment(tree: UrdfTree, joint: UrdfJoint) -> float:
    """Return the most by which a joint can move the first moment of the mass behind it, kg m."""
    behind = list(_behind(tree, joint.child, 0.0))
    if joint.type != "prismatic":
        return sum(mass * distance for mass, distance in behind)
    limit = joint.element.find("limit")
    travel = abs(numbers(limit, "upper", "0")[0] - numbers(limit, "lower", "0")[0])
    return travel * sum(mass for mass, _ in behind)


def _behind(tree: UrdfTree, link: str, distance: float) -> Iterator[tuple[float, float]]:
    """Yield mass, and greatest distance from a joint at ``distance`` from ``link``, of the links from it on."""
    mass, com = _inertial(tree, link)
    yield mass or 0.0, distance + math.hypot(*com)
    for joint in tree.below[link]:
        yield from _behind(tree, joint.child, distance + math.hypot(*numbers(joint.element.find("origin"), "xyz")))


def _loaded(joint: Joint, carried: Sequence[_Carried]) -> Joint:
    """Return the joint with the masses of its link and of the links on it as a single mass."""
    rigid = [link for link in carried if link.joint is None and link.mass > 0]
    if not rigid:
        return joint
    mass = joint.mass or 0.0
    total = mass + sum(link.mass for link in rigid)
    moments = (link.mass * (link.frame.rotation @ link.com + link.frame.translation) for link in rigid)
    moment: Array = sum(moments, mass * np.array(joint.com or ZERO))
    return replace(joint, mass=total, com=cast(Vector, tuple((moment / total).tolist())))


def _branches(tree: UrdfTree, carried: Sequence[_Carried], parent: str | None) -> Iterator[BranchJoint]:
    """Yield the moving joints among links that ``parent`` carries, and those behind them."""
    for link in carried:
        if link.joint is None:
            continue
        joint = replace(_read_joint(tree, link.joint), limits=None)
        own = _origin(link.joint)
        if not (link.frame.rotation == own.rotation).all() or not (link.frame.translation == own.translation).all():
            frame = Frame.of(link.frame)
            joint = replace(joint, parameters=dict(zip(ORIGIN_PARAMETERS, (*frame.xyz, *frame.rpy, 0.0), strict=True)))
        behind = list(_carried(tree, link.joint.child))
        yield BranchJoint(_loaded(joint, behind), parent)
        yield from _branches(tree, behind, joint.name)


# Mimic joints of the chain, and of its branches.


def _resolve_mimics(
    tree: UrdfTree, joints: Sequence[Joint], branches: Sequence[BranchJoint]
) -> tuple[list[Joint], list[BranchJoint]]:
    """Return the joints with every mimic made to follow, directly, a joint variable of the chain or of a branch.

    Of the joints of the chain that follow a joint outside of it, the first becomes the variable, and any other, in the
    chain or outside, follows it: ``q_b = m_b / m_a (q_a - o_a) + o_b``. A joint that follows one which stands at zero
    keeps a variable.
    """
    by_name = {joint.name: joint for joint in tree.joints}
    inside = {joint.name for joint in joints}
    chain = [_direct_mimic(tree, by_name, joint) for joint in joints]
    beside = [_direct_mimic(tree, by_name, branch.joint) for branch in branches]
    leaders: dict[str, Joint] = {}
    for joint in chain:
        if joint.mimic is not None and joint.mimic.master not in inside and joint.mimic.multiplier != 0.0:
            leaders.setdefault(joint.mimic.master, joint)

    def resolved(joint: Joint, known: Collection[str]) -> Joint:
        rule = joint.mimic or Mimic(joint.name)
        leader = leaders.get(rule.master) if rule.multiplier or joint.name not in inside else None
        if leader is None or leader.mimic is None:
            return joint if rule.master in known else replace(joint, mimic=None)
        if leader is joint:
            return replace(joint, mimic=None, outside=rule)
        ratio = rule.multiplier / leader.mimic.multiplier
        return replace(joint, mimic=Mimic(leader.name, ratio, rule.offset - ratio * leader.mimic.offset))

    known = inside | {joint.name for joint in beside}
    return (
        [resolved(joint, inside) for joint in chain],
        [replace(branch, joint=resolved(joint, known)) for branch, joint in zip(branches, beside, strict=True)],
    )


def _direct_mimic(tree: UrdfTree, by_name: Mapping[str, UrdfJoint], joint: Joint) -> Joint:
    """Return the joint with its mimic made to follow, directly, a joint that moves by itself, in the chain or not."""
    mimic, visited = joint.mimic, {joint.name}
    while mimic is not None:
        master = by_name.get(mimic.master)
        if master is None or master.type == "fixed" or master.name in visited:
            problem = "which follows it in turn: none of these joints moves by itself"
            if master is None or master.type == "fixed":
                problem = "which is not a joint of this file" if master is None else "which is fixed"
            tree.report(by_name[joint.name].element, joint.name, f"follows {mimic.master!r}, {problem}")
            break
        if master.mimic is None:
            return replace(joint, mimic=mimic)
        visited.add(master.name)
        # q = m1 (m2 q' + o2) + o1
        ratio, inner = mimic.multiplier, master.mimic
        mimic = Mimic(inner.master, ratio * inner.multiplier, ratio * inner.offset + mimic.offset)
    return joint


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
        joint_columns: Returns the names of a pose file's columns, which say where a chain without ``tip_link`` ends.

    A joint that follows a joint outside the chain becomes a joint variable, because nothing in the chain moves it.
    Masses of links outside the chain, such as a gripper's, count with the link of the chain that carries them; joints
    that move much of it, such as those of another arm, are branches.

    Raises:
        InputError: The URDF has a problem, its chain is not serial, or the choice of a chain is ambiguous.
        UsageError: ``base_link`` or ``tip_link`` is not a link of the URDF, or the tip is not behind the base.
    """
    tree = read_tree(text, file)
    base, tip = _choose_chain(tree, base_link, tip_link, joint_columns)
    path = tree.paths(base).get(tip)
    if not path:
        raise UsageError(f"{file}: link {tip!r} is not behind link {base!r}")
    if len(path) > MAX_JOINTS:
        message = f"there are {len(path)} joints from {base!r} to {tip!r}, expected at most {MAX_JOINTS}"
        raise InputError(Problem(message, file, fix="choose a shorter chain with `base_link` and `tip_link`"))
    joints, branches = _with_branches(tree, path)
    _check_sizes(tree, [*joints, *(branch.joint for branch in branches)])
    tree.finish()
    joints, branches = _resolve_mimics(tree, joints, branches)
    if not any(joint.is_variable for joint in joints):
        tree.report(None, "", f"no joint between {base!r} and {tip!r} moves", "choose a longer chain")
    tree.finish()
    return Robot(
        tree.root.get("name", "robot"), "urdf", tuple(joints), base_link=base, tip_link=tip, branches=tuple(branches)
    )
