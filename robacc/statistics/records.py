"""Records of error statistics and their intervals, filled by :mod:`robacc.accuracy.error_statistics`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from robacc.geometry import Array
from robacc.statistics.intervals import Interval
from robacc.statistics.multivariate import AssumptionTests
from robacc.statistics.scaled_percentile import LengthShape
from robacc.statistics.variance_components import PoseStructure

Unit = Literal["m", "rad"]
Statistic = Literal["rms", "mean_error", "p95", "max"]


@dataclass(frozen=True, slots=True)
class MatrixInterval:
    """Confidence intervals of a covariance matrix, element by element (not for all elements at once)."""

    lower: Array | None
    upper: Array | None
    """``(3, 3)`` each, m^2 or rad^2"""
    confidence: float
    method: str
    why: str | None = None


@dataclass(frozen=True, slots=True)
class Ellipsoid:
    """Principal axes of the covariance about zero, longest first."""

    axes: Array
    """``(3, 3)``, unit vectors as columns, in the frame of the errors"""
    sd: Array
    """``(3,)`` principal standard deviations, m or rad"""
    intervals: tuple[Interval, Interval, Interval]


@dataclass(frozen=True, slots=True)
class Radius:
    """Radius of the sphere about zero that contains 95 % of poses under a fitted Gaussian."""

    value: float | None
    interval: Interval
    why: str | None = None
    shape: LengthShape | None = None
    """Distribution of the lengths under that Gaussian; None without scatter."""


@dataclass(frozen=True, slots=True)
class Intervals:
    """Intervals of the numbers of the same name in :class:`ErrorStatistics`."""

    mean: tuple[Interval, Interval, Interval]
    covariance: MatrixInterval
    centred_covariance: MatrixInterval
    rms: Interval
    mean_error: Interval
    p95: Interval


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """Statistics of N position or orientation errors, in m and m^2 or rad and rad^2."""

    unit: Unit
    n: int
    n_poses: int
    """Commanded poses: fewer than ``n`` where some were repeated."""
    n_independent: float
    """Poses that intervals count: commanded poses less the share of the frames that were fitted to them."""
    confidence: float
    mean: Array
    """``(3,)``"""
    covariance: Array
    """``(3, 3)`` maximum likelihood about zero, divisor N: equation (13) or (14) of Wu and Lee"""
    centred_covariance: Array
    """``(3, 3)`` about the mean, divisor N"""
    rms: float
    """RMS of the error's length: the root of the covariance's trace. The next three are of the length too."""
    mean_error: float
    p95: float
    """95th percentile of the sample, interpolated linearly at (N - 1) p: Hyndman and Fan's type 7, numpy's default."""
    max: float
    share_below_max: float
    """Share of all poses whose error is below ``max`` with ``confidence``; ``max`` itself has no interval."""
    intervals: Intervals
    ellipsoid: Ellipsoid
    radius95_zero_mean: Radius
    """Radius of N(0, covariance)."""
    radius95_fitted_mean: Radius
    """Radius of N(mean, centred_covariance)."""
    tests: AssumptionTests
    structure: PoseStructure
    assumption: str
    """Assumptions of the intervals, and the reasons."""

    def estimate(self, statistic: Statistic) -> tuple[float, Interval]:
        """Return the value and interval of the named statistic of the error's length."""
        if statistic == "max":
            why = (
                f"the largest error of all poses has no interval: with {100 * self.confidence:g} % confidence, "
                f"{100 * self.share_below_max:.3g} % of poses are below the largest of these {self.n_poses}"
            )
            return self.max, Interval.missing(self.confidence, why)
        values = {
            "rms": (self.rms, self.intervals.rms),
            "mean_error": (self.mean_error, self.intervals.mean_error),
            "p95": (self.p95, self.intervals.p95),
        }
        return values[statistic]
