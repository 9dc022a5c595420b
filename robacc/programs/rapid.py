"""ABB RAPID: robtargets and jointtargets of a module, with the tool and the work object of their motions."""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from robacc.geometry import Poses, quaternion_from_rotation
from robacc.programs.program import (
    NUMBER,
    Convention,
    Dialect,
    Draft,
    MotionType,
    Program,
    ProgramFrame,
    ProgramNumber,
    ProgramSource,
    frame_of,
    mask,
)
from robacc.robots.description import Frame

# Declarations, aggregates and instructions of ABB RAPID that matter for targets.
#
# Source: ABB, Technical reference manual: RAPID Instructions, Functions and Data types (3HAC050917), and RAPID
# Overview (3HAC050947).

MM = 1e-3
DEGREE = math.pi / 180
HIDDEN = re.compile(r'"(?:[^"\r\n]|"")*"|![^\r\n]*')
"""Strings and comments."""
_ANY = re.IGNORECASE
DECLARATION = re.compile(
    r"\b(CONST|PERS|VAR)\s+(robtarget|jointtarget|tooldata|wobjdata)\s+(\w+)\s*(\{[^}]*\})?\s*(?::=\s*([^;]*))?;", _ANY
)
ASSIGNMENT = re.compile(r"(?<![\\\w.])([A-Za-z_]\w*)\s*(?:\{[^}]*\})?(?:\s*\.\s*\w+)*\s*:=", _ANY)
ROUTINE = re.compile(r"^[ \t]*(?:LOCAL[ \t]+)?(PROC|FUNC|TRAP|ENDPROC|ENDFUNC|ENDTRAP|MODULE|ENDMODULE)\b", _ANY | re.M)
INSTRUCTION = re.compile(
    r"\b(MoveAbsJ|(?:Move|Trigg|Arc|Spot|Disp|Cap|Search|Paint)(?:[LJC])\w*)[ \t]*(?=[\s\\\[])([^;]*);", _ANY
)
DISPLACEMENT = re.compile(r"\b(PDispOn|PDispSet|EOffsOn|EOffsSet|CorrCon|SoftAct)\b[^;]*;", _ANY)
_TOKEN = re.compile(r"[\[\],]|[^\[\],]+")
_BRACKET_OR_COMMA = re.compile(r"[\[\](){},]")
_BRACKET_OR_SWITCH = re.compile(r"[\[\](){}\\]")
_NUMBER = re.compile(rf"\s*({NUMBER})\s*\Z")


@dataclass(frozen=True, slots=True)
class RapidValue:
    """Value of an aggregate: a leaf, or the parts of ``[…]``."""

    start: int
    end: int
    parts: tuple[RapidValue, ...] | None = None

    def numbers(self, text: str, units: Sequence[float]) -> tuple[ProgramNumber, ...] | None:
        """Return the numbers of an aggregate of ``len(units)`` numbers, or None."""
        if self.parts is None or len(self.parts) != len(units):
            return None
        result = []
        for part, unit in zip(self.parts, units, strict=True):
            match = None if part.parts is not None else _NUMBER.match(text, part.start, part.end)
            if match is None:
                return None
            result.append(ProgramNumber(match.start(1), match.end(1), float(match[1]), unit))
        return tuple(result)


def parse_value(text: str, start: int, end: int) -> RapidValue | None:
    """Return the aggregate ``[…]`` in a part of the text; None for anything else, or for brackets that do not match."""
    stack: list[tuple[int, list[RapidValue]]] = []
    leaf: tuple[int, int] | None = None
    result: RapidValue | None = None
    for match in _TOKEN.finditer(text, start, end):
        token = match[0]
        if result is not None:
            return None if token.strip() else result
        if token == "[":
            if leaf is not None and text[slice(*leaf)].strip():
                return None
            stack.append((match.start(), []))
            leaf = None
        elif not stack:
            if token.strip():
                return None
        elif token in ",]":
            if leaf is not None:
                stack[-1][1].append(RapidValue(*leaf))
            leaf = None
            if token == "]":
                opened, parts = stack.pop()
                value = RapidValue(opened, match.end(), tuple(parts))
                if stack:
                    stack[-1][1].append(value)
                else:
                    result = value
        elif token.strip():
            leaf = (match.start(), match.end())
        elif leaf is None and text[match.start() - 1] in "[," and text[match.end() : match.end() + 1] in (",", "]"):
            leaf = (match.start(), match.end())  # a string, which the mask hides
    return result


def split_parts(text: str, start: int, end: int) -> list[tuple[int, int]]:
    """Return the places between commas outside of brackets."""
    parts = []
    depth = 0
    first = start
    for match in _BRACKET_OR_COMMA.finditer(text, start, end):
        character = match[0]
        if character in "[({":
            depth += 1
        elif character in "])}":
            depth -= 1
        elif depth == 0:
            parts.append((first, match.start()))
            first = match.end()
    parts.append((first, end))
    return parts


def without_switches(text: str, start: int, end: int) -> tuple[int, int]:
    r"""Return the place of an argument without its ``\Switch`` parts and the blanks around it."""
    depth = 0
    for match in _BRACKET_OR_SWITCH.finditer(text, start, end):
        if match[0] in "[({":
            depth += 1
        elif match[0] in "])}":
            depth -= 1
        elif depth == 0:
            end = match.start()
            break
    part = text[start:end]
    return end - len(part.lstrip()), start + len(part.rstrip())


_GLOBAL = -1
_ORIGIN = Frame()
_NAME = re.compile(r"([A-Za-z_]\w*)\s*(?:\{\s*([^}]*?)\s*\})?\Z")
_POSE_UNITS = (MM, MM, MM)
_TURN_UNITS = (1.0, 1.0, 1.0, 1.0)
_AXIS_UNITS = (DEGREE,) * 6
_RUN_TIME = "the target is computed at run time"
_ELSEWHERE = "the target's numbers are in none of the files read"
_CHANGED = "the program assigns it at run time in line {}"
_KINDS: dict[str, MotionType] = {"l": "linear", "j": "joint", "c": "circular"}


@dataclass(slots=True)
class _Module:
    """Masked text of a file, its routines and what it assigns."""

    source: ProgramSource
    masked: str
    starts: list[int] = field(default_factory=list)
    """Places where routines begin."""
    changes: dict[tuple[int, str], int] = field(default_factory=dict)
    """First assignment outside of declarations, by routine and name."""

    def routine(self, position: int) -> int:
        """Return the number of the routine around a place, or :data:`_GLOBAL` for the module's own data."""
        k = bisect_right(self.starts, position) - 1
        return k if k >= 0 and k % 2 == 0 else _GLOBAL


@dataclass(slots=True)
class _Scope:
    """Data by routine and name, names in small letters."""

    targets: dict[tuple[int, str], list[int | None]] = field(default_factory=dict)
    """Indices of a target, or of the elements of an array; None for an element that is no target."""
    frames: dict[str, ProgramFrame] = field(default_factory=dict)

    def find(self, routine: int, name: str) -> list[int | None] | None:
        """Return the target of a name as seen from a routine."""
        local = self.targets.get((routine, name))
        return self.targets.get((_GLOBAL, name)) if local is None else local


def parse_rapid(source: ProgramSource, others: Sequence[ProgramSource] = ()) -> Program:
    """Return the program of a RAPID module.

    Args:
        source: Module whose targets are wanted.
        others: Modules that declare its tools and work objects.

    Raises:
        InputError: The text is no RAPID module, or is truncated.
    """
    module = _module(source)
    draft = Draft(source, Dialect.rapid)
    scope = _Scope({}, {"tool0": ProgramFrame("tool0", _ORIGIN), "wobj0": ProgramFrame("wobj0", _ORIGIN)})
    for other in [*(_module(other) for other in others), module]:
        _declare(other, scope, draft, is_program=other is module)
    dropped: dict[int, str] = {}
    for key, indices in scope.targets.items():
        position = _change_of(module, key)
        for index in indices if position is not None else ():
            if index is not None:
                dropped[index] = _CHANGED.format(source.line(position or 0))
    for match in INSTRUCTION.finditer(module.masked):
        _add_motion(module, match, scope, draft)
    for match in DISPLACEMENT.finditer(module.masked):
        reason = f"{match[1]} moves targets at run time; the corrections are those of the undisplaced targets"
        draft.note(match.start(), match.end(), reason)
    return draft.program(dropped)


def _module(source: ProgramSource) -> _Module:
    """Return a module with its routines.

    Raises:
        InputError: The module or a routine lacks its end.
    """
    module = _Module(source, mask(source.text, HIDDEN))
    opened: list[tuple[str, int]] = []
    count = 0
    for match in ROUTINE.finditer(module.masked):
        word = match[1].upper()
        if not word.startswith("END"):
            opened.append((word, match.start(1)))
            count += 1
        elif opened and opened[-1][0] == word[3:]:
            opened.pop()
        else:
            raise source.error(f"{word} ends no {word[3:]}", match.start(1), "copy it from the controller again")
        if word not in ("MODULE", "ENDMODULE"):
            module.starts.append(match.start())
    if not count:
        raise source.error("has no MODULE and no PROC, so it is not a RAPID module")
    if opened:
        word, position = opened[-1]
        fix = "copy it from the controller again"
        raise source.error(f"is truncated: this {word} has no END{word}", position, fix)
    inside = [(match.start(), match.end()) for match in DECLARATION.finditer(module.masked)]
    firsts = [start for start, _ in inside]
    for match in ASSIGNMENT.finditer(module.masked):
        k = bisect_right(firsts, match.start()) - 1
        if k < 0 or match.start() >= inside[k][1]:
            module.changes.setdefault((module.routine(match.start()), match[1].lower()), match.start())
    for match in INSTRUCTION.finditer(module.masked):
        if match[1].lower().startswith("search"):
            name = _search_point(module, match)
            module.changes.setdefault((module.routine(match.start()), name), match.start())
    return module


def _change_of(module: _Module, key: tuple[int, str]) -> int | None:
    """Return the place where a variable is assigned at run time, or None."""
    routine, name = key
    if routine != _GLOBAL:
        return module.changes.get(key)
    places = [place for (_, changed), place in module.changes.items() if changed == name]
    return min(places, default=None)


def _declare(module: _Module, scope: _Scope, draft: Draft, is_program: bool) -> None:
    """Add the data that a module declares; targets only of the program itself."""
    for match in DECLARATION.finditer(module.masked):
        kind, name = match[2].lower(), match[3]
        if match[5] is None:
            continue
        value = parse_value(module.masked, match.start(5), match.end(5))
        if kind in ("tooldata", "wobjdata"):
            is_changed = any(changed == name.lower() for _, changed in module.changes)
            frame = None if value is None or is_changed else _frame(module.masked, value, kind)
            scope.frames[name.lower()] = ProgramFrame(name, frame)
            if frame is not None:
                (draft.tools if kind == "tooldata" else draft.bases)[name] = frame
        elif is_program:
            key = (module.routine(match.start()), name.lower())
            elements = [value] if match[4] is None or value is None else list(value.parts or ())
            scope.targets[key] = [
                _add_target(draft, module, f"{name}{{{i + 1}}}" if match[4] else name, kind, element)
                for i, element in enumerate(elements)
            ]
            for element, index in zip(elements, scope.targets[key], strict=True):
                if index is None:
                    start, end = (match.start(5), match.end(5)) if element is None else (element.start, element.end)
                    draft.note(start, end, f"{name} lacks some of the numbers of a {kind}")


def _add_target(draft: Draft, module: _Module, name: str, kind: str, value: RapidValue | None) -> int | None:
    """Add a robtarget or jointtarget; return its index, or None where its numbers are not all there."""
    if value is None or not value.parts:
        return None
    text = module.source.text
    if kind == "jointtarget":
        numbers = value.parts[0].numbers(module.masked, _AXIS_UNITS) if len(value.parts) == 2 else None
        if numbers is None:
            return None
        return draft.add(name, Convention.joints, numbers, external=_text(text, value.parts[1]))
    if len(value.parts) != 4:
        return None
    place = value.parts[0].numbers(module.masked, _POSE_UNITS)
    turn = value.parts[1].numbers(module.masked, _TURN_UNITS)
    if place is None or turn is None or abs(sum(number.value**2 for number in turn) - 1) > 0.02:
        return None
    configuration = _text(text, value.parts[2])
    return draft.add(
        name,
        Convention.quaternion,
        place + turn,
        configuration=configuration,
        external=_text(text, value.parts[3]),
    )


def _text(text: str, value: RapidValue) -> str:
    return " ".join(text[value.start : value.end].split())


def _frame(masked: str, value: RapidValue, kind: str) -> Frame | None:
    """Return the tool in the flange's frame or the work object in the world; None where it moves or is held."""
    parts = value.parts or ()
    flags = [masked[part.start : part.end].strip().upper() for part in parts]
    if kind == "tooldata":
        return _pose(masked, parts[1]) if len(parts) == 3 and flags[0] == "TRUE" else None
    if len(parts) != 5 or flags[0] != "FALSE" or flags[1] != "TRUE":
        return None
    user, item = _pose(masked, parts[3]), _pose(masked, parts[4])
    if user is None or item is None:
        return None
    poses = [Poses.from_xyz_rpy(np.array(frame.xyz), np.array(frame.rpy)) for frame in (user, item)]
    combined = poses[0] @ poses[1]
    return frame_of(Convention.quaternion, [*combined.translation, *quaternion_from_rotation(combined.rotation)])


def _pose(masked: str, value: RapidValue) -> Frame | None:
    parts = value.parts or ()
    if len(parts) != 2:
        return None
    place, turn = parts[0].numbers(masked, _POSE_UNITS), parts[1].numbers(masked, _TURN_UNITS)
    if place is None or turn is None or abs(sum(number.value**2 for number in turn) - 1) > 0.02:
        return None
    return frame_of(Convention.quaternion, [number.value * number.unit for number in (*place, *turn)])


def _arguments(module: _Module, match: re.Match[str]) -> list[tuple[int, int]]:
    r"""Return the places of an instruction's arguments, without those that begin with ``\``."""
    places = split_parts(module.masked, match.start(2), match.end(2))
    trimmed = [without_switches(module.masked, *place) for place in places]
    return [(start, end) for start, end in trimmed if end > start]


def _search_point(module: _Module, match: re.Match[str]) -> str:
    """Return the variable that a search instruction stores its point in."""
    arguments = _arguments(module, match)
    return module.masked[slice(*arguments[1])].strip().lower() if len(arguments) > 1 else ""


def _add_motion(module: _Module, match: re.Match[str], scope: _Scope, draft: Draft) -> None:
    """Add the motions of an instruction, or notes on targets that are computed."""
    word = match[1].lower()
    is_joint_target = word == "moveabsj"
    letter = "j" if is_joint_target else re.sub(r"^(move|trigg|arc|spot|disp|cap|search|paint)", "", word)[:1]
    motion = _KINDS[letter]
    arguments = _arguments(module, match)
    tool, base = _frames(module, match, arguments, scope)
    first = 2 if word.startswith("search") else 0
    for start, end in arguments[first : first + (2 if motion == "circular" else 1)]:
        text = module.masked[start:end]
        name = _NAME.match(text)
        if name is not None:
            indices = scope.find(module.routine(match.start()), name[1].lower())
            if indices is None:
                draft.note(match.start(), match.end(), _ELSEWHERE)
                continue
            if name[2] and name[2].isdecimal():
                indices = indices[int(name[2]) - 1 : int(name[2])]
            for index in indices:
                draft.move(start, index, motion, tool, base)
            continue
        kind = "jointtarget" if is_joint_target else "robtarget"
        target = _add_target(draft, module, "", kind, parse_value(module.masked, start, end))
        if target is None:
            draft.note(match.start(), match.end(), _RUN_TIME)
        draft.move(start, target, motion, tool, base)


def _frames(
    module: _Module, match: re.Match[str], arguments: Sequence[tuple[int, int]], scope: _Scope
) -> tuple[ProgramFrame | None, ProgramFrame | None]:
    r"""Return the tool, which is the last argument, and the work object of ``\WObj``."""
    work = re.search(r"\\WObj\s*:=\s*([^\\,;]+)", match[2], re.IGNORECASE)
    names = (
        module.masked[slice(*arguments[-1])].strip() if len(arguments) > 1 else "",
        work[1].strip() if work else "wobj0",
    )
    tool, base = (scope.frames.get(name.lower(), ProgramFrame(name, None)) for name in names)
    return tool, base
