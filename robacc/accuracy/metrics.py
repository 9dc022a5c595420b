"""The four figures of an error's length that every comparison uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robacc.geometry import Array


@dataclass(frozen=True, slots=True)
class ErrorMetrics:
    """Of the error's length over poses, m or rad."""

    rms: float
    mean: float
    p95: float
    """Linear interpolation between order statistics."""
    max: float


@dataclass(frozen=True, slots=True)
class PoseMetrics:
    """Of position and, where it was measured, orientation."""

    position: ErrorMetrics
    orientation: ErrorMetrics | None


def pose_metrics(residual: Array) -> PoseMetrics:
    """From residuals ``(3 or 6, N)``, m and rad."""
    turned = _figures(residual[3:]) if residual.shape[0] == 6 else None
    return PoseMetrics(_figures(residual[:3]), turned)


def _figures(errors: Array) -> ErrorMetrics:
    length = np.sqrt(np.sum(np.square(errors), axis=0))
    if length.size == 0:
        return ErrorMetrics(float("nan"), float("nan"), float("nan"), float("nan"))
    return ErrorMetrics(
        float(np.sqrt(np.mean(np.square(length)))),
        float(np.mean(length)),
        float(np.percentile(length, 95.0)),
        float(np.max(length)),
    )
