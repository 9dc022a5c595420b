"""Keys that the documents of `robacc calibrate` and `robacc trace` share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.stages import Gain, Residuals
from robacc.documents.poses import pose_document, robot_document
from robacc.documents.stages import ErrorRows, stage_document
from robacc.documents.statistics import covariance_document, parameters_document
from robacc.error_model.structure import Repeatability
from robacc.fitting.deflection_model import BETTER, DeflectionChoice
from robacc.fitting.fit_result import Fit
from robacc.fitting.noise import LackOfFit
from robacc.fitting.places import places
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.description import Robot
from robacc.tracing.causes import ErrorCause
from robacc.tracing.judging import Judged


def judged_keys(
    result: Judged, data: Measurements, robot: Robot, apart: Measurements | None, seed: int
) -> dict[str, Any]:
    """Return the keys that every fit has; charts need the robot and the residuals of every pose.

    Args:
        result: The result.
        data: Calibration poses.
        robot: The nominal model.
        apart: Held-out poses, where they come from a file of their own.
        seed: Seed of the resampling behind intervals.
    """

    def poses(rows: Measurements, residuals: Residuals, used: NDArray[np.bool_] | None) -> dict[str, Any]:
        return pose_document(rows, rows.position - residuals.nominal[:3], residuals, used)

    return {
        "n_poses": data.n,
        "noise": _noise_document(result.noise),
        **_stage_documents(result, data, apart, seed),
        "causes": _causes_document(result.causes),
        "gain_m": _gain_document(result.gain),
        "n_folds": result.n_folds,
        "parameters": parameters_document(result.parameters),
        "parameter_covariance": covariance_document(result.covariance),
        "priors": _priors_document(result.fit),
        "repeatability": _repeatability_document(result.repeatability),
        "converged": result.fit.converged,
        "deflection": _deflection_document(result.deflection),
        "outliers": [{"line": data.line(int(i))} for i in result.fit.outliers],
        "warnings": list(result.warnings),
        "robot": robot_document(robot, data.q),
        "poses": poses(data, result.residuals, result.fit.inliers),
        "poses_apart": None if apart is None or result.holdout is None else poses(apart, result.holdout, None),
    }


def _priors_document(fit: Fit) -> list[dict[str, Any]]:
    """Return the estimated priors about nominal, one for each kind of constants that has one."""
    return [
        {
            "effect": kind.partition(" (")[0],
            "unit": kind.partition(" (")[2].rstrip(")"),
            "std": std,
            "weakly_identifiable": [name for name in fit.weak if name.startswith(kind.partition(" (")[0])],
        }
        for kind, std in fit.prior_stds.items()
    ]


def _repeatability_document(repeatability: Repeatability | None) -> dict[str, Any] | None:
    """Return the key ``repeatability``."""
    if repeatability is None:
        return None
    return {
        "joints": dict(repeatability.joints),
        "position_m": repeatability.position,
        "pose_position_m": repeatability.pose_position,
        "source": repeatability.source,
    }


def _noise_document(lack_of_fit: LackOfFit) -> dict[str, Any]:
    """Return the key ``noise``."""
    return {
        "position_m": lack_of_fit.noise.position,
        "along_axes_m": None if lack_of_fit.noise.along_axes is None else list(lack_of_fit.noise.along_axes),
        "orientation_rad": lack_of_fit.noise.orientation,
        "source": lack_of_fit.noise.source,
        "residual_over_noise": lack_of_fit.ratio,
        "lack_of_fit_p_value": lack_of_fit.p_value,
    }


def _stage_documents(
    result: Judged, data: Measurements, apart: Measurements | None, seed: int
) -> dict[str, dict[str, Any]]:
    """Return ``nominal_unregistered``, ``nominal``, ``before`` and ``after``."""
    residuals, holdout = result.residuals, result.holdout
    groups, used = places(data), result.fit.inliers
    fitted = (residuals.unregistered, residuals.nominal, residuals.before, residuals.after)
    held_out: tuple[Array | None, ...] = (
        residuals.unregistered,
        residuals.held_out_nominal,
        residuals.held_out_before,
        residuals.held_out_after,
    )
    held_out_groups, held_out_used = groups, used
    if holdout is not None and apart is not None:
        held_out = (holdout.unregistered, holdout.nominal, holdout.before, holdout.after)
        held_out_groups, held_out_used = places(apart), np.ones(apart.n, dtype=bool)
    stages = {
        "nominal_unregistered": result.nominal_unregistered,
        "nominal": result.nominal,
        "before": result.before,
        "after": result.after,
    }
    return {
        name: stage_document(
            stage,
            ErrorRows(errors, used, groups),
            None if held_out_errors is None else ErrorRows(held_out_errors, held_out_used, held_out_groups),
            seed,
        )
        for (name, stage), errors, held_out_errors in zip(stages.items(), fitted, held_out, strict=True)
    }


def _causes_document(causes: Sequence[ErrorCause]) -> list[dict[str, Any]]:
    """Return the key ``causes``."""
    return [
        {
            "effect": cause.effect,
            "joints": list(cause.joints),
            "settings": cause.settings,
            "declared": cause.declared,
            "size_at_tool_m": cause.size,
            "low_m": cause.interval[0],
            "high_m": cause.interval[1],
            "error_without_m": cause.left,
            "share": cause.share,
        }
        for cause in causes
    ]


def _gain_document(gain: Gain | None) -> dict[str, Any] | None:
    """Return the key ``gain_m``."""
    if gain is None:
        return None
    return {
        "value": gain.value,
        "low": finite(gain.low),
        "high": finite(gain.high),
        "confidence": gain.confidence,
    }


def _deflection_document(choice: DeflectionChoice | None) -> dict[str, Any] | None:
    """Return the key ``deflection``."""
    if choice is None:
        return None
    return {
        "form": choice.form,
        "difference_rms_m": choice.difference,
        "difference_whitened": choice.separation,
        "rigid_better_by": choice.gain,
        "needed": BETTER,
    }


def finite(value: float) -> float | None:
    """Return the value; None if it is not finite, which JSON has no number for."""
    return value if math.isfinite(value) else None
