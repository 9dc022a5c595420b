"""Difference of two numbers that have only intervals.

The method of variance estimates recovery takes each limit of the difference from the distances of the limits that face
each other (G. Y. Zou, A. Donner, "Construction of confidence limits about effect measures", Statistics in Medicine
27, 2008). It assumes independence, which is conservative for results on the same poses.
"""

from __future__ import annotations

import math

from robacc.comparison.compared_result import ComparedFigure
from robacc.comparison.differences import Difference
from robacc.statistics.distributions import normal_cdf, normal_quantile

METHOD = "from the intervals of the two results, assumed independent (Zou and Donner)"


def from_intervals(first: ComparedFigure, second: ComparedFigure, confidence: float) -> Difference:
    """Return ``second`` minus ``first``; ``confidence`` is recorded where there is no interval."""
    value = second.value - first.value
    limits = (first.lower, first.upper, second.lower, second.upper)
    if any(limit is None for limit in limits) or first.confidence is None or second.confidence is None:
        why = "the results have no interval for this figure"
        return Difference(value, None, None, confidence, None, "none", False, None, why)
    if first.confidence != second.confidence:
        why = f"the intervals of the results have different confidences, {first.confidence:g} and {second.confidence:g}"
        return Difference(value, None, None, confidence, None, "none", False, None, why)
    first_low, first_high, second_low, second_high = (limit or 0.0 for limit in limits)
    below = math.hypot(max(second.value - second_low, 0.0), max(first_high - first.value, 0.0))
    above = math.hypot(max(second_high - second.value, 0.0), max(first.value - first_low, 0.0))
    p_value = _p_value(value, below if value > 0.0 else above, first.confidence)
    return Difference(value, value - below, value + above, first.confidence, p_value, METHOD, False, None)


def _p_value(value: float, distance: float, confidence: float) -> float:
    """Return the p-value as if the limit that faces zero, at ``distance`` from the value, were a Gaussian's."""
    if value == 0.0 or distance == 0.0:
        return float(value == 0.0)
    return 2.0 * normal_cdf(-normal_quantile(0.5 + 0.5 * confidence) * abs(value) / distance)
