"""RMS, mean, 95th percentile and maximum of the error's length: the metrics that every comparison uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robacc.geometry import Array


@dataclass(frozen=True, slots=True)
class ErrorMetrics:
    """Metrics of the error's length over poses, m or rad."""

    rms: float
    mean: float
    p95: float
    """Interpolated linearly between order statistics."""
    max: float


@dataclass(frozen=True, slots=True)
class PoseMetrics:
    """Metrics of position and, where it was measured, of orientation."""

    position: ErrorMetrics
    orientation: ErrorMetrics | None


def pose_metrics(residual: Array) -> PoseMetrics:
    """Return the metrics of residuals ``(3 or 6, N)`` in m and rad."""
    orientation = _error_metrics(residual[3:]) if residual.shape[0] == 6 else None
    return PoseMetrics(_error_metrics(residual[:3]), orientation)


def _error_metrics(errors: Array) -> ErrorMetrics:
    return length_metrics(np.sqrt(np.sum(np.square(errors), axis=0)))


def length_metrics(length: Array) -> ErrorMetrics:
    """Return the metrics of lengths ``(N,)``, m or rad; NaN without any."""
    if length.size == 0:
        return ErrorMetrics(float("nan"), float("nan"), float("nan"), float("nan"))
    return ErrorMetrics(
        float(np.sqrt(np.mean(np.square(length)))),
        float(np.mean(length)),
        float(np.percentile(length, 95.0)),
        float(np.max(length)),
    )
