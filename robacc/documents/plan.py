"""Keys of ``robacc.plan/1`` in m and rad."""

from __future__ import annotations

import dataclasses
from hashlib import sha256
from typing import Any

from robacc.documents.parts import robot_document, rounded
from robacc.planning.campaign import CampaignPlan, NeededPoses, PayloadBlock
from robacc.planning.candidates import targets_in_base
from robacc.planning.collisions import LinkCollisions
from robacc.planning.expected import AccuracyPoint, ExpectedAccuracy, Sufficiency, Worth
from robacc.planning.power import Detectability
from robacc.planning.route import Route
from robacc.robots.description import Frame


def payload(plan: CampaignPlan, csv: str) -> dict[str, Any]:
    """Return the keys of a plan; ``csv`` is the file of the visits."""
    sight = plan.settings.constraints.sight
    in_base = dataclasses.replace(plan.robot, base=Frame())
    return {
        "purpose": plan.settings.purpose,
        "criterion": plan.settings.criterion if plan.settings.purpose == "calibrate" else None,
        "n_poses": int(plan.chosen.size),
        "n_visits": len(plan.route.roles),
        "fit": plan.settings.fit,
        "candidates": {
            "source": plan.candidates.source,
            "drawn": plan.candidates.n_drawn,
            "feasible": plan.candidates.n_poses,
            "excluded": [dataclasses.asdict(entry) for entry in plan.candidates.excluded],
        },
        "collisions": _collisions(plan.settings.constraints.collisions),
        "noise": {
            "position_m": plan.noise.position,
            "orientation_rad": plan.noise.orientation,
            "repeatability_joints": plan.noise.joints,
            "repeatability_m": plan.repeatability,
            "unexplained_m": plan.noise.unexplained,
            "source": plan.noise.source,
        },
        "visits": _visits(plan),
        "route": _route(plan.route),
        "payloads": [_payload_block(block) for block in plan.payload_blocks],
        "validation": _validation(plan),
        "instrument_in_base_m": None if sight is None else list(sight.position),
        "robot": robot_document(in_base, plan.q),
        "coefficients": [dataclasses.asdict(entry) for entry in plan.coefficients],
        "correlations": [dataclasses.asdict(pair) for pair in plan.correlations],
        "accuracy": None if plan.accuracy is None else _accuracy(plan.accuracy),
        "worth": None if plan.worth is None else _worth(plan.worth),
        **_detectability(plan.detectability),
        "power": _power(plan),
        "needed_poses": [_needed(entry) for entry in plan.needed],
        "sufficiency": None if plan.sufficiency is None else _sufficiency(plan.sufficiency),
        "file_sha256": sha256(csv.encode()).hexdigest(),
    }


def _collisions(collisions: LinkCollisions | None) -> dict[str, Any] | None:
    """Return the pairs of links that are checked, and those that overlap; None without a check."""
    if collisions is None:
        return None
    return {
        "pairs": [[collisions.shapes[i].link for i in pair] for pair in collisions.pairs],
        "overlapping": [list(pair) for pair in collisions.overlapping],
    }


def _visits(plan: CampaignPlan) -> dict[str, Any]:
    """Return the visits in order, in m and rad."""
    visits = plan.visits()
    assert visits.pose is not None
    assert visits.direction is not None
    assert visits.speed is not None
    return {
        "pose": [str(name) for name in visits.pose],
        "role": list(plan.route.roles),
        "q": rounded(plan.q),
        "direction": visits.direction.T.astype(int),
        "speed": rounded(visits.speed),
        "payload_kg": plan.payload_kg,
        "target_in_base_m": rounded(plan.candidates.position[:, plan.chosen[plan.route.visits]]),
    }


def _payload_block(block: PayloadBlock) -> dict[str, float]:
    """Return the visits with one payload."""
    return {
        "payload_kg": block.payload,
        "first_visit": block.first,
        "n_visits": block.n_visits,
        "n_poses": block.n_poses,
    }


def _validation(plan: CampaignPlan) -> dict[str, Any] | None:
    """Return the validation poses, in m and rad; None without any."""
    if plan.validation is None:
        return None
    return {
        "q": rounded(plan.validation),
        "payload_kg": plan.validation_payload,
        "target_in_base_m": rounded(targets_in_base(plan.robot, plan.validation)),
    }


def _worth(worth: Worth) -> dict[str, Any]:
    """Return the predicted errors of more measurements, m rms."""
    return {
        "new_poses_rms_m": worth.new_poses,
        "repeated_poses_rms_m": worth.repeated_poses,
        "readings_rms_m": worth.readings,
        "verdict": worth.verdict,
    }


def _sufficiency(sufficiency: Sufficiency) -> dict[str, Any]:
    """Return whether the poses measured so far are enough, with the predicted errors, m."""
    return {
        "n_already": sufficiency.n,
        "enough": sufficiency.enough,
        "why": sufficiency.why,
        "now_m": sufficiency.now,
        "later_m": sufficiency.later,
        "of_model": sufficiency.of_model,
    }


def _route(route: Route) -> dict[str, Any]:
    return {
        "passes": route.passes,
        "length": route.length,
        "random_length": route.random_length,
        "rarer_direction_share": route.direction_share,
        "speed_std": route.speed_std,
        "drift_share": route.drift_share,
        "repeats": route.roles.count("repeat"),
        "checks": route.roles.count("check"),
    }


def _accuracy(accuracy: ExpectedAccuracy) -> dict[str, Any]:
    return {
        "planned": None if accuracy.planned is None else _point(accuracy.planned),
        "curve": [_point(point) for point in accuracy.points],
        "knee": accuracy.knee,
    }


def _point(point: AccuracyPoint) -> dict[str, Any]:
    return {
        "n_poses": point.n,
        "rms_m": point.rms,
        "worst_m": point.worst,
        "total_rms_m": point.total,
        "random_rms_m": point.random_rms,
    }


def _detectability(detectability: Detectability | None) -> dict[str, Any]:
    if detectability is None:
        return {"detection_limits": None, "inseparable": None, "not_testable": None}
    return {
        "detection_limits": [
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
        "inseparable": [dataclasses.asdict(pair) for pair in detectability.pairs],
        "not_testable": detectability.missing,
    }


def _power(plan: CampaignPlan) -> dict[str, float] | None:
    if plan.power is None or plan.random_power is None:
        return None
    return {
        "found": plan.power.detected,
        "separated": plan.power.separated,
        "random_found": plan.random_power.detected,
        "random_separated": plan.random_power.separated,
    }


def _needed(entry: NeededPoses) -> dict[str, Any]:
    demand = entry.demand
    return {
        "name": demand.label,
        "statistic": demand.statistic,
        "limit_m": demand.limit,
        "confidence": demand.confidence,
        "true_over_limit": entry.ratio,
        "n_poses": entry.poses,
        "by_ratio": [{"true_over_limit": ratio, "n_poses": number} for ratio, number in entry.by_ratio],
    }
