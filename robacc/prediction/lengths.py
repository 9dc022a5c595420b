r"""Length of zero-mean Gaussian vectors: probability, quantile and mean over N covariances at once.

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
from robacc.prediction.carlson import carlson_rg
from robacc.prediction.length_guess import QuantileGuess
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
    probability, density = np.zeros(squares.size), np.zeros(squares.size)
    for zeta, factor in path:
        # Each factor is in the upper half plane, and so is the product of the principal roots of two of them. Complex
        # numbers are in parts: NumPy's complex root takes four times as long.
        ax, ay, bx, by = 1.0 + zeta.real * low, zeta.imag * low, 1.0 + zeta.real * middle, zeta.imag * middle
        ax, ay = _upper_root(ax * bx - ay * by, ax * by + ay * bx)
        bx, by = _upper_root(1.0 + zeta.real * high, zeta.imag * high)
        x, y = ax * bx - ay * by, ax * by + ay * bx
        square = x * x + y * y
        x /= square
        y /= square
        density += factor.imag * x - factor.real * y
        ratio = factor / zeta
        probability += ratio.imag * x - ratio.real * y
    return probability, density


def _upper_root(x: Array, y: Array) -> tuple[Array, Array]:
    """Return the real and the imaginary part of the root of x + iy in the upper half plane."""
    larger = np.sqrt(0.5 * (np.sqrt(x * x + y * y) + np.abs(x)))
    smaller = 0.5 * y / larger
    is_right = x >= 0.0
    return np.where(is_right, np.copysign(larger, y), smaller), np.where(is_right, np.abs(smaller), larger)


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
        squares = _squares(probability, shares, _guess(probability)(shares))
        result[start : start + BLOCK][scatter] = np.sqrt(squares * power)
    return result


@functools.cache
def _guess(probability: float) -> QuantileGuess:
    return QuantileGuess(lambda shares: _squares(probability, shares, _initial_square(probability, shares)))


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
        cdf, density = _mixture_cdf_and_density(square, shares, count, zero_share, path)
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


def _mixture_cdf_and_density(
    square: float, shares: Array, count: float, zero_share: float, path: Contour
) -> tuple[float, float]:
    cdf, density = 0.0, 0.0
    for start in range(0, shares.shape[1], BLOCK):
        block = shares[:, start : start + BLOCK]
        cdf_block, density_block = _cdf_and_density(np.full(block.shape[1], square), block, path)
        cdf, density = cdf + float(cdf_block.sum()), density + float(density_block.sum())
    return zero_share + cdf / count, density / count


def mean_lengths(variances: Array) -> Array:
    """Return E|Z| ``(N,)`` for variances ``(3, N)``, ascending."""
    return 2.0 * math.sqrt(2.0 / math.pi) * carlson_rg(variances)
