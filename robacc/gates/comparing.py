"""The curve of the difference between a result's figure and a stored one's: paired where the poses are the same."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from robacc.gates.confidence import LEVELS, BoundCurve, difference
from robacc.gates.criteria import GateCriterion
from robacc.gates.lookup import GateFigure, GateSample, Missing, figure, sample
from robacc.statistics.paired import paired_difference
from robacc.statistics.records import Statistic

_SAME_PLACE = 1e-6
"""m: commanded positions that agree to this are of one command; robot files are written with more digits."""
_PAIRABLE = ("rms", "mean_error", "p95", "max")


def compared(
    document: Mapping[str, Any], baseline: Mapping[str, Any], criterion: GateCriterion
) -> tuple[GateFigure, GateFigure] | Missing:
    """The difference, result minus baseline, and the baseline's figure; what is missing where there is none."""
    own = figure(document, criterion.key, criterion.confidence)
    if isinstance(own, Missing):
        return own
    its = figure(baseline, criterion.key, criterion.confidence)
    if isinstance(its, Missing):
        return Missing(f"the baseline does not answer: {its.why}")
    if own.dimension != its.dimension:
        return Missing("the result and the baseline have different units of it")
    one, other = sample(document, criterion.key), sample(baseline, criterion.key)
    value, curve, n = own.value - its.value, None, own.n
    if one is not None and other is not None and own.statistic in _PAIRABLE:
        paired = _matched(one, other, criterion.paired)
        if isinstance(paired, Missing):
            return paired
        if paired is not None:
            seed = document.get("seed")
            value, curve, n = _paired(
                *paired, own.statistic, criterion.confidence, seed if isinstance(seed, int) else 0
            )
    elif criterion.paired:
        return Missing("paired: true takes the errors of every pose, which are not in both results")
    if curve is None and own.curve is not None and its.curve is not None:
        curve = difference(own.value, own.curve, its.value, its.curve)
    return GateFigure(value, own.dimension, curve, n, own.statistic), its


def _matched(one: GateSample, other: GateSample, paired: bool | None) -> tuple[GateSample, GateSample] | Missing | None:
    """The rows in use in both; None where the poses are not the same ones."""
    if paired is False:
        return None
    rows, left, right = np.intersect1d(one.rows, other.rows, return_indices=True)
    same = one.file is not None and one.file == other.file
    if not same and one.commanded is not None and other.commanded is not None:
        same = one.rows.size == other.rows.size and rows.size > 0
        same = same and bool(np.all(np.abs(one.commanded[:, left] - other.commanded[:, right]) < _SAME_PLACE))
    if paired and not same and one.rows.size != other.rows.size:
        return Missing(f"paired: true, but there are {one.rows.size} poses here and {other.rows.size} in the baseline")
    if not (same or paired) or rows.size == 0:
        return None
    return _rows(one, left), _rows(other, right)


def _rows(of: GateSample, chosen: Any) -> GateSample:
    commanded = None if of.commanded is None else of.commanded[:, chosen]
    return GateSample(of.errors[:, chosen], of.groups[chosen], of.rows[chosen], commanded, of.file)


def _paired(
    one: GateSample, other: GateSample, statistic: str, confidence: float, seed: int
) -> tuple[float, BoundCurve, int]:
    levels = sorted({*LEVELS, confidence, max(2.0 * confidence - 1.0, 0.01)})
    value, intervals = paired_difference(
        one.errors, other.errors, cast("Statistic", statistic), levels, groups=one.groups, seed=seed
    )
    drawn = BoundCurve.through(intervals)
    curve = BoundCurve(drawn.z, drawn.bounds, f"paired, {drawn.method}", drawn.why, drawn.exact)
    return value, curve, int(np.unique(one.groups).size)
