"""Statistics of Cartesian errors: Wu and Lee's covariances (13), (14), with intervals and tests of assumptions.

Equation (13) assumes that the errors are independent draws from a Gaussian with zero mean. Where the data do not
contradict it (Hotelling's and Mardia's tests at 1 %), intervals are chi-square intervals. Where they do, or where
commanded poses were repeated, intervals come from resampling poses. Each interval names its method.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError
from robacc.geometry import Array
from robacc.statistics.confidence_curves import PercentileCurve
from robacc.statistics.intervals import (
    EstimateOrReason,
    Interval,
    PoseSampling,
    interpolated,
    percentile_levels,
    student_interval,
)
from robacc.statistics.multivariate import AssumptionTests, assumption_tests, pose_structure, second_moment
from robacc.statistics.quadratic_form import LengthShape, ScaledPercentileCurve
from robacc.statistics.records import (
    ErrorStatistics,
    Intervals,
    Statistic,
    Unit,
    ellipsoid,
    matrix_interval,
    radius95,
    satterthwaite,
)

SIGNIFICANCE = 0.01
"""Significance level: an assumption with a smaller p-value is rejected."""
FEWEST_FOR_MODEL = 10
"""Fewer poses cannot contradict a Gaussian, so no interval relies on its tail."""
_BY_SHAPE = "the sample's percentile and the shape of the fitted Gaussian, valid only if the errors are Gaussian"


@dataclass(frozen=True)
class _ErrorSample:
    """Errors, their sampling and moments, and the assumptions that their intervals rely on."""

    errors: Array
    """``(3, N)``"""
    sampling: PoseSampling
    tests: AssumptionTests
    gaussian: bool
    """The errors of the commanded poses look Gaussian, and no commanded pose was repeated."""
    shape: bool
    """The errors of the commanded poses look Gaussian."""
    zero_mean: bool
    text: str
    """Assumptions and rejections as a sentence."""
    mean: Array
    covariance: Array
    """About zero."""
    centred: Array
    """``(3, N)`` errors about their mean."""
    centred_covariance: Array
    lengths: Array
    """``(N,)``"""

    @classmethod
    def of(cls, errors: Array, groups: NDArray[Any] | None, share: float, draws: int, seed: int) -> _ErrorSample:
        """Check the errors and their groups, and test the assumptions; the text names those that cannot be tested."""
        errors = np.asarray(errors, dtype=float)
        if errors.ndim != 2 or errors.shape[0] != 3:
            raise ValueError(f"errors must have the shape (3, N), not {errors.shape}")
        if (n := errors.shape[1]) == 0:
            raise InputError("there are no poses; statistics need at least one")
        finite = np.all(np.isfinite(errors), axis=0)
        if not np.all(finite):
            first = int(np.argmin(finite)) + 1
            raise InputError(f"{int(np.sum(~finite))} errors are not finite numbers; the first is that of pose {first}")
        if groups is not None:
            if np.shape(groups) != (n,):
                raise ValueError(f"groups must have the shape ({n},), not {np.shape(groups)}")
            unique, index = np.unique(groups, return_inverse=True)
            # Without repetitions: the faster and exact case.
            groups = None if unique.size == n else index.astype(np.int64)
        sampling = PoseSampling(n, groups, draws, seed, share)
        means = errors if groups is None else np.stack([sampling.sums(part) for part in errors]) / sampling.sizes
        tests = assumption_tests(means)
        shape_p_values = [test.p_value for test in (tests.skewness, tests.kurtosis)]
        shape = all(p is None or p >= SIGNIFICANCE for p in shape_p_values)
        zero_mean_p = tests.zero_mean.p_value
        # Errors without scatter along their mean have no p-value, but such a mean is not due to chance.
        zero_mean = sampling.n_groups <= 3 if zero_mean_p is None else zero_mean_p >= SIGNIFICANCE
        repeated = "commanded poses were repeated, and repetitions are not independent"
        rejections = [
            text
            for holds, text in (
                (shape, "the errors are not Gaussian (Mardia)"),
                (zero_mean, "their mean is not zero (Hotelling)"),
                (groups is None, repeated),
            )
            if not holds
        ]
        text = f"errors assumed Gaussian with zero mean; no test rejects it at {100 * SIGNIFICANCE:g} %"
        if rejections:
            text = f"{'; '.join(rejections)}: intervals come from resampling, not from a Gaussian model"
        elif zero_mean_p is None or None in shape_p_values:
            text = "errors assumed Gaussian with zero mean; the poses are too few to test it"
        mean = np.mean(errors, axis=1)
        centred = errors - mean[:, None]
        # A component that is equal in all errors becomes exactly zero, without rounding residue.
        low, high = np.min(errors, axis=1), np.max(errors, axis=1)
        centred[high - low <= 8 * np.finfo(float).eps * np.max(np.maximum(-low, high))] = 0.0
        lengths = np.sqrt(np.einsum("in,in->n", errors, errors))
        moments = mean, second_moment(errors), centred, second_moment(centred)
        return cls(errors, sampling, tests, shape and groups is None, shape, zero_mean, text, *moments, lengths)

    def radius95(self, about_zero: bool, confidence: float) -> tuple[EstimateOrReason, LengthShape | None]:
        """Return the radius of the Gaussian about zero or about the mean, and the shape of its lengths."""
        if about_zero:
            gaussian = self.gaussian and self.zero_mean
            return radius95(self.errors, np.zeros(3), self.covariance, gaussian, self.sampling, confidence)
        return radius95(self.errors, self.mean, self.centred_covariance, self.gaussian, self.sampling, confidence)

    def mean_intervals(self, confidence: float) -> tuple[Interval, Interval, Interval]:
        """Return intervals of the mean's components: Student's t for Gaussian errors (exact), else the bootstrap."""
        n = self.sampling.n_independent
        if self.sampling.too_few or not self.gaussian:
            x, y, z = (self.sampling.mean_interval(part, confidence, positive=False) for part in self.errors)
            return x, y, z
        errors = np.sqrt(np.diag(self.centred_covariance) / (n - 1.0))
        x, y, z = (
            student_interval(*part, n - 1.0, confidence)
            for part in zip(self.mean.tolist(), errors.tolist(), strict=True)
        )
        return x, y, z

    def length_intervals(
        self, radius: EstimateOrReason, shape: LengthShape | None, confidence: float
    ) -> dict[Statistic, Interval]:
        """Return the intervals of RMS, mean and 95th percentile of the length.

        ``radius`` and ``shape`` are those of the Gaussian about zero if its mean is assumed to be zero, else about the
        mean.
        """
        sampling, squares = self.sampling, np.square(self.lengths)
        if (why := sampling.too_few) is not None:
            rms = Interval.missing(confidence, why)
        elif self.gaussian and self.zero_mean:
            rms = satterthwaite(self.covariance, sampling.n_independent, confidence)
            rms = sampling.cautious(rms, squares, confidence).root()
        else:
            rms = sampling.mean_interval(squares, confidence, positive=True).root()
        return {
            "rms": rms,
            "mean_error": sampling.mean_interval(self.lengths, confidence, positive=True),
            "p95": self._p95_interval(radius, shape, confidence),
        }

    def _p95_interval(self, radius: EstimateOrReason, shape: LengthShape | None, confidence: float) -> Interval:
        """Return the interval of the 95th percentile: order statistics if there are enough poses, else by the shape.

        Both rest on the sample's own percentile. With few poses the Gaussian gives the shape of the distribution only,
        not its scale; see :mod:`robacc.statistics.quadratic_form`.
        """
        sampling, lengths = self.sampling, self.lengths
        n = int(sampling.n_independent)
        levels = percentile_levels(n, 0.95, confidence)
        # Repetitions count as one pose, however equal they are: the levels are then wider than needed, never narrower.
        by_model = levels[1] is None and self.shape and n >= FEWEST_FOR_MODEL
        if not by_model and (n < FEWEST_FOR_MODEL or levels == (None, None, None)):
            return Interval.missing(confidence, f"{sampling.described}: too few for a 95th percentile")
        if by_model and shape is None:
            return radius.interval
        # Lengths beyond the sample: scaled to the fitted Gaussian, shaped like the sample's squares.
        variance = float(np.var(np.square(lengths)))
        dof = 2.0 * float(np.mean(np.square(lengths))) ** 2 / variance if variance > 0.0 else None
        curve = PercentileCurve(lengths, n, 0.95, radius.interval.curve, radius.value, dof, by_model)
        if by_model and shape is not None:
            scaled = ScaledPercentileCurve.of(percentile95(lengths), n, 0.95, shape)
            return dataclasses.replace(
                scaled.interval(confidence, _BY_SHAPE), curve=dataclasses.replace(curve, model=scaled)
            )
        # The k-th of n is at k / (n + 1) in levels and at k - 1 in positions.
        limits = iter(interpolated(lengths, [level * (sampling.n + 1) - 1.0 for level in levels if level is not None]))
        lower, upper, bound = (None if level is None else next(limits) for level in levels)
        too_few = f"{sampling.described}: too few for an upper limit without assuming a distribution"
        method = f"order statistics of {sampling.described}"
        if sampling.groups is not None:
            method += "; all repetitions of a pose count as one, so the confidence is at least the stated one"
        return Interval(lower, upper, bound, confidence, method, too_few if upper is None else None, curve)


def percentile95(lengths: Array) -> float:
    """Return the sample's 95th percentile, linear between order statistics (Hyndman and Fan's type 7)."""
    return interpolated(lengths, [0.95 * (lengths.size - 1)])[0]


def error_statistics(
    errors: Array,
    unit: Unit,
    *,
    groups: NDArray[Any] | None = None,
    share: float = 1.0,
    confidence: float = 0.95,
    bootstrap: int = 2000,
    seed: int = 0,
) -> ErrorStatistics:
    """Return the statistics of errors, each with its interval.

    Args:
        errors: ``(3, N)`` position errors in m or orientation errors (rotation vectors) in rad, all in one frame.
        unit: ``"m"`` or ``"rad"``.
        groups: ``(N,)`` id of each error's commanded pose, of any type; equal ids are repetitions of one pose and
            do not count as independent. None: no pose was repeated.
        share: Degrees of freedom that fitted frames leave, as a share of the measured components.
        confidence: Confidence of every interval.
        bootstrap: Number of resamples where an interval needs them.
        seed: Seed of the resampling; the same seed gives the same limits.

    Raises:
        InputError: There are no errors, or some are not finite.
        ValueError: The shape of ``errors`` or ``groups`` is wrong.
    """
    sample = _ErrorSample.of(errors, groups, share, bootstrap, seed)
    sampling, n = sample.sampling, sample.sampling.n_independent
    dof = n if sample.gaussian and sample.zero_mean else None
    dof_centred = n - 1.0 if sample.gaussian else None
    about_zero, about_mean = (sample.radius95(zero, confidence) for zero in (True, False))
    by_length = sample.length_intervals(*(about_zero if sample.zero_mean else about_mean), confidence)
    return ErrorStatistics(
        unit=unit,
        n=sampling.n,
        n_poses=sampling.n_groups,
        n_independent=n,
        confidence=confidence,
        mean=sample.mean,
        covariance=sample.covariance,
        centred_covariance=sample.centred_covariance,
        rms=float(np.sqrt(np.trace(sample.covariance))),
        mean_error=float(np.mean(sample.lengths)),
        p95=percentile95(sample.lengths),
        max=float(np.max(sample.lengths)),
        share_below_max=(1.0 - confidence) ** (1.0 / n),  # Wilks, as for a gate's largest error
        intervals=Intervals(
            sample.mean_intervals(confidence),
            matrix_interval(sample.errors, sample.covariance, dof, sampling, confidence),
            matrix_interval(sample.centred, sample.centred_covariance, dof_centred, sampling, confidence),
            by_length["rms"],
            by_length["mean_error"],
            by_length["p95"],
        ),
        ellipsoid=ellipsoid(sample.errors, sample.covariance, dof is not None, sampling, confidence),
        radius95_zero_mean=about_zero[0],
        radius95_fitted_mean=about_mean[0],
        tests=sample.tests,
        structure=pose_structure(sample.errors, sampling.groups),
        assumption=sample.text,
    )


def length_intervals(
    errors: Array,
    confidences: Sequence[float],
    *,
    groups: NDArray[Any] | None = None,
    share: float = 1.0,
    bootstrap: int = 2000,
    seed: int = 0,
) -> tuple[Mapping[Statistic, Interval], ...]:
    """Return the intervals of the error's length alone, at each of ``confidences``.

    They are those of :func:`error_statistics`.

    Args:
        errors: ``(3, N)``, as in :func:`error_statistics`.
        confidences: Confidences of the intervals, between 0 and 1.
        groups: As in :func:`error_statistics`.
        share: As in :func:`error_statistics`.
        bootstrap: As in :func:`error_statistics`.
        seed: As in :func:`error_statistics`.

    Raises:
        InputError: There are no errors, or some are not finite.
        ValueError: The shape of ``errors`` or ``groups`` is wrong.
    """
    sample = _ErrorSample.of(errors, groups, share, bootstrap, seed)
    return tuple(
        sample.length_intervals(*sample.radius95(sample.zero_mean, confidence), confidence)
        for confidence in confidences
    )
