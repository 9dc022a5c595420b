"""Orders of a periodic joint error that measured poses support."""

from __future__ import annotations

import math

import numpy as np

from robacc.geometry import Array

ONE_TURN = 2.1 * math.pi
"""rad: range of a joint that counts as one turn at most."""
SAME_ORDER = 0.5
"""Difference of two orders, identified on different poses, below which they are the same harmonic."""
ORDER_STEP = 0.25
"""Periods per turn between orders that are tried; the best is then improved off this grid."""
HIGHEST_ORDER = 40.0
_FEWEST = 8
"""Different angles that an order needs at least."""
_CLOSEST = 0.1
"""Quantile of the gaps between angles that sets the highest order they support."""


def supported_orders(angle: Array) -> Array:
    """Return the orders between one period over the range of angles and the limit that the spacing of poses sets.

    Randomly spaced angles have no Nyquist order; the limit is that of the closest tenth of the gaps.
    """
    values = np.unique(np.round(angle, 6))
    if values.size < _FEWEST:
        return np.zeros(0)
    reach = float(values[-1] - values[0])
    gap = float(np.quantile(np.diff(values), _CLOSEST))
    highest = min(HIGHEST_ORDER, np.pi / max(gap, 1e-6))
    lowest = max(ORDER_STEP, np.pi / reach)
    first = math.ceil(lowest / ORDER_STEP) * ORDER_STEP
    return np.arange(first, highest + 1e-9, ORDER_STEP)
