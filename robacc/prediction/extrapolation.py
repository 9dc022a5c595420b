"""Uncertainty of effects and profiles beyond the ranges that they were fitted on.

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
from robacc.effects.drivers import MARGIN, Periods, Validity, driver_values, is_outside, nearest_image, range_excess
from robacc.effects.specification import Known, faded
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.statistics.distributions import normal_quantile

_SAMPLES = 200
_SHARE = 0.1
"""Share of a range beyond its end at which nothing of the effect is known any more."""
_WAVES = 64
"""Pairs of waves that make up a process."""
_COLUMNS = {"time_s": "time", "temperature_c": "temperature", "payload_kg": "payload"}


def beyond_columns(model: Model, data: Measurements, sample: Measurements | None = None) -> Array:
    """Return columns ``(6, K, n)`` of the errors beyond the ranges of effects; their outer products are covariances.

    The error of a held effect is the same function of its drivers at every pose: a stationary Gaussian process of the
    drivers, less its value at the end of the range, with a correlation length of half of :data:`_SHARE` of the range.
    Source of the columns: A. Rahimi and B. Recht, "Random features for large-scale kernel machines", NIPS (2007), here
    at the points of an additive recurrence.

    Args:
        model: Model with its known effects.
        data: Poses with their circumstances.
        sample: All poses, of which ``data`` are some: they decide the size of an effect. Products of the columns at
            two poses are covariances too. With None, only those at one pose are, which takes fewer columns.
    """
    columns = [np.zeros((6, 0, data.n))]
    for known in model.known:
        if stds := _motion_stds(model.arm, known, data, sample):
            waves = np.ones((1, data.n)) if sample is None else _difference_waves(model.arm, known, data)
            jacobian = _motion_columns(model, data, tuple(stds))
            columns += [jacobian[:, i, None] * (std * waves) for i, std in enumerate(stds.values())]
        columns.append(_faded_column(known, model, data, sample or data))
    return np.concatenate(columns, axis=1)


def _motion_columns(model: Model, data: Measurements, motions: tuple[int, ...]) -> Array:
    """Return the derivative ``(6, len(motions), n)`` of the poses to the scalars of some motions."""
    bound = dataclasses.replace(model, free=()).bind(data)
    terms = tuple(Term(f"motion{motion}", "", 1.0, (Part(motion),)) for motion in motions)
    moved = dataclasses.replace(bound, terms=terms, owners=tuple(range(len(terms))))
    return moved.linearise(np.zeros(len(terms)))[1]


def _difference_waves(arm: Arm, known: Known, data: Measurements) -> Array:
    """Return ``(K, n)`` the process at the poses less its value at the end of the range, of unit size."""
    limits, periods = known.held_limits(arm)
    rows = []
    for name, (low, high) in limits.items():
        if (values := driver_values(arm, data, name)) is not None:
            image = nearest_image(values, low, high, periods.get(name))
            rows.append(np.stack((image, np.clip(image, low, high))) / max(high - low, 1e-12))
    if not rows:
        return np.zeros((0, data.n))
    places = np.array(rows) / (0.5 * _SHARE)
    phase = np.tensordot(_frequencies(len(rows)), places, axes=1)
    waves = np.concatenate([wave(phase[:, 0]) - wave(phase[:, 1]) for wave in (np.cos, np.sin)])
    length = np.linalg.norm(waves, axis=0)
    result: Array = waves / np.where(length > 0.0, length, 1.0)
    return result


def _frequencies(count: int) -> Array:
    """Return ``(K, count)`` normal quantiles of evenly spread points."""
    # The generalised golden ratio g with g^(count + 1) = g + 1 spreads points evenly in any number of dimensions.
    ratio = 2.0
    for _ in range(50):
        ratio = (1.0 + ratio) ** (1.0 / (count + 1))
    points = np.modf(0.5 + np.outer(np.arange(_WAVES), ratio ** -np.arange(1.0, count + 1)))[0]
    return np.array([[normal_quantile(float(value)) for value in row] for row in np.clip(points, 1e-6, 1.0 - 1e-6)])


def _motion_stds(arm: Arm, known: Known, data: Measurements, sample: Measurements | None = None) -> dict[int, Array]:
    """Return the standard deviation ``(n,)`` of the scalar of each motion; none if no pose is beyond the ranges."""
    limits, periods = known.held_limits(arm)
    growth = _growth(arm, data, limits, periods, known.effect.traits.is_bounded)
    # With ``sample``, poses are a block of many, which all have the columns of every held effect.
    if not limits or (sample is None and not growth.any()):
        return {}
    squares = _mean_squares(arm, known, data if sample is None else sample, limits)
    return {motion: np.sqrt(2.0 * square) * growth for motion, square in squares.items()}


def _growth(arm: Arm, data: Measurements, limits: Validity, periods: Periods, is_bounded: bool) -> Array:
    """Return the standard deviation ``(n,)`` of a held effect over its size."""
    share = np.zeros(data.n)
    for name, (low, high) in limits.items():
        if (values := driver_values(arm, data, name)) is not None:
            excess = range_excess(values, low, high, periods.get(name)) / max(high - low, 1e-12)
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


# Uncertainty that profiles add beyond the ranges that they were fitted on.
#
# Beyond its range a profile fades to its level at the end of the range, while the variance of its coefficients grows
# to that of the prior. What fading takes from the profile also counts as a standard deviation: near the range the
# poses still say something of it.


def _faded_column(known: Known, model: Model, data: Measurements, sample: Measurements) -> Array:
    """Return what fading takes from an effect ``(6, 1, n)``; no column if no pose of ``sample`` is beyond its range."""
    limits, periods = known.fading_limits(model.arm)
    if not limits or not is_outside(model.arm, sample, limits, periods).any():
        return np.zeros((6, 0, data.n))
    complete = known.effect.terms(model.arm, data)
    left = faded(known.effect, model.arm, data, known.validity)
    motions = tuple(dict.fromkeys(term.parts[0].motion for term in complete))
    lost = np.zeros((len(motions), data.n))
    for whole, rest in zip(complete, left, strict=True):
        before, after = whole.parts[0], rest.parts[0]
        lost[motions.index(before.motion)] += known.values.get(whole.name, 0.0) * (before.factor - after.factor)
    result: Array = np.einsum("imn,mn->in", _motion_columns(model, data, motions), lost)
    return result[:, None]
