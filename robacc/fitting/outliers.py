"""Misfit beyond the known noise, the inlier mask, and a circumstance that outliers share."""

import math

import numpy as np

from robacc.fitting.levels import FEW, ROUNDING, SIGNIFICANT
from robacc.geometry import Array, NDArray
from robacc.measurements import Measurements
from robacc.modelling.model import Noise, NoiseSource
from robacc.robots.arm import BLOCK
from robacc.statistics.intervals import quantiles, root

# Misfit of a model beyond the known measurement noise, and the inlier mask.


def misfits(
    data: Measurements, residual: Array, inliers: NDArray[np.bool_], used: tuple[float, float]
) -> tuple[float, float]:
    """Return the misfit of position (m) and orientation (rad) at which the cost equals the degrees of freedom.

    ``used`` are the numbers of effective coefficients that position and orientation determine: the sums of the
    leverages of their residuals (restricted maximum likelihood at given weights).
    """
    rows = slice(None) if data.n > BLOCK and inliers.all() else inliers  # of many rows without a copy
    along, known = data.along_noise(residual[:3])
    variance = known if isinstance(known, float) else known[:, inliers]
    position = _misfit(along[:, rows], variance, used[0], data.count(inliers) * 3 // len(residual))
    if residual.shape[0] == 3:
        return position, 0.0
    turned = 0.0 if data.sigma_rotation is None else np.square(data.sigma_rotation[inliers])
    return position, _misfit(residual[3:, rows], turned, used[1], 3 * int(np.count_nonzero(inliers)))


def _misfit(residual: Array, known: Array | float, used: float, count: int) -> float:
    """Return the misfit t with sum r^2 / (s^2 + t^2) = degrees of freedom; 0 if the known noise s explains all.

    ``count`` numbers were measured.
    """
    dof = max(count - used, FEW * count)
    if isinstance(known, float):
        return float(np.sqrt(np.vdot(residual, residual) / dof))
    square = np.square(residual)

    def excess(variance: float) -> float:
        return float((square / (known + variance)).sum()) - dof

    return math.sqrt(root(excess, ROUNDING**2, float(square.sum() / dof))) if excess(ROUNDING**2) > 0.0 else 0.0


def row_weights(data: Measurements, misfit: tuple[float, float]) -> Array:
    """Return ``(M, N)`` reciprocal standard deviations of measuring uncertainty and a misfit common to all poses.

    The misfit is at least :data:`ROUNDING`. This gives data without noise finite weights, and keeps the weights of
    noisy position and exact orientation within what the normal equations can hold. How coordinates are correlated is
    no part of the weights. The array is read-only: without uncertainties of rows, these share one column.
    """
    rows, known = 3 if data.rotation is None else 6, data.position_variance
    variance = np.empty((rows, 1 if known is None and data.sigma_rotation is None else data.n))
    variance[:3] = max(misfit[0], ROUNDING) ** 2 + (0.0 if known is None else known)
    variance[3:] = max(misfit[1], ROUNDING) ** 2
    if data.sigma_rotation is not None:
        variance[3:] += np.square(data.sigma_rotation)
    return np.broadcast_to(1.0 / np.sqrt(variance), (rows, data.n))


def inlier_mask(
    residual: Array,
    white: Array,
    inliers: NDArray[np.bool_],
    coefficients: int,
    tolerance: float = 1.0,
    shown: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """Return ``(N,)`` the mask of inliers: a robust scale from the median, a limit far beyond any tail.

    The median and the limit of the mean whitened square are Wilson and Hilferty's quantiles of the chi-square
    distribution, the limit at a tail of 1e-7 / N, that is some six standard deviations: a structured residual that the
    model lacks is bounded and stays within it, a beam break does not. ``white`` ``(M, N)`` is the residual over its
    standard deviations, ``tolerance`` multiplies the limit of the length;
    ``shown`` ``(3, N)`` are the components that were measured, by default all.
    """
    rows = np.array(len(residual)) if shown is None else shown.sum(axis=0)
    distance = np.square(white).sum(axis=0) / rows
    limit = tolerance**2 * inlier_limit(distance, rows, distance.size)
    if not limit.any():
        return inliers
    mask: NDArray[np.bool_] = (distance <= limit) | (
        np.maximum(residual.max(axis=0), -residual.min(axis=0)) <= ROUNDING
    )
    # If more than a fifth of the rows deviate, the model is wrong.
    return mask if mask.sum() >= max(0.8 * mask.size, coefficients / np.mean(rows) + 1) else inliers


def inlier_limit(distance: Array, rows: NDArray[np.int64], n: int) -> Array:
    """Return the limit ``(L,)`` or ``()`` of the mean squares ``(L,)`` of ``rows`` components among ``n`` rows."""
    cube_root_var = 2.0 / (9.0 * rows)
    scale = max(float(quantiles(distance / (1.0 - cube_root_var) ** 3, [0.5])[0]), 0.0)
    tail = 5.2 + 0.2 * math.log10(max(n, 10))
    return np.asarray(scale * (1.0 - cube_root_var + tail * np.sqrt(cube_root_var)) ** 3)


def noise_of(data: Measurements, misfit: tuple[float, float], is_given: bool) -> Noise:
    """Return known noise and misfit together, and the source of the figure."""
    position = np.zeros((3, 1)) if data.position_variance is None else data.position_variance
    orientation = 0.0 if data.sigma_rotation is None else float(np.mean(np.square(data.sigma_rotation)))
    turned = None if data.rotation is None else float(np.sqrt(orientation + misfit[1] ** 2))
    of_file: NoiseSource = "file" if misfit[0] == 0.0 else "file and misfit"
    source: NoiseSource = "given" if is_given else "residual" if data.sigma_position is None else of_file
    return Noise.of_variances(np.mean(position, axis=1) + misfit[0] ** 2, turned, source)


# Circumstance that outliers share: rows that a lacking effect displaces, and no accidents of the instrument.
#
# A beam break strikes rows at random. Rows that all lie at large angles of one joint, in one corner, or at one time
# have a common cause. Beyond each outlier lie so many outliers and such a share of all rows: the binomial probability
# of so many is significant for all outliers and all circumstances together (Bonferroni).


def outlier_pattern(data: Measurements, outliers: NDArray[np.bool_], names: tuple[str, ...]) -> str | None:
    """Return the circumstance that the outliers share, as a sentence; None if they look accidental.

    Args:
        data: Measured poses.
        outliers: ``(N,)`` mask of the outliers.
        names: Names of the joints, in the order of ``data.q``.
    """
    count = int(np.count_nonzero(outliers))
    if count < 3 or count == outliers.size:
        return None
    from scipy.special import bdtrc  # Its import takes longer than an estimate of 100 poses.

    joints, approaches = (
        [] if values is None else list(zip(names, values, strict=True)) for values in (data.q, data.direction)
    )
    from_centre = np.linalg.norm(data.position - np.median(data.position, axis=1, keepdims=True), axis=0)
    quantities: list[tuple[str, str, Array | None]] = [
        *((name, "(rad or m)", q) for name, q in joints),
        *((f"the distance of {name} from its median", "(rad or m)", np.abs(q - np.median(q))) for name, q in joints),
        *((f"the direction of approach of {name}", "", values) for name, values in approaches),
        *((name, "m", values) for name, values in zip("xyz", data.position, strict=True)),
        ("the distance from the centre of the poses", "m", from_centre),
        ("time", "s", data.time),
        ("temperature", "°C", data.temperature),
        ("payload", "kg", data.payload),
        ("row number", "", np.arange(1.0, data.n + 1.0)),
    ]
    tested = [(name, unit, values) for name, unit, values in quantities if values is not None and np.ptp(values) > 0]
    least, pattern = SIGNIFICANT / (2.0 * len(tested) * count), None
    for name, unit, values in tested:
        for side, sign in (("at or above", 1.0), ("at or below", -1.0)):
            levels, ordered = np.sort(sign * values[outliers])[::-1], np.sort(sign * values)
            inside = count - np.searchsorted(levels[::-1], levels)
            share = 1.0 - np.searchsorted(ordered, levels) / data.n
            by_chance = bdtrc(inside - 1, count, share)
            best = int(np.argmin(by_chance))
            if by_chance[best] <= least:
                least, pattern = by_chance[best], (name, unit, side, sign * levels[best], inside[best], share[best])
    if pattern is None:
        return None
    name, unit, side, limit, beyond, part = pattern
    return (
        f"{beyond} of {count} outliers have {name} {side} {f'{limit:.4g} {unit}'.strip()}, "
        f"but only {100 * part:.0f} % of all rows have: the outliers have a common cause"
    )
