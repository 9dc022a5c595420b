"""Staubli VAL3 data files (``.dtx``): points, joints, tools and frames; motions of the ``.pgx`` programs beside them.

Sources of the layout and of R = Rx(rx) Ry(ry) Rz(rz): two public generators of VAL3 programs (RoboDK's post-processor,
visose/Robots) and a public worked example of nested frames, which agree.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from robacc.programs.assemble import Draft
from robacc.programs.conventions import Convention
from robacc.programs.program import Dialect, Program, ProgramFrame, ProgramNumber
from robacc.programs.source import NUMBER, ProgramSource, mask
from robacc.programs.val3_code import Val3Code, read_code
from robacc.programs.val3_frames import Entry, FrameTree

_SIGN = re.compile(r"<Database\b[^>]*/VAL3/Data/")
_COMMENT = re.compile(r"<!--.*?-->", re.S)
_DATA = re.compile(r"<Data\b([^>]*?)(?:/>|>(.*?)</Data\s*>)", re.S)
_VALUE = re.compile(r"<Value\b([^>]*?)/?>", re.S)
_ATTRIBUTE = re.compile(r"""([\w:.-]+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_INCH = re.compile(r"""\bmillimeterUnit\s*=\s*["']false["']""")
_POSE = ("x", "y", "z", "rx", "ry", "rz")
_JOINTS = tuple(f"j{i}" for i in range(1, 7))
_CONFIGURATION = ("shoulder", "elbow", "wrist")
_DEGREE = math.pi / 180
_FIX = "export the application from the controller or Stäubli Robotics Suite again"


@dataclass(frozen=True, slots=True)
class _Value:
    """Element ``Value`` of an array of data."""

    name: str
    """``pPick[0]``"""
    attributes: dict[str, re.Match[str]]
    start: int
    end: int

    def text(self, key: str) -> str | None:
        """Return the text of an attribute."""
        match = self.attributes.get(key)
        return None if match is None else match[2] if match[2] is not None else match[3]

    def number(self, key: str, unit: float) -> ProgramNumber | None:
        """Return an attribute as a number; None where it is missing or no number."""
        text = self.text(key)
        if text is None or not re.fullmatch(NUMBER, text):
            return None
        match = self.attributes[key]
        group = 2 if match[2] is not None else 3
        return ProgramNumber(match.start(group), match.end(group), float(text), unit)


def parse_val3(source: ProgramSource, others: Sequence[ProgramSource] = ()) -> Program:
    """Return the targets of a data file.

    Args:
        source: Data file, ``.dtx``.
        others: Programs (``.pgx``) of the application, and projects (``.pjx``), which state the unit of length.

    Raises:
        InputError: The text is no data file, is truncated, or belongs to a project in inches.
    """
    text = mask(source.text, _COMMENT)
    if _SIGN.search(text) is None:
        raise source.error("is not a VAL3 data file: it has no Database of VAL3/Data", fix=_FIX)
    if "</Database" not in text:
        raise source.error("is truncated: it has no </Database>", len(text), _FIX)
    if any(_INCH.search(other.text) for other in others if other.file.lower().endswith(".pjx")):
        raise source.error("belongs to a project in inches (millimeterUnit is false)", fix="set it to millimetres")
    values = _values(text)
    code = read_code([other for other in others if other.file.lower().endswith(".pgx")])
    tree = FrameTree({kind: _entries(values.get(kind, [])) for kind in ("frame", "tool")}, code.changed)
    draft = Draft(source, Dialect.val3)
    dropped: dict[int, str] = {}
    index: dict[str, int] = {}
    for kind in ("pointRx", "jointRx"):
        for value in values.get(kind, []):
            number = _add(draft, kind, value, tree)
            if number is None:
                continue
            index[value.name] = number
            if (place := code.changed.get(value.name.partition("[")[0].lower())) is not None:
                dropped[number] = f"{place} changes it at run time"
    _add_motions(draft, code, index, tree)
    return draft.program(dropped)


def _values(text: str) -> dict[str, list[_Value]]:
    """Return the values of every array by type; their attributes lie at their places in the text."""
    result: dict[str, list[_Value]] = {}
    for data in _DATA.finditer(text):
        head = {match[1]: match[2] or match[3] or "" for match in _ATTRIBUTE.finditer(data[1])}
        if data[2] is None or "name" not in head:
            continue
        for value in _VALUE.finditer(text, data.start(2), data.end(2)):
            attributes = {match[1]: match for match in _ATTRIBUTE.finditer(text, value.start(1), value.end(1))}
            key = attributes["key"][2] or attributes["key"][3] if "key" in attributes else "0"
            entry = _Value(f"{head['name']}[{key}]", attributes, value.start(), value.end())
            result.setdefault(head.get("type", ""), []).append(entry)
    return result


def _entries(values: Sequence[_Value]) -> dict[str, Entry]:
    """Return frames or tools by name, as numbers in m and rad; a missing number is zero."""
    result = {}
    for value in values:
        numbers = []
        for key in _POSE:
            unit = 1e-3 if len(key) == 1 else _DEGREE
            number = value.number(key, unit)
            numbers.append(0.0 if value.text(key) is None else math.nan if number is None else number.value * unit)
        result[value.name.lower()] = Entry(tuple(numbers), (value.text("fatherId") or "").lower())
    return result


def _add(draft: Draft, kind: str, value: _Value, tree: FrameTree) -> int | None:
    """Add a point or joints; return its index, or None where its numbers are not all written."""
    is_joint = kind == "jointRx"
    keys = _JOINTS if is_joint else _POSE
    numbers = [value.number(key, 1e-3 if len(key) == 1 else _DEGREE) for key in keys]
    known = [number for number in numbers if number is not None]
    if len(known) < len(keys):
        draft.note(value.start, value.end, f"{value.name} lacks some of its numbers, so it is set at run time, or zero")
        return None
    if is_joint:
        return draft.add(value.name, Convention.joints, known)
    father = value.text("fatherId")
    base = None if father is None else ProgramFrame(father, tree.base(father.lower()))
    words = [text for key in _CONFIGURATION if (text := value.text(key)) is not None]
    return draft.add(value.name, Convention.moving_xyz, known, configuration=" ".join(words), base=base)


def _add_motions(draft: Draft, code: Val3Code, index: dict[str, int], tree: FrameTree) -> None:
    """Add the motions of the programs to targets of this file, and notes on those whose target is computed."""
    numbers = {name.lower(): number for name, number in index.items()}
    arrays: dict[str, list[int]] = {}
    for name, number in numbers.items():
        arrays.setdefault(name.partition("[")[0], []).append(number)
    for motion in code.motions:
        frame = ProgramFrame(motion.tool, tree.tool(motion.tool.lower())) if motion.tool else None
        if motion.element is None:
            draft.notes.append(motion.note("the target is computed at run time"))
            continue
        chosen = [numbers[motion.element]] if motion.element in numbers else arrays.get(motion.element, [])
        for number in chosen:
            draft.moves.append(motion.move(number, frame if draft.targets[number].kind == "cartesian" else None))
