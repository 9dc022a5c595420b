"""Measured accuracy: ``robacc.estimate/1``, ``robacc.estimate-many/1``, ``robacc.iso9283/1``; errors of poses as CSV.

All keys are in m and rad. A criterion of ISO 9283 has ``max_m``, the largest value over commanded poses (the largest
magnitude, if it has a sign), with its interval under ``intervals``, so that a gate's ``iso9283.RP.max`` finds both. A
missing value is null, and ``why`` gives the reason.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from robacc.accuracy.estimation import commanded_poses, position_errors
from robacc.documents.envelope import GATE_KEY, GATE_RESULT, significant_document
from robacc.documents.keys import (
    ALIGNMENT,
    FIGURES,
    INTERVAL,
    LEFT_OUT,
    METRICS,
    NOTES,
    OUTSIDE_KEY,
    POSES,
    QUANTITIES,
    ROBOT,
    STATISTICS,
    WARNINGS,
    Key,
    array,
    choice,
    count,
    digest,
    flag,
    matrix3,
    number,
    ordinal,
    part,
    parts,
    pose_document,
    robot_document,
    rounded,
    rows3,
    share,
    size,
    table,
    text,
    texts,
    vector3,
    within,
)
from robacc.geometry import quaternion_from_rotation
from robacc.io.json_text import json_text
from robacc.workers import FileOutcome

_WORST = part(
    line=Key(count, "Line of the file."),
    place=Key(text, "Line as text, or the row where the file has no lines.", optional=True),
    pose=Key(text | None, "Id of the pose, or null."),
    target=Key(text | None, "Measured target, or null."),
    error_m=Key(size, "Length of the position error, m.", "position"),
    error_rad=Key(size | None, "Length of the orientation error, rad, or null.", "orientation"),
)
"""A pose with a large error."""
_FRAME = part(
    mean_m=Key(vector3, "Mean error, m.", lambda frame: frame.position.mean(axis=1)),
    covariance_m2=Key(
        matrix3, "Covariance about zero, m².", lambda frame: frame.position @ frame.position.T / frame.position.shape[1]
    ),
    centred_covariance_m2=Key(
        matrix3, "Covariance about the mean, m².", lambda frame: np.cov(frame.position, bias=True)
    ),
    errors_m=Key(rows3, "Position error of each row, m.", lambda frame: rounded(frame.position)),
)
"""Position errors in the axes of a frame."""
_QUANTITY_GRADE = {
    unit: part(
        **{
            "grade": Key(text, "Grade of this quantity alone."),
            "demonstrated_grade": Key(text | None, "Best grade that is confirmed for this quantity."),
            f"value_{unit}": Key(size | None, f"Statistic of the scale, {unit}."),
            f"upper_bound_{unit}": Key(
                size | None,
                f"Upper bound of the statistic at the scale's confidence, {unit}; null if there is none.",
                "interval.upper_bound",
            ),
            f"limit_{unit}": Key(size | None, f"Limit of the grade, {unit}; null if it has none."),
            "method": Key(text, "Method of the bound.", "interval.method"),
            "why": Key(text | None, "Reason why there is no bound, or null."),
        }
    )
    for unit, _ in QUANTITIES
}
GRADE = part(
    grade=Key(text, "Grade by the estimated statistics."),
    demonstrated=Key(flag, "True if the grade is confirmed: the upper bounds meet its limits too."),
    demonstrated_grade=Key(text | None, "Best grade that is confirmed; null if there is none."),
    scale=Key(text, "Name of the scale.", "scale.name"),
    statistic=Key(choice("rms", "mean_error", "p95", "max"), "Statistic that the limits apply to.", "scale.statistic"),
    confidence=Key(share, "Confidence of the upper bounds.", "scale.confidence"),
    position=Key(_QUANTITY_GRADE["m"], "Position alone."),
    orientation=Key(_QUANTITY_GRADE["rad"] | None, "Orientation alone; null if none was measured."),
    limited_by=Key(array(text), "Quantities that prevent a better grade."),
    next=Key(
        part(
            grade=Key(text, "Name of the grade."),
            position_excess_m=Key(size | None, "Distance of the position beyond its limit, m."),
            orientation_excess_rad=Key(size | None, "Distance of the orientation beyond its limit, rad."),
        )
        | None,
        "Next better grade and the distances to its limits; null at the best grade.",
    ),
    probability=Key(
        share | None, "Probability that the limits of the grade are truly met, given the data; null if unknown."
    ),
    probabilities=Key(
        parts(grade=Key(text, "Name of the grade."), probability=Key(share, "Probability of the grade.")),
        "Probability that each grade is the true grade.",
        lambda grade: [{"grade": name, "probability": share} for name, share in grade.probabilities],
    ),
    poses_to_demonstrate=Key(
        count | None,
        "Total number of poses that would confirm the grade; null if it is confirmed or the number is unknown.",
    ),
    reason=Key(text, "Explanation of the grade."),
    steps=Key(
        parts(
            grade=Key(text, "Name of the grade."),
            position_m=Key(size, "Position limit, m."),
            orientation_rad=Key(size | None, "Orientation limit, rad; null for no limit."),
        ),
        "Steps of the scale, the best grade first.",
        "scale.steps",
    ),
    otherwise=Key(text, "Grade of errors that meet no step.", "scale.otherwise"),
)
"""Grade of measured errors; limits, values and bounds in m and rad."""


ESTIMATE_ITSELF = part(
    n_poses=Key(count, "Measured poses (rows)."),
    frame=Key(
        choice("tool", "base"), "Axes of the errors: the commanded target's, or the measuring frame's.", "errors.frame"
    ),
    commanded=Key(choice("robot", "file"), "Source of the commanded poses."),
    alignment=Key(ALIGNMENT | None, "Frames registered to the poses; null without a registration."),
    unaligned=Key(
        part(
            position=Key(FIGURES["m"]),
            orientation=Key(FIGURES["rad"] | None, "Metrics of orientation; null if none was measured."),
        )
        | None,
        "Metrics without the registration; null if no frame was registered.",
    ),
    position=Key(
        STATISTICS["m"], source=lambda result: STATISTICS["m"].write(result.position, errors_m=result.errors.position.T)
    ),
    orientation=Key(
        STATISTICS["rad"] | None,
        "Orientation errors; null if no orientation was measured or commanded.",
        lambda result: (
            result.orientation and STATISTICS["rad"].write(result.orientation, errors_rad=result.errors.rotation.T)
        ),
    ),
    grade=Key(GRADE, "Grade of the errors."),
    worst_poses=Key(
        part(
            by_position=Key(array(_WORST), "Largest position errors, the largest first.", "worst_position"),
            by_orientation=Key(array(_WORST), "Largest orientation errors, the largest first.", "worst_orientation"),
        ),
        "Poses with the largest errors.",
        "",
    ),
    targets=Key(
        parts(
            target=Key(text, "Name of the target.", "name"),
            n_poses=Key(count, "Number of rows of the target."),
            **within("position", METRICS["m"]),
        ),
        "Metrics of each target, if there are several.",
    ),
    distances=Key(
        part(
            n_pairs=Key(count, "Pairs of poses; of many poses, those of 300."),
            rms_m=Key(size, "Rms error, m."),
            p95_m=Key(size, "95th percentile of the error's size, m."),
            max_m=Key(size, "Largest error, m."),
            scale=Key(number, "Share of the distance by which measured ones are longer, by least squares."),
            between=Key(array(text), "Places of the two poses of the largest error."),
            distance_m=Key(size, "Their commanded distance, m."),
            bands=Key(
                parts(
                    up_to_m=Key(size, "Longest distance of the band, m."),
                    n_pairs=Key(count, "Pairs of poses."),
                    rms_m=Key(size, "Rms error, m."),
                    max_m=Key(size, "Largest error, m."),
                ),
                "Errors by distance, in bands of as many pairs.",
            ),
        )
        | None,
        "Errors of the distances between poses, measured minus commanded, which no registration of the base "
        "changes; null where positions are not measured.",
        optional=True,
    ),
    **NOTES,
    **WARNINGS,
)
"""Keys of the estimate itself."""


ESTIMATE = part(
    **(ESTIMATE_ITSELF.keys or {}),
    noise=Key(
        part(
            position_m=Key(size | None, "Standard deviation along an axis, m."),
            orientation_rad=Key(size | None, "Standard deviation about an axis, rad."),
            source=Key(choice("file"), "Source of the noise: always the file."),
        )
        | None,
        "Measurement noise that the file states, rms over poses; null if it states none.",
        lambda result: (
            dict(zip(("position_m", "orientation_rad"), result.data.stated_noise, strict=True)) | {"source": "file"}
            if result.data.stated_noise != (None, None)
            else None
        ),
    ),
    robot=Key(
        ROBOT | None,
        source=lambda result: robot_document(result.robot, result.data.q, result.alignment and result.alignment.robot),
    ),
    poses=Key(
        POSES,
        source=lambda result: pose_document(
            result.data, commanded_poses(result.data, result.robot, result.alignment)[0]
        ),
    ),
    position_by_frame=Key(
        part(
            base=Key(_FRAME, "Axes of the measuring frame."),
            tool=Key(_FRAME, "Axes of the commanded target; missing if no orientation was commanded.", optional=True),
        ),
        "Position errors in the axes of each frame.",
        lambda result: position_errors(result.data, *commanded_poses(result.data, result.robot, result.alignment)),
    ),
    outside_validity=OUTSIDE_KEY,
    gate=GATE_KEY,
).named(about="Cartesian error at each measured pose, its covariances, and an accuracy grade.")
SUMMARY = part(
    n_poses=Key(count, "Measured poses."),
    rms_m=Key(size, "Rms position error, m.", "position.rms"),
    p95_m=Key(size, "95th percentile of the position error, m.", "position.p95"),
    max_m=Key(size, "Largest length of an error, m.", "position.max"),
    rms_rad=Key(size | None, "Rms orientation error, rad, or null.", "orientation.rms"),
    grade=Key(text, "Grade.", "grade.grade"),
    demonstrated=Key(flag, "True if the grade is confirmed.", "grade.demonstrated"),
)
"""Main figures of an estimate."""
_ENTRY = part(
    file=Key(text, "Name of the file.", "name"),
    done=Key(flag, "True if there is an estimate.", lambda outcome: not outcome.failed),
    exit_status=Key(choice(0, 1, 2, 3, 4, 5), "Exit status of the command on this file alone."),
    problems=Key(
        parts(
            message=Key(text, "Description of the problem."),
            line=Key(count | None, "Line of the file."),
            row=Key(ordinal | None, "Row of a file without lines."),
            column=Key(text | None, "Column of the file."),
            fix=Key(text | None, "Advice to fix the problem."),
        ),
        "Problems of the file.",
    ),
    n_problems=Key(count, "Total number of problems."),
    summary=Key(SUMMARY | None, "Main figures; null if there are none."),
    gate=Key(GATE_RESULT | None, "Gate outcome; null without a gate."),
    written=Key(text | None, "Name of the result's file, or null."),
    result=Key(table(), "Complete result, as robacc.estimate/1.", lambda _: LEFT_OUT, optional=True),
)
"""One file of several."""
ESTIMATE_MANY = part(
    n_files=Key(count, "Number of files."),
    n_failed=Key(count, "Number of files without an estimate."),
    results=Key(array(_ENTRY), "Files, in the order given."),
).named(about="Estimates of several files.")


def many_pieces(head: Mapping[str, Any], outcomes: Iterable[tuple[FileOutcome, str | None]]) -> Iterator[str]:
    """Yield the document's text in pieces, so that memory holds one file's result at a time.

    Args:
        head: Keys about all files; their ``results`` follow.
        outcomes: Outcome of each file, and the path of its JSON result, which becomes its key ``result``.
    """
    yield json_text(head).removesuffix("\n}\n") + ',\n  "results": ['
    separator = "\n    "
    for outcome, path in outcomes:
        text = json_text(significant_document(_ENTRY.write(outcome))).removesuffix("\n}\n")
        yield separator + text.replace("\n", "\n    ")
        separator = ",\n    "
        if path is not None:
            result = Path(path).read_text(encoding="utf-8").removesuffix("\n")
            yield ',\n      "result": ' + result.replace("\n", "\n      ")
        yield "\n    }"
    yield "\n  ]\n}\n"


# An evaluation by ISO 9283.


def _each(figures: str, name: str) -> Callable[[Any], Any]:
    """Return a source: the attribute ``name`` of each of the figures of a place; None without figures."""
    return lambda place: getattr(place, figures) and [getattr(figure, name) for figure in getattr(place, figures)]


def _symbol(symbol: str) -> Callable[[Any], Any]:
    """Return a source: the characteristic with a symbol."""
    return lambda result: result.characteristic(symbol)


CHARACTERISTIC = part(
    symbol=Key(text, "Symbol of the standard."),
    clause=Key(text, "Clause of ISO 9283:1998.", lambda characteristic: f"ISO 9283:1998, {characteristic.clause}"),
    max_m=Key(
        number | None,
        "Largest value, m, by magnitude if the criterion has a sign; null if the data do not support it.",
        "position.value",
    ),
    max_at=Key(text | None, "Commanded pose, or pair of poses, of the largest value.", "position_at"),
    intervals=Key(part(max_m=Key(INTERVAL, source="")), source="position.interval"),
    why=Key(
        text | None,
        "Reason why there is no number, or null.",
        lambda characteristic: characteristic.position.interval.why if characteristic.position.value is None else None,
    ),
    orientation=Key(
        part(
            max_rad=Key(number | None, "Largest value, rad, or null.", "angle.value"),
            max_at=Key(text | None, "Commanded pose and angle of the largest value.", "angle_at"),
            intervals=Key(part(max_rad=Key(INTERVAL, source="")), source="angle.interval"),
            why=Key(
                text | None,
                "Reason why there is no number, or null.",
                lambda characteristic: (
                    characteristic.angle.interval.why if characteristic.angle.value is None else None
                ),
            ),
        ),
        "Largest value of the angles a, b, c.",
        "",
    ),
    poses=Key(
        parts(
            pose=Key(text, "Id of the pose; a pair has both ids with a dash.", lambda place: "–".join(place.poses)),
            poses=Key(array(text), "Ids of the poses."),
            file=Key(text | None, "File of the poses; null for a criterion over several files.", "source"),
            n=Key(count, "Number of visits, or pairs of visits."),
            position_m=Key(number | None, "Value of the criterion, m.", "position.value"),
            xyz_m=Key(
                array(number | None) | None,
                "Values along x, y, z, m; null if the standard defines none.",
                _each("axes", "value"),
            ),
            abc_rad=Key(
                array(number | None) | None, "Values of a, b, c, rad; null if there are none.", _each("angles", "value")
            ),
            mean_distance_m=Key(
                size | None,
                "RP: mean distance of the visits from their barycentre, m.",
                lambda place: LEFT_OUT if place.mean_distance is None else place.mean_distance,
                optional=True,
            ),
            sd_distance_m=Key(
                size | None,
                "RP: standard deviation of that distance, m.",
                lambda place: LEFT_OUT if place.mean_distance is None else place.sd_distance,
                optional=True,
            ),
            between=Key(
                text,
                "The two approaches, windows or files with the largest distance.",
                lambda place: LEFT_OUT if place.between is None else place.between,
                optional=True,
            ),
            intervals=Key(
                part(
                    position_m=Key(INTERVAL, source="position.interval"),
                    xyz_m=Key(array(INTERVAL) | None, source=_each("axes", "interval")),
                    abc_rad=Key(array(INTERVAL) | None, source=_each("angles", "interval")),
                ),
                "Intervals of the numbers, by their keys.",
                "",
            ),
        ),
        "Criterion at each commanded pose, or pair of poses.",
        "places",
    ),
    notes=Key(array(text), "Notes on the criterion."),
).named("characteristic", "One criterion over all commanded poses.")

ISO9283 = part(
    n_poses=Key(count, "Number of measured rows of all files."),
    n_commanded_poses=Key(count, "Number of commanded poses of all files.", lambda result: len(result.poses)),
    files=Key(array(text), "File names, one for each robot.", "sources"),
    commanded=Key(
        choice("robot", "file") | None,
        "Source of the commanded poses; null if there are none, and then there is no accuracy.",
    ),
    alignment=Key(
        array(ALIGNMENT) | None,
        "Frames registered to the poses of each file; null without a registration.",
        lambda result: result.alignments or None,
    ),
    unaligned=Key(
        part(AP_max_m=Key(array(number | None), "Largest AP of each file, m.", "")) | None,
        "Values without the registration; null if no frame was registered.",
    ),
    confidence=Key(share, "Confidence of the intervals."),
    iso9283=Key(
        part(
            AP=Key(CHARACTERISTIC, "Pose accuracy.", _symbol("AP")),
            RP=Key(CHARACTERISTIC, "Pose repeatability; never to be called accuracy.", _symbol("RP")),
            vAP=Key(CHARACTERISTIC, "Multi-directional pose accuracy variation.", _symbol("vAP")),
            AD=Key(CHARACTERISTIC, "Distance accuracy.", _symbol("AD")),
            RD=Key(CHARACTERISTIC, "Distance repeatability.", _symbol("RD")),
            drift=Key(
                part(
                    AP=Key(CHARACTERISTIC, "Drift of pose accuracy.", _symbol("dAP")),
                    RP=Key(CHARACTERISTIC, "Drift of pose repeatability.", _symbol("dRP")),
                    barycentre=Key(CHARACTERISTIC, "Drift of the barycentre.", _symbol("shift")),
                ),
                "Drift over time.",
                "",
            ),
            exchangeability=Key(
                CHARACTERISTIC,
                "Exchangeability: largest distance between the barycentres of two robots at a commanded pose.",
                _symbol("E"),
            ),
        ),
        "Criteria by symbol; a criterion without a number gives the reason.",
        "",
    ),
    protocol=Key(
        parts(
            condition=Key(text, "Name of the condition."),
            clause=Key(text, "Clause of the standard."),
            status=Key(choice("met", "not_met", "unknown"), "Status: met, not_met or unknown."),
            why=Key(text, "Result of the check."),
        ),
        "Conditions of the standard's protocol.",
    ),
    visits=Key(
        parts(
            pose=Key(text, "Id of the commanded pose.", "label"),
            file=Key(text, "File of the pose.", "source"),
            n=Key(count, "Number of visits.", "data.n"),
            commanded_m=Key(vector3 | None, "Commanded position in the measuring frame, m; null if unknown."),
            barycentre_m=Key(vector3, "Barycentre of the visits, m.", lambda pose: pose.data.position.mean(axis=1)),
            attained_m=Key(rows3, "Measured position, m.", "data.position.T"),
            angle_deviations_rad=Key(
                rows3 | None,
                "Deviations of the angles a, b, c, rad; null if no orientation was measured.",
                lambda pose: None if pose.turn is None else pose.turn.T,
            ),
            angles_about=Key(
                text | None,
                "Meaning of the angles a, b, c, or null.",
                lambda pose: None if pose.turn is None else "x, y, z" if pose.at_pole else "roll, pitch, yaw",
            ),
            cycle=Key(array(text) | None, "Cycle of each visit.", lambda pose: texts(pose.data.cycle)),
            time_s=Key(array(number) | None, "Time, s.", "data.time"),
        ),
        "Every visit of each commanded pose.",
        "poses",
    ),
    **NOTES,
    **WARNINGS,
    outside_validity=OUTSIDE_KEY,
    gate=GATE_KEY,
).named(about="Pose criteria of ISO 9283:1998 and the conditions of its protocol that the data meet.")

ISO9283_POSES = part(
    cube=Key(
        part(
            edge_m=Key(size, "Edge of the cube, m."),
            centre_in_base_m=Key(vector3, "Centre of the cube in the base frame, m.", "centre"),
            plane_rises_towards=Key(choice("x+", "x-", "y+", "y-"), "The plane of the poses.", "plane"),
        ),
        "Cube of the five poses.",
        "proposal",
    ),
    **within(
        "proposal",
        {
            "orientation": Key(choice("down", "forward", "own", "free"), "Orientation of the tool."),
            "target": Key(text | None, "Target, for a robot with several targets."),
            "joint_margin": Key(
                number | None, "Smallest distance of a joint to its limits, as a share of its range.", "margin"
            ),
        },
    ),
    poses=Key(
        array(
            part(
                pose=Key(text, "Name of the pose, P1 to P5."),
                position_m=Key(vector3, "Position in the measuring frame, m."),
                quaternion=Key(array(number, 4), "Quaternion w, x, y, z."),
                q=Key(array(number), "Joint variables, rad or m."),
            ),
            5,
        ),
        "Poses P1 to P5.",
        lambda result: [
            {
                "pose": f"P{i + 1}",
                "position_m": result.proposal.poses.translation[:, i],
                "quaternion": quaternion_from_rotation(result.proposal.poses.rotation[..., i]),
                "q": q,
            }
            for i, q in enumerate(result.proposal.q.T)
        ],
    ),
    **within("proposal", NOTES),
    file_sha256=Key(
        digest, "SHA-256 of the written CSV file.", lambda result: sha256(result.csv().encode()).hexdigest()
    ),
).named(about="Cube of ISO 9283 in an arm's workspace and its five poses.")
