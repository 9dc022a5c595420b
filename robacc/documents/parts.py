"""Parts that several documents share: statistics, grades, coefficients, poses, the robot, curves of effects."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.grade import Grade, QuantityGrade
from robacc.accuracy.pose_errors import ErrorMetrics
from robacc.accuracy.stages import Residuals
from robacc.diagnostics.partial_residuals import PartialResidual
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.validity import OutsideValidity
from robacc.robots.arm import Arm, skeleton, typical_pose
from robacc.robots.description import Robot
from robacc.statistics.intervals import EstimateOrReason, Interval
from robacc.statistics.multivariate import AssumptionTest
from robacc.statistics.records import ErrorStatistics, MatrixInterval

if TYPE_CHECKING:
    from robacc.fitting.parameters import FittedParameter, ParameterCovariance


# JSON key of the poses outside a model's validity ranges.


def outside_document(outside: OutsideValidity | None) -> dict[str, Any]:
    """Return the key ``outside_validity``; None is a model without ranges."""
    if outside is None:
        return {"n_poses": 0, "position_std_max_m": 0.0, "ranges": []}
    return {
        "n_poses": outside.n_poses,
        "position_std_max_m": outside.std_max,
        "ranges": [
            {
                "effect": item.effect,
                "driver": item.driver,
                "unit": item.unit,
                "low": item.low,
                "high": item.high,
                "n_poses": item.n_poses,
                "largest_excess": item.excess,
                "rule": "held" if item.is_held else "extrapolated",
            }
            for item in outside.ranges
        ],
    }


# Parts of a JSON result for charts: the robot's outline, every pose, and the curves of effects.
#
# Values of poses are rounded to 1e-12 m or rad, far below any instrument, which halves the size of the document.

_DECIMALS = 12


def robot_document(robot: Robot | None, q: Array | None, registered: Robot | None = None) -> dict[str, Any] | None:
    """Return the robot's name, joints, and outline at a typical pose of ``q`` ``(J, N)``; None without a robot.

    The outline is that of the ``registered`` robot if there is one, among the poses in the measuring frame.
    """
    if robot is None:
        return None
    arm = Arm.of(registered or robot)
    outline = None
    if q is not None and q.shape[1]:
        typical = q[:, typical_pose(q)]
        outline = {"q": typical, "line_m": rounded(skeleton(arm, typical))}
    return {
        "name": robot.name,
        "joints": [{"name": joint.name, "type": joint.type} for joint in robot.variables],
        "effects": list(dict.fromkeys(str(entry.get("effect", "?")) for entry in robot.effects)),
        "fitted_to": list(robot.fitted_to),
        "outline": outline,
    }


def pose_document(
    data: Measurements, commanded: Array, residuals: Residuals | None = None, used: NDArray[np.bool_] | None = None
) -> dict[str, Any]:
    """Return columns with an entry for each row: its line, ids, commanded and measured values, and residuals.

    Rows with the same ``group`` are repetitions of one commanded pose.

    Args:
        data: The measured rows.
        commanded: ``(3, N)`` commanded position of the target in the measuring frame, m.
        residuals: Residuals of a fit, if there is a fit.
        used: ``(N,)`` rows without outliers.
    """
    return {
        "line": [data.line(i) for i in range(data.n)],
        "pose": _texts(data.pose),
        "cycle": _texts(data.cycle),
        "target": _texts(data.target),
        "group": data.groups(),
        "q": None if data.q is None else rounded(data.q),
        "commanded_m": rounded(commanded),
        "attained_m": rounded(data.position),
        "time_s": data.time,
        "temperature_c": data.temperature,
        "payload_kg": data.payload,
        "used": used,
        **({} if residuals is None else _stages(residuals)),
    }


def _stages(residuals: Residuals) -> dict[str, Any]:
    by_stage = {
        "nominal_unregistered": residuals.unregistered,
        "nominal": residuals.nominal,
        "before": residuals.before,
        "after": residuals.after,
        "held_out_nominal": residuals.held_out_nominal,
        "held_out_before": residuals.held_out_before,
        "held_out_after": residuals.held_out_after,
    }
    return {
        "errors_m": {name: None if errors is None else rounded(errors[:3]) for name, errors in by_stage.items()},
        "errors_rad": None
        if residuals.nominal.shape[0] == 3
        else {name: None if errors is None else rounded(errors[3:]) for name, errors in by_stage.items()},
    }


def curve_document(curve: PartialResidual) -> dict[str, Any]:
    """Return one curve of an effect; ``x`` and ``grid`` are in ``driver_unit``, all other values in ``unit``."""
    spectrum = curve.spectrum
    return {
        "joint": curve.joint,
        "driver": curve.driver,
        "driver_unit": curve.driver_unit,
        "unit": curve.unit,
        "x": curve.x,
        "effect": rounded(curve.effect),
        "residual_before": rounded(curve.before),
        "residual_after": rounded(curve.after),
        "sd": rounded(curve.sd),
        "grid": curve.grid,
        "curve": None if curve.value is None else rounded(curve.value),
        "spectrum": None
        if spectrum is None
        else {
            "orders": spectrum.orders,
            "before_rad": rounded(spectrum.before),
            "after_rad": rounded(spectrum.after),
            "noise_rad": spectrum.noise,
        },
    }


def rounded(values: Array) -> Array:
    """Return rounded values with poses first, the order of a document."""
    result: Array = np.round(values, _DECIMALS).T
    return result


def _texts(column: NDArray[Any] | None) -> list[str] | None:
    return None if column is None else [str(value) for value in column]


# Statistics, grades and coefficients as parts of a JSON result: SI units in the keys, null with ``why`` if missing.
#
# Keys of position statistics end in ``_m`` and ``_m2``, those of orientation statistics in ``_rad`` and ``_rad2``.

Document = dict[str, Any]
_COVARIANCE_DIGITS = 8
"""Significant digits of a covariance: sums of 500 coefficients keep their variances to 2e-7 of their size."""


def statistics_document(statistics: ErrorStatistics) -> Document:
    """Return the ``position`` or ``orientation`` part of ``robacc.estimate/1``, without the errors themselves."""
    unit = statistics.unit
    intervals = statistics.intervals
    return {
        f"mean_{unit}": statistics.mean,
        f"covariance_{unit}2": statistics.covariance,
        f"centred_covariance_{unit}2": statistics.centred_covariance,
        f"rms_{unit}": statistics.rms,
        f"mean_error_{unit}": statistics.mean_error,
        f"p95_{unit}": statistics.p95,
        f"max_{unit}": statistics.max,
        "percentile_definition": "linear interpolation at (n - 1) p (Hyndman and Fan type 7)",
        "share_below_max": statistics.share_below_max,
        "n_commanded_poses": statistics.n_poses,
        "independent_poses": statistics.n_independent,
        "confidence": statistics.confidence,
        "assumption": statistics.assumption,
        "intervals": {
            f"mean_{unit}": [interval_document(interval) for interval in intervals.mean],
            f"covariance_{unit}2": _matrix_interval(intervals.covariance),
            f"centred_covariance_{unit}2": _matrix_interval(intervals.centred_covariance),
            f"rms_{unit}": interval_document(intervals.rms),
            f"mean_error_{unit}": interval_document(intervals.mean_error),
            f"p95_{unit}": interval_document(intervals.p95),
            f"max_{unit}": interval_document(statistics.estimate("max")[1]),
        },
        "ellipsoid": [
            {"direction": direction, f"sd_{unit}": sd, "interval": interval_document(interval)}
            for direction, sd, interval in zip(
                statistics.ellipsoid.axes.T, statistics.ellipsoid.sd, statistics.ellipsoid.intervals, strict=True
            )
        ],
        "radius95": {
            "zero_mean": _radius(statistics.radius95_zero_mean, unit),
            "fitted_mean": _radius(statistics.radius95_fitted_mean, unit),
        },
        "tests": {
            "zero_mean": _test(statistics.tests.zero_mean),
            "skewness": _test(statistics.tests.skewness),
            "kurtosis": _test(statistics.tests.kurtosis),
        },
        "pose_structure": {
            f"between_{unit}2": statistics.structure.between,
            f"within_{unit}2": statistics.structure.within,
            "intraclass_correlation": statistics.structure.intraclass_correlation,
            "effective_poses": statistics.structure.effective_poses,
            "text": statistics.structure.text,
            "why": statistics.structure.why,
        },
    }


def grade_document(grade: Grade) -> Document:
    """Return the ``grade`` part of ``robacc.estimate/1``; limits, values and bounds in m and rad."""
    scale, following = grade.scale, grade.next
    return {
        "grade": grade.grade,
        "demonstrated": grade.demonstrated,
        "demonstrated_grade": grade.demonstrated_grade,
        "scale": scale.name,
        "statistic": scale.statistic,
        "confidence": scale.confidence,
        "position": _quantity(grade.position),
        "orientation": None if grade.orientation is None else _quantity(grade.orientation),
        "limited_by": grade.limited_by,
        "next": None
        if following is None
        else {
            "grade": following.grade,
            "position_excess_m": following.position,
            "orientation_excess_rad": following.orientation,
        },
        "probability": grade.probability,
        "probabilities": [{"grade": name, "probability": share} for name, share in grade.probabilities],
        "poses_to_demonstrate": grade.poses_to_demonstrate,
        "reason": grade.reason,
        "steps": [
            {"grade": step.grade, "position_m": step.position, "orientation_rad": step.orientation}
            for step in scale.steps
        ],
        "otherwise": scale.otherwise,
    }


def parameters_document(parameters: Iterable[FittedParameter]) -> list[Document]:
    """Return name, value, standard error and unit of each coefficient, and why a standard error is missing.

    A value of -0.0 becomes 0.0.
    """
    return [
        {
            "name": parameter.name,
            "value": parameter.value + 0.0,
            "std": parameter.std,
            "unit": parameter.unit,
            **({"why": parameter.why} if parameter.why else {}),
        }
        for parameter in parameters
    ]


def covariance_document(covariance: ParameterCovariance) -> Document:
    """Return the covariance of the coefficients: its lower triangle, which tells all, in few digits."""
    rows = [
        [*(float(f"{value:.{_COVARIANCE_DIGITS}g}") for value in row[:i]), float(row[i])]
        for i, row in enumerate(covariance.matrix.tolist())
    ]
    return {"names": list(covariance.names), "lower_triangle": rows}


def figures_document(figures: ErrorMetrics, unit: str) -> Document:
    """Return the four metrics of an error's length."""
    return {
        f"rms_{unit}": figures.rms,
        f"mean_error_{unit}": figures.mean,
        f"p95_{unit}": figures.p95,
        f"max_{unit}": figures.max,
    }


def interval_document(interval: Interval) -> Document:
    """Return an interval in the unit of its number."""
    return {
        "lower": interval.lower,
        "upper": interval.upper,
        "upper_bound": interval.upper_bound,
        "confidence": interval.confidence,
        "method": interval.method,
        "why": interval.why,
    }


def _matrix_interval(interval: MatrixInterval) -> Document:
    return {
        "lower": interval.lower,
        "upper": interval.upper,
        "confidence": interval.confidence,
        "method": interval.method,
        "why": interval.why,
    }


def _radius(radius: EstimateOrReason, unit: str) -> Document:
    return {f"radius_{unit}": radius.value, "interval": interval_document(radius.interval), "why": radius.why}


def _test(test: AssumptionTest) -> Document:
    return {
        "method": test.method,
        "statistic": test.statistic,
        "p_value": test.p_value,
        "dimension": test.dimension,
        "why": test.why,
    }


def _quantity(quantity: QuantityGrade) -> Document:
    unit = quantity.unit
    return {
        "grade": quantity.grade,
        "demonstrated_grade": quantity.demonstrated_grade,
        f"value_{unit}": quantity.value,
        f"upper_bound_{unit}": quantity.interval.upper_bound,
        f"limit_{unit}": quantity.limit,
        "method": quantity.interval.method,
        "why": quantity.why,
    }
