"""KUKA KRL: targets of ``.src`` and ``.dat`` files, with $TOOL and $BASE where the text alone decides them.

Source: KUKA System Software 8, Operating and Programming Instructions for System Integrators, chapter "Programming
for user group Expert (KRL syntax)".
"""

from __future__ import annotations

import itertools
import os
import re
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path, PurePath

import numpy as np

from robacc.errors import refuse
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
    NUMBER,
    POSE_UNITS,
    RUN_TIME,
    ZYX,
    Draft,
    EventKind,
    FrameEvent,
    Place,
    arguments,
    items,
    mask,
    numbers,
    on_sides,
    stripped,
    timeline,
    unclosed,
    write_program,
)

_ANY = re.IGNORECASE
_HIDDEN = re.compile(r'"[^"\r\n]*"|;[^\r\n]*')
"""Strings and comments."""
_NAME = r"[A-Za-z_$][\w$]*(?:\[\s*\d+\s*\])?"
_STATEMENTS = {
    kind: re.compile(pattern, _ANY)
    for kind, pattern in {
        "motion": r"\s*(S?(?:PTP|LIN|CIRC)|SPL|ASYPTP)(_REL)?(?![\w.\[])\s*(?!=)",
        "block": r"\s*(?:GLOBAL\s+)?(DEFDAT|DEFFCT|DEF)\s+(?:\w+(?:\[\s*\])?\s+)?(\$?\w+)",
        "end": r"\s*(END(?:DAT|FCT)?)()\s*\Z",
        "inner": r"\s*(IF|SWITCH|FOR|WHILE|LOOP|REPEAT|ELSE|CASE|DEFAULT|"
        r"ENDIF|ENDSWITCH|ENDFOR|ENDWHILE|ENDLOOP|UNTIL)\b()",
        "declaration": r"\s*(?:(?:GLOBAL|DECL|CONST)\s+)*(E6POS|POS|E6AXIS|AXIS|FRAME|FDAT)"
        rf"\s+({_NAME})\s*(=?)\s*(.*)",
        "command": r"\s*BAS\s*\(\s*#(\w+)\s*(?:,\s*(\w+))?",
        "assignment": rf"\s*({_NAME})(\s*\.\s*\w+)?\s*=(?!=)\s*",
        "indexed": r"\s*([A-Za-z_]\w*)\s*\[[^\]=]*\][^=]*=(?!=)",
        "call": r"\s*(\w+)\s*\(",
    }.items()
}
"""Statements that matter, in the order in which a line is compared with them."""
_BLOCKS: dict[str, EventKind] = {
    **dict.fromkeys(("DEF", "DEFFCT", "DEFDAT"), "routine"),
    **dict.fromkeys(("LOOP", "FOR", "WHILE", "REPEAT"), "loop"),
    **dict.fromkeys(("IF", "SWITCH"), "open"),
    **dict.fromkeys(("ELSE", "CASE", "DEFAULT"), "next"),
}
"""What a word of a block does; any other closes one."""
SIGN = re.compile(r"^\s*(?:&ACCESS\b|(?:GLOBAL\s+)?DEF(?:DAT|FCT)?\s+[\w$](?![^\r\n]*\)\s*:))", re.I | re.M)
"""A routine's head; one that ends in a colon is of URScript."""
_ENTRY = re.compile(rf"(?:\w+\s*:\s*)?([A-Za-z]\w*(?:\[\s*\])?)\s+({NUMBER})")
_FRAME_KEYS = ("X", "Y", "Z", "A", "B", "C")
_AXIS_KEYS = ("A1", "A2", "A3", "A4", "A5", "A6")
_TYPES = ("E6POS", "POS", "E6AXIS", "AXIS", "FRAME")
_TABLE = re.compile(r"(TOOL|BASE)_DATA\[\s*(\d+)\s*\]\Z", _ANY)
_WITH = {
    "TOOL": re.compile(r"\$TOOL\s*=\s*([^,]+)", _ANY),
    "BASE": re.compile(r"\$BASE\s*=\s*((?:[^,(]|\([^)]*\))+)", _ANY),
}
_SPLINE_DATA = re.compile(r"S(?:TOOL2?|BASE)\s*\(\s*(\w+)(?:\s*\.\s*\w+)?\s*\)", _ANY)
_TAIL = re.compile(r"\bWITH\b|\bC_(?:PTP|DIS|VEL|ORI|SPL)\b|,\s*CA\s", _ANY)
_REFERENCE = re.compile(rf"{_NAME}\Z")


def companions(path: str) -> list[str]:
    """Return the path of the ``.dat`` of a ``.src`` or of the ``.src`` of a ``.dat``, where it exists."""
    own = Path(path)
    wanted = {".src": ".dat", ".dat": ".src"}.get(own.suffix.lower(), "")
    others = (own.with_suffix(suffix) for suffix in (wanted, wanted.upper(), wanted.capitalize()) if suffix)
    return [os.fspath(other) for other in others if other.is_file()][:1]


def parse(source: ProgramSource, others: Sequence[ProgramSource] = ()) -> Program:
    """Return the program of a ``.src`` or ``.dat`` file.

    Args:
        source: File whose targets are wanted.
        others: Files that belong to it: the ``.dat`` or ``.src`` of the same name, ``$config.dat``.

    Raises:
        InputError: The text is no KRL, or is truncated.
    """
    return _Reader(source, others).program()


def _key(name: str) -> str:
    """Return a name without blanks, in capitals."""
    return re.sub(r"\s", "", name).upper()


def _written(text: str, place: Place) -> ProgramTarget | None:
    """Return the target or frame of an aggregate ``{X 1.0,Y 2.0,…}`` that fills a place; None where a number lacks."""
    entries: dict[str, Place] = {}
    for start, end in items(text, place):
        entry = _ENTRY.fullmatch(text, start, end)
        key = _key(entry[1]) if entry else ""
        if key in entries or (entry is None and "#" not in text[start:end]):
            return None
        if entry:
            entries[key] = entry.span(2)

    pose = numbers(text, [entries[key] for key in _FRAME_KEYS if key in entries], POSE_UNITS)
    if pose is not None:
        configuration = (f"{key} {text[slice(*span)]}" for key, span in entries.items() if key in ("S", "T"))
        return ProgramTarget(ZYX, pose, ",".join(configuration))
    keys = [key for key in _AXIS_KEYS if key in entries]
    axes = numbers(text, [entries[key] for key in keys], AXIS_UNITS[: len(keys)])
    return ProgramTarget(None, axes) if axes and keys == list(_AXIS_KEYS[: len(keys)]) else None


class _Reader:
    """Statements, variables and frames of a program and of the files behind it; names are in capitals."""

    def __init__(self, source: ProgramSource, others: Sequence[ProgramSource]) -> None:
        """Find the statements and the variables.

        Raises:
            InputError: The text is no KRL, or is truncated.
        """
        self.sources, self.draft = (source, *others), Draft(source, "krl", configurations=CONFIGURATIONS)
        self.text, self.end = mask("\n".join(part.text for part in self.sources), _HIDDEN), len(source.text)
        """Text of all files, and where the program's own ends."""
        self.starts = list(itertools.accumulate((len(part.text) + 1 for part in self.sources), initial=0))
        """Where each file begins in the text."""
        self.values: dict[str, list[tuple[str, str, Place]]] = {}
        """Name as written, declared type (empty for an assignment) and place of each aggregate of a variable."""
        self.changes: dict[str, list[int]] = {}
        """Places of assignments that are no aggregate of numbers, by name."""
        self.types: dict[str, str] = {}
        """Declared types."""
        self.data: dict[str, dict[str, str]] = {}
        """Numbers of tool and base of each FDAT."""
        self.fixed: set[str] = set()
        """FDAT whose tool stands in the cell (IPO_FRAME #TCP)."""
        self.statements: list[tuple[str, re.Match[str]]] = []
        """Kind and match of each statement, whose match begins and ends with its line."""
        for line in re.finditer(r"[^\r\n]+", self.text):
            for kind, pattern in _STATEMENTS.items():
                if (match := pattern.match(self.text, *line.span())) is not None:
                    self.statements.append((kind, match))
                    self.read_variable(kind, match)
                    break
        blocks = [
            (match[1], match.start(), kind == "block")
            for kind, match in self.statements
            if kind in ("block", "end") and match.start() < self.end
        ]
        is_whole = any(opens for *_, opens in blocks) or any(map(self.own, self.values))
        word, place = next(iter(unclosed(blocks)), ("", 0))
        no_end, fix = "is truncated: the routine that begins here has no END", "copy it from the controller again"
        refuse(
            (not is_whole, source.problem("has no DEF, DEFFCT or DEFDAT, so it is not a complete KRL file")),
            (word, source.problem(no_end, place, fix)),
        )
        self.frames: dict[str, Frame] = {}
        """Frames of variables, such as ``TOOL_DATA[1]``."""
        for name, ((_, kind, at), *more) in self.values.items():
            written = _written(self.text, at)
            if more or name in self.changes or written is None or written.convention is None:
                continue
            if _TABLE.match(name) or (kind in ("FRAME", "") and not written.configuration):
                self.frames[name] = written.frame

    def read_variable(self, kind: str, match: re.Match[str]) -> None:
        """Take in a statement that declares or changes a variable: its value, or the place where it is computed."""
        word, is_new = match[1].upper(), kind == "declaration"
        if kind == "indexed":
            self.changes.setdefault(f"{word}[", []).append(match.start())
        elif is_new and word == "FDAT" and match[3]:
            numbers_of = dict(re.findall(r"(TOOL|BASE)_NO\s+(\d+)", match[4].upper()))
            if len(numbers_of) == 2:
                self.data[_key(match[2])] = numbers_of
                self.fixed |= {_key(match[2])} if re.search(r"IPO_FRAME\s+#TCP", match[4], _ANY) else set()
        elif is_new and not match[3]:
            for other in (match[2], *match[4].split(",")):
                self.types.setdefault(_key(other).partition("[")[0], word)
        elif kind == "assignment" or is_new:
            name, start = (match[2], match.start(4)) if is_new else (match[1], match.end())
            place = stripped(self.text, (start, match.endpos))
            if is_new:
                self.types.setdefault(_key(name), word)
            if self.text.startswith("{", place[0]) if is_new else not match[2] and _written(self.text, place):
                self.values.setdefault(_key(name), []).append((name.strip(), word if is_new else "", place))
            else:
                self.changes.setdefault(_key(name), []).append(place[0])

    def own(self, name: str) -> bool:
        """Return whether a variable has a value in the program's own file."""
        return name in self.values and self.values[name][0][2][0] < self.end

    def program(self) -> Program:
        """Return the program."""
        targets: dict[str, int] = {}
        for name in filter(self.own, self.values):
            label, _, place = self.values[name][0]
            if self.type_of(name) in _TYPES and not _TABLE.match(name):
                reason = f"{name} lacks some of the numbers of a target"
                if (index := self.draft.add(label, _written(self.text, place), place, reason)) is not None:
                    targets[name] = index
        self.read_motions(targets)
        bases = {_key(_rest(match)) for kind, match in self.statements if _frame_of(kind, match)}
        moved = {index for index, *_ in self.draft.moves}
        for name, index in targets.items():
            changes = self.changes.get(name, self.changes.get(f"{name.partition('[')[0]}[", [])) or [
                place[0] for *_, place in self.values[name][:0:-1]
            ]
            if changes:
                self.draft.dropped[index] = CHANGED.format(self.line_of(changes[0]))
            elif self.type_of(name) == "FRAME" and index not in moved:
                self.draft.dropped[index] = (
                    "is a frame" if name in bases else "is a FRAME that no motion of the files read goes to"
                )
        return self.draft.program()

    def type_of(self, name: str) -> str:
        """Return the declared type of a variable or of its array."""
        return self.types.get(name) or self.types.get(name.partition("[")[0], "")

    def line_of(self, position: int) -> str:
        """Return the line of a place, and its file if it is not the program's own."""
        number = bisect_right(self.starts, position) - 1
        line = str(self.sources[number].line(position - self.starts[number]))
        return f"{line} of {PurePath(self.sources[number].file).name}" if number else line

    def numbered(self, number: str, kind: str) -> ProgramFrame:
        """Return the tool or base of a number."""
        return ProgramFrame(number, Frame() if number == "0" else self.frames.get(f"{kind}_DATA[{number}]"))

    def resolve(self, text: str) -> ProgramFrame | None:
        """Return the frame of the right-hand side of an assignment; None where it is computed."""
        if (written := _written(text, (0, len(text)))) is not None and written.convention is ZYX:
            return ProgramFrame("", written.frame)
        key = _key(text)
        if key in ("$NULLFRAME", "$WORLD"):
            return ProgramFrame(key, Frame())
        if (match := _TABLE.match(key)) is not None:
            return self.numbered(match[2], match[1])
        return ProgramFrame(key, self.frames[key]) if key in self.frames else None

    def events(self, frame: str) -> Iterator[FrameEvent]:
        """Yield the statements that decide $TOOL or $BASE."""
        for kind, match in self.statements:
            place, word = match.start(), match[1].upper()
            if kind in ("block", "end", "inner"):
                yield FrameEvent(place, _BLOCKS.get(word, "close"), name=match[2].upper())
            elif kind == "call":
                yield FrameEvent(place, "call", name=word)
            elif kind == "command" and word == frame:
                number = match[2] or ""
                yield FrameEvent(place, "set", self.numbered(number, frame) if number.isdecimal() else None)
            elif kind == "command":
                yield FrameEvent(place, "set" if word in ("INITMOV", "FRAMES") else "may set")
            elif _frame_of(kind, match) == frame:
                yield FrameEvent(place, "set", None if match[2] else self.resolve(_rest(match)))
            elif kind == "assignment" and _key(match[1]) == "FDAT_ACT" and not match[2]:
                data = None if (name := _key(_rest(match))) in self.fixed else self.data.get(name)
                yield FrameEvent(place, "set", None if data is None else self.numbered(data[frame], frame))

    def of_spline(self, text: str, kind: str) -> ProgramFrame | None:
        """Return the frame that a motion sets with ``WITH $TOOL = STOOL2(FP1), $BASE = SBASE(FP1.BASE_NO)``."""
        match = _WITH[kind].search(text)
        if match is None:
            return None
        value = match[1].strip()
        data = _SPLINE_DATA.match(value)
        if data is not None and (name := data[1].upper()) in self.data:
            number = self.data[name][kind]
            return ProgramFrame(number, None) if name in self.fixed else self.numbered(number, kind)
        return self.resolve(value) or ProgramFrame(value, None)

    def read_motions(self, targets: dict[str, int]) -> None:
        """Add the motions to targets of the program, and notes on those that it computes at run time."""
        tools, bases = (timeline(list(self.events(kind))) for kind in ("TOOL", "BASE"))
        elsewhere: dict[str, int] = {}
        for match in (match for kind, match in self.statements if kind == "motion"):
            line, is_own = (match.start(), match.endpos), match.start() < self.end
            tail = _TAIL.search(self.text, match.end(), match.endpos)
            stop = tail.start() if tail else match.endpos
            tool = self.of_spline(self.text[stop : match.endpos], "TOOL") or tools(line[0])
            base = self.of_spline(self.text[stop : match.endpos], "BASE") or bases(line[0])
            for place in arguments(self.text, match.end(), stop)[0][: 2 if match[1].upper().endswith("CIRC") else 1]:
                name = _key(self.text[slice(*place)])
                found: list[int | None] | str = [targets[name]] if name in targets else ""
                if match[2]:
                    found = "a relative motion has no target of its own"
                if found and (is_own or not match[2]):
                    self.draft.move(line, found, tool, base)
                elif is_own and self.type_of(name) and name in self.values:
                    elsewhere.setdefault(name, place[0])
                elif is_own:
                    self.draft.move(line, self.inline(place), tool, base)
        if elsewhere:
            files = {
                self.line_of(start).partition(" of ")[2]
                for name in elsewhere
                for *_, (start, _) in self.values[name]
                if start > self.end
            }
            first = min(elsewhere.values())
            self.draft.note(
                (first, first + 1),
                f"{len(elsewhere)} targets are declared in {', '.join(sorted(files))}: correct that file as well",
            )

    def inline(self, place: Place) -> list[int | None] | str:
        """Add the target of a motion whose numbers are in the instruction; return a reason where they are not."""
        if not items(self.text, place):
            return ELSEWHERE if _REFERENCE.match(self.text, *place) and self.text[place[0]] != "$" else RUN_TIME
        written = _written(self.text, place)
        if written is None or len(written.numbers) < len(_AXIS_KEYS):
            return "the instruction leaves numbers of the target out or computes them"
        return [self.draft.add("", written)]


def _rest(match: re.Match[str]) -> str:
    """Return the rest of a statement's line."""
    return match.string[match.end() : match.endpos]


def _frame_of(kind: str, match: re.Match[str]) -> str:
    """Return ``TOOL`` or ``BASE`` for an assignment to $TOOL or $BASE; empty for any other statement."""
    name = _key(match[1]) if kind == "assignment" else ""
    return name[1:] if name in ("$TOOL", "$BASE") else ""


# Status ``S`` of a KRL target: the side of the wrist centre on which a solution of the inverse kinematics lies.
#
# Bit 0 is set where the wrist centre is behind axis 1 (overhead area), bit 1 where it is in front of the straight
# line from axis 2 to axis 3, bit 2 where axis 5 is negative. Higher bits say nothing about the joints. Sources: KUKA
# System Software 8, "Status and Turn"; in words, Beckhoff TF5200, "Status & Turn (IS, IT)". The signs of bits 1 and 2
# agree with the turn bits of axes 3 and 5 in recorded public programs.


def joint_window(configuration: str) -> Array | None:
    """Return the least and the largest value ``(2, 6)`` of each joint that a turn allows, rad.

    Bit i of T is set where axis i + 1 is negative (KUKA, Expert Programming, "Status and Turn").
    """
    turn = _bits("T", configuration)
    if turn is None and _bits("S", configuration) is None:
        return None
    low, high = window = np.repeat([[-np.inf], [np.inf]], N_AXES, axis=1)
    if turn is not None:
        is_negative = np.array([turn >> i & 1 for i in range(N_AXES)], dtype=bool)
        low[~is_negative] = high[is_negative] = 0.0
    return window


def allowed_by_status(arm: Arm, configuration: str, q: Array) -> NDArray[np.bool_]:
    """Return ``(N,)`` whether joints ``(J, N)`` have the status of a configuration; all, where it has none.

    Args:
        arm: Nominal arm with the identity as its base frame, ``$ROBROOT``.
        configuration: ``S`` and ``T`` as the program writes them.
        q: Joints, rad.
    """
    status = _bits("S", configuration)
    if status is None:
        return np.ones(q.shape[1], dtype=bool)
    return on_sides(arm, q, *(bool(status >> bit & 1) for bit in range(3)))


def _bits(letter: str, configuration: str) -> int | None:
    """Return the number of ``S`` or ``T``, in binary digits, ``'B010'``, or in decimal ones; None where it lacks."""
    match = re.search(rf"\b{letter}\s*'?(B[01]+|\d+)", configuration, re.IGNORECASE)
    if match is None:
        return None
    return int(match[1][1:], 2) if match[1][0] in "Bb" else int(match[1])


CONFIGURATIONS = ConfigurationRules(joint_window, allowed_by_status, are_read_whole=True)
"""``S`` and ``T`` of Cartesian targets."""


NEW_SUFFIX = ".src"
"""Suffix of a new program."""
write = partial(
    write_program,
    {
        **LAYOUT,
        "has": f"a krl program's targets have 1 to {N_AXES}",
        "program": "&ACCESS RVP\nDEF {name}( )\n"
        "; written by robacc: check the speed, the tool and every motion before you run it\nBAS (#INITMOV,0)\n"
        + "".join(f"$VEL_AXIS[{i + 1}]=10\n" for i in range(N_AXES))
        + "$VEL.CP=0.100\n{moves}\nEND\n",
        "move": "; {comment}\nPTP {{{numbers}}}",
        "wait": "WAIT SEC 2",
        "number": "A{key} {value}",
    },
)
"""Return the text of a new program; see :func:`robacc_plugins.dialects.write_program`."""
