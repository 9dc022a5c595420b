"""Length of Gaussian vectors: probability, quantile and mean, of one vector and of many; interval of a percentile.

For independent Z_i ~ N(m_i, v_i), Q = sum Z_i^2 has the Laplace transform

    M(s) = prod_i (1 + 2 v_i s)^(-1/2) exp(-m_i^2 s / (1 + 2 v_i s)),

and P(Q <= q) is the integral of e^(sq) M(s) / s along a path to the right of the pole at 0, divided by 2 pi i; a path
between the pole and the first branch point -1/(2 max v) gives minus P(Q > q) instead. The trapezoidal rule on a
parabola converges exponentially. A variance of zero is allowed.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np

from robacc.geometry import Array, NDArray
from robacc.statistics.intervals import ASSURANCE, Interval, beta_cdf, normal_quantile, root, smallest_sufficient

Complex = NDArray[np.complexfloating[Any, Any]]
Distribution = Callable[[Array], tuple[Array, Array]]
"""Returns P(Q <= q) and q times its density for squared lengths q ``(N,)`` above zero."""


def principal_variances(covariance: Array) -> Array:
    """Return eigenvalues ``(3, N)`` of covariances ``(3, 3, N)``, ascending, clipped at zero.

    The closed form (O. K. Smith, Communications of the ACM 4 (1961) 168) takes a tenth of LAPACK's time, but loses
    digits where two eigenvalues nearly agree; LAPACK finds these.
    """
    mean = np.trace(covariance) / 3.0
    (x, a, b), (_, y, c), (_, _, z) = covariance - mean * np.eye(3)[:, :, None]
    size = np.sqrt((x * x + y * y + z * z) / 6.0 + (a * a + b * b + c * c) / 3.0)
    half = 0.5 * (x * (y * z - c * c) - a * (a * z - b * c) + b * (a * c - b * y))
    cosine = half / np.where(size > 0.0, size, 1.0) ** 3
    turn = np.array([[2.0], [-2.0], [0.0]]) * math.pi / 3.0
    values = mean + 2.0 * size * np.cos(np.arccos(np.clip(cosine, -1.0, 1.0)) / 3.0 + turn)
    is_close = np.abs(cosine) > 1.0 - 1e-4
    values[:, is_close] = np.linalg.eigvalsh(np.moveaxis(covariance[:, :, is_close], -1, 0)).T
    return np.asarray(np.maximum(values, 0.0))


def _solved(probability: float, distribution: Distribution, variance: Array, share: float = 1e-5) -> Array:
    """Return the q ``(N,)`` of ``probability`` of squared lengths of mean 1 and ``variance`` ``(N,)``.

    Newton's steps in log q within a bracket have the curvature of gamma distributions. The last step starts within
    ``share`` of the probability beyond, and leaves about its square. The start is Wilson and Hilferty's cube, with
    Satterthwaite's degrees of freedom.
    """
    relative, shape = variance / 9.0, 1.0 / variance
    square = np.maximum(1.0 - relative + normal_quantile(probability) * np.sqrt(relative), 0.1) ** 3
    low, high = np.zeros_like(square), np.full_like(square, math.inf)
    enough = max(share * (1.0 - probability), 1e-14)
    for _ in range(200):
        cdf, density = distribution(square)
        low, high = np.where(cdf < probability, square, low), np.where(cdf < probability, high, square)
        step = np.clip((probability - cdf) / np.maximum(density, 1e-300), -1.0, 1.0)
        following = square * np.exp(step / np.maximum(1.0 + 0.5 * step * shape * (1.0 - square), 0.5))
        middle = np.where(np.isinf(high), 2.0 * square, 0.5 * (low + high))
        last, square = square, np.where((low <= following) & (following <= high), following, middle)
        if np.all((np.abs(probability - cdf) <= enough) | (square == last)):
            break
    return square


# Many vectors of zero mean: the same few nodes for all, with an error of about 1e-10.
#
# P(Q <= q) = 1/(2 pi i) int e^ζ/ζ prod (1 + 2 v_i ζ/q)^(-1/2) dζ converges geometrically on the parabola
# ζ = μ (iu + 1)^2: J. A. C. Weideman, L. N. Trefethen, "Parabolic and hyperbolic contours for computing the Bromwich
# integral", Mathematics of Computation 76 (2007) 1341-1356.

_COUNT = 12
"""Nodes of the path; the error falls as exp(-2 pi n/3)."""
_U = (np.arange(_COUNT) + 0.5) * 3.0 / _COUNT
_ZETA = math.pi * _COUNT / 12.0 * np.square(1j * _U + 1.0)
_CONTOUR = list(zip(_ZETA.tolist(), (0.5 * np.exp(_ZETA) * (1j - _U)).tolist(), strict=True))
"""Nodes of the path in the upper half plane, each with its factor."""
_BLOCK = 8192
"""Vectors at a time: their working arrays stay in the processor's cache."""


def _cdf_and_density(squares: Array, variances: Array) -> tuple[Array, Array]:
    """Return P(Q <= q) and q times its density, ``(N,)`` each, for q = ``squares`` ``(N,)`` above zero."""
    both = np.zeros((2, squares.size))
    for start in range(0, squares.size, _BLOCK):
        probability, density = both[:, start : start + _BLOCK]
        low, middle, high = 2.0 * variances[:, start : start + _BLOCK] / squares[start : start + _BLOCK]
        # The product of the factors 1 + 2 v_i ζ/q is a polynomial of ζ. The first factors have the angle of the product
        # of two up to a full turn, and of three up to one and a half. Complex numbers are in parts, which is faster.
        two, pair = middle + high, middle * high
        first, second, third = two + low, pair + low * two, low * pair
        for zeta, factor in _CONTOUR:
            square, cube = zeta * zeta, zeta * zeta * zeta
            x = 1.0 + zeta.real * first + square.real * second + cube.real * third
            y = zeta.imag * first + square.imag * second + cube.imag * third
            size = np.sqrt(x * x + y * y)
            larger = np.sqrt(0.5 * (size + np.abs(x)))
            smaller = 0.5 * np.abs(y) / larger
            # The root in the upper half plane; in the lower one after a full turn of the product.
            sign = np.where((y > 0.0) & (two + 2.0 * zeta.real * pair < 0.0), -1.0, 1.0) / size
            is_right = x >= 0.0
            x = np.copysign(np.where(is_right, larger, smaller), y) * sign
            y = np.where(is_right, smaller, larger) * sign
            density += factor.imag * x - factor.real * y
            ratio = factor / zeta
            probability += ratio.imag * x - ratio.real * y
    return both[0], both[1]


def length_quantiles(probability: float, variances: Array) -> Array:
    """Return radii ``(N,)`` of ``probability`` for variances ``(3, N)``; zero if all variances are zero.

    Args:
        probability: At least 0.5, below 1.
        variances: Variances along the principal axes, ascending.
    """
    power = variances.sum(axis=0)
    scatter, result = power > 0.0, np.zeros(power.size)
    shares = variances[:, scatter] / power[scatter]
    distribution = partial(_cdf_and_density, variances=shares)
    square = _solved(probability, distribution, 2.0 * np.sum(np.square(shares), axis=0))
    result[scatter] = np.sqrt(square * power[scatter])
    return result


def mixture_quantile(probability: float, variances: Array) -> float:
    """Return the radius of ``probability`` of the mixture of all N vectors in equal parts.

    Their variances ``(3, N)`` ascend.
    """
    power = variances.sum(axis=0)
    mean_power = float(np.mean(power))
    if mean_power == 0.0:
        return 0.0
    shares = variances[:, power > 0.0] / mean_power

    def mixture(square: Array) -> tuple[Array, Array]:
        parts = np.sum(_cdf_and_density(np.full(shares.shape[1], square[0]), shares), axis=1)
        cdf, density = parts[:, None] / power.size
        return 1.0 - shares.shape[1] / power.size + cdf, density

    second_moment = np.sum(2.0 * np.sum(np.square(shares), axis=0) + np.square(shares.sum(axis=0))) / power.size
    return math.sqrt(_solved(probability, mixture, np.array([second_moment - 1.0]))[0] * mean_power)


def mean_lengths(variances: Array) -> Array:
    """Return E|Z| ``(N,)`` for variances ``(3, N)``, ascending: (8 / pi)^(1/2) R_G(v_1, v_2, v_3).

    R_G is the mean of the length of diag(v)^(1/2) u over all unit vectors u (DLMF 19.16.3 and 19.21.10), here by
    Carlson's duplication of R_F and R_D (DLMF 19.26.18 and 19.26.20). scipy.special has it, but its import takes longer
    than all criteria of ISO 9283.
    """
    # Without a floor R_F and R_D are infinite where two variances are zero; R_G changes by less than 1e-18.
    x, y, z = first, second, third = np.maximum(variances / np.where(variances[2] > 0.0, variances[2], 1.0), 1e-20)
    r_d, weight = np.zeros_like(z), 1.0
    while np.any(z - x > 1e-7 * z):
        roots = np.sqrt((x, y, z))
        shift = roots[0] * roots[1] + (roots[0] + roots[1]) * roots[2]
        r_d += 3.0 * weight / (roots[2] * (z + shift))
        x, y, z, weight = 0.25 * (x + shift), 0.25 * (y + shift), 0.25 * (z + shift), 0.25 * weight
    r_d += weight / ((x + y + 3.0 * z) / 5.0) ** 1.5
    r_f = 1.0 / np.sqrt((x + y + z) / 3.0)
    r_g = 0.5 * (third * r_f - (first - third) * (second - third) * r_d / 3.0 + np.sqrt(first * second / third))
    return np.asarray(np.sqrt(8.0 / math.pi * variances[2]) * r_g)


# One vector, to full precision.
#
# The path goes through the saddle point of the integrand, where it is as small as the result (so that nothing cancels,
# in either tail), and bends to the left as a parabola. Imhof's formula (Biometrika 48, 1961) is the same integral along
# the imaginary axis, where it converges slowly for the two or three terms of a position error. Source of the path:
# S. O. Rice, "Distribution of quadratic forms in normal random variables - evaluation by numerical integration", SIAM
# J. Sci. Stat. Comput. 1 (1980) 438-448.

_ROUNDING = 1e-14
_RISE = 0.5
"""Rise of the exponent above the saddle point that is allowed: a factor of e^0.5 cancels less than a digit."""
_ABREAST = np.linspace(0.0, 5.0, 21)[:, None]
"""Ratios of horizontal to vertical distance from a singularity at which the path is checked."""


def length_probability(radius: float, mean: Array, variance: Array) -> float:
    """Return P(|Z| <= radius) for independent Z_i ~ N(mean[i], variance[i]), i < 3; absolute error about 1e-13."""
    return _contour(radius * radius, tuple(mean), tuple(variance))[0]


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

    def distribution(square: Array) -> tuple[Array, Array]:
        # In units of the mean square length, so that the solution does not depend on the unit.
        cdf, s, _, factor = _contour(float(square[0]), tuple(mean / math.sqrt(power)), tuple(variance / power))
        return np.array([cdf]), (s @ factor).imag * square

    scatter = np.sum(variance * (2.0 * variance + 4.0 * np.square(mean))) / power**2
    return math.sqrt(_solved(probability, distribution, np.array([scatter]), 1e-7)[0] * power)


def squared_quantile_gradient(radius: float, mean: Array, variance: Array) -> tuple[Array, Array]:
    """Return the gradient of the squared quantile radius r^2 at constant probability.

    Args:
        radius: Quantile from :func:`length_quantile`.
        mean: ``(3,)`` in principal axes.
        variance: ``(3,)`` along the same axes.

    Returns:
        d(r^2)/dm ``(3,)`` and d(r^2)/dC ``(3, 3)``, symmetric, in principal axes; the first has the unit of ``mean``.
    """
    scale = math.sqrt(float(np.sum(variance) + np.sum(np.square(mean))))
    _, s, w, factor = _contour((radius / scale) ** 2, tuple(mean / scale), tuple(variance / scale**2))
    # Weights: s for the density, d log M/dm_i and d log M/dC_ij for the gradient; C_ij and C_ji are separate variables.
    ratio = (mean / scale)[:, None] * s / w
    by_covariance: Complex = 2.0 * ratio[:, None] * ratio[None, :]
    by_covariance[np.arange(3), np.arange(3)] -= s / w
    density = (s @ factor).imag
    return 2.0 * (ratio @ factor).imag / density * scale, -(by_covariance @ factor).imag / density


@lru_cache(maxsize=1024)
def _contour(q: float, mean: tuple[float, ...], variance: tuple[float, ...]) -> tuple[float, Complex, Complex, Complex]:
    """Return P(Q <= q), and the nodes of its integral: s ``(n,)``, 1 + 2 v s ``(3, n)``, and their factors ``(n,)``.

    The imaginary part of the sum of s and the factors is the density dP/dq. All is zero below the contribution of
    directions without scatter. The latest are kept: several figures and stages of a result ask for the same.
    """
    if q <= sum(m * m for m, v in zip(mean, variance, strict=True) if v == 0.0):
        return 0.0, np.zeros(1, dtype=complex), np.ones((3, 1), dtype=complex), np.zeros(1, dtype=complex)
    is_upper = q > sum(variance) + sum(m * m for m in mean)
    saddle, curvature = _saddle_point(q, mean, variance, is_upper)

    def along(t: Array) -> tuple[Complex, Complex, Complex]:
        """Return s = saddle + i t - b t^2 ``(n,)``, log(e^(sq) M(s) / s), and w = 1 + 2 v s ``(3, n)``."""
        s: Complex = saddle + 1j * t - bend * np.square(t)
        w = 1.0 + 2.0 * np.array(variance)[:, None] * s
        logs = s * q - np.log(s) - 0.5 * np.sum(np.log(w), axis=0)
        return s, logs - np.sum(np.square(mean)[:, None] * s / w, axis=0), w

    grid = np.append(0.0, 2.0 ** np.arange(-2.0, 60.0, 0.5) / math.sqrt(curvature))
    distance = saddle + np.array([0.5 / v for v in variance if v > 0.0])
    # Start with a parabola whose focus is the first branch point: the exponent of that axis falls steadily from the
    # vertex. Where the mean lies along an axis of less scatter, the path may come near the singularity of that axis
    # and is straightened: along a straight line the integrand never exceeds its value at the saddle point.
    bend, end = 0.25 / float(np.min(distance)), 0.0
    uncertainty = _ROUNDING * (1.0 + abs(saddle) * q)
    nodes, last = 32, math.inf
    while True:
        if end == 0.0:
            # Near a singularity a peak may be narrower than the grid: extra points cover the path from where it lies
            # five times as far to the left as below, to where it lies straight below.
            near = (np.sqrt(np.square(_ABREAST) + 4.0 * bend * distance) - _ABREAST) / (2.0 * bend)
            t = np.sort(np.concatenate((grid, near.ravel())))
            height = along(t)[1].real
            at_saddle = float(height[0])
            height -= at_saddle
            if float(np.max(height)) >= _RISE:
                bend *= 0.25
                continue
            # At the end the integrand is negligible.
            # Fall of the integrand's exponent from the saddle point at which the path ends: e^-42 = 6e-19.
            end = float(t[min(np.flatnonzero(height > -42.0)[-1] + 1, t.size - 1)])
        t = np.linspace(0.0, end, nodes + 1)
        s, logarithm, w = along(t)
        if float(np.max(logarithm.real)) > at_saddle + 2.0 * _RISE:
            # The path crosses a peak that its shape should avoid.
            bend, end = 0.25 * bend, 0.0
            continue
        # The path is symmetric about the real axis: twice the upper half's imaginary part, half weight at t = 0.
        factor = np.exp(logarithm) * (1j - 2.0 * bend * t) * (end / nodes / math.pi)
        factor[0] *= 0.5
        tail = float(np.sum(factor.imag))
        if abs(tail - last) <= uncertainty or nodes >= 8192:
            break
        last, nodes = tail, 2 * nodes
    return 1.0 + tail if is_upper else tail, s, w, factor


def _saddle_point(
    q: float, mean: tuple[float, ...], variance: tuple[float, ...], is_upper: bool
) -> tuple[float, float]:
    """Return the minimum over real s of log(e^(sq) M(s) / |s|), convex there, and its second derivative."""
    terms = [(float(m) ** 2, float(v)) for m, v in zip(mean, variance, strict=True)]

    def slope(s: float) -> float:
        return q - 1.0 / s - sum(v / (1.0 + 2.0 * v * s) + square / (1.0 + 2.0 * v * s) ** 2 for square, v in terms)

    branch = -0.5 / max(variance)
    low, high = (branch * (1.0 - 1e-12), branch * 1e-12) if is_upper else (1.0 / q, 2.0 / q)
    # The path only needs to pass near the saddle point, relative to the distance to the nearest singularity.
    s = root(slope, low, high, 1e-9)
    w = [1.0 + 2.0 * v * s for _, v in terms]
    bends = [2.0 * v * v / (x * x) + 4.0 * m * v / x**3 for (m, v), x in zip(terms, w, strict=True)]
    return s, 1.0 / (s * s) + sum(bends)


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

_DEGREE = 16
"""Degree of the polynomial of the logit of F in the logarithm of the squared length: F to 1e-5."""
_LEAST, _MOST = 0.2, 1.0 - 1e-8
"""Shares between which F is interpolated: the second largest of ten lengths is below the first in 1 of 200,000 sets."""
_LEAST_WEIGHT = 1e-6
"""Weight below which an order statistic counts as absent from the percentile."""
_GAUSS = np.polynomial.legendre.leggauss(32)
"""Nodes and weights."""


@dataclass(frozen=True, eq=False)
class ScaledPercentileCurve:
    """Confidence curve of the ``p`` quantile of lengths, from the sample's own percentile."""

    value: float
    """Percentile of the sample."""
    n: int
    """Number of independent lengths."""
    p: float
    mean: Array
    """``(3,)`` mean, in principal axes, of the Gaussian whose length has the distribution up to its scale."""
    variances: Array
    """``(3,)``"""

    @cached_property
    def true(self) -> float:
        """The ``p`` quantile of the Gaussian's length."""
        return length_quantile(self.p, self.mean, self.variances)

    @cached_property
    def _constant(self) -> float:
        """Square of the part of the mean along axes without scatter, which every squared length contains."""
        return float(np.sum(np.square(self.mean[self.variances == 0.0])))

    @cached_property
    def _ends(self) -> tuple[float, float]:
        """Lengths between which F is interpolated: its quantiles :data:`_LEAST` and :data:`_MOST`."""
        return (
            length_quantile(_LEAST, self.mean, self.variances),
            length_quantile(_MOST, self.mean, self.variances),
        )

    @cached_property
    def _logit(self) -> tuple[Array, Array]:
        """Chebyshev series ``(K, 2)`` of the logit of F and of its derivative, and their domain ``(2,)``.

        They are series in the logarithm of the squared length less the constant.
        """

        def logit(logarithms: Array) -> Array:
            radii = [math.sqrt(math.exp(x) + self._constant) for x in logarithms.tolist()]
            shares = np.array([length_probability(radius, self.mean, self.variances) for radius in radii])
            # Lengths that are equal to the last digits have no other share.
            shares = np.clip(shares, 0.5 * _LEAST, 1.0 - 0.5 * (1.0 - _MOST))
            return np.asarray(np.log(shares) - np.log1p(-shares))

        domain = [math.log(length**2 - self._constant) for length in self._ends]
        series = np.polynomial.Chebyshev.interpolate(logit, _DEGREE, domain=domain)
        return np.column_stack((series.coef, np.append(series.deriv().coef, 0.0))), series.domain

    def _distribution(self, lengths: Array) -> tuple[Array, Array]:
        """Return F and dF / d length; beyond the range, those of its ends."""
        squares, (series, (low, high)) = np.square(np.clip(lengths, *self._ends)) - self._constant, self._logit
        places = np.clip((2.0 * np.log(squares) - low - high) / (high - low), -1.0, 1.0)
        logit, slope = np.polynomial.chebyshev.chebval(places, series)
        shares = 1.0 / (1.0 + np.exp(-logit))
        return shares, shares * (1.0 - shares) * slope * 2.0 * lengths / squares

    def _share_below(self, value: float, n: int) -> float:
        """Return the probability that the percentile of ``n`` lengths is below ``value``."""
        if not self._ends[0] < value < self._ends[1]:
            return float(value >= self._ends[1])
        rank = 1.0 + (n - 1.0) * self.p
        k = min(math.floor(rank), n - 1)
        w = rank - k
        share, density = (float(each[0]) for each in self._distribution(np.array([value])))
        if w < _LEAST_WEIGHT:
            return beta_cdf(share, float(k), n + 1.0 - k)
        below = beta_cdf(share, k + 1.0, float(n - k))
        if w > 1.0 - _LEAST_WEIGHT:
            return below
        # The logarithm of F is concave: F(y)^k falls at least as fast as its tangent at the value.
        fall = k * density / share * w / (1.0 - w)
        # The integral ends where the integrand's logarithm has fallen by 40.
        reach = min(self._ends[1], value / w, value + 40.0 / fall) - value
        nodes, weights = _GAUSS
        lengths = value + 0.5 * reach * (1.0 + nodes)
        both, slopes = self._distribution(np.concatenate(((value - w * lengths) / (1.0 - w), lengths)))
        (lower, shares), densities = np.split(both, 2), slopes[lengths.size :]
        scale = math.lgamma(n + 1.0) - math.lgamma(k + 1.0) - math.lgamma(n - k)
        integrand = np.exp(scale + k * np.log(lower) + (n - k - 1.0) * np.log(1.0 - shares)) * densities
        return min(below + 0.5 * reach * float(weights @ integrand), 1.0)

    def below(self, value: float) -> float:
        """See :class:`robacc.statistics.intervals.ConfidenceCurve`."""
        return 1.0 - self._share_below(self.true * self.value / value, self.n) if value > 0.0 else 0.0

    def interval(self, confidence: float, method: str) -> Interval:
        """Return the interval; the curve at each of its bounds is that bound's level."""
        return Interval.at(lambda p: self.value / self._ratio(1.0 - p, self.n), confidence, method)

    def poses_for(self, limit: float, confidence: float, n: int) -> int | None:
        """See :class:`robacc.statistics.intervals.ConfidenceCurve`."""

        def suffices(poses: int) -> bool:
            # The bound is the sample's percentile over this ratio, so the percentile must be below limit times it.
            length = self.true * limit / self.value * self._ratio(1.0 - confidence, poses)
            return self._share_below(length, poses) >= ASSURANCE

        return smallest_sufficient(suffices, 2.0 * n) if limit > self.value else None

    def _ratio(self, level: float, n: int) -> float:
        """Return the quantile of the sample's percentile over the true percentile."""
        return root(lambda length: self._share_below(length, n) - level, *self._ends, 1e-9) / self.true
