"""How much of a residual is measuring noise: known from the file, from repeats, or only from the residual itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robacc.fitting.solver import Fit
from robacc.measurements import Measurements
from robacc.modelling.observation import Noise
from robacc.statistics.distributions import chi2_sf, f_sf

_LEAST_REPEATS = 10
"""Degrees of freedom below which repeats say too little of the noise."""


@dataclass(frozen=True, slots=True)
class LackOfFit:
    """Whether a residual is more than noise that is known independently of the model."""

    noise: Noise
    p_value: float | None
    """None where noise is known from the residual alone: then only structure can tell."""
    ratio: float
    """Root mean square of the residual over the noise's."""


def lack_of_fit(found: Fit, data: Measurements) -> LackOfFit:
    """Compare the residual of the rows that took part with the measuring noise."""
    rows = found.kept
    freedom = found.degrees_of_freedom * (0.5 if found.residual.shape[0] == 6 else 1.0)
    energy = float(np.sum(np.square(found.residual[:3, rows])))
    repeats = _pure_error(found, data)
    if repeats is not None:
        variance, repeat_freedom = repeats
        rest = max(freedom - repeat_freedom, 1.0)
        between = max(energy - variance * repeat_freedom, 0.0) / rest
        p_value = f_sf(between / max(variance, 1e-300), rest, repeat_freedom)
        noise = Noise(float(np.sqrt(variance)), found.noise.orientation, "repeats")
        return LackOfFit(noise, p_value, float(np.sqrt(energy / max(freedom, 1.0) / variance)))
    if data.sigma_position is not None:
        known = np.square(data.sigma_position[:, rows])
        statistic = float(np.sum(np.square(found.residual[:3, rows]) / known))
        sigma = float(np.sqrt(np.mean(known)))
        orientation = None
        if data.sigma_rotation is not None and data.rotation is not None:
            orientation = float(np.sqrt(np.mean(np.square(data.sigma_rotation[rows]))))
        ratio = float(np.sqrt(energy / max(freedom, 1.0))) / sigma
        return LackOfFit(Noise(sigma, orientation, "file"), chi2_sf(statistic, max(freedom, 1.0)), ratio)
    return LackOfFit(found.noise, None, 1.0)


def _pure_error(found: Fit, data: Measurements) -> tuple[float, float] | None:
    """Variance along an axis (m^2) within repeats of one commanded pose, and its degrees of freedom."""
    groups = data.groups()[found.kept]
    if data.target is not None:
        pairs = np.stack((groups, np.unique(data.target[found.kept], return_inverse=True)[1]))
        groups = np.unique(pairs, axis=1, return_inverse=True)[1]
    counts = np.bincount(groups)
    freedom = 3.0 * float(np.sum(np.maximum(counts - 1, 0)))
    if freedom < _LEAST_REPEATS:
        return None
    residual = found.residual[:3, found.kept]
    within = 0.0
    for axis in residual:
        means = np.bincount(groups, weights=axis) / np.maximum(counts, 1)
        within += float(np.sum(np.square(axis - means[groups])))
    return (within / freedom, freedom) if within > 0 else None
