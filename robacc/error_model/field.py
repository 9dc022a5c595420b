"""What a fit lacks of the position, as one process over the joints along the axes of the measuring frame.

The three axes share their kernel, so that N visits need a matrix of N x N only: more poses are seen than beside the
terms of the joints, and shorter lengths.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import solve_triangular

from robacc.effects.base import Effect
from robacc.effects.correction import PoseCorrection
from robacc.error_model.covariance import ACCEPTED, LEAST, CovarianceParameters, climbed
from robacc.error_model.structure import beside
from robacc.fitting.fit_result import Fit
from robacc.geometry import Array
from robacc.measurements import Measurements

_MOST_VISITS = 600
"""Visits that the process is estimated on: the time grows with their cube."""
_STDS = (LEAST, math.log(0.1))
"""Bounds of the logarithm of a standard deviation, m."""
_LENGTHS = (math.log(0.1), math.log(30.0))
"""The same of a length, rad: the reach of the finest order of a joint's profile, and more than a joint turns."""


def correction_of_position(
    fitted: Fit, data: Measurements, noise: CovarianceParameters
) -> tuple[Effect, float, float] | None:
    """Return the correction of the position by a process over the joints, with its evidence and what that costs.

    None if the evidence is not worth its cost: half the log of the visits for the variance and each length, and the
    odds of acceptance. Visits of a place may share a further error, and errors wander if the search found that
    (``noise``). With V the covariance of one axis and P that of all rows beside the fit's columns, steps are those of
    the average information (:func:`robacc.error_model.covariance.likelihood_derivatives`).
    """
    linear, index = beside(fitted, data, _MOST_VISITS)
    rows, y, count = linear.rows, linear.y[:, :3], len(linear.y)
    moving = np.flatnonzero(rows.moves)
    if not moving.size:
        return None
    columns = linear.columns[:, :3] * linear.prior_std
    chords = np.stack([rows.chords[j] for j in moving.tolist()])
    stated, fixed = np.diag(rows.stated[:, :3].mean(axis=1)), [np.eye(count)]
    if np.unique(rows.place).size < count:
        fixed.append(rows.same_place)
    if (wander := noise.terms.get("wander")) is not None:
        fixed.append(np.exp(-rows.lags * math.exp(-wander[-1])))

    def likelihood(parameters: Array) -> tuple[float, Array, Array]:
        variances, precision = np.exp(2.0 * parameters[: len(fixed) + 1]), np.exp(-2.0 * parameters[len(fixed) + 1 :])
        kernel = np.exp(-0.5 * np.tensordot(precision, chords, 1))
        slopes = [2.0 * variance * each for variance, each in zip(variances, [*fixed, kernel], strict=True)]
        factor = np.linalg.cholesky(stated + 0.5 * np.sum(slopes, axis=0))
        slopes += [scale * chord * 0.5 * slopes[-1] for scale, chord in zip(precision, chords, strict=True)]
        inverse = np.asarray(solve_triangular(factor, np.eye(count), lower=True, check_finite=False))
        own, by_column = inverse @ y, (inverse @ columns.reshape(count, -1)).reshape(3 * count, -1)
        triangle = np.linalg.cholesky(by_column.T @ by_column + np.eye(by_column.shape[1]))
        spread = np.asarray(solve_triangular(triangle, by_column.T, lower=True, check_finite=False))
        reduced = spread @ own.ravel()
        weighted = inverse.T @ (own - (spread.T @ reduced).reshape(count, 3))
        shared = inverse.T @ spread.T.reshape(count, -1)
        weights = weighted @ weighted.T + shared @ shared.T - 3.0 * inverse.T @ inverse
        moved = np.stack([(inverse @ (slope @ weighted)).ravel() for slope in slopes])
        beyond = moved @ spread.T
        log_det = 6.0 * np.sum(np.log(np.diag(factor))) + 2.0 * np.sum(np.log(np.diag(triangle)))
        return (
            -0.5 * float(log_det + np.vdot(own, own) - reduced @ reduced),
            np.array([0.5 * float(np.vdot(weights, slope)) for slope in slopes]),
            0.5 * (moved @ moved.T - beyond @ beyond.T),
        )

    std = max(math.log(0.7 * float(np.sqrt(np.mean(np.square(fitted.residual[:3, index]))))), LEAST)
    bounds = [_STDS] * (len(fixed) + 1) + [_LENGTHS] * moving.size
    start = np.concatenate((np.full(len(fixed) + 1, std), np.zeros(moving.size)))
    without = [*[_STDS] * len(fixed), (LEAST, LEAST), *[(0.0, 0.0)] * moving.size]
    found, alone = climbed(start, bounds, likelihood), climbed(start, without, likelihood)
    if found is None or alone is None:
        return None
    evidence = likelihood(found)[0] - likelihood(alone)[0]
    cost = 0.5 * math.log(count) * (1 + moving.size)
    if evidence - cost <= ACCEPTED:
        return None
    arm, process = fitted.model.arm, len(fixed)
    lengths = (np.exp(found[process + 1 :]) / rows.scale[moving]).tolist()
    ratio = math.exp(2.0 * (found[0] - found[process]))
    joints = [arm.names[j] for j in moving]
    return PoseCorrection.over(arm, data.subset(index), joints, lengths, "position", ratio), evidence, cost
