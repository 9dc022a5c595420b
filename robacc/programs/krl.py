"""KUKA KRL: targets of ``.src`` and ``.dat`` files, with $TOOL and $BASE where the text alone decides them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import PurePath

from robacc.programs.frames import FrameEvent, timeline
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

# Statements of KUKA KRL that matter for targets: declarations, assignments, motions, blocks.
#
# Source: KUKA System Software 8, Operating and Programming Instructions for System Integrators, chapter "Programming
# for user group Expert (KRL syntax)".

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


# Findings in one KRL file: declarations, assignments, motions and the statements that decide $TOOL and $BASE.

_ANY = re.IGNORECASE
_DECLARATION = re.compile(
    rf"\s*(?:(?:GLOBAL|DECL|CONST)\s+)*(E6POS|POS|E6AXIS|AXIS|FRAME|FDAT)\s+({NAME})\s*(=?)\s*(.*)", _ANY
)
_ASSIGNMENT = re.compile(rf"\s*({NAME})(\s*\.\s*\w+)?\s*=(?!=)\s*", _ANY)
_INDEXED = re.compile(r"\s*([A-Za-z_]\w*)\s*\[[^\]=]*\][^=]*=(?!=)", _ANY)
_MOTION = re.compile(r"\s*(S?(?:PTP|LIN|CIRC)|SPL|ASYPTP)(_REL)?(?![\w.\[])\s*(?!=)", _ANY)
_ROUTINE = re.compile(r"\s*(?:GLOBAL\s+)?(DEFDAT|DEFFCT|DEF)\s+(?:\w+(?:\[\s*\])?\s+)?(\$?\w+)", _ANY)
_ROUTINE_END = re.compile(r"\s*END(?:DAT|FCT)?\s*\Z", _ANY)
_BLOCK = re.compile(
    r"\s*(IF|SWITCH|FOR|WHILE|LOOP|REPEAT|ELSE|CASE|DEFAULT|ENDIF|ENDSWITCH|ENDFOR|ENDWHILE|ENDLOOP|UNTIL)\b", _ANY
)
_CALL = re.compile(r"\s*(\w+)\s*\(", _ANY)
_BAS = re.compile(r"\s*BAS\s*\(\s*#(\w+)\s*(?:,\s*(\w+))?", _ANY)


@dataclass(slots=True)
class KrlReading:
    """Findings in one file."""

    source: ProgramSource
    masked: str = ""
    literals: dict[str, list[tuple[str, Aggregate]]] = field(default_factory=dict)
    """Declarations and assignments with an aggregate, by name in capitals: type (empty for an assignment)."""
    changes: dict[str, list[int]] = field(default_factory=dict)
    """Places of assignments that are no aggregate of numbers, by name."""
    declared: dict[str, str] = field(default_factory=dict)
    motions: list[tuple[KrlLine, re.Match[str]]] = field(default_factory=list)
    statements: list[tuple[int, str, str]] = field(default_factory=list)
    """Place, kind and text of statements that matter for $TOOL and $BASE."""
    spelling: dict[str, str] = field(default_factory=dict)
    """Names as written, by names in capitals."""
    data_frames: dict[str, tuple[str, str]] = field(default_factory=dict)
    """Numbers of tool and base of each FDAT."""
    fixed_tool: set[str] = field(default_factory=set)
    """FDAT whose tool stands in the cell (IPO_FRAME #TCP)."""


def read_krl(source: ProgramSource) -> KrlReading:
    """Return every statement of a file that matters."""
    masked, each = lines(source)
    reading = KrlReading(source, masked)
    for line in each:
        if (match := _MOTION.match(line.text)) is not None:
            reading.motions.append((line, match))
        elif (match := _ROUTINE.match(line.text)) is not None:
            reading.statements.append((line.start, "routine", match[2].upper()))
        elif _ROUTINE_END.match(line.text):
            reading.statements.append((line.start, "end", ""))
        elif (match := _BLOCK.match(line.text)) is not None:
            reading.statements.append((line.start, match[1].upper(), ""))
        elif (match := _DECLARATION.match(line.text)) is not None:
            _read_declaration(reading, line, match)
        elif (match := _BAS.match(line.text)) is not None:
            reading.statements.append((line.start, f"BAS {match[1].upper()}", (match[2] or "").upper()))
        elif (match := _ASSIGNMENT.match(line.text)) is not None:
            _read_assignment(reading, line, match)
        elif (match := _INDEXED.match(line.text)) is not None:
            reading.changes.setdefault(f"{match[1].upper()}[", []).append(line.start)
        elif (match := _CALL.match(line.text)) is not None:
            reading.statements.append((line.start, "call", match[1].upper()))
    return reading


def key_of(name: str) -> str:
    """Return a name without blanks, in capitals."""
    return re.sub(r"\s", "", name).upper()


def _read_declaration(reading: KrlReading, line: KrlLine, match: re.Match[str]) -> None:
    kind, name = match[1].upper(), key_of(match[2])
    if not match[3]:
        for other in [match[2], *match[4].split(",")]:
            reading.declared[key_of(other).partition("[")[0]] = kind
        return
    start = line.start + match.start(4)
    aggregate = aggregate_at(reading.source.text, reading.masked, start, line.end)
    if kind == "FDAT":
        text = match[4]
        tool, base = (re.search(rf"{key}_NO\s+(\d+)", text, _ANY) for key in ("TOOL", "BASE"))
        if tool and base:
            reading.data_frames[name] = (tool[1], base[1])
        if re.search(r"IPO_FRAME\s+#TCP", text, _ANY):
            reading.fixed_tool.add(name)
        return
    reading.declared[name] = kind
    reading.spelling[name] = match[2].strip()
    if aggregate is None or reading.masked[aggregate.end : line.end].strip():
        reading.changes.setdefault(name, []).append(line.start)
    else:
        reading.literals.setdefault(name, []).append((kind, aggregate))


def _read_assignment(reading: KrlReading, line: KrlLine, match: re.Match[str]) -> None:
    name = key_of(match[1])
    value = line.text[match.end() :]
    if name in ("$TOOL", "$BASE"):
        text = "component" if match[2] else value
        reading.statements.append((line.start + match.end(), name, text))
        return
    if name == "FDAT_ACT" and not match[2]:
        reading.statements.append((line.start, "FDAT", key_of(value)))
        return
    start = line.start + match.end()
    aggregate = None if match[2] else aggregate_at(reading.source.text, reading.masked, start, line.end)
    if aggregate is not None and aggregate.is_literal and (aggregate.frame() or aggregate.axes()):
        reading.literals.setdefault(name, []).append(("", aggregate))
        reading.spelling.setdefault(name, match[1].strip())
    else:
        reading.changes.setdefault(name, []).append(line.start)


# $TOOL and $BASE of KRL motions, where the text of the files decides them.

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


_TAIL = re.compile(r"\bWITH\b|\bC_(?:PTP|DIS|VEL|ORI|SPL)\b|,\s*CA\s", _ANY)
_REFERENCE = re.compile(rf"\s*({NAME})\s*\Z")
_KINDS: dict[str, MotionType] = {"PTP": "joint", "LIN": "linear", "CIR": "circular", "SPL": "other", "ASY": "joint"}
_CHANGED = "the program assigns it at run time in line {}"
_NO_TARGET = "the target is computed at run time"
_ELSEWHERE = "the target's numbers are in none of the files read"


def parse_krl(source: ProgramSource, others: Sequence[ProgramSource] = ()) -> Program:
    """Return the program of a ``.src`` or ``.dat`` file.

    Args:
        source: File whose targets are wanted.
        others: Files that belong to it: the ``.dat`` or ``.src`` of the same name, ``$config.dat``.

    Raises:
        InputError: The text is no KRL, or is truncated.
    """
    program = read_krl(source)
    _check_complete(program)
    readings = [program, *(read_krl(other) for other in others)]
    draft = Draft(source, Dialect.krl)
    frames = collect_frames(readings, draft)
    names = _Names(readings)
    targets = _declared_targets(program, names, draft)
    dropped: dict[int, str] = {}
    for reading in readings:
        _add_motions(reading, program, names, frames, targets, draft)
    used_as_base = {text.strip().upper() for reading in readings for _, _, text in reading.statements}
    moved = {move.target for move in draft.moves}
    for name, index in targets.items():
        change = names.change_of(name)
        if change is not None:
            dropped[index] = _CHANGED.format(change)
        elif names.type_of(name) == "FRAME" and index not in moved:
            is_frame = name in used_as_base
            dropped[index] = "is a frame" if is_frame else "is a FRAME that no motion of the files read goes to"
    return draft.program(dropped)


@dataclass(slots=True)
class _Names:
    """Variables of all files that were read."""

    readings: Sequence[KrlReading]

    def literals(self, name: str) -> list[tuple[str, Aggregate]]:
        return [literal for reading in self.readings for literal in reading.literals.get(name, ())]

    def type_of(self, name: str) -> str:
        for reading in self.readings:
            if (kind := reading.declared.get(name) or reading.declared.get(name.partition("[")[0])) is not None:
                return kind
        return ""

    def change_of(self, name: str) -> str | None:
        """Return the line that changes a variable at run time, or None."""
        for reading in self.readings:
            for place in reading.changes.get(name, ()) or reading.changes.get(f"{name.partition('[')[0]}[", ()):
                line = str(reading.source.line(place))
                return line if reading is self.readings[0] else f"{line} of {PurePath(reading.source.file).name}"
        literals = self.literals(name)
        if len(literals) > 1:
            last = literals[-1][1]
            owner = next(r for r in self.readings if any(a is last for _, a in r.literals.get(name, ())))
            return str(owner.source.line(last.start))
        return None


def _check_complete(reading: KrlReading) -> None:
    """Raise InputError where the text is no KRL, or where routines lack their ends."""
    opened: list[int] = []
    count = 0
    for place, kind, _ in reading.statements:
        if kind == "routine":
            opened.append(place)
            count += 1
        elif kind == "end" and opened:
            opened.pop()
    if not count and not reading.literals:
        raise reading.source.error("has no DEF, DEFFCT or DEFDAT, so it is not a complete KRL file")
    if opened:
        fix = "copy it from the controller again"
        raise reading.source.error("is truncated: the routine that begins here has no END", opened[0], fix)


def _declared_targets(reading: KrlReading, names: _Names, draft: Draft) -> dict[str, int]:
    """Add the targets that this file declares with numbers; return their indices by name."""
    result: dict[str, int] = {}
    for name, literals in reading.literals.items():
        kind = names.type_of(name)
        if kind not in ("E6POS", "POS", "E6AXIS", "AXIS", "FRAME") or FRAME_DATA.match(name):
            continue
        aggregate = literals[0][1]
        index = _add_target(draft, reading.spelling.get(name, name), aggregate)
        if index is None:
            draft.note(aggregate.start, aggregate.end, f"{name} lacks some of the numbers of a target")
        else:
            result[name] = index
    return result


def _add_target(draft: Draft, name: str, aggregate: Aggregate) -> int | None:
    external = aggregate.entries(("E1", "E2", "E3", "E4", "E5", "E6"))
    numbers = aggregate.frame()
    if numbers is not None:
        configuration = aggregate.entries(("S", "T"))
        return draft.add(name, Convention.zyx, numbers, configuration=configuration, external=external)
    numbers = aggregate.axes()
    if numbers is not None:
        return draft.add(name, Convention.joints, numbers, external=external)
    return None


def _add_motions(
    reading: KrlReading, program: KrlReading, names: _Names, frames: KrlFrames, targets: dict[str, int], draft: Draft
) -> None:
    """Add the motions of a file to targets of the program, and notes on those computed at run time."""
    tools = timeline(frame_events(reading, frames, "TOOL"))
    bases = timeline(frame_events(reading, frames, "BASE"))
    elsewhere: dict[str, int] = {}
    for line, match in reading.motions:
        tail = _TAIL.search(line.text, match.end())
        stop = tail.start() if tail else len(line.text)
        tool, base = spline_frames(line.text[stop:], frames)
        tool = tool or tools.at(line.start)
        base = base or bases.at(line.start)
        motion = _KINDS[match[1].upper().removeprefix("S")[:3] if match[1].upper() != "SPL" else "SPL"]
        places = split_arguments(line.text[match.end() : stop], line.start + match.end())
        for start, end in places[: 2 if motion == "circular" else 1]:
            part = reading.masked[start:end]
            if match[2]:
                if reading is program:
                    draft.note(line.start, line.end, "a relative motion has no target of its own")
                continue
            reference = _REFERENCE.match(part)
            name = key_of(reference[1]) if reference else ""
            if name in targets:
                draft.move(start, targets[name], motion, tool, base)
                continue
            if reading is not program:
                continue
            if reference and names.literals(name) and names.type_of(name):
                elsewhere.setdefault(name, start)
                continue
            _add_inline(reading, (start, end), line, draft, motion, (tool, base))
    if elsewhere:
        files = sorted(
            {PurePath(r.source.file).name for r in names.readings[1:] if any(name in r.literals for name in elsewhere)}
        )
        first = min(elsewhere.values())
        reason = f"{len(elsewhere)} targets are declared in {', '.join(files)}: correct that file as well"
        draft.note(first, first + 1, reason)


def _add_inline(
    reading: KrlReading,
    place: tuple[int, int],
    line: KrlLine,
    draft: Draft,
    motion: MotionType,
    frames: tuple[ProgramFrame | None, ProgramFrame | None],
) -> None:
    """Add the target of a motion whose numbers are in the instruction, or a note."""
    aggregate = aggregate_at(reading.source.text, reading.masked, *place)
    if aggregate is None or reading.masked[aggregate.end : place[1]].strip():
        reference = _REFERENCE.match(reading.masked[slice(*place)])
        is_variable = reference is not None and not reference[1].startswith("$")
        draft.note(line.start, line.end, _ELSEWHERE if is_variable else _NO_TARGET)
        return
    index = _add_target(draft, "", aggregate)
    if index is None or (draft.targets[index].kind == "joint" and len(draft.targets[index].numbers) < 6):
        draft.note(line.start, line.end, "the instruction leaves numbers of the target out or computes them")
        if index is not None:
            draft.targets.pop()
        return
    draft.move(place[0], index, motion, *frames)
