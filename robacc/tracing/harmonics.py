"""Harmonics of a joint's periodic error, each with its amplitude and phase."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import Effect
from robacc.effects.gear_orders import order_tolerance, origin_of
from robacc.effects.periodic import orders_of
from robacc.fitting.parameters import FittedParameter
from robacc.geometry import Array
from robacc.robots.arm import Arm

_MOST_NAMED = 6
"""Largest number of harmonics named."""
_OF_COUNTERBALANCE = 2.5
"""Order up to which a periodic error may come from a counterbalance."""
_CLEAR = 2.0
"""Standard errors from which a harmonic of a profile is named: about 95 % confidence."""


@dataclass(frozen=True, slots=True)
class Harmonic:
    """One order of a periodic error, amplitude x cos(order q - phase), q the joint's commanded angle; rad."""

    order: float
    amplitude: float
    amplitude_std: float | None
    """Standard error; None, as the phase's, if cosine and sine are not identifiable."""
    phase: float
    phase_std: float | None
    origin: str | None = None
    """Physical origin that the order agrees with; None if there is none."""
    aliases: tuple[float, ...] = ()
    """Other orders that the poses do not distinguish from it."""


def fitted_harmonics(effect: Effect, parameters: Sequence[FittedParameter], covariance: Array) -> tuple[Harmonic, ...]:
    """Return the harmonics of an effect, strongest first, from its parameters: cosine and sine of each order.

    ``covariance`` ``(2 K, 2 K)`` belongs to the parameters; NaN where a parameter is not identified.
    """
    harmonics = _harmonics(orders_of(effect), np.array([parameter.value for parameter in parameters]), covariance)
    return tuple(sorted(harmonics, key=lambda harmonic: -harmonic.amplitude))


def _harmonics(orders: Sequence[float], values: Array, covariance: Array) -> Iterator[Harmonic]:
    """Yield harmonics from alternating cosines and sines; errors by the law of propagation (JCGM 100, 5.2.2)."""
    for i, order in enumerate(orders):
        pair = slice(2 * i, 2 * i + 2)
        cosine, sine = (float(value) for value in values[pair])
        amplitude = math.hypot(cosine, sine)
        along, across = None, None
        if amplitude > 0.0:
            rotation = np.array([[cosine, sine], [-sine, cosine]]) / amplitude
            variance = np.diag(rotation @ covariance[pair, pair] @ rotation.T)
            if np.all(variance >= 0.0):
                along, across = (float(size) for size in np.sqrt(variance))
                across /= amplitude
        yield Harmonic(order, amplitude, along, math.atan2(sine, cosine), across)


def profile_harmonics(harmonics: Sequence[Harmonic]) -> tuple[Harmonic, ...]:
    """Return the strong harmonics of a joint's complete profile, strongest first."""
    clear = [h for h in harmonics if h.amplitude_std is not None and h.amplitude > _CLEAR * h.amplitude_std]
    return tuple(clear[:_MOST_NAMED])


def named_harmonics(
    harmonics: Sequence[Harmonic], aliases: Sequence[float], angle_range: float, arm: Arm, joint: str
) -> tuple[Harmonic, ...]:
    """Return harmonics with their physical origins and, of a single order, its aliases."""
    tolerance = order_tolerance(angle_range)
    ratio = arm.joint(joint).gear_ratio
    return tuple(
        dataclasses.replace(
            harmonic,
            origin=origin_of(harmonic.order, ratio, tolerance),
            aliases=tuple(aliases) if len(harmonics) == 1 else (),
        )
        for harmonic in harmonics
    )


def counterbalance_statement(effect: Effect, harmonics: Sequence[Harmonic], effects: Sequence[Effect]) -> str | None:
    """Return that a counterbalance has the shape of a periodic error; None unless its joint is a spring, too.

    A spring or cylinder of free length L between points at radii a and b of the axis turns the joint by its compliance
    times k a b sin(q + phi) (1 - L / sqrt(a^2 + b^2 + 2 a b cos(q + phi))): a function of the joint's angle alone,
    which orders 1 and 2 describe over a range of 2 rad.
    """
    springs = [other for other in effects if other.is_spring and set(effect.joints) <= set(other.joints)]
    if not springs or not harmonics or any(harmonic.order > _OF_COUNTERBALANCE for harmonic in harmonics):
        return None
    return (
        f"with {springs[0]}, a counterbalance across {effect.joints[0]} has the same shape: a spring or cylinder that "
        "the robot file does not state, whose torque follows the joint's angle"
    )


def periodic_statement(effect: Effect, harmonics: Sequence[Harmonic], effects: Sequence[Effect] = ()) -> str | None:
    """Return the origins of a periodic error's orders, or that it has none and is a profile.

    ``effects`` are all findings; a spring on the same joint makes a counterbalance a possible origin.
    """
    if text := counterbalance_statement(effect, harmonics, effects):
        return text
    if effect.is_profile():
        known = [harmonic for harmonic in harmonics if harmonic.origin is not None]
        if not known:
            return "a profile of the joint's error over its angle: no order agrees with a gear, a motor or an encoder"
    origins = [f"order {harmonic.order:g}: {harmonic.origin}" for harmonic in harmonics if harmonic.origin is not None]
    if not origins and harmonics:
        origins = ["no physical origin of this order is known: read it as a profile of the joint's error"]
    others = [f"{order:g}" for harmonic in harmonics for order in harmonic.aliases]
    if others:
        origins.append(f"orders {', '.join(others)} are not distinguishable from it on these poses")
    return "; ".join(origins) or None
