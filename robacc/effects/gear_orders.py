"""Physical origins of a periodic error's order: motor turns, the wave generator of a strain-wave gear, the joint."""

from __future__ import annotations

import math

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
