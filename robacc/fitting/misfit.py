"""Misfit of a model beyond the known measurement noise, and the inlier mask."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.observation import Noise, NoiseSource, weights

_ROUNDING = 1e-9
"""m or rad: below any instrument, above rounding; a row within it is never an outlier."""
_LEAST_DOF = 0.05
"""Least degrees of freedom, as a share of the residuals, if coefficients use up nearly all."""
_LEAST_INLIERS = 0.8
"""Least share of inliers: if more rows deviate, the model is wrong."""
_BISECTIONS = 60
"""Halvings of the interval that holds a misfit: beyond them a float has no digits left."""
_MEDIAN = {3: 2.3660 / 3, 6: 5.3481 / 6}
"""Median of a chi-square variable over its degrees of freedom, 3 and 6."""


def estimate(
    data: Measurements, residual: Array, inliers: NDArray[np.bool_], used: tuple[float, float]
) -> tuple[float, float]:
    """Return the misfit of position (m) and orientation (rad) at which the cost equals the degrees of freedom.

    ``used`` are the numbers of effective coefficients that position and orientation determine: the sums of the
    leverages of their residuals (restricted maximum likelihood at given weights).
    """
    position = _misfit(residual[:3, inliers], _position_variance(data, inliers), used[0])
    if residual.shape[0] == 3:
        return position, 0.0
    return position, _misfit(residual[3:, inliers], _variance(data.sigma_rotation, inliers), used[1])


def row_weights(data: Measurements, misfit: tuple[float, float]) -> Array:
    """Return ``(M, N)`` reciprocal standard deviations, the misfit at least :data:`_ROUNDING`.

    The lower limit gives data without noise finite weights, and keeps the weights of noisy position and exact
    orientation within what the normal equations can hold.
    """
    return weights(data, max(misfit[0], _ROUNDING), max(misfit[1], _ROUNDING))


def inlier_mask(
    residual: Array, weight: Array, inliers: NDArray[np.bool_], coefficients: int, tolerance: float = 1.0
) -> NDArray[np.bool_]:
    """Return ``(N,)`` the mask of inliers: a robust scale from the median, a limit far beyond any tail.

    ``tolerance`` multiplies the limit of the length.
    """
    rows, n = residual.shape
    distance = np.square(residual * weight).mean(axis=0)
    scale = float(np.median(distance)) / _MEDIAN[rows]
    if scale <= 0:
        return inliers
    limit = tolerance**2 * outlier_limit(rows, n) * scale
    mask: NDArray[np.bool_] = (distance <= limit) | (np.abs(residual).max(axis=0) <= _ROUNDING)
    return mask if mask.sum() >= max(_LEAST_INLIERS * n, coefficients / rows + 1) else inliers


def noise_of(data: Measurements, misfit: tuple[float, float], is_given: bool) -> Noise:
    """Return known noise and misfit together, and the source of the figure."""
    position = np.zeros((3, 1)) if data.position_variance is None else data.position_variance
    orientation = 0.0 if data.sigma_rotation is None else float(np.mean(np.square(data.sigma_rotation)))
    turned = None if data.rotation is None else float(np.sqrt(orientation + misfit[1] ** 2))
    source: NoiseSource
    if is_given:
        source = "given"
    elif data.sigma_position is None:
        source = "residual"
    else:
        source = "file" if misfit[0] == 0.0 else "file and misfit"
    return Noise.of_variances(np.mean(position, axis=1) + misfit[0] ** 2, turned, source)


def _position_variance(data: Measurements, inliers: NDArray[np.bool_]) -> Array | float:
    variance = data.position_variance
    return 0.0 if variance is None else np.broadcast_to(variance, (3, data.n))[:, inliers]


def _variance(column: Array | None, inliers: NDArray[np.bool_]) -> Array | float:
    return 0.0 if column is None else np.square(column[..., inliers])


def _misfit(residual: Array, known: Array | float, used: float) -> float:
    """Return the misfit t with sum r^2 / (s^2 + t^2) = degrees of freedom; 0 if the known noise s explains all."""
    dof = max(residual.size - used, _LEAST_DOF * residual.size)
    square = np.square(residual)
    if isinstance(known, float):
        return float(np.sqrt(square.sum() / dof))
    if np.all(known > 0.0) and float((square / known).sum()) <= dof:
        return 0.0
    low, high = 0.0, float(square.sum() / dof)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if float((square / (known + middle)).sum()) > dof:
            low = middle
        else:
            high = middle
    return float(np.sqrt(high))


def outlier_limit(rows: int, n: int) -> float:
    """Return the mean whitened square of a row beyond which it is an outlier.

    Wilson and Hilferty's quantile of the chi-square distribution at a tail of 1e-7 / N, that is some six standard
    deviations: a structured residual that the model lacks is bounded and stays within it, a beam break does not.
    """
    tail = 5.2 + 0.2 * np.log10(max(n, 10))
    cube_root_var = 2.0 / (9.0 * rows)
    return float((1 - cube_root_var + tail * np.sqrt(cube_root_var)) ** 3)
