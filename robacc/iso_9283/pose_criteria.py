"""Pose accuracy, repeatability, multi-directional variation and exchangeability: clauses 7.2 and 7.7 of ISO 9283:1998.

With n visits p_j of a commanded pose p_c, their barycentre p̄ and the distances l_j = |p_j - p̄|:

    AP_p = |p̄ - p_c|,  AP_x = x̄ - x_c …,  AP_a = ā - a_c …
    RP_l = l̄ + 3 S_l,  S_l^2 = sum (l_j - l̄)^2 / (n - 1),  RP_a = ± 3 S_a …
    vAP_p = max |p̄_h - p̄_k|,  vAP_a = max |ā_h - ā_k| …   over approaches h, k
    E = max |p̄_h - p̄_k|                                    over robots h, k
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.iso_9283 import estimates
from robacc.iso_9283.characteristics import PlaceEstimate, combine_places, missing_characteristic, separation
from robacc.iso_9283.distance import distance
from robacc.iso_9283.estimates import IntervalEstimate
from robacc.iso_9283.records import Characteristic
from robacc.iso_9283.repeatability import position_repeatability
from robacc.iso_9283.visits import CommandedPose

NO_COMMAND = "the commanded poses are not known: give `robot`, or columns cmd_x, cmd_y, cmd_z"
NO_ANGLES = "no orientation was measured"
_NO_COMMANDED_ANGLES = "no orientation was commanded and measured"
_MAX_APPROACHES = 8
"""Largest number of approach directions at a pose; more are random moves."""
_SAME_COMMAND = 1e-6
"""m: commanded positions closer than this are the same."""


def accuracy(poses: Sequence[CommandedPose], confidence: float) -> Characteristic:
    """Return the accuracy (AP) of every commanded pose."""
    if any(pose.deviation is None for pose in poses):
        return missing_characteristic("AP", confidence, NO_COMMAND)
    return combine_places("AP", [_accuracy_estimate(pose) for pose in poses], confidence, _NO_COMMANDED_ANGLES)


def position_accuracy(deviation: Array) -> IntervalEstimate:
    """Return AP_p from deviations ``(3, n)`` of the visits from the command."""
    n = deviation.shape[1]
    covariance = np.cov(deviation, ddof=1) / n if n > 1 else np.zeros((3, 3))
    return distance(deviation.mean(axis=1), covariance, n - 1)


def _accuracy_estimate(pose: CommandedPose) -> PlaceEstimate:
    assert pose.deviation is not None
    axes = tuple(estimates.mean(row) for row in pose.deviation)
    angles = None if pose.turn is None or not pose.oriented else tuple(estimates.mean(row) for row in pose.turn)
    return PlaceEstimate((pose.label,), pose.source, pose.n, position_accuracy(pose.deviation), axes, angles)


def repeatability(poses: Sequence[CommandedPose], confidence: float, seed: int) -> Characteristic:
    """Return the repeatability (RP) of every commanded pose with at least two visits."""
    places = [_repeatability_estimate(pose, seed) for pose in poses if pose.n > 1]
    if not places:
        return missing_characteristic(
            "RP", confidence, "every commanded pose was visited only once: RP needs several cycles"
        )
    return combine_places("RP", places, confidence, NO_ANGLES)


def _repeatability_estimate(pose: CommandedPose, seed: int) -> PlaceEstimate:
    length = np.sqrt(np.sum(np.square(pose.residuals), axis=0))
    return PlaceEstimate(
        (pose.label,),
        pose.source,
        pose.n,
        position_repeatability(pose.residuals, (seed, *pose.stream)),
        None,
        None if pose.turn is None else tuple(estimates.threefold_std(row) for row in pose.turn),
        float(np.mean(length)),
        float(np.std(length, ddof=1)),
    )


def multidirectional(poses: Sequence[CommandedPose], confidence: float) -> Characteristic:
    """Return the variation (vAP) of every commanded pose with several approaches (directions of the joints)."""
    if all(pose.direction is None for pose in poses):
        return missing_characteristic(
            "vAP", confidence, "approach directions are not known: give dir_q columns, or `ordered`"
        )
    approached = [(pose, _approaches(pose)) for pose in poses]
    places = [
        _variation_estimate(pose, approaches)
        for pose, approaches in approached
        if 2 <= len(approaches) <= _MAX_APPROACHES
    ]
    if places:
        return combine_places("vAP", places, confidence, NO_ANGLES)
    if any(len(approaches) > _MAX_APPROACHES for _, approaches in approached):
        return missing_characteristic(
            "vAP", confidence, "the moves to a pose differ from visit to visit: there are no approaches to compare"
        )
    return missing_characteristic(
        "vAP", confidence, "every commanded pose was always approached from the same direction"
    )


def _approaches(pose: CommandedPose) -> list[tuple[str, NDArray[np.int64]]]:
    """Return name and visits of each approach; visits without a moving joint are left out."""
    if pose.direction is None:
        return []
    moving = np.flatnonzero(np.any(pose.direction != 0, axis=0))
    approaches, index = np.unique(pose.direction[:, moving], axis=1, return_inverse=True)
    names = ["".join("−0+"[int(np.sign(value)) + 1] for value in directions) for directions in approaches.T]
    return [(name, moving[index.ravel() == i]) for i, name in enumerate(names)]


def _variation_estimate(pose: CommandedPose, approaches: Sequence[tuple[str, NDArray[np.int64]]]) -> PlaceEstimate:
    turns = None if pose.turn is None else [pose.turn[:, rows] for _, rows in approaches]
    groups = [pose.attained[:, rows] for _, rows in approaches]
    position, angles, between = separation(groups, [name for name, _ in approaches], turns)
    return PlaceEstimate(
        (pose.label,), pose.source, sum(rows.size for _, rows in approaches), position, None, angles, between=between
    )


def exchangeability(
    poses_by_file: Sequence[Sequence[CommandedPose]], attained: Sequence[Sequence[Array]], confidence: float
) -> Characteristic:
    """Return E between robots, one per file, at the commanded poses that all files have.

    Args:
        poses_by_file: Commanded poses of each file.
        attained: Attained positions ``(3, n)`` of each commanded pose, in a frame that the robots share, m.
        confidence: Confidence of the intervals.
    """
    if len(poses_by_file) < 2:
        return missing_characteristic(
            "E", confidence, "exchangeability compares several robots: give one file per robot"
        )
    by_label = [dict(zip((pose.label for pose in poses), range(len(poses)), strict=True)) for poses in poses_by_file]
    shared = [label for label in by_label[0] if all(label in labels for labels in by_label[1:])]
    if not shared:
        return missing_characteristic("E", confidence, "the files share no commanded pose")
    places = []
    for label in shared:
        shared_poses = [poses[labels[label]] for poses, labels in zip(poses_by_file, by_label, strict=True)]
        if (reason := _command_mismatch(shared_poses)) is not None:
            return missing_characteristic("E", confidence, reason)
        groups = [positions[labels[label]] for positions, labels in zip(attained, by_label, strict=True)]
        position, _, between = separation(groups, [pose.source for pose in shared_poses], None)
        places.append(PlaceEstimate((label,), None, sum(pose.n for pose in shared_poses), position, between=between))
    return combine_places("E", places, confidence, "the criterion is defined for positions only")


def _command_mismatch(poses: Sequence[CommandedPose]) -> str | None:
    first = poses[0]
    for pose in poses[1:]:
        if first.commanded is None or pose.commanded is None:
            return None
        offset = float(np.linalg.norm(pose.commanded - first.commanded))
        if offset > _SAME_COMMAND:
            return (
                f"{pose.label} of {pose.source} is commanded {offset * 1e3:.3g} mm from that of {first.source}: "
                "exchangeability needs the same commanded poses"
            )
    return None
