"""Statistics of Cartesian errors: Wu and Lee's covariances (13), (14), with intervals and tests of their assumptions.

Equation (13) assumes that the errors are independent draws from a Gaussian with zero mean. Where the data do not
contradict it (Hotelling's and Mardia's tests at 1 %), intervals are chi-square intervals. Where they do, or where
commanded poses were repeated, intervals come from resampling poses. Each interval names its method.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.assumption import interval_assumption
from robacc.accuracy.error_intervals import mean_intervals, p95_interval, percentile95, rms_interval
from robacc.errors import InputError
from robacc.geometry import Array
from robacc.statistics.covariance_intervals import ellipsoid, matrix_interval
from robacc.statistics.intervals import Interval, PoseSampling, share_below_maximum
from robacc.statistics.multivariate import assumption_tests, second_moment
from robacc.statistics.radius95 import radius95
from robacc.statistics.records import ErrorStatistics, Intervals, Statistic, Unit
from robacc.statistics.variance_components import pose_structure


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
