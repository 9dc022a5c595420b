"""Length of a Gaussian vector: its exact distribution, and the interval of a percentile of such lengths.

For independent Z_i ~ N(m_i, v_i), Q = sum Z_i^2 has the Laplace transform

    M(s) = prod_i (1 + 2 v_i s)^(-1/2) exp(-m_i^2 s / (1 + 2 v_i s)),

and P(Q <= q) is the integral of e^(sq) M(s) / s along a path to the right of the pole at 0, divided by 2 pi i; a path
between the pole and the first branch point -1/(2 max v) gives minus P(Q > q) instead. The path goes through the
saddle point of the integrand, where it is as small as the result (so that nothing cancels, in either tail), and bends
to the left as a parabola; the trapezoidal rule on it converges exponentially.

Imhof's formula (Biometrika 48, 1961) is the same integral along the imaginary axis, where it converges slowly for the
two or three terms of a position error. Source of the path: S. O. Rice, "Distribution of quadratic forms in normal
random variables - evaluation by numerical integration", SIAM J. Sci. Stat. Comput. 1 (1980) 438-448.
A variance of zero is allowed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.statistics.confidence_curves import ASSURANCE, smallest_sufficient
from robacc.statistics.distributions import beta_cdf
from robacc.statistics.intervals import Interval, tails

Complex = NDArray[np.complexfloating[Any, Any]]

_DROP = 42.0
"""Fall of the integrand's exponent from the saddle point at which the path ends: e^-42 = 6e-19."""
_ROUNDING = 1e-14
_MAX_NODES = 8192
_FEWEST_NODES = 32
_RISE = 0.5
"""Rise of the exponent above the saddle point that is allowed: a factor of e^0.5 cancels less than a digit."""
_ABREAST = np.linspace(0.0, 5.0, 21)[:, None]
"""Ratios of horizontal to vertical distance from a singularity at which the path is checked."""


@dataclass(frozen=True, slots=True)
class _Path:
    """Contour integrals of e^(sq) M(s)/s times the requested weights, at a value q."""

    cdf: float
    sf: float
    uncertainty: float
    """Rounding error of both: the size of the exponent times a few units of the last place."""
    density: float
    """dP/dq"""
    gradient: Array
    """``(12,)`` dP/dm_i and dP/dC_ij, with C_ij and C_ji counted as separate variables; empty unless requested"""


def length_probability(radius: float, mean: Array, variance: Array) -> float:
    """Return P(|Z| <= radius) for independent Z_i ~ N(mean[i], variance[i]), i < 3; absolute error about 1e-13."""
    return _probability(radius * radius, np.asarray(mean, dtype=float), np.asarray(variance, dtype=float)).cdf


def length_quantile(probability: float, mean: Array, variance: Array) -> float:
    """Return the radius with P(|Z| <= radius) = ``probability``, in the unit of the square root of ``variance``.

    Args:
        probability: Between 0 and 1, both excluded.
        mean: ``(3,)`` in principal axes.
        variance: ``(3,)`` along the same axes; zeros are allowed.
    """
    mean, variance = np.asarray(mean, dtype=float), np.asarray(variance, dtype=float)
    power = float(np.sum(variance) + np.sum(np.square(mean)))
    if power == 0.0 or float(np.max(variance)) <= 1e-24 * power:
        return math.sqrt(power)
    # Everything in units of the mean square length, so that the solution does not depend on the unit.
    m, v = mean / math.sqrt(power), variance / power
    length_std = math.sqrt(2.0 * float(np.sum(v * v)) + 4.0 * float(np.sum(m * m * v)))
    low = float(np.sum(np.square(m[v == 0.0])))
    high = 1.0 + 2.0 * length_std
    while _probability(high, m, v).cdf < probability:
        low, high = high, high + 2.0 * (high - low)
    q = max(0.5 * (low + high), low)
    for _ in range(200):
        path = _probability(q, m, v)
        error = path.cdf - probability if probability < 0.5 else (1.0 - probability) - path.sf
        if abs(error) <= path.uncertainty or high - low <= 1e-15 * high:
            break
        low, high = (q, high) if error < 0.0 else (low, q)
        # A step that would leave the bracket is not computed: far out the density may be almost zero.
        following = q - error / path.density if abs(error) < path.density * (high - low) else low
        q = following if low < following < high else 0.5 * (low + high)
    return math.sqrt(q * power)


def squared_quantile_gradient(radius: float, mean: Array, variance: Array) -> tuple[Array, Array]:
    """Return the gradient of the squared quantile radius r^2 at constant probability.

    Args:
        radius: Quantile from :func:`length_quantile`.
        mean: ``(3,)`` in principal axes.
        variance: ``(3,)`` along the same axes.

    Returns:
        d(r^2)/dm ``(3,)`` and d(r^2)/dC ``(3, 3)``, symmetric, in principal axes; the first has the unit of ``mean``.
    """
    mean, variance = np.asarray(mean, dtype=float), np.asarray(variance, dtype=float)
    scale = math.sqrt(float(np.sum(variance) + np.sum(np.square(mean))))
    path = _probability((radius / scale) ** 2, mean / scale, variance / scale**2, gradient=True)
    return -path.gradient[:3] / path.density * scale, -path.gradient[3:].reshape(3, 3) / path.density


def _probability(q: float, mean: Array, variance: Array, *, gradient: bool = False) -> _Path:
    """Return the contour integrals at ``q``; zero below the contribution of directions without scatter."""
    if q <= float(np.sum(np.square(mean[variance == 0.0]))):
        return _Path(0.0, 1.0, 0.0, 0.0, np.zeros(12 if gradient else 0))
    upper = q > float(np.sum(variance) + np.sum(np.square(mean)))
    saddle, curvature = _saddle_point(q, mean, variance, upper)
    bend, end, top = _shape_of_path(q, mean, variance, saddle, curvature)
    uncertainty = _ROUNDING * (1.0 + abs(saddle) * q)
    nodes, last = _FEWEST_NODES, math.inf
    while True:
        integrals = _trapezoid(q, mean, variance, saddle, bend, end, nodes, top, gradient)
        if integrals is None:
            bend, end, top = _shape_of_path(q, mean, variance, saddle, curvature, 0.25 * bend)
            continue
        tail = float(integrals[0])
        if abs(tail - last) <= uncertainty or nodes >= _MAX_NODES:
            break
        last, nodes = tail, 2 * nodes
    cdf, sf = (1.0 + tail, -tail) if upper else (tail, 1.0 - tail)
    return _Path(cdf, sf, uncertainty, float(integrals[1]), integrals[2:])


def _saddle_point(q: float, mean: Array, variance: Array, upper: bool) -> tuple[float, float]:
    """Return the minimum over real s of log(e^(sq) M(s) / |s|), convex there, and its second derivative."""
    terms = [(float(m) ** 2, float(v)) for m, v in zip(mean, variance, strict=True)]

    def slopes(s: float) -> tuple[float, float]:
        first, second = q - 1.0 / s, 1.0 / (s * s)
        for square, v in terms:
            w = 1.0 + 2.0 * v * s
            first -= v / w + square / (w * w)
            second += 2.0 * v * v / (w * w) + 4.0 * square * v / (w * w * w)
        return first, second

    branch = -0.5 / float(np.max(variance))
    if upper:
        low, high = branch, 0.0
        s = 0.5 * low
    else:
        low, high = 0.0, 1.0 / q
        while slopes(high)[0] < 0.0:
            low, high = high, 2.0 * high
        s = high
    for _ in range(100):
        first, second = slopes(s)
        low, high = (s, high) if first < 0.0 else (low, s)
        following = s - first / second
        if not low < following < high:
            following = 0.5 * (low + high)
        # The path only needs to pass near the saddle point, relative to the distance to the nearest singularity (close
        # to a singularity Newton's steps are short even far from the root).
        distance = min(abs(following), following - branch) if upper else following
        if abs(following - s) <= 1e-3 * distance:
            s = following
            break
        s = following
    return s, slopes(s)[1]


def _exponent(s: Complex, q: float, mean: Array, variance: Array) -> tuple[Complex, Complex]:
    """Return log(e^(sq) M(s) / s) ``(n,)`` and w = 1 + 2 v s ``(3, n)`` at complex ``s`` ``(n,)``."""
    w = 1.0 + 2.0 * variance[:, None] * s
    value: Complex = (
        s * q - np.log(s) - 0.5 * np.sum(np.log(w), axis=0) - np.sum(np.square(mean)[:, None] * s / w, axis=0)
    )
    return value, w


def _shape_of_path(
    q: float, mean: Array, variance: Array, saddle: float, curvature: float, max_bend: float = math.inf
) -> tuple[float, float, float]:
    """Return the bend b of the path saddle + i t - b t^2, its end and the exponent that it should not exceed.

    The bend is at most ``max_bend``. At the end, a value of t, the integrand is negligible.
    """
    grid = 2.0 ** np.arange(-2.0, 60.0, 0.5) / math.sqrt(curvature)
    distance = saddle + 0.5 / variance[variance > 0.0]
    at_saddle = _exponent(np.array([complex(saddle)]), q, mean, variance)[0].real[0]
    # Start with a parabola whose focus is the first branch point: the exponent of that axis falls steadily from the
    # vertex. Where the mean lies along an axis of less scatter, the path may come near the singularity of that axis
    # and is straightened: along a straight line the integrand never exceeds its value at the saddle point.
    bend = min(0.25 / float(np.min(distance)), max_bend)
    while True:
        # Near a singularity a peak may be narrower than the grid: extra points cover the path from where it lies five
        # times as far to the left as below, to where it lies straight below.
        near = (np.sqrt(np.square(_ABREAST) + 4.0 * bend * distance) - _ABREAST) / (2.0 * bend)
        t = np.sort(np.concatenate((grid, near.ravel())))
        s: Complex = saddle + 1j * t - bend * np.square(t)
        height = _exponent(s, q, mean, variance)[0].real - at_saddle
        if float(np.max(height)) < _RISE:
            break
        bend *= 0.25
    relevant = np.flatnonzero(height > -_DROP)
    return bend, float(t[min(relevant[-1] + 1, t.size - 1)]), float(at_saddle) + 2.0 * _RISE


def _trapezoid(
    q: float,
    mean: Array,
    variance: Array,
    saddle: float,
    bend: float,
    end: float,
    nodes: int,
    top: float,
    gradient: bool,
) -> Array | None:
    """Return the integrals ``(2 or 14,)`` for weights 1, s (density) and d log M/dm_i, d log M/dC_ij (gradient).

    None where a node's exponent exceeds ``top``: the path crosses a peak that its shape should avoid.
    """
    t = np.linspace(0.0, end, nodes + 1)
    s: Complex = saddle + 1j * t - bend * np.square(t)
    value, w = _exponent(s, q, mean, variance)
    if float(np.max(value.real)) > top:
        return None
    # The path is symmetric about the real axis: twice the upper half's imaginary part, half weight at t = 0.
    factor = np.exp(value) * (1j - 2.0 * bend * t) * (end / nodes / math.pi)
    factor[0] *= 0.5
    weights = np.concatenate((np.ones((1, s.size)), s[None]))
    if gradient:
        ratio = mean[:, None] * s / w
        by_covariance: Complex = 2.0 * ratio[:, None] * ratio[None, :]
        by_covariance[np.arange(3), np.arange(3)] -= s / w
        weights = np.concatenate((weights, -2.0 * ratio, by_covariance.reshape(9, -1)))
    result: Array = (weights @ factor).imag
    return result


# Interval of a percentile from the sample's own percentile, for lengths whose distribution is known up to its scale.
#
# The sample's percentile of n lengths with distribution F lies at the rank 1 + (n - 1) p: it is (1 - w) X_k + w X_k+1
# of two order statistics. Given X_k+1 = x, X_k is the largest of k lengths below x, so that
#
#     P((1 - w) X_k + w X_k+1 <= t) = I(F(t); k + 1, n - k)
#                                     + integral over x > t of F(y)^k (1 - F(x))^(n-k-1) dF(x) / B(k + 1, n - k),
#
# y = (t - w x) / (1 - w), I the regularised incomplete beta function (H. A. David and H. N. Nagaraja, Order
# Statistics, 2003, section 2.2). With F known up to its scale, the ratio of the sample's percentile to the true
# percentile has a known distribution, and its quantiles give the interval. F is here the length of a fitted Gaussian.

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


class LengthShape(NamedTuple):
    """Gaussian vector whose length has the distribution, up to its scale."""

    mean: Array
    """``(3,)`` in principal axes."""
    variances: Array
    """``(3,)``"""


@dataclass(frozen=True, slots=True, eq=False)
class ScaledPercentileCurve:
    """Confidence curve of the ``p`` quantile of lengths, from the sample's own percentile.

    F of many lengths at once: the logit of F is a polynomial in the logarithm of the squared length. The square of
    ``constant``, the part of the mean along axes without scatter, is subtracted from that of the length.
    """

    value: float
    """Percentile of the sample."""
    n: int
    """Number of independent lengths."""
    p: float
    true: float
    """``p`` quantile of the shape."""
    constant: float
    logit: np.polynomial.Chebyshev
    slope: np.polynomial.Chebyshev
    shortest: float
    longest: float

    @classmethod
    def of(cls, value: float, n: int, p: float, shape: LengthShape) -> ScaledPercentileCurve:
        """Return the curve of the percentile ``value`` of ``n`` lengths.

        F is interpolated between its quantiles :data:`_LEAST` and :data:`_MOST`.
        """
        shortest, longest = length_quantile(_LEAST, *shape), length_quantile(_MOST, *shape)
        constant = math.sqrt(float(np.sum(np.square(shape.mean[shape.variances == 0.0]))))

        def logit(logarithms: Array) -> Array:
            shares = np.array(
                [length_probability(math.hypot(math.exp(0.5 * x), constant), *shape) for x in logarithms.tolist()]
            )
            # Lengths that are equal to the last digits have no other share.
            shares = np.clip(shares, 0.5 * _LEAST, 1.0 - 0.5 * (1.0 - _MOST))
            return np.asarray(np.log(shares) - np.log1p(-shares))

        domain = [math.log(length**2 - constant**2) for length in (shortest, longest)]
        fitted = np.polynomial.Chebyshev.interpolate(logit, _DEGREE, domain=domain)
        true = length_quantile(p, *shape)
        return cls(value, n, p, true, constant, fitted, fitted.deriv(), shortest, longest)

    def shares(self, lengths: Array) -> Array:
        """Return F; beyond the range, of its ends."""
        at = np.square(np.clip(lengths, self.shortest, self.longest)) - self.constant**2
        return np.asarray(1.0 / (1.0 + np.exp(-self.logit(np.log(at)))))

    def densities(self, lengths: Array) -> Array:
        """Return dF / d length."""
        shares, squares = self.shares(lengths), np.square(lengths) - self.constant**2
        return np.asarray(shares * (1.0 - shares) * self.slope(np.log(squares)) * 2.0 * lengths / squares)

    def share_below(self, value: float, n: int) -> float:
        """Return the probability that the percentile of ``n`` lengths is below ``value``."""
        if not self.shortest < value < self.longest:
            return float(value >= self.longest)
        rank = 1.0 + (n - 1.0) * self.p
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

    def below(self, value: float) -> float:
        """See :class:`robacc.statistics.confidence_curves.ConfidenceCurve`."""
        if value <= 0.0:
            return 0.0
        return 1.0 - self.share_below(self.true * self.value / value, self.n)

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
            return self.share_below(self.true * reach, poses) >= ASSURANCE

        return smallest_sufficient(suffices, 2.0 * n)

    def _ratio(self, level: float, n: int) -> float:
        """Return the quantile of the sample's percentile over the true percentile."""
        low, high = (self.shortest, 0.0), (self.longest, 1.0)

        def on_chord() -> float:
            return low[0] + (high[0] - low[0]) * (level - low[1]) / (high[1] - low[1])

        for step in range(_HALVINGS + _CHORDS):
            length = 0.5 * (low[0] + high[0]) if step < _HALVINGS else on_chord()
            middle = length, self.share_below(length, n)
            low, high = (middle, high) if middle[1] < level else (low, middle)
        return on_chord() / self.true
