"""Reader of logs: values of a controller or an instrument that stand in other text, as programs print them.

Values are lists, as ``[[x,y,z],[q1,q2,q3,q4],[cf],[eax]]`` of RAPID, ``j:{j1,…,j6}{EJ …}`` of ROKAE and
``p[x,y,z,rx,ry,rz]`` of URScript, and numbers behind their names, as ``{E6POS: X 1.0, Y 2.0, …}`` of KRL,
``J1 = 1.0 deg`` of FANUC and ``X=1.0 Y=2.0``. A pose begins where its first value comes again.
"""

from __future__ import annotations

import hashlib
import io
import itertools
import re
from collections.abc import Iterator, Sequence
from typing import BinaryIO, NamedTuple

import numpy as np

from robacc.errors import Problem, by_key, refuse
from robacc.geometry import NDArray, quaternion_from_rotation, rotation_from_rpy
from robacc.io.column_table import ColumnTable
from robacc.io.files import bytes_of, decode
from robacc.io.table import Table, TableOptions, TextTable

_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_NUMBERS = rf"{_NUMBER}(?:\s*,\s*{_NUMBER})+"
_KEY = r"(?<![\w.])(?:[XYZABCWPR]|R[XYZ]|[AJ]T?\d|Roll|Pitch|Yaw)(?![\w.])"
_UNIT = r"(?:mm|deg|°)"
_VALUES = re.compile(
    rf"(?:[\[{{]\s*)?(?P<nested>[\[{{]\s*{_NUMBERS}\s*[\]}}](?:\s*,\s*[\[{{]\s*{_NUMBERS}\s*[\]}}])+)(?:\s*[\]}}])?"
    rf"|[\[({{]\s*(?P<list>{_NUMBERS})\s*[\])}}]"
    rf"|(?<=[:=])[ \t]*(?P<line>{_NUMBER}(?:[ \t]*,[ \t]*{_NUMBER}){{2,}})[ \t]*$"
    rf"|(?P<named>(?:{_KEY}\s*+[:=]?\s*+{_NUMBER}\s*+{_UNIT}?[\s,;]*+){{3,}})",
    re.IGNORECASE | re.MULTILINE,
)
"""Lists in a list or separated by commas, one list, the numbers behind a colon up to the end of a line, and numbers
behind their names."""
_NAMED = re.compile(rf"({_KEY})\s*+[:=]?\s*+({_NUMBER})\s*+({_UNIT}?)", re.IGNORECASE)
_LABEL = re.compile(r"(?P<word>[A-Za-z_]\w*)\s*(?:[(\[]\s*(?P<unit>m|mm|rad|deg|°)\s*[)\]])?\s*[:=]*\s*$")
"""Word before values, and the unit behind it."""
_POSE = re.compile(r"'([^']+)'|\b([A-Za-z]\w*?[ _]?\d+)\b")
"""Name of a pose: a text in quotes, or a word with a number at its end."""
_JOINTS = re.compile(r"joint|axis|axes|angle|movej|posj|jpos|\b[jq]\b", re.IGNORECASE)
_TURN = re.compile(r"rpy|euler|rotation|orient|quat|angle", re.IGNORECASE)
_COORDINATES = ("X", "Y", "Z")
_QUATERNION = ("Qw", "Qx", "Qy", "Qz")
_RAPID = re.compile(r"\b9E\+?0?9\b")
"""Position of an axis that an arm of ABB does not have."""
_ROKAE = re.compile(r"\b[jp]\s*:\s*\{")
"""Target of a program of ROKAE, whose units are those of RAPID."""
_SEVENTH = "J7 [deg]"
"""Joint of a target of ROKAE that an arm of six joints does not have; it is 0 then."""
_URSCRIPT = re.compile(r"\bp\[")
"""Pose of Universal Robots, whose units are m and rad."""
_KRL = re.compile(r"\{\s*(\w+:)?\s*$")
"""Beginning of a structure of KUKA, whose units are mm and degrees."""
_ABC = ("A [deg]", "B [deg]", "C [deg]")
_MOST_JOINTS = 7
_FEWEST = 2
"""Poses in the beginning of a file that make it a log."""


class _Record(NamedTuple):
    """Values of one pose."""

    values: dict[str, float]
    line: int
    name: str
    caption: str = ""
    """Words between these values and those before, in their line and in the line above, without numbers."""


class LogTable(ColumnTable):
    """Values of a log; each pose is at the line of its first value."""

    def __init__(self, records: list[_Record], file: str, options: TableOptions, sha256: str) -> None:
        """Take the poses."""
        self._lines = np.array([record.line for record in records], dtype=np.int64)
        keys = dict.fromkeys(key for record in records for key in record.values)
        columns = [(key, np.array([record.values.get(key, np.nan) for record in records])) for key in keys]
        names = np.array([record.name for record in records])
        named = [("Name", names)] if len({*names.tolist()} - {""}) == names.size else []
        remark = f"values in the text of a log: {', '.join(keys)}"
        super().__init__([*named, *columns], file, options.skip_gaps, sha256, remark)
        self.log.counted = "line"

    @property
    def places(self) -> NDArray[np.int64]:
        """Line of each pose in the file."""
        return self._lines


def takes(path: str, first: bytes) -> bool:
    """Return whether a file is a log: most of its lines with several numbers have values in lists or behind names."""
    text = first.decode(errors="replace")
    if not first or "\0" in text:
        return False
    spans = [(text.count("\n", 0, at.start()), text.count("\n", 0, at.end())) for at in _VALUES.finditer(text)]
    covered = {line for start, end in spans for line in range(start, end + 1)}
    numbered = {i for i, line in enumerate(text.splitlines()) if len(re.findall(r"\d\.\d", line)) >= len(_COORDINATES)}
    return max(len(spans), len(covered)) >= _FEWEST and 2 * len(covered & numbered) >= len(numbered)


def read_stream(stream: BinaryIO, file: str, options: TableOptions) -> Table:
    """Return the poses of a log as a table; lists that no word tells apart as numbers without a header.

    Raises:
        InputError: The file is not text, or has poses of several kinds.
    """
    data = bytes_of(stream, file)
    text = decode(data, file)
    records = [*_records(text)]
    _check_captions(records, file)
    if _ROKAE.search(text) and not any(record.values.get(_SEVENTH) for record in records):
        for record in records:
            record.values.pop(_SEVENTH, None)
    if any(record.values for record in records):
        return LogTable(records, file, options, hashlib.sha256(data).hexdigest())
    lines = (" ".join(re.findall(rf"(?<![\w.]){_NUMBER}", line)) for line in text.splitlines())
    return TextTable(io.BytesIO("\n".join(lines).encode()), file, options)


def _records(text: str) -> Iterator[_Record]:
    """Yield the poses of a log; a value that is there already begins the next one, and so does the first of all."""
    is_rapid = _RAPID.search(text) or _ROKAE.search(text)
    units = ("mm", "deg") if is_rapid else ("m", "rad") if _URSCRIPT.search(text) else None
    first, record = "", _Record({}, 0, "")
    line, start, end = 1, 0, 0
    for at in _VALUES.finditer(text):
        begin = max(text.rfind("\n", end, at.start()) + 1, end)
        above = max(text.rfind("\n", end, max(begin - 1, end)) + 1, end)
        before, caption = text[begin : at.start()], _caption(text[above : at.start()])
        name = next(("".join(found) for found in _POSE.findall(before)), "")
        line += text.count("\n", start, at.start())
        start, end = at.start(), at.end()
        for values in _named(at["named"], before) if at["named"] else [_listed(at[0], before, name, units)]:
            first = first or next(iter(values), "")
            if first in values or not record.values.keys().isdisjoint(values):
                if record.values:
                    yield record
                record = _Record({}, line, name)
            if not record.values:
                record = record._replace(caption=caption)
            record.values.update(values)
            record = record._replace(line=record.line or line, name=record.name or name)
    yield record


def _caption(text: str) -> str:
    """Return the words of a text, without numbers but that of a type."""
    return " ".join(re.findall(r"\btype\W*\d+|[^\W\d_]{2,}", text))


def _check_captions(records: Sequence[_Record], file: str) -> None:
    """Raise InputError where the captions of poses change in turn, as those of an arm and of an instrument do."""
    lines = by_key((record.caption, record.line) for record in records)
    kinds = {caption: found for caption, found in lines.items() if len(found) > 2}
    n_changes = sum(first.caption != second.caption for first, second in itertools.pairwise(records))
    has_same_values = len({tuple(record.values) for record in records}) == 1
    listed = ", ".join(f"{caption or 'none'!r} (line {found[0]})" for caption, found in kinds.items())
    message = f"has poses of {len(kinds)} kinds in turn, by their captions: {listed}"
    fix = "write the poses of the instrument and those of the arm to a file each"
    is_mixed = has_same_values and len(kinds) > 1 and 3 * n_changes > 2 * len(records)
    refuse((is_mixed, Problem(message, file, fix=fix)))


def _named(text: str, before: str) -> Iterator[dict[str, float]]:
    """Yield the values behind names; a name that comes again begins the next pose."""
    is_krl = bool(_KRL.search(before))
    values: dict[str, float] = {}
    for key, number, unit in _NAMED.findall(text):
        unit = unit or ("mm" if key in _COORDINATES else "deg") * is_krl
        column = f"{key} [{unit}]" if unit else key
        if column in values:
            yield values
            values = {}
        values[column] = float(number)
    if is_krl and {*_ABC} <= values.keys():
        # The names of the angles alone would leave their convention open.
        yaw, pitch, roll = np.radians([values.pop(key) for key in _ABC])
        quaternion = quaternion_from_rotation(rotation_from_rpy(np.array([[roll], [pitch], [yaw]])))
        values |= dict(zip(_QUATERNION, quaternion[:, 0].tolist(), strict=True))
    yield values


def _listed(text: str, before: str, name: str, units: tuple[str, str] | None) -> dict[str, float]:
    """Return the values of lists by the names of their columns; none for lists that no word says the kind of.

    Args:
        text: The lists.
        before: Text before them in their line.
        name: Name of the pose.
        units: Those of lengths and angles, where the language of the log has no others.
    """
    lists = [[float(cell) for cell in part.split(",")] for part in re.findall(_NUMBERS, text)]
    sizes = [len(part) for part in lists]
    label = _LABEL.search(before)
    word = label["word"] if label and label["word"] != name else ""
    stated = label["unit"] if label else None
    length, angle = (f" [{stated or unit}]" if stated or unit else "" for unit in units or ("", ""))
    is_rapid = units == ("mm", "deg")
    keys: list[str] = []
    if is_rapid and len(sizes) == 2 and sizes[0] > len(_COORDINATES):
        keys = [f"J{i + 1}{angle}" for i in range(sizes[0])]
    elif sizes[:2] == [3, 4]:
        # A robot target has the configuration of the arm behind its pose.
        word = "robot" if is_rapid and (len(sizes) > 2 or word == "p") else word
        quaternion = _QUATERNION if is_rapid else [f"Orientation {i}" for i in range(1, 5)]
        keys = [f"{word} {key}{length}" for key in _COORDINATES] + [f"{word} {key}" for key in quaternion]
    elif word == "p" and sizes == [6]:
        keys = [f"target_TCP_pose_{i}" for i in range(6)]
    elif _JOINTS.search(word) and sizes[0] <= _MOST_JOINTS:
        keys = [f"J{i + 1}{angle}" for i in range(sizes[0])]
    elif _TURN.search(word) and sizes == [4]:
        keys = [f"Orientation {i}" for i in range(1, 5)]
    elif (word or (label and name)) and sizes == [3] and not _TURN.search(word):
        keys = [f"{word} {key}{length}" for key in _COORDINATES]
    return dict(zip(map(str.strip, keys), [value for part in lists for value in part], strict=False))
