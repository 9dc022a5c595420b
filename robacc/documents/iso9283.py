"""An evaluation after ISO 9283 as the keys of ``robacc.iso9283/1`` (m and rad).

Every characteristic has ``max_m``, the largest over commanded poses (of a signed one the largest size), with its
interval under ``intervals``, so that a gate's ``iso9283.RP.max`` finds both; where there is no number it is null and
``why`` says so.
"""

from __future__ import annotations

from typing import Any

from robacc.documents.statistics import interval_document, parameters_document
from robacc.geometry import quaternion_from_rotation
from robacc.iso_9283.proposal import Proposal
from robacc.iso_9283.records import Characteristic, CriterionFigure, Iso9283Result, IsoCriterion
from robacc.iso_9283.visits import CommandedPose

Document = dict[str, Any]


def payload(result: Iso9283Result) -> Document:
    """The document's own keys; arrays stay arrays, which :mod:`robacc.io.json_text` writes."""
    found = {one.symbol: one for one in result.characteristics}
    return {
        "n_poses": result.n_poses,
        "n_commanded_poses": len(result.poses),
        "files": list(result.sources),
        "commanded": result.commanded,
        "alignment": [
            {
                "what": alignment.effects,
                "n_parameters": alignment.n_parameters,
                "parameters": parameters_document(alignment.parameters),
            }
            for alignment in result.alignments
        ]
        or None,
        "unaligned": None if result.unaligned is None else {"AP_max_m": result.unaligned},
        "confidence": result.confidence,
        "iso9283": {
            "AP": _characteristic(found["AP"]),
            "RP": _characteristic(found["RP"]),
            "vAP": _characteristic(found["vAP"]),
            "AD": _characteristic(found["AD"]),
            "RD": _characteristic(found["RD"]),
            "drift": {
                "AP": _characteristic(found["dAP"]),
                "RP": _characteristic(found["dRP"]),
                "barycentre": _characteristic(found["shift"]),
            },
            "exchangeability": _characteristic(found["E"]),
        },
        "protocol": [
            {
                "condition": condition.name,
                "clause": condition.clause,
                "status": condition.status.replace(" ", "_"),
                "why": condition.why,
            }
            for condition in result.protocol
        ],
        "visits": [_visits(pose) for pose in result.poses],
        "notes": result.notes,
        "warnings": result.warnings,
    }


def proposal_payload(found: Proposal) -> Document:
    """The keys of ``robacc.iso9283-poses/1``."""
    return {
        "cube": {"edge_m": found.edge, "centre_in_base_m": found.centre, "plane_rises_towards": found.plane},
        "orientation": found.orientation,
        "target": found.target,
        "joint_margin": found.margin,
        "poses": [
            {
                "pose": f"P{i + 1}",
                "position_m": found.poses.translation[:, i],
                "quaternion": quaternion_from_rotation(found.poses.rotation[..., i]),
                "q": found.q[:, i],
            }
            for i in range(found.q.shape[1])
        ],
        "notes": list(found.notes),
    }


def _characteristic(one: Characteristic) -> Document:
    return {
        "symbol": one.symbol,
        "clause": f"ISO 9283:1998, {one.clause}",
        "max_m": one.position.value,
        "max_at": one.position_at,
        "intervals": {"max_m": interval_document(one.position.interval)},
        "why": one.position.interval.why if one.position.value is None else None,
        "orientation": {
            "max_rad": one.angle.value,
            "max_at": one.angle_at,
            "intervals": {"max_rad": interval_document(one.angle.interval)},
            "why": one.angle.interval.why if one.angle.value is None else None,
        },
        "poses": [_criterion(place) for place in one.places],
        "notes": one.notes,
    }


def _criterion(place: IsoCriterion) -> Document:
    document: Document = {
        "pose": "–".join(place.poses),
        "poses": list(place.poses),
        "file": place.source,
        "n": place.n,
        "position_m": place.position.value,
    }
    intervals: Document = {"position_m": interval_document(place.position.interval)}
    for key, figures in (("xyz_m", place.axes), ("abc_rad", place.angles)):
        document[key] = None if figures is None else [figure.value for figure in figures]
        intervals[key] = None if figures is None else [_interval(figure) for figure in figures]
    if place.mean_distance is not None:
        document |= {"mean_distance_m": place.mean_distance, "sd_distance_m": place.sd_distance}
    if place.between is not None:
        document["between"] = place.between
    return {**document, "intervals": intervals}


def _interval(figure: CriterionFigure) -> Document:
    return interval_document(figure.interval)


def _visits(pose: CommandedPose) -> Document:
    """Every visit of a commanded pose: what a picture of it needs."""
    return {
        "pose": pose.label,
        "file": pose.source,
        "n": pose.n,
        "commanded_m": pose.commanded,
        "barycentre_m": pose.attained.mean(axis=1),
        "attained_m": pose.attained.T,
        "angle_deviations_rad": None if pose.turn is None else pose.turn.T,
        "angles_about": None if pose.turn is None else ("x, y, z" if pose.at_pole else "roll, pitch, yaw"),
        "cycle": None if pose.cycle is None else [str(name) for name in pose.cycle],
        "time_s": pose.time,
    }
