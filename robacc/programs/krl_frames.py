"""$TOOL and $BASE of KRL motions, where the text of the files decides them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from robacc.programs.assemble import Draft, frame_of
from robacc.programs.conventions import Convention
from robacc.programs.frame_state import FrameEvent
from robacc.programs.krl_reading import KrlReading, key_of
from robacc.programs.krl_syntax import aggregate_at
from robacc.programs.program import ProgramFrame
from robacc.robots.description import Frame

_ANY = re.IGNORECASE
FRAME_DATA = re.compile(r"(TOOL|BASE)_DATA\[\s*(\d+)\s*\]\Z", _ANY)
_WITH_TOOL = re.compile(r"\$TOOL\s*=\s*([^,]+)", _ANY)
_WITH_BASE = re.compile(r"\$BASE\s*=\s*((?:[^,(]|\([^)]*\))+)", _ANY)
_SPLINE_DATA = re.compile(r"S(?:TOOL2?|BASE)\s*\(\s*(\w+)(?:\s*\.\s*\w+)?\s*\)", _ANY)
_EVENTS = {"LOOP": "loop", "FOR": "loop", "WHILE": "loop", "REPEAT": "loop", "IF": "open", "SWITCH": "open"}
_ORIGIN = Frame()


@dataclass(slots=True)
class KrlFrames:
    """Tools and bases of the files, by number and by variable."""

    tools: dict[str, Frame]
    bases: dict[str, Frame]
    variables: dict[str, Frame]
    data_frames: dict[str, tuple[str, str]]
    """Numbers of tool and base of each FDAT."""
    fixed_tool: set[str]
    """FDAT whose tool stands in the cell."""

    def resolve(self, text: str) -> ProgramFrame | None:
        """Return the frame of the right-hand side of an assignment; None where it is computed."""
        key = key_of(text)
        if key in ("$NULLFRAME", "$WORLD"):
            return ProgramFrame(key, _ORIGIN)
        if (match := FRAME_DATA.match(key)) is not None:
            return self.numbered(match[2], match[1])
        if key in self.variables:
            return ProgramFrame(key, self.variables[key])
        return None

    def numbered(self, number: str, kind: str) -> ProgramFrame:
        """Return the tool or base of a number."""
        if number == "0":
            return ProgramFrame("0", _ORIGIN)
        table = self.tools if kind.upper() == "TOOL" else self.bases
        return ProgramFrame(number, table.get(number))


def collect_frames(readings: Sequence[KrlReading], draft: Draft) -> KrlFrames:
    """Return the frames that the files define with numbers, and put them into the draft."""
    frames = KrlFrames(draft.tools, draft.bases, {}, {}, set())
    for reading in readings:
        frames.data_frames.update(reading.data_frames)
        frames.fixed_tool.update(reading.fixed_tool)
        for name, literals in reading.literals.items():
            if len(literals) != 1 or name in reading.changes:
                continue
            numbers = literals[0][1].frame()
            if numbers is None:
                continue
            frame = frame_of(Convention.zyx, [number.value * number.unit for number in numbers])
            if (match := FRAME_DATA.match(name)) is not None:
                (draft.tools if match[1].upper() == "TOOL" else draft.bases)[match[2]] = frame
            elif literals[0][0] in ("FRAME", "") and "S" not in literals[0][1].numbers:
                frames.variables[name] = frame
    return frames


def spline_frames(text: str, frames: KrlFrames) -> tuple[ProgramFrame | None, ProgramFrame | None]:
    """Return tool and base that a spline motion sets with ``WITH $TOOL = STOOL2(FP1), $BASE = SBASE(FP1.BASE_NO)``."""
    result: list[ProgramFrame | None] = []
    for pattern, kind, place in ((_WITH_TOOL, "TOOL", 0), (_WITH_BASE, "BASE", 1)):
        match = pattern.search(text)
        data = None if match is None else _SPLINE_DATA.match(match[1].strip())
        if match is None:
            result.append(None)
        elif data is not None and data[1].upper() in frames.data_frames:
            name = data[1].upper()
            unknown = name in frames.fixed_tool
            number = frames.data_frames[name][place]
            result.append(ProgramFrame(number, None) if unknown else frames.numbered(number, kind))
        else:
            result.append(frames.resolve(match[1]) or ProgramFrame(match[1].strip(), None))
    return result[0], result[1]


def frame_events(reading: KrlReading, frames: KrlFrames, kind: str) -> list[FrameEvent]:
    """Return the statements of a file that decide $TOOL or $BASE."""
    setters = _routines_that_set(reading, f"${kind}")
    events: list[FrameEvent] = []
    for place, name, text in reading.statements:
        if name == "routine":
            events.append(FrameEvent(place, "start"))
        elif name in _EVENTS:
            events.append(FrameEvent(place, "loop" if _EVENTS[name] == "loop" else "open"))
        elif name in ("ELSE", "CASE", "DEFAULT"):
            events.append(FrameEvent(place, "next"))
        elif name.startswith("END") or name == "UNTIL":
            events.append(FrameEvent(place, "close"))
        elif name == f"${kind}":
            events.append(FrameEvent(place, "set", _assigned(reading, place, text, frames)))
        elif name == "FDAT":
            numbers = frames.data_frames.get(text)
            if numbers is None or text in frames.fixed_tool:
                events.append(FrameEvent(place, "set", None))
            else:
                events.append(FrameEvent(place, "set", frames.numbered(numbers[0 if kind == "TOOL" else 1], kind)))
        elif name == f"BAS {kind}":
            number = text if text.isdecimal() else None
            events.append(FrameEvent(place, "set", None if number is None else frames.numbered(number, kind)))
        elif name in ("BAS INITMOV", "BAS FRAMES") or (name == "call" and text in setters):
            events.append(FrameEvent(place, "set", None))
    return events


def _assigned(reading: KrlReading, place: int, text: str, frames: KrlFrames) -> ProgramFrame | None:
    aggregate = aggregate_at(reading.source.text, reading.masked, place, place + len(text))
    if aggregate is None or reading.masked[aggregate.end : place + len(text)].strip():
        return frames.resolve(text)
    numbers = aggregate.frame()
    if numbers is None:
        return None
    return ProgramFrame("", frame_of(Convention.zyx, [number.value * number.unit for number in numbers]))


def _routines_that_set(reading: KrlReading, name: str) -> set[str]:
    """Return the routines of a file that assign $TOOL or $BASE, directly or through one another."""
    bodies: dict[str, set[str]] = {}
    direct: set[str] = set()
    routine = ""
    for _, kind, text in reading.statements:
        if kind == "routine":
            routine = text
        elif kind == "call":
            bodies.setdefault(routine, set()).add(text)
        elif kind in (name, "FDAT") or kind.startswith("BAS"):
            direct.add(routine)
    while True:
        more = {routine for routine, calls in bodies.items() if calls & direct} - direct
        if not more:
            return direct
        direct |= more
