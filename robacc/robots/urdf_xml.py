"""Read a URDF's XML safely: check its numbers and select the elements that a chain needs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element, TreeBuilder, tostring
from xml.parsers import expat

from robacc.errors import InputError, Problem

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
    reader.read(text)
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

    def read(self, text: str) -> None:
        try:
            self.parser.Parse(text, True)
        except expat.ExpatError as error:
            reason = expat.ErrorString(error.code)
            raise InputError(Problem(f"not well-formed XML: {reason}", self.file, error.lineno)) from None
        except UnicodeEncodeError:
            raise InputError(Problem("not well-formed XML: it contains a lone surrogate", self.file)) from None

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
