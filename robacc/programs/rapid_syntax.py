"""Declarations, aggregates and instructions of ABB RAPID that matter for targets.

Source: ABB, Technical reference manual: RAPID Instructions, Functions and Data types (3HAC050917), and RAPID Overview
(3HAC050947).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from robacc.programs.program import ProgramNumber
from robacc.programs.source import NUMBER

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
