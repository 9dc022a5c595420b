"""Sums over errors from which their statistics follow, so that errors of many poses need not be held in the memory.

Every mean that has an interval is linear in the features z = (1, e, e e^T, |d|) of an error d = o + e, o near the mean.
Its standard error comes from sums of z over commanded poses or, of many poses, over groups of them by a hash of the
command, so that repetitions of a command are in one group (cluster-robust variance; K.-Y. Liang, S. L. Zeger,
"Longitudinal data analysis using generalized linear models", Biometrika 73, 1986). Third and fourth moments are in the
sum of z z^T, and quantiles come from a histogram of the lengths.
"""

from dataclasses import dataclass

import numpy as np

from robacc.geometry import Array, NDArray, vector_lengths

PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
LENGTH = np.eye(11)[-1]
"""Weights of the features whose sum is the length of the error."""
_GROUPS = 4096
"""Groups of poses: a standard error from them has a relative standard error of 1 / sqrt(2 * 4096), one per cent."""
_HASHES = 1 << 19
"""Hashes of different commands that are kept, four megabytes of them."""
_SHIFT = np.uint64(52 - 12)
"""Bits of a length that do not count in its bin: its exponent and 12 bits of its mantissa do, so a bin is a 4096th
of its length wide at most."""


def features(errors: Array, lengths: Array) -> Array:
    """Return z ``(11, N)`` of errors from the origin ``(3, N)``, and of the lengths ``(N,)`` of the errors."""
    return np.stack([np.ones(lengths.size), *errors, *(errors[i] * errors[j] for i, j in PAIRS), lengths])


def weights(origin: Array, about: Array, linear: Array | None = None, quadratic: Array | None = None) -> Array:
    """Return ``(11,)`` w with w . z = linear . f + f^T quadratic f, f = d - about the error from another point.

    ``quadratic`` ``(3, 3)`` is symmetric; what is None is zero.
    """
    shift, square = origin - about, np.zeros((3, 3)) if quadratic is None else quadratic
    slope = np.zeros(3) if linear is None else linear
    products = [square[i, j] * (1.0 if i == j else 2.0) for i, j in PAIRS]
    return np.array([(slope + square @ shift) @ shift, *(slope + 2.0 * square @ shift), *products, 0.0])


def smallest_hashes(*hashes: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return the different hashes of commands, ascending; of many commands the smallest."""
    # With counts, ``np.unique`` sorts, which takes a hundredth of the time of its table of hashes.
    return np.unique(np.concatenate(hashes), return_counts=True)[0][:_HASHES]


def count_commands(smallest: NDArray[np.uint64], n: int) -> int:
    """Return how many of the commands of n poses are different; n where the count cannot be told from it.

    Among many commands, the largest of their smallest hashes shows how close they lie, with a relative standard error
    of 1 / sqrt(k) by k hashes: Z. Bar-Yossef, T. S. Jayram, R. Kumar, D. Sivakumar, L. Trevisan, "Counting distinct
    elements in a data stream", RANDOM 2002.
    """
    if smallest.size < _HASHES:
        return int(smallest.size)
    counted = round((_HASHES - 1) * 2.0**64 / float(smallest[-1]))
    return n if counted >= n * (1.0 - 4.0 / _HASHES**0.5) else counted


@dataclass(frozen=True, slots=True)
class ErrorSums:
    """Sums over the errors of many poses."""

    origin: Array
    """``(3,)``"""
    groups: Array
    """``(G, 11)`` sums of z over groups of poses."""
    products: Array
    """``(11, 11)`` sum of z z^T."""
    bins: NDArray[np.int64]
    """``(2, B)`` numbers of the bins of the lengths, ascending, and the number of lengths in each."""
    largest: float
    """Largest length."""

    @classmethod
    def of(cls, errors: Array, origin: Array, hashes: NDArray[np.uint64]) -> "ErrorSums":
        """Return the sums over errors ``(3, N)`` of poses with these hashes ``(N,)`` of their commands."""
        length = vector_lengths(errors)
        z = features(errors - origin[:, None], length)
        numbers = (hashes % np.uint64(_GROUPS)).astype(np.int64)
        groups = [np.bincount(numbers, weights=row, minlength=_GROUPS).astype(float) for row in z]
        bins = np.stack(np.unique((length.view(np.uint64) >> _SHIFT).astype(np.int64), return_counts=True))
        return cls(origin, np.stack(groups, axis=1), z @ z.T, bins, float(length.max(initial=0.0)))

    def __add__(self, other: "ErrorSums") -> "ErrorSums":
        """Return the sums over the errors of both."""
        (numbers, counts), (others, more) = self.bins, other.bins
        merged, place = np.unique(np.concatenate((numbers, others)), return_inverse=True)
        both = np.bincount(place, np.concatenate((counts, more)), merged.size).astype(np.int64)
        return ErrorSums(
            self.origin,
            self.groups + other.groups,
            self.products + other.products,
            np.stack((merged, both)),
            max(self.largest, other.largest),
        )

    @property
    def n(self) -> int:
        """Number of poses."""
        return round(float(self.products[0, 0]))

    def above(self, length: float) -> int:
        """Return how many lengths are in bins above that of ``length``."""
        own = int(np.float64(length).view(np.uint64) >> _SHIFT)
        numbers, counts = self.bins
        return int(counts[numbers > own].sum())

    @property
    def lengths(self) -> Array:
        """Quantiles of the lengths at equal steps of the probability from 0 to 1, linear within a bin."""
        numbers, counts = self.bins
        edges = np.stack((numbers, numbers + 1)).astype(np.uint64) << _SHIFT
        below = np.concatenate(([0], np.cumsum(counts)))
        # Quantiles that stand for the lengths, at equal steps of the probability.
        probability = np.linspace(0.0, self.n, 1 << 16)
        place = np.clip(np.searchsorted(below, probability, side="right") - 1, 0, counts.size - 1)
        low, high = edges.view(np.float64)[:, place]
        share = (probability - below[place]) / counts[place]
        return np.asarray(np.minimum(low + share * (high - low), self.largest))
