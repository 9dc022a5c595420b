"""Difference of one statistic between two results, paired by commanded pose, with interval and p-value.

A smooth statistic is a function of sums over commanded poses, so each pose has an influence on its value (F. R. Hampel,
"The influence curve and its role in robust estimation", JASA 69, 1974). If both sets have the same poses, the two
influences of a pose are subtracted before they are squared, and their common part cancels; otherwise the squares of the
two standard errors add up, with Welch and Satterthwaite's degrees of freedom. Student's t is widened on either side to
the studentised bootstrap over poses if the bootstrap is wider (P. Hall, The Bootstrap and Edgeworth Expansion, 1992).
The standard error of a percentile comes from the bootstrap.

The p-value agrees with the interval: it is below 1 - confidence exactly if the interval excludes zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.comparison.reading import ErrorSample, ErrorSet
from robacc.geometry import Array
from robacc.statistics.distributions import f_sf, normal_cdf, normal_quantile, student_quantile
from robacc.statistics.intervals import (
    FEWEST_FOR_BOOTSTRAP,
    MOST_FOR_BOOTSTRAP,
    EstimatedValue,
    Interval,
    interpolated,
    resampled_counts,
)

DRAWS = 2000
FEWEST_FOR_PERCENTILE = 30
"""With fewer poses, a single pose sets the 95th percentile, and bootstrap intervals cover less than they claim."""
_ROUNDING = 1e-13
"""A standard error below this fraction of the statistic is rounding."""


@dataclass(frozen=True, slots=True)
class Difference:
    """Statistic of the second set minus statistic of the first."""

    value: float
    interval: Interval
    """It gives the reason for a missing interval or p-value."""
    p_value: float | None = None
    """Two-sided p-value of no difference."""
    paired: bool = False
    n_poses: int | None = None
    """Commanded poses of a paired difference."""

    @classmethod
    def same(cls, value: float, confidence: float, why: str, paired: bool, n_poses: int | None) -> Difference:
        """Return a difference without uncertainty, and the reason."""
        interval = Interval(value, value, None, confidence, why)
        return cls(value, interval, float(value == 0.0), paired, n_poses)


_MOMENTS: dict[str, tuple[int, int]] = {
    "rms": (0, 2),
    "mean_error": (1, 0),
    **{f"mean_{axis}": (3 + i, 0) for i, axis in enumerate("xyz")},
    **{f"sd_{axis}": (3 + i, 6 + i) for i, axis in enumerate("xyz")},
}
"""Rows of :meth:`ErrorSample.sums` with the means m and s of a statistic, 0 for none: m, or the root of s - m^2."""
SMOOTH = tuple(_MOMENTS)
"""Statistics that are smooth functions of sums over poses."""
VECTORIAL = frozenset(name for name in SMOOTH if name not in ("rms", "mean_error"))
"""Statistics of components, which depend on the frame."""
RESAMPLED = frozenset({*SMOOTH, "p95"})
"""Statistics whose difference is computed from errors."""
NO_TEST_OF_MAXIMUM = "no test exists for the largest of all errors"


def difference(
    statistic: str, first: ErrorSample, second: ErrorSample, *, paired: bool, confidence: float = 0.95, seed: int = 0
) -> Difference:
    """Return the ``statistic`` of ``second`` minus that of ``first``.

    Args:
        statistic: A member of :data:`RESAMPLED`, or ``max``, which has no interval.
        first: Errors to compare with.
        second: Errors to compare; if ``paired``, of the same commanded poses with the same numbers.
        paired: Both samples have the same commanded poses.
        confidence: Confidence of the interval.
        seed: Seed of the resampling.
    """
    samples, sizes = (first, second), [first.n_groups, second.n_groups]
    values = [_statistic_of(statistic, sample) for sample in samples]
    value, n = values[1] - values[0], first.n_groups if paired else None
    why = None
    if statistic == "max":
        why = NO_TEST_OF_MAXIMUM
    elif min(sizes) < 2:
        why = "one commanded pose shows no scatter between poses"
    elif statistic == "p95" and min(sizes) < FEWEST_FOR_PERCENTILE:
        why = f"{min(sizes)} poses: too few to compare 95th percentiles; at least {FEWEST_FOR_PERCENTILE} are needed"
    elif statistic.startswith("sd_") and min(sizes) < FEWEST_FOR_BOOTSTRAP:
        why = f"fewer than {FEWEST_FOR_BOOTSTRAP} poses: too few to compare standard deviations"
    if why is not None:
        n = n if statistic == "p95" and min(sizes) > 1 else None
        return Difference(value, Interval.missing(confidence, why), None, paired, n)
    sums = [sample.sums() for sample in samples]
    if statistic == "p95":
        resampled = [_resampled_percentile(sample, seed, 0 if paired else i) for i, sample in enumerate(samples)]
        spreads = [resampled[1] - resampled[0]] if paired else resampled
        variances = [np.asarray(np.var(spread)) for spread in spreads]
        error = float(np.std(resampled[1] - resampled[0]))
        method = f"Student's t with the bootstrap's standard error ({resampled[0].size} draws)"
    else:
        variances = _variances([_influence(statistic, part, np.ones((1, part.shape[1])))[1] for part in sums], paired)
        error = math.sqrt(float(np.sum(variances)))
        method = "Student's t"
    if error <= _ROUNDING * max(map(abs, values)):
        return Difference.same(value, confidence, "the same at every pose", paired, n)
    terms = (float(np.sum(variance)) ** 2 / (size - 1.0) for variance, size in zip(variances, sizes, strict=False))
    dof = float(np.sum(variances)) ** 2 / sum(terms)
    below = above = t = student_quantile(0.5 + 0.5 * confidence, dof)
    if statistic != "p95" and min(sizes) >= FEWEST_FOR_BOOTSTRAP and max(sizes) <= MOST_FOR_BOOTSTRAP:
        drawn = _studentised(statistic, sums, value, paired, seed)
        low, high = interpolated(
            drawn, [tail * (drawn.size - 1) for tail in (0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence)]
        )
        # The lower limit follows from the upper quantile of t, and the upper limit from the lower quantile.
        below, above = max(t, high), max(t, -low)
        method = f"Student's t, no narrower than the studentised bootstrap ({DRAWS} draws)"
    ratio = (below if value > 0.0 else above) / t
    p_value = f_sf((value / error / ratio) ** 2, 1.0, dof)
    basis = f"over {n} poses, paired" if paired else "Welch's degrees of freedom"
    interval = Interval(value - below * error, value + above * error, None, confidence, f"{method}, {basis}")
    return Difference(value, interval, p_value, paired, n)


def _statistic_of(statistic: str, sample: ErrorSample) -> float:
    if statistic in ("p95", "max"):
        lengths = np.sqrt(np.sum(np.square(sample.vectors), axis=0))
        return interpolated(lengths, [(0.95 if statistic == "p95" else 1.0) * (lengths.size - 1)])[0]
    return float(_influence(statistic, sample.sums(), np.ones((1, sample.n_groups)))[0][0])


def _influence(statistic: str, sums: Array, counts: Array) -> tuple[Array, Array]:
    """Return a statistic of ``sums`` ``(9, G)`` over resamples ``(B,)``, and each pose's influence on it ``(B, G)``.

    ``counts`` ``(B, G)`` says how often each resample contains each pose.
    """
    first, second = _MOMENTS[statistic]
    used = sums[[0, first, second]]
    rows, mean, square = (counts @ used.T).T
    mean, square = (mean / rows if first else np.zeros_like(rows)), square / rows
    value, by_mean, by_square = mean, np.ones_like(rows), np.zeros_like(rows)
    if second:
        value = np.sqrt(np.maximum(square - mean**2, 0.0))
        by_square = 0.5 / np.maximum(value, 1e-300)
        by_mean = -2.0 * mean * by_square
    gradient = np.stack([-by_mean * mean - by_square * square, by_mean, by_square]) / rows
    return value, gradient.T @ used


def _variances(influences: list[Array], paired: bool, counts: list[Array] | None = None) -> list[Array]:
    """Return squared standard errors: a single term for paired samples, else a term for each sample."""
    terms = [influences[1] - influences[0]] if paired else influences
    weights = [np.ones(1)] * len(terms) if counts is None else counts
    variances = []
    for term, weight in zip(terms, weights, strict=False):
        size = term.shape[-1]
        variances.append(np.sum(weight * np.square(term), axis=-1) * (size / (size - 1.0)))
    return variances


def _studentised(statistic: str, sums: list[Array], value: float, paired: bool, seed: int) -> Array:
    """Return (resampled difference - difference) / standard error of the resample, ``(B,)``."""
    counts = [resampled_counts(part.shape[1], DRAWS, (seed, 0 if paired else i)) for i, part in enumerate(sums)]
    resamples = [_influence(statistic, *part) for part in zip(sums, counts, strict=True)]
    error = np.sqrt(sum(_variances([influence for _, influence in resamples], paired, counts), np.zeros(DRAWS)))
    usable = error > 0.0
    return np.asarray((resamples[1][0] - resamples[0][0] - value)[usable] / error[usable])


def _resampled_percentile(sample: ErrorSample, seed: int, stream: int) -> Array:
    """Return the 95th percentiles of resamples of poses, ``(B,)``; repetitions of a pose stay together."""
    lengths = np.sqrt(np.sum(np.square(sample.vectors), axis=0))
    order = np.argsort(lengths, kind="stable")
    lengths, groups = lengths[order], sample.groups[order]
    size = sample.n_groups
    rng = np.random.default_rng([seed, stream])
    # With many poses the percentile is nearly Gaussian, and few draws suffice for its standard error.
    draws = DRAWS if size <= MOST_FOR_BOOTSTRAP else 200
    percentiles = np.empty(draws)
    for i in range(draws):
        cumulative = np.cumsum(np.bincount(rng.integers(size, size=size), minlength=size)[groups])
        position = 0.95 * (cumulative[-1] - 1.0)
        low = int(position)
        ranks = np.searchsorted(cumulative, [low, min(low + 1, cumulative[-1] - 1)], side="right")
        percentiles[i] = lengths[ranks[0]] + (position - low) * (lengths[ranks[1]] - lengths[ranks[0]])
    return percentiles


# Difference of two numbers that have only intervals.
#
# The method of variance estimates recovery takes each limit of the difference from the distances of the limits that
# face each other (G. Y. Zou, A. Donner, "Construction of confidence limits about effect measures", Statistics in
# Medicine 27, 2008). It assumes independence, which is conservative for results on the same poses.

METHOD = "from the intervals of the two results, assumed independent (Zou and Donner)"


def from_intervals(first: EstimatedValue, second: EstimatedValue, confidence: float) -> Difference:
    """Return ``second`` minus ``first``; ``confidence`` is recorded where there is no interval."""
    value, ends = second.value - first.value, []
    for interval in (first.interval, second.interval):
        if interval is None or interval.lower is None or interval.upper is None:
            return Difference(value, Interval.missing(confidence, "the results have no interval for this figure"))
        ends.append((interval.lower, interval.upper, interval.confidence))
    (first_low, first_high, level), (second_low, second_high, second_level) = ends
    if level != second_level:
        why = f"the intervals of the results have different confidences, {level:g} and {second_level:g}"
        return Difference(value, Interval.missing(confidence, why))
    below = math.hypot(max(second.value - second_low, 0.0), max(first_high - first.value, 0.0))
    above = math.hypot(max(second_high - second.value, 0.0), max(first.value - first_low, 0.0))
    # The p-value is as if the limit that faces zero were a Gaussian's.
    distance, p_value = below if value > 0.0 else above, float(value == 0.0)
    if value != 0.0 and distance != 0.0:
        p_value = 2.0 * normal_cdf(-normal_quantile(0.5 + 0.5 * level) * abs(value) / distance)
    return Difference(value, Interval(value - below, value + above, None, level, METHOD), p_value)


# Pairing of two results by commanded pose.

_SAME_JOINT = 1e-6
"""Largest difference of equal joint commands, rad or m: below any encoder's step, above the rounding of a file."""
_SAME_POSITION = 1e-4
"""Largest distance of equal commanded positions, m, for arms or alignments that differ."""
_ENOUGH = 0.5
"""Smallest share of common poses, of either result's poses, for a paired comparison."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairing:
    """Two sets of errors as samples for :func:`robacc.comparison.differences.difference`."""

    first: ErrorSample
    second: ErrorSample
    paired: bool
    n_first: int
    """Commanded poses of the complete set."""
    n_second: int


def pair_poses(first: ErrorSet, second: ErrorSet) -> Pairing:
    """Pair the errors of common commanded poses; with too few common poses, return both complete sets unpaired."""
    sizes = first.n_groups, second.n_groups
    if (keys := _common_keys(first, second)) is not None:
        common = np.intersect1d(*keys)
        if common.size >= max(2, _ENOUGH * max(np.unique(numbers).size for numbers in keys)):
            samples = [_rows(*each, common) for each in zip((first, second), keys, strict=True)]
            return Pairing(samples[0], samples[1], True, *sizes)
    return Pairing(first, second, False, *sizes)


def _rows(errors: ErrorSet, numbers: NDArray[np.int64], common: NDArray[np.int64]) -> ErrorSample:
    """Return the errors whose pose has one of the numbers ``common``."""
    rows = np.isin(numbers, common)
    return ErrorSample(errors.vectors[:, rows], np.searchsorted(common, numbers[rows]))


def _common_keys(first: ErrorSet, second: ErrorSet) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Return numbers of commanded poses with the same meaning in both results; None if nothing relates the poses.

    Rows are matched in order if both results have the same rows; otherwise by the joints, or by ids that name the
    same positions.
    """
    same_joints = first.q is not None and second.q is not None and first.q.shape[0] == second.q.shape[0]
    # No targets are an array without axes.
    if first.groups.size == second.groups.size and np.array_equal(np.array(first.target), np.array(second.target)):
        same_files = bool(first.files) and first.files == second.files
        close = same_joints and _close(first.q, second.q, _SAME_JOINT)
        if same_files or close or _close(first.commanded, second.commanded, _SAME_POSITION):
            # A pose repeated in one result is one pose in both.
            return first.groups, first.groups
    if same_joints and first.q is not None and second.q is not None:
        return _numbers_of(np.round(first.q / _SAME_JOINT).T, np.round(second.q / _SAME_JOINT).T)
    if first.pose is not None and second.pose is not None and _same_positions(first, second):
        return _numbers_of(first.pose, second.pose)
    return None


def _close(first: Array | None, second: Array | None, tolerance: float) -> bool:
    return (
        first is not None
        and second is not None
        and first.shape == second.shape
        and bool(np.all(np.abs(first - second) <= tolerance))
    )


def _numbers_of(first: NDArray[Any], second: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return a number for each row of two arrays, the same for equal rows."""
    numbers = np.unique(np.concatenate((first, second)), axis=0, return_inverse=True)[1].ravel().astype(np.int64)
    return numbers[: len(first)], numbers[len(first) :]


def _same_positions(first: ErrorSet, second: ErrorSet) -> bool:
    """Return whether equal ids have equal commanded positions, as far as both results list positions."""
    if first.commanded is None or second.commanded is None or first.pose is None or second.pose is None:
        return True
    positions = dict(zip(first.pose.tolist(), first.commanded.T, strict=True))
    return all(
        float(np.max(np.abs(positions[name] - position))) <= _SAME_POSITION
        for name, position in zip(second.pose.tolist(), second.commanded.T, strict=True)
        if name in positions
    )
