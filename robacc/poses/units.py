"""Checks of the units of columns whose names have none: degrees, millimetres, inches."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem
from robacc.geometry import Array
from robacc.io.files import ProblemLog
from robacc.poses.columns import AXES, SIGMAS
from robacc.poses.foreign_columns import compact
from robacc.poses.layout import COMMANDED_AXES, Values, listing
from robacc.poses.reading import JointLimits
from robacc.statistics.intervals import interpolated

# Plausibility of units: columns without a unit in their names must not be in degrees or millimetres.
#
# A unit in a column's name is taken as given; only bare names are checked. The bounds are wide, so that good data
# pass; each has its reason beside it.

TURN = 2 * math.pi
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
_SMALL_RANGE = 0.05
"""m; below it the range may come from errors and outliers, not from motion."""


def degrees_likely(q: Array, limits: tuple[float, float] | None) -> bool:
    """Return whether a revolute joint's values ``(N,)``, declared as rad, are in degrees.

    They are where they exceed two turns, or one turn at a fifth of the poses; and where a fifth of the poses break
    known limits that all poses keep when read as degrees. A value within the limits never counts as degrees.
    """
    largest = float(max(q.max(), -q.min()))
    if largest <= 1.001 * TURN:
        return False
    outside = np.ones(q.shape, dtype=bool) if limits is None else outside_limits(q, limits)
    if limits is not None and np.mean(outside) >= _FREQUENT and not outside_limits(np.radians(q), limits).any():
        return True
    size = np.abs(q)
    return bool(np.any(outside & (size > _MANY_TURNS)) or np.mean(outside & (size > 1.001 * TURN)) >= _FREQUENT)


def outside_limits(q: Array, limits: tuple[float, float]) -> NDArray[np.bool_]:
    """Return ``(N,)``: True where a joint's value is outside its limits by more than rounding (5e-6 rad or m)."""
    outside: NDArray[np.bool_] = (q < limits[0] - LIMIT_TOLERANCE) | (q > limits[1] + LIMIT_TOLERANCE)
    return outside


def excess_beyond_limits(q: Array, limits: tuple[float, float]) -> Array:
    """Return ``(N,)``: how far a joint's value is outside its limits, rad or m; 0 within them or by rounding."""
    excess: Array = np.maximum(np.maximum(limits[0] - q, q - limits[1]), 0.0)
    return np.where(excess > LIMIT_TOLERANCE, excess, 0.0)


def angle_beyond_turn(values: Array) -> bool:
    """Return whether roll, pitch, yaw or a rotation vector ``(3, N)`` exceeds one turn, which rad never needs."""
    return bool(np.max(np.abs(values)) > 1.01 * TURN)


def lengths_too_large(position: Array) -> bool:
    """Return whether most of ``position`` ``(3, N)`` has a larger range or distance than a robot's poses in m."""
    if max(np.ptp(axis) for axis in position) <= _RANGE and np.max(np.abs(position)) <= _DISTANCE:
        return False
    # A few wild readings are outliers, not another unit.
    return (
        float(np.max(central_range(position))) > _RANGE
        or float(np.max(np.abs(np.median(position, axis=1)))) > _DISTANCE
    )


def central_range(values: Array) -> Array:
    """Return the range ``(C,)`` of the middle 90 % of each row of ``(C, N)``, which outliers do not change."""
    last = values.shape[1] - 1
    limits = np.array([interpolated(row, (0.05 * last, 0.95 * last)) for row in values])
    result: Array = limits[:, 1] - limits[:, 0]
    return result


def thousandfold(first: Array, second: Array) -> float | None:
    """Return the ratio of the ranges of ``first`` and ``second`` ``(3, N)`` where it is about 1000 or 0.001."""
    first_range, second_range = float(np.max(central_range(first))), float(np.max(central_range(second)))
    if max(first_range, second_range) < _SMALL_RANGE or min(first_range, second_range) <= 0:
        return None
    ratio = first_range / second_range
    # The smaller of the two must be motion: 0.3 mm of scatter about one commanded pose is not another unit.
    if _THOUSAND[0] < ratio < _THOUSAND[1] and second_range * 1000 > _SMALL_RANGE:
        return ratio
    return ratio if _THOUSAND[0] < 1 / ratio < _THOUSAND[1] and first_range * 1000 > _SMALL_RANGE else None


def doubtful_sigma(sigma: Array, kind: str) -> tuple[bool, bool]:
    """Return whether a measuring uncertainty (m or rad) is impossible, and whether it is doubtful."""
    doubtful, impossible = _SIGMA_LENGTH if kind == "length" else _SIGMA_ANGLE
    typical = float(np.median(sigma))
    return typical > impossible, typical > doubtful


def plausible_sigma(sigma: Array) -> bool:
    """Return whether a measuring uncertainty of positions (m) is one of an instrument that tests robots."""
    low, high = _SIGMA_USUAL
    return low <= float(np.median(sigma)) <= high


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


# Checks of the units of columns without a unit in their names.

_FEWEST_OTHERS = 5
"""Rows outside a stretch in another unit, at least …"""
_LEAST_OTHERS = 0.1
"""… and their least share of all rows."""
_MOSTLY = 0.8
"""Least share of the rows of a stretch that show its unit."""
_MOST_METRES = 30.0
"""Coordinate of a measured position from which it shows that it is in mm."""


class UnitChecks:
    """Checks of columns without a unit in their names; problems go to the log, doubts to :attr:`warnings`."""

    def __init__(self, values: Values, log: ProblemLog, line: int | None) -> None:
        """Check ``values``, in which every number could be read; ``line`` is the header's line."""
        self.values = values
        self.log = log
        self.line = line
        self.warnings: list[str] = []

    def run(self, limits: JointLimits | None) -> frozenset[str]:
        """Run every check and return the joints whose unit is wrong."""
        if self.values.lines.size == 0:
            return frozenset()
        layout = self.values.layout
        if layout.wrong_unit:
            return frozenset(layout.joints())
        if layout.without_unit:
            return self._ask_units()
        self._ask_unit_of_sigma()
        wrong_joints = self._joints(limits)
        too_large = [keys for keys in (AXES, COMMANDED_AXES) if self._lengths(keys)]
        if not too_large:
            self._scales()
        for keys in (layout.orientation, layout.commanded_orientation):
            if keys is not None and len(keys) == 3:
                self._angles(keys)
        for keys in (SIGMAS, ("sigma_r",)):
            self._sigma(keys)
        return wrong_joints

    def _ask_units(self) -> frozenset[str]:
        """Report the columns of an export that need a unit, with what their values suggest; return their joints."""
        columns = self.values.layout.without_unit
        sizes = {}
        for kind, quantity in (("length", "lengths"), ("angle", "angles"), ("joint", "joint variables")):
            values = [self.values.column(column.key) for column in columns if column.kind == kind]
            largest = max((float(np.max(np.abs(value))) for value in values if value is not None), default=None)
            if largest is not None:
                sizes[quantity] = f"{quantity} up to {largest:.4g}"
        self.log.add(
            f"these columns state no unit ({', '.join(sizes.values())})",
            self.line,
            compact([column.name for column in columns]),
            "give `units`, for example mm,deg or m,rad, or write the units into the names, as in q1_deg",
        )
        return frozenset(self.values.layout.joints())

    def _ask_unit_of_sigma(self) -> None:
        """Report uncertainties that are too large or too small in the unit of the position."""
        layout = self.values.layout
        sigma = self.values.column_set(SIGMAS)
        if not layout.unit_of_position or sigma is None or plausible_sigma(sigma):
            return
        columns = [layout.columns[key] for key in layout.unit_of_position]
        typical = float(np.median(sigma)) * columns[0].divisor
        self.log.add(
            f"these columns state no unit, and {typical:.3g} {columns[0].unit} is not a usual measuring uncertainty",
            self.line,
            compact([column.name for column in columns]),
            "give their unit with `units`, for example um, or write it into the names, as in Ux (um)",
        )

    def _refuse(
        self, keys: Sequence[str], message: str, unit: str, likely_unit: str, large: NDArray[np.bool_] | None = None
    ) -> None:
        """Report columns in another unit; ``large`` ``(N,)`` are the rows that show it."""
        columns = [self.values.layout.columns[key] for key in keys]
        names = [column.name for column in columns]
        stretch = None if large is None else self._stretch(large)
        if stretch is not None:
            message = f"{message}, from line {stretch[0]} to {stretch[1]} only"
            fix = f"these lines seem to be in {likely_unit} and the others in {unit}; convert one part of the file"
            self.log.add(message, self.line, listing(names), fix)
            return
        new_names = listing([f"{name}_{likely_unit}" for name in names])
        fix = f"if they are in {likely_unit}, name the columns {new_names}; if in {unit}, {names[0]}_{unit} and so on"
        self.log.add(message, self.line, listing(names), fix)

    def _stretch(self, large: NDArray[np.bool_]) -> tuple[int, int] | None:
        """Return the first and last line of the rows that are ``large`` ``(N,)``, if these are one part of the file."""
        rows = np.flatnonzero(large)
        if rows.size == 0:
            return None
        first, last = int(rows[0]), int(rows[-1])
        others = large.size - (last + 1 - first)
        if others < max(_FEWEST_OTHERS, _LEAST_OTHERS * large.size) or np.mean(large[first : last + 1]) < _MOSTLY:
            return None
        return int(self.values.lines[first]), int(self.values.lines[last])

    def _bare(self, keys: Sequence[str]) -> Array | None:
        """Return a set of columns without units in their names; None for any other set."""
        group = self.values.layout.group(keys)
        if group is None or any(column.unit is not None for column in group):
            return None
        return self.values.column_set(keys)

    def _joints(self, limits: JointLimits | None) -> frozenset[str]:
        degrees: list[str] = []
        millimetres: list[str] = []
        largest = 0.0
        large = np.zeros(self.values.lines.size, dtype=bool)
        for i, key in enumerate(self.values.layout.joints()):
            q = self._bare((key,))
            if q is None:
                continue
            limit = limits[i] if limits is not None and i < len(limits) else None
            if self.values.layout.columns[key].kind == "length":
                if np.max(np.abs(q)) > 50.0 and (limit is None or outside_limits(q[0], limit).any()):
                    millimetres.append(key)
            elif degrees_likely(q[0], limit):
                degrees.append(key)
                largest = max(largest, float(np.max(np.abs(q))))
                large |= np.abs(q[0]) > TURN
        if degrees:
            self._refuse(degrees, f"found joint angles up to {largest:.4g}, which cannot be rad", "rad", "deg", large)
        if millimetres:
            self._refuse(millimetres, "found joint travels of more than 50, which cannot be m", "m", "mm")
        if not degrees:
            return frozenset(millimetres)
        # One joint in degrees means all of them: limit checks of those that turned little would repeat the problem.
        columns = self.values.layout.columns
        return frozenset(
            key
            for key in self.values.layout.joints()
            if key in millimetres or (key in columns and columns[key].kind != "length" and columns[key].unit is None)
        )

    def _lengths(self, keys: Sequence[str]) -> bool:
        position = self._bare(keys)
        if position is None or not lengths_too_large(position):
            return False
        largest = float(np.max(np.abs(position)))
        far = np.max(np.abs(position), axis=0) > _MOST_METRES
        self._refuse(keys, f"found positions up to {largest:.4g}, which cannot be m", "m", "mm", far)
        return True

    def _scales(self) -> None:
        """Report attained and commanded positions of which one is in mm."""
        attained, commanded = self.values.column_set(AXES), self.values.column_set(COMMANDED_AXES)
        if attained is None or commanded is None or attained.shape[1] < 2:
            return
        ratio = thousandfold(attained, commanded)
        if ratio is None:
            return
        names = [self.values.layout.columns[key].name for key in (*AXES, *COMMANDED_AXES)]
        message = f"attained positions spread {ratio:.3g} times as far as commanded positions, so one of them is in mm"
        self.log.add(
            message, self.line, ", ".join(names), "put the unit in the columns' names, for example x_mm and cmd_x_m"
        )

    def _angles(self, keys: Sequence[str]) -> None:
        angles = self._bare(keys)
        if angles is not None and angle_beyond_turn(angles):
            largest = float(np.max(np.abs(angles)))
            self._refuse(keys, f"found angles up to {largest:.4g}, which cannot be rad", "rad", "deg")

    def _sigma(self, keys: Sequence[str]) -> None:
        sigma = self._bare(keys)
        if sigma is None:
            return
        kind = self.values.layout.columns[keys[0]].kind
        unit, likely_unit = ("m", "mm") if kind == "length" else ("rad", "deg")
        impossible, doubtful = doubtful_sigma(sigma, kind)
        message = f"found a typical measuring uncertainty of {float(np.median(sigma)):.3g} {unit}"
        if impossible:
            self._refuse(keys, f"{message}, which no instrument has", unit, likely_unit)
        elif doubtful:
            names = listing([f"{key}_{likely_unit}" for key in keys])
            self.warnings.append(f"{self.log.at(self.line)}: {message}; if it is in {likely_unit}, name it {names}")
