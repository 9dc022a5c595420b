"""Staubli VAL3 data files (``.dtx``) and the motions of ``.pgx`` programs to their points.

Sources of the layout and of R = Rx(rx) Ry(ry) Rz(rz): two public generators of VAL3 programs (RoboDK's post-processor,
visose/Robots) and a public worked example of nested frames, which agree.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.geometry import Poses, rotation_from_rpy, rpy_from_rotation
from robacc.programs.program import (
    NUMBER,
    Convention,
    Dialect,
    Draft,
    MotionType,
    Program,
    ProgramFrame,
    ProgramMove,
    ProgramNote,
    ProgramNumber,
    ProgramSource,
    frame_of,
    mask,
)
from robacc.robots.description import Frame

# Frames and tools of a VAL3 data file, each in its father, composed up to the world or the flange.

_ROOTS = {"frame": "world[0]", "tool": "flange[0]"}


@dataclass(frozen=True, slots=True)
class Entry:
    """Frame or tool in its father."""

    native: tuple[float, ...]
    """x, y, z, rx, ry, rz in m and rad; NaN where it is no number."""
    father: str
    """Name of the father, lower case; empty where it is not given."""


@dataclass(frozen=True, slots=True)
class FrameTree:
    """Frames and tools by name, lower case."""

    entries: Mapping[str, Mapping[str, Entry]]
    """``frame`` and ``tool`` to entries by name."""
    changed: Collection[str]
    """Names of the data that programs change, lower case."""

    def base(self, name: str) -> Frame | None:
        """Return a frame in the world; None where it is not known before run time."""
        return self._resolved("frame", name, 0)

    def tool(self, name: str) -> Frame | None:
        """Return a tool in the flange's frame; None where it is not known before run time."""
        return self._resolved("tool", name if "[" in name else f"{name}[0]", 0)

    def _resolved(self, kind: str, name: str, depth: int) -> Frame | None:
        if name == _ROOTS[kind]:
            return Frame()
        entry = self.entries[kind].get(name)
        # A frame that is its own father, over some others, has no place.
        if entry is None or depth > len(self.entries[kind]) or name.partition("[")[0] in self.changed:
            return None
        father = self._resolved(kind, entry.father, depth + 1)
        if father is None or any(math.isnan(number) for number in entry.native):
            return None
        return _composed(father, frame_of(Convention.moving_xyz, entry.native))


def _composed(father: Frame, child: Frame) -> Frame:
    pose = _pose(father) @ _pose(child)
    roll, pitch, yaw = (float(angle) for angle in rpy_from_rotation(pose.rotation)[:, 0])
    x, y, z = (float(value) for value in pose.translation[:, 0])
    return Frame((x, y, z), (roll, pitch, yaw))


def _pose(frame: Frame) -> Poses:
    return Poses(rotation_from_rpy(np.array(frame.rpy)[:, None]), np.array(frame.xyz)[:, None])


# Motions of VAL3 programs (``.pgx``) to points, with their tools, and the variables that the programs change.

_HIDDEN = re.compile(r'//[^\r\n]*|"[^"\r\n]*"|<!--.*?-->', re.S)
_SECTION = re.compile(r"<!\[CDATA\[(.*?)\]\]>", re.S)
_SIGNIFICANT = re.compile(r"[^\r\n]")
_MOTION = re.compile(r"\bmov(e[jlc])\s*\(")
_KINDS: dict[str, MotionType] = {"ej": "joint", "el": "linear", "ec": "circular"}
_ELEMENT = re.compile(r"(?:\w+\s*:\s*)?(\w+)\s*(?:\[\s*(.*?)\s*\])?\Z", re.S)
_ASSIGNED = re.compile(r"\b(\w+)\s*(?:\[[^\]\r\n]*\])?(?:\s*\.\s*\w+)*\s*=(?!=)")
_LINKED = re.compile(r"\b(?:link|setFrame)\s*\(([^)]*)\)")


@dataclass(frozen=True, slots=True)
class Val3Motion:
    """Motion instruction to one target."""

    file: str
    line: int
    text: str
    motion: MotionType
    element: str | None
    """``ppick[0]``, or ``ppick`` for an element that is chosen at run time; None for a target that is computed."""
    tool: str
    """Tool as written; empty where it is computed."""

    def move(self, target: int, tool: ProgramFrame | None) -> ProgramMove:
        """Return the motion to a target of the data file."""
        return ProgramMove(self.line, target, self.motion, tool)

    def note(self, reason: str) -> ProgramNote:
        """Return a note on the motion."""
        return ProgramNote(self.line, f"{self.file}: {self.text}", reason)


@dataclass(frozen=True, slots=True)
class Val3Code:
    """What the programs of an application do with its data."""

    motions: tuple[Val3Motion, ...]
    changed: Mapping[str, str]
    """Name of each variable that a program assigns to, lower case, and the place of the first assignment."""


def read_code(programs: Sequence[ProgramSource]) -> Val3Code:
    """Return the motions of programs, in their order, and the variables that they change."""
    motions: list[Val3Motion] = []
    changed: dict[str, str] = {}
    for program in programs:
        text = mask(_code(program.text), _HIDDEN)
        name = re.split(r"[\\/]", program.file)[-1]
        for match in _ASSIGNED.finditer(text):
            changed.setdefault(match[1].lower(), f"line {program.line(match.start())} of {name}")
        for match in _LINKED.finditer(text):
            for word in re.findall(r"\w+", match[1]):
                changed.setdefault(word.lower(), f"line {program.line(match.start())} of {name}")
        for match in _MOTION.finditer(text):
            motions += _motions(program, name, text, match)
    return Val3Code(tuple(motions), changed)


def _code(text: str) -> str:
    """Return the text with spaces in place of all that is XML; as it is where no section of code is marked."""
    sections = list(_SECTION.finditer(text))
    if not sections:
        return text
    pieces, position = [], 0
    for section in sections:
        pieces += [_SIGNIFICANT.sub(" ", text[position : section.start(1)]), section[1]]
        position = section.end(1)
    return "".join((*pieces, _SIGNIFICANT.sub(" ", text[position:])))


def _motions(program: ProgramSource, name: str, text: str, match: re.Match[str]) -> Iterator[Val3Motion]:
    arguments, end = _arguments(text, match.end())
    n_targets = 2 if match[1] == "ec" else 1
    tool = arguments[n_targets] if len(arguments) > n_targets else ""
    element = _ELEMENT.match(tool)
    tool = "" if element is None else f"{element[1]}[{element[2] or '0'}]"
    for argument in arguments[:n_targets]:
        element = _ELEMENT.match(argument)
        place = None
        if element is not None:
            index = element[2] or "0"
            place = f"{element[1]}[{index}]".lower() if index.isdecimal() else element[1].lower()
        line = program.line(match.start())
        yield Val3Motion(name, line, program.excerpt(match.start(), end), _KINDS[match[1]], place, tool)


def _arguments(text: str, start: int) -> tuple[list[str], int]:
    """Return the arguments of a call whose parenthesis opens before ``start``, and the place after it."""
    depth, pieces, position = 1, [], start
    for k in range(start, len(text)):
        character = text[k]
        if character in "([{":
            depth += 1
        elif character in ")]}":
            depth -= 1
        if depth == 0 or (depth == 1 and character == ","):
            pieces.append(text[position:k].strip())
            position = k + 1
        if depth == 0:
            return pieces, k + 1
    return pieces, len(text)


_SIGN = re.compile(r"<Database\b[^>]*/VAL3/Data/")
_COMMENT = re.compile(r"<!--.*?-->", re.S)
_DATA = re.compile(r"<Data\b([^>]*?)(?:/>|>(.*?)</Data\s*>)", re.S)
_VALUE = re.compile(r"<Value\b([^>]*?)/?>", re.S)
_ATTRIBUTE = re.compile(r"""([\w:.-]+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_INCH = re.compile(r"""\bmillimeterUnit\s*=\s*["']false["']""")
_POSE = ("x", "y", "z", "rx", "ry", "rz")
_JOINTS = tuple(f"j{i}" for i in range(1, 7))
_CONFIGURATION = ("shoulder", "elbow", "wrist")
_DEGREE = math.pi / 180
_FIX = "export the application from the controller or Stäubli Robotics Suite again"


@dataclass(frozen=True, slots=True)
class _Value:
    """Element ``Value`` of an array of data."""

    name: str
    """``pPick[0]``"""
    attributes: dict[str, re.Match[str]]
    start: int
    end: int

    def text(self, key: str) -> str | None:
        """Return the text of an attribute."""
        match = self.attributes.get(key)
        return None if match is None else match[2] if match[2] is not None else match[3]

    def number(self, key: str, unit: float) -> ProgramNumber | None:
        """Return an attribute as a number; None where it is missing or no number."""
        text = self.text(key)
        if text is None or not re.fullmatch(NUMBER, text):
            return None
        match = self.attributes[key]
        group = 2 if match[2] is not None else 3
        return ProgramNumber(match.start(group), match.end(group), float(text), unit)


def parse_val3(source: ProgramSource, others: Sequence[ProgramSource] = ()) -> Program:
    """Return the targets of a data file.

    Args:
        source: Data file, ``.dtx``.
        others: Programs (``.pgx``) of the application, and projects (``.pjx``), which state the unit of length.

    Raises:
        InputError: The text is no data file, is truncated, or belongs to a project in inches.
    """
    text = mask(source.text, _COMMENT)
    if _SIGN.search(text) is None:
        raise source.error("is not a VAL3 data file: it has no Database of VAL3/Data", fix=_FIX)
    if "</Database" not in text:
        raise source.error("is truncated: it has no </Database>", len(text), _FIX)
    if any(_INCH.search(other.text) for other in others if other.file.lower().endswith(".pjx")):
        raise source.error("belongs to a project in inches (millimeterUnit is false)", fix="set it to millimetres")
    values = _values(text)
    code = read_code([other for other in others if other.file.lower().endswith(".pgx")])
    tree = FrameTree({kind: _entries(values.get(kind, [])) for kind in ("frame", "tool")}, code.changed)
    draft = Draft(source, Dialect.val3)
    dropped: dict[int, str] = {}
    index: dict[str, int] = {}
    for kind in ("pointRx", "jointRx"):
        for value in values.get(kind, []):
            number = _add(draft, kind, value, tree)
            if number is None:
                continue
            index[value.name] = number
            if (place := code.changed.get(value.name.partition("[")[0].lower())) is not None:
                dropped[number] = f"{place} changes it at run time"
    _add_motions(draft, code, index, tree)
    return draft.program(dropped)


def _values(text: str) -> dict[str, list[_Value]]:
    """Return the values of every array by type; their attributes lie at their places in the text."""
    result: dict[str, list[_Value]] = {}
    for data in _DATA.finditer(text):
        head = {match[1]: match[2] or match[3] or "" for match in _ATTRIBUTE.finditer(data[1])}
        if data[2] is None or "name" not in head:
            continue
        for value in _VALUE.finditer(text, data.start(2), data.end(2)):
            attributes = {match[1]: match for match in _ATTRIBUTE.finditer(text, value.start(1), value.end(1))}
            key = attributes["key"][2] or attributes["key"][3] if "key" in attributes else "0"
            entry = _Value(f"{head['name']}[{key}]", attributes, value.start(), value.end())
            result.setdefault(head.get("type", ""), []).append(entry)
    return result


def _entries(values: Sequence[_Value]) -> dict[str, Entry]:
    """Return frames or tools by name, as numbers in m and rad; a missing number is zero."""
    result = {}
    for value in values:
        numbers = []
        for key in _POSE:
            unit = 1e-3 if len(key) == 1 else _DEGREE
            number = value.number(key, unit)
            numbers.append(0.0 if value.text(key) is None else math.nan if number is None else number.value * unit)
        result[value.name.lower()] = Entry(tuple(numbers), (value.text("fatherId") or "").lower())
    return result


def _add(draft: Draft, kind: str, value: _Value, tree: FrameTree) -> int | None:
    """Add a point or joints; return its index, or None where its numbers are not all written."""
    is_joint = kind == "jointRx"
    keys = _JOINTS if is_joint else _POSE
    numbers = [value.number(key, 1e-3 if len(key) == 1 else _DEGREE) for key in keys]
    known = [number for number in numbers if number is not None]
    if len(known) < len(keys):
        draft.note(value.start, value.end, f"{value.name} lacks some of its numbers, so it is set at run time, or zero")
        return None
    if is_joint:
        return draft.add(value.name, Convention.joints, known)
    father = value.text("fatherId")
    base = None if father is None else ProgramFrame(father, tree.base(father.lower()))
    words = [text for key in _CONFIGURATION if (text := value.text(key)) is not None]
    return draft.add(value.name, Convention.moving_xyz, known, configuration=" ".join(words), base=base)


def _add_motions(draft: Draft, code: Val3Code, index: dict[str, int], tree: FrameTree) -> None:
    """Add the motions of the programs to targets of this file, and notes on those whose target is computed."""
    numbers = {name.lower(): number for name, number in index.items()}
    arrays: dict[str, list[int]] = {}
    for name, number in numbers.items():
        arrays.setdefault(name.partition("[")[0], []).append(number)
    for motion in code.motions:
        frame = ProgramFrame(motion.tool, tree.tool(motion.tool.lower())) if motion.tool else None
        if motion.element is None:
            draft.notes.append(motion.note("the target is computed at run time"))
            continue
        chosen = [numbers[motion.element]] if motion.element in numbers else arrays.get(motion.element, [])
        for number in chosen:
            draft.moves.append(motion.move(number, frame if draft.targets[number].kind == "cartesian" else None))
