"""Keys of ``robacc.iso9283/1`` in m and rad.

Every characteristic has ``max_m``, the largest value over commanded poses (the largest magnitude, if it has a sign),
with its interval under ``intervals``, so that a gate's ``iso9283.RP.max`` finds both. A missing value is null, and
``why`` gives the reason.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from robacc.documents.gate import GATE_KEY
from robacc.documents.keys import (
    LEFT_OUT,
    Key,
    array,
    choice,
    count,
    digest,
    number,
    part,
    rows3,
    share,
    size,
    text,
    vector3,
)
from robacc.documents.parts import ALIGNMENT, INTERVAL, OUTSIDE_KEY, WARNINGS, texts
from robacc.geometry import quaternion_from_rotation


def _each(figures: str, name: str) -> Callable[[Any], Any]:
    """Return a source: the attribute ``name`` of each of the figures of a place; None without figures."""
    return lambda place: getattr(place, figures) and [getattr(figure, name) for figure in getattr(place, figures)]


def _symbol(symbol: str) -> Callable[[Any], Any]:
    """Return a source: the characteristic with a symbol."""
    return lambda result: next(entry for entry in result.characteristics if entry.symbol == symbol)


CHARACTERISTIC = part(
    {
        "symbol": Key(text, "Symbol of the standard."),
        "clause": Key(
            text, "Clause of ISO 9283:1998.", lambda characteristic: f"ISO 9283:1998, {characteristic.clause}"
        ),
        "max_m": Key(
            number | None,
            "Largest value, m, by magnitude if the criterion has a sign; null if the data do not support it.",
            "position.value",
        ),
        "max_at": Key(text | None, "Commanded pose, or pair of poses, of the largest value.", "position_at"),
        "intervals": Key(
            part(
                {
                    "max_m": Key(INTERVAL, source=""),
                }
            ),
            source="position.interval",
        ),
        "why": Key(
            text | None,
            "Reason why there is no number, or null.",
            lambda characteristic: (
                characteristic.position.interval.why if characteristic.position.value is None else None
            ),
        ),
        "orientation": Key(
            part(
                {
                    "max_rad": Key(number | None, "Largest value, rad, or null.", "angle.value"),
                    "max_at": Key(text | None, "Commanded pose and angle of the largest value.", "angle_at"),
                    "intervals": Key(
                        part(
                            {
                                "max_rad": Key(INTERVAL, source=""),
                            }
                        ),
                        source="angle.interval",
                    ),
                    "why": Key(
                        text | None,
                        "Reason why there is no number, or null.",
                        lambda characteristic: (
                            characteristic.angle.interval.why if characteristic.angle.value is None else None
                        ),
                    ),
                }
            ),
            "Largest value of the angles a, b, c.",
            "",
        ),
        "poses": Key(
            array(
                part(
                    {
                        "pose": Key(
                            text,
                            "Id of the pose; a pair has both ids with a dash.",
                            lambda place: "–".join(place.poses),
                        ),
                        "poses": Key(array(text), "Ids of the poses."),
                        "file": Key(
                            text | None, "File of the poses; null for a criterion over several files.", "source"
                        ),
                        "n": Key(count, "Number of visits, or pairs of visits."),
                        "position_m": Key(number | None, "Value of the criterion, m.", "position.value"),
                        "xyz_m": Key(
                            array(number | None) | None,
                            "Values along x, y, z, m; null if the standard defines none.",
                            _each("axes", "value"),
                        ),
                        "abc_rad": Key(
                            array(number | None) | None,
                            "Values of a, b, c, rad; null if there are none.",
                            _each("angles", "value"),
                        ),
                        "mean_distance_m": Key(
                            size | None,
                            "RP: mean distance of the visits from their barycentre, m.",
                            lambda place: LEFT_OUT if place.mean_distance is None else place.mean_distance,
                            optional=True,
                        ),
                        "sd_distance_m": Key(
                            size | None,
                            "RP: standard deviation of that distance, m.",
                            lambda place: LEFT_OUT if place.mean_distance is None else place.sd_distance,
                            optional=True,
                        ),
                        "between": Key(
                            text,
                            "The two approaches, windows or files with the largest distance.",
                            lambda place: LEFT_OUT if place.between is None else place.between,
                            optional=True,
                        ),
                        "intervals": Key(
                            part(
                                {
                                    "position_m": Key(INTERVAL, source="position.interval"),
                                    "xyz_m": Key(array(INTERVAL) | None, source=_each("axes", "interval")),
                                    "abc_rad": Key(array(INTERVAL) | None, source=_each("angles", "interval")),
                                }
                            ),
                            "Intervals of the numbers, by their keys.",
                            "",
                        ),
                    }
                )
            ),
            "Criterion at each commanded pose, or pair of poses.",
            "places",
        ),
        "notes": Key(array(text), "Notes on the criterion."),
    },
    "characteristic",
    "One criterion over all commanded poses.",
)

ISO9283 = part(
    {
        "n_poses": Key(count, "Number of measured rows of all files."),
        "n_commanded_poses": Key(count, "Number of commanded poses of all files.", lambda result: len(result.poses)),
        "files": Key(array(text), "File names, one for each robot.", "sources"),
        "commanded": Key(
            choice("robot", "file") | None,
            "Source of the commanded poses; null if there are none, and then there is no accuracy.",
        ),
        "alignment": Key(
            array(ALIGNMENT) | None,
            "Frames registered to the poses of each file; null without a registration.",
            lambda result: result.alignments or None,
        ),
        "unaligned": Key(
            part(
                {
                    "AP_max_m": Key(array(number | None), "Largest AP of each file, m.", ""),
                }
            )
            | None,
            "Values without the registration; null if no frame was registered.",
        ),
        "confidence": Key(share, "Confidence of the intervals."),
        "iso9283": Key(
            part(
                {
                    "AP": Key(
                        CHARACTERISTIC,
                        "Pose accuracy.",
                        _symbol("AP"),
                    ),
                    "RP": Key(
                        CHARACTERISTIC,
                        "Pose repeatability; never to be called accuracy.",
                        _symbol("RP"),
                    ),
                    "vAP": Key(
                        CHARACTERISTIC,
                        "Multi-directional pose accuracy variation.",
                        _symbol("vAP"),
                    ),
                    "AD": Key(
                        CHARACTERISTIC,
                        "Distance accuracy.",
                        _symbol("AD"),
                    ),
                    "RD": Key(
                        CHARACTERISTIC,
                        "Distance repeatability.",
                        _symbol("RD"),
                    ),
                    "drift": Key(
                        part(
                            {
                                "AP": Key(
                                    CHARACTERISTIC,
                                    "Drift of pose accuracy.",
                                    _symbol("dAP"),
                                ),
                                "RP": Key(
                                    CHARACTERISTIC,
                                    "Drift of pose repeatability.",
                                    _symbol("dRP"),
                                ),
                                "barycentre": Key(
                                    CHARACTERISTIC,
                                    "Drift of the barycentre.",
                                    _symbol("shift"),
                                ),
                            }
                        ),
                        "Drift over time.",
                        "",
                    ),
                    "exchangeability": Key(
                        CHARACTERISTIC,
                        "Exchangeability: pose accuracy over several robots.",
                        _symbol("E"),
                    ),
                }
            ),
            "Criteria by symbol; a criterion without a number gives the reason.",
            "",
        ),
        "protocol": Key(
            array(
                part(
                    {
                        "condition": Key(text, "Name of the condition.", "name"),
                        "clause": Key(text, "Clause of the standard."),
                        "status": Key(
                            choice("met", "not_met", "unknown"),
                            "Status: met, not_met or unknown.",
                            lambda condition: condition.status.replace(" ", "_"),
                        ),
                        "why": Key(text, "Result of the check."),
                    }
                )
            ),
            "Conditions of the standard's protocol.",
        ),
        "visits": Key(
            array(
                part(
                    {
                        "pose": Key(text, "Id of the commanded pose.", "label"),
                        "file": Key(text, "File of the pose.", "source"),
                        "n": Key(count, "Number of visits."),
                        "commanded_m": Key(
                            vector3 | None, "Commanded position in the measuring frame, m; null if unknown."
                        ),
                        "barycentre_m": Key(
                            vector3, "Barycentre of the visits, m.", lambda pose: pose.attained.mean(axis=1)
                        ),
                        "attained_m": Key(rows3, "Measured position, m.", "attained.T"),
                        "angle_deviations_rad": Key(
                            rows3 | None,
                            "Deviations of the angles a, b, c, rad; null if no orientation was measured.",
                            lambda pose: None if pose.turn is None else pose.turn.T,
                        ),
                        "angles_about": Key(
                            text | None,
                            "Meaning of the angles a, b, c, or null.",
                            lambda pose: (
                                None if pose.turn is None else "x, y, z" if pose.at_pole else "roll, pitch, yaw"
                            ),
                        ),
                        "cycle": Key(array(text) | None, "Cycle of each visit.", lambda pose: texts(pose.cycle)),
                        "time_s": Key(array(number) | None, "Time, s.", "time"),
                    }
                )
            ),
            "Every visit of each commanded pose.",
            "poses",
        ),
        "notes": Key(array(text), "Notes on the figures: assumptions and limitations."),
        **WARNINGS,
        "outside_validity": OUTSIDE_KEY,
        "gate": GATE_KEY,
    },
    about="Pose criteria of ISO 9283:1998 and the conditions of its protocol that the data meet.",
)

ISO9283_POSES = part(
    {
        "cube": Key(
            part(
                {
                    "edge_m": Key(size, "Edge of the cube, m."),
                    "centre_in_base_m": Key(vector3, "Centre of the cube in the base frame, m.", "centre"),
                    "plane_rises_towards": Key(choice("x+", "x-", "y+", "y-"), "The plane of the poses.", "plane"),
                }
            ),
            "Cube of the five poses.",
            "",
        ),
        "orientation": Key(choice("down", "forward", "own", "free"), "Orientation of the tool."),
        "target": Key(text | None, "Target, for a robot with several targets."),
        "joint_margin": Key(
            number | None, "Smallest distance of a joint to its limits, as a share of its range.", "margin"
        ),
        "poses": Key(
            array(
                part(
                    {
                        "pose": Key(text, "Name of the pose, P1 to P5."),
                        "position_m": Key(vector3, "Position in the measuring frame, m."),
                        "quaternion": Key(array(number, 4), "Quaternion w, x, y, z."),
                        "q": Key(array(number), "Joint variables, rad or m."),
                    }
                ),
                5,
            ),
            "Poses P1 to P5.",
            lambda proposal: [
                {
                    "pose": f"P{i + 1}",
                    "position_m": proposal.poses.translation[:, i],
                    "quaternion": quaternion_from_rotation(proposal.poses.rotation[..., i]),
                    "q": proposal.q[:, i],
                }
                for i in range(proposal.q.shape[1])
            ],
        ),
        "notes": Key(array(text), "Notes on the figures: assumptions and limitations."),
        "file_sha256": Key(digest, "SHA-256 of the written CSV file."),
    },
    about="Cube of ISO 9283 in an arm's workspace and its five poses.",
)
