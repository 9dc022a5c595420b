"""What the names of a foreign table's columns may stand for, and the choice among names that compete for a meaning."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from robacc.io.problem_log import ProblemLog
from robacc.io.table_parts import Header
from robacc.poses.columns import FIXED_KINDS, Column, Names
from robacc.poses.headings import Heading, Meaning, heading_of, is_of_ros, meaning_of
from robacc.poses.single_point import single_point


@dataclass(frozen=True, slots=True)
class HeadingCandidate:
    """A column, and the documented column that its name may stand for."""

    heading: Heading
    index: int
    meaning: Meaning
    key: str


def choose(header: Header, known: Mapping[str, Column], names: Names, log: ProblemLog) -> dict[str, HeadingCandidate]:
    """Return the column for each key that the names stand for; what they leave open goes to ``log``.

    Args:
        header: Names in the file.
        known: Columns whose names are documented; they stay as they are.
        names: The robot's joints.
        log: Takes questions.
    """
    used = {column.index for column in known.values()}
    candidates = [candidate for candidate in _candidates(header, names, log) if candidate.index not in used]
    candidates = _with_quaternion(candidates, known, log, header.line)
    candidates = [candidate for candidate in candidates if candidate.key not in known]
    return _without_conflicts(_renumbered(candidates), log, header.line)


def _candidates(header: Header, names: Names, log: ProblemLog) -> Iterator[HeadingCandidate]:
    headings = [_heading(i, header, log) for i in range(len(header.names))]
    siblings = frozenset(heading.text for heading in headings)
    numbered = single_point(siblings)
    for i, heading in enumerate(headings):
        joint = _named_joint(heading, names)
        known = meaning_of(heading, siblings) or numbered.get(heading.text)
        meaning = Meaning(joint, si=is_of_ros(heading)) if joint else known
        if meaning is None:
            continue
        key = meaning.key
        if meaning.commanded and key in FIXED_KINDS and f"cmd_{key}" in FIXED_KINDS:
            key = f"cmd_{key}"
        yield HeadingCandidate(heading, i, meaning, key)


def _heading(index: int, header: Header, log: ProblemLog) -> Heading:
    """Return a column's heading with the unit behind its numbers; log a unit that its name contradicts."""
    heading, unit = heading_of(header.names[index]), header.cell_units.get(index)
    if unit is None or heading.unit == unit:
        return heading
    if heading.unit is not None:
        log.add(f"the cells are in {unit}, but the name is of {heading.unit}", header.line, heading.name)
    return replace(heading, unit=unit)


def _named_joint(heading: Heading, names: Names) -> str | None:
    """Return the key of the robot's joint whose name stands in the heading."""
    text = heading.name.lower()
    for i, name in enumerate(names.joint_names):
        if len(name) > 2 and re.search(rf"(?<![a-z0-9_]){re.escape(name.lower())}(?![a-z0-9])", text):
            others = set(re.findall(r"[a-z]+", text.replace(name.lower(), " ")))
            if not others & {"velocity", "effort", "vel", "speed", "torque", "acceleration", "current", "error"}:
                return f"q{i + 1}"
    return None


def _with_quaternion(
    candidates: Sequence[HeadingCandidate], known: Mapping[str, Column], log: ProblemLog, line: int | None
) -> list[HeadingCandidate]:
    """Return the candidates with Q0 … Q3 beside joints of other names as a quaternion, whose scalar part is Q0.

    Of Q1 … Q4 the first or the last may be the scalar part: a question.
    """
    numbered = {item.heading.text: item for item in candidates if re.fullmatch(r"q \d", item.heading.text)}
    others = [item for item in candidates if item.heading.text not in numbered]
    numbers = sorted(int(text[-1]) for text in numbered)
    has_joints = any(re.fullmatch(r"q\d+", key) for key in (*(item.key for item in others), *known))
    if not has_joints or numbers not in ([0, 1, 2, 3], [1, 2, 3, 4]) or {"qw", "qx"} & {item.key for item in others}:
        return list(candidates)
    if numbers[0] == 0:
        return others + [
            replace(numbered[f"q {number}"], key=key, meaning=replace(numbered[f"q {number}"].meaning, key=key))
            for number, key in enumerate(("qw", "qx", "qy", "qz"))
        ]
    names = ", ".join(numbered[f"q {number}"].heading.name for number in numbers)
    fix = (
        "name them qw, qx, qy, qz or qx, qy, qz, qw in a column map, which robacc init writes and `columns` takes; "
        "leave them empty there if they are no orientation"
    )
    log.add("these may be a quaternion with its scalar part first or last", line, names, fix)
    return others


def _renumbered(candidates: Sequence[HeadingCandidate]) -> list[HeadingCandidate]:
    """Return the candidates with joints numbered from 1 where the file numbers them from 0."""
    numbers = {int(item.key[1:]) for item in candidates if re.fullmatch(r"q\d+", item.key)}
    if 0 not in numbers:
        return list(candidates)
    return [
        HeadingCandidate(item.heading, item.index, item.meaning, f"q{int(item.key[1:]) + 1}")
        if re.fullmatch(r"q\d+", item.key)
        else item
        for item in candidates
    ]


def _without_conflicts(
    candidates: Sequence[HeadingCandidate], log: ProblemLog, line: int | None
) -> dict[str, HeadingCandidate]:
    """Return one candidate a key; two that are equally good are a question."""
    by_key: dict[str, list[HeadingCandidate]] = {}
    for candidate in candidates:
        by_key.setdefault(candidate.key, []).append(candidate)
    result: dict[str, HeadingCandidate] = {}
    read_back: dict[str, HeadingCandidate] = {}
    for key, items in by_key.items():
        if re.fullmatch(r"q\d+", key):
            # The commanded joints are wanted; attained ones stand in where the file has no others, else beside them.
            if read := _read_back(items):
                read_back[f"read_{key}"] = read
            items = (
                [item for item in items if item.meaning.commanded]
                or [item for item in items if item.meaning.commanded is None]
                or items
            )
        if len(items) > 1 and FIXED_KINDS.get(key) != "text":
            listed = " or ".join(repr(item.heading.name) for item in items)
            log.add(f"found several columns for {key}: {listed}", line, fix="choose with `columns`")
        result[key] = items[0]
    joints = [key for key in result if re.fullmatch(r"q\d+", key)]
    return result | (read_back if len(read_back) == len(joints) else {})


def _read_back(items: Sequence[HeadingCandidate]) -> HeadingCandidate | None:
    """Return the attained joint of a commanded and an attained joint in the same unit; else None."""
    commanded = [item for item in items if item.meaning.commanded is not False]
    attained = [item for item in items if item.meaning.commanded is False]
    if len(commanded) != 1 or len(attained) != 1 or commanded[0].heading.unit != attained[0].heading.unit:
        return None
    return attained[0]
