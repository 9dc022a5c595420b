"""Number of poses that decides a limit, and poses spread over the task's region.

The squared error length of n poses is taken as a chi-square with n degrees of freedom, as for errors along one
direction; errors in three directions need fewer. A true value of r times the limit L is confirmed where the upper
bound s sqrt(n / chi2(1 - c; n)) of the estimate s is within L, so with probability P(chi2_n <= chi2(1 - c; n) / r^2).
A 95th percentile is bounded by order statistics: their variance is larger, and they need ln(1 - c) / ln 0.95 poses at
least (S. S. Wilks, "Determination of sample sizes for setting tolerance limits", Ann. Math. Statist. 12, 1941).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.statistics.distributions import chi2_cdf, chi2_quantile

AcceptanceStatistic = Literal["rms", "mean_error", "p95", "max"]

ASSURANCE = 0.9
"""Probability that the planned number of poses decides."""
MOST_POSES = 2000
RATIOS = (0.5, 0.6, 0.7, 0.8, 0.9)
EXPECTED_RATIO = 0.8
"""True value over the limit for which the number is planned, if no expected value is given."""
_REPRESENTED = 500
"""Poses, drawn at random, that stand for all in the mean distance."""
_PERCENTILE_COST = 2.4
"""Variance of order statistics relative to that of a Gaussian's radius, as in the decision on a gate."""


@dataclass(frozen=True, slots=True)
class Demand:
    """One limit that the measurement is to decide."""

    label: str
    statistic: AcceptanceStatistic
    limit: float
    """m or rad"""
    unit: str
    confidence: float
    share: float = 0.95
    """Share of all poses that must lie within the limit of a largest error."""


@dataclass(frozen=True, slots=True)
class NeededPoses:
    """Numbers of poses that decide one demand."""

    demand: Demand
    ratio: float
    """True value over the limit that the number is for."""
    poses: int | None
    """None where more than :data:`MOST_POSES` are needed."""
    by_ratio: tuple[tuple[float, int | None], ...]


def needed(demand: Demand, expected: float | None) -> NeededPoses:
    """Return the number of poses that decides ``demand`` with probability 0.9 if the true value is ``expected``."""
    ratio = EXPECTED_RATIO if expected is None else expected / demand.limit
    by_ratio = tuple((each, poses_for(demand, each)) for each in RATIOS)
    return NeededPoses(demand, ratio, poses_for(demand, ratio), by_ratio)


def poses_for(demand: Demand, ratio: float) -> int | None:
    """Return the number of poses that decides if the true value is ``ratio`` times the limit, below or above it."""
    fewest = 3
    if demand.statistic == "p95":
        fewest = math.ceil(math.log(1.0 - demand.confidence) / math.log(0.95))
    if demand.statistic == "max":
        return math.ceil(math.log(1.0 - demand.confidence) / math.log(demand.share)) if ratio <= 1.0 else fewest
    low, high = 2, 4
    while not _decides(high, ratio, demand.confidence):
        low, high = high, 2 * high
        if high > 4 * MOST_POSES:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if _decides(middle, ratio, demand.confidence) else (middle, high)
    cost = _PERCENTILE_COST if demand.statistic == "p95" else 1.0
    number = max(math.ceil(cost * high), fewest)
    return number if number <= MOST_POSES else None


def _decides(n: int, ratio: float, confidence: float) -> bool:
    if ratio < 1.0:
        return chi2_cdf(chi2_quantile(1.0 - confidence, n) / ratio**2, n) >= ASSURANCE
    return 1.0 - chi2_cdf(chi2_quantile(confidence, n) / ratio**2, n) >= ASSURANCE


def spread_poses(position: Array, q: Array, count: int, seed: int) -> NDArray[np.int64]:
    """Return ``count`` poses that represent all, in position ``(3, N)`` and in joints ``(J, N)``.

    Each pose in turn is the one that lowers most the energy distance between the chosen poses and all: the mean
    distance to all poses less the mean distance to those chosen (S. Mak and V. R. Joseph, "Support points", Annals of
    Statistics 46, 2018). Distances of positions and of joints, each over its mean, are added. ``seed`` draws the poses
    that stand for all where there are many.
    """
    n = q.shape[1]
    if count >= n:
        return np.arange(n)
    sample = np.random.default_rng([seed, 3]).permutation(n)[:_REPRESENTED]
    spaces = []
    mean_distance = np.zeros(n)
    for values in (_scaled(position), _scaled(q)):
        distance = np.mean([_distances(values, values[:, at]) for at in sample], axis=0)
        scale = float(distance.mean()) or 1.0
        spaces.append(values / scale)
        mean_distance += distance / scale
    to_chosen, chosen = np.zeros(n), np.zeros(count, dtype=np.int64)
    for i in range(count):
        score = mean_distance - to_chosen / (i + 1)
        score[chosen[:i]] = np.inf
        chosen[i] = np.argmin(score)
        to_chosen += sum(_distances(values, values[:, chosen[i]]) for values in spaces)
    return chosen


def _distances(values: Array, point: Array) -> Array:
    result: Array = np.sqrt(np.sum(np.square(values - point[:, None]), axis=0))
    return result


def _scaled(values: Array) -> Array:
    result: Array = (values - values.mean(axis=1, keepdims=True)) / np.maximum(
        np.std(values, axis=1, keepdims=True), 1e-9
    )
    return result
