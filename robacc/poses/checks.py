"""Checks of the values of a pose file: units and conventions that names leave open, each row, repeated rows."""

import difflib
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from robacc.errors import InputError, Note, Problem, by_key, listing
from robacc.geometry import Array, NDArray, vector_lengths
from robacc.io.files import ProblemLog, clip
from robacc.measurements import (
    ONE_COMMAND,
    Measurements,
    commanded_groups,
    motion_between_visits,
    numbered,
    numbered_visits,
)
from robacc.poses.layout import QUANTITY, Values, compact
from robacc.poses.reading import (
    AGREES,
    AXES,
    BY_SIGHT,
    COMMANDED_AXES,
    COMMANDED_QUATERNION,
    CONVENTIONS,
    CORRELATIONS,
    JOINT_COLUMN,
    QUATERNION,
    ROTATION_VECTOR,
    RPY,
    SIGMAS,
    Column,
    KnownPoses,
    KnownRobot,
    Reading,
    is_documented,
    is_ruled_out,
    try_conventions,
)
from robacc.poses.reshaped_tables import unit_and_error
from robacc.statistics.intervals import interpolated

# Plausibility of units: columns without a unit in their names must not be in degrees or millimetres.
#
# A unit in a column's name is taken as given; only bare names are checked. The bounds are wide, so that good data
# pass; each has its reason beside it.

TURN = 2 * math.pi
_FREQUENT = 0.2
"""Share of poses beyond one turn: no joint of an arm reaches it, angles in degrees exceed it at once."""
EXCESS_TOLERANCE = {"length": 5e-4, "angle": math.radians(0.05)}
"""m and rad; a limit exceeded by less is a warning: controllers log positions beyond a limit by their following error,
and data sheets round limits."""
_RANGE = 50.0
"""m; no arm on any track covers more; in mm the smallest cell does."""
_DISTANCE = 200.0
"""m; beyond a laser tracker's range, so no instrument measures a robot there."""
SMALL_RANGE = 0.05
"""m; below it the range may come from errors and outliers, not from motion."""


def degrees_likely(q: Array, limits: tuple[float, float] | None) -> bool:
    """Return whether a revolute joint's values ``(N,)``, declared as rad, are in degrees.

    They are where they exceed two turns, or one turn at a fifth of the poses; and where a fifth of the poses break
    known limits that all poses keep when read as degrees. A value within the limits never counts as degrees.
    """
    largest = float(max(q.max(), -q.min()))
    if largest <= 1.001 * TURN:
        return False
    outside = np.ones(q.shape, dtype=bool) if limits is None else excess_beyond_limits(q, limits) > 0
    if limits is not None and np.mean(outside) >= _FREQUENT and not excess_beyond_limits(np.radians(q), limits).any():
        return True
    size = np.abs(q)
    # rad; industrial joints end at one turn either way, few at two; 12.6 degrees is less than any arm's motion.
    return bool(np.any(outside & (size > 2 * TURN)) or np.mean(outside & (size > 1.001 * TURN)) >= _FREQUENT)


def excess_beyond_limits(q: Array, limits: tuple[float, float]) -> Array:
    """Return ``(N,)``: how far a joint's value is outside its limits, rad or m; 0 within them or by rounding."""
    excess: Array = np.maximum(np.maximum(limits[0] - q, q - limits[1]), 0.0)
    # rad or m; rounding of a limit and a joint variable in other units, or of a limit with five decimals (3.14159).
    return np.where(excess > 5e-6, excess, 0.0)


def lengths_too_large(position: Array) -> bool:
    """Return whether most of ``position`` ``(3, N)`` has a larger range or distance than a robot's poses in m."""
    # A few wild readings are outliers, not another unit: most of the poses decide.
    is_any = max(np.ptp(axis) for axis in position) > _RANGE or np.max(np.abs(position)) > _DISTANCE
    return bool(
        is_any and (np.max(central_range(position)) > _RANGE or np.max(np.abs(np.median(position, axis=1))) > _DISTANCE)
    )


def central_range(values: Array) -> Array:
    """Return the range ``(C,)`` of the middle 90 % of each row of ``(C, N)``, which outliers do not change."""
    last = values.shape[1] - 1
    limits = np.array([interpolated(row, (0.05 * last, 0.95 * last)) for row in values])
    return np.asarray(limits[:, 1] - limits[:, 0])


def thousandfold(first: Array, second: Array) -> float | None:
    """Return the ratio of the ranges of ``first`` and ``second`` ``(3, N)`` where it is about 1000 or 0.001."""
    ranges = [float(np.max(central_range(positions))) for positions in (first, second)]
    low, high = sorted(ranges)
    # The smaller of the two must be motion: 0.3 mm of scatter about one commanded pose is not another unit.
    is_motion = high >= SMALL_RANGE and low * 1000 > SMALL_RANGE
    # Only a mix-up of m and mm explains such a ratio of two ranges of the same poses.
    return ranges[0] / ranges[1] if is_motion and 300.0 < high / low < 3000.0 else None


def doubtful_sigma(sigma: Array, kind: str) -> tuple[bool, bool]:
    """Return whether a measuring uncertainty (m or rad) is impossible, and whether it is doubtful."""
    # m; doubtful above the first; no instrument that tests a robot is as bad as the second.
    # rad; the same for an orientation.
    doubtful, impossible = (0.01, 0.1) if kind == "length" else (0.05, 0.5)
    typical = float(np.median(sigma))
    return typical > impossible, typical > doubtful


def check_scale(position: Array, nominal: Array, file: str | None) -> None:
    """Raise an error for positions in another unit than the robot's lengths, judged by their range.

    The distance from the origin is no evidence, because the robot may stand metres away from the instrument. Nor is a
    target that the arm only turns about, because it does not move.

    Args:
        position: ``(3, N)`` measured positions, m.
        nominal: ``(3, N)`` positions of the nominal model at these poses, m, in any frame.
        file: Name of the file, for the message.

    Raises:
        InputError: The positions are about 1000 times too large or too small.
    """
    if (ratio := thousandfold(position, nominal)) is None:
        return
    measured_range, nominal_range = (float(np.max(central_range(p))) for p in (position, nominal))
    times, unit, names = f"{ratio:.0f} times as far as", "mm", "x_mm, y_mm, z_mm"
    if ratio < 1:
        times, unit, names = f"{1 / ratio:.0f} times less than", "m", "x, y, z"
    raise InputError(
        Problem(
            f"the positions spread over {measured_range:.4g} m, {times} the robot moved ({nominal_range:.4g} m)",
            file,
            column="x, y, z",
            fix=f"if they are in {unit}, name the columns {names} or give `units`; or correct the robot file's units",
        )
    )


# Units of columns without a unit in their names: checks, and the choice where one reading is left.

_READINGS = {"length": ("m", "mm", "in", "cm"), "angle": ("rad", "deg")}
_NEAR, _APART = math.log(5.0), math.log(4.0)
"""Logarithms of the largest ratio of the measured and the commanded range, which differ by the tool, and of the least
ratio by which another reading is worse. Units differ by 25 or more."""
_SAMPLE = 400
"""Rows that are tried at most."""


def check_units(
    values: Values, limits: Sequence[tuple[float, float] | None] | None
) -> tuple[frozenset[str], frozenset[str]]:
    """Check columns without a unit in their names; problems and warnings go to the log.

    Args:
        values: Values, in which every number could be read.
        limits: Limits of the joints.

    Returns:
        Joints whose unit is wrong, and the quantities, ``length`` and ``angle``, whose columns are in another unit,
        with ``part`` if only some rows are.
    """
    layout, log, line = values.layout, values.log, values.header
    joints = layout.joints()
    wrong: set[str] = set()
    is_asked = bool(layout.without_unit) and not log.total  # without another problem the values may show the units
    if values.lines.size and not layout.wrong_unit and is_asked:
        # What the values suggest: a question to the user.
        kinds = {"length": "lengths", "angle": "angles", "joint": "joint variables"}
        sizes = [
            f"{kinds[kind]} up to {np.max(np.abs(values.numbers[rows])):.4g}"
            for kind in kinds
            if (rows := [values.row_index[column.key] for column in layout.without_unit if column.kind == kind])
        ]
        message = f"these columns state no unit ({', '.join(sizes)})"
        fix = "give `units`, for example mm,deg or m,rad, or write the units into the names, as in q1_deg"
        log.add(message, line, compact([column.name for column in layout.without_unit]), fix)
    if values.lines.size == 0 or layout.wrong_unit or layout.without_unit:
        return frozenset(joints), frozenset()

    def bare(keys: Sequence[str]) -> Array | None:
        """Return a set of columns without units in their names; None for any other set."""
        is_bare = layout.has(keys) and all(layout.columns[key].unit is None for key in keys)
        return values.column_set(keys) if is_bare else None

    def refuse(keys: Sequence[str], found: str, kind: str, large: NDArray[np.bool_] | None = None) -> None:
        """Log columns in another unit; ``large`` ``(N,)`` are the rows that show it."""
        unit, likely_unit = _READINGS[kind][:2]
        wrong.add(kind)
        names = [layout.columns[key].name for key in keys]
        new_names = listing([f"{name}_{likely_unit}" for name in names])
        fix = (
            f"if they are in {likely_unit}, name the columns {new_names}, or give `units={likely_unit}`; if in {unit}, "
            f"{names[0]}_{unit} and so on"
        )
        first, last = (0, values.lines.size - 1) if large is None or not large.any() else np.flatnonzero(large)[[0, -1]]
        others = values.lines.size - (last + 1 - first)
        if large is not None and others >= max(5, 0.1 * values.lines.size) and np.mean(large[first : last + 1]) >= 0.8:
            # Most rows of this stretch show the unit, and many rows are outside: it is one part of the file.
            wrong.add("part")
            found = f"{found}, from line {values.lines[first]} to {values.lines[last]} only"
            fix = f"these lines seem to be in {likely_unit} and the others in {unit}; convert one part of the file"
        log.add(found, line, listing(names), fix)

    sigma = values.column_set(SIGMAS) if layout.unit_of_position else None
    # m; an interferometer on the bench reaches the first, a camera over a cell stays below the second.
    if sigma is not None and not 1e-6 <= float(np.median(sigma)) <= 1e-3:
        column = layout.columns[layout.unit_of_position[0]]
        typical = f"{float(np.median(sigma)) * column.divisor:.3g} {column.unit}"
        message = f"these columns state no unit, and {typical} is not a usual measuring uncertainty"
        fix = "give their unit with `units`, for example um, or write it into the names, as in Ux (um)"
        log.add(message, line, compact([layout.columns[key].name for key in layout.unit_of_position]), fix)
    bare_joints = {key: q[0] for key in joints if (q := bare((key,))) is not None}
    limit_of = dict(zip(joints, limits or (), strict=False))
    turning = {key: q for key, q in bare_joints.items() if layout.columns[key].kind != "length"}
    degrees = {key: q for key, q in turning.items() if degrees_likely(q, limit_of.get(key))}
    millimetres = [
        key
        for key, q in bare_joints.items()
        if key not in turning and np.max(np.abs(q)) > _RANGE
        if (limit := limit_of.get(key)) is None or excess_beyond_limits(q, limit).any()
    ]
    if degrees:
        sizes_of = np.abs(np.array([*degrees.values()]))
        found = f"found joint angles up to {np.max(sizes_of):.4g}, which cannot be rad"
        refuse([*degrees], found, "angle", np.any(sizes_of > TURN, axis=0))
    if millimetres:
        refuse(millimetres, "found joint travels of more than 50, which cannot be m", "length")
    positions = {keys: p for keys in (AXES, COMMANDED_AXES) if (p := bare(keys)) is not None and lengths_too_large(p)}
    for keys, position in positions.items():
        far = np.max(np.abs(position), axis=0)
        # Coordinate of a measured position from which it shows that it is in mm.
        refuse(keys, f"found positions up to {np.max(far):.4g}, which cannot be m", "length", far > 30.0)
    attained, commanded = values.column_set(AXES), values.column_set(COMMANDED_AXES)
    both = not positions and attained is not None and commanded is not None and attained.shape[1] > 1
    if both and (ratio := thousandfold(attained, commanded)) is not None:  # type: ignore[arg-type]
        names = ", ".join(layout.columns[key].name for key in (*AXES, *COMMANDED_AXES))
        message = f"attained positions spread {ratio:.3g} times as far as commanded positions"
        fix = "put the unit in the columns' names, for example x_mm and cmd_x_m"
        log.add(f"{message}, so one of them is in mm", line, names, fix)
        wrong.add("length")
    for keys in (layout.orientation() or (), layout.orientation("cmd_") or ()):
        angles = bare(keys) if len(keys) == 3 else None
        # Roll, pitch, yaw or a rotation vector never need more than a turn.
        if angles is not None and (largest := np.max(np.abs(angles))) > 1.01 * TURN:
            refuse(keys, f"found angles up to {largest:.4g}, which cannot be rad", "angle")
    for keys, kind in ((SIGMAS, "length"), (BY_SIGHT, "length"), (("sigma_r",), "angle")):
        if (sigma := bare(keys)) is None:
            continue
        impossible, doubtful = doubtful_sigma(sigma, kind)
        unit, likely_unit = _READINGS[kind][:2]
        typical = f"found a typical measuring uncertainty of {float(np.median(sigma)):.3g} {unit}"
        if impossible:
            refuse(keys, f"{typical}, which no instrument has", kind)
        elif doubtful:
            names = listing([f"{key}_{likely_unit}" for key in keys])
            log.warn(f"{typical}; if it is in {likely_unit}, name it {names}", line)
    # One joint in degrees means all of them: limit checks of those that turned little would repeat the problem.
    return frozenset([*millimetres, *(turning if degrees else ())]), frozenset(wrong)


def with_units(
    values: Values, robot: KnownRobot, known_poses: KnownPoses | None, *, is_touched: bool = False
) -> Values:
    """Return the values with the units that only one reading leaves; notes on them go to the log.

    Documented names are SI. They are read otherwise only where the values cannot be SI and the motion of the arm shows
    the unit; other names also where the values alone leave one unit. Poses ``is_touched`` of other measurements than
    positions are in rad where in degrees no joint would turn by more than 2 pi degrees, as in no campaign.
    """
    layout, foreign = values.layout, {QUANTITY[column.kind] for column in values.layout.without_unit}
    columns = [
        column
        for column in layout.columns.values()
        if column.unit is None and column.kind in QUANTITY and column.key in values.row_index
    ]

    def doubts(trial: Values) -> frozenset[str]:
        stated = trial._replace(layout=layout._replace(without_unit=()), log=ProblemLog(""))
        return check_units(stated, robot.limits)[1]

    index = np.arange(0, values.lines.size, -(-values.lines.size // _SAMPLE) or 1)
    index = index[np.isfinite(values.numbers[:, index]).all(axis=0)]
    rows = values.rows(index)
    wrong = foreign | doubts(rows)
    if not index.size or layout.wrong_unit or "part" in wrong or not wrong:
        return values
    known = (None, None) if known_poses is None or values.log.total else known_poses(values.keys)
    if known[0] is not None:
        index = index[np.isfinite(known[0][0, index])]
        rows = values.rows(index)
    tries: list[tuple[float, dict[_Group, list[Column]], dict[tuple[str, ...], float]]] = []
    # All in one unit; else, of an export, a tracker's mm beside metres of the controller.
    for are_apart in (False, True)[: 1 + bool(foreign)]:
        tried = _groups(columns, layout.without_unit, are_apart)
        choices = [_READINGS[name] if name in wrong else _READINGS[name][:1] for name, *_ in tried]
        scores = {}
        for units in itertools.product(*choices):
            trial = _scaled(rows, tried, dict(zip(tried, units, strict=True)))
            if not doubts(trial):
                score = _distance(trial, robot, tuple(None if part is None else part[..., index] for part in known))
                # A centimetre is too near to an inch to be told by the range.
                if score <= (0.0 if "cm" in units else _NEAR if are_apart else math.inf):
                    scores[units] = score
        tries.append((min(scores.values(), default=math.inf), tried, scores))
        if scores and (tries[0][0] < -15.0 or len(layout.orientation() or ()) != 3):
            break
    # Units apart where they alone agree, or where only so the angles of the measured poses follow the arm, too.
    best, groups, scores = min(tries, key=lambda each: (not each[2], round(min(each[0], 99.0), -1)))
    # Of documented names the motion of the arm decides: the lengths, and the angles where the joints are known.
    moves = robot.pose_at is not None and any(JOINT_COLUMN.fullmatch(column.key) for column in columns)
    shown = (
        foreign if best >= _NEAR else foreign | ({"length", "angle"} if moves or known[0] is not None else {"length"})
    )
    left = [units for units, score in scores.items() if best >= _NEAR or score < best + _APART]
    q = rows.column_set(layout.joints()) if is_touched else None
    if q is not None and index.size >= 10 and np.abs(q).max() <= 2.0 * np.pi:
        left = [units for units in left if "deg" not in units]
    options = {group: {units[i] for units in left} for i, group in enumerate(groups) if group[0] in wrong & shown}
    found = {group: min(units) for group, units in options.items() if len(units) == 1}
    reason = f"no other unit agrees with the values{' and the motion of the arm' * (best < _NEAR)}"
    for group, unit in found.items():
        taken = compact([column.name for column in groups[group]])
        values.log.warn(Note(f"{taken} taken as {unit}: {reason}"), of_file=True)
    return _scaled(values, groups, found)


_Group = tuple[str, bool, bool]
"""Quantity of columns, whether their names are not documented, and whether they are those of commands alone."""


def _groups(columns: Sequence[Column], undocumented: Sequence[Column], are_apart: bool) -> dict[_Group, list[Column]]:
    """Return the columns of each quantity; where they ``are_apart``, those of commands and of measured values each."""
    return by_key(
        (
            (
                QUANTITY[column.kind],
                column in undocumented,
                are_apart and bool(column.key.startswith("cmd_") or JOINT_COLUMN.fullmatch(column.key)),
            ),
            column,
        )
        for column in columns
    )


def _scaled(values: Values, groups: Mapping[_Group, Sequence[Column]], units: Mapping[_Group, str]) -> Values:
    """Return the values with the columns of each group in its unit; columns of other groups stay."""
    numbers, layout = values.numbers.copy() if units else values.numbers, values.layout
    new = {column.key: replace(column, unit=unit) for group, unit in units.items() for column in groups[group]}
    for key, column in new.items():
        numbers[values.row_index[key]] /= column.divisor / column.coverage
    layout = layout._replace(
        columns={**layout.columns, **new},
        without_unit=tuple(column for column in layout.without_unit if column.key not in new),
        unit_of_position=layout.unit_of_position or tuple(key for key in SIGMAS if key in new),
    )
    return values._replace(numbers=numbers, layout=layout)


def _distance(values: Values, robot: KnownRobot, known: tuple[Array | None, ...]) -> float:
    """Return the distance of the ranges of positions from that of the arm, as a logarithm of their ratio.

    It is less by 10 where positions, and where orientations, follow the arm.
    """
    layout, q = values.layout, values.column_set(values.layout.joints())
    measured, commanded = values.column_set(AXES), values.column_set(COMMANDED_AXES)
    if q is not None and robot.pose_at is not None:
        poses = robot.pose_at(q)
        known = (poses.translation, poses.rotation)
    elif known[0] is None and (keys := layout.orientation("cmd_")) is not None:
        known = (commanded, rotations(values, keys, _convention(keys, None)))
    at = commanded if known[0] is None else known[0]
    positions = (at, measured, at if commanded is None else commanded)
    ranges = [0.0 if position is None else float(np.max(central_range(position))) for position in positions]
    # m; commanded positions of an arm that stands or has a short track do not spread farther than 12.
    if not (min(ranges[1:]) > 0 and SMALL_RANGE < ranges[0] < 12.0):
        return math.inf
    fits = 0
    for prefix, position in (("", measured), ("cmd_", commanded)):
        fits += position is not None and unit_and_error(position, *known)[0] == "m"
        angles = values.column_set(layout.orientation(prefix) or ())
        if angles is not None and len(angles) == 3 and known[1] is not None:
            tried = try_conventions(angles, known[1], ("rotvec", "fixed-xyz", "moving-xyz", "kuka-abc", "zyz"))
            fits += bool(min((tried or {"": math.inf}).values()) < AGREES)
    return max(abs(math.log(each / ranges[0])) for each in ranges[1:]) - 10.0 * fits


# Orientations: their representation, and the convention of angles that names leave open.

BLOCK = 4096
"""Rows converted or written at a time: the working arrays of a block fit the cache."""
_WRITERS = {
    "rotvec": "Universal Robots",
    "fixed-xyz": "trackers, FANUC, Yaskawa",
    "moving-xyz": "Stäubli",
    "kuka-abc": "KUKA",
    "zyz": "Kawasaki, Doosan",
    "wxyz": "scalar part first",
    "xyzw": "scalar part last, ROS",
}
"""Makers whose exports use a convention."""
_OPTIONS = {
    ROTATION_VECTOR[0]: ("rotvec", "fixed-xyz", "moving-xyz"),
    RPY[0]: ("fixed-xyz", "moving-xyz"),
    QUATERNION[0]: ("wxyz", "xyzw"),
}
"""Conventions that files use, by the first of the columns; the first convention is the documented one."""


def rotations(values: Values, keys: tuple[str, ...] | None, convention: str) -> Array | None:
    """Return rotations ``(3, 3, N)`` from the file's representation; None where the file has none."""
    if keys is None or (columns := values.column_set(keys)) is None:
        return None
    result = np.empty((3, 3, columns.shape[1]))
    for start in range(0, columns.shape[1], BLOCK):
        result[..., start : start + BLOCK] = CONVENTIONS[convention](columns[:, start : start + BLOCK])
    return result


def _convention(keys: Sequence[str], stated: str | None) -> str:
    """Return the convention of these columns as stated, or as documented; other names than rx take few."""
    options = _OPTIONS[keys[0].removeprefix("cmd_")]
    return stated if stated in options or (stated and options[0] == "rotvec") else options[0]


def conventions(
    values: Values, reading: Reading, robot: KnownRobot, known_poses: KnownPoses | None
) -> Mapping[str, str]:
    """Return the convention of attained and commanded angles, by prefix: as stated, as named, or as the data show.

    Questions go to the log, and notes of what the data showed. Documented names keep their convention; the data may
    show that it is wrong. Roll, pitch and yaw of an export are about fixed axes unless the data show otherwise.
    """
    layout, log, n = values.layout, values.log, values.lines.size
    orientations = {prefix: keys for prefix in ("", "cmd_") if (keys := layout.orientation(prefix)) is not None}
    stated: dict[str, str | None] = {}
    for prefix, keys in orientations.items():
        named = layout.angles.get(prefix, ())
        # The order of a quaternion is no statement on angles, nor on names that say the order.
        is_open = keys[0] == prefix + QUATERNION[0] and (named or reading.columns is not None)
        angles = reading.angles if is_open or reading.angles not in _OPTIONS[QUATERNION[0]] else None
        stated[prefix] = named[0] if len(named) == 1 else angles
    chosen = {prefix: _convention(keys, stated[prefix]) for prefix, keys in orientations.items()}
    rows = np.linspace(0, n - 1, min(n, _SAMPLE)).astype(int)

    def known_orientations(prefix: str) -> Array | None:
        """Return orientations of the rows that do not depend on the angles in question; None where there are none."""
        q, other = values.column_set(layout.joints()), "" if prefix else "cmd_"
        if robot.pose_at is not None and q is not None:
            return robot.pose_at(q[:, rows]).rotation
        if known_poses is not None:
            known = known_poses(values.keys)[1]
            return None if known is None else known[..., rows]
        columns = values.column_set(orientations.get(other, ()))
        is_named = (
            columns is not None and orientations[other][0] != other + ROTATION_VECTOR[0] and other not in layout.angles
        )
        if columns is None or not (is_named or stated[other]):
            return None
        return CONVENTIONS[_convention(orientations[other], stated[other])](columns[:, rows])

    for prefix, keys in orientations.items():
        is_documented_set = prefix not in layout.angles
        columns = values.column_set(keys)
        is_quaternion = is_documented_set and keys[0] == prefix + QUATERNION[0]
        # Without sound numbers a trial shows nothing.
        if stated[prefix] or is_quaternion or columns is None or n == 0 or log.total:
            continue
        options = layout.angles.get(prefix) or _OPTIONS[keys[0].removeprefix("cmd_")]
        known = known_orientations(prefix)
        trial = None if known is None else try_conventions(columns[:, rows], known, options)
        others = values.column_set(orientations.get("" if prefix else "cmd_", ()))
        if known is None and known_poses is None and others is not None and len(others) == len(columns):
            # Both may be of one convention, under which the turns between poses agree.
            alike = {
                name: try_conventions(columns[:, rows], CONVENTIONS[name](others[:, rows]), (name,)) for name in options
            }
            trial = None if None in alike.values() else {name: found[name] for name, found in alike.items() if found}
        if is_documented_set and (trial is None or not is_ruled_out(chosen[prefix], trial)):
            continue
        names = [layout.columns[key].name for key in keys]
        is_settled = trial is not None and sum(not is_ruled_out(name, trial) for name in trial) == 1
        doubts = (
            (not is_documented_set and not is_settled, "may be angles of several conventions"),
            (not is_documented_set, ""),
            (keys[0] == prefix + ROTATION_VECTOR[0], "are documented as a rotation vector, which they do not fit"),
            (any(map(is_documented, names)), "are documented as about fixed axes, which they do not fit"),
        )
        doubt = next((text for applies, text in doubts if applies), "")
        missed = (
            {}
            if trial is None
            else {name: f"{np.degrees(trial[name]):.2g} degrees" for name in sorted(trial, key=trial.__getitem__)}
        )
        if doubt:
            by = ", ".join(f"{name} by {missed[name]}" for name in trial or ())
            fitting = [name for name in options if not (is_settled and trial and is_ruled_out(name, trial))]
            listed = " or ".join(f"`angles={name}` ({_WRITERS.get(name, 'fixed axes')})" for name in fitting)
            message = f"these {doubt}" + (f" (they miss the known orientations: {by})" if by else "")
            none = "none fits: check the commands of the rows and the unit of the angles; or else " * bool(
                trial and min(trial.values()) > 5.0 * AGREES
            )
            log.add(message, values.header, ", ".join(names), f"{none}give {listed}")
        elif missed:
            best, worse, *_ = missed
            fits = f"it fits the known orientations to {missed[best]}, others miss by {missed[worse]}"
            log.warn(Note(f"{', '.join(names)} taken as {best}: {fits}"), of_file=True)
            chosen[prefix] = best
    return chosen


# Poses that lie close together; repetitions of one commanded pose whose joints were logged as read.

MOST_POSES = 5000
"""Largest number of poses that are compared; more are close to others in any case."""


def with_repetitions(data: Measurements, log: ProblemLog) -> Measurements:
    """Return data without ids of poses with ids of those that were repeated, and log a remark.

    Joints that were logged as read differ a little from visit to visit of one commanded pose.
    """
    if data.pose is not None or data.q is None or not 2 <= data.n <= MOST_POSES:
        return data
    _, first, which = np.unique(data.groups(), return_index=True, return_inverse=True)
    place = close_groups(data.q[:, first], ONE_COMMAND, 2.0 * ONE_COMMAND)
    count = np.bincount(place)
    # Share of the different readings that are near another, from which a file has repetitions.
    if np.mean(count[place] > 1) < 0.25:
        return data
    ids = np.array([f"P{k + 1}" for k in numbered(first[place[which]]).tolist()])
    log.warn(
        f"{data.n} rows are read as {np.count_nonzero(count)} commanded poses and their repetitions, because joints "
        f"differ by less than {1e3 * ONE_COMMAND:g} mrad (mm); a pose column states repetitions",
        of_file=True,
    )
    return replace(data, pose=ids)


def close_groups(values: Array, near: float, widest: float) -> NDArray[np.int64]:
    """Return ``(P,)`` a number that columns of ``(K, P)`` share if they are linked by steps of at most ``near``.

    A group that extends over more than ``widest`` in a row of ``values``, such as a sweep of a joint, is none.
    """
    order = np.argsort(values[0], kind="stable")
    ends = np.searchsorted(values[0, order], values[0, order] + near, side="right")
    place = np.arange(values.shape[1])
    for i, end in enumerate(ends):
        others = order[i:end]
        close = place[others[np.abs(values[:, others] - values[:, others[:1]]).max(axis=0) <= near]]
        if close.size > 1:
            place[np.isin(place, close)] = close.min()
    rows, number = np.argsort(place, kind="stable"), numbered(place)
    start = np.flatnonzero(np.diff(place[rows], prepend=-1))
    extents = [each.reduceat(values[:, rows], start, axis=1) for each in (np.maximum, np.minimum)]
    wide = (extents[0] - extents[1]).max(axis=0) > widest
    return np.where(wide[number], np.arange(place.size), place)


# Direction and speed of the joints' last motion: as given, or derived from the order of visits.


def check_visits(values: Values, ordered: bool) -> None:
    """Log each row that contradicts its ``visit``: other commands, or with ``ordered`` an earlier visit continued."""
    visit = values.texts.get("visit")
    if visit is None or visit.size < 2:
        return
    _, first, number = np.unique(visit, return_index=True, return_inverse=True)
    origin = first[number]
    sets = (values.column_set(keys) for keys in (values.layout.joints(), COMMANDED_AXES))
    if (commands := next((commands for commands in sets if commands is not None), None)) is not None:
        values.log.add_rows(
            # rad or m; largest difference between the commands of the rows of a visit, from joints that were read back.
            np.max(np.abs(commands - commands[:, origin]), axis=0) > 1e-3,
            values.lines,
            "visit",
            lambda i: (
                f"visit {clip(str(visit[i]))} has another command than on {values.log.counted} "
                f"{values.lines[origin[i]]}; a visit is one arrival of the arm, so number each arrival differently"
            ),
        )
    if ordered:
        values.log.add_rows(
            np.append(False, visit[1:] != visit[:-1]) & (origin < np.arange(visit.size)),
            values.lines,
            "visit",
            lambda i: (
                f"visit {clip(str(visit[i]))} continues after another visit began, although rows are said to be in the "
                "order measured; number each arrival differently, or sort the rows"
            ),
        )


def motion_of(values: Values, ordered: bool) -> tuple[Array | None, Array | None]:
    """Return direction and speed ``(J, N)``: as given, derived from the order of visits, or 0 with a warning."""
    layout, log = values.layout, values.log
    q, time = values.column_set(layout.joints()), values.column("time_s")
    derived: Sequence[Array | None] = (None, None)
    if ordered and q is None:
        text = "the file has no joint columns, so the order of rows does not give the joints' directions"
        log.warn(text, of_file=True)
    elif ordered and q is not None:
        visit, cycle, target, pose = (values.texts.get(name) for name in ("visit", "cycle", "target", "pose"))
        grouping = None if cycle is None and target is None else commanded_groups(pose, q)
        groups = np.arange(values.lines.size) if grouping is None else grouping.numbers
        derived = motion_between_visits(q, numbered_visits(groups, visit, cycle, target))
    if time is not None and np.any(np.diff(time) < 0):
        line = values.lines[int(np.argmax(np.diff(time) < 0)) + 1]
        cause = "the clock was set back, or the rows are not in the order measured"
        log.warn(f"time_s decreases at {log.counted} {line}: {cause}", of_file=True)
    result: list[Array | None] = []
    for keys, motion in zip((layout.joints("dir_"), layout.joints("speed_")), derived, strict=True):
        missing = [key for key in keys if key not in values.row_index]
        table = values.column_set(keys)
        if missing and (motion is not None or len(missing) < len(keys)):
            table = np.zeros((len(keys), values.lines.size)) if motion is None else motion
            for row, key in zip(table, keys, strict=True):
                row[:] = values.numbers[values.row_index[key]] if key in values.row_index else row
            if motion is None:
                log.warn(f"no column {listing(missing)}: 0 (not moving) is assumed", of_file=True)
        result.append(table)
    for names in zip(layout.joints("dir_"), layout.joints("speed_"), strict=True):
        pair = values.numbers[[values.row_index[key] for key in names if key in values.row_index]]
        if len(pair) == 2 and (opposite := pair[0] * pair[1] < 0).any():
            place = f"{log.counted} {values.lines[np.argmax(opposite)]}"
            text = f"{' and '.join(names)} have opposite signs at {place}: one of them is wrong"
            log.warn(text, of_file=True)
    return result[0], result[1]


# Rows of a pose file that repeat an earlier row to the last digit.


def duplicate_rows(values: Values) -> NDArray[np.bool_] | None:
    """Return the rows ``(N,)`` that repeat an earlier row or its measured values, which noise hardly ever does.

    A warning names them; None without such rows.
    """
    n, counted = values.lines.size, values.log.counted
    keys = (*AXES, *QUATERNION, *ROTATION_VECTOR, *RPY)
    measured = values.numbers[[values.row_index[key] for key in keys if key in values.row_index]]
    same_measured = _equal_pairs(measured if len(measured) else values.numbers)
    first, second = _equal_pairs(values.numbers) if same_measured.size else same_measured
    equal, same_visit = np.ones((2, first.size), dtype=bool)
    for name, text in values.texts.items():
        # A measurement is a copy whatever its visit is called.
        (same_visit if name in ("pose", "cycle", "visit") else equal)[text[first] != text[second]] = False
    duplicate = equal & same_visit
    if duplicate.any():
        first, second = first[duplicate], second[duplicate]
        where = "an earlier row in every column"
    # Rounded values of many visits repeat by chance; a few to the last digit are copies.
    elif 0 < np.count_nonzero(equal) <= 0.1 * n:
        first, second = first[equal], second[equal]
        where = "an earlier row of another visit to the last digit"
    elif same_measured.size and "x" in values.row_index and _are_copies(measured[:3], same_measured.shape[1]):
        first, second = same_measured
        where = "the measured values of an earlier row to the last digit"
    else:
        return None
    i = int(np.argmin(values.lines[second]))  # the copy that comes first is the example
    rows = f"{first.size} row{'s repeat' if first.size > 1 else ' repeats'} {where}"
    example = f"{counted} {values.lines[second[i]]} repeats {counted} {int(values.lines[first[i]])}"
    values.log.warn(f"{rows} ({example}); every row counts as a measurement, so delete copies", of_file=True)
    copies = np.zeros(n, dtype=bool)
    copies[second] = True
    return copies


def _equal_pairs(numbers: Array) -> NDArray[np.int64]:
    """Return the numbers ``(2, P)`` of rows with equal ``numbers`` ``(C, N)`` in pairs, the earlier first."""
    # Equal rows have equal sums, term by term; only rows with equal sums are compared in full.
    sums = np.zeros(numbers.shape[1])
    for number, row in enumerate(numbers, 2):
        sums += math.sqrt(number) * row
    ordered = np.sort(sums)
    if not np.any(ordered[1:] == ordered[:-1]):
        return np.empty((2, 0), dtype=np.int64)
    order = np.argsort(sums, kind="stable")
    pairs = np.stack([order[:-1], order[1:]])[:, ordered[1:] == ordered[:-1]]
    return pairs[:, (numbers[:, pairs[0]] == numbers[:, pairs[1]]).all(axis=0)]


def _are_copies(position: Array, equal: int) -> bool:
    """Return whether ``equal`` pairs of equal positions ``(3, N)`` are too many for chance.

    By chance, many more pairs differ in the last digits than agree in all of them.
    """
    # m; positions rounded to this repeat by chance, since arms repeat within it.
    steps = position / 1e-5
    if np.count_nonzero(np.abs(steps - np.round(steps)) > 1e-4) < 0.5 * position.size:
        return False
    # m; size of the cells in which positions that nearly agree are counted.
    cells = np.unique(np.floor(np.unique(position, axis=1) / 5e-6), axis=1, return_counts=True)[1]
    # Pairs of a cell that differ, for each that is equal, from which equal ones are chance: five times fewer than noise
    # gives, at a resolution of 1 um.
    return float(np.sum(cells * (cells - 1)) / 2) < 25.0 * equal


READ_BACK_TOLERANCE = 0.1
"""rad or m; an arm that stands is never as far from its command."""
SMALLEST_SIGMA = 1e-12
"""m or rad; below it a weight 1/sigma^2 makes the other rows negligible."""
_LARGEST_OF: Mapping[str, float] = {"length": 1e8, "angle": 1e6, "joint": 1e8, "number": 1e12}
"""m (geocentric coordinates are 6.4e6), rad, m or rad for a joint, and the units of circumstances."""


_RULES: tuple[tuple[str, Callable[[Array], NDArray[np.bool_]], str], ...] = (
    ("dir_", lambda v: ~np.isin(v, (-1.0, 0.0, 1.0)), "expected -1, 0 or 1"),
    ("speed_", lambda v: np.abs(v) > 1 + 1e-6, "expected a fraction of full speed, -1 to 1"),
    ("sigma_", lambda v: v <= 0, "expected a standard deviation above 0"),
    ("sigma_", lambda v: (v > 0) & (v < SMALLEST_SIGMA), f"expected at least {SMALLEST_SIGMA:g} m or rad"),
    ("payload_kg", lambda v: v < 0, "expected 0 kg or more"),
    ("temperature_c", lambda v: v < -273.15, "expected -273.15 degrees Celsius or more"),
)
"""Start of the keys of columns, what is wrong with a value, and what is expected."""


def check_sizes(values: Values) -> None:
    """Log numbers that are too large to compute with, and set them to NaN."""
    for key, column in values.layout.columns.items():
        limit, value = _LARGEST_OF.get(column.kind), values.column(key)
        if limit is not None and value is not None:
            _report(values, key, np.abs(value) > limit, f"expected at most {limit * column.divisor:g}{_unit(column)}")
            value[np.abs(value) > limit] = np.nan


def check_rows(values: Values, robot: KnownRobot, skip_limits: frozenset[str], ignore_limits: bool) -> None:
    """Log values of rows that are wrong; small excesses of limits are warnings.

    Args:
        values: The values, of which :func:`check_sizes` set too large ones to NaN.
        robot: Limits of its joints, and its targets.
        skip_limits: Joints whose unit is wrong; a limit check of every row would repeat that problem.
        ignore_limits: All excesses of limits are warnings.

    Where the file lacks joints, its columns may belong to others: no limit is checked.
    """
    layout, log = values.layout, values.log
    for keys in (QUATERNION, COMMANDED_QUATERNION):
        _check_length(values, keys)
    if layout.has(joints := layout.joints()):
        for key, name, limit in zip(joints, robot.joint_names or joints, robot.limits or (), strict=False):
            if limit is not None and key not in skip_limits:
                _check_limits(values, key, name, limit, ignore_limits)
    for start, test, expected in _RULES:
        for key in values.row_index:
            if key.startswith(start):
                _report(values, key, test(values.numbers[values.row_index[key]]), expected)
    for key in layout.joints():
        _check_read_back(values, key)
    if (correlations := values.column_set(CORRELATIONS)) is not None:
        determinant = 1.0 + 2.0 * np.prod(correlations, axis=0) - np.sum(np.square(correlations), axis=0)
        log.add_rows(
            np.any(np.abs(correlations) >= 1.0, axis=0) | (determinant < 1e-9),  # below, an error is rounding
            values.lines,
            compact(CORRELATIONS),
            lambda i: f"found {', '.join(f'{each:g}' for each in correlations[:, i])}, which no noise has",
            "expected correlations between -1 and 1 whose matrix is positive definite",
        )
    # kg; twice that of the strongest arm.
    if (payload := values.column("payload_kg")) is not None and (heavy := payload > 5000.0).any():
        log.warn(
            f"payload_kg is {payload[heavy][0]:g} kg, more than an arm carries", int(values.lines[np.argmax(heavy)])
        )
    target, known = values.texts.get("target"), None if robot.target_names in (None, "any") else robot.targets
    if target is not None and known:
        log.add_rows(
            ~np.isin(target, known) & (target != ""),
            values.lines,
            "target",
            lambda i: (
                f"found {clip(str(target[i]))}, expected a target of the robot file ({listing(known)}); the nearest is "
                f"{difflib.get_close_matches(str(target[i]), known, n=1, cutoff=0.0)[0]}"
            ),
        )
    # The robot's tool is not used where the file has commanded poses; it would be wrong for all targets but one.
    elif target is not None and known is not None and layout.has(layout.joints()):
        names = list(dict.fromkeys(target[target != ""].tolist()))
        message = f"found several targets ({listing([*map(clip, names)])}), but the robot has one tool and no targets"
        fix = (
            "fit tool_frame, which finds their places (`align` of estimate, `fit` of calibrate; a trace does), "
            "list each target under targets: in the robot file instead of tool, or keep the rows of one target"
        )
        if len(names) > 1:
            log.add(message, int(values.lines[np.argmax(target == names[1])]), "target", fix)


def _check_length(values: Values, keys: Sequence[str]) -> None:
    """Log quaternions that are not of unit length."""
    if (quaternion := values.column_set(keys)) is None:
        return
    with np.errstate(over="ignore"):
        length = vector_lengths(quaternion)
    values.log.add_rows(
        np.abs(length - 1) > 1e-3,
        values.lines,
        ", ".join(values.layout.columns[key].name for key in keys),
        lambda i: f"found a quaternion of length {length[i]:.6g}, expected 1 within 0.001",
    )


def _check_read_back(values: Values, key: str) -> None:
    """Log a joint that was read back far from its command: another unit, another order, or another row."""
    command, value, column = values.column(key), values.column(f"read_{key}"), values.layout.columns.get(f"read_{key}")
    if command is None or value is None or column is None or not column.name.startswith("read_"):
        return
    values.log.add_rows(
        np.abs(value - command) > READ_BACK_TOLERANCE,
        values.lines,
        column.name,
        lambda i: (
            f"found {value[i]:.6g}, but the commanded joint is {command[i]:.6g} (rad or m); check the unit and "
            "the order of the columns read back"
        ),
    )


def _check_limits(values: Values, key: str, joint: str, limits: tuple[float, float], ignore: bool) -> None:
    column, value = values.layout.columns[key], values.numbers[values.row_index[key]]
    unit, factor = _unit(column), column.divisor
    limits_text = f"the limits of {joint}, {limits[0] * factor:.6g} to {limits[1] * factor:.6g}{unit}"
    tolerance = np.inf if ignore else EXCESS_TOLERANCE.get(column.kind, EXCESS_TOLERANCE["length"])
    excess = excess_beyond_limits(value, limits)
    if count := np.count_nonzero(small := (excess > 0) & (excess <= tolerance)):
        rows = "1 row, which is used" if count == 1 else f"{count} rows, which are used"
        most = f"{excess[small].max() * factor:.3g}{unit}"
        values.log.warn(
            f"{column.name} exceeds {limits_text} by at most {most} in {rows}", int(values.lines[np.argmax(small)])
        )
    fix = "`ignore_limits` uses these rows all the same"
    if column.unit == "rad" and degrees_likely(value, limits):
        fix = "if the joints are in degrees, name the columns as in q1_deg, or give `units` with deg; else " + fix
    _report(values, key, excess > tolerance, f"expected a value within {limits_text}", fix)


def _report(values: Values, key: str, failed: NDArray[np.bool_], expected: str, fix: str | None = None) -> None:
    """Log the values of a column that fail a test; NaN is in the log already."""
    column, value = values.layout.columns[key], values.numbers[values.row_index[key]]
    values.log.add_rows(
        failed & ~np.isnan(value),
        values.lines,
        column.name,
        lambda i: f"found {value[i] * column.divisor:.10g}{_unit(column)}, {expected}",
        fix,
    )


def _unit(column: Column) -> str:
    """Return the unit of a column behind a blank, for a message."""
    return f" {column.unit}" if column.unit else ""
