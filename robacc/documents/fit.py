"""Documents of `robacc calibrate` and `robacc trace`: the keys that they share, and their own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.error_statistics import length_intervals
from robacc.accuracy.pose_errors import PoseMetrics
from robacc.accuracy.stages import Gain, Residuals, Stage
from robacc.calibration.calibrating import Calibration
from robacc.documents.parts import (
    covariance_document,
    curve_document,
    figures_document,
    interval_document,
    parameters_document,
    pose_document,
    robot_document,
)
from robacc.effects.request import Baseline
from robacc.error_model.structure import Repeatability
from robacc.fitting.fit_result import Fit, Identifiability
from robacc.fitting.masses import BETTER, DeflectionChoice, UndeclaredLoad
from robacc.fitting.priors import weak_kinds
from robacc.fitting.sparse_prior import ShrunkKind
from robacc.fitting.visits import places
from robacc.fitting.warnings import LackOfFit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.description import Robot
from robacc.statistics.intervals import Interval
from robacc.tracing.findings import Finding
from robacc.tracing.judging import ErrorCause, Judged
from robacc.tracing.search import Ranked
from robacc.tracing.trace import Trace

# Stages of a fit as parts of a JSON result: the metrics of each stage with their intervals.

CONFIDENCE = 0.95


class ErrorRows(NamedTuple):
    """Residuals behind the metrics of a stage."""

    residual: Array
    """``(3 or 6, N)`` m, rad"""
    used: NDArray[np.bool_]
    """``(N,)`` mask of the rows that are not outliers."""
    groups: NDArray[np.int64]
    """``(N,)`` number of each row's commanded pose; intervals are over poses, repetitions staying together."""


def stage_document(stage: Stage, fitted: ErrorRows, held_out: ErrorRows | None, seed: int) -> dict[str, Any]:
    """Return the metrics of one stage on calibration poses, and on held-out poses if there are any.

    Intervals on calibration poses ignore the fit to these poses; the metrics on held-out poses are the valid ones.
    """
    everything = np.ones_like(fitted.used)
    return {
        "fitted": _poses(stage.fitted, fitted._replace(used=everything), seed),
        "fitted_inliers": None if stage.fitted_inliers is None else _poses(stage.fitted_inliers, fitted, seed),
        "held_out": None
        if stage.held_out is None or held_out is None
        else _poses(stage.held_out, held_out._replace(used=np.ones_like(held_out.used)), seed),
        "held_out_inliers": None
        if stage.held_out_inliers is None or held_out is None
        else _poses(stage.held_out_inliers, held_out, seed),
    }


def _poses(figures: PoseMetrics, errors: ErrorRows, seed: int) -> dict[str, Any]:
    metrics: dict[str, Any] = {"position": None, "orientation": None}
    groups = errors.groups[errors.used]
    for name, unit, rows, quantity_metrics in (
        ("position", "m", slice(0, 3), figures.position),
        ("orientation", "rad", slice(3, 6), figures.orientation),
    ):
        if quantity_metrics is None:
            continue
        metrics[name] = {
            **figures_document(quantity_metrics, unit),
            "n_poses": int(groups.size),
            "n_commanded_poses": int(np.unique(groups).size),
            "intervals": _intervals(errors.residual[rows, errors.used], groups, unit, seed),
        }
    return metrics


def _intervals(errors: Array, groups: NDArray[np.int64], unit: str, seed: int) -> dict[str, Any]:
    if errors.shape[1] == 0:
        missing = interval_document(Interval.missing(CONFIDENCE, "no pose"))
        return {f"{name}_{unit}": missing for name in ("rms", "mean_error", "p95")}
    (by_name,) = length_intervals(errors, (CONFIDENCE,), groups=groups, seed=seed)
    return {f"{name}_{unit}": interval_document(interval) for name, interval in by_name.items()}


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
        "robot": robot_document(robot, data.q, result.fit.model.arm.robot),
        "poses": poses(data, result.residuals, result.fit.inliers),
        "poses_apart": None if apart is None or result.holdout is None else poses(apart, result.holdout, None),
    }


def _priors_document(fit: Fit) -> list[dict[str, Any]]:
    """Return the broad priors about nominal, one for each kind of constants of which some are weakly identifiable."""
    return [
        {"effect": kind.effect, "unit": kind.unit, "std": kind.std, "weakly_identifiable": list(kind.names)}
        for kind in weak_kinds(fit)
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


# The document of `robacc calibrate`.


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


# The document of `robacc trace`.


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
        "verdict": trace.verdict,
        "assumption": trace.assumption,
        **judged_keys(trace, data, robot, apart, seed),
        "findings": [_finding(finding) for finding in trace.findings],
        "undeclared_load": _undeclared_load(trace.undeclared_load),
        "explained_share": trace.explained_share,
        "unexplained": {
            "rms_m": trace.unexplained.rms,
            "noise_rms_m": trace.unexplained.noise_rms,
            "structured": trace.unexplained.structured,
            "p_value": trace.unexplained.p_value,
            "hints": list(trace.unexplained.hints),
            "parts": {f"{part}_m": size for part, size in trace.unexplained.parts.items()},
        },
        "search": {"steps": len(trace.steps), "settled": trace.settled},
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
            }
            for rival in finding.alternatives
        ],
        "p_value": finite(finding.p_value),
        "evidence": finite(finding.evidence),
        "size_at_tool_m": finding.size_at_tool,
        "largest_at_tool_m": finding.largest_at_tool,
        "held_out_before_m": finding.held_out_before,
        "held_out_after_m": finding.held_out_after,
        "held_out_before_rad": finding.held_out_turn[0],
        "held_out_after_rad": finding.held_out_turn[1],
        "turn_at_tool_rad": finding.turn_at_tool[0],
        "largest_turn_at_tool_rad": finding.turn_at_tool[1],
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


def _undeclared_load(load: UndeclaredLoad | None) -> dict[str, Any] | None:
    if load is None:
        return None
    return {
        "statement": load.statement,
        "joints": list(load.joints),
        "named": load.is_named,
        "mass_error": load.mass_error,
        "places": [
            {
                "link": place.link,
                "mass_kg": place.mass,
                "low_kg": place.low,
                "high_kg": place.high,
                "log_bayes_factor": place.log_bayes_factor,
            }
            for place in load.places
        ],
    }


def _change(finding: Finding) -> dict[str, Any] | None:
    if finding.change is None:
        return None
    place, low, high = finding.change
    return {"at": place, "low": low, "high": high, "unit": "s" if "from_time_s" in finding.settings else "line"}


def _ranked(candidate: Ranked) -> dict[str, Any]:
    effect = candidate.effect
    return {
        "effect": effect.name,
        "joints": list(effect.joints),
        "settings": effect.settings(),
        "evidence": candidate.evidence,
        "log_prior": candidate.log_prior,
        "p_value": candidate.p_value,
        "explained": candidate.gain,
    }
