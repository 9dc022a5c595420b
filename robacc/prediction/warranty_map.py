"""Map of the workspace: where an arm holds its grade, by voxels of the predicted positions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.prediction.predicting import Prediction, steps_met
from robacc.quantities import number_text

_ACROSS = 10
"""Approximate number of voxels along the longest side of the workspace, where no edge is given."""


@dataclass(frozen=True, slots=True)
class WarrantyMap:
    """Predicted errors of the V voxels that have a configuration."""

    edge: float
    """Edge of a voxel, m."""
    centre: Array
    """``(3, V)`` centres of the voxels, measuring frame, m."""
    count: NDArray[np.int64]
    """``(V,)`` configurations in each voxel."""
    rms: tuple[Array, Array]
    """``(V,)`` RMS of position (m) and of orientation (rad)."""
    bound: tuple[Array, Array]
    """``(V,)`` largest 95 % bound of position (m) and of orientation (rad)."""
    grades: tuple[str, ...]
    """``(V,)`` grade that every configuration of the voxel meets."""

    def csv(self) -> str:
        """Return a CSV with a row for each voxel; lengths in m, angles in rad."""
        rows = ["x_m,y_m,z_m,configurations,rms_m,bound95_m,rms_rad,bound95_rad,grade"]
        columns = (self.rms[0], self.bound[0], self.rms[1], self.bound[1])
        for i, centre in enumerate(self.centre.T.tolist()):
            numbers = [number_text(float(value)) for value in (*centre, *(column[i] for column in columns))]
            rows.append(",".join((*numbers[:3], str(int(self.count[i])), *numbers[3:], self.grades[i])))
        return "\n".join(rows) + "\n"


def warranty_map(prediction: Prediction, position: Array, edge: float | None = None) -> WarrantyMap:
    """Return the map of predicted errors.

    Args:
        prediction: Predicted errors of N configurations.
        position: ``(3, N)`` position of the target, measuring frame, m.
        edge: Edge of a voxel, m; None for a round length that gives ten to 25 voxels along its longest side.
    """
    edge = _round_edge(position) if edge is None else edge
    index = np.floor(position / edge).astype(np.int64)
    voxels, number = np.unique(index, axis=1, return_inverse=True)
    number = number.ravel()
    count = np.bincount(number)
    parts = (prediction.position, prediction.orientation)
    rms: list[Array] = [np.sqrt(np.bincount(number, np.square(errors.pose_rms)) / count) for errors in parts]
    bound = [np.zeros(count.size), np.zeros(count.size)]
    for largest, errors in zip(bound, parts, strict=True):
        np.maximum.at(largest, number, errors.pose_radius95)
    scale = prediction.grade.scale
    ranks = np.argmax(steps_met(scale, {"position": bound[0], "orientation": bound[1]}), axis=0)
    grades = tuple(map(scale.name_of, ranks.tolist()))
    return WarrantyMap(edge, np.asarray((voxels + 0.5) * edge), count, (rms[0], rms[1]), (bound[0], bound[1]), grades)


def _round_edge(position: Array) -> float:
    """Return the edge of a voxel, m: 1, 2 or 5 times a power of ten, for the positions ``(3, N)``."""
    wanted = max(float(np.max(np.ptp(position, axis=1), initial=0.0)) / _ACROSS, 1e-3)
    power = 10.0 ** math.floor(math.log10(wanted))
    return float(power * max(step for step in (1, 2, 5) if step * power <= wanted))
