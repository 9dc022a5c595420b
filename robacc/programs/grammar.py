"""Grammar that all dialects share: places of arguments and numbers in the text, and the frames in force.

The reader of a dialect is a table of patterns for its statements, and functions that say what a statement means. It
works on the text with blanks in place of comments and strings (:func:`mask`), so that a place in one is a place in the
other.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from robacc.programs.program import NUMBER, ProgramFrame, ProgramNumber

MM = 1e-3
DEGREE = math.pi / 180
POSE_UNITS = (MM, MM, MM, DEGREE, DEGREE, DEGREE)
"""Units of x, y, z and three angles, in the dialects that write mm and degrees."""
AXIS_UNITS = (DEGREE,) * 6
RUN_TIME = "the target is computed at run time"
ELSEWHERE = "the target's numbers are in none of the files read"
CHANGED = "the program assigns it at run time in line {}"

Place = tuple[int, int]
"""First character of a part of the text, and the one behind its last."""

_PUNCTUATION = re.compile(r"[\[\](){},\\]")
_NUMBER = re.compile(NUMBER)


def mask(text: str, hidden: re.Pattern[str]) -> str:
    """Return the text with spaces in place of every match of ``hidden`` (comments and strings), line ends kept."""
    return hidden.sub(lambda match: re.sub(r"[^\r\n]", " ", match[0]), text)


def stripped(text: str, place: Place) -> Place:
    """Return a place without the blanks at its ends."""
    part = text[slice(*place)]
    return place[1] - len(part.lstrip()), place[0] + len(part.rstrip())


def arguments(text: str, start: int, end: int | None = None) -> tuple[list[Place], int]:
    """Return the places between commas outside of brackets, and where they end.

    They end at ``end``, or before at a bracket that closes none of theirs. A switch of RAPID is a part of its own, with
    its backslash.
    """
    end = len(text) if end is None else end
    places, first, depth = [], start, 0
    for match in _PUNCTUATION.finditer(text, start, end):
        if match[0] in "[({":
            depth += 1
        elif match[0] in ",\\":
            if depth == 0:
                places.append((first, match.start()))
                first = match.start() + (match[0] == ",")
        elif depth:
            depth -= 1
        else:
            end = match.start()
            break
    return [stripped(text, place) for place in (*places, (first, end))], end


def items(text: str, place: Place) -> list[Place]:
    """Return the places of the parts of an aggregate ``[…]`` or ``{…}``; none for anything else."""
    start, end = stripped(text, place)
    parts, closed = arguments(text, start + 1, end)
    return parts if text[start:end][:1] in ("[", "{") and closed == end - 1 else []


def numbers(text: str, places: Sequence[Place], units: Sequence[float]) -> tuple[ProgramNumber, ...] | None:
    """Return the numbers at places, one for each unit; None where a part is no number, or one lacks or is too many."""
    if len(places) != len(units) or not all(_NUMBER.fullmatch(text, *place) for place in places):
        return None
    return tuple(
        ProgramNumber(*place, float(text[slice(*place)]), unit) for place, unit in zip(places, units, strict=True)
    )


def unclosed(blocks: Iterable[tuple[str, int, bool]]) -> list[tuple[str, int]]:
    """Return the word and place of each block that has no end; blocks are word, place and whether it opens one."""
    opened: list[tuple[str, int]] = []
    for word, position, opens in blocks:
        if opens:
            opened.append((word, position))
        elif opened:
            opened.pop()
    return opened


# Tool or base frame in force at each place of a program, where the text alone decides it.

EventKind = Literal["routine", "open", "loop", "next", "close", "set", "may set", "call"]


@dataclass(frozen=True, slots=True)
class FrameEvent:
    """Statement that matters for the frame in force: start of a routine, a block's ends, a call, or an assignment."""

    position: int
    kind: EventKind
    frame: ProgramFrame | None = None
    """Frame of an assignment; None where the program computes it."""
    name: str = ""
    """Name of a routine that starts or is called."""


def timeline(events: Sequence[FrameEvent]) -> Callable[[int], ProgramFrame | None]:
    """Return a function of a place that returns the frame in force there; None where the text leaves it open.

    A frame that is set inside a branch is unknown after the branch. One that is set inside a loop is unknown from the
    loop's head to the assignment, since the second turn begins with it, and after the loop. A routine that sets one,
    itself or by a call, leaves it unknown after its call.
    """
    setting: set[int | str] = set()
    before = -1
    while before < len(setting):
        before = len(setting)
        frames = _frames(events, setting)

    def at(position: int) -> ProgramFrame | None:
        k = bisect_right(events, position, key=lambda event: event.position) - 1
        return frames[k] if k >= 0 else None

    return at


def _frames(events: Sequence[FrameEvent], setting: set[int | str]) -> list[ProgramFrame | None]:
    """Return the frames after each event, and add the blocks (by place) and routines (by name) that set one."""
    result: list[ProgramFrame | None] = []
    current: ProgramFrame | None = None
    opened: list[tuple[FrameEvent, ProgramFrame | None]] = []
    for event in events:
        if event.kind in ("set", "may set") or (event.kind == "call" and event.name in setting):
            if event.kind != "may set":
                current = event.frame
            around = [block for block, _ in opened]
            routine = max((i for i, block in enumerate(around) if block.kind == "routine"), default=-1)
            setting |= {around[routine].name if routine >= 0 else "", *(b.position for b in around[routine + 1 :])}
        elif event.kind == "routine":
            opened.append((event, current))
            current = None
        elif event.kind in ("open", "loop"):
            current = None if event.kind == "loop" and event.position in setting else current
            opened.append((event, current))
        elif opened and event.kind == "next":
            current = opened[-1][1]
        elif opened and event.kind == "close":
            block, outer = opened.pop()
            if block.kind == "routine":
                current = outer  # a definition runs nothing
            elif block.position in setting:
                current = None
        result.append(current)
    return result
