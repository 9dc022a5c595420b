"""Tool or base frame in force at each place of a program, where the text alone decides it."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from robacc.programs.program import ProgramFrame

EventKind = Literal["start", "routine", "open", "loop", "next", "close", "set"]


@dataclass(frozen=True, slots=True)
class FrameEvent:
    """Statement that matters for the frame in force: start of a routine, a block's ends, or an assignment.

    ``start`` begins a routine that ends where the next one starts; ``routine`` one that is closed, and may be nested.
    """

    position: int
    kind: EventKind
    frame: ProgramFrame | None = None
    """Frame of an assignment; None where the program computes it."""


@dataclass(slots=True)
class FrameTimeline:
    """Frames in force by place; None where branches or loops leave it open."""

    positions: list[int]
    frames: list[ProgramFrame | None]

    def at(self, position: int) -> ProgramFrame | None:
        """Return the frame in force at a place of the text."""
        k = bisect_right(self.positions, position) - 1
        return self.frames[k] if k >= 0 else None


def timeline(events: Sequence[FrameEvent]) -> FrameTimeline:
    """Return the frames in force after each event, in the order of the text.

    A frame that is set inside a branch is unknown after the branch. One that is set inside a loop is unknown from the
    loop's head to the assignment, since the second turn begins with it, and after the loop.
    """
    setting = _blocks_that_set(events)
    result = FrameTimeline([], [])
    current: ProgramFrame | None = None
    before: list[ProgramFrame | None] = []
    opened: list[int] = []
    for k, event in enumerate(events):
        if event.kind == "start":
            current, before, opened = None, [], []
        elif event.kind == "set":
            current = event.frame
        elif event.kind == "routine":
            opened.append(k)
            before.append(current)
            current = None
        elif event.kind in ("open", "loop"):
            opened.append(k)
            current = None if event.kind == "loop" and setting.get(k) else current
            before.append(current)
        elif opened and event.kind == "next":
            current = before[-1]
        elif opened and event.kind == "close":
            outer = before.pop()
            block = opened.pop()
            if events[block].kind == "routine":
                current = outer  # a definition runs nothing
            elif setting.get(block):
                current = None
        result.positions.append(event.position)
        result.frames.append(current)
    return result


def _blocks_that_set(events: Sequence[FrameEvent]) -> dict[int, bool]:
    """Return, for each block by the index of its opening event, whether a frame is set inside."""
    result: dict[int, bool] = {}
    stack: list[int] = []
    for k, event in enumerate(events):
        if event.kind == "start":
            stack = []
        elif event.kind in ("routine", "open", "loop"):
            stack.append(k)
            result[k] = False
        elif event.kind == "set":
            for block in reversed(stack):
                result[block] = True
                if events[block].kind == "routine":
                    break
        elif event.kind == "close" and stack:
            stack.pop()
    return result
