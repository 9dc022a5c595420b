"""Measurement noise: known from the file, from repeats, or only from the residual itself."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from robacc.fitting.fit_result import Fit
from robacc.fitting.visits import visit_numbers
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.observation import Noise, NoiseSource
from robacc.statistics.distributions import chi2_sf, f_sf

_LEAST_REPEATS = 10
"""Degrees of freedom that an estimate of the noise from repeats needs at least."""
_NEGLIGIBLE = 0.1
"""Ratio of misfit to noise below which the noise is the file's."""


@dataclass(frozen=True, slots=True)
class LackOfFit:
    """Test of a residual against noise that is known independently of the model."""

    noise: Noise
    p_value: float | None
    """None if noise is known from the residual alone."""
    ratio: float
    """Root mean square of the residual over that of the noise."""


def lack_of_fit(fit: Fit, data: Measurements) -> LackOfFit:
    """Compare the residual of the inliers with the measurement noise."""
    rows = fit.inliers
    dof = fit.degrees_of_freedom * (0.5 if fit.residual.shape[0] == 6 else 1.0)
    sum_of_squares = float(np.sum(np.square(fit.residual[:3, rows])))
    if fit.scatter is not None and fit.scatter.any():
        # Noise and scatter were estimated together from this residual, so it cannot be more than both.
        white = fit.whitening.apply(fit.residual * rows)[:3]
        noise = replace(fit.noise, source=_source_beside_scatter(fit, data))
        return LackOfFit(noise, None, float(np.sqrt(np.sum(np.square(white)) / max(dof, 1.0))))
    repeats = _pure_error(fit, data)
    if repeats is not None:
        variance, repeat_dof = repeats
        remaining_dof = max(dof - repeat_dof, 1.0)
        between = max(sum_of_squares - variance * repeat_dof, 0.0) / remaining_dof
        p_value = f_sf(between / max(variance, 1e-300), remaining_dof, repeat_dof)
        noise = Noise(float(np.sqrt(variance)), fit.noise.orientation, "repeats")
        return LackOfFit(noise, p_value, float(np.sqrt(sum_of_squares / max(dof, 1.0) / variance)))
    if data.sigma_position is not None:
        known = np.square(data.sigma_position[:, rows])
        statistic = float(np.sum(np.square(fit.residual[:3, rows]) / known))
        sigma = float(np.sqrt(np.mean(known)))
        orientation = None
        if data.sigma_rotation is not None and data.rotation is not None:
            orientation = float(np.sqrt(np.mean(np.square(data.sigma_rotation[rows]))))
        ratio = float(np.sqrt(sum_of_squares / max(dof, 1.0))) / sigma
        stated = Noise.of_variances(np.mean(known, axis=1), orientation, "file")
        return LackOfFit(stated, chi2_sf(statistic, max(dof, 1.0)), ratio)
    return LackOfFit(fit.noise, None, 1.0)


def _source_beside_scatter(fit: Fit, data: Measurements) -> NoiseSource:
    """Return where the noise comes from that was estimated together with the scatter of the joints."""
    if data.sigma_position is not None:
        return "file" if fit.misfit[0] <= _NEGLIGIBLE * fit.noise.position else "file and misfit"
    visits, poses = visit_numbers(data)[fit.inliers], data.groups()[fit.inliers]
    return "repeats" if np.unique(visits).size > np.unique(poses).size else "residual"


def _pure_error(fit: Fit, data: Measurements) -> tuple[float, float] | None:
    """Return the variance along an axis (m^2) within repeats of a commanded pose, and its degrees of freedom."""
    repeats = variances_of_repeats(fit.residual[:3], fit, data)
    if repeats is None:
        return None
    variances, dof = repeats
    variance = float(np.mean(variances))
    return (variance, 3.0 * dof) if variance > 0 else None


def variances_of_repeats(residual: Array, fit: Fit, data: Measurements) -> tuple[Array, float] | None:
    """Return the variances ``(3,)`` (m²) within repeats of a commanded pose, and the degrees of freedom of each.

    ``residual`` ``(3, N)`` are residuals of the fit, along any axes. None if there are too few repeats.
    """
    rows = data.first_measured(fit.inliers)
    groups = data.groups()[rows]
    if data.target is not None:
        pairs = np.stack((groups, np.unique(data.target[rows], return_inverse=True)[1]))
        groups = np.unique(pairs, axis=1, return_inverse=True)[1]
    counts = np.bincount(groups)
    dof = float(np.sum(np.maximum(counts - 1, 0)))
    if 3.0 * dof < _LEAST_REPEATS:
        return None
    means = np.array([np.bincount(groups, weights=axis) / np.maximum(counts, 1) for axis in residual[:, rows]])
    return np.sum(np.square(residual[:, rows] - means[:, groups]), axis=1) / dof, dof
