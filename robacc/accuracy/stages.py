"""Before and after: figures and residuals of an arm as delivered, registered and mended, and what separates them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.metrics import PoseMetrics
from robacc.geometry import Array
from robacc.statistics.distributions import normal_quantile


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage of before and after."""

    fitted: PoseMetrics
    held_out: PoseMetrics | None
    """None where there were too few poses to hold any out."""


@dataclass(frozen=True, slots=True)
class Residuals:
    """Residuals ``(3 or 6, N)`` of the same poses at every stage: m, and rad, in the measuring frame."""

    nominal: Array
    before: Array
    after: Array
    held_before: Array | None = None
    """By models that had no part of the pose; None where none was held out."""
    held_after: Array | None = None


@dataclass(frozen=True, slots=True)
class Gain:
    """How much the position's root mean square fell on poses held out, with an interval over poses."""

    value: float
    low: float
    high: float
    confidence: float


@dataclass(frozen=True, slots=True)
class BeforeAfter:
    """All that is said of before and after."""

    nominal: Stage
    """As delivered."""
    before: Stage
    after: Stage
    gain: Gain | None
    """None where no pose was held out."""
    residuals: Residuals
    """Of every pose, those left out as outliers too."""
    apart: Residuals | None
    """Of poses of their own, where such were held out."""


def paired_gain(before: Array, after: Array, groups: NDArray[np.int64], confidence: float = 0.95) -> Gain:
    """Fall of the position's rms from ``before`` to ``after`` ``(M, N)`` on the same poses.

    The interval is the delta method's over groups of repeats: both errors of a pose stay together, so what the stages
    share cancels.
    """
    squares = np.stack([np.sum(np.square(one[:3]), axis=0) for one in (before, after)])
    count = int(groups.max(initial=-1)) + 1
    sums = np.stack([np.bincount(groups, weights=one, minlength=count) for one in squares])
    n = squares.shape[1]
    rms = np.sqrt(sums.sum(axis=1) / n)
    value = float(rms[0] - rms[1])
    if count < 3 or rms.min() <= 0:
        return Gain(value, float("nan"), float("nan"), confidence)
    influence = (sums[0] - sums[0].mean()) / (2 * rms[0] * n) - (sums[1] - sums[1].mean()) / (2 * rms[1] * n)
    spread = float(np.sqrt(np.sum(np.square(influence)) * count / (count - 1)))
    reach = normal_quantile(0.5 + confidence / 2) * spread
    return Gain(value, value - reach, value + reach, confidence)
