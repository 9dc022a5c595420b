"""Intervals of the difference between two statistics of the same poses: common variation cancels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.statistics.intervals import Interval, PoseSampling, interpolated, tails
from robacc.statistics.records import Statistic

FEWEST_FOR_P95 = 20
"""With fewer poses a resample's 95th percentile is nearly its maximum, which resampling does not describe."""
_MOST_CELLS = 4_000_000
"""Numbers in an array of resamples: about 30 MB."""


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
    """Return the first statistic minus the second, and its interval over poses at each of ``confidences``.

    Differences of RMS errors (by the first-order influence of each pose) and of mean errors are studentised;
    differences of 95th percentiles are resampled over poses; differences of largest errors have no interval.

    Args:
        first: ``(3, N)`` errors, m or rad.
        second: ``(3, N)`` of the same poses, in the same order.
        statistic: Statistic of the error's length.
        confidences: Confidences of the intervals.
        groups: ``(N,)`` id of each row's commanded pose; rows of one pose are resampled together.
        draws: Number of resamples.
        seed: Seed of the resampling.
    """
    n = first.shape[1]
    index = None if groups is None else np.unique(groups, return_inverse=True)[1].astype(np.int64)
    if index is not None and index.max(initial=-1) + 1 == n:
        index = None
    first_lengths, second_lengths = (np.sqrt(np.einsum("in,in->n", errors, errors)) for errors in (first, second))
    sampling = PoseSampling(n, index, draws, seed)
    if statistic == "max":
        why = "the difference of two largest errors has no interval"
        value = float(first_lengths.max() - second_lengths.max())
        return value, tuple(Interval.missing(confidence, why) for confidence in confidences)
    if statistic == "p95":
        return _percentile_difference(first_lengths, second_lengths, sampling, confidences)
    if statistic == "mean_error":
        values = first_lengths - second_lengths
    else:
        rms = [float(np.sqrt(np.mean(np.square(lengths)))) for lengths in (first_lengths, second_lengths)]
        parts = [
            0.5 * (np.square(lengths) / size + size) if size > 0.0 else lengths
            for lengths, size in zip((first_lengths, second_lengths), rms, strict=True)
        ]
        values = parts[0] - parts[1]
    value = float(np.mean(values))
    return value, tuple(sampling.mean_interval(values, confidence, positive=False) for confidence in confidences)


def _percentile_difference(
    first: Array, second: Array, sampling: PoseSampling, confidences: Sequence[float]
) -> tuple[float, tuple[Interval, ...]]:
    value = interpolated(first, [0.95 * (sampling.n - 1)])[0] - interpolated(second, [0.95 * (sampling.n - 1)])[0]
    if np.array_equal(first, second):
        return 0.0, tuple(Interval(0.0, 0.0, 0.0, confidence, "no difference") for confidence in confidences)
    if sampling.n_groups < FEWEST_FOR_P95:
        why = f"{sampling.n_groups} poses: too few to resample a 95th percentile"
        return value, tuple(Interval.missing(confidence, why) for confidence in confidences)
    draws = min(sampling.draws, max(_MOST_CELLS // sampling.n, 200))
    limited = PoseSampling(sampling.n, sampling.groups, draws, sampling.seed)
    counts = limited.counts() if limited.groups is None else limited.counts()[:, limited.groups]
    differences = _resampled_percentile(first, counts) - _resampled_percentile(second, counts)
    method = f"bootstrap over {limited.n_groups} poses, {draws} draws"
    intervals = []
    for confidence in confidences:
        low, high, bound = interpolated(differences, [p * (differences.size - 1) for p in tails(confidence)])
        intervals.append(Interval(low, high, bound, confidence, method))
    return value, tuple(intervals)


def _resampled_percentile(lengths: Array, counts: Array) -> Array:
    """Return each resample's 95th percentile ``(draws,)``, interpolated between two lengths as the sample's is."""
    order = np.argsort(lengths, kind="stable")
    below = np.cumsum(counts[:, order], axis=1)
    last = below[:, -1] - 1.0
    rank = np.floor(0.95 * last)
    low, high = (
        lengths[order][np.argmax(below > number[:, None], axis=1)] for number in (rank, np.minimum(rank + 1.0, last))
    )
    result: Array = low + (0.95 * last - rank) * (high - low)
    return result
