"""Uncertainty of effects beyond the ranges that they were fitted on.

Beyond its range a held effect keeps its value at the end, and the truth goes on. The squared difference of two distant
values of a stationary function is twice its mean square, on average. So the scalar that the effect moves has this
variance from a tenth of the range beyond its end. From a whole range on the standard deviation grows in proportion,
unless the effect is periodic, which bounds it. Effects with a physical reason to go on (compliance, gear ratio) have
none of it.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from robacc.effects.base import SCALE_OF_INSTRUMENT, Part, Term
from robacc.effects.specification import Known
from robacc.effects.validity import MARGIN, Validity, driver_values
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm

_SAMPLES = 200
_SHARE = 0.1
"""Share of a range beyond its end at which nothing of the effect is known any more."""
_COLUMNS = {"time_s": "time", "temperature_c": "temperature", "payload_kg": "payload"}


def extrapolation(model: Model, data: Measurements) -> Array | None:
    """Return the covariance ``(6, 6, n)`` that held effects add beyond their ranges; None if no pose is beyond one.

    Args:
        model: Model with its known effects.
        data: Poses with their circumstances.
    """
    variance: dict[int, Array] = {}
    for known in model.known:
        limits = {name: known.validity[name] for name in known.effect.held_drivers(model.arm, known.validity)}
        growth = _growth(model.arm, data, limits, known.effect.is_bounded)
        if not growth.any():
            continue
        for motion, square in _mean_squares(model.arm, known, data, limits).items():
            variance[motion] = variance.get(motion, np.zeros(data.n)) + 2.0 * np.square(growth) * square
    if not variance:
        return None
    jacobian = _motion_columns(model, data, tuple(variance))
    result: Array = np.einsum("imn,mn,jmn->ijn", jacobian, np.array(list(variance.values())), jacobian, optimize=True)
    return result


def _growth(arm: Arm, data: Measurements, limits: Validity, is_bounded: bool) -> Array:
    """Return the standard deviation ``(n,)`` of a held effect over its size."""
    share = np.zeros(data.n)
    for name, (low, high) in limits.items():
        if (values := driver_values(arm, data, name)) is not None:
            excess = np.maximum(np.maximum(low - values, values - high), 0.0) / max(high - low, 1e-12)
            share = np.maximum(share, np.where(excess > MARGIN, excess, 0.0))
    within: Array = np.minimum(share / _SHARE, 1.0)
    return within if is_bounded else np.maximum(within, share)


def _mean_squares(arm: Arm, known: Known, data: Measurements, limits: Validity) -> dict[int, float]:
    """Return the mean square of the scalar that an effect adds to each motion, over its ranges."""
    sample = _within(arm, data, limits)
    sums: dict[int, Array] = {}
    for term in known.effect.terms(arm, sample):
        value = known.values.get(term.name, 0.0)
        for part in term.parts:
            if part.loads is None and part.motion != SCALE_OF_INSTRUMENT:
                sums[part.motion] = sums.get(part.motion, np.zeros(sample.n)) + value * part.factor
    return {motion: float(np.mean(np.square(scalar))) for motion, scalar in sums.items()}


def _within(arm: Arm, data: Measurements, limits: Validity) -> Measurements:
    """Return poses whose drivers are spread evenly over their ranges; all else is as in ``data``."""
    sample = data.subset(np.arange(_SAMPLES) % data.n)
    assert sample.q is not None
    changes: dict[str, Any] = {}
    rng = np.random.default_rng(0)
    for name, (low, high) in limits.items():
        values = rng.permutation(np.linspace(low, high, _SAMPLES))
        if name in arm.names:
            q = changes.setdefault("q", sample.q.copy())
            q[arm.number(name)] = values
        elif name in _COLUMNS:
            changes[_COLUMNS[name]] = values
    return dataclasses.replace(sample, **changes)


def _motion_columns(model: Model, data: Measurements, motions: tuple[int, ...]) -> Array:
    """Return the derivative ``(6, len(motions), n)`` of the poses to the scalars of some motions."""
    bound = dataclasses.replace(model, free=()).bind(data)
    terms = tuple(Term(f"motion{motion}", "", 1.0, (Part(motion),)) for motion in motions)
    moved = dataclasses.replace(bound, terms=terms, owners=tuple(range(len(terms))))
    return moved.linearise(np.zeros(len(terms)))[1]
