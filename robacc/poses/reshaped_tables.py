"""Tables of another shape: without a header, poses as matrices, one row an axis, or several targets a row."""

import itertools
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np

from robacc.errors import Note, Problem, refuse
from robacc.geometry import Array, NDArray
from robacc.io.dialect import number_of
from robacc.io.table import Table, TableBody
from robacc.plug_ins import plug_in
from robacc.poses.reading import (
    AXES,
    DEVIATIONS,
    QUATERNION,
    SAY_LITTLE,
    UNITS,
    UNKNOWN_ROBOT,
    KnownRobot,
    heading_of,
    labelled,
    source_of,
)

# Tables without a header whose form is known: TUM trajectories, and point lists of SpatialAnalyzer.

_TUM = ("time", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


def with_known_names(
    table: Table, required: bool = True, robot: KnownRobot = UNKNOWN_ROBOT, attained: bool = True, commands: bool = True
) -> tuple[str, ...]:
    """Return the names of a table, or those that the rows of a table without names show.

    Args:
        table: The table; a remark on it says how columns without names were read.
        required: Rows of no known form are an error; else their columns stay numbered.
        robot: The arm, whose motion shows which columns are joints and which are positions.
        attained: As in :func:`robacc.poses.csv_file.read_poses`.
        commands: As in :func:`robacc.poses.csv_file.read_poses`.

    Raises:
        InputError: The rows have no known form, or several forms fit.
    """
    dialect, width = table.dialect, len(table.names)
    if dialect.separator is None and " ".join(dialect.names).lower() == "timestamp tx ty tz qx qy qz qw":
        return _TUM
    if dialect.is_documented or dialect.names:
        return table.names
    cells = [[number_of(text, dialect.decimal_comma) for text in row] for row in dialect.sample if len(row) == width]
    rows = np.array(cells, dtype=float).reshape(-1, width)
    texts = np.isnan(rows).all(axis=0)
    rows = rows[np.isfinite(rows[:, ~texts]).all(axis=1)]
    if rows.size and dialect.separator is None and width == len(_TUM) and _are_unit(rows[:, 4:]):
        return _TUM
    if rows.size and width >= 16 and (rows[:, -4:] == (0, 0, 0, 1)).all():
        joints = (f"J{i + 1}" for i in range(width - 16))
        return (*joints, *(f"m_{row}{column}" for row in range(4) for column in range(4)))
    names = _of_numbers(table, rows, texts, robot, attained, commands) if required or texts.any() else None
    who = "give `robot`, whose motion shows the columns" if robot.pose_at is None else "check that the arm is `robot`"
    refuse(
        (
            names is None and required,
            Problem(
                "found numbers, expected a header row",
                table.file,
                table.line,
                fix=f"{who}; or begin the file with the columns' names, or name them with `columns`: a file with "
                "entries such as 'column 1: x_mm', which the command init writes",
            ),
        )
    )
    return names or table.names


def _are_unit(vectors: Array) -> bool:
    """Return whether vectors ``(N, K)`` are of unit length."""
    # The square of a mistaken number may be none.
    return bool((np.abs(vectors) < 2).all() and (np.abs(np.linalg.norm(vectors, axis=1) - 1) < 1e-3).all())


def _of_numbers(
    table: Table, rows: Array, texts: NDArray[np.bool_], robot: KnownRobot, attained: bool, commands: bool
) -> tuple[str, ...] | None:
    """Return names of columns of numbers where one reading is left; the remark of the table says which.

    In a file of joints and positions the motion of the arm shows which are which. In a file of either alone, their
    number does, with a count or texts before them.
    """
    width, joints = texts.size, len(robot.joint_names or ())
    steps = np.diff(rows[:, 0])
    lead = int(texts.argmin()) or int(
        len(rows) > 1
        # A time since 1970 is no coordinate.
        and (rows[:, 0].min() > 1e9 or (np.all((steps >= 1) & (steps % 1 == 0)) and width not in (3, 6, joints)))
    )
    found: dict[int, str] = {}
    if not attained and joints:
        found = {lead + i: f"J{i + 1}" for i in range(joints)} if width == lead + joints else {}
    elif (readings := _readings(rows, robot)) or (commands and attained and not texts.any()):
        found = readings[0] if len(readings) == 1 else {}
    elif width - lead in (3, 6, 7):
        found = dict(enumerate("XYZ", lead))
    if not found:
        return None
    for i in [i + 1 for i, name in found.items() if re.match(r"Z( |$)", name)]:
        # An orientation follows the position, or, in a list of SpatialAnalyzer, its uncertainty.
        is_list = texts.any() and (rows[:, i : i + 3] > 0).all()
        is_quaternion = rows.size and _are_unit(rows[:, i : i + 4])
        angles = ("Quat1 Quat2 Quat3 Quat4" if is_quaternion else "Ux Uy Uz" if is_list else "Rx Ry Rz").split()
        is_constant = len(found) > 3 and not np.ptp(rows[:, i : i + 3], axis=0).any()  # so not measured
        if {*range(i, i + len(angles))} <= {*range(width)} - {*found} and not is_constant:
            found |= dict(enumerate(angles, i))
    # A count that skips a number is that of points, of which some were not measured.
    has_names = texts[lead - 1] or (steps.size > 0 and np.median(steps) == 1 < steps.max())
    named = [found.get(i, "Name" if i == lead - 1 and has_names else f"column {i + 1}") for i in range(width)]
    reason = "only this reading agrees with the motion of the arm" if commands and attained else "by their number"
    read_as = ", ".join(found[i] for i in sorted(found))
    table.log.remarks.append(f"no header: columns {min(found) + 1} to {max(found) + 1} read as {read_as}, {reason}")
    return tuple(named)


def _readings(rows: Array, robot: KnownRobot) -> list[dict[int, str]]:
    """Return the names of columns, by index, under which positions follow the motion of the arm.

    Three positions beside the same joints, or more, are those of as many targets; of two, one may be the controller's.
    """
    joints, result = len(robot.joint_names or ()), []
    # Columns without names that are tried.
    if robot.pose_at is None or not joints or rows.shape[1] > 24:
        return []
    turns = np.array([kind != "prismatic" for kind in robot.joint_types or ["revolute"] * joints])[:, None]
    for first, (angle, length) in itertools.product(range(rows.shape[1] - joints + 1), (("rad", "m"), ("deg", "mm"))):
        q = rows[:, first : first + joints].T
        q = np.where(turns, q / UNITS[angle][1], q / UNITS[length][1])
        if not np.isfinite(q).all():
            continue
        poses = robot.pose_at(q)
        for place in {*range(rows.shape[1] - 2)} - {*range(first - 2, first + joints)}:
            if unit := unit_and_error(rows[:, place : place + 3].T, poses.translation, poses.rotation)[0]:
                units = [angle if turn else length for turn in turns.ravel()]
                names = {first + i: f"q{i + 1}_{unit}" for i, unit in enumerate(units)}
                result.append(names | {place + i: f"{AXES[i].upper()} [{unit}]" for i in range(3)})
    names = {i: name for reading in result for i, name in reading.items()}
    if len(result) > 2 and len(names) == joints + 3 * len(result):
        places = sorted([i for i, name in reading.items() if name[0] in "XYZ"] for reading in result)
        return [names | {i: f"{names[i][0]}{k}{names[i][1:]}" for k, place in enumerate(places, 1) for i in place}]
    return result


def unit_and_error(position: Array, translation: Array | None, rotation: Array | None) -> tuple[str | None, float]:
    """Return the unit in which positions ``(3, N)`` follow the poses of an arm, and the rms error that remains, m.

    A target at c of the tool, measured in another frame and unit, is at A p + s = t + R c in the frame of the arm,
    which is linear in A, s and c. The unit is None where the positions do not follow the poses.
    """
    n, eye = position.shape[1], np.eye(3)
    # 8 rows have 24 coordinates, well above the 15 parameters. No coordinate is larger in any unit: the Earth is 4e7 m
    # round.
    if translation is None or rotation is None or n < 8 or not np.abs(position).max() < 1e9:
        return None, np.inf
    centred = position - position.mean(axis=1, keepdims=True)
    of_a = np.einsum("ij,kn->nijk", eye, centred).reshape(3 * n, 9)
    design = np.hstack((of_a, np.tile(eye, (n, 1)), -np.moveaxis(rotation, 2, 0).reshape(3 * n, 3)))
    wanted = translation - translation.mean(axis=1, keepdims=True)
    solution, _, rank, _ = np.linalg.lstsq(design, wanted.T.ravel(), rcond=None)
    remaining = np.sum((design @ solution - wanted.T.ravel()) ** 2) / (3 * n - rank)
    # Largest remaining error as a share of the arm's motion: worse than any arm, and far below an unrelated motion's.
    if 3 * n * remaining >= 0.01**2 * np.sum(wanted**2):
        return None, np.inf
    scale = np.linalg.norm(solution[:9].reshape(3, 3), 2)
    # Largest difference of a length from its unit, as a share: no arm is off by this much, and units are by 25 or more.
    unit = next((unit for unit in ("m", "mm", "cm", "in") if abs(scale * UNITS[unit][1] - 1) < 0.05), None)
    return unit, float(np.sqrt(3 * remaining))


# Tables with a pose as the entries of a matrix, as hand-eye calibrations write it: ``m_00 … m_23``, ``r11 … r33``.

MATRIX_ENTRY = re.compile(r"(?P<stem>.*?[a-zA-Z])[_.\[(, ]*(?P<row>[0-4])[_., \])\[(]*(?P<column>[0-4])[\])]*")
"""Name of a column that is the entry of a matrix."""


def with_poses_of_matrices(table: Table) -> Table:
    """Return a table with quaternions, and positions, in place of the entries of matrices."""
    # Of 16 counted columns, five look like an entry: 10 to 14.
    has_entries = sum(bool(MATRIX_ENTRY.fullmatch(name.strip())) for name in table.names) >= 5
    return plug_in("robacc.readers", "hand-eye").with_poses(table) if has_entries else table


_COUNTED = dict(zip(("q0", "q1", "q2", "q3"), QUATERNION, strict=True))
MEASURED = frozenset(
    {"value", "wert", "measured", "actual", "ist", "messwert", "istwert", "istmaß", "act", "meas", "result"}
    | {"mesuré", "mesure", "medido", "misurato"}
)
"""Words of a column of measured values in a report with a row for each axis of a point."""


def reshaped(table: Table, robot: KnownRobot, attained: bool, commands: bool) -> Table:
    """Return a table with one row a measured target; the given one where it has this shape.

    Args:
        table: Table whose rows were not read yet.
        robot: The arm: its targets, and the motion that shows what columns without names are.
        attained: As in :func:`robacc.poses.csv_file.read_poses`.
        commands: As in :func:`robacc.poses.csv_file.read_poses`.
    """
    table.names = with_known_names(table, True, robot, attained, commands)
    if table.dialect.sample:
        # rostopic prints the names of joints in columns; messages list joints in any order.
        first = dict(zip(table.names, table.dialect.sample[0], strict=False))
        table.names = tuple(
            f"joint_states/{first[f'field.name{match[1]}']}/position"
            if (match := re.fullmatch(r"field\.position(\d+)", name)) and f"field.name{match[1]}" in first
            else name
            for name in table.names
        )
    table = with_poses_of_matrices(table)
    # Any target may have columns of its own.
    targets = None if robot.target_names == "any" else robot.targets
    words = {heading_of(name).words for name in table.names}
    is_report = any((texts and MEASURED.issuperset(texts)) or DEVIATIONS & {*texts} for texts in words)
    if is_report and not {("x",), ("y",), ("z",)} & words:
        table = plug_in("robacc.readers", "reports").points(table) or table
    if points_in_rows(table.names):
        table = plug_in("robacc.readers", "reports").targets_in_rows(table, targets) or table
    return table


def with_named_quaternion(table: Table) -> tuple[str, ...]:
    """Return the names with Q0 … Q3 beside no Q4 as a quaternion; a note of it goes to the log."""
    lower = [name.lower() for name in table.names]
    if not {*_COUNTED} <= {*lower} or "q4" in lower:
        return table.names
    table.log.warn(Note("q0 … q3 are taken as a quaternion, scalar part first"), of_file=True)
    return tuple(_COUNTED.get(key, name) for key, name in zip(lower, table.names, strict=True))


def points_in_rows(names: Sequence[str]) -> dict[str, dict[str, int]]:
    """Return the columns ``X1, Y1, Z1, X2 …`` by label and axis; empty unless two labels have an axis."""
    points: dict[str, dict[str, int]] = {}
    sources = set()
    for index, heading in enumerate(map(heading_of, names)):
        words, axis = labelled(heading) or ((), "turn")
        if axis != "turn" and (source := source_of(heading.words)) >= 0:
            label = "".join(word for word in words if word not in SAY_LITTLE)
            points.setdefault(label, {}).setdefault(axis, index)
            sources.add(source)
    return {} if "" in points or len(points) < 2 or len(sources) > 1 else points


def advice_on_points(names: Sequence[str]) -> str | None:
    """Return what to do about a file with several points in each row; None for another file."""
    points = points_in_rows(names)
    labels = ", ".join(points)
    lacking = (
        f"the rows hold the points {labels}, but point {label} has no {' and no '.join(missing)}"
        for label, columns in points.items()
        if (missing := [axis.upper() for axis in AXES if axis not in columns])
    )
    several = (
        f"each row holds the points {labels}: for several targets at one pose, fit tool_frame, which finds their "
        "places (`align` of estimate, `fit` of calibrate; a trace does), or name them under targets in the robot file "
        f"({labels}); for a single target, choose its columns with `columns`"
    )
    return next(lacking, several) if points else None


Rows = tuple[NDArray[np.int64], Sequence[NDArray[Any]]]
"""Rows that are formed from those of another table: the old rows ``(R, N)`` that make each new one, in which a column
that stays has one value, and the new columns ``(N,)``."""


class ReshapedTable(Table):
    """Table whose rows are formed from those of another: some columns make new ones, which follow the others."""

    def __init__(
        self,
        table: Table,
        used: Collection[int],
        new: Mapping[str, int | None],
        made_of: tuple[Sequence[int], Sequence[int]],
        make: Callable[[TableBody], Rows],
        remark: str,
    ) -> None:
        """Form a table.

        Args:
            table: The other table.
            used: Its columns that do not stay.
            new: Names of the new columns, and the old columns in whose units their values are.
            made_of: Old columns of numbers and of texts that make the new ones.
            make: Returns the rows from these columns.
            remark: How the rows are formed, for a message.
        """
        self._kept = [i for i in range(len(table.names)) if i not in used]
        super().__init__(table.file, [*(table.names[i] for i in self._kept), *new], table.line)
        self.log, self.dialect = table.log, table.dialect
        self.log.remarks.append(remark)
        units = enumerate([*self._kept, *new.values()])
        self.cell_units = {i: unit for i, old in units if old is not None and (unit := table.cell_units.get(old))}
        self._table, self._made_of, self._make = table, made_of, make

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return every row, with the columns of the given indices only; :attr:`log` collects problems of values."""
        n = len(self._kept)
        self._table.times = frozenset(self._kept[i] for i in self.times)
        kept = [[self._kept[i] for i in columns if i < n] for columns in (numbers, texts)]
        old = self._table.body([*kept[0], *self._made_of[0]], [*kept[1], *self._made_of[1]])
        self.sha256 = self._table.sha256
        rows, new = self._make(TableBody(old.numbers[len(kept[0]) :], old.texts[len(kept[1]) :], old.lines))
        first, lines = rows[0], old.lines[rows[0]]
        for column, values in zip(kept[0], old.numbers, strict=False):
            differs = np.any(
                np.abs(values[rows] - values[first]) > 1e-9 * np.maximum(1.0, np.abs(values[first])), axis=0
            )
            self.log.add_rows(
                differs, lines, self._table.names[column], lambda _: "the rows of one point have different values"
            )
        stay = [*zip(kept[0], old.numbers, strict=False), *zip(kept[1], old.texts, strict=False)]
        by_index = {self._kept.index(column): values[first] for column, values in stay} | dict(enumerate(new, n))
        table = np.array([by_index[i] for i in numbers], dtype=float).reshape(len(numbers), first.size)
        return TableBody(table, [by_index[i] for i in texts], lines)
