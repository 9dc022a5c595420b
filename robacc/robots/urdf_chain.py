"""Read a URDF's XML safely, check its sizes, and choose one serial chain in its tree of links."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from xml.etree.ElementTree import Element, TreeBuilder, tostring
from xml.parsers import expat

from robacc.errors import InputError, Problem, UsageError
from robacc.robots.description import LENGTH_PARAMETERS, Joint
from robacc.robots.yaml_units import MAX_LENGTH, TRAVEL_IN_MM, TURN, limits_likely_degrees

# Read a URDF's XML safely: check its numbers and select the elements that a chain needs.

_ELEMENTS: Mapping[str, tuple[str, ...]] = {
    "": ("robot",),
    "robot": ("link", "joint"),
    "link": ("inertial",),
    "inertial": ("origin", "mass"),
    "joint": ("origin", "parent", "child", "axis", "limit", "mimic"),
    "leaf": (),
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


@dataclass(frozen=True, slots=True)
class UrdfDocument:
    """Part of a URDF that describes its links and joints."""

    file: str
    root: Element
    lines: Mapping[Element, int]
    """1-based line of each element's opening tag."""
    problems: list[Problem] = field(default_factory=list)

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

    def text(self) -> bytes:
        """Return the selected elements as XML, without a document type, entities or names of other files."""
        return bytes(tostring(self.root))


def read_document(text: str, file: str) -> UrdfDocument:
    """Return the selected part of a URDF with every number checked.

    A document type is an error before anything is expanded: a URDF has none, and entities can exhaust the memory or
    read other files.

    Raises:
        InputError: The text is not well-formed XML, is not a URDF, is xacro, or has wrong names or numbers.
    """
    reader = _UrdfReader(file)
    try:
        reader.parser.Parse(text, True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise InputError(Problem(f"not well-formed XML: {reason}", file, error.lineno)) from None
    except UnicodeEncodeError:
        raise InputError(Problem("not well-formed XML: it contains a lone surrogate", file)) from None
    document = UrdfDocument(file, reader.builder.close(), reader.lines)
    _check(document)
    document.finish()
    return document


class _UrdfReader:
    """Expat's handlers: selected elements go to a tree, with their lines."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.lines: dict[Element, int] = {}
        self.builder = TreeBuilder()
        self.parents = [""]
        self.skipped = 0
        self.parser = expat.ParserCreate()
        self.parser.StartDoctypeDeclHandler = self._doctype
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end

    def _refuse(self, message: str, fix: str | None = None) -> None:
        raise InputError(Problem(message, self.file, self.parser.CurrentLineNumber, fix=fix))

    def _refuse_xacro(self) -> None:
        self._refuse("this is xacro, not URDF", "run xacro first: xacro robot.xacro > robot.urdf")

    def _doctype(self, name: str, *_: object) -> None:
        self._refuse(f"a document type (<!DOCTYPE {name}>) is not allowed in a URDF", "remove it and its entities")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        if tag.startswith("xacro:"):
            self._refuse_xacro()
        parent = self.parents[-1]
        if not parent and tag != "robot":
            model = _OTHER_MODELS.get(tag, "not a URDF")
            self._refuse(f"the root element is <{tag}>, so this is {model}; a URDF's root is <robot>")
        if self.skipped or tag not in _ELEMENTS[parent]:
            self.skipped += 1
            return
        if any("${" in value or "$(" in value for value in attributes.values()):
            self._refuse_xacro()
        names = ("name",) if tag == "robot" else (*_NAMES.get(tag, ()), *_NUMBERS.get(tag, {}))
        known = {key: value for key, value in attributes.items() if key in names}
        element = self.builder.start(tag, known)
        self.lines[element] = self.parser.CurrentLineNumber
        self.parents.append(tag if tag in _ELEMENTS else "leaf")

    def _end(self, tag: str) -> None:
        if self.skipped:
            self.skipped -= 1
            return
        self.builder.end(tag)
        self.parents.pop()


def _check(document: UrdfDocument) -> None:
    robot_name = document.root.attrib.setdefault("name", "robot")
    if not robot_name.isprintable():
        document.report(document.root, "", f"<robot name>: expected a name, found {robot_name!r}")
    first_lines: dict[tuple[str, str], int] = {}
    for owner in document.root:
        name = owner.get("name", "")
        if name and (owner.tag, name) in first_lines:
            message = f"there is already a {owner.tag} {name!r} in line {first_lines[owner.tag, name]}"
            document.report(owner, name, message)
        first_lines.setdefault((owner.tag, name), document.lines[owner])
        for element in owner.iter():
            _check_element(document, owner, element)
        if owner.tag == "joint":
            for tag in ("parent", "child"):
                if owner.find(tag) is None:
                    document.report(owner, name, f"the joint has no <{tag}>")


def _check_element(document: UrdfDocument, owner: Element, element: Element) -> None:
    name = owner.get("name", "")
    for attribute in _NAMES.get(element.tag, ()):
        value = element.get(attribute, "")
        if not value.strip():
            document.report(element, name, f"<{element.tag}> needs the attribute {attribute!r}")
        elif not value.isprintable():
            document.report(element, name, f"<{element.tag} {attribute}>: expected a name, found {value!r}")
    for attribute, count in _NUMBERS.get(element.tag, {}).items():
        numbers = element.get(attribute)
        if numbers is None:
            continue
        try:
            # float() also accepts 1_000 and digits of other scripts, which no other reader of URDF does.
            plain = numbers.isascii() and "_" not in numbers
            values = [float(part) for part in numbers.split()] if plain else []
        except ValueError:
            values = []
        # An infinite limit means no limit.
        finite = all(math.isfinite(value) or (element.tag == "limit" and math.isinf(value)) for value in values)
        if len(values) != count or not finite:
            expected = "a number" if count == 1 else f"{count} numbers"
            document.report(element, name, f"<{element.tag} {attribute}>: expected {expected}, found {numbers[:60]!r}")


# Check a URDF, which is in m and rad, for sizes that only make sense in mm or degrees.

_LENGTH_FIX = "a URDF's lengths are in m"
_ANGLE_FIX = "a URDF's angles are in rad"


def check_sizes(document: UrdfDocument, elements: Mapping[str, Element], joints: Sequence[Joint]) -> None:
    """Report lengths and angles that are too large for an arm.

    Args:
        document: The URDF, which collects the problems.
        elements: Each joint's element, by its name.
        joints: Joints of the chain.
    """
    for joint in joints:
        element = elements[joint.name]
        for name, value in joint.parameters.items():
            if name in LENGTH_PARAMETERS and abs(value) > MAX_LENGTH:
                document.report(element, joint.name, f"{name} of {value:g} m is too long for an arm", _LENGTH_FIX)
            elif name not in LENGTH_PARAMETERS and abs(value) > TURN:
                document.report(element, joint.name, f"{name} of {value:g} rad is more than a turn", _ANGLE_FIX)
        if joint.com is not None and max(map(abs, joint.com)) > MAX_LENGTH:
            message = f"the centre of mass of its link is {max(map(abs, joint.com)):g} m away, too far for an arm"
            document.report(element, joint.name, message, _LENGTH_FIX)
        if joint.type == "prismatic" and joint.limits is not None:
            longest = max(map(abs, joint.limits))
            if TRAVEL_IN_MM[0] < longest < TRAVEL_IN_MM[1]:
                document.report(element, joint.name, f"a travel of {longest:g} m is too long for an arm", _LENGTH_FIX)
    if limits_likely_degrees(joints):
        document.report(None, "", "the limits of every joint are more than two turns", _ANGLE_FIX)


_NUMBERED = re.compile(r"(?i)[qja]_?([1-9]\d?)")
"""Column of a joint without a name: q1, J1, A1."""
_UNIT = re.compile(r"(_(m|mm|um|rad|deg|mrad)|\s*[\[(].*[\])])$")
"""Unit at the end of a column's name."""
_FLANGES = ("tool0", "flange")
"""Links that stand for the flange (ROS REP 199), the preferred first."""


@dataclass(frozen=True, slots=True)
class UrdfTree:
    """Links and joints of the file, as yourdfpy reads them."""

    document: UrdfDocument
    robot: Any
    """yourdfpy's Robot."""
    parent_joint: dict[str, Any]
    """Joint that moves each link."""
    elements: dict[str, Element]
    """Element of each joint, by name."""

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


def choose_chain(
    tree: UrdfTree, base_link: str | None, tip_link: str | None, joint_columns: Callable[[], Sequence[str]] | None
) -> tuple[str, str]:
    """Return the first and the last link of the chain.

    A chain's tip that the caller does not name follows from the columns of the pose file. Where they name joints, the
    chain ends behind the last of them. Where they number joints, ``q1 … qN``, the longest chain ends behind its
    N-th joint. Fixed joints behind it belong to the chain up to the flange, but a gripper does not.
    """
    columns = [_UNIT.sub("", name.strip()) for name in joint_columns()] if joint_columns and tip_link is None else []
    named = frozenset(joint.name for joint in tree.robot.joints if _moves(joint)) & frozenset(columns)
    base = _choose_base(tree, base_link)
    if named:
        last = _last_joint(tree, base, named)
        if last is not None:
            path = tree.path(base, last.child) or []
            first = next(joint for joint in path if joint.name in named)
            unnamed = any(_moves(joint) for joint in path[: path.index(first)])
            # Joints in front that the file does not have, such as wheels, only place the base.
            return first.parent if unnamed and base_link is None else base, _flange(tree, last.child)
    count = len({match[1] for name in columns if (match := _NUMBERED.fullmatch(name))})
    if count and not named and (tip := _tip_of_length(tree, base, count)) is not None:
        return base, tip
    return base, _choose_tip(tree, base, tip_link)


def _moves(joint: Any) -> bool:
    return joint.type != "fixed" and joint.mimic is None


def _last_joint(tree: UrdfTree, base: str, named: frozenset[str]) -> Any | None:
    """Return the joint of ``named`` with all others before it; None where they are on several branches."""
    joints = [joint for joint in tree.robot.joints if joint.name in named]
    last = (j for j in joints if named <= {before.name for before in tree.path(base, j.child) or ()})
    return next(last, None)


def _tip_of_length(tree: UrdfTree, base: str, count: int) -> str | None:
    """Return the flange of the chain of ``count`` moving joints; None unless the longest chains begin with only one."""
    paths = [tree.path(base, leaf) or [] for leaf in tree.leaves(base)]
    moving = [[joint for joint in path if _moves(joint)] for path in paths]
    longest = max(map(len, moving), default=0)
    if longest <= count:
        return None
    links = {joints[count - 1].child for joints in moving if len(joints) == longest}
    return _flange(tree, links.pop()) if len(links) == 1 else None


def _flange(tree: UrdfTree, link: str) -> str:
    """Return the link behind the fixed joints that follow ``link``, in front of a gripper and of a fork."""
    while True:
        joints = [joint for joint in tree.robot.joints if joint.parent == link]
        moving = {joint.parent for joint in tree.robot.joints if joint.type != "fixed"}
        fixed = [joint.child for joint in joints if joint.type == "fixed" and joint.child not in moving]
        named = [name for name in _FLANGES if name in fixed]
        if named:
            return named[0]
        if len(fixed) != 1 or len(joints) > 1:
            return link
        link = fixed[0]


def _choose_base(tree: UrdfTree, base_link: str | None) -> str:
    if base_link is not None:
        return _known_link(tree, base_link, "`base_link`")
    # The links that no joint moves.
    roots: list[str] = [link.name for link in tree.robot.links if link.name not in tree.parent_joint]
    if len(roots) == 1:
        return roots[0]
    if roots:
        message = f"{len(roots)} links could be the base: {_listing(roots)}"
        raise InputError(Problem(message, tree.document.file, fix="choose one with `base_link`"))
    loop = "the joints form a loop: there is no link to start from"
    raise InputError(Problem(loop if tree.parent_joint else "the file has no links", tree.document.file))


def _choose_tip(tree: UrdfTree, base: str, tip_link: str | None) -> str:
    if tip_link is not None:
        return _known_link(tree, tip_link, "`tip_link`")
    paths = {leaf: tree.path(base, leaf) or [] for leaf in tree.leaves(base)}
    if not paths:
        raise InputError(Problem(f"no joint follows the link {base!r}", tree.document.file))
    ranks = {leaf: (sum(map(_moves, path)), len(path)) for leaf, path in paths.items()}
    leaves = sorted(ranks, key=ranks.__getitem__, reverse=True)
    n_best = sum(rank == ranks[leaves[0]] for rank in ranks.values())
    if n_best == 1:
        return leaves[0]
    message = f"{n_best} chains are equally long; the tree ends at {_listing(leaves)}"
    raise InputError(Problem(message, tree.document.file, fix="choose one with `tip_link`"))


def _known_link(tree: UrdfTree, name: str, parameter: str) -> str:
    names = [link.name for link in tree.robot.links]
    if name in names:
        return name
    suggestions = difflib.get_close_matches(name, names, 3, 0.5) or names
    raise UsageError(f"{parameter}: {tree.document.file} has no link {name!r}; it has {_listing(suggestions)}")


def _listing(names: Sequence[str]) -> str:
    text = ", ".join(names[:12])
    return f"{text} and {len(names) - 12} more" if len(names) > 12 else text
