"""Orders of a periodic joint error: their physical origins, and those that measured poses support."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from robacc.effects.base import setting
from robacc.geometry import Array

# Physical origins of a periodic error's order: motor turns, the wave generator of a strain-wave gear, the joint.

TYPICAL_RATIOS = (50, 51, 57, 80, 81, 100, 101, 105, 120, 121, 141, 153, 160, 161, 171)
"""Usual ratios of strain-wave gears (50 to 161) and of RV reducers (57 to 171), from makers' catalogues."""
_OF_THE_MOTOR = {
    1: "once per motor turn: motor encoder, or eccentricity of the input",
    2: "twice per motor turn: the wave generator of a strain-wave gear, or the motor's shaft",
    4: "four times per motor turn: the second harmonic of a strain-wave gear's wave generator",
}
_OF_THE_JOINT = {
    1: "once per joint turn: eccentricity of the output gear or of the encoder's disc",
    2: "twice per joint turn: ovality, or two reading heads",
}
_LEAST_TOLERANCE = 0.05
_LARGEST_TOLERANCE = 0.4
"""Largest difference from a typical ratio's order: typical ratios are one apart. Over a quarter turn, orders have an
uncertainty of about 0.3."""


def order_tolerance(angle_range: float) -> float:
    """Return the difference of two orders that poses over ``angle_range`` rad do not distinguish reliably.

    It is a tenth of the spacing at which two harmonics are orthogonal over the range.
    """
    return max(_LEAST_TOLERANCE, 0.1 * 2 * math.pi / max(angle_range, 1e-6))


def origin_of(order: float, gear_ratio: float | None, tolerance: float) -> str | None:
    """Return the physical origin of an order per joint turn; None if it fits none.

    Where the ratio is unknown, typical ratios are compared, only with the motor's first two orders.
    """
    for multiple, text in _OF_THE_JOINT.items():
        if abs(order - multiple) <= tolerance:
            return text
    if gear_ratio:
        for multiple, text in _OF_THE_MOTOR.items():
            if abs(order - multiple * abs(gear_ratio)) <= tolerance * multiple:
                return f"{text} (gear_ratio {abs(gear_ratio):g})"
        return None
    for multiple in (1, 2):
        for ratio in TYPICAL_RATIOS:
            if abs(order - multiple * ratio) <= min(tolerance, _LARGEST_TOLERANCE):
                text = _OF_THE_MOTOR[multiple]
                return f"{text} (a typical gear of ratio {ratio}; the robot file has no gear_ratio)"
    return None


ORDER_STEP = 0.25
"""Periods per turn between orders that are tried; the best is then improved off this grid."""
HIGHEST_ORDER = 40.0
"""Largest order that competes with every candidate."""
HIGHEST_OF_ALL = 210.0
"""Largest order that is tried where nothing else is significant: twice the ratio of common strain-wave gears."""
HIGHEST_OF_SLIDE = 1000.0
"""rad/m: largest order of a slide that is tried where nothing else is significant: a period of 6 mm."""
_FEWEST = 8
"""Different angles that an order needs at least."""
_CLOSEST = 0.1
"""Quantile of the gaps between angles that sets the highest order they support."""


def common_period(orders: Sequence[float]) -> float:
    """Return the range of a joint (rad) over which poses separate the orders from each other and from a constant.

    It is one period of their smallest difference, the constant being order zero; beyond such a range the sum repeats
    what the poses showed.
    """
    spacing = np.diff(np.sort([0.0, *orders]))
    return 2.0 * math.pi / float(spacing[spacing > 0].min())


def are_separable(first: float, second: float, angle_range: float) -> bool:
    """Return whether poses over a range of a joint (rad) separate two orders: a quarter period of their beat or more.

    Over less, two waves of opposite phase and any size fit as well as small ones.
    """
    return abs(first - second) * angle_range >= 0.5 * math.pi


def exact_period(orders: Sequence[float], gear_ratio: float | None) -> float | None:
    """Return the turn of a joint (rad) after which a sum of these orders repeats itself; None if there is none.

    A single order repeats after its own period. Several whole orders repeat after a turn at most; fitted within less
    than a turn, they also imitate orders between them. The orders of a gear are whole if its ratio is; an unknown ratio
    counts as whole, as that of strain-wave gears.
    """
    if len(orders) == 1:
        return 2.0 * math.pi / orders[0]
    whole = all(float(order).is_integer() for order in orders)
    if not whole or not float(gear_ratio or 1.0).is_integer():
        return None
    return 2.0 * math.pi / math.gcd(*(int(order) for order in orders))


def supported_orders(angle: Array) -> Array:
    """Return the orders between one period over the range of angles and the limit that the spacing of poses sets.

    Randomly spaced angles have no Nyquist order; the limit is that of the closest tenth of the gaps.
    """
    lowest, highest = _limits(angle)
    first = math.ceil(max(ORDER_STEP, lowest) / ORDER_STEP) * ORDER_STEP
    return np.arange(first, min(HIGHEST_ORDER, highest) + 1e-9, ORDER_STEP)


def high_orders(angle: Array, largest: float = HIGHEST_OF_ALL) -> Array:
    """Return the orders above :data:`HIGHEST_ORDER`, at most ``largest``, that the spacing of poses supports."""
    _, highest = _limits(angle)
    return np.arange(HIGHEST_ORDER + ORDER_STEP, min(largest, highest) + 1e-9, ORDER_STEP)


def _limits(angle: Array) -> tuple[float, float]:
    """Return the order of half a period over the range of angles, and the highest; the highest is 0 with few angles."""
    values = np.unique(np.round(angle, 6))
    if values.size < _FEWEST:
        return ORDER_STEP, 0.0
    gap = float(np.quantile(np.diff(values), _CLOSEST))
    return float(np.pi / (values[-1] - values[0])), float(np.pi / max(gap, 1e-6))


def orders_setting(default: tuple[float, ...]) -> Any:
    """Return the field of an effect that is its orders."""
    return setting(default, written=True, above=0.0, most=1000.0, different=True)
