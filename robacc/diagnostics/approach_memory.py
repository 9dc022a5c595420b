"""Memory of a joint's play: errors that depend on how its torque changed since the previous visit.

Play without memory has two values, given by the approach. Where friction and springs act together (hysteresis), the
joint also remembers the load of the previous visit: the error follows the sign of the change of gravity's torque. That
sign depends on the present pose too, so its least-squares fit by polynomials of the ranks of torque and joint is
subtracted. The difference is independent of the residual of a complete model. The sum of their products, over the root
of the sum of the squared products, is then a standard Gaussian to good accuracy (a self-normalised sum; V. H. de la
Peña, T. L. Lai, Q.-M. Shao, Self-Normalized Processes, 2009).

Source of the mechanism: M. Ruderman, F. Hoffmann, T. Bertram, "Modeling and identification of elastic robot joints with
hysteresis and backlash", IEEE Trans. Industrial Electronics 56 (2009) 3840-3847.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.fit_result import Fit
from robacc.fitting.normal_equations import joint_columns
from robacc.geometry import Array
from robacc.gravity.torques import weight_torques
from robacc.measurements import Measurements
from robacc.statistics.distributions import normal_cdf

_FEWEST = 30
"""Visits from which the sum is close to Gaussian."""
_DEGREE = 4
"""Degree of the polynomials of ranks."""
_LARGEST = 7.0
"""Limit of an error's size, over the median of all sizes: an accident of the instrument counts as the limit."""


def memory_of_play(fit: Fit, data: Measurements, joints: Sequence[str]) -> dict[str, float]:
    """Return, for each joint with play, the p-value of a memory in the residual.

    Outliers count with a bounded size, since a memory may be what makes them. The result is empty without masses,
    without joint variables, or with fewer than 30 visits that follow another visit.
    """
    if not joints or data.q is None or not fit.model.arm.chain.bodies:
        return {}
    order = _in_sequence(data)
    before = previous_visit(data.q[:, order])
    follows = before >= 0
    if np.count_nonzero(follows) < _FEWEST:
        return {}
    present, previous = order[follows], order[before[follows]]
    torque = weight_torques(fit.model.arm, data)
    columns = joint_columns(fit.model, data.subset(present))[:3]
    result = {}
    for joint in joints:
        number = fit.model.arm.number(joint)
        column = columns[:, number]
        error = np.einsum("mn,mn->n", column, fit.residual[:3, present])
        error = error / np.maximum(np.linalg.norm(column, axis=0), 1e-12)
        limit = _LARGEST * float(np.median(np.abs(error)))
        error = np.clip(error, -limit, limit)
        change = np.sign(torque[number, present] - torque[number, previous])
        regressors = [_polynomials(torque[number, present]), _polynomials(data.q[number, present])[1:]]
        if data.direction is not None:
            regressors.append(data.direction[number, present][None])
        result[joint] = _p_value(_without(change, np.concatenate(regressors)), error)
    return result


def previous_visit(q: Array) -> NDArray[np.int64]:
    """Return for each column of ``(J, N)`` the number ``(N,)`` of the last earlier column that differs from it.

    It is -1 for the first column and its repeats.
    """
    changed = np.zeros(q.shape[1], dtype=bool)
    changed[1:] = np.any(q[:, 1:] != q[:, :-1], axis=0)
    start = np.maximum.accumulate(np.where(changed, np.arange(q.shape[1]), 0))
    return np.asarray(start - 1, dtype=np.int64)


def _in_sequence(data: Measurements) -> NDArray[np.int64]:
    """Return the numbers ``(N,)`` of the rows in order of time; in order of the file without times."""
    return np.arange(data.n) if data.time is None or data.ordered else np.argsort(data.time, kind="stable")


def _polynomials(values: Array) -> Array:
    """Return ``(5, N)`` Chebyshev polynomials of the ranks of ``(N,)``."""
    ranks = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    scaled = 2.0 * ranks / max(values.size - 1, 1) - 1.0
    return np.asarray(np.polynomial.chebyshev.chebvander(scaled, _DEGREE).T, dtype=np.float64)


def _without(values: Array, regressors: Array) -> Array:
    """Return ``(N,)`` values without their least-squares fit by the rows of ``(K, N)``."""
    coefficients = np.linalg.lstsq(regressors.T, values, rcond=None)[0]
    return np.asarray(values - coefficients @ regressors, dtype=np.float64)


def _p_value(regressor: Array, error: Array) -> float:
    """Return the two-sided p-value of the self-normalised sum of products of two series ``(N,)``."""
    products = regressor * error
    root_sum_square = float(np.sqrt(np.sum(np.square(products))))
    if root_sum_square == 0.0:
        return 1.0
    return 2.0 * normal_cdf(-abs(float(np.sum(products))) / root_sum_square)
