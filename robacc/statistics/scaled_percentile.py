"""Interval of a percentile from the sample's own percentile, for lengths whose distribution is known up to its scale.

The k-th of n order statistics of lengths with distribution F is F^-1(U), U ~ Beta(k, n + 1 - k). The sample's
percentile lies at the rank k = 1 + (n - 1) p, linear between neighbours; the same beta distribution with a fractional k
is used for it. With F known up to its scale, the ratio of the sample's percentile to the true percentile has a known
distribution, and its quantiles give the interval. F is here the length of a fitted Gaussian.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robacc.geometry import Array
from robacc.statistics.confidence_curves import ASSURANCE, smallest_sufficient
from robacc.statistics.distributions import beta_cdf
from robacc.statistics.intervals import Interval, tails
from robacc.statistics.quadratic_form import length_probability, length_quantile

_BISECTIONS = 60


@dataclass(frozen=True, slots=True, eq=False)
class LengthShape:
    """Distribution of the length of a Gaussian vector, up to its scale."""

    mean: Array
    """``(3,)`` in principal axes."""
    variances: Array
    """``(3,)``"""

    def share(self, length: float) -> float:
        """Return the share of lengths up to ``length``."""
        return length_probability(length, self.mean, self.variances)

    def quantile(self, share: float) -> float:
        """Return the length that ``share`` of all lengths do not exceed."""
        return length_quantile(share, self.mean, self.variances)


@dataclass(frozen=True, slots=True, eq=False)
class ScaledPercentileCurve:
    """Confidence curve of the ``p`` quantile of lengths, from the sample's own percentile."""

    value: float
    """Percentile of the sample."""
    n: int
    """Number of independent lengths."""
    p: float
    shape: LengthShape
    true: float
    """``p`` quantile of ``shape``."""

    @classmethod
    def of(cls, value: float, n: int, p: float, shape: LengthShape) -> ScaledPercentileCurve:
        """Return the curve of the percentile ``value`` of ``n`` lengths."""
        return cls(value, n, p, shape, shape.quantile(p))

    def below(self, value: float) -> float:
        """See :class:`robacc.statistics.confidence_curves.ConfidenceCurve`."""
        if value <= 0.0:
            return 0.0
        return 1.0 - _share_below(self.shape.share(self.true * self.value / value), self.n, self.p)

    def interval(self, confidence: float, method: str) -> Interval:
        """Return the interval; the curve at each of its bounds is that bound's level."""
        lower, upper, bound = (self.value / self._ratio(1.0 - level, self.n) for level in tails(confidence))
        return Interval(lower, upper, bound, confidence, method)

    def poses_for(self, limit: float, confidence: float, n: int) -> int | None:
        """See :class:`robacc.statistics.confidence_curves.ConfidenceCurve`."""
        if limit <= self.value:
            return None

        def suffices(poses: int) -> bool:
            # The bound is the sample's percentile over this ratio, so the percentile must be below limit times it.
            reach = limit / self.value * self._ratio(1.0 - confidence, poses)
            return _share_below(self.shape.share(self.true * reach), poses, self.p) >= ASSURANCE

        return smallest_sufficient(suffices, 2.0 * n)

    def _ratio(self, level: float, n: int) -> float:
        """Return the quantile of the sample's percentile over the true percentile."""
        low, high = 0.0, 1.0
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if _share_below(middle, n, self.p) < level else (low, middle)
        return self.shape.quantile(min(max(0.5 * (low + high), 1e-12), 1.0 - 1e-12)) / self.true


def _share_below(u: float, n: int, p: float) -> float:
    """Return the probability that the sample's percentile is below the ``u`` quantile of its distribution."""
    if not 0.0 < u < 1.0:
        return float(u >= 1.0)
    rank = 1.0 + (n - 1.0) * p
    return beta_cdf(u, rank, n + 1.0 - rank)


def shape_of(mean: Array, variances: Array) -> LengthShape | None:
    """Return the shape of a Gaussian; None without scatter."""
    if not math.isfinite(float(np.sum(variances))) or not np.any(variances):
        return None
    return LengthShape(mean, variances)
