"""Interval of a percentile from the sample's own percentile, for lengths whose distribution is known up to its scale.

The sample's percentile of n lengths with distribution F lies at the rank 1 + (n - 1) p: it is (1 - w) X_k + w X_k+1 of
two order statistics. Given X_k+1 = x, X_k is the largest of k lengths below x, so that

    P((1 - w) X_k + w X_k+1 <= t) = I(F(t); k + 1, n - k)
                                    + integral over x > t of F(y)^k (1 - F(x))^(n-k-1) dF(x) / B(k + 1, n - k),

y = (t - w x) / (1 - w), I the regularised incomplete beta function (H. A. David and H. N. Nagaraja, Order Statistics,
2003, section 2.2). With F known up to its scale, the ratio of the sample's percentile to the true percentile has a
known distribution, and its quantiles give the interval. F is here the length of a fitted Gaussian.
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

_HALVINGS = 10
_CHORDS = 3
"""Steps along the chord of the last bracket, where the distribution is all but straight."""
_DEGREE = 16
"""Degree of the polynomial of the logit of F in the logarithm of the squared length: F to 1e-5."""
_LEAST, _MOST = 0.2, 1.0 - 1e-8
"""Shares between which F is interpolated: the second largest of ten lengths is below the first in 1 of 200,000 sets."""
_LEAST_WEIGHT = 1e-6
"""Weight below which an order statistic counts as absent from the percentile."""
_NEGLIGIBLE = 40.0
"""Fall of the integrand's logarithm at which an integral ends."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)


@dataclass(frozen=True, slots=True)
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
class _Interpolated:
    """F of many lengths at once: the logit of F is a polynomial in the logarithm of the squared length.

    The square of ``constant``, the part of the mean along axes without scatter, is subtracted from that of the length.
    """

    constant: float
    logit: np.polynomial.Chebyshev
    slope: np.polynomial.Chebyshev
    shortest: float
    longest: float

    @classmethod
    def of(cls, shape: LengthShape) -> _Interpolated:
        """Interpolate between the quantiles :data:`_LEAST` and :data:`_MOST`."""
        shortest, longest = shape.quantile(_LEAST), shape.quantile(_MOST)
        constant = math.sqrt(float(np.sum(np.square(shape.mean[shape.variances == 0.0]))))

        def logit(logarithms: Array) -> Array:
            shares = np.array([shape.share(math.hypot(math.exp(0.5 * x), constant)) for x in logarithms.tolist()])
            # Lengths that are equal to the last digits have no other share.
            shares = np.clip(shares, 0.5 * _LEAST, 1.0 - 0.5 * (1.0 - _MOST))
            return np.asarray(np.log(shares) - np.log1p(-shares))

        domain = [math.log(length**2 - constant**2) for length in (shortest, longest)]
        fitted = np.polynomial.Chebyshev.interpolate(logit, _DEGREE, domain=domain)
        return cls(constant, fitted, fitted.deriv(), shortest, longest)

    def shares(self, lengths: Array) -> Array:
        """Return F; beyond the range, of its ends."""
        at = np.square(np.clip(lengths, self.shortest, self.longest)) - self.constant**2
        return np.asarray(1.0 / (1.0 + np.exp(-self.logit(np.log(at)))))

    def densities(self, lengths: Array) -> Array:
        """Return dF / d length."""
        shares, squares = self.shares(lengths), np.square(lengths) - self.constant**2
        return np.asarray(shares * (1.0 - shares) * self.slope(np.log(squares)) * 2.0 * lengths / squares)

    def share_below(self, value: float, n: int, p: float) -> float:
        """Return the probability that the ``p`` percentile of ``n`` lengths is below ``value``."""
        if not self.shortest < value < self.longest:
            return float(value >= self.longest)
        rank = 1.0 + (n - 1.0) * p
        k = min(math.floor(rank), n - 1)
        w = rank - k
        share = float(self.shares(np.array([value]))[0])
        if w < _LEAST_WEIGHT:
            return beta_cdf(share, float(k), n + 1.0 - k)
        below = beta_cdf(share, k + 1.0, float(n - k))
        if w > 1.0 - _LEAST_WEIGHT:
            return below
        # The logarithm of F is concave: F(y)^k falls at least as fast as its tangent at the value.
        fall = k * float(self.densities(np.array([value]))[0]) / share * w / (1.0 - w)
        reach = min(self.longest, value / w, value + _NEGLIGIBLE / fall) - value
        lengths = value + 0.5 * reach * (1.0 + _NODES)
        lower = self.shares((value - w * lengths) / (1.0 - w))
        upper = 1.0 - self.shares(lengths)
        scale = math.lgamma(n + 1.0) - math.lgamma(k + 1.0) - math.lgamma(n - k)
        integrand = np.exp(scale + k * np.log(lower) + (n - k - 1.0) * np.log(upper)) * self.densities(lengths)
        return min(below + 0.5 * reach * float(_WEIGHTS @ integrand), 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class ScaledPercentileCurve:
    """Confidence curve of the ``p`` quantile of lengths, from the sample's own percentile."""

    value: float
    """Percentile of the sample."""
    n: int
    """Number of independent lengths."""
    p: float
    true: float
    """``p`` quantile of the shape."""
    lengths: _Interpolated

    @classmethod
    def of(cls, value: float, n: int, p: float, shape: LengthShape) -> ScaledPercentileCurve:
        """Return the curve of the percentile ``value`` of ``n`` lengths."""
        return cls(value, n, p, shape.quantile(p), _Interpolated.of(shape))

    def below(self, value: float) -> float:
        """See :class:`robacc.statistics.confidence_curves.ConfidenceCurve`."""
        if value <= 0.0:
            return 0.0
        return 1.0 - self.lengths.share_below(self.true * self.value / value, self.n, self.p)

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
            return self.lengths.share_below(self.true * reach, poses, self.p) >= ASSURANCE

        return smallest_sufficient(suffices, 2.0 * n)

    def _ratio(self, level: float, n: int) -> float:
        """Return the quantile of the sample's percentile over the true percentile."""
        low, high = (self.lengths.shortest, 0.0), (self.lengths.longest, 1.0)

        def on_chord() -> float:
            return low[0] + (high[0] - low[0]) * (level - low[1]) / (high[1] - low[1])

        for step in range(_HALVINGS + _CHORDS):
            length = 0.5 * (low[0] + high[0]) if step < _HALVINGS else on_chord()
            middle = length, self.lengths.share_below(length, n, self.p)
            low, high = (middle, high) if middle[1] < level else (low, middle)
        return on_chord() / self.true


def shape_of(mean: Array, variances: Array) -> LengthShape | None:
    """Return the shape of a Gaussian; None without scatter."""
    if not math.isfinite(float(np.sum(variances))) or not np.any(variances):
        return None
    return LengthShape(mean, variances)
