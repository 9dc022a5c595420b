"""Keys of ``robacc.plan/1`` in m and rad."""

from __future__ import annotations

import dataclasses
from hashlib import sha256
from typing import Any

from robacc.documents.parts import robot_document, rounded
from robacc.planning.campaign import CampaignPlan
from robacc.planning.candidates import targets_in_base
from robacc.planning.expected import AccuracyPoint
from robacc.robots.description import Frame


def payload(plan: CampaignPlan, csv: str) -> dict[str, Any]:
    """Return the keys of a plan; ``csv`` is the file of the visits."""
    collisions, sight = plan.settings.constraints.collisions, plan.settings.constraints.sight
    noise, route, accuracy, worth = plan.noise, plan.route, plan.accuracy, plan.worth
    detectability, sufficiency = plan.detectability, plan.sufficiency
    in_base = dataclasses.replace(plan.robot, base=Frame())
    visits = plan.visits()
    assert visits.pose is not None
    assert visits.direction is not None
    assert visits.speed is not None
    return {
        "purpose": plan.settings.purpose,
        "criterion": plan.settings.criterion if plan.settings.purpose == "calibrate" else None,
        "n_poses": int(plan.chosen.size),
        "n_visits": len(route.roles),
        "fit": plan.settings.fit,
        "candidates": {
            "source": plan.candidates.source,
            "drawn": plan.candidates.n_drawn,
            "feasible": plan.candidates.n_poses,
            "excluded": [dataclasses.asdict(entry) for entry in plan.candidates.excluded],
        },
        "collisions": None
        if collisions is None
        else {
            "pairs": [[collisions.shapes[i].link for i in pair] for pair in collisions.pairs],
            "overlapping": [list(pair) for pair in collisions.overlapping],
        },
        "noise": {
            "position_m": noise.position,
            "orientation_rad": noise.orientation,
            "repeatability_joints": noise.joints,
            "repeatability_m": plan.repeatability,
            "unexplained_m": noise.unexplained,
            "source": noise.source,
        },
        "visits": {
            "pose": [str(name) for name in visits.pose],
            "role": list(route.roles),
            "q": rounded(plan.q),
            "direction": visits.direction.T.astype(int),
            "speed": rounded(visits.speed),
            "payload_kg": plan.payload_kg,
            "target_in_base_m": rounded(plan.candidates.position[:, plan.chosen[route.visits]]),
        },
        "route": {
            "passes": route.passes,
            "length": route.length,
            "random_length": route.random_length,
            "rarer_direction_share": route.direction_share,
            "speed_std": route.speed_std,
            "drift_share": route.drift_share,
            "repeats": route.roles.count("repeat"),
            "checks": route.roles.count("check"),
        },
        "payloads": [
            {
                "payload_kg": block.payload,
                "first_visit": block.first,
                "n_visits": block.n_visits,
                "n_poses": block.n_poses,
            }
            for block in plan.payload_blocks
        ],
        "validation": None
        if plan.validation is None
        else {
            "q": rounded(plan.validation),
            "payload_kg": plan.validation_payload,
            "target_in_base_m": rounded(targets_in_base(plan.robot, plan.validation)),
        },
        "instrument_in_base_m": None if sight is None else list(sight.position),
        "robot": robot_document(in_base, plan.q),
        "coefficients": [dataclasses.asdict(entry) for entry in plan.coefficients],
        "correlations": [dataclasses.asdict(pair) for pair in plan.correlations],
        "accuracy": None
        if accuracy is None
        else {
            "planned": None if accuracy.planned is None else _point(accuracy.planned),
            "curve": [_point(point) for point in accuracy.points],
            "knee": accuracy.knee,
        },
        "worth": None
        if worth is None
        else {
            "new_poses_rms_m": worth.new_poses,
            "repeated_poses_rms_m": worth.repeated_poses,
            "readings_rms_m": worth.readings,
            "verdict": worth.verdict,
        },
        "detection_limits": None
        if detectability is None
        else [
            {
                "effect": limit.effect,
                "joints": list(limit.joints),
                "settings": limit.settings,
                "limit": limit.limit,
                "unit": limit.unit,
                "usual_size": limit.usual,
                "power": limit.power,
                "rms_m": limit.rms,
            }
            for limit in detectability.limits
        ],
        "inseparable": None if detectability is None else [dataclasses.asdict(pair) for pair in detectability.pairs],
        "not_testable": None if detectability is None else detectability.missing,
        "power": None
        if plan.power is None or plan.random_power is None
        else {
            "found": plan.power.detected,
            "separated": plan.power.separated,
            "random_found": plan.random_power.detected,
            "random_separated": plan.random_power.separated,
        },
        "needed_poses": [
            {
                "name": entry.demand.label,
                "statistic": entry.demand.statistic,
                "limit_m": entry.demand.limit,
                "confidence": entry.demand.confidence,
                "true_over_limit": entry.ratio,
                "n_poses": entry.poses,
                "by_ratio": [{"true_over_limit": ratio, "n_poses": number} for ratio, number in entry.by_ratio],
            }
            for entry in plan.needed
        ],
        "sufficiency": None
        if sufficiency is None
        else {
            "n_already": sufficiency.n,
            "enough": sufficiency.enough,
            "why": sufficiency.why,
            "now_m": sufficiency.now,
            "later_m": sufficiency.later,
            "of_model": sufficiency.of_model,
        },
        "file_sha256": sha256(csv.encode()).hexdigest(),
    }


def _point(point: AccuracyPoint) -> dict[str, Any]:
    return {
        "n_poses": point.n,
        "rms_m": point.rms,
        "worst_m": point.worst,
        "total_rms_m": point.total,
        "random_rms_m": point.random_rms,
    }
