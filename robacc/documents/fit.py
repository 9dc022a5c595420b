"""The documents of `robacc calibrate` and `robacc trace`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.stages import Gain, Residuals
from robacc.calibration import Calibration
from robacc.documents.parameters import parameters_document
from robacc.documents.poses import curve_document, pose_document, robot_document
from robacc.documents.stages import Errors, stage_document
from robacc.fitting.deflection_model import BETTER, DeflectionChoice
from robacc.fitting.identifiability import Identifiability
from robacc.fitting.noise import LackOfFit
from robacc.fitting.solver import Fit
from robacc.fitting.sparse_prior import ShrunkKind
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.description import Robot
from robacc.tracing.candidate_scorer import Ranked
from robacc.tracing.findings import Finding
from robacc.tracing.trace import Trace


def calibration_payload(
    found: Calibration, data: Measurements, robot: Robot, apart: Measurements | None = None, seed: int = 0
) -> dict[str, Any]:
    """Keys of ``robacc.calibrate/2``: ``robot`` as delivered, ``apart`` the poses held out, where they are others.

    ``seed`` is of what intervals draw at random.
    """
    fit = found.fit
    return {
        "n_poses": data.n,
        "noise": _noise(found.noise),
        **_stages(found, found.fit, data, apart, seed),
        "gain_m": _gain(found.gain),
        "n_folds": found.n_folds,
        "effects": [{"effect": e.name, "joints": list(e.joints), **e.settings()} for e in found.effects],
        "parameters": parameters_document(found.parameters),
        "shrinkage": [_kind(kind) for kind in found.shrunk],
        "deflection": _deflection(found.deflection),
        "correlations": [{"first": c.first, "second": c.second, "correlation": c.value} for c in found.correlations],
        "chi_square": fit.chi_square,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "identifiability": _identifiability(found.identifiability),
        "outliers": [{"line": data.line(int(i))} for i in fit.outliers],
        "leverage": [{"line": data.line(i), "share": share} for i, share in found.leverage],
        "warnings": list(found.warnings),
        "partial_residuals": [
            {"name": effect.name, "joints": list(effect.joints), **curve_document(curve)}
            for effect, curve in found.partial_residuals
        ],
        **_pictured(found, found.fit, data, robot, apart),
    }


def trace_payload(
    found: Trace, data: Measurements, robot: Robot, apart: Measurements | None = None, seed: int = 0
) -> dict[str, Any]:
    """Keys of ``robacc.trace/2``: ``robot`` as delivered, ``apart`` the poses held out, where they are others.

    ``seed`` is of what intervals draw at random.
    """
    from robacc.fitting.parameters import parameters

    return {
        "n_poses": data.n,
        "verdict": found.verdict,
        "noise": _noise(found.noise),
        **_stages(found, found.final, data, apart, seed),
        "gain_m": _gain(found.gain),
        "n_folds": found.n_folds,
        "findings": [_finding(one) for one in found.findings],
        "deflection": _deflection(found.deflection),
        "unexplained": {
            "rms_m": found.unexplained.rms,
            "noise_rms_m": found.unexplained.noise_rms,
            "structured": found.unexplained.structured,
            "p_value": found.unexplained.p_value,
            "hints": list(found.unexplained.hints),
        },
        "parameters": parameters_document(parameters(found.final)),
        "candidates": [
            {"step": i, "action": step.action, "effect": step.chosen, "ranking": [_ranked(one) for one in step.ranking]}
            for i, step in enumerate(found.steps)
        ],
        "next_poses": [
            {"text": one.text, "q": [list(q) for q in one.q], "difference_m": list(one.difference)}
            for one in found.next_poses
        ],
        "not_offered": [{"effect": name, "why": why} for name, why in found.missing.items()],
        "detection_limits": [
            {
                "effect": one.effect,
                "joints": list(one.joints),
                "settings": one.settings,
                "limit": one.limit,
                "unit": one.unit,
                "rms_m": one.rms,
            }
            for one in found.detection
        ],
        "outliers": [{"line": data.line(int(i))} for i in found.final.outliers],
        "warnings": list(found.warnings),
        **_pictured(found, found.final, data, robot, apart),
    }


def _pictured(
    found: Calibration | Trace, fit: Fit, data: Measurements, robot: Robot, apart: Measurements | None
) -> dict[str, Any]:
    def poses(of: Measurements, residuals: Residuals, used: NDArray[np.bool_] | None) -> dict[str, Any]:
        return pose_document(of, of.position - residuals.nominal[:3], residuals, used)

    return {
        "robot": robot_document(robot, data.q),
        "poses": poses(data, found.residuals, fit.kept),
        "poses_apart": None if apart is None or found.apart is None else poses(apart, found.apart, None),
    }


def _finding(one: Finding) -> dict[str, Any]:
    return {
        "effect": one.effect,
        "joints": list(one.joints),
        "settings": one.settings,
        "alternatives": [
            {
                "effect": other.effect,
                "joints": list(other.joints),
                "similarity": other.similarity,
                "evidence_difference": other.evidence_difference,
                "settings": other.settings,
            }
            for other in one.alternatives
        ],
        "p_value": _number(one.p_value),
        "evidence": _number(one.evidence),
        "held_out_before_m": one.held_out_before,
        "held_out_after_m": one.held_out_after,
        "stability": {"folds": one.stability[0], "of": one.stability[1]},
        "parameters": parameters_document(one.parameters),
        "harmonics": [
            {
                "order": line.order,
                "amplitude_rad": line.amplitude,
                "amplitude_std_rad": line.amplitude_std,
                "phase_rad": line.phase,
                "phase_std_rad": line.phase_std,
            }
            for line in one.harmonics
        ],
        "validity": {name: [low, high] for name, low, high in one.validity},
        "partial_residuals": [curve_document(curve) for curve in one.partial_residuals],
        "warnings": list(one.warnings),
    }


def _ranked(one: Ranked) -> dict[str, Any]:
    effect = one.candidate.effect
    return {
        "effect": effect.name,
        "joints": list(effect.joints),
        "settings": effect.settings(),
        "evidence": one.evidence,
        "log_prior": one.log_prior,
        "p_value": one.p_value,
        "explained": one.gain,
    }


def _noise(found: LackOfFit) -> dict[str, Any]:
    return {
        "position_m": found.noise.position,
        "orientation_rad": found.noise.orientation,
        "source": found.noise.source,
        "residual_over_noise": found.ratio,
        "lack_of_fit_p_value": found.p_value,
    }


def _stages(
    found: Calibration | Trace, fit: Fit, data: Measurements, apart: Measurements | None, seed: int
) -> dict[str, dict[str, Any]]:
    """``nominal``, ``before`` and ``after``."""
    own, other = found.residuals, found.apart
    groups, used = data.groups(), fit.kept
    fitted = (own.nominal, own.before, own.after)
    held: tuple[Array | None, ...] = (own.nominal, own.held_before, own.held_after)
    held_groups, held_used = groups, used
    if other is not None and apart is not None:
        held = (other.nominal, other.before, other.after)
        held_groups, held_used = apart.groups(), np.ones(apart.n, dtype=bool)
    stages = {"nominal": found.nominal, "before": found.before, "after": found.after}
    return {
        name: stage_document(
            stage,
            Errors(one, used, groups),
            None if crossed is None else Errors(crossed, held_used, held_groups),
            seed,
        )
        for (name, stage), one, crossed in zip(stages.items(), fitted, held, strict=True)
    }


def _gain(gain: Gain | None) -> dict[str, Any] | None:
    if gain is None:
        return None
    return {
        "value": gain.value,
        "low": _number(gain.low),
        "high": _number(gain.high),
        "confidence": gain.confidence,
    }


def _kind(kind: ShrunkKind) -> dict[str, Any]:
    return {
        "unit": kind.unit,
        "width": kind.width,
        "constants": [
            {"name": name, "probability": probability}
            for name, probability in zip(kind.names, kind.probability, strict=True)
        ],
    }


def _deflection(found: DeflectionChoice | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "form": found.form,
        "difference_rms_m": found.difference,
        "difference_whitened": found.separation,
        "rigid_better_by": found.gain,
        "needed": BETTER,
    }


def _identifiability(found: Identifiability) -> dict[str, Any]:
    return {
        "n_identifiable": int(found.kept.size),
        "not_identifiable": [
            {"name": one.name, "partners": list(one.partners), "why": one.why} for one in found.dropped
        ],
        "condition_number": found.condition,
        "observability": found.observability(),
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
