"""How far a model misses beyond the measuring noise that is known, and rows that are no part of the rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.observation import Noise, NoiseSource, weights

_ROUNDING = 1e-9
"""m or rad: below any instrument, above rounding; of data without noise no row is an outlier within it."""
_LEAST_FREEDOM = 0.05
"""Share of the residuals that count as degrees of freedom at least, where coefficients use up nearly all of them."""
_LEAST_KEPT = 0.8
"""Share of the rows that must stay: where more are odd, it is the model that is wrong."""
_BISECTIONS = 60
"""Halvings of the interval that holds a misfit: beyond them a float has no digits left."""
_MEDIAN = {3: 2.3660 / 3, 6: 5.3481 / 6}
"""Median of a chi-square variable over its degrees of freedom, 3 and 6."""


def estimate(data: Measurements, residual: Array, kept: NDArray[np.bool_], used: float) -> tuple[float, float]:
    """Misfit of position (m) and orientation (rad) that brings the whitened squares to what the freedom left says.

    ``used`` is the number of effective coefficients; position and orientation share them.
    """
    if residual.shape[0] == 3:
        return _one(residual[:, kept], _variance(data.sigma_position, kept), used), 0.0
    return (
        _one(residual[:3, kept], _variance(data.sigma_position, kept), 0.5 * used),
        _one(residual[3:, kept], _variance(data.sigma_rotation, kept), 0.5 * used),
    )


def row_weights(data: Measurements, misfit: tuple[float, float]) -> Array:
    """``(M, N)`` reciprocal standard deviations, the misfit at least :data:`_ROUNDING`.

    Data without any noise can so be weighed at all, and position with noise beside orientation without any is weighed
    within what the normal equations can hold.
    """
    return weights(data, max(misfit[0], _ROUNDING), max(misfit[1], _ROUNDING))


def inlier_mask(residual: Array, weight: Array, kept: NDArray[np.bool_], coefficients: int) -> NDArray[np.bool_]:
    """``(N,)`` rows that belong to the rest: a robust scale from the median, a limit far beyond any tail."""
    rows, n = residual.shape
    distance = np.square(residual * weight).mean(axis=0)
    scale = float(np.median(distance)) / _MEDIAN[rows]
    if scale <= 0:
        return kept
    found: NDArray[np.bool_] = (distance <= _limit(rows, n) * scale) | (np.abs(residual).max(axis=0) <= _ROUNDING)
    return found if found.sum() >= max(_LEAST_KEPT * n, coefficients / rows + 1) else kept


def noise_of(data: Measurements, misfit: tuple[float, float], given: bool) -> Noise:
    """What the model cannot predict: known noise and misfit together, and where the figure is from."""
    position = 0.0 if data.sigma_position is None else float(np.mean(np.square(data.sigma_position)))
    orientation = 0.0 if data.sigma_rotation is None else float(np.mean(np.square(data.sigma_rotation)))
    turned = None if data.rotation is None else float(np.sqrt(orientation + misfit[1] ** 2))
    source: NoiseSource
    if given:
        source = "given"
    elif data.sigma_position is None:
        source = "residual"
    else:
        source = "file" if misfit[0] == 0.0 else "file and misfit"
    return Noise(float(np.sqrt(position + misfit[0] ** 2)), turned, source)


def _variance(column: Array | None, kept: NDArray[np.bool_]) -> Array | float:
    return 0.0 if column is None else np.square(column[..., kept])


def _one(residual: Array, known: Array | float, used: float) -> float:
    """The misfit t with sum r^2 / (s^2 + t^2) = degrees of freedom; 0 where the known noise s explains it all."""
    freedom = max(residual.size - used, _LEAST_FREEDOM * residual.size)
    square = np.square(residual)
    if isinstance(known, float):
        return float(np.sqrt(square.sum() / freedom))
    if float((square / known).sum()) <= freedom:
        return 0.0
    low, high = 0.0, float(square.sum() / freedom)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if float((square / (known + middle)).sum()) > freedom:
            low = middle
        else:
            high = middle
    return float(np.sqrt(high))


def _limit(rows: int, n: int) -> float:
    """A row's mean whitened square beyond which it is no part of the rest.

    Wilson and Hilferty's quantile of the chi-square distribution at a tail of 1e-7 / N, that is some six standard
    deviations: a structured residual that a model lacks is bounded and stays within it, a beam break does not.
    """
    tail = 5.2 + 0.2 * np.log10(max(n, 10))
    spread = 2.0 / (9.0 * rows)
    return float((1 - spread + tail * np.sqrt(spread)) ** 3)
