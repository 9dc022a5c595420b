"""The tolerances that would reach a grade: the given ones tightened where the error budget says it pays.

A tolerance costs the more the tighter it is; by the reciprocal model, c t0/t for a parameter whose given tolerance t0
costs c = 1 (K. W. Chase, W. H. Greenwood, B. G. Loosli, L. F. Hauglund, "Least cost tolerance allocation for mechanical
assemblies with automated process selection", Manufacturing Review 3(1), 1990). With factors f_p = t/t0 and shares A_p,
B_p of the predicted variance of position and orientation,

    minimise Σ 1/f_p   subject to   Σ A_p f_p² <= T_A,  Σ B_p f_p² <= T_B,  f_p <= 1,

whose solution is f_p = min(1, (λ A_p + μ B_p)^(-1/3)) with the two multipliers at zero or at their limits. What has a
large share is tightened most, no tolerance is widened, and what costs nothing is left alone.
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

_ROUNDS = 12
_REACHED = 1e-3
"""A statistic within this share below its limit is as near as a tolerance need be."""


@dataclass(frozen=True, slots=True)
class Allocated:
    """One parameter's tolerance, given and needed, as standard deviations in m or rad."""

    parameter: ToleranceParameter
    needed: float

    @property
    def factor(self) -> float:
        """Needed over given; 1 where it may stay."""
        return self.needed / self.parameter.sd


@dataclass(frozen=True, slots=True)
class Allocation:
    """Tolerances that reach a grade, and the prediction made with them."""

    grade: str
    needed: tuple[Allocated, ...]
    uniform_factor: float
    """What all tolerances alike would have to be multiplied by; 1 where the grade is reached already."""
    verified: Prediction
    """Predicted again, at the same poses, with the needed tolerances."""
    met: bool
    """Whether that prediction meets the grade."""


def allocate(robot: Robot, prediction: Prediction, grade: str) -> Allocation:
    """Tighten the tolerances of ``prediction`` until it reaches ``grade`` of its scale.

    Raises:
        UsageError: the scale has no such grade.
    """
    scale = prediction.grade.scale
    limits = step_limits(scale, grade)
    shares = {share.name: (share.position, share.orientation) for share in prediction.budget}
    share = np.array([shares[parameter.name] for parameter in prediction.parameters]).T
    first = _excess(prediction, limits)
    # The statistic is not quite proportional to the RMS, whose square the budget divides: aim again by what is missed.
    aims = np.minimum(1.0, 1.0 / np.square(first))
    factors, verified = np.ones(share.shape[1]), prediction
    for _ in range(_ROUNDS):
        excess = _excess(verified, limits)
        if np.max(excess) <= 1.0:
            break
        factors = _factors(share, aims)
        verified = _again(robot, prediction, factors)
        excess = _excess(verified, limits)
        if 1.0 - _REACHED <= np.max(excess) <= 1.0:
            break
        aims = np.where(excess > 1.0, aims / np.square(excess) * (1.0 - 0.5 * _REACHED), aims)
    needed = tuple(
        Allocated(parameter, parameter.sd * float(factor))
        for parameter, factor in zip(prediction.parameters, factors, strict=True)
    )
    uniform = min(1.0, 1.0 / float(np.max(first)))
    return Allocation(grade, needed, uniform, verified, bool(np.max(_excess(verified, limits)) <= 1.0))


def _excess(prediction: Prediction, limits: tuple[float, float | None]) -> Array:
    """The statistics of position and orientation over their limits; zero where there is no limit."""
    statistic = prediction.grade.scale.statistic
    position, orientation = limits
    return np.array(
        [
            prediction.position.value(statistic) / position,
            0.0 if orientation is None else prediction.orientation.value(statistic) / orientation,
        ]
    )


def _again(robot: Robot, prediction: Prediction, factors: Array) -> Prediction:
    tightened = [
        dataclasses.replace(parameter, sd=parameter.sd * float(factor))
        for parameter, factor in zip(prediction.parameters, factors, strict=True)
    ]
    return predict_accuracy(robot, tightened, prediction.configurations, prediction.grade.scale, prediction.meaning)


def _factors(share: Array, aims: Array) -> Array:
    """The optimum for ``share`` ``(2, P)`` and ``aims`` ``(2,)``, by turns over the two multipliers.

    The dual is concave and smooth, so maximising it over one multiplier at a time converges.
    """
    multipliers = np.zeros(2)
    for _ in range(200):
        before = multipliers.copy()
        for k in range(2):

            def surplus(value: float, k: int = k) -> float:
                trial = multipliers.copy()
                trial[k] = value
                return float(share[k] @ np.square(_optimum(share, trial)) - aims[k])

            multipliers[k] = _root(surplus)
        if np.allclose(multipliers, before, rtol=1e-9, atol=0.0):
            break
    return _optimum(share, multipliers)


def _optimum(share: Array, multipliers: Array) -> Array:
    price = multipliers @ share
    # A price of at most one leaves the tolerance as it is.
    result: Array = np.maximum(price, 1.0) ** (-1.0 / 3.0)
    return result


def _root(surplus: Callable[[float], float]) -> float:
    """Where a falling function crosses zero, zero where it starts below."""
    if surplus(0.0) <= 0.0:
        return 0.0
    high = 1.0
    while surplus(high) > 0.0:
        high *= 8.0
    low = 0.0 if high == 1.0 else high / 8.0
    for _ in range(100):
        middle = 0.5 * (low + high) if low == 0.0 else math.sqrt(low * high)
        low, high = (middle, high) if surplus(middle) > 0.0 else (low, middle)
        if high - low <= 1e-12 * high:
            break
    return high
