"""Motions of VAL3 programs (``.pgx``) to points, with their tools, and the variables that the programs change."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from robacc.programs.program import MotionType, ProgramFrame, ProgramMove, ProgramNote
from robacc.programs.source import ProgramSource, mask

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
