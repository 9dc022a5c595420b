"""The document of `robacc calibrate`."""

from __future__ import annotations

from typing import Any

from robacc.calibration.calibrating import Calibration
from robacc.documents.fit import (
    causes_document,
    deflection_document,
    gain_document,
    noise_document,
    pose_keys,
    priors_document,
    repeatability_document,
    stage_documents,
)
from robacc.documents.poses import curve_document
from robacc.documents.statistics import covariance_document, parameters_document
from robacc.fitting.identifiability import Identifiability
from robacc.fitting.sparse_prior import ShrunkKind
from robacc.measurements import Measurements
from robacc.robots.description import Robot


def calibration_payload(
    calibration: Calibration, data: Measurements, robot: Robot, apart: Measurements | None = None, seed: int = 0
) -> dict[str, Any]:
    """Return the keys of ``robacc.calibrate/2``.

    Args:
        calibration: The result.
        data: Calibration poses.
        robot: The nominal model.
        apart: Held-out poses, where they come from a file of their own.
        seed: Seed of the resampling behind intervals.
    """
    fit = calibration.fit
    return {
        "n_poses": data.n,
        "noise": noise_document(calibration.noise),
        **stage_documents(calibration, calibration.fit, data, apart, seed),
        "causes": causes_document(calibration.causes),
        "gain_m": gain_document(calibration.gain),
        "n_folds": calibration.n_folds,
        "effects": [
            {"effect": effect.name, "joints": list(effect.joints), **effect.settings()}
            for effect in calibration.effects
        ],
        "parameters": parameters_document(calibration.parameters),
        "parameter_covariance": covariance_document(calibration.covariance),
        "priors": priors_document(calibration.fit),
        "repeatability": repeatability_document(calibration.repeatability),
        "converged": calibration.fit.converged,
        "shrinkage": [_kind(kind) for kind in calibration.shrunk],
        "deflection": deflection_document(calibration.deflection),
        "correlations": [
            {"first": pair.first, "second": pair.second, "correlation": pair.value} for pair in calibration.correlations
        ],
        "chi_square": fit.chi_square,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "identifiability": _identifiability(calibration.identifiability),
        "outliers": [{"line": data.line(int(i))} for i in fit.outliers],
        "leverage": [{"line": data.line(i), "share": share} for i, share in calibration.leverage],
        "warnings": list(calibration.warnings),
        "partial_residuals": [
            {"name": effect.name, "joints": list(effect.joints), **curve_document(curve)}
            for effect, curve in calibration.partial_residuals
        ],
        **pose_keys(calibration, calibration.fit, data, robot, apart),
    }


def _kind(kind: ShrunkKind) -> dict[str, Any]:
    return {
        "unit": kind.unit,
        "width": kind.std,
        "constants": [
            {"name": name, "probability": probability}
            for name, probability in zip(kind.names, kind.probability, strict=True)
        ],
    }


def _identifiability(identifiability: Identifiability) -> dict[str, Any]:
    return {
        "n_identifiable": int(identifiability.columns.size),
        "not_identifiable": [
            {"name": parameter.name, "partners": list(parameter.partners), "why": parameter.why}
            for parameter in identifiability.dropped
        ],
        "condition_number": identifiability.condition,
        "observability": identifiability.observability(),
    }
