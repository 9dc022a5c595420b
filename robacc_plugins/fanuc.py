"""FANUC TP programs as ASCII (``.LS``): joint and Cartesian positions of the ``/POS`` section.

Source: FANUC, Operator's Manual (R-30iB), "Program Structure" and "ASCII program"; layout checked on public programs.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial

import numpy as np

from robacc.errors import refuse
from robacc.geometry import Array
from robacc.programs.program import ConfigurationRules, Program, ProgramFrame, ProgramSource, ProgramTarget
from robacc.programs.targets import N_AXES
from robacc.robots.description import Frame
from robacc_plugins.dialects import AXIS_UNITS, FIXED_XYZ, LAYOUT, MM, NUMBER, POSE_UNITS, Draft, numbers, write_program

SIGN = re.compile(r"^/PROG\b", re.M)
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
_CARTESIAN = ("X", "Y", "Z", "W", "P", "R")
_FIX = "write the program as ASCII again"
_DECIMALS = 3
"""Decimals of every number in a .LS file, whose columns have a fixed width."""
_DECIMALS_OF = dict.fromkeys((*POSE_UNITS, *AXIS_UNITS), _DECIMALS)


def parse(source: ProgramSource, others: Sequence[ProgramSource] = ()) -> Program:
    """Return the program of a ``.LS`` file.

    Raises:
        InputError: The text is no TP program, or is truncated.
    """
    text = source.text
    sections = {match[1]: match for match in _SECTION.finditer(text)}
    refuse(
        ("PROG" not in sections, source.problem("has no /PROG, so it is not a TP program in ASCII", fix=_FIX)),
        ("END" not in sections, source.problem("is truncated: it has no /END", len(text), _FIX)),
    )
    draft = Draft(source, "fanuc", configurations=CONFIGURATIONS, decimals=_DECIMALS_OF)
    end = sections["END"].start()
    first = sections["POS"].end() if "POS" in sections else end
    positions = list(_POSITION.finditer(text, first, end))
    spans = [match.span() for match in positions]
    gaps = zip((first, *(stop for _, stop in spans)), (*(start for start, _ in spans), end), strict=True)
    for gap in (gap for gap in gaps if text[slice(*gap)].strip()):
        opened = text.find("{", *gap)
        is_cut = gap[1] == end and opened >= 0 and text.find("}", opened, end) < 0
        refuse((is_cut, source.problem("is truncated: this position has no }", opened, _FIX)))
        draft.note(gap, "is not a position that robacc knows")
    targets = {match[1]: index for match in positions if (index := _add_position(draft, match)) is not None}
    if "MN" in sections:
        for match in _MOTION.finditer(text, sections["MN"].end(), first):
            instruction, place = match[2], (match.start(1), match.end())
            if (offset := _OFFSET.search(instruction)) is not None:
                draft.note(place, f"{offset[1]} moves the target at run time")
            for point in list(_POINT.finditer(instruction))[: 2 if match[1] == "C" else 1]:
                if point[1] == "PR" or not point[2].isdecimal():
                    draft.note(place, "the target is in a register, which is known at run time only")
                elif point[2] not in targets:
                    draft.note(place, f"P[{point[2]}] is not a target of this program")
                elif _INCREMENTAL.search(instruction):
                    draft.dropped[targets[point[2]]] = f"the motion in line {source.line(place[0])} is incremental"
                else:
                    target = draft.targets[targets[point[2]]]
                    draft.move(place, [targets[point[2]]], target.tool, target.base)
    return draft.program()


def _add_position(draft: Draft, match: re.Match[str]) -> int | None:
    """Add the position of group 1; return its index, or None where it is not taught."""
    text = draft.source.text
    groups = list(_GROUP.finditer(text, *match.span(3)))
    ends = [*(group.start() for group in groups[1:]), match.end(3)]
    place = next(((group.end(), end) for group, end in zip(groups, ends, strict=False) if group[1] == "1"), None)
    if place is None:
        draft.note(match.span(), f"P[{match[1]}] has no group 1")
        return None
    entries = {entry[1]: entry for entry in _ENTRY.finditer(text, *place)}
    is_pose = "X" in entries
    keys = _CARTESIAN if is_pose else sorted(key for key in entries if key.startswith("J"))
    expected = POSE_UNITS if is_pose else [MM if entries[key][3] == "mm" else AXIS_UNITS[0] for key in keys]
    known = numbers(text, [entries[key].span(2) for key in keys if key in entries], expected)
    is_whole = keys == (_CARTESIAN if is_pose else [f"J{i + 1}" for i in range(len(keys))])
    if (
        not known
        or not is_whole
        or any((entries[key][3] == "mm") != (unit == MM) for key, unit in zip(keys, expected, strict=True))
    ):
        draft.note(match.span(), f"P[{match[1]}] is not taught, or lacks some of its numbers")
        return None
    configuration = _CONFIGURATION.search(text, *place) if is_pose else None
    frames = _FRAMES.search(text, *place)
    comment = (match[2] or "").strip().strip('"')
    return draft.add(
        f"P[{match[1]}:{comment}]" if comment else f"P[{match[1]}]",
        ProgramTarget(
            FIXED_XYZ if is_pose else None,
            known,
            configuration[1] if configuration else "",
        ),
        tool=ProgramFrame(frames[2], None) if frames else None,
        # User frame 0 is the world frame.
        base=ProgramFrame(frames[1], Frame() if frames[1] == "0" else None) if frames else None,
    )


def joint_window(configuration: str) -> Array | None:
    """Return the least and the largest value ``(2, 6)`` of each joint that the turn numbers allow, rad.

    A ``CONFIG`` ends with three turn numbers: 0 from -180 to 180 degrees, 1 from 180 degrees on. Public sources agree
    that the third is that of axis 6; the first two are those of axes 1 and 4, or 4 and 5, so equal ones are that of
    axis 4 in both readings. The joints behind its letters depend on the arm and are not read.
    """
    numbers = [int(number) for number in re.findall(r"-?\d+", configuration)]
    if len(numbers) != 3:
        return None
    window = np.repeat([[-np.inf], [np.inf]], N_AXES, axis=1)
    window[:, 5] = _turn_range(numbers[2])
    if numbers[0] == numbers[1]:
        window[:, 3] = _turn_range(numbers[0])
    return window


def _turn_range(turn: int) -> tuple[float, float]:
    """Return the range (rad) of an axis of a turn number; sources differ on turns beyond the first."""
    first, last = {0: (-np.pi, np.pi), 1: (np.pi, 3.0 * np.pi)}.get(abs(turn), (2.0 * np.pi, np.inf))
    return (first, last) if turn >= 0 else (-last, -first)


CONFIGURATIONS = ConfigurationRules(joint_window)
"""``CONFIG`` of Cartesian targets."""


NEW_SUFFIX = ".ls"
"""Suffix of a new program."""
write = partial(
    write_program,
    {
        **LAYOUT,
        "has": f"a fanuc program's targets have 1 to {N_AXES}",
        "program": '/PROG  {NAME}\n/ATTR\nOWNER\t\t= MNEDITOR;\nCOMMENT\t\t= "robacc";\nPROTECT\t\t= READ_WRITE;\n'
        "DEFAULT_GROUP\t= 1,*,*,*,*;\n/MN\n{moves}\n/POS\n{data}\n/END\n",
        "data": "P[{k}]{{\n   GP1:\n\tUF : 0, UT : 1,\n\t{numbers}\n}};",
        "move": "J P[{k}] 10% FINE",
        "wait": "  WAIT   2.00(sec)",
        "line": "{i:4d}:{line} ;",
        "number": "J{key}= {value:>9} deg",
        "decimals": _DECIMALS,
        "comma": ",\t",
        "half": ",\n\t",
        "bare_point": True,
    },
)
"""Return the text of a new program; see :func:`robacc_plugins.dialects.write_program`."""
