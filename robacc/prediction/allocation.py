"""Tolerances that reach a grade at least cost, by tightening the given tolerances.

A tighter tolerance costs more; in the reciprocal model the cost is c t0/t, and c = 1 for every given tolerance t0
(K. W. Chase, W. H. Greenwood, B. G. Loosli, L. F. Hauglund, "Least cost tolerance allocation for mechanical assemblies
with automated process selection", Manufacturing Review 3(1), 1990). With factors f_p = t/t0 and shares A_p, B_p of the
predicted variance of position and orientation,

    minimise Σ 1/f_p   subject to   Σ A_p f_p² <= T_A,  Σ B_p f_p² <= T_B,  f_p <= 1,

the solution is f_p = min(1, (λ A_p + μ B_p)^(-1/3)) with both multipliers at zero or at their limits. Parameters with a
large share are tightened most; no tolerance is widened.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robacc.geometry import Array
from robacc.prediction.parameters import ToleranceParameter
from robacc.prediction.predicting import Prediction, predict_accuracy, step_limits
from robacc.robots.description import Robot

_MAX_ROUNDS = 12
_TARGET_BAND = 1e-3
"""Relative distance below a limit at which the allocation stops."""


@dataclass(frozen=True, slots=True)
class AllocatedTolerance:
    """Tolerance of one parameter, given and needed, as standard deviations in m or rad."""

    parameter: ToleranceParameter
    needed: float

    @property
    def factor(self) -> float:
        """Needed over given tolerance; 1 if it is unchanged."""
        return self.needed / self.parameter.sd


@dataclass(frozen=True, slots=True)
class Allocation:
    """Tolerances that reach a grade, and the prediction with them."""

    grade: str
    needed: tuple[AllocatedTolerance, ...]
    uniform_factor: float
    """Common factor of all tolerances that reaches the grade; 1 if it is reached already."""
    verified: Prediction
    """Prediction at the same poses with the needed tolerances."""
    met: bool
    """True if that prediction meets the grade."""


def allocate(robot: Robot, prediction: Prediction, grade: str) -> Allocation:
    """Tighten the tolerances of ``prediction`` until it reaches ``grade`` of its scale.

    Raises:
        UsageError: The scale has no such grade.
    """
    scale = prediction.grade.scale
    limits = step_limits(scale, grade)
    budget = {share.name: (share.position, share.orientation) for share in prediction.budget}
    shares = np.array([budget[parameter.name] for parameter in prediction.parameters]).T
    initial_excess = _relative_excess(prediction, limits)
    # The statistic is not exactly proportional to the RMS, whose square the budget divides: correct the targets.
    target_variances = np.minimum(1.0, 1.0 / np.square(initial_excess))
    factors, verified = np.ones(shares.shape[1]), prediction
    for _ in range(_MAX_ROUNDS):
        excess = _relative_excess(verified, limits)
        if np.max(excess) <= 1.0:
            break
        factors = _optimal_factors(shares, target_variances)
        verified = _predict_tightened(robot, prediction, factors)
        excess = _relative_excess(verified, limits)
        if 1.0 - _TARGET_BAND <= np.max(excess) <= 1.0:
            break
        target_variances = np.where(
            excess > 1.0, target_variances / np.square(excess) * (1.0 - 0.5 * _TARGET_BAND), target_variances
        )
    needed = tuple(
        AllocatedTolerance(parameter, parameter.sd * float(factor))
        for parameter, factor in zip(prediction.parameters, factors, strict=True)
    )
    uniform_factor = min(1.0, 1.0 / float(np.max(initial_excess)))
    return Allocation(grade, needed, uniform_factor, verified, bool(np.max(_relative_excess(verified, limits)) <= 1.0))


def _relative_excess(prediction: Prediction, limits: tuple[float, float | None]) -> Array:
    """Return the statistics of position and orientation over their limits; zero if there is no limit."""
    statistic = prediction.grade.scale.statistic
    position, orientation = limits
    return np.array(
        [
            prediction.position.value(statistic) / position,
            0.0 if orientation is None else prediction.orientation.value(statistic) / orientation,
        ]
    )


def _predict_tightened(robot: Robot, prediction: Prediction, factors: Array) -> Prediction:
    tightened = [
        dataclasses.replace(parameter, sd=parameter.sd * float(factor))
        for parameter, factor in zip(prediction.parameters, factors, strict=True)
    ]
    return predict_accuracy(robot, tightened, prediction.configurations, prediction.grade.scale, prediction.meaning)


def _optimal_factors(shares: Array, target_variances: Array) -> Array:
    """Return the optimal factors ``(P,)`` for ``shares`` ``(2, P)`` and ``target_variances`` ``(2,)``.

    The dual is concave and smooth, so maximising it over one multiplier at a time converges.
    """
    multipliers = np.zeros(2)
    for _ in range(200):
        previous = multipliers.copy()
        for constraint in range(2):

            def variance_surplus(value: float, constraint: int = constraint) -> float:
                trial = multipliers.copy()
                trial[constraint] = value
                return float(shares[constraint] @ np.square(_optimum(shares, trial)) - target_variances[constraint])

            multipliers[constraint] = _root(variance_surplus)
        if np.allclose(multipliers, previous, rtol=1e-9, atol=0.0):
            break
    return _optimum(shares, multipliers)


def _optimum(shares: Array, multipliers: Array) -> Array:
    price = multipliers @ shares
    # A price of at most one leaves the tolerance unchanged.
    factors: Array = np.maximum(price, 1.0) ** (-1.0 / 3.0)
    return factors


def _root(function: Callable[[float], float]) -> float:
    """Return the zero of a falling function, or zero if it starts below zero."""
    if function(0.0) <= 0.0:
        return 0.0
    high = 1.0
    while function(high) > 0.0:
        high *= 8.0
    low = 0.0 if high == 1.0 else high / 8.0
    for _ in range(100):
        middle = 0.5 * (low + high) if low == 0.0 else math.sqrt(low * high)
        low, high = (middle, high) if function(middle) > 0.0 else (low, middle)
        if high - low <= 1e-12 * high:
            break
    return high
