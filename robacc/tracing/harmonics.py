"""The orders that a joint's periodic error is made of, each with its amplitude and phase."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import Effect
from robacc.effects.periodic import of_order, orders_of
from robacc.fitting.parameters import FittedParameter
from robacc.geometry import Array
from robacc.tracing.candidate_scorer import Chosen
from robacc.tracing.candidates import Candidate, OrderGrid
from robacc.tracing.selection import Selection

_MOST = 6
"""Lines named at most."""
_WEAK = 0.1
"""A line that adds less than this share of the strongest one's evidence is not named."""


@dataclass(frozen=True, slots=True)
class Harmonic:
    """One order of a periodic error, amplitude x cos(order q - phase), q the joint's commanded angle; rad."""

    order: float
    amplitude: float
    amplitude_std: float | None
    """Standard error; None, as the phase's, where the poses do not show cosine and sine."""
    phase: float
    phase_std: float | None


def fitted_harmonics(effect: Effect, own: Sequence[FittedParameter], covariance: Array) -> tuple[Harmonic, ...]:
    """The lines of an effect of few orders, strongest first, from its parameters: cosine and sine of each order.

    ``covariance`` ``(2 K, 2 K)`` is the parameters', NaN where one is not identified.
    """
    found = _lines(orders_of(effect), np.array([one.value for one in own]), covariance)
    return tuple(sorted(found, key=lambda line: -line.amplitude))


def _lines(orders: Sequence[float], values: Array, covariance: Array) -> Iterator[Harmonic]:
    """Amplitudes and phases of cosines and sines in turn, their errors by the law of propagation (JCGM 100, 5.2.2)."""
    for i, order in enumerate(orders):
        pair = slice(2 * i, 2 * i + 2)
        cosine, sine = (float(value) for value in values[pair])
        amplitude = math.hypot(cosine, sine)
        along, across = None, None
        if amplitude > 0.0:
            turned = np.array([[cosine, sine], [-sine, cosine]]) / amplitude
            variance = np.diag(turned @ covariance[pair, pair] @ turned.T)
            if np.all(variance >= 0.0):
                along, across = (float(size) for size in np.sqrt(variance))
                across /= amplitude
        yield Harmonic(order, amplitude, along, math.atan2(sine, cosine), across)


def profile_harmonics(selection: Selection, one: Chosen) -> tuple[Harmonic, ...]:
    """The strong lines of a joint's whole profile, in the order in which they explain most.

    Neighbouring orders of a profile share one physical line, and its slow part is mostly what the model mimics; so the
    profile is taken out and single orders, whole or not, are put in its place one at a time, each beside those before.
    """
    joint = one.candidate.effect.joints[0]
    field, others = selection.field, [other for other in selection.chosen if other is not one]
    wave = next((wave for wave in field.waves if wave.joint == joint), None)
    if wave is None:
        return ()
    taken: list[Chosen] = []
    strongest = 0.0
    for _ in range(_MOST):
        order, evidence = field.strongest_order(field.condition([*others, *taken]), wave)
        if evidence <= _WEAK * strongest or evidence <= 0:
            break
        strongest = strongest or evidence
        taken.append(field.taken(_candidate(wave, order), 0.0))
    if not taken:
        return ()
    # Columns are built as lines are found; the model without them is conditioned on once more, to see them all.
    columns = np.concatenate([line.columns for line in taken])
    conditioned = field.condition(others)
    values = conditioned.least_squares(columns)
    left = max(conditioned.energy - float(values @ conditioned.moment[columns]), 0.0)
    variance = left / max(conditioned.freedom - columns.size, 1.0)
    covariance = np.asarray(variance * np.linalg.pinv(conditioned.block(columns), hermitian=True), dtype=np.float64)
    orders = [orders_of(line.candidate.effect)[0] for line in taken]
    return tuple(_lines(orders, values, covariance))


def _candidate(wave: OrderGrid, order: float) -> Candidate:
    return Candidate(of_order(wave.joint, order), (), wave.log_prior)
