"""Checks of the units of columns whose names have none: degrees, millimetres, inches."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Note, Problem
from robacc.geometry import Array
from robacc.io.files import ProblemLog
from robacc.poses.columns import AXES, COMMANDED_AXES, JOINT_COLUMN, SIGMAS, UNITS, Column
from robacc.poses.layout import QUANTITY, Values, compact, listing
from robacc.poses.reading import AGREES, JointLimits, KnownPoses, KnownRobot, try_conventions
from robacc.poses.reshaped_tables import unit_of_positions
from robacc.statistics.intervals import interpolated

# Plausibility of units: columns without a unit in their names must not be in degrees or millimetres.
#
# A unit in a column's name is taken as given; only bare names are checked. The bounds are wide, so that good data
# pass; each has its reason beside it.

TURN = 2 * math.pi
_LARGEST_ANGLE = 1.01 * TURN
"""rad; roll, pitch, yaw or a rotation vector never need more than a turn."""
_MANY_TURNS = 2 * TURN
"""rad; industrial joints end at one turn either way, few at two; 12.6 degrees is less than any arm's motion."""
_FREQUENT = 0.2
"""Share of poses beyond one turn: no joint of an arm reaches it, angles in degrees exceed it at once."""
LIMIT_TOLERANCE = 5e-6
"""rad or m; rounding of a limit and a joint variable in other units, or of a limit with five decimals (3.14159)."""
EXCESS_TOLERANCE = {"length": 5e-4, "angle": math.radians(0.05)}
"""m and rad; a limit exceeded by less is a warning: controllers log positions beyond a limit by their following error,
and data sheets round limits."""
_RANGE = 50.0
"""m; no arm on any track covers more; in mm the smallest cell does."""
_DISTANCE = 200.0
"""m; beyond a laser tracker's range, so no instrument measures a robot there."""
_SIGMA_LENGTH = (0.01, 0.1)
"""m; doubtful above the first; no instrument that tests a robot is as bad as the second."""
_SIGMA_USUAL = (1e-6, 1e-3)
"""m; an interferometer on the bench reaches the first, a camera over a cell stays below the second."""
_SIGMA_ANGLE = (0.05, 0.5)
"""rad; the same for an orientation."""
_THOUSAND = (300.0, 3000.0)
"""Ratio of two ranges of the same poses that only a mix-up of m and mm explains."""
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
    return bool(np.any(outside & (size > _MANY_TURNS)) or np.mean(outside & (size > 1.001 * TURN)) >= _FREQUENT)


def excess_beyond_limits(q: Array, limits: tuple[float, float]) -> Array:
    """Return ``(N,)``: how far a joint's value is outside its limits, rad or m; 0 within them or by rounding."""
    excess: Array = np.maximum(np.maximum(limits[0] - q, q - limits[1]), 0.0)
    return np.where(excess > LIMIT_TOLERANCE, excess, 0.0)


def lengths_too_large(position: Array) -> bool:
    """Return whether most of ``position`` ``(3, N)`` has a larger range or distance than a robot's poses in m."""
    # A few wild readings are outliers, not another unit: most of the poses decide.
    if max(np.ptp(axis) for axis in position) <= _RANGE and np.max(np.abs(position)) <= _DISTANCE:
        return False
    return bool(np.max(central_range(position)) > _RANGE or np.max(np.abs(np.median(position, axis=1))) > _DISTANCE)


def central_range(values: Array) -> Array:
    """Return the range ``(C,)`` of the middle 90 % of each row of ``(C, N)``, which outliers do not change."""
    last = values.shape[1] - 1
    limits = np.array([interpolated(row, (0.05 * last, 0.95 * last)) for row in values])
    result: Array = limits[:, 1] - limits[:, 0]
    return result


def thousandfold(first: Array, second: Array) -> float | None:
    """Return the ratio of the ranges of ``first`` and ``second`` ``(3, N)`` where it is about 1000 or 0.001."""
    first_range, second_range = float(np.max(central_range(first))), float(np.max(central_range(second)))
    if max(first_range, second_range) < SMALL_RANGE or min(first_range, second_range) <= 0:
        return None
    ratio = first_range / second_range
    # The smaller of the two must be motion: 0.3 mm of scatter about one commanded pose is not another unit.
    if _THOUSAND[0] < ratio < _THOUSAND[1] and second_range * 1000 > SMALL_RANGE:
        return ratio
    return ratio if _THOUSAND[0] < 1 / ratio < _THOUSAND[1] and first_range * 1000 > SMALL_RANGE else None


def doubtful_sigma(sigma: Array, kind: str) -> tuple[bool, bool]:
    """Return whether a measuring uncertainty (m or rad) is impossible, and whether it is doubtful."""
    doubtful, impossible = _SIGMA_LENGTH if kind == "length" else _SIGMA_ANGLE
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
    ratio = thousandfold(position, nominal)
    if ratio is None:
        return
    measured_range, nominal_range = float(np.max(central_range(position))), float(np.max(central_range(nominal)))
    if ratio > 1:
        times = f"{ratio:.0f} times as far as"
        fix = "if they are in mm, name the columns x_mm, y_mm, z_mm or give `units`; or correct the robot file's units"
    else:
        times = f"{1 / ratio:.0f} times less than"
        fix = "if they are in m, name the columns x, y, z or give `units`; or correct the robot file's units"
    message = f"the positions spread over {measured_range:.4g} m, {times} the robot moved ({nominal_range:.4g} m)"
    raise InputError(Problem(message, file, column="x, y, z", fix=fix))


# Units of columns without a unit in their names: checks, and the choice where one reading is left.

_READINGS = {"length": ("m", "mm", "in", "cm"), "angle": ("rad", "deg")}
_FITS = 10.0
"""Advantage of a reading under which the positions, or the orientations, follow the arm."""
_NEAR, _APART = math.log(5.0), math.log(4.0)
"""Logarithms of the largest ratio of the measured and the commanded range, which differ by the tool, and of the least
ratio by which another reading is worse. Units differ by 25 or more."""
_LARGEST = 12.0
"""m; commanded positions of an arm that stands or has a short track do not spread farther."""
_SAMPLE = 400
"""Rows that are tried at most."""
_FEWEST_OTHERS = 5
"""Rows outside a stretch in another unit, at least …"""
_LEAST_OTHERS = 0.1
"""… and their least share of all rows."""
_MOSTLY = 0.8
"""Least share of the rows of a stretch that show its unit."""
_MOST_METRES = 30.0
"""Coordinate of a measured position from which it shows that it is in mm."""


def check_units(values: Values, limits: JointLimits | None) -> tuple[frozenset[str], frozenset[str]]:
    """Check columns without a unit in their names; problems and warnings go to the log.

    Args:
        values: Values, in which every number could be read.
        limits: Limits of the joints.

    Returns:
        Joints whose unit is wrong, and the quantities, ``length`` and ``angle``, whose columns are in another unit,
        with ``part`` if only some rows are.
    """
    layout, log, line = values.layout, values.log, values.header
    joints = frozenset(layout.joints())
    wrong: set[str] = set()
    if values.lines.size == 0 or layout.wrong_unit:
        return joints, frozenset()
    if layout.without_unit and log.total:
        return joints, frozenset()  # another problem, without which the values may show the units
    if columns := layout.without_unit:
        # What the values suggest: a question to the user.
        kinds = {"length": "lengths", "angle": "angles", "joint": "joint variables"}
        sizes = [
            f"{kinds[kind]} up to {np.max(np.abs(values.numbers[rows])):.4g}"
            for kind in kinds
            if (rows := [values.row_index[column.key] for column in columns if column.kind == kind])
        ]
        message = f"these columns state no unit ({', '.join(sizes)})"
        fix = "give `units`, for example mm,deg or m,rad, or write the units into the names, as in q1_deg"
        log.add(message, line, compact([column.name for column in columns]), fix)
        return joints, frozenset()

    def bare(keys: Sequence[str] | None) -> Array | None:
        """Return a set of columns without units in their names; None for any other set."""
        if not keys or not layout.has(keys) or any(layout.columns[key].unit is not None for key in keys):
            return None
        return values.column_set(keys)

    def refuse(
        keys: Sequence[str], message: str, unit: str, likely_unit: str, large: NDArray[np.bool_] | None = None
    ) -> None:
        """Log columns in another unit; ``large`` ``(N,)`` are the rows that show it."""
        wrong.add(UNITS[likely_unit][0])
        names = [layout.columns[key].name for key in keys]
        new_names = listing([f"{name}_{likely_unit}" for name in names])
        fix = f"if they are in {likely_unit}, name the columns {new_names}; if in {unit}, {names[0]}_{unit} and so on"
        if large is not None and large.any():
            first, last = np.flatnonzero(large)[[0, -1]]
            is_many = large.size - (last + 1 - first) >= max(_FEWEST_OTHERS, _LEAST_OTHERS * large.size)
            if is_many and np.mean(large[first : last + 1]) >= _MOSTLY:
                # These rows are one part of the file.
                wrong.add("part")
                message = f"{message}, from line {values.lines[first]} to {values.lines[last]} only"
                fix = f"these lines seem to be in {likely_unit} and the others in {unit}; convert one part of the file"
        log.add(message, line, listing(names), fix)

    sigma = values.column_set(SIGMAS) if layout.unit_of_position else None
    if sigma is not None and not _SIGMA_USUAL[0] <= float(np.median(sigma)) <= _SIGMA_USUAL[1]:
        # Uncertainties that are too large or too small in the unit of the position.
        column = layout.columns[layout.unit_of_position[0]]
        typical = f"{float(np.median(sigma)) * column.divisor:.3g} {column.unit}"
        message = f"these columns state no unit, and {typical} is not a usual measuring uncertainty"
        fix = "give their unit with `units`, for example um, or write it into the names, as in Ux (um)"
        log.add(message, line, compact([layout.columns[key].name for key in layout.unit_of_position]), fix)
    degrees: dict[str, Array] = {}
    millimetres: list[str] = []
    for key, limit in itertools.zip_longest(layout.joints(), (limits or ())[: layout.n_joints]):
        if (q := bare((key,))) is None:
            continue
        if layout.columns[key].kind != "length":
            degrees |= {key: q[0]} if degrees_likely(q[0], limit) else {}
        elif np.max(np.abs(q)) > _RANGE and (limit is None or excess_beyond_limits(q[0], limit).any()):
            millimetres.append(key)
    if degrees:
        sizes_of = np.abs(np.array(list(degrees.values())))
        message = f"found joint angles up to {np.max(sizes_of):.4g}, which cannot be rad"
        refuse([*degrees], message, "rad", "deg", np.any(sizes_of > TURN, axis=0))
    if millimetres:
        refuse(millimetres, "found joint travels of more than 50, which cannot be m", "m", "mm")
    # One joint in degrees means all of them: limit checks of those that turned little would repeat the problem.
    alike = {
        key
        for key in joints & layout.columns.keys()
        if degrees and layout.columns[key].kind != "length" and layout.columns[key].unit is None
    }
    positions = {keys: p for keys in (AXES, COMMANDED_AXES) if (p := bare(keys)) is not None and lengths_too_large(p)}
    for keys, position in positions.items():
        far = np.max(np.abs(position), axis=0)
        refuse(keys, f"found positions up to {np.max(far):.4g}, which cannot be m", "m", "mm", far > _MOST_METRES)
    attained, commanded = values.column_set(AXES), values.column_set(COMMANDED_AXES)
    both = not positions and attained is not None and commanded is not None and attained.shape[1] > 1
    if both and (ratio := thousandfold(attained, commanded)) is not None:  # type: ignore[arg-type]
        names = ", ".join(layout.columns[key].name for key in (*AXES, *COMMANDED_AXES))
        message = f"attained positions spread {ratio:.3g} times as far as commanded positions"
        fix = "put the unit in the columns' names, for example x_mm and cmd_x_m"
        log.add(f"{message}, so one of them is in mm", line, names, fix)
    for prefix in ("", "cmd_"):
        keys = layout.orientation(prefix) or ()
        angles = bare(keys) if len(keys) == 3 else None
        if angles is not None and (largest := np.max(np.abs(angles))) > _LARGEST_ANGLE:
            refuse(keys, f"found angles up to {largest:.4g}, which cannot be rad", "rad", "deg")
    for keys, kind, unit, likely_unit in ((SIGMAS, "length", "m", "mm"), (("sigma_r",), "angle", "rad", "deg")):
        if (sigma := bare(keys)) is not None:
            impossible, doubtful = doubtful_sigma(sigma, kind)
            message = f"found a typical measuring uncertainty of {float(np.median(sigma)):.3g} {unit}"
            if impossible:
                refuse(keys, f"{message}, which no instrument has", unit, likely_unit)
            elif doubtful:
                names = listing([f"{key}_{likely_unit}" for key in keys])
                log.warn(f"{message}; if it is in {likely_unit}, name it {names}", line)
    return frozenset(millimetres) | alike, frozenset(wrong)


def with_units(values: Values, robot: KnownRobot, known_poses: KnownPoses | None) -> Values:
    """Return the values with the units that only one reading leaves; notes on them go to the log.

    Documented names are SI. They are read otherwise only where the values cannot be SI and the motion of the arm shows
    the unit; other names also where the values alone leave one unit.
    """
    layout, foreign = values.layout, {QUANTITY[column.kind] for column in values.layout.without_unit}
    columns = [
        column
        for column in layout.columns.values()
        if column.unit is None and column.kind in QUANTITY
        if QUANTITY[column.kind] not in foreign or column in layout.without_unit
    ]

    def doubts(trial: Values) -> frozenset[str]:
        stated = replace(trial, layout=replace(layout, without_unit=()), log=ProblemLog(""))
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
    scores = {}
    for units in itertools.product(*(_READINGS[name] if name in wrong else _READINGS[name][:1] for name in _READINGS)):
        trial = _scaled(rows, columns, dict(zip(_READINGS, units, strict=True)))
        if not doubts(trial):
            scores[units] = _distance(trial, robot, tuple(None if part is None else part[..., index] for part in known))
            if units[0] == "cm" and scores[units] > 0:
                del scores[units]  # too near to an inch to be told by the range
    best = min(scores.values(), default=math.inf)
    # Of documented names the motion of the arm decides: the lengths, and the angles of the joints.
    of_arm = robot.pose_at is not None and any(JOINT_COLUMN.fullmatch(column.key) for column in columns)
    shown = foreign if best >= _NEAR else foreign | ({"length", "angle"} if of_arm else {"length"})
    left = [units for units, score in scores.items() if best >= _NEAR or score < best + _APART]
    options = {name: {units[i] for units in left} for i, name in enumerate(_READINGS) if name in wrong & shown}
    found = {name: min(units) for name, units in options.items() if len(units) == 1}
    reason = f"no other unit agrees with the values{' and the motion of the arm' * (best < _NEAR)}"
    for quantity, unit in found.items():
        taken = compact([column.name for column in columns if QUANTITY[column.kind] == quantity])
        values.log.warn(Note(f"{taken} taken as {unit}: {reason}"), of_file=True)
    return _scaled(values, columns, found)


def _scaled(values: Values, columns: Sequence[Column], units: Mapping[str, str]) -> Values:
    """Return the values with these columns in the unit of their quantity; columns of another quantity stay."""
    numbers, layout = values.numbers.copy() if units else values.numbers, values.layout
    new = {c.key: replace(c, unit=units[QUANTITY[c.kind]]) for c in columns if QUANTITY[c.kind] in units}
    for key, column in new.items():
        numbers[values.row_index[key]] /= column.divisor / column.coverage
    layout = replace(
        layout,
        columns={**layout.columns, **new},
        without_unit=tuple(column for column in layout.without_unit if column.key not in new),
        unit_of_position=layout.unit_of_position or tuple(key for key in SIGMAS if key in new),
    )
    return replace(values, numbers=numbers, layout=layout)


def _distance(values: Values, robot: KnownRobot, known: tuple[Array | None, ...]) -> float:
    """Return the distance between the ranges of measured and commanded positions, as a logarithm of their ratio.

    It is less by :data:`_FITS` where positions, and where orientations, follow the arm.
    """
    q, measured, commanded = (values.column_set(keys) for keys in (values.layout.joints(), AXES, COMMANDED_AXES))
    if q is not None and robot.pose_at is not None:
        poses = robot.pose_at(q)
        known = (poses.translation, poses.rotation)
    at = commanded if known[0] is None else known[0]
    ranges = [0.0 if position is None else float(np.max(central_range(position))) for position in (measured, at)]
    if not (ranges[0] > 0 and SMALL_RANGE < ranges[1] < _LARGEST):
        return math.inf
    fits = float(measured is not None and unit_of_positions(measured, *known) == "m")
    angles = values.column_set(values.layout.orientation() or ())
    if angles is not None and len(angles) == 3 and known[1] is not None:
        tried = try_conventions(angles, known[1], ("rotvec", "fixed-xyz", "moving-xyz", "kuka-abc", "zyz"))
        fits += float(min((tried or {"": math.inf}).values()) < AGREES)
    return abs(math.log(ranges[0] / ranges[1])) - _FITS * fits
