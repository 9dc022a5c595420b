"""Warnings that every fit can give, and the measurement noise that they are judged by."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from robacc.fitting.fit_result import Fit
from robacc.fitting.outliers import outlier_pattern
from robacc.fitting.priors import weak_kinds
from robacc.fitting.registration import ALIGNABLE
from robacc.fitting.visits import visit_numbers
from robacc.geometry import Array
from robacc.measurements import Measurements, different
from robacc.modelling.observation import Noise, NoiseSource
from robacc.statistics.distributions import chi2_sf, f_sf

# Measurement noise: known from the file, from repeats, or only from the residual itself.

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
    return "repeats" if different(visits) > different(poses) else "residual"


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


_MAX_NAMES = 10
"""Names or rows that a warning lists; the others are counted."""
_FAR = 0.05
"""Share of the spread of the poses above which a residual without fitted frames comes from the frames."""
_GROSS = 0.01
"""Share of the spread of the poses above which a residual with fitted frames comes from a mistake in the data."""
_LARGE_CONDITION = 1e3
"""Condition number of the scaled columns from which on a warning is given."""
_FEW_NAMES = 3
"""Coefficients that a warning of a large condition number names."""
_MILLI = {"m": "mm", "rad": "mrad"}
_SURE = 0.999
"""Probability of a larger residual, beyond which the stated uncertainty is taken to be too large …"""
_SMALL = 0.7
"""… if the residual is also less than this part of it, which is more than the rounding of a sigma explains."""


def outliers_warning(fit: Fit, data: Measurements) -> tuple[str, ...]:
    """Return a warning that lists the outliers; empty if there are none."""
    if not fit.outliers.size:
        return ()
    lines = ", ".join(str(data.line(int(i))) for i in fit.outliers[:_MAX_NAMES])
    pattern = outlier_pattern(data, ~fit.inliers, fit.model.arm.names)
    shared = () if pattern is None else (pattern,)
    several, more = "s" * (fit.outliers.size > 1), " …" * (fit.outliers.size > _MAX_NAMES)
    counted = f"{fit.outliers.size} row{several}, on {data.counted}{several} {lines}{more}"
    return (f"outliers left out of the fit: {counted}", *shared)


def convergence_warning(fit: Fit) -> tuple[str, ...]:
    """Return a warning if the fit did not converge; else empty."""
    if fit.converged:
        return ()
    return (
        f"the fit did not converge in {fit.steps} steps, so its figures are provisional and no model is written; check "
        "the units, the frames and the joint signs, fit fewer effects, or measure more poses",
    )


def no_held_out_warning(data: Measurements) -> str:
    """Return the warning that there are too few poses to hold any out."""
    poses = "1 pose is" if data.n == 1 else f"{data.n} poses are"
    return f"{poses} too few to hold any out: all errors are of calibration poses"


def frames_warning(declared: Fit, data: Measurements) -> tuple[str, ...]:
    """Return a warning with the probable cause if the residual is too large for an arm; else empty."""
    names = {effect.name for effect in declared.model.free}
    absent = [name for name in ALIGNABLE if name not in names]
    position = data.position[:, declared.inliers]
    position_var = float(np.sum(np.var(position, axis=1)))
    mean_square = float(np.mean(np.sum(np.square(declared.residual[:3, declared.inliers]), axis=0)))
    if mean_square <= (_FAR if absent else _GROSS) ** 2 * position_var:
        return ()
    cause, advice = "units, joint signs, exchanged columns or an instrument that was moved", ""
    if absent:
        cause, advice = "frames that do not agree", f"; declare {','.join(absent)}"
    return (f"errors this large come from {cause} rather than from the arm{advice}",)


def condition_warning(fit: Fit) -> tuple[str, ...]:
    """Return a warning that names the coefficients known least if the condition number is large; else empty."""
    condition = fit.identifiability.condition
    if condition <= _LARGE_CONDITION:
        return ()
    stds = np.sqrt(np.diag(fit.covariance))
    known_least = [i for i in np.argsort(-np.nan_to_num(stds))[:_FEW_NAMES] if fit.terms[i].unit in _MILLI]
    listed = ", ".join(f"{fit.names[i]} (± {1e3 * stds[i]:.2g} {_MILLI[fit.terms[i].unit]})" for i in known_least)
    return (
        f"condition number {condition:.3g}: some coefficients are weakly identifiable on these poses, most of all "
        f"{listed or 'combinations of them'}; measure more poses, with more varied joint angles and orientations",
    )


def sigma_warning(noise: LackOfFit) -> tuple[str, ...]:
    """Return a warning if the residual is far below the uncertainty that the file states; else empty."""
    if noise.noise.source != "file" or noise.p_value is None or noise.p_value <= _SURE or noise.ratio >= _SMALL:
        return ()
    return (
        f"the residual is only {noise.ratio:.2g} times the measurement noise of the file's sigma columns, so the sigma "
        "columns are too large (wrong unit, or k = 2), and so are the standard errors",
    )


def weak_parameters_warning(fit: Fit) -> tuple[str, ...]:
    """Return a warning that lists the weakly identifiable constants; empty if there are none."""
    kinds = weak_kinds(fit)
    names = sorted(name for kind in kinds for name in kind.names)
    if not names:
        return ()
    more = f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else ""
    stds = " and ".join(dict.fromkeys(f"{1e3 * kind.std:.3g} {_MILLI[kind.unit]}" for kind in kinds))
    return (
        f"weakly identifiable on these poses: {', '.join(names[:_MAX_NAMES])}{more}; a prior about the nominal values "
        f"limits them (standard deviation {stds}, that of a badly made arm); measure poses with more different "
        "orientations",
    )
