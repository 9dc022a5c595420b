"""The orders that a joint's periodic error is made of, each with its amplitude and phase."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects.transmission_error import TransmissionError
from robacc.fitting.parameters import Parameter
from robacc.tracing.candidates import Candidate, Waves
from robacc.tracing.competition import Chosen
from robacc.tracing.selection import Selection

_MOST = 6
"""Lines named at most."""
_WEAK = 0.1
"""A line that adds less than this share of the strongest one's evidence is not named."""


@dataclass(frozen=True, slots=True)
class Line:
    """One order of a periodic error: amplitude (rad) and phase of amplitude x cos(order q - phase)."""

    order: float
    amplitude: float
    phase: float


def fitted_lines(effect: TransmissionError, own: Sequence[Parameter]) -> tuple[Line, ...]:
    """The lines of an effect of few orders, strongest first, from its parameters: cosine and sine of each order."""
    found = [
        Line(order, math.hypot(cosine.value, sine.value), math.atan2(sine.value, cosine.value))
        for order, cosine, sine in zip(effect.orders, own[::2], own[1::2], strict=True)
    ]
    return tuple(sorted(found, key=lambda line: -line.amplitude))


def profile_lines(selection: Selection, one: Chosen) -> tuple[Line, ...]:
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
    values = field.condition(others).least_squares(columns)
    return tuple(
        Line(float(line.candidate.effect.settings()["orders"][0]), math.hypot(c, s), math.atan2(s, c))
        for line, c, s in zip(taken, values[::2], values[1::2], strict=True)
    )


def _candidate(wave: Waves, order: float) -> Candidate:
    return Candidate(TransmissionError((wave.joint,), (order,)), (), wave.log_prior)
