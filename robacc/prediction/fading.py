"""Uncertainty that profiles add beyond the ranges that they were fitted on.

Beyond its range a profile fades to its level at the end of the range, while the variance of its coefficients grows to
that of the prior. What fading takes from the profile also counts as a standard deviation: near the range the poses
still say something of it.
"""

from __future__ import annotations

import numpy as np

from robacc.effects.beyond_range import faded
from robacc.effects.specification import Known
from robacc.effects.validity import is_outside
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.prediction.motion_columns import motion_columns


def fading_columns(model: Model, data: Measurements, sample: Measurements) -> Array | None:
    """Return columns ``(6, K, n)`` whose products over two poses are the covariance that fading adds; None if none.

    Args:
        model: Model with its known effects.
        data: Poses with their circumstances.
        sample: All poses, of which ``data`` are some: they decide which profiles have columns.
    """
    columns = [part for known in model.known if (part := _column_of(known, model, data, sample)) is not None]
    return np.stack(columns, axis=1) if columns else None


def _column_of(known: Known, model: Model, data: Measurements, sample: Measurements) -> Array | None:
    """Return what fading takes from an effect ``(6, n)``; None if it does not fade, or no pose is beyond its range."""
    limits, periods = known.fading_limits(model.arm)
    if not limits or not is_outside(model.arm, sample, limits, periods).any():
        return None
    complete = known.effect.terms(model.arm, data)
    left = faded(known.effect, model.arm, data, known.validity)
    motions = tuple(dict.fromkeys(term.parts[0].motion for term in complete))
    lost = np.zeros((len(motions), data.n))
    for whole, rest in zip(complete, left, strict=True):
        before, after = whole.parts[0], rest.parts[0]
        lost[motions.index(before.motion)] += known.values.get(whole.name, 0.0) * (before.factor - after.factor)
    result: Array = np.einsum("imn,mn->in", motion_columns(model, data, motions), lost)
    return result
