"""Keys of ``robacc.predict/1`` in m and rad, and the prediction of every pose as CSV."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from robacc.documents.parts import parameters_document, robot_document, rounded
from robacc.prediction.comparison import ChiSquare, MeasuredComparison
from robacc.prediction.components import VarianceComponents
from robacc.prediction.model_uncertainty import Coverage
from robacc.prediction.predicting import Allocation, PredictedErrors, Prediction, Share
from robacc.prediction.warranty_map import WarrantyMap, warranty_map
from robacc.quantities import number_text
from robacc.robots.arm import build_chain
from robacc.robots.description import Robot


def payload(
    prediction: Prediction,
    allocation: Allocation | None = None,
    comparison: MeasuredComparison | None = None,
    coverage: Sequence[Coverage] = (),
) -> dict[str, Any]:
    """Return the keys of the prediction; arrays stay arrays, which :mod:`robacc.io.json_text` writes."""
    return {
        "n_poses": prediction.configurations.n,
        "frame": "tool",
        "configurations": prediction.configurations.source,
        "tolerances": {
            "meaning": prediction.meaning,
            "parameters": [
                {"parameter": p.name, "joint": p.joint, "kind": p.kind, "sd": p.sd, "unit": p.unit}
                for p in prediction.parameters
            ],
        },
        "position": _errors(prediction.position),
        "orientation": _errors(prediction.orientation),
        "budget": [_share(share, "parameter") for share in prediction.budget],
        "budget_by_joint": [_share(share, "name") for share in prediction.by_joint],
        "budget_by_kind": [_share(share, "name") for share in prediction.by_kind],
        "grade": _grade(prediction),
        "allocation": None if allocation is None else _allocation(allocation),
        "against": None if comparison is None else _comparison(comparison),
        "coverage": _coverage(coverage),
        "notes": prediction.notes,
    }


def pose_payload(prediction: Prediction, robot: Robot) -> dict[str, Any]:
    """Return the keys for charts: the robot's outline, and the poses of the prediction."""
    configurations = prediction.configurations
    reached = build_chain(robot).poses(configurations.scalars, configurations.n)
    voxels = warranty_map(prediction, reached.translation) if prediction.is_calibrated else None
    return {
        "warranty_map": None if voxels is None else _voxels(voxels),
        "robot": robot_document(robot, configurations.q),
        "poses": {
            "label": [configurations.label(i) for i in range(configurations.n)],
            "q": rounded(configurations.q),
            "commanded_m": rounded(reached.translation),
        },
    }


def _voxels(voxels: WarrantyMap) -> dict[str, Any]:
    return {
        "voxel_m": voxels.edge,
        "centre_m": rounded(voxels.centre),
        "configurations": voxels.count,
        "bound95_m": voxels.bound[0],
        "bound95_rad": voxels.bound[1],
        "grade": voxels.grades,
    }


def per_pose_csv(prediction: Prediction, joint_names: Sequence[str]) -> str:
    """Return a CSV row for each pose: its label, joint variables and predicted errors (m, rad, tool frame)."""
    configurations = prediction.configurations
    header = ["pose", *joint_names]
    columns: list[list[str]] = [[configurations.label(i) for i in range(configurations.n)]]
    columns += [[number_text(value) for value in row] for row in configurations.q.tolist()]
    for errors in (prediction.position, prediction.orientation):
        unit = errors.unit
        header += [f"rms_{unit}", f"radius95_{unit}"]
        rows = [errors.pose_rms, errors.pose_radius95]
        for i, first in enumerate("xyz"):
            for j, second in list(enumerate("xyz"))[i:]:
                header.append(f"v_{first}{second}_{unit}2")
                rows.append(errors.covariance[i, j])
        columns += [[number_text(value) for value in row.tolist()] for row in rows]
    lines = [",".join(header), *(",".join(row) for row in zip(*columns, strict=True))]
    return "\n".join(lines) + "\n"


def _errors(errors: PredictedErrors) -> dict[str, Any]:
    unit = errors.unit
    worst = errors.worst
    percentiles = errors.percentiles()
    return {
        f"rms_{unit}": errors.rms,
        f"mean_error_{unit}": errors.mean_error,
        f"p95_{unit}": errors.p95,
        f"max_radius95_{unit}": errors.max,
        f"mean_covariance_{unit}2": errors.mean_covariance,
        "percentiles_over_poses": {
            f"rms_{unit}": {f"p{percent}": rms for percent, (rms, _) in percentiles.items()},
            f"radius95_{unit}": {f"p{percent}": radius for percent, (_, radius) in percentiles.items()},
        },
        "worst": {
            "pose": worst.index,
            "label": worst.label,
            "q": worst.q,
            f"rms_{unit}": worst.rms,
            f"radius95_{unit}": worst.radius95,
            "direction": worst.direction,
            f"sd_{unit}": worst.sd,
        },
        f"covariance_{unit}2": np.moveaxis(errors.covariance, -1, 0),
        f"pose_rms_{unit}": errors.pose_rms,
        f"pose_radius95_{unit}": errors.pose_radius95,
    }


def _share(share: Share, name: str) -> dict[str, Any]:
    record: dict[str, Any] = {name: share.name}
    if name == "parameter":
        record |= {"joint": share.joint, "kind": share.kind, "sd": share.tolerance, "unit": share.unit}
    return record | {"share_position": share.position, "share_orientation": share.orientation}


def _grade(prediction: Prediction) -> dict[str, Any]:
    grade = prediction.grade
    return {
        "grade": grade.grade,
        "scale": grade.scale.name,
        "statistic": grade.scale.statistic,
        "position": grade.position,
        "orientation": grade.orientation,
        "limited_by": grade.limited_by,
        "demonstrated": False,
        "share_of_poses_meeting": dict(grade.meeting),
    }


def _allocation(allocation: Allocation) -> dict[str, Any]:
    verified = allocation.verified
    return {
        "grade": allocation.grade,
        "met": allocation.met,
        "uniform_factor": allocation.uniform_factor,
        "tolerances": [
            {
                "parameter": item.parameter.name,
                "joint": item.parameter.joint,
                "given_sd": item.parameter.sd,
                "needed_sd": item.needed,
                "factor": item.factor,
                "unit": item.parameter.unit,
            }
            for item in allocation.needed
        ],
        "verified": {
            "grade": verified.grade.grade,
            "position": {"rms_m": verified.position.rms, "p95_m": verified.position.p95},
            "orientation": {"rms_rad": verified.orientation.rms, "p95_rad": verified.orientation.p95},
        },
    }


def _comparison(comparison: MeasuredComparison) -> dict[str, Any]:
    evidence, consistency = comparison.statistics, comparison.consistency
    noise = evidence.noise
    alignment = comparison.alignment
    return {
        "n_poses": comparison.n_poses,
        "measured": {"position_rms_m": comparison.position_rms, "orientation_rms_rad": comparison.orientation_rms},
        "alignment": None
        if alignment is None
        else {
            "what": alignment.effects,
            "degrees_of_freedom": evidence.n_aligned,
            "parameters": parameters_document(alignment.parameters),
        },
        "noise": {
            "position_m": noise.position,
            "orientation_rad": noise.orientation,
            "source_position": noise.source_position,
            "source_orientation": noise.source_orientation,
        },
        "verdict": consistency.verdict,
        "hint": comparison.hint,
        "normalised_squared_error": {
            "total": _chi_square(consistency.total),
            "parameters": _chi_square(consistency.parameters),
            "noise": _chi_square(consistency.noise),
        },
        "likelihood_ratio": None if consistency.scale is None else dataclasses.asdict(consistency.scale),
        "variance_components": None if comparison.components is None else _components(comparison.components),
        "one_draw": comparison.one_draw,
    }


def _coverage(coverage: Sequence[Coverage]) -> dict[str, Any] | None:
    if not coverage:
        return None
    shares: dict[str, Any] = {
        item.quantity: {
            "n_poses": item.n_poses,
            "n_inside": item.n_inside,
            "share": item.share,
            "noise_source": item.noise_source,
        }
        for item in coverage
    }
    first = coverage[0]
    return {"probability": first.probability, "registered": first.registered, "orientation": None, **shares}


def _chi_square(test: ChiSquare | None) -> dict[str, Any] | None:
    return None if test is None else {**dataclasses.asdict(test), "ratio": test.ratio}


def _components(components: VarianceComponents) -> dict[str, Any]:
    return {
        "confidence": components.confidence,
        "components": [dataclasses.asdict(component) for component in components.components],
        "notes": components.notes,
    }
