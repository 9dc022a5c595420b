"""Uncertainty of coefficients at poses beyond the joint ranges of their fit.

Errors that poses share, because the model lacks an effect, move the coefficients by more than independent errors do.
Held-out poses show what that does to predictions within the ranges of the fit, and it counts as unexplained error
there. Beyond the ranges nothing shows it, so the standard errors that allow for shared errors hold there
(:mod:`robacc.fitting.shared_errors`).
"""

from __future__ import annotations

import numpy as np

from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.prediction.model_fit import ModelFit
from robacc.robots.description import Robot

_SHARE = 0.1
"""Share of a range beyond its end from which on the standard errors have their full size."""
_LEAST = 1e-6
"""The same for a joint that did not move, rad or m: more than rounding."""


def excess_share(robot: Robot, fit: ModelFit, data: Measurements) -> Array:
    """Return ``(N,)`` how far the poses are beyond the joint ranges of the fit.

    It is 0 within the ranges, and grows to 1 at a tenth of a range beyond the end.
    """
    share = np.zeros(data.n)
    if data.q is None:
        return share
    for name, row in zip(robot.variable_names, data.q, strict=True):
        low, high = fit.ranges.get(name, (-np.inf, np.inf))
        excess = np.maximum(np.maximum(low - row, row - high), 0.0)
        full = max(_SHARE * (high - low), _LEAST)
        share = np.maximum(share, np.minimum(excess / full, 1.0))
    return share


def widened(jacobian: Array, factor: Array, share: Array) -> Array:
    """Return a Jacobian ``(6, P, N)`` to coefficients whose standard errors grow beyond the ranges of their fit.

    Args:
        jacobian: Derivative of the poses to the coefficients.
        factor: ``(P,)`` factor of the standard error of each coefficient that allows for errors that poses share.
        share: ``(N,)`` of :func:`excess_share`.
    """
    if not share.any() or np.all(factor == 1.0):
        return jacobian
    result: Array = jacobian * (1.0 + np.outer(factor - 1.0, share))
    return result
