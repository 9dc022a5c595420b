"""Whether numbers can be in the unit they are said to be in: degrees and millimetres without a unit are refused.

A wrong unit is never computed with. Only bare names are judged: a unit in a column's name is the user's word. The
bounds are wide, so that good data raise no alarm; each is beside its reason.
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
"""rad; industrial joints end at one turn either way, few at two; as degrees it is 12.6, which any arm passes."""
_OFTEN = 0.2
"""Share of poses beyond one turn that no joint of an arm reaches, and angles in degrees do at once."""
LIMIT_TOLERANCE = 1e-9
"""rad or m; what writing a limit and a joint variable in other units or fewer digits may lose."""
_SPREAD = 50.0
"""m; no arm on any track covers more, while in mm the smallest cell does."""
_DISTANCE = 200.0
"""m; beyond a laser tracker's range, so no instrument measures a robot there."""
_SIGMA_LENGTH = (0.01, 0.1)
"""m; no instrument that tests a robot is as bad as the second; the first deserves a question."""
_SIGMA_ANGLE = (0.05, 0.5)
"""rad; the same of an orientation."""
_THOUSAND = (300.0, 3000.0)
"""Ratio of two spreads of the same poses that only a mix-up of m and mm explains."""
_SMALL_SPREAD = 0.05
"""m; below it errors and outliers, not the motion, may make up the spread."""


def degrees_likely(q: Array, limits: tuple[float, float] | None) -> bool:
    """Whether a revolute joint's values ``(N,)``, said to be rad, are in degrees.

    They are where they go beyond two turns, or beyond one turn at a fifth of the poses; and where the limits are known
    and a fifth of the poses break them, while all of them keep the limits when read as degrees. A value within the
    limits is never held against the file.
    """
    largest = float(max(q.max(), -q.min()))
    if largest <= 1.001 * TURN:
        return False
    outside = np.ones(q.shape, dtype=bool) if limits is None else outside_limits(q, limits)
    if limits is not None and np.mean(outside) >= _OFTEN and not outside_limits(np.radians(q), limits).any():
        return True
    size = np.abs(q)
    return bool(np.any(outside & (size > _MANY_TURNS)) or np.mean(outside & (size > 1.001 * TURN)) >= _OFTEN)


def outside_limits(q: Array, limits: tuple[float, float]) -> NDArray[np.bool_]:
    """``(N,)`` where a joint's values are outside its limits by more than rounding (1e-9 rad or m)."""
    outside: NDArray[np.bool_] = (q < limits[0] - LIMIT_TOLERANCE) | (q > limits[1] + LIMIT_TOLERANCE)
    return outside


def angle_beyond_turn(values: Array) -> bool:
    """Whether roll, pitch, yaw or a rotation vector ``(3, N)`` goes beyond one turn, as none in rad needs to."""
    return bool(np.max(np.abs(values)) > 1.01 * TURN)


def lengths_too_large(position: Array) -> bool:
    """Whether most of ``position`` ``(3, N)`` spreads or lies farther off than a robot's poses in m can."""
    if max(np.ptp(axis) for axis in position) <= _SPREAD and np.max(np.abs(position)) <= _DISTANCE:
        return False
    # A few wild readings are outliers, not another unit.
    return float(np.max(spread(position))) > _SPREAD or float(np.max(np.abs(np.median(position, axis=1)))) > _DISTANCE


def spread(values: Array) -> Array:
    """``(C,)`` range of the middle 90 % of each row of ``(C, N)``, which outliers leave alone."""
    last = values.shape[1] - 1
    limits = np.array([interpolated(row, (0.05 * last, 0.95 * last)) for row in values])
    result: Array = limits[:, 1] - limits[:, 0]
    return result


def thousandfold(first: Array, second: Array) -> float | None:
    """About 1000 or 0.001 where ``first`` ``(3, N)`` spreads that many times as far as ``second`` ``(3, N)``."""
    one, other = float(np.max(spread(first))), float(np.max(spread(second)))
    if max(one, other) < _SMALL_SPREAD or min(one, other) <= 0:
        return None
    ratio = one / other
    # The smaller of the two must itself be motion: 0.3 mm of scatter about one commanded pose is no unit.
    if _THOUSAND[0] < ratio < _THOUSAND[1] and other * 1000 > _SMALL_SPREAD:
        return ratio
    return ratio if _THOUSAND[0] < 1 / ratio < _THOUSAND[1] and one * 1000 > _SMALL_SPREAD else None


def doubtful_sigma(sigma: Array, kind: str) -> tuple[bool, bool]:
    """Whether a measuring uncertainty (m or rad) cannot be, and whether it deserves a question."""
    question, impossible = _SIGMA_LENGTH if kind == "length" else _SIGMA_ANGLE
    typical = float(np.median(sigma))
    return typical > impossible, typical > question


def check_scale(position: Array, nominal: Array, file: str | None) -> None:
    """Refuse positions in another unit than the robot's lengths, judged by how far they spread.

    The distance from the origin says nothing, the robot may stand metres away from the instrument. Nor does a target
    that the arm only turns about: it does not move.

    Args:
        position: ``(3, N)`` as measured, m.
        nominal: ``(3, N)`` that the nominal robot takes at these poses, m, in any frame.
        file: Name for the message.

    Raises:
        InputError: The positions are some 1000 times too large or too small.
    """
    ratio = thousandfold(position, nominal)
    if ratio is None:
        return
    span, moved = float(np.max(spread(position))), float(np.max(spread(nominal)))
    if ratio > 1:
        times = f"{ratio:.0f} times as far as"
        fix = "if they are in mm, name the columns x_mm, y_mm, z_mm; or mend the robot file's units"
    else:
        times = f"{1 / ratio:.0f} times less than"
        fix = "if they are in m, name the columns x, y, z; or mend the robot file's units"
    message = f"the positions spread over {span:.4g} m, {times} the robot moved ({moved:.4g} m)"
    raise InputError(Problem(message, file, column="x, y, z", fix=fix))
