"""Layout of a pose file: what each of its columns is taken for, whether each set of columns is complete, its values."""

import difflib
import itertools
import re
from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from robacc.errors import MAX_PROBLEMS, Note, by_key, listing
from robacc.geometry import Array, NDArray
from robacc.io.files import ProblemLog, clip
from robacc.io.table import Table
from robacc.measurements import MOVES_UNUSED, Measurements
from robacc.poses.reading import (
    AS_NAMED,
    AXES,
    BY_SIGHT,
    COMMANDED_AXES,
    CORRELATIONS,
    FIXED_KINDS,
    INSTRUMENT,
    JOINT_COLUMN,
    NAME_UNITS,
    ORIENTATIONS,
    QUATERNION,
    ROTATION_VECTOR,
    SIGMAS,
    TIME_KEYS,
    UNITS,
    Column,
    Heading,
    Kind,
    KnownRobot,
    Meaning,
    Reading,
    heading_of,
    is_point_name,
    labelled,
    meaning_of,
    source_of,
    split_unit,
    time_column,
)
from robacc.poses.reshaped_tables import advice_on_points

_QUANTITIES: Mapping[str, tuple[str, ...]] = {"length": ("length",), "angle": ("angle",), "joint": ("length", "angle")}
"""Quantities of the units that each kind of column may have; one of these units it needs."""
QUANTITY = {kind: quantities[-1] for kind, quantities in _QUANTITIES.items()}
"""Quantity of each kind of column that needs a unit; a joint of unknown type turns."""
_UNIT_OF_KEY = {"temperature_c": "degC", "payload_kg": "kg", **dict.fromkeys(("time_s", *TIME_KEYS), "s")}


class Names(NamedTuple):
    """Names that a column may have in one file, for one robot."""

    robot: KnownRobot
    header: Sequence[str | None]
    """Names of the columns, or those that a column map gives them; None for a column that is not read."""
    keys: Mapping[str, str]
    """Key of each joint's name, also behind ``dir_``, ``speed_`` and ``read_``; those of joints outside the chain are
    ``branch_q1 …``."""

    @classmethod
    def of(cls, header: Sequence[str | None], robot: KnownRobot) -> "Names":
        """Return the names for a robot in a file with this header."""
        names = tuple(robot.joint_names or ())
        # A robot whose joints are called q0 … q5 has a q1 that is the second of them. The documented numbering goes
        # first where the file has all of it; then the joints' names, where the file has all of those.
        bare = {text for name in header if name for text in (name, split_unit(name)[0])}
        from_zero = [f"q{i}" for i in range(len(names))]
        if {*from_zero} <= bare and f"q{len(names)}" not in bare:
            names = tuple(from_zero)
        by_name = set(names) <= bare and not {f"q{i + 1}" for i in range(len(names))} <= bare
        labels = {branch.name: (f"branch_q{i + 1}", False) for i, branch in enumerate(robot.branches)}
        for (i, name), prefix in itertools.product(enumerate(names), ("", "dir_", "speed_", "read_")):
            labels[f"{prefix}{name}"] = f"{prefix}q{i + 1}", by_name
        keys = {
            label: key
            for label, (key, goes_first) in labels.items()
            if label not in FIXED_KINDS and (goes_first or not JOINT_COLUMN.fullmatch(label))  # it means nothing else
        }
        return cls(robot, header, keys)

    def key(self, name: str) -> str | None:
        """Return the key of a name without unit; None for an unknown name."""
        if name in self.keys:
            return self.keys[name]
        name = re.sub(r"^cmd_(?=q[1-9]\d{0,2}$)", "", name, flags=re.ASCII)  # another name of a commanded joint
        return name if name in FIXED_KINDS or JOINT_COLUMN.fullmatch(name) else None

    def kind(self, key: str) -> Kind:
        """Return the kind of a key's column; a joint of unknown type may be an angle or a length."""
        if key in FIXED_KINDS:
            return FIXED_KINDS[key]
        stem, _, number = key.rpartition("q")
        if stem in ("dir_", "speed_"):
            return "ratio"
        is_branch = stem == "branch_"
        types = [branch.type for branch in self.robot.branches] if is_branch else [*(self.robot.joint_types or ())]
        joint_type = next(iter(types[int(number) - 1 :]), None)
        return "joint" if joint_type is None else "length" if joint_type == "prismatic" else "angle"


@lru_cache(1024)
def nearest_name(name: str, joint_names: tuple[str, ...]) -> str:
    """Return the known name most similar to ``name``, with or without a unit; each of many readings asks for it."""
    joints = joint_names or tuple(f"q{i + 1}" for i in range(6))
    bare = {**FIXED_KINDS, **dict.fromkeys(joints, "joint")}
    motions = (f"{prefix}{joint}" for prefix in ("dir_", "speed_", "read_") for joint in joints)
    suffixed = (
        f"{stem}_{unit}"
        for stem, kind in bare.items()
        for unit in NAME_UNITS
        if UNITS[unit][0] in _QUANTITIES.get(kind, ())
    )
    # The start of the name is enough: the cost of the comparison grows with the length of both names.
    return difflib.get_close_matches(name[:64].lower(), [*bare, *motions, *suffixed], n=1, cutoff=0.0)[0]


class Layout(NamedTuple):
    """Columns in use, by key, and what the names of an export leave open."""

    columns: Mapping[str, Column]
    """By key; for times, the keys of :data:`~robacc.poses.reading.TIME_KEYS`; joints outside the chain have the keys
    ``branch_q1 …``."""
    names: Names
    unused: Sequence[str] = ()
    """Names in the file that are not read."""
    angles: Mapping[str, tuple[str, ...]] = MappingProxyType({})
    """Conventions that the angles may belong to, by the prefix of their keys: ``""`` or ``cmd_``; without an entry they
    are documented."""
    without_unit: tuple[Column, ...] = ()
    """Lengths and angles whose unit is stated nowhere."""
    wrong_unit: bool = False
    """Whether a heading states a unit of another quantity."""
    unit_of_position: tuple[str, ...] = ()
    """Keys of uncertainties whose unit is taken to be that of the position."""

    @property
    def n_joints(self) -> int:
        """Number of the robot's joints, or of joint columns where no robot is known; 0 without joint columns."""
        matches = [match for key in self.columns if (match := JOINT_COLUMN.fullmatch(key))]
        numbers = [int(match[2]) for match in matches if not match[1]] or [int(match[2]) for match in matches]
        return len(self.names.robot.joint_names or ()) or max(numbers, default=0)

    def joints(self, prefix: str = "") -> tuple[str, ...]:
        """Return the keys of all joints' columns, ``q1 … qN``, with a prefix ``dir_``, ``speed_`` or ``read_``."""
        return tuple(f"{prefix}q{i + 1}" for i in range(self.n_joints))

    def has(self, keys: Sequence[str]) -> bool:
        """Return whether the file has all of a set of columns."""
        return bool(keys) and set(keys) <= self.columns.keys()

    def orientation(self, prefix: str = "") -> tuple[str, ...] | None:
        """Return the keys of the attained or ``cmd_`` orientation's three or four columns."""
        groups = (tuple(f"{prefix}{name}" for name in group) for group in ORIENTATIONS)
        return next(filter(self.has, groups), None)


def read_layout(
    table: Table,
    robot: KnownRobot,
    attained: bool = True,
    reading: Reading = AS_NAMED,
    commands: bool = True,
) -> Layout:
    """Return the columns of a table; every problem goes to its log, and a column with a problem is left out.

    Args:
        table: Table whose names are known; its log takes duplicates, wrong units, and columns missing from a set.
        robot: The robot's joints, and those beside its chain, which may have columns.
        attained: Whether the attained position is required.
        reading: Statements of the user on names that leave a question open.
        commands: Whether joints or commanded poses are required.
    """
    log, line = table.log, table.line
    for stated in [name for name in reading.columns or () if name not in table.names]:
        nearest = difflib.get_close_matches(stated, table.names, n=1, cutoff=0.6)
        hint = f"; did you mean {clip(nearest[0])}?" if nearest else ""
        log.add(f"the map names a column {clip(stated)}, which the file does not have{hint}", line)
    names = Names.of([(reading.columns or {}).get(name, name) for name in table.names], robot)
    layout = documented_columns(table, names, reading)
    has_commands = any(
        key.startswith("cmd_") or (JOINT_COLUMN.fullmatch(key) and not key.startswith("read_"))
        for key in layout.columns
    )
    is_repeated = "pose" in layout.columns and not layout.names.robot.joint_names
    siblings = frozenset(heading_of(name).text for name in table.names)
    turned = {getattr(meaning_of(heading_of(name), siblings), "key", "") for name in layout.unused}
    if reading.columns is None and (
        not table.dialect.is_documented
        or (attained and not layout.has(AXES))
        or not (has_commands or (is_repeated or not commands if attained or commands else layout.has(AXES)))
        # A target's offset turns with the orientation of commands from another file.
        or (not (commands or attained) and layout.orientation() is None and turned >= {*ROTATION_VECTOR})
    ):
        # The names are not all documented: notes say what each was taken for.
        layout = find_columns(table, layout, reading)
    else:
        # Names that say enough beside documented ones: of times, and of the poses of commands.
        of_time = ("time_s", "time", ("time", "timestamp", "t").__contains__)
        open_keys = [of_time] if attained and commands else [of_time, ("pose", "pose", is_point_name)]
        for documented, key, says in open_keys if reading.columns is None else []:
            name = next(filter(says, filter(None, layout.unused)), None)
            if name is not None and documented not in layout.columns:
                columns = {**layout.columns, key: Column(name, table.names.index(name), key, "text", None)}
                layout = layout._replace(columns=columns, unused=[other for other in layout.unused if other != name])
        unknown = Counter(filter(None, layout.unused))
        for name in [name for name, count in unknown.items() if count > 1]:
            log.add("the column is a duplicate", line, clip(name), "keep one of them")
        texts = [
            f"unknown column {clip(name)} is ignored; the nearest known name is "
            f"{documented_name(name) or nearest_name(name, tuple(names.robot.joint_names or ()))!r}"
            for name in [*unknown][:MAX_PROBLEMS]
        ]
        texts += [f"… and {len(unknown) - MAX_PROBLEMS} more unknown columns"] * (len(unknown) > MAX_PROBLEMS)
        if unnamed := sum(not name for name in layout.unused):
            texts.append(f"columns without a name are ignored: {unnamed}")
        for text in texts:
            log.warn(text, line)
    _check_sets(layout, table, robot, attained, commands)
    return layout


def documented_columns(table: Table, names: Names, reading: Reading = AS_NAMED) -> Layout:
    """Return the columns whose names, or whose entries in a column map, are documented."""
    columns: dict[str, Column] = {}
    unknown: list[str] = []
    for index, name in enumerate(names.header):
        column = None if name is None else _documented_column(name, index, names, table, reading)
        if name is not None and column is None:
            unknown.append(name)
        elif column is not None and (first := columns.setdefault(column.key, column)) is not column:
            of = "" if first.name == column.name else f" of {first.name}"
            table.log.add(f"the column is a duplicate{of}", table.line, name, "keep one of them")
    return Layout(columns, names, unknown)


_EXPECTED = {"angle": ("an angle", " (rad, mrad, deg)"), "length": ("a length", " (m, mm, um)")}


def _documented_column(name: str, index: int, names: Names, table: Table, reading: Reading) -> Column | None:
    """Return the column of a documented name, None for an unknown name; log units that do not fit."""
    stem, unit = (name, None) if names.key(name) else split_unit(name)
    label = table.names[index]
    if (key := names.key(stem)) is None:
        return None if reading.columns is None else time_column(name, index, label)
    kind = names.kind(key)
    fitting = _QUANTITIES.get(kind, ())
    of_cells = None if kind == "text" else table.cell_units.get(index)
    if unit is not None and UNITS[unit][0] not in fitting:
        expected = "".join(_EXPECTED.get(kind, ("no unit",)))
        table.log.add(f"found unit {unit} in the name, expected {expected}", table.line, name)
        unit = None
    stated = unit or _UNIT_OF_KEY.get(key)
    if of_cells and stated and stated != of_cells:
        table.log.add(f"the cells are in {of_cells}, but the name is of {stated}", table.line, label)
    elif of_cells and not stated and UNITS[of_cells][0] not in fitting:
        expected = _EXPECTED.get(kind, ("a plain number",))[0]
        table.log.add(f"the cells are in {of_cells}, expected {expected}", table.line, label)
    elif of_cells and not stated:
        unit = of_cells
    is_uncertainty = reading.columns is not None and key in (*SIGMAS, "sigma_r")
    coverage = (reading.coverage or 1.0) if is_uncertainty else 1.0
    return Column(label, index, key, kind, unit or reading.unit_of.get(QUANTITY.get(kind, "")), coverage)


def _check_sets(layout: Layout, table: Table, robot: KnownRobot, attained: bool, commands: bool) -> None:
    """Log sets of columns that are incomplete or given twice, and what the file lacks."""
    log, line, columns, joint_names, count = table.log, table.line, layout.columns, robot.joint_names, layout.n_joints
    ignored = [name for name in layout.unused if name]
    rules = "".join(
        f"; {clip(name)} is outside the robot's chain, so write the column {rule}"
        for name in ignored
        if (rule := robot.outside.get(name) or robot.outside.get(split_unit(name)[0]))
    )
    unknown = f" (unknown in this file: {listing(ignored)}){rules}" if ignored else ""

    def check_set(keys: Sequence[str], set_name: str, required: bool = False, fix: str = "", counts: str = "") -> None:
        missing = [key for key in keys if key not in columns]
        if missing and (required or len(missing) < len(keys)):
            are_missing = f"columns {listing(missing)} are" if len(missing) > 1 else f"column {missing[0]} is"
            fix = fix or f"expected {', '.join(keys)}: {set_name}"
            log.add(f"{counts}{are_missing} missing", line, fix=fix + unknown)

    commanded = any(key.startswith("cmd_") for key in columns)
    words = {word for name in layout.unused for word in (name.lower(), *heading_of(name).words)}
    forms = (
        (True, advice_on_points(layout.unused)),
        (
            words & {"az", "azimuth", "hz", "horizontal", "theta"} and words & {"dist", "distance", "range", "d", "r"},
            "the file has angles and distances of an instrument; export X, Y and Z",
        ),
        (
            words & {"axis", "achse", "coordinate"} and words & {"actual", "measured", "ist"},
            "the file has one row for each axis; export one row for each point, with its X, Y and Z",
        ),
    )
    others = ", or of other measurements socket, plane, distance, or u_px and v_px"
    check_set(
        AXES,
        "the attained position" + others * columns.keys().isdisjoint(AXES),
        attained,
        next((text for applies, text in forms if applies and text), "") if attained else "",
    )
    check_set(COMMANDED_AXES, "the commanded position", commanded)
    check_set(CORRELATIONS, "the correlations of the measuring uncertainty")
    check_set(INSTRUMENT, "the place of the instrument in the measuring frame")
    beside = {SIGMAS: CORRELATIONS, BY_SIGHT: INSTRUMENT}
    for set_name, groups in (
        ("the attained orientation", ORIENTATIONS),
        ("the commanded orientation", [tuple(f"cmd_{name}" for name in group) for group in ORIENTATIONS]),
        ("the measuring uncertainty of a position", [*beside]),
    ):
        present = [keys for keys in groups if not columns.keys().isdisjoint((*keys, *beside.get(keys, ())))]
        for keys in present:
            check_set(keys, set_name, True)
        if len(present) > 1:
            sets_text = " and ".join(", ".join(keys) for keys in present)
            log.add(f"{set_name} is given more than once: {sets_text}", line, fix="keep one of them")
    check_set(layout.joints("read_"), "the joint variables as read back")
    joint_numbers = sorted(int(key[1:]) for key in columns if JOINT_COLUMN.fullmatch(key) and key[0] == "q")
    if joint_numbers:
        quaternion = "; if q1 … q4 are a quaternion, as ABB writes it, name them qw, qx, qy, qz or use `columns`"
        fix = f"expected q1 … q{count} without a gap"
        fix += f", or the joints' names {listing(joint_names)}" if joint_names else ""
        fix += quaternion * (joint_numbers == [1, 2, 3, 4])
        counts = f"the robot has {count} joints, the file has columns for {len(joint_numbers)}: " if joint_names else ""
        check_set(layout.joints(), "", True, fix, counts)
    # Without the attained position, which is required, that is the problem of the file.
    elif commands and not commanded and (not attained or layout.has(AXES)) and (joint_names or "pose" not in columns):
        keys_text = f"q1 … q{count}" if joint_names else "q1 … qN"
        fix = "give the commands with `commanded`: the robot program, or a table of joints or poses; or " * attained
        fix += f"add columns {keys_text} (joint variables) or cmd_x, cmd_y, cmd_z (commanded pose)"
        message = f"the file has {'measured poses only: ' * attained}neither joint variables nor commanded poses"
        log.add(message, line, fix=fix + unknown)
    for key, column in columns.items():
        if (match := JOINT_COLUMN.fullmatch(key)) and int(match[2]) > count:
            last = f"the robot has {count} joints" if joint_names else f"the last joint column is q{count}"
            log.add(f"the column belongs to joint {match[2]}, but {last}", line, column.name)


# Positions beside each other: those of the controller and of an instrument, of a body and of its markers.


def measured_position(table: Table, names: Names) -> tuple[list[Heading], set[int]]:
    """Return headings without the words of the position that was measured, and the columns of its rivals.

    The rivals stay as commands where the file has no others.

    Of several positions that of an instrument is the measured one, else an attained one, else that without a word, last
    the controller's. A body has an orientation, its markers have none. Two that are equally likely are a question.

    Args:
        table: Table of the headings; its log takes the question.
        names: Names that columns may have.
    """
    headings = [heading_of(name) for name in table.names]
    siblings = frozenset(heading.text for heading in headings)
    keys = [_named_joint(heading, names) or getattr(meaning_of(heading, siblings), "key", "") for heading in headings]
    joints = any(map(_JOINT.fullmatch, keys))
    places: dict[tuple[str, ...], dict[str, int]] = {}
    turned: dict[tuple[str, ...], list[int]] = {}
    for i, heading in enumerate(headings):
        label, part = labelled(heading) or ((), "")
        if part == "turn":
            turned.setdefault(label, []).append(i)
        elif part:
            while part in places.get(label, ()):
                label = (*label, "repeated")
            places.setdefault(label, {})[part] = i
    ranks = {label: source_of(label) for label, axes in places.items() if len(axes) == len(AXES)}
    if joints and max(ranks.values(), default=0) == 1:
        ranks |= {label: 1 for label in ranks if {"ref", "reference"} & {*label}}
    ranks = {label: rank for label, rank in ranks.items() if rank >= 0}
    best = [label for label, rank in ranks.items() if rank == max(ranks.values())]
    bodies = [label for label in best if len(turned.get(label, ())) >= len(AXES)]
    # A controller's pose has an orientation, too.
    best = bodies if len(bodies) == 1 and not (joints and len(best) == 2) else best
    if len(best) > 1 and (() in best or (joints and len(bodies) == 1)):
        texts = [", ".join(headings[i].name for i in places[label].values()) for label in best]
        table.log.add(
            f"found several positions: {' or '.join(map(repr, texts))}",
            table.line,
            fix="say with `columns` which was measured",
        )
        best = best[:1]
    is_target = any(1 < len(axes) < len(AXES) and source_of(label) == 1 for label, axes in places.items())
    if len(best) != 1 or (ranks[best[0]] == 0 and len(ranks) == 1) or (is_target and ranks[best[0]] == 1):
        return headings, set()
    result, rivals = [*headings], [label for label in ranks if label not in best]
    said = (best[0], *rivals) if len(rivals) == 1 else best
    for label, i in ((of, i) for of in said for i in (*places[of].values(), *turned.get(of, ()))):
        words = tuple(word.replace("phi", "r") for word in headings[i].words if word not in label)
        result[i] = headings[i]._replace(words=words)
    # An axis alone, such as X_Value, is none of a position, and stray markers are no commands.
    alone = [label for label in places if label not in ranks and best[0]]
    strays = [label for label in rivals if "repeated" in label]
    unread = [i for label in (*alone, *strays) for i in places[label].values()]
    result = [item._replace(words=()) if i in unread and source_of(item.words) > 0 else item
              for i, item in enumerate(result)]  # fmt: skip
    rivals = [label for label in rivals if label not in strays]
    return result, {i for label in rivals for i in (*places[label].values(), *turned.get(label, ()))}


# What the names of a foreign table's columns may stand for, and the choice among names that compete for a meaning.

_JOINT = re.compile(r"q\d+")
_CANDIDATES: Mapping[str, tuple[str, ...]] = {
    "axes": ("rotvec", "fixed-xyz", "moving-xyz"),
    "abc": ("kuka-abc", "fixed-xyz", "moving-xyz", "zyz"),
    "abg": ("kuka-abc", "fixed-xyz", "moving-xyz"),
    "wpr": ("fixed-xyz",),
    "oat": ("zyz",),
    "ur": ("rotvec",),
    "quaternion": ("wxyz", "xyzw"),
}
"""Conventions that a family of angle names may belong to; one alone is certain."""
_PREAMBLE_UNITS = (
    r"(?i)(?:\b(?:units?|einheit(?:en)?)\b\W*|^\W*(?=\w+\W*$))(?P<unit>mm|millimet\w+|met\w+|m|in|inch\w*)\b"
)


class _Candidate(NamedTuple):
    """A column, and what its name may stand for."""

    place: int
    """Index in the file."""
    heading: Heading
    meaning: Meaning
    rival: bool
    """Whether another position was measured, so that this one is commanded."""


def _candidates(known: Layout, table: Table, headings: Sequence[Heading], rivals: Set[int]) -> list[_Candidate]:
    """Return what the names stand for, by keys; a unit behind the numbers that a name contradicts goes to the log."""
    result = []
    siblings = frozenset(heading.text for heading in headings)
    for i, heading in enumerate(headings):
        unit = table.cell_units.get(i, heading.unit)
        if heading.unit not in (None, unit):
            table.log.add(f"the cells are in {unit}, but the name is of {heading.unit}", table.line, heading.name)
        joint = _named_joint(heading, known.names)
        meaning = Meaning(joint) if joint else meaning_of(heading, siblings)
        if meaning is not None:
            rival = i in rivals and not _JOINT.fullmatch(meaning.key)
            meaning = meaning._replace(commanded=True) if rival else meaning
            result.append(_Candidate(i, heading._replace(unit=unit), meaning._replace(key=meaning.full_key), rival))
    keys = {*known.columns, *(item.meaning.key for item in result if not item.rival)}
    has_commands = any(_JOINT.fullmatch(key) or key.startswith("cmd_") for key in keys)
    used = {column.index for column in known.columns.values()}
    # One uncertainty may be of all axes that have none of their own.
    return [
        item._replace(meaning=item.meaning._replace(key=key))
        for item in result
        if item.place not in used and not (item.rival and has_commands)
        for key in (
            [axis for axis in SIGMAS if axis not in keys] if item.meaning.key == "sigma" else [item.meaning.key]
        )
    ]


_ROS_FIELD = r"(^|[./])(position|translation|orientation|rotation)[./][xyzw]$|[./]position$"
"""Path of a ROS message's field, whose unit is SI (REP 103)."""
_NOT_READ = frozenset({"velocity", "effort", "vel", "speed", "torque", "acceleration", "current", "error"})
"""Words beside the name of a joint that make it another quantity."""


def _named_joint(heading: Heading, names: Names) -> str | None:
    """Return the key of the robot's joint whose name stands in the heading."""
    text, joints = heading.name.lower(), [name.lower() for name in names.robot.joint_names or ()]
    if (match := re.fullmatch(r"(?:observation\.state|positions?)_(\d+)", text)) and int(match[1]) <= len(
        joints
    ):  # a list
        return f"q{match[1]}"
    keys = (
        f"q{i}"
        for i, name in enumerate(joints, 1)
        if len(name) > 2 and re.search(rf"(?<![a-z0-9_]){re.escape(name)}(?![a-z0-9])", text)
        if _NOT_READ.isdisjoint(re.findall(r"[a-z]+", text.replace(name, " ")))
    )
    return next(keys, None)


def _chosen(known: Layout, table: Table, headings: Sequence[Heading], rivals: Set[int]) -> dict[str, _Candidate]:
    """Return the column for each key that the names stand for; two that are equally good are a question."""
    candidates = _candidates(known, table, headings, rivals)
    counted = {item.heading.text: i for i, item in enumerate(candidates) if re.fullmatch(r"q \d", item.heading.text)}
    others = {item.meaning.key for i, item in enumerate(candidates) if i not in counted.values()}
    is_quaternion = sorted(counted) == ["q 1", "q 2", "q 3", "q 4"] and not {"qw", "qx"} & (others - {*known.columns})
    if is_quaternion and any(map(_JOINT.fullmatch, others | {*known.columns})):
        # Q1 … Q4 beside joints of other names are a quaternion, in an order that is open.
        for name, key in zip(sorted(counted), QUATERNION, strict=True):
            candidates[counted[name]] = candidates[counted[name]]._replace(meaning=Meaning(key, family="quaternion"))
    candidates = [item for item in candidates if item.meaning.key not in known.columns]
    # Joints are counted from 1.
    shift = int(any(item.meaning.key == "q0" for item in candidates))
    keys = (item.meaning.key for item in candidates)
    shifted = (f"q{int(key[1:]) + shift}" if _JOINT.fullmatch(key) else key for key in keys)
    found = by_key(zip(shifted, candidates, strict=True))
    result: dict[str, _Candidate] = {}
    read_back: dict[str, _Candidate] = {}
    for key, items in found.items():
        if _JOINT.fullmatch(key):
            # The commanded joints are wanted; attained ones stand in where the file has no others, else beside them.
            attained = [item for item in items if item.meaning.commanded is False]
            items = [item for item in items if item.meaning.commanded is not False]
            if len(attained) == len(items) == 1 and attained[0].heading.unit == items[0].heading.unit:
                read_back[f"read_{key}"] = attained[0]
            items = [item for item in items if item.meaning.commanded] or items or attained
        if len(items) > 1 and FIXED_KINDS.get(key) != "text":
            listed = " or ".join(repr(item.heading.name) for item in items)
            table.log.add(f"found several columns for {key}: {listed}", table.line, fix="choose with `columns`")
        result[key] = items[0]
    return result | (read_back if len(read_back) == sum(map(bool, map(_JOINT.fullmatch, result))) else {})


def find_columns(table: Table, known: Layout, reading: Reading) -> Layout:
    """Return the columns that the names of a table stand for; ambiguous names and missing units go to its log.

    Args:
        table: Table whose names are taken; its log takes notes of what each was taken for.
        known: Columns whose names are documented; they stay as they are.
        reading: Statements of the user.
    """
    headings, rivals = measured_position(table, known.names)
    known = known._replace(columns={key: item for key, item in known.columns.items() if item.index not in rivals})
    chosen = _chosen(known, table, headings, rivals)
    is_open = {key: item.meaning.expanded and reading.coverage is None for key, item in chosen.items()}
    expanded = dict.fromkeys(item.heading.name for key, item in chosen.items() if is_open[key])
    chosen = {key: item for key, item in chosen.items() if not is_open[key]}
    of_preamble, remark = None, ""
    # A line above the table may state the unit of length.
    if stated_unit := next(filter(None, (re.search(_PREAMBLE_UNITS, line) for line in table.dialect.preamble)), None):
        of_preamble = {"mm": "mm", "mil": "mm", "m": "m", "met": "m"}.get(stated_unit["unit"].lower()[:3], "in")
        remark = f"lengths in {of_preamble}, as {stated_unit[0].strip(' ([')!r} says"
    columns = {
        **known.columns,
        **{key: _column(key, item, known.names, reading, of_preamble, table) for key, item in chosen.items()},
    }
    nameless = [columns[key] for key in chosen if columns[key].unit is None and columns[key].kind in QUANTITY]
    without_unit = [column for column in nameless if chosen[column.key].heading.unit is None]
    angles = {
        "cmd_" if key.startswith("cmd_") else "": _CANDIDATES[item.meaning.family]
        for key, item in chosen.items()
        if item.meaning.family and not JOINT_COLUMN.fullmatch(key)
    }
    remarks = ["joint variables are attained values, used as commands"] * any(
        item.meaning.commanded is False and JOINT_COLUMN.fullmatch(key) for key, item in chosen.items()
    )
    units = {columns[axis].unit for axis in AXES if axis in columns}
    unit = next(iter(units)) if len(units) == 1 else None
    sigmas = [column for column in without_unit if column.key in SIGMAS and unit is not None]
    if sigmas:
        # Uncertainties without a unit have that of the position.
        columns |= {column.key: replace(column, unit=unit) for column in sigmas}
        text = compact([column.name for column in sigmas])
        remarks.append(f"{text} taken as {unit}, the unit of {columns['x'].name}; `units` states another")
    taken = {column.index for column in columns.values()}
    free = [(i, name) for i, name in enumerate(table.names) if i not in taken]
    unused = [name for _, name in free if name]
    is_moving = {i: len({row[i : i + 1] for row in table.dialect.sample}) > 1 for i, _ in free}
    moving = [name for i, name in free if re.fullmatch(r"(?:.*[^a-z])?E\d\b.*", name) and is_moving[i]]
    ways = "1 for a standard uncertainty, 2 for an expanded one with coverage factor 2"
    stated = statement(columns, known.columns)
    for text in (
        f"columns: {stated}" if stated else "",
        f"not used: {', '.join(_with_suggestion(name, known.names) for name in unused)}" if unused else "",
        *remarks,
        remark,
        f"{', '.join(moving)} {MOVES_UNUSED}" if moving else "",
        f"to use the uncertainties {compact([*expanded])}, give `coverage`: {ways}" if expanded else "",
    ):
        if text:
            table.log.warn(Note(text), table.line)
    return Layout(
        columns,
        known.names,
        unused,
        angles,
        without_unit=tuple(column for column in without_unit if column not in sigmas),
        wrong_unit=len(without_unit) < len(nameless),
        unit_of_position=tuple(column.key for column in sigmas),
    )


def _with_suggestion(name: str, names: Names) -> str:
    """Return a name in quotes, with the documented name that it resembles."""
    known = nearest_name(name, tuple(names.robot.joint_names or ()))
    # Similarity of two names (0 to 1) from which one may be a slip of the other.
    is_similar = difflib.SequenceMatcher(None, name[:64].lower(), known).ratio() >= 0.8
    return f"{clip(name)} (did you mean {known}?)" if is_similar else clip(name)


def _column(
    key: str, candidate: _Candidate, names: Names, reading: Reading, of_preamble: str | None, table: Table
) -> Column:
    heading, meaning = candidate.heading, candidate.meaning
    kind: Kind = "text" if key in TIME_KEYS else names.kind(key)
    quantity = QUANTITY.get(kind, "")
    fitting = _QUANTITIES.get(kind) or ((UNITS[_UNIT_OF_KEY[key]][0],) if key in _UNIT_OF_KEY else ())
    unit = heading.unit if fitting else None
    if unit and UNITS[unit][0] not in fitting:
        expected = f"expected a unit of {fitting[-1]}"
        table.log.add(f"found unit {unit} for {key}, {expected}", table.line, heading.name)
        unit = None
    if quantity and unit is None:
        is_si = meaning.family == "ur" or (not meaning.family and re.search(_ROS_FIELD, heading.name))
        of_all, si_unit = (of_preamble, "m") if quantity == "length" else (None, "rad")
        unit = of_all or reading.unit_of.get(quantity) or (si_unit if is_si else None)
    coverage = (reading.coverage or 1.0) if meaning.expanded else meaning.coverage
    return Column(heading.name, candidate.place, key, kind, unit, coverage)


def statement(columns: Mapping[str, Column], documented: Mapping[str, Column]) -> str:
    """Return which column was taken for what, without the columns whose names are documented."""
    taken = sorted((column for key, column in columns.items() if key not in documented), key=lambda item: item.index)

    def run(item: tuple[int, Column]) -> object:
        """Return what joints that follow each other have in common."""
        match = re.fullmatch(r"(read_)?q(\d+)", item[1].key)
        return (match[1], item[1].unit, int(match[2]) - item[0]) if match else item[1].key

    parts = []
    for _, group in itertools.groupby(enumerate(taken), run):
        pairs = [
            (column.name, "time_s" if column.key in TIME_KEYS else f"{column.label}{factor}")
            for _, column in group
            for factor in [f" times {column.coverage:g}" if column.coverage != 1 else ""]
        ]
        if len(pairs) > 2:
            pairs = [(f"{pairs[0][0]} … {pairs[-1][0]}", f"{pairs[0][1]} … {pairs[-1][1]}")]
        parts += [f"{name} -> {key}" for name, key in pairs]
    return ", ".join(parts)


def documented_name(name: str) -> str | None:
    """Return the documented name that another name stands for; None where it stands for none."""
    heading = heading_of(name)
    meaning = meaning_of(heading, frozenset())
    if meaning is None or meaning.key in TIME_KEYS or meaning.key not in FIXED_KINDS:
        return None
    key = meaning.full_key
    takes_unit = FIXED_KINDS[key] in ("length", "angle") and heading.unit in NAME_UNITS
    return f"{key}_{heading.unit}" if takes_unit else key


def compact(names: Sequence[str]) -> str:
    """Return the names, of many only the first and the last ones."""
    return ", ".join(names) if len(names) <= 9 else f"{', '.join(names[:4])}, …, {', '.join(names[-2:])}"


# Values of the columns of a pose file.


class Values(NamedTuple):
    """Values of the columns in use, SI."""

    layout: Layout
    numbers: Array
    """``(C, N)``; NaN where a value could not be read."""
    row_index: Mapping[str, int]
    """Row of ``numbers`` by key; the keys of a set are adjacent."""
    texts: Mapping[str, NDArray[np.str_]]
    lines: NDArray[np.int64]
    """``(N,)`` line of the file, from 1."""
    log: ProblemLog
    """Takes problems, warnings and notes of the file."""
    header: int | None
    """Line of the columns' names."""

    @property
    def keys(self) -> Measurements:
        """Names, times and lines of the rows, which they are joined to those of another file by."""
        position, gaps = np.zeros((3, self.lines.size)), tuple(self.log.gaps)
        return Measurements(
            position, pose=self.texts.get("pose"), time=self.column("time_s"), rows=self.lines, gaps=gaps
        )

    def column(self, key: str) -> Array | None:
        """Return one column ``(N,)``; None where the file does not have it."""
        return self.numbers[self.row_index[key]] if key in self.row_index else None

    def column_set(self, keys: Sequence[str]) -> Array | None:
        """Return a set of columns ``(len(keys), N)`` without copying; None where one of them is missing."""
        if not keys or any(key not in self.row_index for key in keys):
            return None
        start = self.row_index[keys[0]]
        return self.numbers[start : start + len(keys)]

    def rows(self, index: NDArray[Any]) -> "Values":
        """Return some of the rows."""
        return self._replace(
            numbers=self.numbers[:, index],
            texts={key: text[index] for key, text in self.texts.items()},
            lines=self.lines[index],
        )
