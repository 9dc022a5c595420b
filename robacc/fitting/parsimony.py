"""Hayati's rotation only if the data require it.

Near-parallel axes need a rotation about y in the model, or their tilt cannot be described (Hayati 1983). If the axes
are truly parallel, it is one more coefficient that fits noise, which costs accuracy at poses far from those measured.
So if the whole geometry is fitted, the rotations are put to a joint Wald test once everything else is in the model, and
left out if they are not significant.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from robacc.effects.base import Effect
from robacc.effects.link_geometry import LinkGeometry
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.linear_algebra import solved
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.statistics.distributions import chi2_sf

_SIGNIFICANCE = 0.001
"""The rotations stay if their p-value is at most this."""


def without_idle_rotations(fitted: Fit, original: Model, data: Measurements, options: Options) -> Fit:
    """Return ``fitted``, or the fit of ``original`` without the rotations about y of a geometry fitted as a whole."""
    place = next((i for i, effect in enumerate(original.free) if _is_whole_geometry(effect, original.arm)), None)
    columns = fitted.identifiability.columns
    rotations = [i for i in columns if fitted.owners[i] == place and fitted.terms[i].label == "beta"]
    if place is None or not rotations or not np.isfinite(fitted.covariance[rotations, rotations]).all():
        return fitted
    value = fitted.theta[rotations]
    covariance = fitted.covariance[np.ix_(rotations, rotations)]
    std = np.sqrt(np.diag(covariance))
    statistic = float(value / std @ solved(covariance / std[:, None] / std, value / std))
    if chi2_sf(statistic, float(len(rotations))) <= _SIGNIFICANCE:
        return fitted
    effects = list(original.free)
    effects[place] = LinkGeometry(effects[place].joints, ("theta", "d", "a", "alpha"))
    return fit(dataclasses.replace(original, free=tuple(effects)), data, options)


def _is_whole_geometry(effect: Effect, arm: Arm) -> bool:
    """Return whether the effect is the arm's whole geometry, not a single row of it."""
    return isinstance(effect, LinkGeometry) and not effect.labels and set(effect.joints) == set(arm.names)
