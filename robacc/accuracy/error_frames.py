"""The same errors in the axes of the tool and in those of the measuring frame: their first two moments in each.

A cloud that is round in one frame may be long in the other: what the tool carries stays with the tool, what the base
does stays with the room.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robacc.accuracy.pose_errors import Commanded, ErrorFrame, pose_errors
from robacc.geometry import Array
from robacc.measurements import Measurements


@dataclass(frozen=True, slots=True)
class Moments:
    """Of the position errors in one frame, and the errors themselves."""

    errors: Array
    """``(3, N)`` m"""
    mean: Array
    """``(3,)`` m"""
    covariance: Array
    """``(3, 3)`` about zero, divisor N: equation (13) of Wu and Lee (1985), m²."""
    centred: Array
    """``(3, 3)`` about the mean, divisor N, m²."""


def position_moments(data: Measurements, commanded: Commanded) -> dict[ErrorFrame, Moments]:
    """In the measuring frame, and in the tool's where its commanded orientation is known."""
    frames: tuple[ErrorFrame, ...] = ("tool", "base") if commanded.oriented else ("base",)
    found = {}
    for frame in frames:
        errors = pose_errors(data, commanded, frame).position
        mean = errors.mean(axis=1)
        covariance = errors @ errors.T / data.n
        found[frame] = Moments(errors, mean, covariance, covariance - np.outer(mean, mean))
    return found
