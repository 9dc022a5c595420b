"""KUKA KRL: targets of ``.src`` and ``.dat`` files, with $TOOL and $BASE where the text alone decides them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath

from robacc.programs.assemble import Draft
from robacc.programs.conventions import Convention
from robacc.programs.frame_state import timeline
from robacc.programs.krl_frames import FRAME_DATA, KrlFrames, collect_frames, frame_events, spline_frames
from robacc.programs.krl_reading import KrlReading, key_of, read_krl
from robacc.programs.krl_syntax import NAME, Aggregate, KrlLine, aggregate_at, split_arguments
from robacc.programs.program import Dialect, MotionType, Program, ProgramFrame
from robacc.programs.source import ProgramSource

_ANY = re.IGNORECASE
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
    if not count:
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
