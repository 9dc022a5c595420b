"""Universal Robots URScript: joint lists and poses that motions go to, with the TCP of ``set_tcp``.

Source: Universal Robots, The URScript Programming Language (SW 3.x, 5.x), modules motion and internals.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from robacc.programs.frames import FrameEvent, FrameTimeline, timeline
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

_HIDDEN = re.compile(r"\"[^\"\r\n]*\"|'[^'\r\n]*'|#[^\r\n]*")
_LITERAL = re.compile(rf"(p?)\s*\[\s*{NUMBER}(?:\s*,\s*{NUMBER}){{5}}\s*\]\Z")
_ASSIGNMENT = re.compile(
    r"^[ \t]*(?:(?:global|local)[ \t]+)?([A-Za-z_]\w*)[ \t]*(\[[^\]\r\n]*\])?[ \t]*=(?!=)[ \t]*", re.M
)
_MOTION = re.compile(r"\b(movej|movel|movep|movec|servoj|servoc)\s*\(")
_TCP = re.compile(r"\bset_tcp\s*\(")
_INVERSE = re.compile(r"get_inverse_kin\s*\(")
_BLOCK = re.compile(r"^[ \t]*(def|thread|sec|if|while|elif|else|end)\b(?:[ \t]+(\w+))?", re.M)
_CALL = re.compile(r"^[ \t]*([A-Za-z_]\w*)[ \t]*\(", re.M)
_KEYWORD = re.compile(r"\s*(?:q|pose|pose_via|pose_to|x|b)\s*=(?!=)")
_NAME = re.compile(r"[A-Za-z_]\w*\Z")
_KINDS: dict[str, MotionType] = {
    "movej": "joint",
    "movel": "linear",
    "movep": "linear",
    "movec": "circular",
    "servoj": "joint",
    "servoc": "circular",
}
_BASE = ProgramFrame("base", Frame())
_RUN_TIME = "the target is computed at run time"


@dataclass(slots=True)
class _Script:
    """Masked text, its variables, and the targets found in it."""

    source: ProgramSource
    masked: str
    literals: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Places of variables that are assigned once, and numbers only."""
    changed: dict[str, int] = field(default_factory=dict)
    """Places where other variables are assigned."""
    targets: dict[int, int] = field(default_factory=dict)
    """Index of each target by the place of its literal."""


def parse_urscript(source: ProgramSource) -> Program:
    """Return the program of a URScript file.

    Raises:
        InputError: The text is truncated.
    """
    script = _Script(source, mask(source.text, _HIDDEN))
    _check_complete(script)
    draft = Draft(source, Dialect.urscript)
    _read_assignments(script)
    tools = _tools(script)
    for match in _MOTION.finditer(script.masked):
        if not _is_definition(script, match.start()):
            _add_motion(script, match, draft, tools)
    used = {place for place, _ in script.literals.values() if place in script.targets}
    as_frames = {place for place, _ in _tcp_literals(script)}
    for place, end in script.literals.values():
        if place not in used and place not in as_frames and script.masked[place] == "p":
            draft.note(place, end, "is a pose that no motion goes to directly")
    return draft.program()


def _check_complete(script: _Script) -> None:
    """Raise InputError where a block or a bracket is not closed."""
    fix = "save the script again"
    opened: list[tuple[str, int]] = []
    for match in _BLOCK.finditer(script.masked):
        if match[1] == "end":
            if opened:
                opened.pop()
        elif match[1] not in ("elif", "else") and not re.search(r"\bend[ \t]*$", _line(script.masked, match.end())):
            opened.append((match[1], match.start(1)))
    if opened:
        word, position = opened[0]
        raise script.source.error(f"is truncated: this {word} has no end", position, fix)
    stack: list[int] = []
    for match in re.finditer(r"[\[\]()]", script.masked):
        if match[0] in "[(":
            stack.append(match.start())
        elif stack:
            stack.pop()
    if stack:
        raise script.source.error("is truncated: this bracket is not closed", stack[-1], fix)


def _line(text: str, position: int) -> str:
    end = re.compile(r"[\r\n]|\Z").search(text, position)
    return text[position : end.start() if end else len(text)]


def _read_assignments(script: _Script) -> None:
    """Sort variables into those that are numbers only and those that the program computes."""
    for match in _ASSIGNMENT.finditer(script.masked):
        name = match[1]
        place = None if match[2] else _literal_at(script.masked, match.end())
        if place is None or name in script.literals or name in script.changed:
            script.changed.setdefault(name, match.start(1))
        else:
            script.literals[name] = place
    for name in script.changed:
        script.literals.pop(name, None)


def _literal_at(masked: str, start: int) -> tuple[int, int] | None:
    """Return the place of a list or pose of six numbers that fills the rest of a statement."""
    while start < len(masked) and masked[start] in " \t":
        start += 1
    opened = masked.find("[", start, start + 2 + 8)
    end = masked.find("]", start) + 1
    if opened < 0 or end <= 0 or _LITERAL.match(masked, start, end) is None:
        return None
    return None if _line(masked, end).strip(" \t;") else (start, end)


def _arguments(masked: str, start: int) -> list[tuple[int, int]]:
    """Return the places of the arguments of a call whose bracket is before ``start``."""
    parts = []
    depth = 0
    first = start
    for match in re.compile(r"[\[\](),]").finditer(masked, start):
        character = match[0]
        if character in "[(":
            depth += 1
        elif character in "])":
            if depth == 0:
                parts.append((first, match.start()))
                return parts
            depth -= 1
        elif depth == 0:
            parts.append((first, match.start()))
            first = match.end()
    return parts


def _trimmed(masked: str, place: tuple[int, int]) -> tuple[int, int]:
    """Return the place of an argument without its keyword and the blanks around it."""
    start, end = place
    keyword = _KEYWORD.match(masked, start, end)
    start = keyword.end() if keyword else start
    while start < end and masked[start].isspace():
        start += 1
    while end > start and masked[end - 1].isspace():
        end -= 1
    return start, end


def _is_definition(script: _Script, position: int) -> bool:
    start = max(script.masked.rfind("\n", 0, position), script.masked.rfind("\r", 0, position)) + 1
    return script.masked[start:position].strip() in ("def", "thread")


def _add_motion(script: _Script, match: re.Match[str], draft: Draft, tools: FrameTimeline) -> None:
    """Add the motions of a call, or notes on targets that are computed."""
    motion = _KINDS[match[1]]
    arguments = _arguments(script.masked, match.end())
    end = arguments[-1][1] + 1 if arguments else match.end()
    for argument in arguments[: 2 if match[1] in ("movec", "servoc") and len(arguments) > 1 else 1]:
        place = _trimmed(script.masked, argument)
        inverse = _INVERSE.match(script.masked, *place)
        if inverse is not None:
            inner = _arguments(script.masked, inverse.end())
            if not inner or inner[-1][1] + 1 != place[1]:
                draft.note(match.start(), end, _RUN_TIME)
                continue
            place = _trimmed(script.masked, inner[0])
        text = script.masked[slice(*place)]
        name = ""
        if _NAME.match(text):
            name = text
            if name in script.changed:
                line = script.source.line(script.changed[name])
                draft.note(match.start(), end, f"the program assigns {name} at run time in line {line}")
                continue
            place = script.literals.get(name, (0, 0))
        literal = _LITERAL.match(script.masked, *place) if place[1] else None
        if literal is None or (inverse is not None and not literal[1]):
            draft.note(match.start(), end, _RUN_TIME)
            continue
        index = _add_target(script, name, place, draft)
        draft.move(match.start(), index, motion, tools.at(match.start()), _BASE)


def _add_target(script: _Script, name: str, place: tuple[int, int], draft: Draft) -> int | None:
    """Add the target of a literal, or return the index that it has."""
    if place[0] not in script.targets:
        convention = Convention.rotation_vector if script.masked[place[0]] == "p" else Convention.joints
        index = draft.add(name, convention, _numbers(script.masked, place))
        if index is None:
            return None
        script.targets[place[0]] = index
    return script.targets[place[0]]


def _numbers(masked: str, place: tuple[int, int]) -> tuple[ProgramNumber, ...]:
    matches: Iterator[re.Match[str]] = re.compile(NUMBER).finditer(masked, *place)
    return tuple(ProgramNumber(match.start(), match.end(), float(match[0]), 1.0) for match in matches)


def _tcp_literals(script: _Script) -> list[tuple[int, int]]:
    """Return the places of the poses that set_tcp takes, in the order of the calls; (0, 0) for a computed one."""
    result = []
    for match in _TCP.finditer(script.masked):
        arguments = _arguments(script.masked, match.end())
        place = _trimmed(script.masked, arguments[0]) if arguments else (0, 0)
        text = script.masked[slice(*place)]
        if _NAME.match(text):
            place = script.literals.get(text, (0, 0))
        literal = _LITERAL.match(script.masked, *place) if place[1] else None
        result.append(place if literal is not None and literal[1] else (0, 0))
    return result


def _tools(script: _Script) -> FrameTimeline:
    """Return the TCP in force at each place; unknown before set_tcp, since the installation sets it."""
    events: list[FrameEvent] = []
    setters: set[str] = set()
    blocks = list(_BLOCK.finditer(script.masked))
    for match, place in zip(_TCP.finditer(script.masked), _tcp_literals(script), strict=True):
        native = [number.value for number in _numbers(script.masked, place)] if place[1] else None
        frame = None if native is None else ProgramFrame("", frame_of(Convention.rotation_vector, native))
        events.append(FrameEvent(match.start(), "set", frame))
    for match in blocks:
        if match[1] in ("def", "thread", "sec"):
            events.append(FrameEvent(match.start(), "routine"))
        elif match[1] in ("if", "while"):
            events.append(FrameEvent(match.start(), "loop" if match[1] == "while" else "open"))
        else:
            events.append(FrameEvent(match.start(), "close" if match[1] == "end" else "next"))
    starts = [(match.start(), match[2] or "") for match in blocks if match[1] in ("def", "thread", "sec")]
    for match in _TCP.finditer(script.masked):
        routine = next((name for start, name in reversed(starts) if start < match.start()), "")
        setters.add(routine)
    for match in _CALL.finditer(script.masked):
        if match[1] in setters:
            events.append(FrameEvent(match.start(), "set", None))
    return timeline(sorted(events, key=lambda event: event.position))
