"""Links and joints of a URDF: its XML read safely, each number checked, each problem with its line."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from robacc.errors import InputError, Problem
from robacc.robots.description import Mimic

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
            ratio, offset = numbers(rule, "multiplier", "1") + numbers(rule, "offset", "0")
            mimic = Mimic(str(rule.get("joint")), ratio, offset)
        return cls(element, str(element.get("name")), kind, parent, child, mimic)


@dataclass(frozen=True)
class UrdfTree:
    """Tree of links and joints, and the problems found in it so far."""

    file: str
    name: str
    links: Mapping[str, Element]
    """Element of each link, by name."""
    joints: tuple[UrdfJoint, ...]
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
    root = reader.builder.close()
    links = {element.get("name", ""): element for element in root.iter("link")}
    unread = UrdfTree(file, root.get("name", "robot"), links, (), reader.lines)
    _check(unread, root)
    unread.finish()
    tree = UrdfTree(file, unread.name, links, tuple(map(UrdfJoint.of, root.iter("joint"))), reader.lines)
    movers: dict[str, str] = {}
    for joint in tree.joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
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


def _check(tree: UrdfTree, root: Element) -> None:
    """Report wrong names and numbers, and names that stand twice."""
    if not tree.name.isprintable():
        tree.report(root, "", f"<robot name>: expected a name, found {tree.name!r}")
    first_lines: dict[tuple[str, str], int] = {}
    for owner in root:
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
