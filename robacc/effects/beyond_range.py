"""Effects beyond the range of their drivers: held at its end, or fading to their level there."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from robacc.effects.base import Effect, Part, Term
from robacc.effects.drivers import Periods, Validity, clip_drivers, driver_values, nearest_image, range_excess
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

_LEVEL_LENGTHS = 4.0
"""Fading lengths at the end of a range over which an effect's level there is its mean: for a profile, one period of its
finest order. On parts of a real arm's poses, half and twice as much predict as well."""
_POINTS = 32
"""Places at which the level is sampled."""


def limits_of(effect: Effect, arm: Arm, validity: Validity, *, fading: bool = False) -> tuple[Validity, Periods]:
    """Return the ranges of the drivers beyond which an effect is held, or fades, and the periods of some of them."""
    rules = {name: effect.beyond(arm, name, limits) for name, limits in validity.items()}
    names = [name for name, rule in rules.items() if (rule.fading is not None if fading else rule.is_held)]
    return (
        {name: validity[name] for name in names},
        {name: period for name in names if (period := rules[name].period) is not None},
    )


def held_at_ends(effect: Effect, arm: Arm, data: Measurements, validity: Validity) -> Measurements:
    """Return the poses with the drivers that ``effect`` does not extrapolate held at the ends of their ranges."""
    return clip_drivers(arm, data, *limits_of(effect, arm, validity))


def faded(effect: Effect, arm: Arm, data: Measurements, validity: Validity) -> tuple[Term, ...]:
    """Return the terms of an effect, less and less of them the farther a fading joint is beyond its range.

    What remains is the effect's level at that end of the range, its mean there over :data:`_LEVEL_LENGTHS` fading
    lengths: beyond the range, slow waves of a profile are still as they were, and fine ones are unknown.
    """
    effect = effect.within(validity)
    terms = effect.terms(arm, data)
    for joint, (low, high) in limits_of(effect, arm, validity, fading=True)[0].items():
        values = driver_values(arm, data, joint)
        _, period, length = effect.beyond(arm, joint, (low, high))
        if values is None or length is None:
            continue
        excess = range_excess(values, low, high, period)
        share = np.exp(-0.5 * np.square(excess / length))
        if np.all(share == 1.0):
            continue
        # Across the gap of a joint that turns on, the level passes from one end to the other.
        of_other = excess / (math.inf if period is None else max(period - (high - low), 1e-12))
        of_low = np.where(nearest_image(values, low, high, period) < low, 1.0 - of_other, of_other)
        near_ends = effect.terms(arm, _near_ends(arm, joint, data, low, high, _LEVEL_LENGTHS * length))
        terms = tuple(
            dataclasses.replace(
                term,
                parts=tuple(
                    _left(part, near, share, of_low) if part.motion == arm.axis_motion(joint) else part
                    for part, near in zip(term.parts, near_end.parts, strict=True)
                ),
            )
            for term, near_end in zip(terms, near_ends, strict=True)
        )
    return terms


def _left(part: Part, near: Part, share: Array, of_low: Array) -> Part:
    """Return a part of which a ``share`` ``(N,)`` is left beyond the range; the rest is its level there.

    Args:
        part: The part at the poses.
        near: The same part near both ends of the range.
        share: Share of the effect that is left; 1 within the range.
        of_low: Share of the lower end in the level; the rest is that of the upper end.
    """
    at_low, at_high = np.broadcast_to(near.factor, (2 * _POINTS,)).reshape(2, _POINTS).mean(axis=1)
    level = of_low * at_low + (1.0 - of_low) * at_high
    return dataclasses.replace(part, factor=share * part.factor + (1.0 - share) * level)


def _near_ends(arm: Arm, joint: str, data: Measurements, low: float, high: float, depth: float) -> Measurements:
    """Return the first pose with a joint at :data:`_POINTS` places near the lower end of its range, then the upper."""
    inside = min(depth, 0.5 * (high - low)) * (np.arange(_POINTS) + 0.5) / _POINTS
    rows = data.subset(np.zeros(2 * _POINTS, dtype=np.int64))
    assert rows.q is not None
    q = rows.q.copy()
    q[arm.number(joint)] = np.concatenate((low + inside, high - inside))
    return dataclasses.replace(rows, q=q)
