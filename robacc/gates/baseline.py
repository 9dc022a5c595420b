"""Difference between a figure of a result and the same figure of a baseline: paired where the poses are the same."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from robacc.gates.bound_curve import LEVELS, BoundCurve, difference_curve
from robacc.gates.criteria import GateCriterion
from robacc.gates.lookup import GateFigure, GateSample, Missing, figure_at, sample_at
from robacc.statistics.paired_difference import paired_difference
from robacc.statistics.records import Statistic

_SAME_POSITION = 1e-6
"""m: commanded positions within this distance belong to the same command; robot files have more digits than that."""
_PAIRABLE = ("rms", "mean_error", "p95", "max")


def difference_to_baseline(
    document: Mapping[str, Any], baseline: Mapping[str, Any], criterion: GateCriterion
) -> tuple[GateFigure, GateFigure] | Missing:
    """Return the difference, result minus baseline, and the baseline's figure, or the reason why there is none."""
    figure = figure_at(document, criterion.key, criterion.confidence)
    if isinstance(figure, Missing):
        return figure
    reference = figure_at(baseline, criterion.key, criterion.confidence)
    if isinstance(reference, Missing):
        return Missing(f"in the baseline, {reference.why}")
    if figure.dimension != reference.dimension:
        return Missing(f"{criterion.key} has different units in the result and in the baseline")
    sample, reference_sample = sample_at(document, criterion.key), sample_at(baseline, criterion.key)
    value, curve, n = figure.value - reference.value, None, figure.n
    if sample is not None and reference_sample is not None and figure.statistic in _PAIRABLE:
        pair = _matching_rows(sample, reference_sample, criterion.paired)
        if isinstance(pair, Missing):
            return pair
        if pair is not None:
            seed = document.get("seed")
            value, curve, n = _paired_figure(
                *pair, figure.statistic, criterion.confidence, seed if isinstance(seed, int) else 0
            )
    elif criterion.paired:
        return Missing("paired: true needs the error of every pose, which the result or the baseline does not list")
    if curve is None and figure.curve is not None and reference.curve is not None:
        curve = difference_curve(figure.value, figure.curve, reference.value, reference.curve)
    return GateFigure(value, figure.dimension, curve, n, figure.statistic), reference


def _matching_rows(
    sample: GateSample, reference: GateSample, paired: bool | None
) -> tuple[GateSample, GateSample] | Missing | None:
    """Return the rows in use that the two samples share; None if their poses differ."""
    if paired is False:
        return None
    rows, in_sample, in_reference = np.intersect1d(sample.rows, reference.rows, return_indices=True)
    same_size = sample.rows.size == reference.rows.size
    same_poses = sample.file is not None and sample.file == reference.file
    if not same_poses and sample.commanded is not None and reference.commanded is not None:
        distance = np.abs(sample.commanded[:, in_sample] - reference.commanded[:, in_reference])
        same_poses = same_size and rows.size > 0 and bool(np.all(distance < _SAME_POSITION))
    if paired and not same_poses and not same_size:
        return Missing(
            f"paired: true needs the same poses, but the result has {sample.rows.size} and the baseline has "
            f"{reference.rows.size}"
        )
    if not (same_poses or paired) or rows.size == 0:
        return None
    return _subset(sample, in_sample), _subset(reference, in_reference)


def _subset(sample: GateSample, rows: NDArray[np.intp]) -> GateSample:
    commanded = None if sample.commanded is None else sample.commanded[:, rows]
    return GateSample(sample.errors[:, rows], sample.groups[rows], sample.rows[rows], commanded, sample.file)


def _paired_figure(
    sample: GateSample, reference: GateSample, statistic: str, confidence: float, seed: int
) -> tuple[float, BoundCurve, int]:
    levels = sorted({*LEVELS, confidence, max(2.0 * confidence - 1.0, 0.01)})
    value, intervals = paired_difference(
        sample.errors, reference.errors, cast("Statistic", statistic), levels, groups=sample.groups, seed=seed
    )
    through = BoundCurve.through(intervals)
    curve = BoundCurve(through.z, through.bounds, f"paired, {through.method}", through.why, through.exact)
    return value, curve, int(np.unique(sample.groups).size)
