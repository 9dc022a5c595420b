"""Plausibility of units: columns without a unit in their names must not be in degrees or millimetres.

A unit in a column's name is taken as given; only bare names are checked. The bounds are wide, so that good data pass;
each has its reason beside it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem
from robacc.geometry import Array
from robacc.statistics.intervals import interpolated

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
