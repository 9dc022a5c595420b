"""FANUC TP programs as ASCII (``.LS``): joint and Cartesian positions of the ``/POS`` section.

Source: FANUC, Operator's Manual (R-30iB), "Program Structure" and "ASCII program"; layout checked on public programs.
"""

from __future__ import annotations

import math
import re

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
)
from robacc.robots.description import Frame

_SECTION = re.compile(r"^/(PROG|ATTR|APPL|MN|POS|END)\b", re.M)
_POSITION = re.compile(r"^[ \t]*P\[\s*(\d+)\s*(?::\s*([^\]]*))?\]\s*\{([^}]*)\}\s*;", re.M)
_GROUP = re.compile(r"\bGP(\d+)\s*:")
_FRAMES = re.compile(r"\bUF\s*:\s*(\w+)\s*,\s*UT\s*:\s*(\w+)")
_CONFIGURATION = re.compile(r"\b[CK]ONFIG\s*:\s*'([^']*)'")
_ENTRY = re.compile(rf"\b([XYZWPR]|J\d|E\d)\s*=\s*({NUMBER}|\*+)\s*(mm|deg)\b")
_MOTION = re.compile(r"^[ \t]*\d*:[ \t]*([JLCAS])[ \t]+(?=P)([^;]*);", re.M)
_POINT = re.compile(r"\b(PR?)\[\s*(\d+|[A-Z]+\[)[^\]]*\]")
_OFFSET = re.compile(r"\b(Tool_Offset|TOOL_OFFSET|Offset|OFFSET|VOFFSET|VISION)\b")
_INCREMENTAL = re.compile(r"\b(INC|INK)\b")
_KINDS: dict[str, MotionType] = {"J": "joint", "L": "linear", "C": "circular", "A": "circular", "S": "other"}
_CARTESIAN = ("X", "Y", "Z", "W", "P", "R")
_UNITS = {"mm": 1e-3, "deg": math.pi / 180}
_FIX = "write the program as ASCII again"


def parse_fanuc(source: ProgramSource) -> Program:
    """Return the program of a ``.LS`` file.

    Raises:
        InputError: The text is no TP program, or is truncated.
    """
    text = source.text
    sections = {match[1]: match for match in _SECTION.finditer(text)}
    if "PROG" not in sections:
        raise source.error("has no /PROG, so it is not a TP program in ASCII", fix=_FIX)
    if "END" not in sections:
        raise source.error("is truncated: it has no /END", len(text), _FIX)
    draft = Draft(source, Dialect.fanuc)
    end = sections["END"].start()
    first = sections["POS"].end() if "POS" in sections else end
    targets: dict[str, int] = {}
    position = first
    for match in _POSITION.finditer(text, first, end):
        if text[position : match.start()].strip():
            draft.note(position, match.start(), "is not a position that robacc knows")
        position = match.end()
        index = _add_position(draft, match)
        if index is not None:
            targets[match[1]] = index
    if text[position:end].strip():
        opened = text.find("{", position, end)
        if opened >= 0 and text.find("}", opened, end) < 0:
            raise source.error("is truncated: this position has no }", opened, _FIX)
        draft.note(position, end, "is not a position that robacc knows")
    dropped: dict[int, str] = {}
    if "MN" in sections:
        for match in _MOTION.finditer(text, sections["MN"].end(), first):
            _add_motions(draft, match, targets, dropped)
    return draft.program(dropped)


def _add_position(draft: Draft, match: re.Match[str]) -> int | None:
    """Add the position of group 1; return its index, or None where it is not taught."""
    text = draft.source.text
    groups = list(_GROUP.finditer(text, match.start(3), match.end(3)))
    ends = [group.start() for group in groups[1:]] + [match.end(3)]
    chosen = next((k for k, group in enumerate(groups) if group[1] == "1"), None)
    if chosen is None:
        draft.note(match.start(), match.end(), f"P[{match[1]}] has no group 1")
        return None
    start, end = groups[chosen].end(), ends[chosen]
    entries = {entry[1]: entry for entry in _ENTRY.finditer(text, start, end)}
    frames = _FRAMES.search(text, start, end)
    tool, base = (ProgramFrame(frames[2], None), _base(frames[1])) if frames else (None, None)
    external = ", ".join(" ".join(entry[0].split()) for key, entry in entries.items() if key.startswith("E"))
    if len(groups) > 1:
        others = ", ".join(f"GP{group[1]}" for k, group in enumerate(groups) if k != chosen)
        external = ", ".join(part for part in (external, others) if part)
    numbers = _numbers(entries)
    if numbers is None:
        draft.note(match.start(), match.end(), f"P[{match[1]}] is not taught, or lacks some of its numbers")
        return None
    configuration = _CONFIGURATION.search(text, start, end)
    comment = (match[2] or "").strip().strip('"')
    name = f"P[{match[1]}:{comment}]" if comment else f"P[{match[1]}]"
    return draft.add(
        name,
        Convention.fixed_xyz if "X" in entries else Convention.joints,
        numbers,
        configuration=configuration[1] if configuration and "X" in entries else "",
        external=external,
        tool=tool,
        base=base,
    )


def _base(name: str) -> ProgramFrame:
    """Return the user frame of a number; 0 is the world frame."""
    return ProgramFrame(name, Frame() if name == "0" else None)


def _numbers(entries: dict[str, re.Match[str]]) -> tuple[ProgramNumber, ...] | None:
    """Return X … R or J1 … Jn as numbers; None where one is missing, masked or in an unexpected unit."""
    if "X" in entries:
        keys = list(_CARTESIAN)
        units = ["mm"] * 3 + ["deg"] * 3
        if any(key not in entries or entries[key][3] != unit for key, unit in zip(keys, units, strict=True)):
            return None
    else:
        keys = sorted(key for key in entries if key.startswith("J"))
        if not keys or keys != [f"J{i + 1}" for i in range(len(keys))]:
            return None
    if any(entries[key][2].startswith("*") for key in keys):
        return None
    return tuple(
        ProgramNumber(entries[key].start(2), entries[key].end(2), float(entries[key][2]), _UNITS[entries[key][3]])
        for key in keys
    )


def _add_motions(draft: Draft, match: re.Match[str], targets: dict[str, int], dropped: dict[int, str]) -> None:
    """Add the motions of an instruction, or notes on what it computes."""
    instruction = match[2]
    if (offset := _OFFSET.search(instruction)) is not None:
        draft.note(match.start(1), match.end(), f"{offset[1]} moves the target at run time")
    motion = _KINDS[match[1]]
    points = list(_POINT.finditer(instruction))[: 2 if match[1] == "C" else 1]
    for point in points:
        line = draft.source.line(match.start(1))
        if point[1] == "PR" or not point[2].isdecimal():
            draft.note(match.start(1), match.end(), "the target is in a register, which is known at run time only")
        elif point[2] not in targets:
            draft.note(match.start(1), match.end(), f"P[{point[2]}] is not a target of this program")
        elif _INCREMENTAL.search(instruction):
            dropped[targets[point[2]]] = f"the motion in line {line} is incremental"
        else:
            index = targets[point[2]]
            target = draft.targets[index]
            draft.move(match.start(1), index, motion, target.tool, target.base)
