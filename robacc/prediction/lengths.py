r"""The length of zero-mean Gaussian vectors, many at once: probability, quantile and mean over N covariances.

For variances v_i along the principal axes, Q = |Z|^2 has the Laplace transform M(s) = prod (1 + 2 v_i s)^(-1/2), whose
singularities lie on the negative real axis, so

    P(Q <= q) = 1/(2 pi i) int e^ζ/ζ prod (1 + 2 v_i ζ/q)^(-1/2) dζ

converges geometrically on the parabola ζ = μ (iu + 1)^2, with the same few nodes whatever the variances. Source of the
path: J. A. C. Weideman, L. N. Trefethen, "Parabolic and hyperbolic contours for computing the Bromwich integral",
Mathematics of Computation 76 (2007) 1341-1356. :mod:`robacc.statistics.quadratic_form` does one vector to the last
digit; here the error is some 1e-10, and a hundred thousand poses take a fraction of a second.

The mean is E|Z| = 2 sqrt(2/pi) R_G(v_1, v_2, v_3): a Gaussian vector is a length (of mean 2 sqrt(2/pi)) times a
direction on the sphere, and Carlson's R_G (DLMF 19.16.3, 19.23.5) is the mean of sqrt(n^T V n) over directions n.
"""

from __future__ import annotations

import math

import numpy as np

from robacc.chain import BLOCK
from robacc.geometry import Array
from robacc.prediction.carlson import carlson_rg
from robacc.statistics.distributions import normal_quantile

_NODES = 12
"""In the upper half plane; the error falls as exp(-2 pi n/3)."""
_STEP = 3.0 / _NODES
_U = (np.arange(_NODES) + 0.5) * _STEP
_MU = math.pi * _NODES / 12.0
_ZETA = _MU * np.square(1j * _U + 1.0)
_FACTOR = _STEP / math.pi * np.exp(_ZETA) * 2.0 * _MU * (1j - _U)
_NEWTON = 30
_CLOSE = 1e-10


def principal_variances(covariance: Array) -> Array:
    """Eigenvalues ``(3, N)`` of covariances ``(3, 3, N)``, ascending; rounding below zero is cut off."""
    values = np.linalg.eigvalsh(np.moveaxis(covariance, -1, 0)).T
    result: Array = np.maximum(values, 0.0)
    return result


def _cdf_and_density(q: Array, variances: Array) -> tuple[Array, Array]:
    """P(Q <= q) and q times its density, ``(N,)`` each, for ``q`` ``(N,)`` above zero."""
    scaled = variances / q
    probability, density = np.zeros(q.size), np.zeros(q.size)
    for zeta, factor in zip(_ZETA, _FACTOR, strict=True):
        # Each root on its principal branch: the product's cut would be crossed.
        transform = factor / np.prod(np.sqrt(1.0 + 2.0 * zeta * scaled), axis=0)
        probability += (transform / zeta).imag
        density += transform.imag
    return probability, density


def length_probabilities(radius: float, variances: Array) -> Array:
    """P(|Z| <= radius) ``(N,)`` for variances ``(3, N)``, each with at least one above zero; radius above zero."""
    return _cdf_and_density(np.full(variances.shape[1], radius * radius), variances)[0]


def length_quantiles(probability: float, variances: Array) -> Array:
    """``(N,)`` radii that hold ``probability``, for variances ``(3, N)``; zero where all variances are.

    Args:
        probability: At least 0.5, below 1.
        variances: Of the principal axes.
    """
    result = np.zeros(variances.shape[1])
    for start in range(0, result.size, BLOCK):
        block = variances[:, start : start + BLOCK]
        scatter = block.sum(axis=0) > 0.0
        result[start : start + BLOCK][scatter] = _quantiles(probability, block[:, scatter])
    return result


def _quantiles(probability: float, variances: Array) -> Array:
    power = variances.sum(axis=0)
    v = variances / power
    q = _first_guess(probability, v)
    for _ in range(_NEWTON):
        cdf, density = _cdf_and_density(q, v)
        # Newton on log q; beyond the median the distribution function is concave, so steps cannot run away.
        step = np.clip((probability - cdf) / density, -1.0, 1.0)
        q = q * np.exp(step)
        if q.size == 0 or float(np.max(np.abs(step))) < _CLOSE:
            break
    result: Array = np.sqrt(q * power)
    return result


def _first_guess(probability: float, shares: Array) -> Array:
    """Wilson and Hilferty's cube with Satterthwaite's degrees of freedom, for variances that add up to one."""
    spread = 2.0 / 9.0 * np.sum(np.square(shares), axis=0)
    guess: Array = np.maximum(1.0 - spread + normal_quantile(probability) * np.sqrt(spread), 0.1) ** 3
    return guess


def mixture_quantile(probability: float, variances: Array) -> float:
    """The radius that holds ``probability`` of the mixture of all N vectors in equal parts, ``(3, N)`` variances."""
    power = variances.sum(axis=0)
    total = float(np.mean(power))
    if total == 0.0:
        return 0.0
    shares = variances[:, power > 0.0] / total
    exact = 1.0 - shares.shape[1] / power.size
    q = float(np.mean(_first_guess(probability, shares / shares.sum(axis=0))))
    low, high = 0.0, math.inf
    for _ in range(100):
        cdf, density = _mixture(q, shares, power.size, exact)
        error = probability - cdf
        low, high = (q, high) if error > 0.0 else (low, q)
        following = q * math.exp(min(max(error / density, -1.0), 1.0)) if density > 0.0 else math.inf
        if not low < following < high:
            following = 2.0 * q if math.isinf(high) else 0.5 * (low + high)
        done = abs(following - q) <= _CLOSE * q
        q = following
        if done:
            break
    return math.sqrt(q * total)


def _mixture(q: float, shares: Array, count: int, exact: float) -> tuple[float, float]:
    cdf, density = 0.0, 0.0
    for start in range(0, shares.shape[1], BLOCK):
        block = shares[:, start : start + BLOCK]
        first, second = _cdf_and_density(np.full(block.shape[1], q), block)
        cdf, density = cdf + float(first.sum()), density + float(second.sum())
    return exact + cdf / count, density / count


def mean_lengths(variances: Array) -> Array:
    """E|Z| ``(N,)`` for variances ``(3, N)``, ascending."""
    return 2.0 * math.sqrt(2.0 / math.pi) * carlson_rg(variances)
