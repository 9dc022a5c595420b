"""Effects beyond the range of their drivers: held at its end, or fading to their level there."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import Effect, Part, Term
from robacc.effects.validity import Periods, Validity, clip_drivers, driver_values, nearest_image, range_excess
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

_LEVEL_LENGTHS = 4.0
"""Fading lengths at the end of a range over which an effect's level there is its mean: for a profile, one period of its
finest order. On parts of a real arm's poses, half and twice as much predict as well."""
_POINTS = 32
"""Places at which the level is sampled."""


def limits_of(effect: Effect, arm: Arm, validity: Validity, names: Sequence[str]) -> tuple[Validity, Periods]:
    """Return the ranges of some drivers of an effect, and the periods of those that have one."""
    periods = {name: effect.period(arm, name) for name in names}
    return (
        {name: validity[name] for name in names},
        {name: period for name, period in periods.items() if period is not None},
    )


def held_at_ends(effect: Effect, arm: Arm, data: Measurements, validity: Validity) -> Measurements:
    """Return the poses with the drivers that ``effect`` does not extrapolate held at the ends of their ranges."""
    if not validity:
        return data
    return clip_drivers(arm, data, *limits_of(effect, arm, validity, effect.held_drivers(arm, validity)))


def faded(effect: Effect, arm: Arm, data: Measurements, validity: Validity) -> tuple[Term, ...]:
    """Return the terms of an effect, less and less of them the farther a fading joint is beyond its range.

    What remains is the effect's level at that end of the range, its mean there over :data:`_LEVEL_LENGTHS` fading
    lengths: beyond the range, slow waves of a profile are still as they were, and fine ones are unknown.
    """
    effect = effect.within(validity)
    terms = effect.terms(arm, data)
    limits, periods = limits_of(effect, arm, validity, effect.fading_drivers(arm, validity))
    for joint, (low, high) in limits.items():
        values = driver_values(arm, data, joint)
        if values is None:
            continue
        beyond = _Beyond.of(effect, arm, joint, values, (low, high), periods.get(joint))
        if np.all(beyond.share == 1.0):
            continue
        near_ends = effect.terms(arm, _near_ends(effect, arm, joint, data, (low, high)))
        terms = tuple(
            dataclasses.replace(term, parts=tuple(map(beyond.left, term.parts, near.parts)))
            for term, near in zip(terms, near_ends, strict=True)
        )
    return terms


@dataclass(frozen=True, slots=True)
class _Beyond:
    """How far each pose has a joint beyond its range."""

    motion: int
    share: Array
    """``(N,)`` share of the effect that is left; 1 within the range."""
    of_low: Array
    """``(N,)`` share of the lower end in the level; the rest is that of the upper end."""

    @classmethod
    def of(
        cls, effect: Effect, arm: Arm, joint: str, values: Array, limits: tuple[float, float], period: float | None
    ) -> _Beyond:
        low, high = limits
        excess = range_excess(values, low, high, period)
        # Across the gap of a joint that turns on, the level passes from one end to the other.
        of_other = excess / (math.inf if period is None else max(period - (high - low), 1e-12))
        is_below = nearest_image(values, low, high, period) < low
        share = np.exp(-0.5 * np.square(excess / effect.fading_length(arm, joint)))
        return cls(arm.axis_motion(joint), share, np.where(is_below, 1.0 - of_other, of_other))

    def left(self, part: Part, near_ends: Part) -> Part:
        """Return a part as it is beyond the range; ``near_ends`` is the same part near both ends of the range."""
        if part.motion != self.motion:
            return part
        factors = np.broadcast_to(near_ends.factor, (2 * _POINTS,)).reshape(2, _POINTS)
        at_low, at_high = factors.mean(axis=1)
        level = self.of_low * at_low + (1.0 - self.of_low) * at_high
        return dataclasses.replace(part, factor=self.share * part.factor + (1.0 - self.share) * level)


def _near_ends(effect: Effect, arm: Arm, joint: str, data: Measurements, limits: tuple[float, float]) -> Measurements:
    """Return the first pose with a joint at :data:`_POINTS` places near the lower end of its range, then the upper."""
    low, high = limits
    depth = min(_LEVEL_LENGTHS * effect.fading_length(arm, joint), 0.5 * (high - low))
    inside = depth * (np.arange(_POINTS) + 0.5) / _POINTS
    rows = data.subset(np.zeros(2 * _POINTS, dtype=np.int64))
    assert rows.q is not None
    q = rows.q.copy()
    q[arm.number(joint)] = np.concatenate((low + inside, high - inside))
    return dataclasses.replace(rows, q=q)
