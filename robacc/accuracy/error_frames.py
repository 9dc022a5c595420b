"""Position errors in the axes of the tool and of the measuring frame, with their mean and covariance in each.

A cloud that is round in one frame may be long in the other: errors of the tool turn with the tool, errors of the base
stay fixed in the room.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robacc.accuracy.pose_errors import Commanded, ErrorFrame, pose_errors
from robacc.geometry import Array
from robacc.measurements import Measurements


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """Position errors in one frame, their mean and covariance."""

    errors: Array
    """``(3, N)`` m"""
    mean: Array
    """``(3,)`` m"""
    covariance: Array
    """``(3, 3)`` about zero, divisor N: equation (13) of Wu and Lee (1985), m²."""
    centred: Array
    """``(3, 3)`` about the mean, divisor N, m²."""


def position_statistics(data: Measurements, commanded: Commanded) -> dict[ErrorFrame, FrameStatistics]:
    """Return the statistics in the measuring frame, and in the tool's where a commanded orientation is known."""
    frames: tuple[ErrorFrame, ...] = ("tool", "base") if commanded.oriented else ("base",)
    statistics = {}
    for frame in frames:
        errors = pose_errors(data, commanded, frame).position
        mean = errors.mean(axis=1)
        covariance = errors @ errors.T / data.n
        statistics[frame] = FrameStatistics(errors, mean, covariance, covariance - np.outer(mean, mean))
    return statistics
