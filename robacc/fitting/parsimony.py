"""Hayati's rotation only where the data show it.

Near-parallel axes need a rotation about y in the model, or their tilt has nowhere to go (Hayati 1983). Where the axes
are truly parallel it is one more number for noise to fill, which costs accuracy at poses far from those measured. So
where the whole geometry is fitted, the rotations are put to a Wald test together once everything else is in the model,
and left out where they do not matter.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from robacc.effects.base import Effect
from robacc.effects.link_geometry import LinkGeometry
from robacc.fitting.solver import Fit, Options, fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.statistics.distributions import chi2_sf

_NEEDED = 0.001
"""The rotations stay where chance alone would make them this large less often."""


def without_idle_rotations(found: Fit, original: Model, data: Measurements, options: Options) -> Fit:
    """``found``, or the fit of ``original`` with the rotations about y left out of a geometry that is fitted whole."""
    place = next((i for i, effect in enumerate(original.free) if _is_whole(effect, original.arm)), None)
    kept = found.identifiability.kept
    rotations = [i for i in kept if found.owners[i] == place and found.names[i].endswith(".beta")]
    if place is None or not rotations or not np.isfinite(found.covariance[rotations, rotations]).all():
        return found
    value = found.theta[rotations]
    statistic = float(value @ np.linalg.solve(found.covariance[np.ix_(rotations, rotations)], value))
    if chi2_sf(statistic, float(len(rotations))) <= _NEEDED:
        return found
    effects = list(original.free)
    effects[place] = LinkGeometry(effects[place].joints, ("theta", "d", "a", "alpha"))
    return fit(dataclasses.replace(original, free=tuple(effects)), data, options)


def _is_whole(effect: Effect, arm: Arm) -> bool:
    """Whether it is the arm's whole geometry, and not a row of it that stands out."""
    return isinstance(effect, LinkGeometry) and not effect.labels and set(effect.joints) == set(arm.names)
