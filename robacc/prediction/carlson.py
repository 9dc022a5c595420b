"""Carlson's symmetric elliptic integral R_G over arrays, without SciPy, whose import takes a third of a second.

Source: B. C. Carlson, "Numerical computation of real or complex elliptic integrals", Numerical Algorithms 10 (1995)
13-26: the duplication theorem reduces the arguments' differences, then a series; DLMF 19.36.1, 19.36.2, 19.21.10.
"""

from __future__ import annotations

import numpy as np

from robacc.geometry import Array

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
