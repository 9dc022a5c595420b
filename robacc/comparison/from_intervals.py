"""The difference of two numbers of which nothing is known but their intervals.

The method of variance estimates recovery: either limit of the difference from the distances of the limits that face
each other (G. Y. Zou, A. Donner, "Construction of confidence limits about effect measures", Statistics in Medicine
27, 2008). It takes the two as independent, which for results on the same poses is cautious.
"""

from __future__ import annotations

import math

from robacc.comparison.compared_result import ComparedFigure
from robacc.comparison.differences import Difference
from robacc.statistics.distributions import normal_cdf, normal_quantile

METHOD = "from the results' own intervals, taken as independent (Zou and Donner)"


def from_intervals(first: ComparedFigure, second: ComparedFigure, confidence: float) -> Difference:
    """``second`` less ``first``; ``confidence`` is what a difference without an interval is said to lack one of."""
    value = second.value - first.value
    limits = (first.lower, first.upper, second.lower, second.upper)
    if any(limit is None for limit in limits) or first.confidence is None or second.confidence is None:
        why = "the results carry no interval of it"
        return Difference(value, None, None, confidence, None, "none", False, None, why)
    if first.confidence != second.confidence:
        why = f"the results' intervals are of different confidences, {first.confidence:g} and {second.confidence:g}"
        return Difference(value, None, None, confidence, None, "none", False, None, why)
    low_a, high_a, low_b, high_b = (limit or 0.0 for limit in limits)
    below = math.hypot(max(second.value - low_b, 0.0), max(high_a - first.value, 0.0))
    above = math.hypot(max(high_b - second.value, 0.0), max(first.value - low_a, 0.0))
    p_value = _p_value(value, below if value > 0.0 else above, first.confidence)
    return Difference(value, value - below, value + above, first.confidence, p_value, METHOD, False, None)


def _p_value(value: float, reach: float, confidence: float) -> float:
    """As if the limit that faces zero were a Gaussian's."""
    if value == 0.0 or reach == 0.0:
        return float(value == 0.0)
    return 2.0 * normal_cdf(-normal_quantile(0.5 + 0.5 * confidence) * abs(value) / reach)
