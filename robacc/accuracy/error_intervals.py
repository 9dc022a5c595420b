"""Intervals of the mean error, the RMS and the 95th percentile, from the Gaussian model or by resampling."""

from __future__ import annotations

import dataclasses

import numpy as np

from robacc.accuracy.assumption import Assumption
from robacc.geometry import Array
from robacc.statistics.confidence_curves import PercentileCurve, Tail
from robacc.statistics.distributions import student_quantile
from robacc.statistics.intervals import Interval, PoseSampling, interpolated, percentile_levels, tails
from robacc.statistics.radius95 import PROBABILITY, satterthwaite
from robacc.statistics.records import Radius
from robacc.statistics.scaled_percentile import ScaledPercentileCurve

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
    its scale; see :mod:`robacc.statistics.scaled_percentile`.
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
