"""First guess of the quantile of a Gaussian vector's length: a polynomial in the shares of its variances.

For variances that add up to one, the squared radius of a given probability is a smooth function of two of their shares.
With l1 <= l2 <= l3, its arguments are a = 3 l1 and b = 2 (l2 - l1)/(1 - 3 l1), both from 0 to 1.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robacc.geometry import Array

_DEGREE = 13
"""Degree in each argument: the guess is then within 1e-5, so that one step of Newton's leaves rounding."""


class QuantileGuess:
    """Polynomial of the squared radius of one probability over the shares of the variances."""

    def __init__(self, solve: Callable[[Array], Array]) -> None:
        """Fit the polynomial; ``solve`` returns the squared radii ``(N,)`` of shares ``(3, N)``, exactly."""
        # Chebyshev's points of the first kind, and the discrete orthogonality of the polynomials on them.
        angle = (np.arange(_DEGREE + 1) + 0.5) * np.pi / (_DEGREE + 1)
        at = 0.5 + 0.5 * np.cos(angle)
        a, b = (argument.ravel() for argument in np.meshgrid(at, at, indexing="ij"))
        low = a / 3.0
        middle = low + (1.0 - a) * b / 2.0
        values = solve(np.stack((low, middle, 1.0 - low - middle))).reshape(at.size, at.size)
        to_coefficients = 2.0 / at.size * np.cos(np.arange(at.size)[:, None] * angle)
        to_coefficients[0] *= 0.5
        self._coefficients = to_coefficients @ values @ to_coefficients.T

    def __call__(self, shares: Array) -> Array:
        """Return the guess ``(N,)`` for shares ``(3, N)``, ascending, that add up to one."""
        low, middle, _ = shares
        remainder = np.maximum(1.0 - 3.0 * low, 1e-12)
        b = np.clip(2.0 * (middle - low) / remainder, 0.0, 1.0)
        result: Array = np.einsum(
            "in,in->n", _chebyshev(6.0 * low - 1.0), self._coefficients @ _chebyshev(2.0 * b - 1.0)
        )
        return result


def _chebyshev(x: Array) -> Array:
    """Return ``(degree + 1, N)`` Chebyshev polynomials at x."""
    result = np.empty((_DEGREE + 1, x.size))
    result[0], result[1] = 1.0, x
    for i in range(2, _DEGREE + 1):
        result[i] = 2.0 * x * result[i - 1] - result[i - 2]
    return result
