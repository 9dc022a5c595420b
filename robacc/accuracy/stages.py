"""Metrics and residuals of the nominal, registered and calibrated arm, and the improvement between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.metrics import PoseMetrics
from robacc.geometry import Array
from robacc.statistics.distributions import student_quantile


@dataclass(frozen=True, slots=True)
class Stage:
    """Metrics of one model: nominal, before or after. Outliers count; metrics without them stand beside."""

    fitted: PoseMetrics
    held_out: PoseMetrics | None
    """None where there are too few poses to hold any out."""
    fitted_inliers: PoseMetrics | None = None
    """Metrics without the outliers; None if there are none."""
    held_out_inliers: PoseMetrics | None = None
    """Metrics of held-out poses without the outliers; None if there are none."""


@dataclass(frozen=True, slots=True)
class Residuals:
    """Residuals ``(3 or 6, N)`` of the same poses at every stage, m and rad, in the measuring frame."""

    unregistered: Array
    """Residuals of the nominal model as it stands in the robot file."""
    nominal: Array
    """Residuals of the nominal model, registered."""
    before: Array
    after: Array
    held_out_nominal: Array | None = None
    """Residuals of the nominal model, registered without the pose; None where no pose was held out."""
    held_out_before: Array | None = None
    """Residuals by models fitted without the pose; None where no pose was held out."""
    held_out_after: Array | None = None


@dataclass(frozen=True, slots=True)
class Gain:
    """Reduction of the position RMS on held-out poses, with an interval over poses."""

    value: float
    low: float
    high: float
    confidence: float


@dataclass(frozen=True, slots=True)
class BeforeAfter:
    """Stages, gain and residuals of two fits to the same poses."""

    nominal_unregistered: Stage
    """Stage of the nominal model as it stands in the robot file."""
    nominal: Stage
    """Stage of the nominal model, registered: base and tool frames fitted as far as the poses allow."""
    before: Stage
    after: Stage
    gain: Gain | None
    """None where no pose was held out."""
    residuals: Residuals
    """Residuals of every calibration pose, outliers included."""
    holdout: Residuals | None
    """Residuals of the validation poses, where there are any."""


def paired_gain(before: Array, after: Array, groups: NDArray[np.int64], confidence: float = 0.95) -> Gain:
    """Return the fall of the position RMS from ``before`` to ``after`` ``(M, N)`` on the same poses.

    The interval is the delta method's over groups of repeats. Both errors of a pose stay together, so that what the
    stages share cancels.
    """
    squares = np.stack([np.sum(np.square(residual[:3]), axis=0) for residual in (before, after)])
    count = int(groups.max(initial=-1)) + 1
    sums = np.stack([np.bincount(groups, weights=square, minlength=count) for square in squares])
    n = squares.shape[1]
    rms = np.sqrt(sums.sum(axis=1) / n)
    value = float(rms[0] - rms[1])
    if count < 3 or rms.min() <= 0:
        return Gain(value, float("nan"), float("nan"), confidence)
    influence = (sums[0] - sums[0].mean()) / (2 * rms[0] * n) - (sums[1] - sums[1].mean()) / (2 * rms[1] * n)
    gain_std = float(np.sqrt(np.sum(np.square(influence)) * count / (count - 1)))
    half_width = student_quantile(0.5 + confidence / 2, count - 1.0) * gain_std
    return Gain(value, value - half_width, value + half_width, confidence)
