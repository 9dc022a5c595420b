"""The difference of one statistic between two sets of errors, with its interval and p-value.

A smooth statistic is a function of sums over commanded poses, so its value moves by each pose's own influence on it
(F. R. Hampel, "The influence curve and its role in robust estimation", JASA 69, 1974). Where both sets are of the same
poses, a pose's two influences are subtracted before they are squared, and what both share cancels; else the two
standard errors add up as squares, with Welch and Satterthwaite's degrees of freedom. Student's t is widened on either
side to the studentised bootstrap over poses where that is wider (P. Hall, The Bootstrap and Edgeworth Expansion, 1992).
A percentile's standard error is the bootstrap's own.

The p-value reads the interval the other way round: it is below 1 - confidence just where the interval leaves zero out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.statistics.distributions import f_sf, student_quantile
from robacc.statistics.intervals import FEWEST_FOR_BOOTSTRAP, MOST_FOR_BOOTSTRAP, interpolated

DRAWS = 2000
FEWEST_FOR_PERCENTILE = 30
"""Below this the 95th percentile hangs on one pose, and its bootstrap intervals hold less often than they say."""
_NIL = 1e-13
"""A standard error of this fraction of the statistic is rounding."""


@dataclass(frozen=True, slots=True)
class Difference:
    """How much greater a statistic is in the second set than in the first."""

    value: float
    lower: float | None
    upper: float | None
    confidence: float
    p_value: float | None
    """Two-sided, that there is no difference."""
    method: str
    paired: bool
    n_poses: int | None
    """Commanded poses that a paired difference is over."""
    why: str | None = None
    """Why there is no interval or no p-value."""


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSample:
    """The errors of one result, by commanded pose."""

    vectors: Array
    """``(3, N)``"""
    groups: NDArray[np.int64]
    """``(N,)`` commanded pose of each row, 0 to G - 1; paired samples number them alike."""

    @property
    def n_groups(self) -> int:
        """Commanded poses."""
        return int(self.groups.max()) + 1

    def sums(self) -> Array:
        """Of each pose's rows ``(9, G)``: number, length, its square, the components, and theirs."""
        lengths = np.sqrt(np.sum(np.square(self.vectors), axis=0))
        features = (np.ones(lengths.size), lengths, lengths**2, *self.vectors, *np.square(self.vectors))
        return np.stack([np.bincount(self.groups, weights=one, minlength=self.n_groups) for one in features])


def _rms(total: Array) -> tuple[Array, Array]:
    value = np.sqrt(total[2] / total[0])
    slope = np.zeros_like(total)
    slope[2] = 0.5 / np.maximum(value * total[0], 1e-300)
    slope[0] = -0.5 * value / total[0]
    return value, slope


def _mean(row: int) -> Callable[[Array], tuple[Array, Array]]:
    def mean(total: Array) -> tuple[Array, Array]:
        value = total[row] / total[0]
        slope = np.zeros_like(total)
        slope[row] = 1.0 / total[0]
        slope[0] = -value / total[0]
        return value, slope

    return mean


def _sd(axis: int) -> Callable[[Array], tuple[Array, Array]]:
    def deviation(total: Array) -> tuple[Array, Array]:
        mean, square = total[3 + axis] / total[0], total[6 + axis] / total[0]
        value = np.sqrt(np.maximum(square - mean**2, 0.0))
        factor = 0.5 / np.maximum(value * total[0], 1e-300)
        slope = np.zeros_like(total)
        slope[6 + axis] = factor
        slope[3 + axis] = -2.0 * mean * factor
        slope[0] = (2.0 * mean**2 - square) * factor
        return value, slope

    return deviation


SMOOTH: dict[str, Callable[[Array], tuple[Array, Array]]] = {
    "rms": _rms,
    "mean_error": _mean(1),
    **{f"mean_{axis}": _mean(3 + i) for i, axis in enumerate("xyz")},
    **{f"sd_{axis}": _sd(i) for i, axis in enumerate("xyz")},
}
"""Each takes sums ``(9, …)`` over all poses, and gives the statistic and its derivatives by them."""
VECTORIAL = frozenset(name for name in SMOOTH if name not in ("rms", "mean_error"))
"""Statistics of components, which depend on the frame."""
RESAMPLED = frozenset({*SMOOTH, "p95"})
"""Statistics whose difference is found from errors."""


def difference(
    statistic: str, first: ErrorSample, second: ErrorSample, *, paired: bool, confidence: float = 0.95, seed: int = 0
) -> Difference:
    """The ``statistic`` of ``second`` less that of ``first``.

    Args:
        statistic: One of :data:`RESAMPLED`.
        first: Errors to compare with.
        second: Errors to compare; where ``paired``, of the same commanded poses in the same numbering.
        paired: Whether they are of the same commanded poses.
        confidence: Of the interval.
        seed: Of the resampling.
    """
    if min(first.n_groups, second.n_groups) < 2:
        value = _plain(statistic, second) - _plain(statistic, first)
        why = "one commanded pose shows no scatter between poses"
        return Difference(value, None, None, confidence, None, "none", paired, None, why)
    if statistic == "p95":
        return _percentile(first, second, paired, confidence, seed)
    if statistic.startswith("sd_") and min(first.n_groups, second.n_groups) < FEWEST_FOR_BOOTSTRAP:
        value = _plain(statistic, second) - _plain(statistic, first)
        why = f"fewer than {FEWEST_FOR_BOOTSTRAP} poses: too few to tell standard deviations apart"
        return Difference(value, None, None, confidence, None, "none", paired, None, why)
    return _smooth(statistic, first, second, paired, confidence, seed)


def _plain(statistic: str, sample: ErrorSample) -> float:
    if statistic == "p95":
        lengths = np.sqrt(np.sum(np.square(sample.vectors), axis=0))
        return interpolated(lengths, [0.95 * (lengths.size - 1)])[0]
    return float(SMOOTH[statistic](sample.sums().sum(axis=1))[0])


def _smooth(
    statistic: str, first: ErrorSample, second: ErrorSample, paired: bool, confidence: float, seed: int
) -> Difference:
    parts = [_Part(SMOOTH[statistic], sample.sums()) for sample in (first, second)]
    value = parts[1].value - parts[0].value
    variances = _variances([part.influence(None)[1] for part in parts], paired)
    error = math.sqrt(float(np.sum(variances)))
    n = first.n_groups if paired else None
    if error <= _NIL * max(abs(part.value) for part in parts):
        return Difference(value, value, value, confidence, float(value == 0.0), "the same at every pose", paired, n)
    sizes = [part.sums.shape[1] for part in parts]
    dof = _degrees_of_freedom(variances, sizes)
    t = student_quantile(0.5 + 0.5 * confidence, dof)
    below = above = t
    method = "Student's t"
    if min(sizes) >= FEWEST_FOR_BOOTSTRAP and max(sizes) <= MOST_FOR_BOOTSTRAP:
        drawn = _studentised(parts, value, paired, seed)
        low, high = interpolated(
            drawn, [tail * (drawn.size - 1) for tail in (0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence)]
        )
        # The lower limit rests on the upper quantile of t, and the other way round.
        below, above = max(t, high), max(t, -low)
        method = f"Student's t, no narrower than the studentised bootstrap ({DRAWS} draws)"
    ratio = (below if value > 0.0 else above) / t
    p_value = f_sf((value / error / ratio) ** 2, 1.0, dof)
    over = f"over {n} poses, paired" if paired else "Welch's degrees of freedom"
    return Difference(
        value, value - below * error, value + above * error, confidence, p_value, f"{method}, {over}", paired, n
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """A smooth statistic of one sample."""

    statistic: Callable[[Array], tuple[Array, Array]]
    sums: Array
    """``(9, G)``"""

    @property
    def value(self) -> float:
        """Of the sample itself."""
        return float(self.statistic(self.sums.sum(axis=1))[0])

    def influence(self, counts: Array | None) -> tuple[Array, Array]:
        """Value and each pose's influence on it: of the sample, or of each resample with ``counts`` ``(B, G)``."""
        total = self.sums.sum(axis=1) if counts is None else self.sums @ counts.T
        value, slope = self.statistic(total)
        return value, slope.T @ self.sums


def _variances(influences: list[Array], paired: bool, counts: list[Array] | None = None) -> list[Array]:
    """Squared standard errors, one where the poses are the same, else one for each sample."""
    terms = [influences[1] - influences[0]] if paired else influences
    weights = [np.ones(1)] * len(terms) if counts is None else counts
    found = []
    for term, weight in zip(terms, weights, strict=False):
        size = term.shape[-1]
        found.append(np.sum(weight * np.square(term), axis=-1) * (size / (size - 1.0)))
    return found


def _degrees_of_freedom(variances: list[Array], sizes: list[int]) -> float:
    whole = float(np.sum(variances))
    return whole**2 / sum(float(one) ** 2 / (size - 1.0) for one, size in zip(variances, sizes, strict=False))


def _studentised(parts: list[_Part], value: float, paired: bool, seed: int) -> Array:
    """(resampled difference - difference) / its own standard error, ``(B,)``."""
    counts = [_counts(part.sums.shape[1], seed, 0 if paired else i) for i, part in enumerate(parts)]
    found = [part.influence(one) for part, one in zip(parts, counts, strict=True)]
    error = np.sqrt(sum(_variances([influence for _, influence in found], paired, counts), np.zeros(DRAWS)))
    usable = error > 0.0
    result: Array = (found[1][0] - found[0][0] - value)[usable] / error[usable]
    return result


@lru_cache(maxsize=8)
def _counts(size: int, seed: int, stream: int) -> Array:
    """How often each of ``size`` poses was drawn, ``(B, size)``."""
    drawn = np.random.default_rng([seed, stream]).integers(size, size=(DRAWS, size))
    drawn += size * np.arange(DRAWS)[:, None]
    return np.bincount(drawn.ravel(), minlength=DRAWS * size).reshape(DRAWS, size).astype(float)


def _percentile(first: ErrorSample, second: ErrorSample, paired: bool, confidence: float, seed: int) -> Difference:
    value = _plain("p95", second) - _plain("p95", first)
    sizes = [first.n_groups, second.n_groups]
    n = first.n_groups if paired else None
    if min(sizes) < FEWEST_FOR_PERCENTILE:
        why = f"{min(sizes)} poses: too few to tell 95th percentiles apart, which takes {FEWEST_FOR_PERCENTILE}"
        return Difference(value, None, None, confidence, None, "none", paired, n, why)
    drawn = [_resampled_percentile(sample, seed, 0 if paired else i) for i, sample in enumerate((first, second))]
    error = float(np.std(drawn[1] - drawn[0]))
    if error <= _NIL * abs(_plain("p95", first)):
        return Difference(value, value, value, confidence, float(value == 0.0), "the same at every pose", paired, n)
    dof = sizes[0] - 1.0 if paired else _degrees_of_freedom([np.asarray(np.var(one)) for one in drawn], sizes)
    reach = student_quantile(0.5 + 0.5 * confidence, dof) * error
    over = f"over {n} poses, paired" if paired else "Welch's degrees of freedom"
    method = f"Student's t with the bootstrap's standard error ({drawn[0].size} draws), {over}"
    p_value = f_sf((value / error) ** 2, 1.0, dof)
    return Difference(value, value - reach, value + reach, confidence, p_value, method, paired, n)


def _resampled_percentile(sample: ErrorSample, seed: int, stream: int) -> Array:
    """95th percentiles of samples of poses drawn anew, ``(B,)``; repetitions of a pose are drawn together."""
    lengths = np.sqrt(np.sum(np.square(sample.vectors), axis=0))
    order = np.argsort(lengths, kind="stable")
    lengths, groups = lengths[order], sample.groups[order]
    size = sample.n_groups
    rng = np.random.default_rng([seed, stream])
    # Few draws settle a standard error where there are many poses, whose percentile is all but Gaussian.
    draws = DRAWS if size <= MOST_FOR_BOOTSTRAP else 200
    found = np.empty(draws)
    for i in range(draws):
        reached = np.cumsum(np.bincount(rng.integers(size, size=size), minlength=size)[groups])
        position = 0.95 * (reached[-1] - 1.0)
        low = int(position)
        ranks = np.searchsorted(reached, [low, min(low + 1, reached[-1] - 1)], side="right")
        found[i] = lengths[ranks[0]] + (position - low) * (lengths[ranks[1]] - lengths[ranks[0]])
    return found
