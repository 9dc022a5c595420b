"""Reports of coordinate measuring machines: a line for each axis of a point, with nominal and measured values.

Tables of such lines become tables of points (:func:`points`), and so do tables of commanded positions and deviations,
and tables with several targets in each row (:func:`targets_in_rows`). Texts of PC-DMIS and DMIS, which are no tables,
are read too.
"""

from __future__ import annotations

import hashlib
import io
import itertools
import re
from collections.abc import Sequence
from typing import BinaryIO

import numpy as np

from robacc.errors import Problem, listing, refuse
from robacc.geometry import NDArray
from robacc.io.column_table import ColumnTable
from robacc.io.dialect import NUMBER
from robacc.io.files import bytes_of, clip, decode
from robacc.io.table import Table, TableBody, TableOptions, TextTable
from robacc.poses.reading import AXES, DEVIATIONS, UNITS, heading_of, is_point_name, labelled, meaning_of, source_of
from robacc.poses.reshaped_tables import MEASURED, ReshapedTable, Rows, points_in_rows

_AXIS_NAMES = frozenset(
    {"axis", "achse", "coordinate", "koordinate", "coord", "component", "komponente", "control", "characteristic", "ax"}
    | {"axe", "eje", "asse"}
)
_NOMINAL = frozenset(
    {"nominal", "nom", "soll", "sollwert", "nennwert", "nennmaß", "commanded", "cmd", "reference", "ref"}
)
_MEASURED_LESS_NOMINAL = frozenset(
    {"dev", "deviation", "abweichung", "abw", "écart", "ecart", "desviación", "scarto", "偏差"}
)
"""Words of deviations, whose sign inspection software defines; a difference or an error may have either."""
_POINT_NAMES = frozenset({"featureid", "feature id", "id"})
"""Names of columns of points in a report that are none in other tables."""
_AXIS = re.compile(
    r"(?:m|pos(?:ition)?|act|ist)?[\W_]*([xyz])(?:[\W_]*(?:value|wert|achse|axis|coord\w*|koord\w*))?\d?", re.IGNORECASE
)
"""Text of an axis: ``X``, ``MX``, ``xValue``, ``X1``."""
_POINT_AND_AXIS = (
    re.compile(r"(?P<point>.*[^\W_].*?)[\W_]+(?P<axis>[xyz])", re.IGNORECASE),
    re.compile(r"(?P<axis>[xyz])[\W_]*(?:value|wert)[\W_]+(?P<point>.+)", re.IGNORECASE),
)
"""Name of a point with its axis: ``Point1_X``, ``P1.Y``, ``X-Value_Point1``."""


def points(table: Table) -> Table | None:
    """Return a table with measured points for a report without columns of them; None for another table."""
    return _by_axes(table) or _with_deviations(table)


def _coordinates(table: Table, group: str, columns: Sequence[int]) -> dict[str, int | None]:
    """Return the names of coordinates with the units in the names of their columns, and these columns."""
    units = (heading_of(table.names[index]).unit for index in columns)
    names = (
        f"{group} {axis.upper()}".strip() + (f" [{unit}]" if unit else "")
        for axis, unit in zip(AXES, units, strict=True)
    )
    return dict(zip(names, columns, strict=True))


def targets_in_rows(table: Table, target_names: Sequence[str] | None) -> Table | None:
    """Return a table with a row for each target of one that has several in each row: ``X1, Y1, Z1, X2, Y2, Z2``.

    In a protocol of repetitions, which has a column of cycles but no commands, they are the poses of a cycle.
    """
    by_label = points_in_rows(table.names)
    targets = [label if target_names is None else _target_of(label, target_names) for label in by_label]
    if not by_label or not all(columns.keys() >= {*AXES} for columns in by_label.values()):
        return None
    points = [[columns[axis] for axis in AXES] for columns in by_label.values()]
    units = [
        {table.cell_units.get(index) or heading_of(table.names[index]).unit for index in columns}
        for columns in zip(*points, strict=True)
    ]
    headings = [heading_of(name) for name in table.names]
    siblings = frozenset(heading.text for heading in headings)
    keys = {meaning.key for heading in headings if (meaning := meaning_of(heading, siblings)) is not None}
    are_poses = None in targets and "cycle" in keys and not any(re.fullmatch(r"q\d+|pose", key) for key in keys)
    kind, column = ("pose", "Name") if are_poses else ("target", "target")
    targets = [*by_label] if are_poses else targets
    is_matched = None not in targets and len({*targets}) == len(targets)
    if not is_matched or any(len(names) > 1 for names in units) or siblings & {"target", "smr", "reflector"}:
        return None
    new = {**_coordinates(table, "", points[0]), column: None}
    new |= {} if are_poses or siblings & {"visit", "arrival"} else {"visit": None}
    parts = (f"{', '.join(table.names[i] for i in p)} of {kind} {t}" for p, t in zip(points, targets, strict=True))

    def make(old: TableBody) -> Rows:
        rows = np.repeat(np.arange(old.lines.size), len(points))
        coordinates = old.numbers.reshape(len(points), 3, -1).transpose(1, 2, 0).reshape(3, -1)
        names = np.tile(np.array(targets, dtype=str), old.lines.size)
        return (rows[None], [*coordinates, names, old.lines.astype(str)[rows]])

    used = [*itertools.chain(*points)]
    return ReshapedTable(table, used, new, (used, []), make, f"several {kind}s in each row: {'; '.join(parts)}")


def _target_of(label: str, names: Sequence[str]) -> str | None:
    """Return the robot's target that a label stands for: its name, or the target with the same number."""
    exact = [name for name in names if name.lower() == label]
    number = re.search(r"\d+$", label)
    ends = ((name, re.search(r"\d+$", name)) for name in names)
    alike = [name for name, end in ends if number and end and int(number[0]) == int(end[0])]
    is_certain = len(alike) == 1 and (label.isdecimal() or alike[0].isdecimal())
    return exact[0] if exact else alike[0] if is_certain else None


def _with_deviations(table: Table) -> Table | None:
    """Return a table with measured positions for one of commanded ones and deviations; None for another table."""
    headings = [heading_of(name) for name in table.names]
    siblings = frozenset(heading.text for heading in headings)
    sets: dict[tuple[str, ...], dict[str, int]] = {}
    for i, heading in enumerate(headings):
        label, axis = labelled(heading) or ((), "turn")
        meaning = meaning_of(heading, siblings)
        is_commanded = meaning is not None and meaning.key == axis and bool(meaning.commanded)
        if axis in AXES and (is_commanded or DEVIATIONS & {*label} or source_of(heading.words) >= 0):
            sets.setdefault(label, {}).setdefault(axis, i)
    sets = {label: columns for label, columns in sets.items() if columns.keys() >= {*AXES}}
    deviations = [label for label in sets if DEVIATIONS & {*label}]
    others = [label for label in sets if label not in deviations]
    if len(deviations) != 1 or len(others) != 1 or source_of(others[0]) > 1:
        return None
    commanded, added = ([sets[label][axis] for axis in AXES] for label in (*others, *deviations))
    units = [headings[columns[0]].unit or table.cell_units.get(columns[0]) for columns in (commanded, added)]
    scale = UNITS[units[0]][1] / UNITS[units[1]][1] if units[0] and units[1] else 1.0
    names, differences = (listing([table.names[i] for i in columns]) for columns in (commanded, added))
    remark = f"{names} taken as commanded, with {differences} added as measured"
    if not {*deviations[0]} & _MEASURED_LESS_NOMINAL:
        sign = f"{differences} taken as measured less commanded; if they are the opposite, change their sign"
        table.log.warn(sign, of_file=True)

    def make(old: TableBody) -> Rows:
        position, deviation = old.numbers[: len(AXES)], old.numbers[len(AXES) :]
        return np.arange(old.lines.size)[None], [*position, *(position + scale * deviation)]

    new = {**_coordinates(table, "Nominal", commanded), **_coordinates(table, "Measured", commanded)}
    return ReshapedTable(table, {*commanded, *added}, new, ([*commanded, *added], []), make, remark)


def _by_axes(table: Table) -> Table | None:
    """Return a table of points for one that has a row for each axis of a point; None for another table.

    The axis is in a column of its own, or in the names.
    """
    words = [heading_of(name).words for name in table.names]
    measured = [i for i, texts in enumerate(words) if texts and set(texts) <= MEASURED]
    nominal = [i for i, texts in enumerate(words) if _NOMINAL & set(texts) and set(texts) <= _NOMINAL | MEASURED]
    axis = [i for i, texts in enumerate(words) if len(texts) == 1 and texts[0] in _AXIS_NAMES]
    axis = axis or [i for i, texts in enumerate(_sampled(table)) if _are_axes(texts)][:1]
    if len(axis) != 1 or len(measured) != 1 or len(nominal) > 1:
        return None
    values = [*measured, *nominal]
    names = [table.names[i] for i in (*axis, *values)]
    points = [i for i, name in enumerate(table.names) if is_point_name(name) or heading_of(name).text in _POINT_NAMES]
    texts = [*axis, *[i for i in points if i not in (*axis, *values)][:1]] if axis[0] not in points else axis
    new: dict[str, int | None] = {**_coordinates(table, "", measured * 3)}
    new |= _coordinates(table, "Nominal", nominal * 3) if nominal else {}
    new |= {"Name": None} if len(texts) > 1 or axis[0] in points else {}
    remark = f"one row for each axis joined: {names[0]} is the axis, {names[1]} the measured"
    remark += f" and {names[2]} the commanded value" if nominal else " value"

    def make(old: TableBody) -> Rows:
        rows, labels = _rows_of_points(old, table, names[0])
        return rows, [*(value[row] for value in old.numbers for row in rows), *[labels[rows[0]]] * ("Name" in new)]

    table.sparse = frozenset(texts)
    return ReshapedTable(table, {*texts, *values}, new, (values, texts), make, remark)


def _sampled(table: Table) -> list[list[str]]:
    """Return the texts of the first rows in each column of a table."""
    width = len(table.names)
    rows = [row for row in table.dialect.sample if len(row) == width]
    return [[row[i] for row in rows if row[i]] or [""] for i in range(width)]


def _are_axes(texts: Sequence[str]) -> bool:
    """Return whether most of the texts stand for an axis; others may be of a diameter or another characteristic."""
    axes = [_axis_of(text) for text in texts]
    return {*AXES} <= {*axes} and 2 * axes.count(None) < len(axes)


def _axis_of(text: str) -> str | None:
    """Return the axis that a text stands for, or that a name has; None for another text."""
    match = _AXIS.fullmatch(text.strip())
    return match[1].lower() if match else _point_and_axis(text)[1]


def _point_and_axis(text: str) -> tuple[str, str | None]:
    """Return the name of a point without its axis, and the axis; the text and None where it has none."""
    matches = filter(None, (form.fullmatch(text.strip()) for form in _POINT_AND_AXIS))
    return next(((match["point"], match["axis"].lower()) for match in matches), (text, None))


def _rows_of_points(old: TableBody, table: Table, name: str) -> tuple[NDArray[np.int64], NDArray[np.str_]]:
    """Return the rows ``(3, P)`` of the x, y and z of each point without a gap, and the name of the point of each row.

    A remark names rows of other axes; ``name`` is the column of axes.
    """
    texts = old.texts[0].tolist()
    axes = [_axis_of(text) or text.strip().lower() for text in texts]
    labels = [*old.texts[-1].tolist()]
    # A name may stand in the first row of its point only.
    labels = [*itertools.accumulate(labels, lambda above, label: label or above)]
    split = [*map(_point_and_axis, labels)]
    if all(found == axis for (_, found), axis in zip(split, axes, strict=True) if axis in AXES):
        labels = [point for point, _ in split]
    elif len(old.texts) == 1:
        labels = [""] * len(axes)
    points: list[tuple[str, dict[str, int]]] = []
    for row, (axis, label) in enumerate(zip(axes, labels, strict=True)):
        if axis in AXES and not (points and points[-1][0] == label and axis not in points[-1][1]):
            points.append((label, {}))
        if axis in AXES:
            points[-1][1][axis] = row
    for label, by_axis in points:
        missing = [axis.upper() for axis in AXES if axis not in by_axis]
        line = int(old.lines[min(by_axis.values())])
        if missing and table.log.gaps:
            table.log.gaps.add(line)
        elif missing:
            point = f"point {clip(label)}" if label else "the point"
            table.log.add(
                f"{point} has no row for {' and '.join(missing)}",
                line,
                fix="the rows of one point stand below each other, one for each of X, Y and Z",
            )
    others = (text for text, axis in zip(texts, axes, strict=True) if axis not in AXES)
    unused = listing([*dict.fromkeys(clip(text.upper()) for text in others)])
    if not points:
        table.log.add(f"found {unused or 'no rows'}, expected rows for X, Y and Z", None, name)
    elif unused:
        table.log.remarks.append(f"rows of {unused} not used")
    complete = [[by_axis[axis] for axis in AXES] for _, by_axis in points if len(by_axis) == len(AXES)]
    return np.array(complete, dtype=np.int64).reshape(-1, 3).T, np.array(labels, dtype=str)


# Texts of PC-DMIS, with a block for each dimension, and of DMIS (ISO 22093), with a line for each feature.

_DIMENSION = re.compile(r"^[ \t]*DIM [^\n=]+=.*?(\S+)\s+(?:UNITS|EINHEITEN|UNIT\S+)\s*=\s*(\w+)", re.MULTILINE)
"""Beginning of a block: the name of the feature, and its unit."""
_HEAD = re.compile(r"AX\s+\S+.*")
_FEATURE = re.compile(
    r"^(FA?)\(([^)]+)\)\s*=\s*FEAT/\w+,(?:\w+,)*CART,\s*(\S+?)\s*,\s*(\S+?)\s*,\s*([^,\s]+)", re.MULTILINE
)
"""Nominal (F) or measured (FA) point of a feature."""
_COLUMNS = (("nom", "nenn", "soll"), ("meas", "mess", "act", "ist", "mis"))
"""Beginnings of the names of nominal and of measured values in several languages."""
_UNITS = re.compile(r"^UNITS/(\w+)", re.MULTILINE)


def takes(path: str, first: bytes) -> bool:
    """Return whether a text is a report of PC-DMIS or the output of DMIS."""
    text = first.decode(errors="replace")
    return bool(_DIMENSION.search(text) or _FEATURE.search(text))


def read_stream(stream: BinaryIO, file: str, options: TableOptions) -> Table:
    """Return the points of a report as a table.

    Raises:
        InputError: The file is not text.
    """
    data = bytes_of(stream, file)
    text, digest = decode(data, file), hashlib.sha256(data).hexdigest()
    if features := _FEATURE.findall(text):
        table: Table = _of_features(features, text, file, options, digest)
    else:
        # Each row stays in its line.
        lines = "\n".join(_rows_of_blocks(text))
        table = TextTable(io.BytesIO(lines.encode()), file, options)
        table.sha256 = digest
    return table


def _of_features(
    features: Sequence[tuple[str, ...]], text: str, file: str, options: TableOptions, digest: str
) -> ColumnTable:
    unit = match[1].lower() if (match := _UNITS.search(text)) else "mm"
    by_kind = {kind: {name: point for found, name, *point in features if found == kind} for kind in ("F", "FA")}
    names = list(by_kind["FA"])
    cells = [(name, cell) for _, name, *point in features for cell in point]
    wrong = next((f"{cell} of {name}, expected a number" for name, cell in cells if not NUMBER.fullmatch(cell)), None)
    fix = "export the points that were measured: FA(name)=FEAT/POINT,CART,x,y,z"
    refuse(
        (not names, Problem("has no features that were measured", file, fix=fix)),
        (wrong is not None, Problem(f"found {wrong}", file)),
    )
    columns = [("Name", np.array(names))]
    for kind, label in (("FA", ""), ("F", "Nominal ")):
        if {*names} <= by_kind[kind].keys():
            points = np.array([by_kind[kind][name] for name in names], dtype=object)
            columns += [(f"{label}{axis} [{unit}]", points[:, i].astype(float)) for i, axis in enumerate("XYZ")]
    return ColumnTable(columns, file, options.skip_gaps, digest, "features of DMIS")


def _rows_of_blocks(text: str) -> list[str]:
    """Return a line of a table, or an empty one, for each line of a report of PC-DMIS."""
    name, unit, head, has_names = "", "", list[str](), False
    rows = []
    for line in text.splitlines():
        row, fields = "", line.split()
        if dimension := _DIMENSION.match(line):
            name, unit = dimension[1], dimension[2].lower()
        elif _HEAD.match(line.strip()):
            head = [field.lower() for field in fields]
            if not has_names:
                row = "\t".join(["Feature", "Axis", "Nominal", "Measured"])
                has_names = True
        elif head and name and fields and _AXIS.fullmatch(fields[0]) and len(fields) >= len(head):
            values = dict(zip(head, fields, strict=False))
            nominal, measured = (
                next((value for key, value in values.items() if key.startswith(stems)), "") for stems in _COLUMNS
            )
            row = "\t".join([name, fields[0], f"{nominal} {unit}", f"{measured} {unit}"])
        rows.append(row)
    return rows
