"""Noncentral F distribution: the probability that a test finds an effect of a given size.

Source: N. L. Johnson, S. Kotz, N. Balakrishnan, Continuous Univariate Distributions, volume 2 (1995), chapter 30: a
Poisson mixture of beta distributions; the recurrence of the incomplete beta function is NIST DLMF 8.17.20.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

from robacc.statistics.distributions import chi2_sf, f_sf

_LARGEST = 1e30
"""Largest noncentrality that is searched."""
_SUMMED = 2e4
"""Noncentrality up to which the mixture is summed. Beyond it the numerator varies by less than 1.5 %, which changes
probabilities by less than 3e-4: it counts as its mean."""


def noncentral_f_sf(x: float, dof1: float, dof2: float, noncentrality: float) -> float:
    """Return P(F > x) of the noncentral F distribution: the power of the F test with critical value ``x``.

    ``noncentrality`` is the whitened sum of squares of the effect, orthogonal to the other coefficients of the model.
    Every term is positive, so that small probabilities keep their digits too.
    """
    if x <= 0.0:
        return 1.0
    if noncentrality > _SUMMED:
        return 1.0 - chi2_sf(dof2 * (noncentrality + dof1) / (dof1 * x), dof2)
    half = 0.5 * noncentrality
    a, b = 0.5 * dof1, 0.5 * dof2
    log_y = -math.log1p(dof1 * x / dof2)
    log_x = math.log(dof1 * x / dof2) + log_y
    tail = f_sf(x, dof1, dof2)
    log_step = a * log_x + b * log_y + math.lgamma(a + b) - math.lgamma(a + 1.0) - math.lgamma(b)
    log_weight = -half
    total = math.exp(log_weight) * tail
    last = int(half + 12.0 * math.sqrt(half) + 40.0)
    for j in range(last if half > 0 else 0):
        # Each step of the mixture has two more degrees of freedom in the numerator.
        tail += math.exp(log_step)
        log_step += log_x + math.log((a + j + b) / (a + j + 1.0))
        log_weight += math.log(half / (j + 1.0))
        total += math.exp(log_weight) * min(tail, 1.0)
    return min(total, 1.0)


@lru_cache(maxsize=256)
def f_critical(tail: float, dof1: float, dof2: float) -> float:
    """Return the x with P(F > x) = ``tail``, 0 < ``tail`` < 1."""
    low, high = 0.0, 1.0
    while f_sf(high, dof1, dof2) > tail:
        low, high = high, 2.0 * high
    return _bisected(lambda x: f_sf(x, dof1, dof2) > tail, low, high)


@lru_cache(maxsize=256)
def needed_noncentrality(power: float, level: float, dof1: float, dof2: float) -> float:
    """Return the noncentrality at which the F test of ``level`` finds an effect with probability ``power``."""
    critical = f_critical(level, dof1, dof2)
    low, high = 0.0, 8.0
    while noncentral_f_sf(critical, dof1, dof2, high) < power and high < _LARGEST:
        low, high = high, 2.0 * high
    return _bisected(lambda x: noncentral_f_sf(critical, dof1, dof2, x) < power, low, high)


def _bisected(below: Callable[[float], bool], low: float, high: float) -> float:
    """Bisect, to nine digits, for the point between ``low`` and ``high`` from which ``below`` is false."""
    while high - low > 1e-9 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if below(middle) else (low, middle)
    return 0.5 * (low + high)
