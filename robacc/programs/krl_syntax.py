"""Statements of KUKA KRL that matter for targets: declarations, assignments, motions, blocks.

Source: KUKA System Software 8, Operating and Programming Instructions for System Integrators, chapter "Programming for
user group Expert (KRL syntax)".
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

from robacc.programs.program import ProgramNumber
from robacc.programs.source import NUMBER, ProgramSource, mask

MM = 1e-3
DEGREE = math.pi / 180
HIDDEN = re.compile(r'"[^"\r\n]*"|;[^\r\n]*')
"""Strings and comments."""
FRAME_KEYS = ("X", "Y", "Z", "A", "B", "C")
AXIS_KEYS = ("A1", "A2", "A3", "A4", "A5", "A6")
NAME = r"[A-Za-z_$][\w$]*(?:\[\s*\d+\s*\])?"

_ENTRY = re.compile(rf"\s*([A-Za-z]\w*(?:\[\s*\])?)\s+({NUMBER})\s*\Z")
_AGGREGATE = re.compile(r"\{\s*(?:(\w+)\s*:)?([^{}\r\n]*)\}")


@dataclass(frozen=True, slots=True)
class Aggregate:
    """Aggregate ``{X 1.0,Y 2.0,…}`` of numbers."""

    start: int
    end: int
    numbers: dict[str, tuple[int, int, float]]
    """Place and value by key, in capitals."""
    is_literal: bool
    """False where an entry is no number, as in ``{X nHeight}``."""
    text: str

    def frame(self) -> tuple[ProgramNumber, ...] | None:
        """Return X, Y, Z, A, B, C; None where one is missing."""
        return self._numbers(FRAME_KEYS, (MM, MM, MM, DEGREE, DEGREE, DEGREE))

    def axes(self) -> tuple[ProgramNumber, ...] | None:
        """Return A1 … A6, or as many as there are from A1 on; None without A1 or with a gap."""
        keys = [key for key in AXIS_KEYS if key in self.numbers]
        if not keys or keys != list(AXIS_KEYS[: len(keys)]):
            return None
        return self._numbers(keys, [DEGREE] * len(keys))

    def entries(self, keys: tuple[str, ...]) -> str:
        """Return the entries of ``keys`` as they are written."""
        parts = [f"{key} {self.text[start:end]}" for key, (start, end, _) in self.numbers.items() if key in keys]
        return ",".join(parts)

    def _numbers(
        self, keys: tuple[str, ...] | list[str], units: tuple[float, ...] | list[float]
    ) -> tuple[ProgramNumber, ...] | None:
        if not self.is_literal or any(key not in self.numbers for key in keys):
            return None
        places = [self.numbers[key] for key in keys]
        return tuple(ProgramNumber(*place, unit) for place, unit in zip(places, units, strict=True))


def aggregate_at(text: str, masked: str, position: int, end: int) -> Aggregate | None:
    """Return the aggregate that begins at ``position`` (blanks before it are skipped), or None."""
    start = position
    while start < end and masked[start] in " \t":
        start += 1
    match = _AGGREGATE.match(masked, start, end)
    if match is None:
        return None
    numbers: dict[str, tuple[int, int, float]] = {}
    is_literal = True
    offset = match.start(2)
    for part in match[2].split(","):
        entry = _ENTRY.match(part)
        if entry is not None:
            key = entry[1].upper()
            is_literal = is_literal and key not in numbers
            numbers[key] = (offset + entry.start(2), offset + entry.end(2), float(entry[2]))
        else:
            is_literal = is_literal and "#" in part
        offset += len(part) + 1
    return Aggregate(match.start(), match.end(), numbers, is_literal, text)


@dataclass(frozen=True, slots=True)
class KrlLine:
    """Line of a program without comments and strings."""

    start: int
    end: int
    text: str


def lines(source: ProgramSource) -> tuple[str, Iterator[KrlLine]]:
    """Return the masked text and its lines that are not empty."""
    masked = mask(source.text, HIDDEN)

    def each() -> Iterator[KrlLine]:
        for match in re.finditer(r"[^\r\n]+", masked):
            if not match[0].isspace():
                yield KrlLine(match.start(), match.end(), match[0])

    return masked, each()


def split_arguments(text: str, offset: int) -> list[tuple[int, int]]:
    """Return the places of the parts between commas outside of brackets."""
    parts = []
    depth = 0
    start = 0
    for k, character in enumerate(text):
        if character in "{[(":
            depth += 1
        elif character in "}])":
            depth -= 1
        elif character == "," and depth == 0:
            parts.append((offset + start, offset + k))
            start = k + 1
    parts.append((offset + start, offset + len(text)))
    return parts
