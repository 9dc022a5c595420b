"""Keys of ``robacc.iso9283/1`` in m and rad.

Every characteristic has ``max_m``, the largest value over commanded poses (the largest magnitude, if it has a sign),
with its interval under ``intervals``, so that a gate's ``iso9283.RP.max`` finds both. A missing value is null, and
``why`` gives the reason.
"""

from __future__ import annotations

from typing import Any

from robacc.documents.parts import interval_document, parameters_document
from robacc.geometry import quaternion_from_rotation
from robacc.iso_9283.cube import Proposal
from robacc.iso_9283.records import Characteristic, Iso9283Result, IsoCriterion
from robacc.iso_9283.visits import CommandedPose
from robacc.statistics.intervals import EstimateOrReason

Document = dict[str, Any]


def payload(result: Iso9283Result) -> Document:
    """Return the keys of the evaluation; arrays stay arrays, which :mod:`robacc.io.json_text` writes."""
    by_symbol = {characteristic.symbol: characteristic for characteristic in result.characteristics}
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
            "AP": _characteristic(by_symbol["AP"]),
            "RP": _characteristic(by_symbol["RP"]),
            "vAP": _characteristic(by_symbol["vAP"]),
            "AD": _characteristic(by_symbol["AD"]),
            "RD": _characteristic(by_symbol["RD"]),
            "drift": {
                "AP": _characteristic(by_symbol["dAP"]),
                "RP": _characteristic(by_symbol["dRP"]),
                "barycentre": _characteristic(by_symbol["shift"]),
            },
            "exchangeability": _characteristic(by_symbol["E"]),
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


def proposal_payload(proposal: Proposal) -> Document:
    """Return the keys of ``robacc.iso9283-poses/1``."""
    return {
        "cube": {"edge_m": proposal.edge, "centre_in_base_m": proposal.centre, "plane_rises_towards": proposal.plane},
        "orientation": proposal.orientation,
        "target": proposal.target,
        "joint_margin": proposal.margin,
        "poses": [
            {
                "pose": f"P{i + 1}",
                "position_m": proposal.poses.translation[:, i],
                "quaternion": quaternion_from_rotation(proposal.poses.rotation[..., i]),
                "q": proposal.q[:, i],
            }
            for i in range(proposal.q.shape[1])
        ],
        "notes": list(proposal.notes),
    }


def _characteristic(characteristic: Characteristic) -> Document:
    return {
        "symbol": characteristic.symbol,
        "clause": f"ISO 9283:1998, {characteristic.clause}",
        "max_m": characteristic.position.value,
        "max_at": characteristic.position_at,
        "intervals": {"max_m": interval_document(characteristic.position.interval)},
        "why": characteristic.position.interval.why if characteristic.position.value is None else None,
        "orientation": {
            "max_rad": characteristic.angle.value,
            "max_at": characteristic.angle_at,
            "intervals": {"max_rad": interval_document(characteristic.angle.interval)},
            "why": characteristic.angle.interval.why if characteristic.angle.value is None else None,
        },
        "poses": [_criterion(place) for place in characteristic.places],
        "notes": characteristic.notes,
    }


def _criterion(place: IsoCriterion[EstimateOrReason]) -> Document:
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


def _interval(figure: EstimateOrReason) -> Document:
    return interval_document(figure.interval)


def _visits(pose: CommandedPose) -> Document:
    """Return every visit of a commanded pose, for charts."""
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
