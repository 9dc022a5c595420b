"""An estimate as the keys of ``robacc.estimate/1`` (m and rad), and its errors pose by pose as CSV."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np

from robacc.estimation import EstimateResult, WorstPose
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.pose_errors import Summary
from robacc.statistics.intervals import Interval
from robacc.statistics.records import ErrorStatistics, MatrixInterval, Radius


def payload(result: EstimateResult) -> dict[str, Any]:
    """The document's own keys; arrays stay arrays, which :mod:`robacc.io.result_json` writes."""
    orientation = None
    if result.orientation is not None and result.errors.rotation is not None:
        orientation = _statistics(result.orientation, result.errors.rotation)
    return {
        "n_poses": result.n_poses,
        "frame": result.errors.frame,
        "commanded": result.commanded,
        "alignment": _alignment(result),
        "unaligned": _unaligned(result),
        "position": _statistics(result.position, result.errors.position),
        "orientation": orientation,
        "grade": result.grade.document(),
        "worst_poses": {
            "by_position": [_worst(pose) for pose in result.worst_position],
            "by_orientation": [_worst(pose) for pose in result.worst_orientation],
        },
        "targets": [
            {"target": target.name, "n_poses": target.n_poses, **_summary(target.position, "m")}
            for target in result.targets
        ],
        "notes": result.notes,
        "warnings": result.warnings,
    }


def per_pose_csv(result: EstimateResult, data: Measurements) -> str:
    """A row a pose: its line, its ids, the error vector and its length, in m and rad."""
    columns: dict[str, Iterable[str]] = {"line": (str(data.line(i)) for i in range(data.n))}
    for name, ids in (("pose", data.pose), ("cycle", data.cycle), ("target", data.target)):
        if ids is not None:
            columns[name] = (_quoted(str(value)) for value in ids)
    columns |= _error_columns(("dx_m", "dy_m", "dz_m", "error_m"), result.errors.position)
    if result.errors.rotation is not None:
        columns |= _error_columns(("rx_rad", "ry_rad", "rz_rad", "error_rad"), result.errors.rotation)
    rows = zip(*columns.values(), strict=True)
    return "\n".join([",".join(columns), *(",".join(row) for row in rows)]) + "\n"


def _error_columns(names: tuple[str, ...], errors: Array) -> dict[str, Iterable[str]]:
    size = np.sqrt(np.einsum("in,in->n", errors, errors))
    return {name: map(repr, values.tolist()) for name, values in zip(names, (*errors, size), strict=True)}


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"' if any(sign in text for sign in ',"\n\r') else text


def _statistics(statistics: ErrorStatistics, errors: Array) -> dict[str, Any]:
    unit = statistics.unit
    square = f"{unit}2"
    intervals = statistics.intervals
    return {
        f"mean_{unit}": statistics.mean,
        f"covariance_{square}": statistics.covariance,
        f"centred_covariance_{square}": statistics.centred_covariance,
        f"rms_{unit}": statistics.rms,
        f"mean_error_{unit}": statistics.mean_error,
        f"p95_{unit}": statistics.p95,
        f"max_{unit}": statistics.max,
        "share_below_max": statistics.share_below_max,
        f"radius95_zero_mean_{unit}": _radius(statistics.radius95_zero_mean),
        f"radius95_fitted_mean_{unit}": _radius(statistics.radius95_fitted_mean),
        "n_commanded_poses": statistics.n_poses,
        "confidence": statistics.confidence,
        "intervals": {
            f"mean_{unit}": [_interval(interval) for interval in intervals.mean],
            f"covariance_{square}": _matrix_interval(intervals.covariance),
            f"centred_covariance_{square}": _matrix_interval(intervals.centred_covariance),
            f"rms_{unit}": _interval(intervals.rms),
            f"mean_error_{unit}": _interval(intervals.mean_error),
            f"p95_{unit}": _interval(intervals.p95),
        },
        "ellipsoid": [
            {
                "direction": statistics.ellipsoid.axes[:, i],
                f"sd_{unit}": statistics.ellipsoid.sd[i],
                "interval": _interval(statistics.ellipsoid.intervals[i]),
            }
            for i in range(3)
        ],
        "tests": dataclasses.asdict(statistics.tests),
        "structure": dataclasses.asdict(statistics.structure),
        "assumption": statistics.assumption,
        f"errors_{unit}": errors.T,
    }


def _interval(interval: Interval) -> dict[str, Any]:
    record: dict[str, Any] = {
        "lower": interval.lower,
        "upper": interval.upper,
        "upper_bound": interval.upper_bound,
        "method": interval.method,
    }
    return record if interval.why is None else {**record, "why": interval.why}


def _matrix_interval(interval: MatrixInterval) -> dict[str, Any]:
    record: dict[str, Any] = {"lower": interval.lower, "upper": interval.upper, "method": interval.method}
    return record if interval.why is None else {**record, "why": interval.why}


def _radius(radius: Radius) -> dict[str, Any]:
    record: dict[str, Any] = {"value": radius.value, "interval": _interval(radius.interval)}
    return record if radius.why is None else {**record, "why": radius.why}


def _summary(summary: Summary, unit: str) -> dict[str, float]:
    return {f"{name}_{unit}": value for name, value in dataclasses.asdict(summary).items()}


def _alignment(result: EstimateResult) -> dict[str, Any] | None:
    if result.alignment is None:
        return None
    return {
        "what": result.alignment.effects,
        "n_parameters": result.alignment.n_parameters,
        "parameters": [
            {"name": name, "value": value, "unit": unit} for name, value, unit in result.alignment.parameters
        ],
    }


def _unaligned(result: EstimateResult) -> dict[str, Any] | None:
    if result.unaligned is None:
        return None
    orientation = result.unaligned.orientation
    return {
        "position": _summary(result.unaligned.position, "m"),
        "orientation": None if orientation is None else _summary(orientation, "rad"),
    }


def _worst(pose: WorstPose) -> dict[str, Any]:
    return {
        "line": pose.line,
        "pose": pose.pose,
        "target": pose.target,
        "error_m": pose.position,
        "error_rad": pose.orientation,
    }
