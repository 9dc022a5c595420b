"""Uncertainty of profiles beyond the ranges that they were fitted on.

Beyond its range a profile returns to zero, the mean of its prior, and its variance returns to that of the prior, which
is equal at all angles and of all orders. Real gears are not so even: low orders are larger, and a part of a turn may be
rougher than another. So :data:`DOUBT` times the variance of the profile's change since the end is added.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robacc.effects.specification import Known
from robacc.effects.validity import clip_drivers, is_outside
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.prediction.motion_columns import motion_columns

DOUBT = 0.3
"""Share of the variance of a profile's change since the end of its range that is added.

Of 0, 0.3, 0.5 and 1 the one whose bounds hold closest to 95 % of the poses of another day of a UR10;
docs/reference/model-accuracy.md has the table.
"""


def relaxation_columns(
    model: Model, coefficients: Sequence[str], covariance: Array, data: Measurements, sample: Measurements
) -> Array | None:
    """Return columns ``(6, K, n)`` whose products over two poses are the covariance that profiles add beyond ranges.

    Args:
        model: Model with its known effects.
        coefficients: Names of the fitted coefficients, P of them.
        covariance: ``(P, P)`` of the coefficients, SI.
        data: Poses with their circumstances.
        sample: All poses, of which ``data`` are some: they decide which profiles have columns.
    """
    number = {name: i for i, name in reversed(list(enumerate(coefficients)))}
    columns = [
        part
        for known in model.known
        if (part := _columns_of(known, model, number, covariance, data, sample)) is not None
    ]
    return np.concatenate(columns, axis=1) if columns else None


def _columns_of(
    known: Known, model: Model, number: Mapping[str, int], covariance: Array, data: Measurements, sample: Measurements
) -> Array | None:
    """Return the columns of one effect; None if it is no profile, or no pose is beyond its range."""
    limits, periods = known.relaxing_limits(model.arm)
    if not limits or not is_outside(model.arm, sample, limits, periods).any():
        return None
    here = known.effect.terms(model.arm, data)
    at_end = known.effect.terms(model.arm, clip_drivers(model.arm, data, limits, periods))
    pairs = [
        (number[term.name], term.parts[0], end.parts[0])
        for term, end in zip(here, at_end, strict=True)
        if term.name in number
    ]
    if not pairs:
        return None
    index = [i for i, _, _ in pairs]
    values, vectors = np.linalg.eigh(covariance[np.ix_(index, index)])
    root = vectors * np.sqrt(DOUBT * np.maximum(values, 0.0))
    motions = tuple(dict.fromkeys(part.motion for _, part, _ in pairs))
    moved = motion_columns(model, data, motions)
    change = np.zeros((len(pairs), len(motions), data.n))
    for i, (_, part, end) in enumerate(pairs):
        change[i, motions.index(part.motion)] = part.factor - end.factor
    result: Array = np.einsum("imn,pmn,pk->ikn", moved, change, root, optimize=True)
    return result
