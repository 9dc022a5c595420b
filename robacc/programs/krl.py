"""KUKA KRL: targets of ``.src`` and ``.dat`` files, with $TOOL and $BASE where the text alone decides them.

Source: KUKA System Software 8, Operating and Programming Instructions for System Integrators, chapter "Programming
for user group Expert (KRL syntax)".
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from pathlib import PurePath
from typing import NamedTuple

from robacc.programs.grammar import (
    AXIS_UNITS,
    CHANGED,
    ELSEWHERE,
    POSE_UNITS,
    RUN_TIME,
    EventKind,
    FrameEvent,
    Place,
    arguments,
    items,
    mask,
    numbers,
    stripped,
    timeline,
    unclosed,
)
from robacc.programs.program import (
    NUMBER,
    ZYX,
    Dialect,
    Draft,
    MotionType,
    Program,
    ProgramFrame,
    ProgramSource,
    ProgramTarget,
)
from robacc.robots.description import Frame

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
_KINDS: dict[str, MotionType] = {"PTP": "joint", "LIN": "linear", "CIR": "circular", "SPL": "other", "ASY": "joint"}
_ORIGIN = Frame()


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

    def as_written(prefix: Sequence[str]) -> str:
        return ",".join(f"{key} {text[slice(*span)]}" for key, span in entries.items() if key in prefix)

    external = as_written(("E1", "E2", "E3", "E4", "E5", "E6"))
    pose = numbers(text, [entries[key] for key in _FRAME_KEYS if key in entries], POSE_UNITS)
    if pose is not None:
        return ProgramTarget(ZYX, pose, as_written(("S", "T")), external)
    keys = [key for key in _AXIS_KEYS if key in entries]
    axes = numbers(text, [entries[key] for key in keys], AXIS_UNITS[: len(keys)])
    return ProgramTarget(None, axes, "", external) if axes and keys == list(_AXIS_KEYS[: len(keys)]) else None


class _KrlValue(NamedTuple):
    """Aggregate that a declaration or an assignment gives a variable."""

    name: str
    """Name as written."""
    type: str
    """Declared type; empty for an assignment."""
    place: Place
    written: ProgramTarget | None


class _File:
    """Findings in one file; names are in capitals."""

    def __init__(self, source: ProgramSource) -> None:
        """Find the statements and the variables."""
        self.source, self.text = source, mask(source.text, _HIDDEN)
        self.statements: list[tuple[str, re.Match[str]]] = []
        """Kind and match of each statement, whose match begins and ends with its line."""
        self.values: dict[str, list[_KrlValue]] = {}
        self.changes: dict[str, list[int]] = {}
        """Places of assignments that are no aggregate of numbers, by name."""
        self.declared: dict[str, str] = {}
        for line in re.finditer(r"[^\r\n]+", self.text):
            tried = ((kind, pattern.match(self.text, *line.span())) for kind, pattern in _STATEMENTS.items())
            self.statements += itertools.islice(((kind, match) for kind, match in tried if match), 1)
        for kind, match in self.statements:
            self.read_variable(kind, match)

    def read_variable(self, kind: str, match: re.Match[str]) -> None:
        """Take in a statement that declares or changes a variable: its value, or the place where it is computed."""
        word, is_new = match[1].upper(), kind == "declaration"
        if kind == "indexed":
            self.changes.setdefault(f"{word}[", []).append(match.start())
        elif is_new and not match[3]:
            for other in (match[2], *match[4].split(",")):
                self.declared[_key(other).partition("[")[0]] = word
        elif kind == "assignment" or (is_new and word != "FDAT"):
            name, start = (match[2], match.start(4)) if is_new else (match[1], match.end())
            place = stripped(self.text, (start, match.endpos))
            written = None if not is_new and match[2] else _written(self.text, place)
            if is_new:
                self.declared[_key(name)] = word
            if self.text.startswith("{", place[0]) if is_new else written is not None:
                value = _KrlValue(name.strip(), word if is_new else "", place, written)
                self.values.setdefault(_key(name), []).append(value)
            else:
                self.changes.setdefault(_key(name), []).append(place[0])


def parse(source: ProgramSource, others: Sequence[ProgramSource] = ()) -> Program:
    """Return the program of a ``.src`` or ``.dat`` file.

    Args:
        source: File whose targets are wanted.
        others: Files that belong to it: the ``.dat`` or ``.src`` of the same name, ``$config.dat``.

    Raises:
        InputError: The text is no KRL, or is truncated.
    """
    file = _File(source)
    blocks = [(kind, match) for kind, match in file.statements if kind in ("block", "end")]
    if not file.values and not any(kind == "block" for kind, _ in blocks):
        raise source.error("has no DEF, DEFFCT or DEFDAT, so it is not a complete KRL file")
    if opened := unclosed((match[1], match.start(), kind == "block") for kind, match in blocks):
        fix = "copy it from the controller again"
        raise source.error("is truncated: the routine that begins here has no END", opened[0][1], fix)
    return _Reader([file, *map(_File, others)], Draft(source, Dialect.krl)).program()


class _Reader:
    """Files of a program, which is the first of them, and the frames that they define."""

    def __init__(self, files: Sequence[_File], draft: Draft) -> None:
        """Take the frames that the files define with numbers."""
        self.files, self.draft = files, draft
        self.frames: dict[str, Frame] = {}
        """Frames of variables, such as ``TOOL_DATA[1]``."""
        self.data: dict[str, dict[str, str]] = {}
        """Numbers of tool and base of each FDAT."""
        self.fixed: set[str] = set()
        """FDAT whose tool stands in the cell (IPO_FRAME #TCP)."""
        statements = (match for file in files for kind, match in file.statements if kind == "declaration")
        for match in statements:
            numbers_of = dict(re.findall(r"(TOOL|BASE)_NO\s+(\d+)", match[4].upper()))
            if match[1].upper() == "FDAT" and match[3] and len(numbers_of) == 2:
                self.data[_key(match[2])] = numbers_of
                if re.search(r"IPO_FRAME\s+#TCP", match[4], _ANY):
                    self.fixed.add(_key(match[2]))
        values = ((name, value, file) for file in files for name, (value, *more) in file.values.items() if not more)
        for name, value, file in values:
            if name in file.changes or value.written is None or value.written.convention is None:
                continue
            if _TABLE.match(name) or (value.type in ("FRAME", "") and not value.written.configuration):
                self.frames[name] = value.written.frame

    def program(self) -> Program:
        """Return the program."""
        targets: dict[str, int] = {}
        for name, (value, *_) in self.files[0].values.items():
            if self.type_of(name) in _TYPES and not _TABLE.match(name):
                reason = f"{name} lacks some of the numbers of a target"
                if (index := self.draft.declare(value.name, value.written, value.place, reason)) is not None:
                    targets[name] = index
        for file in self.files:
            self.read_motions(file, targets)
        bases = {_key(_rest(match)) for file in self.files for kind, match in file.statements if _frame_of(kind, match)}
        moved = {index for index, *_ in self.draft.moves}
        for name, index in targets.items():
            if (change := self.change_of(name)) is not None:
                self.draft.dropped[index] = CHANGED.format(change)
            elif self.type_of(name) == "FRAME" and index not in moved:
                reason = "is a frame" if name in bases else "is a FRAME that no motion of the files read goes to"
                self.draft.dropped[index] = reason
        return self.draft.program()

    def type_of(self, name: str) -> str:
        """Return the declared type of a variable or of its array."""
        kinds = (file.declared.get(name) or file.declared.get(name.partition("[")[0]) for file in self.files)
        return next(filter(None, kinds), "")

    def change_of(self, name: str) -> str | None:
        """Return the line that changes a variable at run time, or None."""
        array = f"{name.partition('[')[0]}["
        changes = [(file, at) for file in self.files for at in file.changes.get(name, file.changes.get(array, ()))]
        values = [(file, value.place[0]) for file in self.files for value in file.values.get(name, ())]
        if not changes and len(values) < 2:
            return None
        file, position = changes[0] if changes else values[-1]
        line = str(file.source.line(position))
        return line if file is self.files[0] else f"{line} of {PurePath(file.source.file).name}"

    def numbered(self, number: str, kind: str) -> ProgramFrame:
        """Return the tool or base of a number."""
        return ProgramFrame(number, _ORIGIN if number == "0" else self.frames.get(f"{kind}_DATA[{number}]"))

    def resolve(self, text: str) -> ProgramFrame | None:
        """Return the frame of the right-hand side of an assignment; None where it is computed."""
        if (written := _written(text, (0, len(text)))) is not None and written.convention is ZYX:
            return ProgramFrame("", written.frame)
        key = _key(text)
        if key in ("$NULLFRAME", "$WORLD"):
            return ProgramFrame(key, _ORIGIN)
        if (match := _TABLE.match(key)) is not None:
            return self.numbered(match[2], match[1])
        return ProgramFrame(key, self.frames[key]) if key in self.frames else None

    def events(self, file: _File, frame: str) -> Iterator[FrameEvent]:
        """Yield the statements of a file that decide $TOOL or $BASE."""
        for kind, match in file.statements:
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
                name = _key(_rest(match))
                is_known = name in self.data and name not in self.fixed
                yield FrameEvent(place, "set", self.numbered(self.data[name][frame], frame) if is_known else None)

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

    def read_motions(self, file: _File, targets: dict[str, int]) -> None:
        """Add the motions of a file to targets of the program, and notes on those computed at run time."""
        tools, bases = (timeline(list(self.events(file, kind))) for kind in ("TOOL", "BASE"))
        is_program, text = file is self.files[0], file.text
        elsewhere: dict[str, int] = {}
        for match in (match for kind, match in file.statements if kind == "motion"):
            line = (match.start(), match.endpos)
            tail = _TAIL.search(text, match.end(), match.endpos)
            stop = tail.start() if tail else match.endpos
            tool = self.of_spline(text[stop : match.endpos], "TOOL") or tools(line[0])
            base = self.of_spline(text[stop : match.endpos], "BASE") or bases(line[0])
            word = match[1].upper()
            motion = _KINDS[word if word == "SPL" else word.removeprefix("S")[:3]]
            for place in arguments(text, match.end(), stop)[0][: 2 if motion == "circular" else 1]:
                name = _key(text[slice(*place)])
                found: list[int | None] | str = [targets[name]] if name in targets else ""
                if match[2]:
                    found = "a relative motion has no target of its own"
                if found and (is_program or not match[2]):
                    self.draft.move(line, found, motion, tool, base)
                elif is_program and self.type_of(name) and any(name in other.values for other in self.files):
                    elsewhere.setdefault(name, place[0])
                elif is_program:
                    self.draft.move(line, self.inline(text, place), motion, tool, base)
        if elsewhere:
            files = {PurePath(f.source.file).name for f in self.files[1:] if not elsewhere.keys().isdisjoint(f.values)}
            first = min(elsewhere.values())
            reason = f"{len(elsewhere)} targets are declared in {', '.join(sorted(files))}: correct that file as well"
            self.draft.note((first, first + 1), reason)

    def inline(self, text: str, place: Place) -> list[int | None] | str:
        """Add the target of a motion whose numbers are in the instruction; return a reason where they are not."""
        if not items(text, place):
            return ELSEWHERE if _REFERENCE.match(text, *place) and text[place[0]] != "$" else RUN_TIME
        written = _written(text, place)
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
