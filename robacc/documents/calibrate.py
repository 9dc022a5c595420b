"""The document of `robacc calibrate`."""

from __future__ import annotations

from typing import Any

from robacc.calibration.calibrating import Calibration
from robacc.documents.fit import judged_keys
from robacc.documents.poses import curve_document
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
    return {
        **judged_keys(calibration, data, robot, apart, seed),
        "effects": [
            {"effect": effect.name, "joints": list(effect.joints), **effect.settings()}
            for effect in calibration.effects
        ],
        "shrinkage": [_kind(kind) for kind in calibration.shrunk],
        "correlations": [
            {"first": pair.first, "second": pair.second, "correlation": pair.value} for pair in calibration.correlations
        ],
        "chi_square": calibration.fit.chi_square,
        "degrees_of_freedom": calibration.fit.degrees_of_freedom,
        "identifiability": _identifiability(calibration.identifiability),
        "leverage": [{"line": data.line(i), "share": share} for i, share in calibration.leverage],
        "partial_residuals": [
            {"name": effect.name, "joints": list(effect.joints), **curve_document(curve)}
            for effect, curve in calibration.partial_residuals
        ],
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
