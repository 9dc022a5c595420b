"""Statistics, grades and coefficients as parts of a JSON result: SI units in the keys, null with ``why`` if missing.

Keys of position statistics end in ``_m`` and ``_m2``, those of orientation statistics in ``_rad`` and ``_rad2``.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from robacc.accuracy.grade import Grade, QuantityGrade
from robacc.accuracy.metrics import ErrorMetrics
from robacc.statistics.intervals import Interval
from robacc.statistics.multivariate import AssumptionTest
from robacc.statistics.records import ErrorStatistics, MatrixInterval, Radius

if TYPE_CHECKING:
    from robacc.fitting.parameters import FittedParameter, ParameterCovariance

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


def _radius(radius: Radius, unit: str) -> Document:
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
        f"upper_bound_{unit}": quantity.upper_bound,
        f"limit_{unit}": quantity.limit,
        "method": quantity.method,
        "why": quantity.why,
    }
