"""The document of `robacc trace`."""

from __future__ import annotations

from typing import Any

from robacc.documents.fit import finite, judged_keys
from robacc.documents.poses import curve_document
from robacc.documents.statistics import parameters_document
from robacc.effects.baseline import Baseline
from robacc.fitting.undeclared_load import UndeclaredLoad
from robacc.measurements import Measurements
from robacc.robots.description import Robot
from robacc.tracing.findings import Finding
from robacc.tracing.search import Ranked
from robacc.tracing.trace_result import Trace


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
