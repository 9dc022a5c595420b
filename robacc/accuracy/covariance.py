"""Statistics of Cartesian errors: Wu and Lee's covariances (13), (14), and beside them what the assumption hides.

Equation (13) takes the errors as independent draws of a Gaussian with zero mean. Where the data do not contradict
that (Hotelling's and Mardia's tests at 1 %), intervals are chi-square ones; where they do, or where commanded poses
were repeated, they come from resampling poses. Each interval says which.
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
from robacc.statistics.confidence import PercentileCurve, Tail
from robacc.statistics.covariance_intervals import ONE_POSE, ellipsoid, matrix_interval
from robacc.statistics.distributions import student_quantile
from robacc.statistics.intervals import (
    Interval,
    PoseSampling,
    interpolated,
    percentile_levels,
    share_below_maximum,
    tails,
)
from robacc.statistics.multivariate import AssumptionTests, assumption_tests, second_moment
from robacc.statistics.radius import PROBABILITY, radius95, satterthwaite_rms
from robacc.statistics.records import ErrorStatistics, Intervals, Radius, Statistic, Unit
from robacc.statistics.structure import pose_structure

SIGNIFICANCE = 0.01
"""Below this p-value an assumption is not relied on."""
FEWEST_FOR_MODEL = 10
"""With fewer poses nothing can be said against a Gaussian, so nothing may rest on its tail."""


@dataclass(frozen=True, slots=True)
class _Assumption:
    """What intervals may rely on."""

    shape: bool
    """The commanded poses' errors look Gaussian."""
    zero_mean: bool
    independent: bool
    """No commanded pose was repeated."""
    text: str


def error_statistics(
    errors: Array,
    unit: Unit,
    *,
    groups: NDArray[Any] | None = None,
    confidence: float = 0.95,
    bootstrap: int = 2000,
    seed: int = 0,
) -> ErrorStatistics:
    """Statistics of errors, each with its interval.

    Args:
        errors: ``(3, N)`` position errors in m or orientation errors (rotation vectors) in rad, all in one frame.
        unit: ``"m"`` or ``"rad"``.
        groups: ``(N,)`` id of each error's commanded pose, of any type; equal ids are repetitions of one pose and
            are not counted as independent. None: each error is of a pose of its own.
        confidence: Of every interval.
        bootstrap: Number of resamples where an interval needs them.
        seed: Of the resampling; the same seed gives the same limits.

    Raises:
        InputError: No error at all, or one that is not finite.
        ValueError: The shape of ``errors`` or ``groups`` is wrong.
    """
    errors = _checked(errors)
    sampling = _sampling(errors.shape[1], groups, bootstrap, seed)
    tests = assumption_tests(_pose_means(errors, sampling))
    assumption = _assumption(tests, sampling)
    zero_mean_gaussian = assumption.shape and assumption.zero_mean and assumption.independent
    gaussian = assumption.shape and assumption.independent
    mean, covariance = np.mean(errors, axis=1), second_moment(errors)
    centred = _centred(errors, mean)
    centred_covariance = second_moment(centred)
    squares = np.einsum("in,in->n", errors, errors)
    lengths = np.sqrt(squares)
    n = errors.shape[1]
    about_zero = radius95(errors, np.zeros(3), covariance, zero_mean_gaussian, sampling, confidence)
    about_mean = radius95(errors, mean, centred_covariance, gaussian, sampling, confidence)
    return ErrorStatistics(
        unit=unit,
        n=n,
        n_poses=sampling.n_groups,
        confidence=confidence,
        mean=mean,
        covariance=covariance,
        centred_covariance=centred_covariance,
        rms=float(np.sqrt(np.trace(covariance))),
        mean_error=float(np.mean(lengths)),
        p95=_p95(lengths),
        max=float(np.max(lengths)),
        share_below_max=share_below_maximum(sampling.n_groups, confidence),
        intervals=Intervals(
            mean=_mean_intervals(errors, centred_covariance, gaussian, sampling, confidence),
            covariance=matrix_interval(errors, covariance, n if zero_mean_gaussian else None, sampling, confidence),
            centred_covariance=matrix_interval(
                centred, centred_covariance, n - 1 if gaussian else None, sampling, confidence
            ),
            rms=_rms_interval(covariance, squares, zero_mean_gaussian, sampling, confidence),
            mean_error=sampling.mean_interval(lengths, confidence, positive=True),
            p95=_p95_interval(lengths, assumption, about_zero, about_mean, sampling, confidence),
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
    bootstrap: int = 2000,
    seed: int = 0,
) -> tuple[Mapping[Statistic, Interval], ...]:
    """Intervals of the error's length alone, as :func:`error_statistics` has them, at each of ``confidences``.

    Args:
        errors: ``(3, N)``, as there.
        confidences: Of the intervals; any between 0 and 1.
        groups: As there.
        bootstrap: As there.
        seed: As there.

    Raises:
        InputError: No error at all, or one that is not finite.
        ValueError: The shape of ``errors`` or ``groups`` is wrong.
    """
    errors = _checked(errors)
    sampling = _sampling(errors.shape[1], groups, bootstrap, seed)
    assumption = _assumption(assumption_tests(_pose_means(errors, sampling)), sampling)
    gaussian = assumption.shape and assumption.independent
    mean, covariance = np.mean(errors, axis=1), second_moment(errors)
    centred = second_moment(errors - mean[:, None])
    squares = np.einsum("in,in->n", errors, errors)
    lengths = np.sqrt(squares)

    def at(confidence: float) -> Mapping[Statistic, Interval]:
        zero_mean = gaussian and assumption.zero_mean
        about_zero = radius95(errors, np.zeros(3), covariance, zero_mean, sampling, confidence)
        about_mean = radius95(errors, mean, centred, gaussian, sampling, confidence)
        return {
            "rms": _rms_interval(covariance, squares, zero_mean, sampling, confidence),
            "mean_error": sampling.mean_interval(lengths, confidence, positive=True),
            "p95": _p95_interval(lengths, assumption, about_zero, about_mean, sampling, confidence),
        }

    return tuple(at(confidence) for confidence in confidences)


def _checked(errors: Array) -> Array:
    """``errors`` as float64, of the right shape, finite and not empty."""
    errors = np.asarray(errors, dtype=float)
    if errors.ndim != 2 or errors.shape[0] != 3:
        raise ValueError(f"errors must have the shape (3, N), not {errors.shape}")
    if errors.shape[1] == 0:
        raise InputError("there are no poses, and statistics take at least one")
    finite = np.all(np.isfinite(errors), axis=0)
    if not np.all(finite):
        first = int(np.argmin(finite)) + 1
        raise InputError(f"{int(np.sum(~finite))} errors are not finite numbers, the first that of pose {first}")
    return errors


def _centred(errors: Array, mean: Array) -> Array:
    """The errors about their mean; a component that is the same in all of them has no scatter, whatever rounds off."""
    centred = errors - mean[:, None]
    low, high = np.min(errors, axis=1), np.max(errors, axis=1)
    centred[high - low <= 8 * np.finfo(float).eps * np.max(np.maximum(-low, high))] = 0.0
    return centred


def _sampling(n: int, groups: NDArray[Any] | None, draws: int, seed: int) -> PoseSampling:
    """Group ids as indices; None where no pose was repeated, which is the faster and exact case."""
    if groups is None:
        return PoseSampling(n, None, draws, seed)
    groups = np.asarray(groups)
    if groups.shape != (n,):
        raise ValueError(f"groups must have the shape ({n},), not {groups.shape}")
    unique, index = np.unique(groups, return_inverse=True)
    return PoseSampling(n, None if unique.size == n else index.astype(np.int64), draws, seed)


def _pose_means(errors: Array, sampling: PoseSampling) -> Array:
    """One error for each commanded pose, ``(3, n_groups)``."""
    if sampling.groups is None:
        return errors
    return np.stack([sampling.sums(component) for component in errors]) / sampling.sizes()


def _assumption(tests: AssumptionTests, sampling: PoseSampling) -> _Assumption:
    """What the tests leave standing; a test that could not be made leaves its assumption, and the text says so."""
    of_shape = [test.p_value for test in (tests.skewness, tests.kurtosis)]
    shape = all(p is None or p >= SIGNIFICANCE for p in of_shape)
    zero_mean_p = tests.zero_mean.p_value
    # Errors that do not scatter along their mean have no p-value, but that mean is no accident.
    constant = zero_mean_p is None and sampling.n_groups > 3
    zero_mean = not constant if zero_mean_p is None else zero_mean_p >= SIGNIFICANCE
    against = []
    if not shape:
        against.append("the errors are not Gaussian (Mardia)")
    if not zero_mean:
        against.append("their mean is not zero (Hotelling)")
    independent = sampling.groups is None
    if not independent:
        against.append("commanded poses were repeated, and their repetitions are not independent")
    untested = zero_mean_p is None or None in of_shape
    if against:
        text = f"{'; '.join(against)}: intervals that equation (13)'s model would give are replaced by resampling"
    elif untested:
        text = "errors taken as Gaussian with zero mean, which so few poses cannot test"
    else:
        text = f"errors taken as Gaussian with zero mean, which no test contradicts at {100 * SIGNIFICANCE:g} %"
    return _Assumption(shape, zero_mean, independent, text)


def _mean_intervals(
    errors: Array, centred: Array, gaussian: bool, sampling: PoseSampling, confidence: float
) -> tuple[Interval, Interval, Interval]:
    """Intervals of the mean's components: Student's t, exact for Gaussian errors; else over resampled poses."""
    n = sampling.n_groups
    if n < 2 or not gaussian:
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


def _rms_interval(
    covariance: Array, squares: Array, zero_mean_gaussian: bool, sampling: PoseSampling, confidence: float
) -> Interval:
    if sampling.n_groups < 2:
        return Interval.missing(confidence, ONE_POSE)
    if zero_mean_gaussian:
        return satterthwaite_rms(covariance, sampling.n, confidence)
    return sampling.mean_interval(squares, confidence, positive=True).root()


def _p95_interval(
    lengths: Array,
    assumption: _Assumption,
    about_zero: Radius,
    about_mean: Radius,
    sampling: PoseSampling,
    confidence: float,
) -> Interval:
    """Interval of the 95th percentile: by order statistics where poses suffice, else by the fitted Gaussian."""
    n = sampling.n_groups
    levels = percentile_levels(n, 0.95, confidence)
    radius = about_zero if assumption.zero_mean else about_mean
    # Repetitions count as one pose, however alike: the levels are then wider than they need be, never narrower.
    by_model = levels[1] is None and assumption.shape and n >= FEWEST_FOR_MODEL
    if not by_model and (n < FEWEST_FOR_MODEL or levels == (None, None, None)):
        return Interval.missing(confidence, f"{n} {'pose' if n == 1 else 'poses'}: too few for a 95th percentile")
    curve = PercentileCurve(lengths, n, 0.95, radius.interval.curve, _tail(radius, lengths), by_model)
    if by_model:
        method = f"95 % radius of the fitted Gaussian, which it relies on; {radius.interval.method}"
        return dataclasses.replace(_holding(radius.interval, _p95(lengths)), method=method, curve=curve)
    # The k-th of n is at k / (n + 1) in levels and at k - 1 in positions.
    limits = iter(interpolated(lengths, [level * (sampling.n + 1) - 1.0 for level in levels if level is not None]))
    lower, upper, bound = (None if level is None else next(limits) for level in levels)
    why = None if upper is not None else f"{n} poses: too few for an upper limit without assuming a distribution"
    method = f"order statistics of {n} poses"
    if sampling.groups is not None:
        method += ", all repetitions of a pose counted as one, so the confidence is at least the one stated"
    return Interval(lower, upper, bound, confidence, method, why, curve)


def _p95(lengths: Array) -> float:
    """The 95th percentile found, linear between order statistics (Hyndman and Fan's type 7)."""
    return interpolated(lengths, [0.95 * (lengths.size - 1)])[0]


def _holding(interval: Interval, value: float) -> Interval:
    """A two-sided interval widened to hold the value found: one without it, though no less true, few would believe."""
    if interval.lower is None or interval.upper is None:
        return interval
    return dataclasses.replace(interval, lower=min(interval.lower, value), upper=max(interval.upper, value))


def _tail(radius: Radius, lengths: Array) -> Tail | None:
    """Of lengths beyond the sample: as wide as the fitted Gaussian's, and of the shape of the sample's own squares."""
    squares = np.square(lengths)
    variance = float(np.var(squares))
    if not radius.value or variance <= 0.0:
        return None
    return Tail(radius.value, 2.0 * float(np.mean(squares)) ** 2 / variance, PROBABILITY)
