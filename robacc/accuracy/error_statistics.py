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
from robacc.statistics.confidence_curves import PercentileCurve, Tail
from robacc.statistics.distributions import student_quantile
from robacc.statistics.intervals import (
    Interval,
    PoseSampling,
    interpolated,
    percentile_levels,
    share_below_maximum,
    tails,
)
from robacc.statistics.multivariate import AssumptionTests, assumption_tests, pose_structure, second_moment
from robacc.statistics.quadratic_form import ScaledPercentileCurve
from robacc.statistics.records import (
    PROBABILITY,
    ErrorStatistics,
    Intervals,
    Radius,
    Statistic,
    Unit,
    ellipsoid,
    matrix_interval,
    radius95,
    satterthwaite,
)

# Assumptions that intervals of errors may rely on, and whether the data contradict them.

SIGNIFICANCE = 0.01
"""Significance level: an assumption with a smaller p-value is rejected."""


@dataclass(frozen=True, slots=True)
class Assumption:
    """Assumptions that intervals may rely on."""

    shape: bool
    """The errors of the commanded poses look Gaussian."""
    zero_mean: bool
    independent: bool
    """No commanded pose was repeated."""
    text: str
    """Assumptions and rejections as a sentence."""


def interval_assumption(tests: AssumptionTests, sampling: PoseSampling) -> Assumption:
    """Return the assumptions that the tests do not reject; the text names those that could not be tested."""
    shape_p_values = [test.p_value for test in (tests.skewness, tests.kurtosis)]
    shape = all(p is None or p >= SIGNIFICANCE for p in shape_p_values)
    zero_mean_p = tests.zero_mean.p_value
    # Errors without scatter along their mean have no p-value, but such a mean is not due to chance.
    constant = zero_mean_p is None and sampling.n_groups > 3
    zero_mean = not constant if zero_mean_p is None else zero_mean_p >= SIGNIFICANCE
    rejections = []
    if not shape:
        rejections.append("the errors are not Gaussian (Mardia)")
    if not zero_mean:
        rejections.append("their mean is not zero (Hotelling)")
    independent = sampling.groups is None
    if not independent:
        rejections.append("commanded poses were repeated, and repetitions are not independent")
    untested = zero_mean_p is None or None in shape_p_values
    level = f"{100 * SIGNIFICANCE:g} %"
    if rejections:
        text = f"{'; '.join(rejections)}: intervals come from resampling, not from a Gaussian model"
    elif untested:
        text = "errors assumed Gaussian with zero mean; the poses are too few to test it"
    else:
        text = f"errors assumed Gaussian with zero mean; no test rejects it at {level}"
    return Assumption(shape, zero_mean, independent, text)


# Intervals of the mean error, the RMS and the 95th percentile, from the Gaussian model or by resampling.

_BY_SHAPE = "the sample's percentile and the shape of the fitted Gaussian, valid only if the errors are Gaussian"
FEWEST_FOR_MODEL = 10
"""Fewer poses cannot contradict a Gaussian, so no interval relies on its tail."""


def mean_intervals(
    errors: Array, centred: Array, gaussian: bool, sampling: PoseSampling, confidence: float
) -> tuple[Interval, Interval, Interval]:
    """Return intervals of the mean's components: Student's t for Gaussian errors (exact), else the bootstrap."""
    n = sampling.n_independent
    if sampling.too_few or not gaussian:
        x, y, z = (sampling.mean_interval(component, confidence, positive=False) for component in errors)
        return x, y, z
    _, above, bound = (student_quantile(p, n - 1.0) for p in tails(confidence))
    intervals = []
    for component, variance in zip(errors, np.diag(centred), strict=True):
        mean, error = float(np.mean(component)), float(np.sqrt(variance / (n - 1.0)))
        intervals.append(
            Interval(mean - above * error, mean + above * error, mean + bound * error, confidence, "Student's t")
        )
    return intervals[0], intervals[1], intervals[2]


def rms_interval(
    covariance: Array, squares: Array, zero_mean_gaussian: bool, sampling: PoseSampling, confidence: float
) -> Interval:
    """Return the interval of the RMS length of errors whose squared lengths are ``squares`` ``(N,)``."""
    if (why := sampling.too_few) is not None:
        return Interval.missing(confidence, why)
    if zero_mean_gaussian:
        interval = satterthwaite(covariance, sampling.n_independent, confidence)
        return sampling.cautious(interval, squares, confidence).root()
    return sampling.mean_interval(squares, confidence, positive=True).root()


def p95_interval(
    lengths: Array,
    assumption: Assumption,
    radius: Radius,
    sampling: PoseSampling,
    confidence: float,
) -> Interval:
    """Return the interval of the 95th percentile: order statistics if there are enough poses, else a Gaussian's shape.

    ``radius`` is that of the Gaussian about zero if the assumption says that the mean is zero, else about the mean.
    Both rest on the sample's own percentile. With few poses the Gaussian gives the shape of the distribution only, not
    its scale; see :mod:`robacc.statistics.quadratic_form`.
    """
    n = int(sampling.n_independent)
    levels = percentile_levels(n, 0.95, confidence)
    # Repetitions count as one pose, however equal they are: the levels are then wider than needed, never narrower.
    by_model = levels[1] is None and assumption.shape and n >= FEWEST_FOR_MODEL
    if not by_model and (n < FEWEST_FOR_MODEL or levels == (None, None, None)):
        return Interval.missing(confidence, f"{sampling.described}: too few for a 95th percentile")
    if by_model:
        if radius.shape is None:
            return radius.interval
        scaled = ScaledPercentileCurve.of(percentile95(lengths), n, 0.95, radius.shape)
        curve = PercentileCurve(lengths, n, 0.95, scaled, _tail(radius, lengths), by_model)
        return dataclasses.replace(scaled.interval(confidence, _BY_SHAPE), curve=curve)
    curve = PercentileCurve(lengths, n, 0.95, radius.interval.curve, _tail(radius, lengths), by_model)
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


def _tail(radius: Radius, lengths: Array) -> Tail | None:
    """Model the lengths beyond the sample: scaled to the fitted Gaussian, shaped like the sample's squares."""
    squares = np.square(lengths)
    variance = float(np.var(squares))
    if not radius.value or variance <= 0.0:
        return None
    return Tail(radius.value, 2.0 * float(np.mean(squares)) ** 2 / variance, PROBABILITY)


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
    errors = _checked(errors)
    sampling = _sampling(errors.shape[1], groups, bootstrap, seed, share)
    tests = assumption_tests(_pose_means(errors, sampling))
    assumption = interval_assumption(tests, sampling)
    zero_mean_gaussian = assumption.shape and assumption.zero_mean and assumption.independent
    gaussian = assumption.shape and assumption.independent
    mean, covariance = np.mean(errors, axis=1), second_moment(errors)
    centred = _centred(errors, mean)
    centred_covariance = second_moment(centred)
    squares = np.einsum("in,in->n", errors, errors)
    lengths = np.sqrt(squares)
    n, independent = errors.shape[1], sampling.n_independent
    about_zero = radius95(errors, np.zeros(3), covariance, zero_mean_gaussian, sampling, confidence)
    about_mean = radius95(errors, mean, centred_covariance, gaussian, sampling, confidence)
    return ErrorStatistics(
        unit=unit,
        n=n,
        n_poses=sampling.n_groups,
        n_independent=independent,
        confidence=confidence,
        mean=mean,
        covariance=covariance,
        centred_covariance=centred_covariance,
        rms=float(np.sqrt(np.trace(covariance))),
        mean_error=float(np.mean(lengths)),
        p95=percentile95(lengths),
        max=float(np.max(lengths)),
        share_below_max=share_below_maximum(independent, confidence),
        intervals=Intervals(
            mean=mean_intervals(errors, centred_covariance, gaussian, sampling, confidence),
            covariance=matrix_interval(
                errors, covariance, independent if zero_mean_gaussian else None, sampling, confidence
            ),
            centred_covariance=matrix_interval(
                centred, centred_covariance, independent - 1.0 if gaussian else None, sampling, confidence
            ),
            rms=rms_interval(covariance, squares, zero_mean_gaussian, sampling, confidence),
            mean_error=sampling.mean_interval(lengths, confidence, positive=True),
            p95=p95_interval(
                lengths, assumption, about_zero if assumption.zero_mean else about_mean, sampling, confidence
            ),
        ),
        ellipsoid=ellipsoid(errors, covariance, zero_mean_gaussian, sampling, confidence),
        radius95_zero_mean=about_zero,
        radius95_fitted_mean=about_mean,
        tests=tests,
        structure=pose_structure(errors, sampling.groups),
        assumption=assumption.text,
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
    errors = _checked(errors)
    sampling = _sampling(errors.shape[1], groups, bootstrap, seed, share)
    assumption = interval_assumption(assumption_tests(_pose_means(errors, sampling)), sampling)
    gaussian = assumption.shape and assumption.independent
    mean, covariance = np.mean(errors, axis=1), second_moment(errors)
    centred = second_moment(errors - mean[:, None])
    squares = np.einsum("in,in->n", errors, errors)
    lengths = np.sqrt(squares)

    def intervals_at(confidence: float) -> Mapping[Statistic, Interval]:
        zero_mean = gaussian and assumption.zero_mean
        if assumption.zero_mean:
            radius = radius95(errors, np.zeros(3), covariance, zero_mean, sampling, confidence)
        else:
            radius = radius95(errors, mean, centred, gaussian, sampling, confidence)
        return {
            "rms": rms_interval(covariance, squares, zero_mean, sampling, confidence),
            "mean_error": sampling.mean_interval(lengths, confidence, positive=True),
            "p95": p95_interval(lengths, assumption, radius, sampling, confidence),
        }

    return tuple(intervals_at(confidence) for confidence in confidences)


def _checked(errors: Array) -> Array:
    """Return ``errors`` as float64 after checking that they are ``(3, N)``, finite and not empty."""
    errors = np.asarray(errors, dtype=float)
    if errors.ndim != 2 or errors.shape[0] != 3:
        raise ValueError(f"errors must have the shape (3, N), not {errors.shape}")
    if errors.shape[1] == 0:
        raise InputError("there are no poses; statistics need at least one")
    finite = np.all(np.isfinite(errors), axis=0)
    if not np.all(finite):
        first = int(np.argmin(finite)) + 1
        raise InputError(f"{int(np.sum(~finite))} errors are not finite numbers; the first is that of pose {first}")
    return errors


def _centred(errors: Array, mean: Array) -> Array:
    """Subtract the mean; a component that is equal in all errors becomes exactly zero, without rounding residue."""
    centred = errors - mean[:, None]
    low, high = np.min(errors, axis=1), np.max(errors, axis=1)
    centred[high - low <= 8 * np.finfo(float).eps * np.max(np.maximum(-low, high))] = 0.0
    return centred


def _sampling(n: int, groups: NDArray[Any] | None, draws: int, seed: int, share: float) -> PoseSampling:
    """Turn group ids into indices; None where no pose was repeated, which is the faster and exact case."""
    if groups is None:
        return PoseSampling(n, None, draws, seed, share)
    groups = np.asarray(groups)
    if groups.shape != (n,):
        raise ValueError(f"groups must have the shape ({n},), not {groups.shape}")
    unique, index = np.unique(groups, return_inverse=True)
    return PoseSampling(n, None if unique.size == n else index.astype(np.int64), draws, seed, share)


def _pose_means(errors: Array, sampling: PoseSampling) -> Array:
    """Return the mean error of each commanded pose, ``(3, n_groups)``."""
    if sampling.groups is None:
        return errors
    return np.stack([sampling.sums(component) for component in errors]) / sampling.sizes()
