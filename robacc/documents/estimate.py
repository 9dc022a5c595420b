"""Keys of ``robacc.estimate/1`` in m and rad, and the errors of every pose as CSV."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from robacc.accuracy.error_frames import FrameStatistics
from robacc.accuracy.estimation import EstimateResult, WorstPose
from robacc.accuracy.pose_errors import ErrorFrame
from robacc.documents.csv_columns import csv_cell, csv_text
from robacc.documents.poses import pose_document, robot_document, rounded
from robacc.documents.statistics import figures_document, grade_document, parameters_document, statistics_document
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.quantities import number_text
from robacc.robots.description import Robot


def payload(result: EstimateResult) -> dict[str, Any]:
    """Return the keys of the estimate; arrays stay arrays, which :mod:`robacc.io.json_text` writes."""
    orientation = None
    if result.orientation is not None and result.errors.rotation is not None:
        orientation = {**statistics_document(result.orientation), "errors_rad": result.errors.rotation.T}
    return {
        "n_poses": result.n_poses,
        "frame": result.errors.frame,
        "commanded": result.commanded,
        "alignment": _alignment(result),
        "unaligned": _unaligned(result),
        "position": {**statistics_document(result.position), "errors_m": result.errors.position.T},
        "orientation": orientation,
        "grade": grade_document(result.grade),
        "worst_poses": {
            "by_position": [_worst(pose) for pose in result.worst_position],
            "by_orientation": [_worst(pose) for pose in result.worst_orientation],
        },
        "targets": [
            {"target": target.name, "n_poses": target.n_poses, **figures_document(target.position, "m")}
            for target in result.targets
        ],
        "notes": result.notes,
        "warnings": result.warnings,
    }


def pose_payload(
    data: Measurements, robot: Robot | None, by_frame: Mapping[ErrorFrame, FrameStatistics]
) -> dict[str, Any]:
    """Return the keys of the data: measurement noise, robot, every pose, and position errors in both frames."""
    return {
        "noise": _noise(data),
        "robot": robot_document(robot, data.q),
        "poses": pose_document(data, data.position - by_frame["base"].errors),
        "position_by_frame": {
            frame: {
                "mean_m": statistics.mean,
                "covariance_m2": statistics.covariance,
                "centred_covariance_m2": statistics.centred,
                "errors_m": rounded(statistics.errors),
            }
            for frame, statistics in by_frame.items()
        },
    }


def _noise(data: Measurements) -> dict[str, Any] | None:
    """Return the measurement noise that the file states, RMS over poses for each axis; None if it states none."""
    if data.sigma_position is None and data.sigma_rotation is None:
        return None
    position, rotation = data.stated_noise
    return {"position_m": position, "orientation_rad": rotation, "source": "file"}


def per_pose_csv(result: EstimateResult, data: Measurements) -> str:
    """Return a CSV row for each pose: its line, its ids, the error vector and its length, in m and rad."""
    columns: dict[str, Iterable[str]] = {"line": (str(data.line(i)) for i in range(data.n))}
    for name in ("pose", "cycle", "visit", "target"):
        ids = getattr(data, name)
        if ids is not None:
            columns[name] = (csv_cell(str(value)) for value in ids)
    columns |= _error_columns(("dx_m", "dy_m", "dz_m", "error_m"), result.errors.position)
    if result.errors.rotation is not None:
        columns |= _error_columns(("rx_rad", "ry_rad", "rz_rad", "error_rad"), result.errors.rotation)
    return csv_text(columns)


def _error_columns(names: tuple[str, ...], errors: Array) -> dict[str, Iterable[str]]:
    size = np.sqrt(np.einsum("in,in->n", errors, errors))
    return {name: map(number_text, values.tolist()) for name, values in zip(names, (*errors, size), strict=True)}


def _alignment(result: EstimateResult) -> dict[str, Any] | None:
    if result.alignment is None:
        return None
    return {
        "what": result.alignment.effects,
        "n_parameters": result.alignment.n_parameters,
        "parameters": parameters_document(result.alignment.parameters),
    }


def _unaligned(result: EstimateResult) -> dict[str, Any] | None:
    if result.unaligned is None:
        return None
    orientation = result.unaligned.orientation
    return {
        "position": figures_document(result.unaligned.position, "m"),
        "orientation": None if orientation is None else figures_document(orientation, "rad"),
    }


def _worst(pose: WorstPose) -> dict[str, Any]:
    return {
        "line": pose.line,
        "pose": pose.pose,
        "target": pose.target,
        "error_m": pose.position,
        "error_rad": pose.orientation,
    }
