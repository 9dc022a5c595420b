"""Map of the workspace: where an arm holds its grade, by voxels of the predicted positions."""

from __future__ import annotations

import numpy as np

from robacc.accuracy.grade_scale import Scale
from robacc.geometry import Array
from robacc.prediction.predicting import Prediction
from robacc.quantities import number_text


def warranty_map_csv(prediction: Prediction, position: Array, voxel: float) -> str:
    """Return a CSV with a row for each voxel that has a configuration.

    Columns: centre of the voxel (m), number of configurations, RMS and largest 95 % bound of position (m) and of
    orientation (rad), and the grade that every configuration there meets.

    Args:
        prediction: Predicted errors of N configurations.
        position: ``(3, N)`` position of the target, measuring frame, m.
        voxel: Edge of a voxel, m.
    """
    index = np.floor(position / voxel).astype(np.int64)
    voxels, number = np.unique(index, axis=1, return_inverse=True)
    number = number.ravel()
    count = np.bincount(number)
    rows = ["x_m,y_m,z_m,configurations,rms_m,bound95_m,rms_rad,bound95_rad,grade"]
    columns = []
    for errors in (prediction.position, prediction.orientation):
        columns += [
            np.sqrt(np.bincount(number, np.square(errors.pose_rms)) / count),
            _largest(errors.pose_radius95, number, count.size),
        ]
    scale = prediction.grade.scale
    for i, centre in enumerate(((voxels + 0.5) * voxel).T):
        numbers = [number_text(float(value)) for value in (*centre, *(column[i] for column in columns))]
        grade = _grade(scale, float(columns[1][i]), float(columns[3][i]))
        rows.append(",".join((*numbers[:3], str(int(count[i])), *numbers[3:], grade)))
    return "\n".join(rows) + "\n"


def _largest(values: Array, number: np.ndarray, count: int) -> Array:
    result = np.zeros(count)
    np.maximum.at(result, number, values)
    return result


def _grade(scale: Scale, position: float, orientation: float) -> str:
    for step in scale.steps:
        if position <= step.position and (step.orientation is None or orientation <= step.orientation):
            return step.grade
    return scale.otherwise
