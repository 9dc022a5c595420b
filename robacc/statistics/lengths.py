"""Length of zero-mean Gaussian vectors: probability, quantile and mean over N covariances.

For variances v_i along the principal axes, Q = |Z|^2 has the Laplace transform M(s) = prod (1 + 2 v_i s)^(-1/2), whose
singularities lie on the negative real axis, so

    P(Q <= q) = 1/(2 pi i) int e^ζ/ζ prod (1 + 2 v_i ζ/q)^(-1/2) dζ

converges geometrically on the parabola ζ = μ (iu + 1)^2, with the same few nodes for all variances. Source of the path:
J. A. C. Weideman, L. N. Trefethen, "Parabolic and hyperbolic contours for computing the Bromwich integral", Mathematics
of Computation 76 (2007) 1341-1356. :mod:`robacc.statistics.quadratic_form` computes a single vector to full precision;
here the error is about 1e-10, and 100,000 poses take a fraction of a second.

The mean is E|Z| = (8 / pi)^(1/2) R_G(v_1, v_2, v_3), as R_G is the mean of the length of diag(v)^(1/2) u over all unit
vectors u (DLMF 19.16.3 and 19.21.10). R_F and R_D, of which R_G is composed, are by duplication: B. C. Carlson,
"Numerical computation of real or complex elliptic integrals", Numerical Algorithms 10 (1995) 13-26.
"""

from __future__ import annotations

import math

import numpy as np

from robacc.chain import BLOCK
from robacc.geometry import Array
from robacc.statistics.distributions import normal_quantile

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


_CONTOUR = _path(12)
_MAX_NEWTON_STEPS = 30
_LAST_STEP = 1e-5
"""Step of the logarithm after which the error, the step's square, is below that of the integral."""
_RELATIVE_TOLERANCE = 1e-10
_SAMPLE = 8
"""One pose of so many gives the start of a mixture's quantile."""
_THIRDS = math.pi * np.array([2.0, 4.0, 0.0]) / 3.0
_NEARLY_EQUAL = 1e-6
"""Distance of the cosine from one below which two eigenvalues are nearly equal; from it on, 12 digits are right."""
_DUPLICATIONS = 5
"""Steps of Carlson's integrals, from which the error of the series is below rounding."""


def principal_variances(covariance: Array) -> Array:
    """Return eigenvalues ``(3, N)`` of covariances ``(3, 3, N)``, ascending, clipped at zero.

    In closed form, which is many times faster: O. K. Smith, "Eigenvalues of a symmetric 3 x 3 matrix", Communications
    of the ACM 4 (1961) 168. It loses digits where two are nearly equal; these are by LAPACK.
    """
    mean = np.einsum("iin->n", covariance) / 3.0
    rest = covariance - mean * np.eye(3)[:, :, None]
    size = np.sqrt(np.einsum("ijn,ijn->n", rest, rest) / 6.0)
    (a, b, c), (_, d, e), (_, _, f) = rest / np.where(size > 0.0, size, 1.0)
    cosine = 0.5 * (a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d))
    angles = np.arccos(np.clip(cosine, -1.0, 1.0)) / 3.0 + _THIRDS[:, None]
    values = mean + 2.0 * size * np.cos(angles)
    nearly_equal = np.abs(cosine) > 1.0 - _NEARLY_EQUAL
    values[:, nearly_equal] = np.linalg.eigvalsh(np.moveaxis(covariance[..., nearly_equal], -1, 0)).T
    result: Array = np.maximum(values, 0.0)
    return result


def _cdf_and_density(squares: Array, variances: Array) -> tuple[Array, Array]:
    """Return P(Q <= q) and q times its density, ``(N,)`` each, for q = ``squares`` ``(N,)`` above zero."""
    low, middle, high = 2.0 * variances / squares
    # The product of the factors 1 + 2 v_i ζ/q is a polynomial of ζ. The first factors have the angle of the product of
    # two up to a full turn, and of three up to one and a half. Complex numbers are in parts, which is faster.
    two, pair = middle + high, middle * high
    first, second, third = two + low, pair + low * two, low * pair
    probability, density = np.zeros(squares.size), np.zeros(squares.size)
    for zeta, factor in _CONTOUR:
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
        square, shape = _initial_square(probability, shares), 0.5 / np.sum(np.square(shares), axis=0)
        for _ in range(_MAX_NEWTON_STEPS):
            cdf, density = _cdf_and_density(square, shares)
            # Newton steps in log q, with the curvature of a gamma distribution of the same variance; beyond the median
            # the distribution function is concave, so they cannot diverge.
            step = np.clip((probability - cdf) / density, -1.0, 1.0)
            square = square * np.exp(step / np.maximum(1.0 + 0.5 * step * shape * (1.0 - square), 0.5))
            if np.max(np.abs(step), initial=0.0) < _LAST_STEP:
                break
        result[start : start + BLOCK][scatter] = np.sqrt(square * power)
    return result


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
    moving = shares.shape[1] / power.size
    square = float(np.mean(_initial_square(probability, shares / shares.sum(axis=0))))
    for part in (shares[:, ::_SAMPLE], shares):
        low, high = 0.0, math.inf
        for _ in range(100):
            blocks = [part[:, start : start + BLOCK] for start in range(0, part.shape[1], BLOCK)]
            sums = [np.sum(_cdf_and_density(np.full(b.shape[1], square), b), axis=1) for b in blocks]
            cdf, density = moving / part.shape[1] * np.sum(sums, axis=0)
            error = probability - (1.0 - moving) - float(cdf)
            low, high = (square, high) if error > 0.0 else (low, square)
            following = square * math.exp(min(max(error / density, -1.0), 1.0)) if density > 0.0 else math.inf
            tolerance = _LAST_STEP
            if not low < following < high:
                following = 2.0 * square if math.isinf(high) else 0.5 * (low + high)
                tolerance = _RELATIVE_TOLERANCE
            last, square = square, following
            if abs(square - last) <= tolerance * last:
                break
    return math.sqrt(square * mean_power)


def mean_lengths(variances: Array) -> Array:
    """Return E|Z| ``(N,)`` for variances ``(3, N)``."""
    result = np.zeros(variances.shape[1])
    for start in range(0, result.size, BLOCK):
        power = variances[:, start : start + BLOCK].sum(axis=0)
        shares = np.sort(variances[:, start : start + BLOCK] / np.where(power > 0.0, power, 1.0), axis=0)
        result[start : start + BLOCK] = np.sqrt(8.0 / math.pi * power) * _complete_integral(*shares)
    return result


def _complete_integral(x: Array, z: Array, y: Array) -> Array:
    """Return Carlson's R_G of ascending numbers; with z between the others, no part of it cancels another."""
    z = np.maximum(z, 1e-30)
    middle, product, root = z, (x - z) * (z - y) / 3.0, np.sqrt(x * y / z)
    total, weight = np.zeros(x.shape), 1.0
    for _ in range(_DUPLICATIONS):
        a, b, c = np.sqrt(x), np.sqrt(y), np.sqrt(z)
        added = a * b + (a + b) * c
        total += weight / (c * (z + added))
        weight *= 0.25
        x, y, z = 0.25 * (x + added), 0.25 * (y + added), 0.25 * (z + added)
    mean = (x + y + z) / 3.0
    u, v = 1.0 - x / mean, 1.0 - y / mean
    e2, e3 = u * v - (u + v) ** 2, -u * v * (u + v)
    first = (1.0 + e2 * (e2 / 24.0 - 0.1 - 3.0 * e3 / 44.0) + e3 / 14.0) / np.sqrt(mean)
    mean = (x + y + 3.0 * z) / 5.0
    u, v = 1.0 - x / mean, 1.0 - y / mean
    w, uv = -(u + v) / 3.0, u * v
    e2, e3, e4, e5 = uv - 6.0 * w * w, (3.0 * uv - 8.0 * w * w) * w, 3.0 * (uv - w * w) * w * w, uv * w**3
    series = (
        1.0
        - 3.0 * e2 / 14.0
        + e3 / 6.0
        + 9.0 * e2 * e2 / 88.0
        - 3.0 * e4 / 22.0
        - 9.0 * e2 * e3 / 52.0
        + 3.0 * e5 / 26.0
    )
    second = 3.0 * total + weight * series / (mean * np.sqrt(mean))
    result: Array = 0.5 * (middle * first + product * second + root)
    return result
