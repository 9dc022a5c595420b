"""The documents of `robacc calibrate` and `robacc trace`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.stages import Gain, Residuals
from robacc.calibration import Calibration
from robacc.documents.poses import curve_document, pose_document, robot_document
from robacc.documents.stages import ErrorRows, stage_document
from robacc.documents.statistics import parameters_document
from robacc.effects.baseline import Baseline
from robacc.fitting.deflection_model import BETTER, DeflectionChoice
from robacc.fitting.fit_repeatability import Repeatability
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
        "noise": _noise(calibration.noise),
        **_stages(calibration, calibration.fit, data, apart, seed),
        "gain_m": _gain(calibration.gain),
        "n_folds": calibration.n_folds,
        "effects": [
            {"effect": effect.name, "joints": list(effect.joints), **effect.settings()}
            for effect in calibration.effects
        ],
        "parameters": parameters_document(calibration.parameters),
        "priors": _priors(calibration.fit),
        "repeatability": _repeatability(calibration.repeatability),
        "converged": calibration.fit.converged,
        "shrinkage": [_kind(kind) for kind in calibration.shrunk],
        "deflection": _deflection(calibration.deflection),
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
        **_pose_keys(calibration, calibration.fit, data, robot, apart),
    }


def trace_payload(
    trace: Trace, data: Measurements, robot: Robot, apart: Measurements | None = None, seed: int = 0
) -> dict[str, Any]:
    """Return the keys of ``robacc.trace/2``.

    Args:
        trace: The result.
        data: Calibration poses.
        robot: The nominal model.
        apart: Held-out poses, where they come from a file of their own.
        seed: Seed of the resampling behind intervals.
    """
    return {
        "n_poses": data.n,
        "verdict": trace.verdict,
        "assumption": trace.assumption,
        "noise": _noise(trace.noise),
        **_stages(trace, trace.final, data, apart, seed),
        "gain_m": _gain(trace.gain),
        "n_folds": trace.n_folds,
        "findings": [_finding(finding) for finding in trace.findings],
        "deflection": _deflection(trace.deflection),
        "priors": _priors(trace.final),
        "converged": trace.final.converged,
        "repeatability": _repeatability(trace.repeatability),
        "explained_share": trace.explained_share,
        "unexplained": {
            "rms_m": trace.unexplained.rms,
            "noise_rms_m": trace.unexplained.noise_rms,
            "structured": trace.unexplained.structured,
            "p_value": trace.unexplained.p_value,
            "hints": list(trace.unexplained.hints),
        },
        "parameters": parameters_document(trace.parameters),
        "candidates": [
            {
                "step": i,
                "action": step.action,
                "effect": step.chosen,
                "ranking": [_ranked(candidate) for candidate in step.ranking],
            }
            for i, step in enumerate(trace.steps)
        ],
        "next_poses": [
            {"text": advice.text, "q": [list(q) for q in advice.q], "difference_m": list(advice.difference)}
            for advice in trace.next_poses
        ],
        "not_offered": [{"effect": name, "why": why} for name, why in trace.missing.items()],
        "detection_limits": [
            {
                "effect": limit.effect,
                "joints": list(limit.joints),
                "settings": limit.settings,
                "limit": limit.limit,
                "unit": limit.unit,
                "rms_m": limit.rms,
            }
            for limit in trace.detection
        ],
        "outliers": [{"line": data.line(int(i))} for i in trace.final.outliers],
        "warnings": list(trace.warnings),
        **_pose_keys(trace, trace.final, data, robot, apart),
    }


def _pose_keys(
    result: Calibration | Trace, fit: Fit, data: Measurements, robot: Robot, apart: Measurements | None
) -> dict[str, Any]:
    """Return the robot and the residuals of every pose, which charts need."""

    def poses(rows: Measurements, residuals: Residuals, used: NDArray[np.bool_] | None) -> dict[str, Any]:
        return pose_document(rows, rows.position - residuals.nominal[:3], residuals, used)

    return {
        "robot": robot_document(robot, data.q),
        "poses": poses(data, result.residuals, fit.inliers),
        "poses_apart": None if apart is None or result.holdout is None else poses(apart, result.holdout, None),
    }


def baseline_payload(baseline: Baseline) -> dict[str, Any]:
    """Return the key ``declared``."""
    return {
        "effects": list(baseline.names),
        "by_default": baseline.by_default,
        "left_out": [{"effect": name, "why": why} for name, why in baseline.left_out],
    }


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        "effect": finding.effect,
        "joints": list(finding.joints),
        "settings": finding.settings,
        "alternatives": [
            {
                "effect": rival.effect,
                "joints": list(rival.joints),
                "similarity": rival.similarity,
                "evidence_difference": rival.evidence_difference,
                "settings": rival.settings,
                "within_uncertainty": rival.within_uncertainty,
            }
            for rival in finding.alternatives
        ],
        "p_value": _number(finding.p_value),
        "evidence": _number(finding.evidence),
        "size_at_tool_m": finding.size_at_tool,
        "largest_at_tool_m": finding.largest_at_tool,
        "held_out_before_m": finding.held_out_before,
        "held_out_after_m": finding.held_out_after,
        "stability": {"folds": finding.stability[0], "of": finding.stability[1]},
        "parameters": parameters_document(finding.parameters),
        "harmonics": [
            {
                "order": harmonic.order,
                "amplitude_rad": harmonic.amplitude,
                "amplitude_std_rad": harmonic.amplitude_std,
                "phase_rad": harmonic.phase,
                "phase_std_rad": harmonic.phase_std,
                "origin": harmonic.origin,
                "aliases": list(harmonic.aliases),
            }
            for harmonic in finding.harmonics
        ],
        "statement": finding.statement,
        "change": _change(finding),
        "validity": {name: [low, high] for name, low, high in finding.validity},
        "partial_residuals": [curve_document(curve) for curve in finding.partial_residuals],
        "implausible": finding.implausible,
        "warnings": list(finding.warnings),
    }


def _change(finding: Finding) -> dict[str, Any] | None:
    if finding.change is None:
        return None
    place, low, high = finding.change
    return {"at": place, "low": low, "high": high, "unit": "s" if "from_time_s" in finding.settings else "line"}


def _ranked(candidate: Ranked) -> dict[str, Any]:
    effect = candidate.candidate.effect
    return {
        "effect": effect.name,
        "joints": list(effect.joints),
        "settings": effect.settings(),
        "evidence": candidate.evidence,
        "log_prior": candidate.log_prior,
        "p_value": candidate.p_value,
        "explained": candidate.gain,
    }


def _priors(fit: Fit) -> list[dict[str, Any]]:
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


def _repeatability(repeatability: Repeatability | None) -> dict[str, Any] | None:
    if repeatability is None:
        return None
    return {
        "joints": dict(repeatability.joints),
        "position_m": repeatability.position,
        "pose_position_m": repeatability.pose_position,
        "source": repeatability.source,
    }


def _noise(lack_of_fit: LackOfFit) -> dict[str, Any]:
    return {
        "position_m": lack_of_fit.noise.position,
        "orientation_rad": lack_of_fit.noise.orientation,
        "source": lack_of_fit.noise.source,
        "residual_over_noise": lack_of_fit.ratio,
        "lack_of_fit_p_value": lack_of_fit.p_value,
    }


def _stages(
    result: Calibration | Trace, fit: Fit, data: Measurements, apart: Measurements | None, seed: int
) -> dict[str, dict[str, Any]]:
    """Return ``nominal_unregistered``, ``nominal``, ``before`` and ``after``."""
    residuals, holdout = result.residuals, result.holdout
    groups, used = data.groups(), fit.inliers
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
        held_out_groups, held_out_used = apart.groups(), np.ones(apart.n, dtype=bool)
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
        "width": kind.std,
        "constants": [
            {"name": name, "probability": probability}
            for name, probability in zip(kind.names, kind.probability, strict=True)
        ],
    }


def _deflection(choice: DeflectionChoice | None) -> dict[str, Any] | None:
    if choice is None:
        return None
    return {
        "form": choice.form,
        "difference_rms_m": choice.difference,
        "difference_whitened": choice.separation,
        "rigid_better_by": choice.gain,
        "needed": BETTER,
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


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
