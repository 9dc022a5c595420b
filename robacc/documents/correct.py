"""Keys of ``robacc.correct/1`` in m and rad, the corrected poses, and the targets as CSV."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from robacc.accuracy.pose_errors import ErrorMetrics
from robacc.correction.correction import Correction, ExpectedErrors, grade_counts
from robacc.documents.envelope import csv_cell, csv_text
from robacc.documents.parts import rounded
from robacc.geometry import Array, Poses, quaternion_from_rotation
from robacc.measurements import Measurements
from robacc.quantities import number_text
from robacc.robots.description import Robot

Document = dict[str, Any]


def payload(result: Correction, given: Measurements, model: Robot) -> Document:
    """Return the keys of a correction; arrays stay arrays, with targets first."""
    targets, oriented = result.targets, result.targets.wanted.oriented
    limits = result.limits
    return {
        "n_targets": result.n_targets,
        "n_corrected": result.n_corrected,
        "n_refused": result.n_targets - result.n_corrected,
        "refused": {cause.value: count for cause, count in result.causes.items()},
        "frame": targets.pair.frame,
        "given": targets.wanted.given,
        "model": model.name,
        "joints": [{"name": joint.name, "type": joint.type} for joint in model.variables],
        "limit": {
            "position_m": limits.position,
            "orientation_rad": limits.orientation,
            "source": result.limits_source,
        },
        "weight_m_per_rad": limits.weight if len(model.variables) < 6 and oriented else None,
        "correction": {
            "position": _extent(result.correction_metrics.position, "m"),
            "orientation": _extent(result.correction_metrics.orientation, "rad") if oriented else None,
        },
        "expected": {
            "before": _expected(result, result.before, oriented),
            "after": _expected(result, result.after, oriented),
        },
        "scale": result.scale.name,
        "targets": _targets(result, given),
        "notes": list(result.notes),
    }


def _extent(metrics: ErrorMetrics | None, unit: str) -> Document | None:
    """Return RMS and largest length; None without any."""
    if metrics is None or math.isnan(metrics.max):
        return None
    return {f"rms_{unit}": metrics.rms, f"max_{unit}": metrics.max}


def _expected(result: Correction, errors: ExpectedErrors, oriented: bool) -> Document:
    """Return the expected errors of the corrected targets together."""

    def part(length: Array, rms: Array | None, bound: Array | None, unit: str) -> Document | None:
        extent = _extent(result.metrics(length), unit)
        if extent is None:
            return None
        return {
            **extent,
            f"expected_rms_{unit}": None if rms is None else result.metrics(rms).rms,
            f"largest_bound95_{unit}": None if bound is None else result.metrics(bound).max,
        }

    grades = None
    if errors.grades is not None:
        chosen = result.targets.is_corrected
        grades = dict(grade_counts(result.scale, [g for g, c in zip(errors.grades, chosen, strict=True) if c]))
    return {
        "position": part(errors.position, errors.position_rms, errors.position_bound, "m"),
        "orientation": part(errors.orientation, _orientation_rms(errors), errors.orientation_bound, "rad")
        if oriented
        else None,
        "grades": grades,
    }


def _targets(result: Correction, given: Measurements) -> Document:
    """Return columns with an entry for each target."""
    targets = result.targets
    wanted, command = framed_poses(result)
    return {
        "line": [given.line(i) for i in range(given.n)],
        "pose": None if given.pose is None else [str(name) for name in given.pose],
        "target": None if given.target is None else [str(name) for name in given.target],
        "corrected": targets.is_corrected,
        "cause": [None if refusal is None else refusal.cause.value for refusal in targets.refusals],
        "reason": [None if refusal is None else refusal.reason for refusal in targets.refusals],
        "q_nominal": rounded(targets.wanted.q),
        "q": rounded(targets.q),
        "wanted_m": rounded(wanted.translation),
        "wanted_quaternion": rounded(quaternion_from_rotation(wanted.rotation)),
        "command_m": rounded(command.translation),
        "command_quaternion": rounded(quaternion_from_rotation(command.rotation)),
        "correction_m": rounded(targets.correction[:3]),
        "correction_rad": rounded(targets.correction[3:]),
        "error_before_m": rounded(targets.error_before[:3]),
        "error_before_rad": rounded(targets.error_before[3:]),
        "error_after_m": rounded(targets.error_after[:3]),
        "error_after_rad": rounded(targets.error_after[3:]),
        "before": _bounds(result.before),
        "after": _bounds(result.after),
    }


def _bounds(errors: ExpectedErrors) -> Document:
    return {
        "rms_m": errors.position_rms,
        "rms_rad": _orientation_rms(errors),
        "bound95_m": errors.position_bound,
        "bound95_rad": errors.orientation_bound,
        "grade": None if errors.grades is None else list(errors.grades),
    }


def _orientation_rms(errors: ExpectedErrors) -> Array | None:
    return errors.orientation_rms if errors.orientation_is_known else None


def framed_poses(result: Correction) -> tuple[Poses, Poses]:
    """Return wanted and commanded poses in the frame of the Cartesian targets."""
    pair = result.targets.pair
    return pair.from_measuring(result.targets.wanted.poses), pair.from_measuring(result.targets.command)


def corrected_poses(result: Correction, given: Measurements) -> Measurements:
    """Return the targets with their corrected joints, and the wanted poses as commanded poses."""
    wanted, _ = framed_poses(result)
    return dataclasses.replace(
        given,
        position=np.zeros((3, given.n)),
        rotation=None,
        q=result.targets.q,
        commanded_position=wanted.translation,
        commanded_rotation=wanted.rotation if result.targets.wanted.oriented else None,
        sigma_position=None,
        sigma_rotation=None,
        payload=result.targets.data.payload,
        temperature=result.targets.data.temperature,
        time=result.targets.data.time,
    )


def per_target_csv(result: Correction, given: Measurements) -> str:
    """Return a CSV row for each target: its line and ids, the command, the correction and the expected errors."""
    targets = result.targets
    _, command = framed_poses(result)
    columns: dict[str, Iterable[str]] = {"line": (str(given.line(i)) for i in range(given.n))}
    for name, ids in (("pose", given.pose), ("target", given.target)):
        if ids is not None:
            columns[name] = (csv_cell(str(value)) for value in ids)
    columns["corrected"] = ("yes" if refusal is None else "no" for refusal in targets.refusals)
    numbers = _number_columns(("command_x_m", "command_y_m", "command_z_m"), command.translation)
    names = ("command_qw", "command_qx", "command_qy", "command_qz")
    numbers |= _number_columns(names, quaternion_from_rotation(command.rotation))
    numbers |= _number_columns(("dx_m", "dy_m", "dz_m", "drx_rad", "dry_rad", "drz_rad"), targets.correction)
    for stage, errors in (("before", result.before), ("after", result.after)):
        numbers[f"{stage}_m"], numbers[f"{stage}_rad"] = errors.position, errors.orientation
        numbers[f"{stage}_rms_m"] = errors.position_rms
        if errors.orientation_is_known:
            numbers[f"{stage}_rms_rad"] = errors.orientation_rms
        for unit, bound in (("m", errors.position_bound), ("rad", errors.orientation_bound)):
            if bound is not None:
                numbers[f"{stage}_bound95_{unit}"] = bound
    columns |= {name: map(number_text, values.tolist()) for name, values in numbers.items()}
    for stage, errors in (("before", result.before), ("after", result.after)):
        if errors.grades is not None:
            columns[f"{stage}_grade"] = errors.grades
    columns["reason"] = ("" if refusal is None else csv_cell(refusal.reason) for refusal in targets.refusals)
    return csv_text(columns)


def _number_columns(names: tuple[str, ...], values: Array) -> dict[str, Array]:
    return dict(zip(names, values, strict=True))
