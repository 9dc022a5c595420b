"""Length of zero-mean Gaussian vectors: probability, quantile and mean over N covariances.

For variances v_i along the principal axes, Q = |Z|^2 has the Laplace transform M(s) = prod (1 + 2 v_i s)^(-1/2), whose
singularities lie on the negative real axis, so

    P(Q <= q) = 1/(2 pi i) int e^ζ/ζ prod (1 + 2 v_i ζ/q)^(-1/2) dζ

converges geometrically on the parabola ζ = μ (iu + 1)^2, with the same few nodes for all variances. Source of the path:
J. A. C. Weideman, L. N. Trefethen, "Parabolic and hyperbolic contours for computing the Bromwich integral", Mathematics
of Computation 76 (2007) 1341-1356. :mod:`robacc.statistics.quadratic_form` computes a single vector to full precision;
here the error is about 1e-10, and 100,000 poses take a fraction of a second.

The mean is E|Z| = 2 sqrt(2/pi) R_G(v_1, v_2, v_3): a Gaussian vector is a length (of mean 2 sqrt(2/pi)) times a
direction on the sphere, and Carlson's R_G (DLMF 19.16.3, 19.23.5) is the mean of sqrt(n^T V n) over directions n.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from robacc.chain import BLOCK
from robacc.geometry import Array
from robacc.statistics.distributions import normal_quantile

# Carlson's symmetric elliptic integral R_G over arrays, without SciPy, whose import takes a third of a second.
#
# Source: B. C. Carlson, "Numerical computation of real or complex elliptic integrals", Numerical Algorithms 10 (1995)
# 13-26: the duplication theorem reduces the arguments' differences, then a series; DLMF 19.36.1, 19.36.2, 19.21.10.

_CLOSE = 2e-3
"""Relative deviation of the arguments from their mean below which the series' first omitted terms are below 1e-15."""
_MAX_ROUNDS = 60


def carlson_rg(values: Array) -> Array:
    """Return R_G ``(N,)`` of ``values`` ``(3, N)``, none negative, each column ascending.

    R_G is the mean of sqrt(n^T V n) over the unit sphere for variances V.
    """
    low, middle, high = values
    result = np.zeros(values.shape[1])
    # Two zeros: R_G(0, 0, z) = sqrt(z)/2.
    single = middle <= 1e-30 * high
    result[single] = 0.5 * np.sqrt(high[single])
    x, y, z = high[~single], low[~single], middle[~single]
    # In units of the largest, against under- and overflow; z in the middle, against cancellation.
    y, z = y / x, z / x
    rf, rd = _rf_rd(np.ones_like(y), y, z)
    doubled = z * rf - (1.0 - z) * (y - z) * rd / 3.0 + np.sqrt(y / z)
    result[~single] = 0.5 * np.sqrt(x) * doubled
    return result


def _rf_rd(x: Array, y: Array, z: Array) -> tuple[Array, Array]:
    """Return R_F(x, y, z) and R_D(x, y, z) from common duplications."""
    weight, rd_sum = 1.0, np.zeros_like(x)
    for _ in range(_MAX_ROUNDS):
        mean_f, mean_d = (x + y + z) / 3.0, (x + y + 3.0 * z) / 5.0
        deviations = [np.abs(1.0 - value / mean) for mean in (mean_f, mean_d) for value in (x, y, z)]
        if x.size == 0 or float(np.max(deviations)) < _CLOSE:
            break
        a, b, c = np.sqrt(x), np.sqrt(y), np.sqrt(z)
        shift = a * b + b * c + c * a
        rd_sum += weight / (c * (z + shift))
        weight *= 0.25
        x, y, z = 0.25 * (x + shift), 0.25 * (y + shift), 0.25 * (z + shift)
    u, v = 1.0 - x / mean_f, 1.0 - y / mean_f
    w = -u - v
    e2, e3 = u * v - w * w, u * v * w
    rf = (1.0 - e2 / 10.0 + e3 / 14.0 + e2 * e2 / 24.0 - 3.0 * e2 * e3 / 44.0) / np.sqrt(mean_f)
    u, v = 1.0 - x / mean_d, 1.0 - y / mean_d
    w = -(u + v) / 3.0
    e2, e3 = u * v - 6.0 * w * w, (3.0 * u * v - 8.0 * w * w) * w
    e4, e5 = 3.0 * (u * v - w * w) * w * w, u * v * w * w * w
    series = 1.0 - 3.0 * e2 / 14.0 + e3 / 6.0 + 9.0 * e2 * e2 / 88.0 - 3.0 * e4 / 22.0 - 9.0 * e2 * e3 / 52.0
    series += 3.0 * e5 / 26.0
    return rf, 3.0 * rd_sum + weight * series / (mean_d * np.sqrt(mean_d))


# First guess of the quantile of a Gaussian vector's length: a polynomial in the shares of its variances.
#
# For variances that add up to one, the squared radius of a given probability is a smooth function of two of their
# shares. With l1 <= l2 <= l3, its arguments are a = 3 l1 and b = 2 (l2 - l1)/(1 - 3 l1), both from 0 to 1.

_DEGREE = 13
"""Degree in each argument: the guess is then within 1e-5, so that one step of Newton's leaves rounding."""


@functools.cache
def _guess_coefficients(probability: float) -> Array:
    """Return the coefficients of the polynomial that fits the exact squared radii of one probability."""
    # Chebyshev's points of the first kind, and the discrete orthogonality of the polynomials on them.
    angle = (np.arange(_DEGREE + 1) + 0.5) * np.pi / (_DEGREE + 1)
    at = 0.5 + 0.5 * np.cos(angle)
    a, b = (argument.ravel() for argument in np.meshgrid(at, at, indexing="ij"))
    low = a / 3.0
    middle = low + (1.0 - a) * b / 2.0
    shares = np.stack((low, middle, 1.0 - low - middle))
    values = _squares(probability, shares, _initial_square(probability, shares)).reshape(at.size, at.size)
    to_coefficients = 2.0 / at.size * np.cos(np.arange(at.size)[:, None] * angle)
    to_coefficients[0] *= 0.5
    result: Array = to_coefficients @ values @ to_coefficients.T
    return result


def _guess(probability: float, shares: Array) -> Array:
    """Return the guess ``(N,)`` for shares ``(3, N)``, ascending, that add up to one."""
    low, middle, _ = shares
    b = np.clip(2.0 * (middle - low) / np.maximum(1.0 - 3.0 * low, 1e-12), 0.0, 1.0)
    second = _guess_coefficients(probability) @ _chebyshev(2.0 * b - 1.0)
    result: Array = np.einsum("in,in->n", _chebyshev(6.0 * low - 1.0), second)
    return result


def _chebyshev(x: Array) -> Array:
    """Return ``(degree + 1, N)`` Chebyshev polynomials at x."""
    result = np.empty((_DEGREE + 1, x.size))
    result[0], result[1] = 1.0, x
    for i in range(2, _DEGREE + 1):
        result[i] = 2.0 * x * result[i - 1] - result[i - 2]
    return result


Contour = tuple[tuple[complex, complex], ...]
"""Nodes of a path in the upper half plane, each with its factor."""


def _path(count: int) -> Contour:
    """Return a path of so many nodes; the error falls as exp(-2 pi n/3)."""
    step = 3.0 / count
    u = (np.arange(count) + 0.5) * step
    scale = math.pi * count / 12.0
    zeta = scale * np.square(1j * u + 1.0)
    factor = step / math.pi * np.exp(zeta) * 2.0 * scale * (1j - u)
    return tuple(zip(zeta.tolist(), factor.tolist(), strict=True))


_FINE, _COARSE = _path(12), _path(6)
_MAX_NEWTON_STEPS = 30
_LAST_STEP = 1e-5
"""Step of the logarithm after which the error, the step's square, is below that of the integral."""
_COARSE_STEP = 1e-3
"""The same with half of the nodes, whose error is 3e-6."""
_RELATIVE_TOLERANCE = 1e-10
_SAMPLE = 8
"""One pose of so many gives the start of a mixture's quantile."""
_LEAST_SAMPLED = 20_000


def principal_variances(covariance: Array) -> Array:
    """Return eigenvalues ``(3, N)`` of covariances ``(3, 3, N)``, ascending, clipped at zero."""
    values = np.linalg.eigvalsh(np.moveaxis(covariance, -1, 0)).T
    result: Array = np.maximum(values, 0.0)
    return result


def _cdf_and_density(squares: Array, variances: Array, path: Contour = _FINE) -> tuple[Array, Array]:
    """Return P(Q <= q) and q times its density, ``(N,)`` each, for q = ``squares`` ``(N,)`` above zero."""
    low, middle, high = 2.0 * variances / squares
    # The product of the factors 1 + 2 v_i ζ/q is a polynomial of ζ. The first factors have the angle of the product of
    # two up to a full turn, and of three up to one and a half. Complex numbers are in parts, which is faster.
    two, pair = middle + high, middle * high
    first, second, third = two + low, pair + low * two, low * pair
    probability, density = np.zeros(squares.size), np.zeros(squares.size)
    for zeta, factor in path:
        square, cube = zeta * zeta, zeta * zeta * zeta
        x = 1.0 + zeta.real * first + square.real * second + cube.real * third
        y = zeta.imag * first + square.imag * second + cube.imag * third
        size = np.sqrt(x * x + y * y)
        larger = np.sqrt(0.5 * (size + np.abs(x)))
        smaller = 0.5 * np.abs(y) / larger
        # The root in the upper half plane; in the lower one after a full turn of the product.
        sign = np.where((y > 0.0) & (two + 2.0 * zeta.real * pair < 0.0), -1.0, 1.0) / size
        x, y = np.copysign(np.where(x >= 0.0, larger, smaller), y) * sign, np.where(x >= 0.0, smaller, larger) * sign
        density += factor.imag * x - factor.real * y
        ratio = factor / zeta
        probability += ratio.imag * x - ratio.real * y
    return probability, density


def length_quantiles(probability: float, variances: Array) -> Array:
    """Return radii ``(N,)`` of ``probability`` for variances ``(3, N)``; zero if all variances are zero.

    Args:
        probability: At least 0.5, below 1.
        variances: Variances along the principal axes.
    """
    result = np.zeros(variances.shape[1])
    for start in range(0, result.size, BLOCK):
        block = np.sort(variances[:, start : start + BLOCK], axis=0)
        power = block.sum(axis=0)
        scatter = power > 0.0
        shares, power = block[:, scatter] / power[scatter], power[scatter]
        squares = _squares(probability, shares, _guess(probability, shares))
        result[start : start + BLOCK][scatter] = np.sqrt(squares * power)
    return result


def _squares(probability: float, shares: Array, square: Array) -> Array:
    """Return squared radii ``(N,)`` of ``probability`` for variances ``(3, N)`` that add up to one, from a guess."""
    for _ in range(_MAX_NEWTON_STEPS):
        cdf, density = _cdf_and_density(square, shares)
        # Newton steps in log q; beyond the median the distribution function is concave, so they cannot diverge.
        step = np.clip((probability - cdf) / density, -1.0, 1.0)
        square = square * np.exp(step)
        if square.size == 0 or float(np.max(np.abs(step))) < _LAST_STEP:
            break
    return square


def _initial_square(probability: float, shares: Array) -> Array:
    """Return Wilson and Hilferty's cube with Satterthwaite's degrees of freedom, for variances that add up to one."""
    relative_variance = 2.0 / 9.0 * np.sum(np.square(shares), axis=0)
    guess: Array = (
        np.maximum(1.0 - relative_variance + normal_quantile(probability) * np.sqrt(relative_variance), 0.1) ** 3
    )
    return guess


def mixture_quantile(probability: float, variances: Array) -> float:
    """Return the radius of ``probability`` of the mixture of all N vectors in equal parts, variances ``(3, N)``."""
    power = variances.sum(axis=0)
    mean_power = float(np.mean(power))
    if mean_power == 0.0:
        return 0.0
    shares = variances[:, power > 0.0] / mean_power
    zero_share = 1.0 - shares.shape[1] / power.size
    square = float(np.mean(_initial_square(probability, shares / shares.sum(axis=0))))
    if shares.shape[1] >= _LEAST_SAMPLED:
        for part in (shares[:, ::_SAMPLE], shares):
            count = part.shape[1] / (1.0 - zero_share)
            square = _mixture_square(probability, part, count, zero_share, square, _COARSE, _COARSE_STEP)
    square = _mixture_square(probability, shares, float(power.size), zero_share, square, _FINE, _LAST_STEP)
    return math.sqrt(square * mean_power)


def _mixture_square(
    probability: float, shares: Array, count: float, zero_share: float, square: float, path: Contour, last_step: float
) -> float:
    """Return the squared radius of the mixture of ``count`` vectors, of which some are zero, from a start."""
    low, high = 0.0, math.inf
    for _ in range(100):
        cdf, density = zero_share, 0.0
        for start in range(0, shares.shape[1], BLOCK):
            block = shares[:, start : start + BLOCK]
            parts = _cdf_and_density(np.full(block.shape[1], square), block, path)
            cdf, density = cdf + float(parts[0].sum()) / count, density + float(parts[1].sum()) / count
        error = probability - cdf
        low, high = (square, high) if error > 0.0 else (low, square)
        next_square = square * math.exp(min(max(error / density, -1.0), 1.0)) if density > 0.0 else math.inf
        tolerance = last_step
        if not low < next_square < high:
            next_square = 2.0 * square if math.isinf(high) else 0.5 * (low + high)
            tolerance = _RELATIVE_TOLERANCE
        converged = abs(next_square - square) <= tolerance * square
        square = next_square
        if converged:
            break
    return square


def mean_lengths(variances: Array) -> Array:
    """Return E|Z| ``(N,)`` for variances ``(3, N)``, ascending."""
    return 2.0 * math.sqrt(2.0 / math.pi) * carlson_rg(variances)
