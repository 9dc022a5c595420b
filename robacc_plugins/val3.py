"""Staubli VAL3 data files (``.dtx``) and the motions of ``.pgx`` programs to their points.

Sources of the layout and of R = Rx(rx) Ry(ry) Rz(rz): two public generators of VAL3 programs (RoboDK's post-processor,
visose/Robots) and a public worked example of nested frames, which agree.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path, PureWindowsPath
from typing import NamedTuple

from robacc.errors import refuse
from robacc.geometry import rotation_from_quaternion, rotation_from_rpy, transpose
from robacc.programs.program import (
    Convention,
    Program,
    ProgramFrame,
    ProgramNote,
    ProgramNumber,
    ProgramSource,
    ProgramTarget,
)
from robacc.robots.description import Frame
from robacc_plugins.dialects import (
    AXIS_UNITS,
    POSE_UNITS,
    RUN_TIME,
    Draft,
    Place,
    arguments,
    mask,
    nearest_angles,
    numbers,
)

SIGN = re.compile(r"<Database\b[^>]*/VAL3/Data/")
_COMMENT = re.compile(r"<!--.*?-->", re.S)
_DATA = re.compile(r"<Data\b([^>]*?)(?:/>|>(.*?)</Data\s*>)", re.S)
_VALUE = re.compile(r"<Value\b([^>]*?)/?>", re.S)
_ATTRIBUTE = re.compile(r"""([\w:.-]+)\s*=\s*(["'])((?:(?!\2)[\s\S])*)\2""")
_INCH = re.compile(r"""\bmillimeterUnit\s*=\s*["']false["']""")
_KEYS = {"pointRx": ("x", "y", "z", "rx", "ry", "rz"), "jointRx": tuple(f"j{i}" for i in range(1, 7))}
_ROOTS = {"frame": "world[0]", "tool": "flange[0]"}
_FIX = "export the application from the controller or Stäubli Robotics Suite again"

_HIDDEN = re.compile(r'//[^\r\n]*|"[^"\r\n]*"|<!--.*?-->', re.S)
_OUTSIDE = re.compile(r"(?:\A|\]\]>)(?:(?!<!\[CDATA\[).)*(?:<!\[CDATA\[|\Z)", re.S)
"""Text of a program around its sections of code."""
_MOTION = re.compile(r"\bmov(e[jlc])\s*\(")
_ELEMENT = re.compile(r"(?:\w+\s*:\s*)?(\w+)\s*(?:\[\s*(.*?)\s*\])?\Z", re.S)
_ASSIGNED = re.compile(r"\b(\w+)\s*(?:\[[^\]\r\n]*\])?(?:\s*\.\s*\w+)*\s*=(?!=)")
_LINKED = re.compile(r"\b(?:link|setFrame)\s*\(([^)]*)\)")


MOVING_XYZ = Convention(
    # The inverse of the rotation by the opposite angles about fixed axes.
    lambda angles: transpose(rotation_from_rpy(-angles)),
    lambda quaternions, near: -nearest_angles(transpose(rotation_from_quaternion(quaternions)), -near),
)
"""x, y, z, rx, ry, rz with R = Rx(rx) Ry(ry) Rz(rz)."""


class _Val3Value(NamedTuple):
    """Element ``Value`` of an array of data."""

    name: str
    """``pPick[0]``"""
    place: Place
    attributes: Mapping[str, str]
    places: Mapping[str, Place]
    """Place of each attribute's text."""


def companions(path: str) -> list[str]:
    """Return the paths of the programs and projects in the folder of a data file, by name."""
    paths = sorted(Path(path).parent.iterdir()) if path.lower().endswith(".dtx") else []
    return [os.fspath(other) for other in paths if other.suffix.lower() in (".pgx", ".pjx") and other.is_file()]


def parse(source: ProgramSource, others: Sequence[ProgramSource] = ()) -> Program:
    """Return the targets of a data file.

    Args:
        source: Data file, ``.dtx``.
        others: Programs (``.pgx``) of the application, and projects (``.pjx``), which state the unit of length.

    Raises:
        InputError: The text is no data file, is truncated, or belongs to a project in inches.
    """
    text = mask(source.text, _COMMENT)
    in_inches = any(_INCH.search(other.text) for other in others if other.file.lower().endswith(".pjx"))
    inches = "belongs to a project in inches (millimeterUnit is false)"
    refuse(
        (not SIGN.search(text), source.problem("is not a VAL3 data file: it has no Database of VAL3/Data", fix=_FIX)),
        ("</Database" not in text, source.problem("is truncated: it has no </Database>", len(text), _FIX)),
        (in_inches, source.problem(inches, fix="set it to millimetres")),
    )
    values = _values(text)
    programs = [(other, _code(other.text)) for other in others if other.file.lower().endswith(".pgx")]
    changed: dict[str, str] = {}
    for program, code in programs:
        words = [(match.start(), match[1]) for match in _ASSIGNED.finditer(code)]
        words += [(match.start(), word) for match in _LINKED.finditer(code) for word in re.findall(r"\w+", match[1])]
        for position, word in words:
            changed.setdefault(word.lower(), f"line {program.line(position)} of {_name(program)}")
    frames = {kind: {value.name.lower(): value for value in values.get(kind, ())} for kind in _ROOTS}
    draft = Draft(source, "val3")
    targets: dict[str, int] = {}
    for kind in _KEYS:
        for value in values.get(kind, ()):
            written = _written(text, kind, value)
            if written is None:
                reason = f"{value.name} lacks some of its numbers, so it is set at run time, or zero"
                draft.note(value.place, reason)
                continue
            father = value.attributes.get("fatherId") if kind == "pointRx" else None
            base = None if father is None else ProgramFrame(father, _frame(text, frames, "frame", father, changed))
            index = draft.add(value.name, written, base=base)
            if index is not None:
                targets[value.name.lower()] = index
                if (place := changed.get(_array(value.name))) is not None:
                    draft.dropped[index] = f"{place} changes it at run time"
    for program, code in programs:
        for match in _MOTION.finditer(code):
            places, end = arguments(code, match.end())
            n_targets = 2 if match[1] == "ec" else 1
            element = _ELEMENT.match(code, *places[n_targets]) if len(places) > n_targets else None
            name = f"{element[1]}[{element[2] or '0'}]" if element else ""
            tool = ProgramFrame(name, _frame(text, frames, "tool", name, changed)) if element else None
            line, excerpt = program.line(match.start()), program.excerpt(match.start(), end + 1)
            for argument in places[:n_targets]:
                element = _ELEMENT.match(code, *argument)
                if element is None:
                    draft.notes.append(ProgramNote(line, f"{_name(program)}: {excerpt}", RUN_TIME))
                    continue
                array, number = element[1].lower(), element[2] or "0"
                # An element that is chosen at run time may be any of its array.
                chosen = (
                    [f"{array}[{number}]"] if number.isdecimal() else [key for key in targets if _array(key) == array]
                )
                draft.moves += [
                    (index, tool if draft.targets[index].kind == "cartesian" else None, None)
                    for index in (targets[key] for key in chosen if key in targets)
                ]
    return draft.program()


def _name(program: ProgramSource) -> str:
    return PureWindowsPath(program.file).name


def _array(name: str) -> str:
    """Return the name of the array of an element, in small letters."""
    return name.partition("[")[0].lower()


def _code(text: str) -> str:
    """Return a program with blanks in place of comments, strings and, where sections of code are marked, XML."""
    return mask(mask(text, _OUTSIDE) if "<![CDATA[" in text else text, _HIDDEN)


def _values(text: str) -> dict[str, list[_Val3Value]]:
    """Return the values of every array by type."""
    result: dict[str, list[_Val3Value]] = {}
    for data in _DATA.finditer(text):
        head = {match[1]: match[3] for match in _ATTRIBUTE.finditer(data[1])}
        if data[2] is None or "name" not in head:
            continue
        for value in _VALUE.finditer(text, *data.span(2)):
            found = list(_ATTRIBUTE.finditer(text, *value.span(1)))
            attributes = {match[1]: match[3] for match in found}
            name = f"{head['name']}[{attributes.get('key', '0')}]"
            places = {match[1]: match.span(3) for match in found}
            result.setdefault(head.get("type", ""), []).append(_Val3Value(name, value.span(), attributes, places))
    return result


def _written(text: str, kind: str, value: _Val3Value) -> ProgramTarget | None:
    """Return a point or joints; None where a number lacks."""
    places = [value.places[key] for key in _KEYS[kind] if key in value.places]
    if kind == "jointRx":
        axes = numbers(text, places, AXIS_UNITS)
        return None if axes is None else ProgramTarget(None, axes)
    pose = numbers(text, places, POSE_UNITS)
    words = [value.attributes[key] for key in ("shoulder", "elbow", "wrist") if key in value.attributes]
    return None if pose is None else ProgramTarget(MOVING_XYZ, pose, " ".join(words))


def _frame(
    text: str,
    frames: Mapping[str, Mapping[str, _Val3Value]],
    kind: str,
    name: str,
    changed: Collection[str],
    depth: int = 0,
) -> Frame | None:
    """Return a frame in the world, or a tool in the flange's frame; None where it is not known before run time."""
    name = name.lower()
    name = name if "[" in name or kind == "frame" else f"{name}[0]"
    if name == _ROOTS[kind]:
        return Frame()
    value = frames[kind].get(name)
    # A frame that is its own father, over some others, has no place.
    if value is None or depth > len(frames[kind]) or _array(name) in changed:
        return None
    father = _frame(text, frames, kind, value.attributes.get("fatherId", ""), changed, depth + 1)
    native: list[ProgramNumber] = []
    for key, unit in zip(_KEYS["pointRx"], POSE_UNITS, strict=True):
        place = value.places.get(key)
        native += (ProgramNumber(0, 0, 0.0, unit),) if place is None else numbers(text, [place], [unit]) or ()
    if father is None or len(native) != len(POSE_UNITS):
        return None
    return Frame.of(father.pose @ ProgramTarget(MOVING_XYZ, tuple(native)).frame.pose)
