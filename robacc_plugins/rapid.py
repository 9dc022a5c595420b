"""ABB RAPID: robtargets and jointtargets of a module, with the tool and the work object of their motions.

Source: ABB, Technical reference manual: RAPID Instructions, Functions and Data types (3HAC050917), and RAPID
Overview (3HAC050947).
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Sequence
from functools import partial

import numpy as np

from robacc.errors import InputError, refuse
from robacc.geometry import Array, NDArray
from robacc.programs.program import ConfigurationRules, Program, ProgramFrame, ProgramSource, ProgramTarget
from robacc.programs.targets import N_AXES
from robacc.robots.arm import Arm
from robacc.robots.description import Frame
from robacc_plugins.dialects import (
    AXIS_UNITS,
    CHANGED,
    ELSEWHERE,
    LAYOUT,
    MM,
    QUATERNION,
    RUN_TIME,
    Draft,
    Place,
    arguments,
    items,
    mask,
    numbers,
    on_sides,
    write_program,
)

_ANY = re.IGNORECASE
SIGN = re.compile(r"^\s*(?:%%%|MODULE\s+\w|(?:LOCAL\s+)?PROC\s+\w)", re.I | re.M)
_ROKAE = re.compile(r"\b(?:joint|rob)target\s+\w+\s*=\s*[jp]\s*:\s*\{")
"""Target of a program of ROKAE, whose modules look like those of RAPID."""
_HIDDEN = re.compile(r'"(?:[^"\r\n]|"")*"|![^\r\n]*')
"""Strings and comments."""
_DECLARATION = re.compile(
    r"\b(CONST|PERS|VAR)\s+(robtarget|jointtarget|tooldata|wobjdata)\s+(\w+)\s*(\{[^}]*\})?\s*(?::=\s*([^;]*))?;", _ANY
)
_ASSIGNMENT = re.compile(r"(?<![\\\w.])([A-Za-z_]\w*)\s*+(?:\{[^}]*\}\s*+)?(?:\.\s*\w+\s*+)*:=", _ANY)
"""A masked declaration is a long run of blanks, in which each must be looked at once."""
_BLOCK = re.compile(r"^[ \t]*(?:LOCAL[ \t]+)?(PROC|FUNC|TRAP|ENDPROC|ENDFUNC|ENDTRAP|MODULE|ENDMODULE)\b", _ANY | re.M)
_INSTRUCTION = re.compile(
    r"\b((?:MoveAbs|Move|Trigg|Arc|Spot|Disp|Cap|Search|Paint)([LJC])\w*)[ \t]*(?=[\s\\\[])([^;]*);", _ANY
)
_DISPLACEMENT = re.compile(r"\b(PDispOn|PDispSet|EOffsOn|EOffsSet|CorrCon|SoftAct)\b[^;]*;", _ANY)
_WORK_OBJECT = re.compile(r"\\WObj\s*:=\s*([^\\,;]+)", _ANY)
_NAME = re.compile(r"([A-Za-z_]\w*)\s*(?:\{\s*([^}]*?)\s*\})?\Z")
_GLOBAL = -1
_DECIMALS = 8
"""Decimals of quaternions."""


def parse(source: ProgramSource, others: Sequence[ProgramSource] = ()) -> Program:
    """Return the program of a RAPID module.

    Args:
        source: Module whose targets are wanted.
        others: Modules that declare its tools and work objects.

    Raises:
        InputError: The text is no RAPID module, or is truncated.
    """
    if target := _ROKAE.search(source.text):
        fix = "copy it to a file that ends in .txt: robacc reads the targets in it as commands"
        raise InputError(source.problem("is a program of ROKAE, not a RAPID module", target.start(), fix))
    modules, draft = (source, *others), Draft(source, "rapid", configurations=CONFIGURATIONS, decimals={1.0: _DECIMALS})
    for module in modules:
        copy, opened, blocks = "copy it from the controller again", [("", 0)], mask(module.text, _HIDDEN)
        for match in _BLOCK.finditer(blocks):
            word, at = match[1].upper(), match.start(1)
            if not word.startswith("END"):
                opened.append((word, at))
            elif opened.pop()[0] != word[3:]:
                raise InputError(module.problem(f"{word} ends no {word[3:]}", at, copy))
        word, at = opened[-1]
        refuse(
            (
                not _BLOCK.search(blocks),
                module.problem("has no MODULE and no PROC, so it is not a RAPID module"),
            ),
            (word, module.problem(f"is truncated: this {word} has no END{word}", at, copy)),
        )
    text, end = mask("\n".join(module.text for module in modules), _HIDDEN), len(source.text)
    borders = [match.start() for match in _BLOCK.finditer(text) if not match[1].upper().endswith("MODULE")]
    """Places where routines begin and end."""

    def routine(position: int) -> int:
        """Return the number of the routine around a place, or :data:`_GLOBAL` for the module's own data."""
        k = bisect_right(borders, position) - 1
        return k if k % 2 == 0 else _GLOBAL

    changed = [(match.start(), match[1]) for match in _ASSIGNMENT.finditer(mask(text, _DECLARATION))]
    # A search stores a point in its second argument.
    changed += [
        (match.start(), text[slice(*point)])
        for match in _INSTRUCTION.finditer(text)
        if match[1].lower().startswith("search")
        for point in _arguments(text, match)[1:2]
    ]
    changes: dict[str, list[int]] = {}
    """Places of assignments outside of declarations, by name in small letters."""
    for start, name in sorted(changed):
        changes.setdefault(name.lower(), []).append(start)
    frames = {name: ProgramFrame(name, Frame()) for name in ("tool0", "wobj0")}
    targets: dict[tuple[int, str], list[int | None]] = {}
    # An array has an index for each element; it is None for an element that is no target.
    declared = [match for match in _DECLARATION.finditer(text) if match[5] is not None]
    # The module's own tools and work objects have precedence.
    for match in sorted(declared, key=lambda match: match.start() < end):
        kind, name, scope = match[2].lower(), match[3], routine(match.start())
        if kind in ("tooldata", "wobjdata"):
            # A frame that the program changes is unknown.
            frame = None if name.lower() in changes else _frame(text, match.span(5), kind)
            frames[name.lower()] = ProgramFrame(name, frame)
        elif match.start() < end:
            elements = (items(text, match.span(5)) if match[4] else []) or [match.span(5)]
            indices = targets[scope, name.lower()] = []
            for i, place in enumerate(elements):
                written, reason = _written(text, place, kind), f"{name} lacks some of the numbers of a {kind}"
                indices.append(draft.add(f"{name}{{{i + 1}}}" if match[4] else name, written, place, reason))
            own = (position for position in changes.get(name.lower(), ()) if position < end)
            if at := next((position for position in own if scope in (routine(position), _GLOBAL)), 0):
                reason = CHANGED.format(source.line(at))
                draft.dropped.update({index: reason for index in indices if index is not None})
    for match in _INSTRUCTION.finditer(text, 0, end):
        places = _arguments(text, match)
        work = _WORK_OBJECT.search(match[3])
        names = text[slice(*places[-1])] if len(places) > 1 else "", work[1].strip() if work else "wobj0"
        tool, base = (frames.get(name.lower(), ProgramFrame(name, None)) for name in names)
        first = 2 if match[1].lower().startswith("search") else 0
        for place in places[first : first + (2 if match[2] in "Cc" else 1)]:
            variable = _NAME.match(text, *place)
            if variable is None:
                kind = "jointtarget" if match[1].lower().startswith("moveabs") else "robtarget"
                written = _written(text, place, kind)
                found: Sequence[int | None] | str = RUN_TIME if written is None else [draft.add("", written)]
            else:
                key = variable[1].lower()
                found = targets.get((routine(match.start()), key)) or targets.get((_GLOBAL, key)) or ELSEWHERE
                if variable[2] and variable[2].isdecimal() and found is not ELSEWHERE:
                    found = found[int(variable[2]) - 1 : int(variable[2])]
            draft.move(match.span(), found, tool, base)
    for match in _DISPLACEMENT.finditer(text, 0, end):
        draft.note(
            match.span(), f"{match[1]} moves targets at run time; the corrections are those of the undisplaced targets"
        )
    return draft.program()


def _written(text: str, place: Place, kind: str) -> ProgramTarget | None:
    """Return the robtarget or jointtarget of an aggregate; None where a number lacks."""
    parts = items(text, place)
    if kind == "jointtarget":
        axes = numbers(text, items(text, parts[0]), AXIS_UNITS) if len(parts) == 2 else None
        return None if axes is None else ProgramTarget(None, axes)
    return _pose(text, parts[:2], " ".join(text[slice(*parts[2])].split())) if len(parts) == 4 else None


def _pose(text: str, parts: Sequence[Place], configuration: str = "") -> ProgramTarget | None:
    """Return a pose of its place and its orientation; None where a number lacks."""
    if len(parts) != 2:
        return None
    place, turn = numbers(text, items(text, parts[0]), (MM,) * 3), numbers(text, items(text, parts[1]), (1.0,) * 4)
    # Difference of a quaternion's squared length from 1 above which its numbers are no orientation.
    if place is None or turn is None or abs(sum(number.value**2 for number in turn) - 1) > 0.02:
        return None
    return ProgramTarget(QUATERNION, place + turn, configuration)


def _frame(text: str, place: Place, kind: str) -> Frame | None:
    """Return the tool in the flange's frame or the work object in the world; None where it moves or is held."""
    parts, is_tool = items(text, place), kind == "tooldata"
    # A tool on the flange; a work object that is not held and does not move.
    count, expected, first = (3, ["TRUE"], 1) if is_tool else (5, ["FALSE", "TRUE"], 3)
    if len(parts) != count or [text[slice(*part)].upper() for part in parts[: len(expected)]] != expected:
        return None
    poses = [_pose(text, items(text, part)) for part in parts[first : 2 if is_tool else 5]]
    frames = [pose.frame for pose in poses if pose is not None]
    if len(frames) != len(poses):
        return None
    return frames[0] if is_tool else Frame.of(frames[0].pose @ frames[1].pose)


def _arguments(text: str, match: re.Match[str]) -> list[Place]:
    r"""Return the places of an instruction's arguments, without ``\Switch`` parts."""
    places, _ = arguments(text, *match.span(3))
    return [place for place in places if text[slice(*place)] and text[place[0]] != "\\"]


def joint_window(configuration: str) -> Array | None:
    """Return the least and the largest value ``(2, 6)`` of each joint that ``[cf1,cf4,cf6,cfx]`` allows, rad.

    They are the quarter turns of axes 1, 4 and 6, 0 from 0 to 90 degrees and -1 from -90 to 0 degrees (ABB, Technical
    reference manual, "confdata").
    """
    numbers = [int(number) for number in re.findall(r"-?\d+", configuration)]
    if len(numbers) < 3:
        return None
    window = np.repeat([[-np.inf], [np.inf]], N_AXES, axis=1)
    window[:, [0, 3, 5]] = 0.5 * np.pi * np.add(numbers[:3], [[0], [1]])
    return window


def allowed_by_cfx(arm: Arm, configuration: str, q: Array) -> NDArray[np.bool_]:
    """Return ``(N,)`` whether joints ``(J, N)``, rad, have the cfx of ``[cf1,cf4,cf6,cfx]``; all, without 0 to 7.

    From 4 on, the wrist centre is behind axis 1; 2, 3, 6 and 7 have it behind the lower arm, and odd numbers have
    a negative axis 5 (ABB, Technical reference manual, "confdata").
    """
    cfx = int([*re.findall(r"-?\d+", configuration), "-1"][3])
    if not 0 <= cfx <= 7:
        return np.ones(q.shape[1], dtype=bool)
    return on_sides(arm, q, behind=cfx >= 4, in_front=cfx & 2 == 0, negative=cfx & 1 == 1)


CONFIGURATIONS = ConfigurationRules(joint_window, allowed_by_cfx, are_read_whole=True)
"""Configurations of robtargets."""


NEW_SUFFIX = ".mod"
"""Suffix of a new program."""
write = partial(
    write_program,
    {
        **LAYOUT,
        "has": f"a rapid program's targets have 1 to {N_AXES}",
        "padded": N_AXES,
        "program": "MODULE {name}\n"
        "  ! written by robacc: check the speed, the tool and every motion before you run it\n"
        "{data}\n\n  PROC main()\n{moves}\n  ENDPROC\nENDMODULE\n",
        "data": f"  CONST jointtarget jt{{k}}:=[[{{numbers}}],[{','.join(['9E+09'] * N_AXES)}]]; ! {{comment}}",
        "move": "    MoveAbsJ jt{k}\\NoEOffs,v100,fine,tool0;",
        "wait": "    WaitTime \\InPos,2;",
    },
)
"""Return the text of a new program; see :func:`robacc_plugins.dialects.write_program`."""
