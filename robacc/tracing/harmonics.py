"""Harmonics of a joint's periodic error, each with its amplitude and phase."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import Effect
from robacc.effects.gear_orders import order_tolerance, origin_of
from robacc.effects.periodic import of_order, orders_of
from robacc.fitting.parameters import FittedParameter
from robacc.geometry import Array
from robacc.robots.arm import Arm
from robacc.tracing.candidates import Candidate, OrderGrid
from robacc.tracing.ranking import Chosen
from robacc.tracing.selection import Selection

_MOST_NAMED = 6
"""Largest number of harmonics named."""
_ALIAS = 5.0
"""Evidence (log Bayes factor) within which another order is an alias (odds of 150 to 1)."""
_MOST_ALIASES = 3
_OF_COUNTERBALANCE = 2.5
"""Order up to which a periodic error may come from a counterbalance."""
_WEAK = 0.1
"""Share of the strongest harmonic's evidence below which a harmonic is not named."""


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


def profile_harmonics(selection: Selection, profile: Chosen) -> tuple[Harmonic, ...]:
    """Return the strong harmonics of a joint's complete profile, by descending evidence.

    Neighbouring orders of a profile share a physical harmonic, and the model mostly reproduces the profile's slow part.
    So the profile is removed and single orders, integer or not, are added in its place in turn, each given those
    before.
    """
    joint = profile.candidate.effect.joints[0]
    scorer, others = selection.scorer, [other for other in selection.chosen if other is not profile]
    grid = next((grid for grid in scorer.order_grids if grid.joint == joint), None)
    if grid is None:
        return ()
    chosen: list[Chosen] = []
    strongest = 0.0
    for _ in range(_MOST_NAMED):
        order, evidence = scorer.strongest_order(scorer.condition([*others, *chosen]), grid)
        if evidence <= _WEAK * strongest or evidence <= 0:
            break
        strongest = strongest or evidence
        chosen.append(scorer.as_chosen(_candidate(grid, order), 0.0))
    if not chosen:
        return ()
    # The columns are appended during the search; condition once more, so that the system contains them all.
    columns = np.concatenate([harmonic.columns for harmonic in chosen])
    conditioned = scorer.condition(others)
    values = conditioned.least_squares(columns)
    remaining = max(conditioned.cost - float(values @ conditioned.rhs[columns]), 0.0)
    variance = remaining / max(conditioned.dof - columns.size, 1.0)
    covariance = np.asarray(variance * np.linalg.pinv(conditioned.block(columns), hermitian=True), dtype=np.float64)
    orders = [orders_of(harmonic.candidate.effect)[0] for harmonic in chosen]
    return tuple(_harmonics(orders, values, covariance))


def named_harmonics(
    harmonics: Sequence[Harmonic], selection: Selection, finding: Chosen | None, arm: Arm, joint: str
) -> tuple[Harmonic, ...]:
    """Return harmonics with their physical origins and, of a single order, its aliases."""
    grid = next((grid for grid in selection.scorer.order_grids if grid.joint == joint), None)
    if grid is None:
        return tuple(harmonics)
    tolerance = order_tolerance(float(np.ptp(grid.angle)))
    ratio = arm.joint(joint).gear_ratio
    aliases: tuple[float, ...] = ()
    if len(harmonics) == 1 and finding is not None:
        conditioned = selection.scorer.condition(selection.chosen, without=finding)
        orders, evidence = selection.scorer.order_evidence(conditioned, joint)
        aliases = _aliases(orders, evidence, harmonics[0].order, 10 * tolerance)
    return tuple(
        dataclasses.replace(harmonic, origin=origin_of(harmonic.order, ratio, tolerance), aliases=aliases)
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


def _aliases(orders: Array, evidence: Array, order: float, apart: float) -> tuple[float, ...]:
    """Return peaks of the evidence more than ``apart`` from ``order`` that come within odds of its own."""
    if orders.size == 0:
        return ()
    near = np.abs(orders - order) <= apart
    limit = float(evidence[near].max(initial=0.0)) - _ALIAS
    taken = near.copy()
    result: list[float] = []
    while len(result) < _MOST_ALIASES:
        candidates = np.where(taken, -np.inf, evidence)
        best = int(np.argmax(candidates))
        if candidates[best] <= max(limit, 0.0):
            break
        result.append(float(orders[best]))
        taken |= np.abs(orders - orders[best]) <= apart
    return tuple(result)


def _candidate(grid: OrderGrid, order: float) -> Candidate:
    return Candidate(of_order(grid.joint, order), (), grid.log_prior)
