"""Intervals of the difference between two figures of the same poses: what the two share cancels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.statistics.intervals import Interval, PoseSampling, interpolated, tails
from robacc.statistics.records import Statistic

FEWEST_FOR_P95 = 20
"""With fewer poses a resample's 95th percentile is all but its maximum, which resampling says nothing of."""
_MOST_CELLS = 4_000_000
"""Numbers in an array of resamples: some 30 MB."""


def paired_difference(
    first: Array,
    second: Array,
    statistic: Statistic,
    confidences: Sequence[float],
    *,
    groups: NDArray[Any] | None = None,
    draws: int = 2000,
    seed: int = 0,
) -> tuple[float, tuple[Interval, ...]]:
    """The first's figure minus the second's, and its interval over poses at each of ``confidences``.

    The difference of two RMS errors by its first-order influence of each pose, that of two means as it stands, both
    studentised; that of two 95th percentiles by resampling poses; that of two largest errors has none.

    Args:
        first: ``(3, N)`` errors, m or rad.
        second: ``(3, N)`` of the same poses, in the same order.
        statistic: Of the error's length.
        confidences: Of the intervals.
        groups: ``(N,)`` id of each row's commanded pose; rows of one pose are drawn together.
        draws: Number of resamples.
        seed: Of the resampling.
    """
    n = first.shape[1]
    index = None if groups is None else np.unique(groups, return_inverse=True)[1].astype(np.int64)
    if index is not None and index.max(initial=-1) + 1 == n:
        index = None
    one, other = (np.sqrt(np.einsum("in,in->n", errors, errors)) for errors in (first, second))
    sampling = PoseSampling(n, index, draws, seed)
    if statistic == "max":
        why = "no interval holds for the difference of two largest errors"
        value = float(one.max() - other.max())
        return value, tuple(Interval.missing(confidence, why) for confidence in confidences)
    if statistic == "p95":
        return _percentiles(one, other, sampling, confidences)
    if statistic == "mean_error":
        values = one - other
    else:
        rms = [float(np.sqrt(np.mean(np.square(lengths)))) for lengths in (one, other)]
        parts = [
            0.5 * (np.square(lengths) / size + size) if size > 0.0 else lengths
            for lengths, size in zip((one, other), rms, strict=True)
        ]
        values = parts[0] - parts[1]
    value = float(np.mean(values))
    return value, tuple(sampling.mean_interval(values, confidence, positive=False) for confidence in confidences)


def _percentiles(
    one: Array, other: Array, sampling: PoseSampling, confidences: Sequence[float]
) -> tuple[float, tuple[Interval, ...]]:
    value = interpolated(one, [0.95 * (sampling.n - 1)])[0] - interpolated(other, [0.95 * (sampling.n - 1)])[0]
    if np.array_equal(one, other):
        return 0.0, tuple(Interval(0.0, 0.0, 0.0, confidence, "no difference") for confidence in confidences)
    if sampling.n_groups < FEWEST_FOR_P95:
        why = f"{sampling.n_groups} poses: too few to resample a 95th percentile"
        return value, tuple(Interval.missing(confidence, why) for confidence in confidences)
    some = PoseSampling(
        sampling.n, sampling.groups, min(sampling.draws, max(_MOST_CELLS // sampling.n, 200)), sampling.seed
    )
    counts = some.counts() if some.groups is None else some.counts()[:, some.groups]
    drawn = _drawn_percentile(one, counts) - _drawn_percentile(other, counts)
    method = f"bootstrap over {some.n_groups} poses, {some.draws} draws"
    intervals = []
    for confidence in confidences:
        low, high, bound = interpolated(drawn, [p * (drawn.size - 1) for p in tails(confidence)])
        intervals.append(Interval(low, high, bound, confidence, method))
    return value, tuple(intervals)


def _drawn_percentile(lengths: Array, counts: Array) -> Array:
    """95th percentile of each resample ``(draws,)``: the smallest length with 95 % of the drawn rows at or below it."""
    order = np.argsort(lengths, kind="stable")
    below = np.cumsum(counts[:, order], axis=1)
    result: Array = lengths[order][np.argmax(below >= 0.95 * below[:, -1:], axis=1)]
    return result
