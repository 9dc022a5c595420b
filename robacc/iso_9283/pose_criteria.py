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
from robacc.iso_9283.collecting import Found, absent, collected, separation
from robacc.iso_9283.distance import distance
from robacc.iso_9283.estimates import IntervalEstimate
from robacc.iso_9283.records import Characteristic
from robacc.iso_9283.repeatability import position_repeatability
from robacc.iso_9283.visits import CommandedPose

NO_COMMAND = "nothing says where the target was to be: give --robot, or columns cmd_x, cmd_y, cmd_z"
NO_ANGLES = "no orientation was measured"
_NO_COMMANDED_ANGLES = "no orientation was commanded and measured"
_MOST_APPROACHES = 8
"""At one pose; more of them are random moves and no approaches."""
_SAME = 1e-6
"""m: commanded poses nearer than this are one."""


def accuracy(poses: Sequence[CommandedPose], confidence: float) -> Characteristic:
    """Accuracy (AP) of every commanded pose."""
    if any(pose.deviation is None for pose in poses):
        return absent("AP", confidence, NO_COMMAND)
    return collected("AP", [_accuracy(pose) for pose in poses], confidence, _NO_COMMANDED_ANGLES)


def position_accuracy(deviation: Array) -> IntervalEstimate:
    """AP_p from deviations ``(3, n)`` of the visits from the command."""
    n = deviation.shape[1]
    covariance = np.cov(deviation, ddof=1) / n if n > 1 else np.zeros((3, 3))
    return distance(deviation.mean(axis=1), covariance, n - 1)


def _accuracy(pose: CommandedPose) -> Found:
    assert pose.deviation is not None
    axes = tuple(estimates.mean(row) for row in pose.deviation)
    angles = None if pose.turn is None or not pose.oriented else tuple(estimates.mean(row) for row in pose.turn)
    return Found((pose.label,), pose.source, pose.n, position_accuracy(pose.deviation), axes, angles)


def repeatability(poses: Sequence[CommandedPose], confidence: float, seed: int) -> Characteristic:
    """Repeatability (RP) of every commanded pose that was visited twice or more."""
    found = [_repeatability(pose, seed) for pose in poses if pose.n > 1]
    if not found:
        return absent("RP", confidence, "every commanded pose was visited once: repeatability needs cycles")
    return collected("RP", found, confidence, NO_ANGLES)


def _repeatability(pose: CommandedPose, seed: int) -> Found:
    length = np.sqrt(np.sum(np.square(pose.residuals), axis=0))
    return Found(
        (pose.label,),
        pose.source,
        pose.n,
        position_repeatability(pose.residuals, (seed, *pose.stream)),
        None,
        None if pose.turn is None else tuple(estimates.threefold_sd(row) for row in pose.turn),
        float(np.mean(length)),
        float(np.std(length, ddof=1)),
    )


def multidirectional(poses: Sequence[CommandedPose], confidence: float) -> Characteristic:
    """Variation (vAP) of every commanded pose approached in more than one way; a way is the joints' directions."""
    if all(pose.direction is None for pose in poses):
        return absent("vAP", confidence, "approach directions are not known: give dir_q columns, or --ordered")
    approached = [(pose, _approaches(pose)) for pose in poses]
    found = [_variation(pose, ways) for pose, ways in approached if 2 <= len(ways) <= _MOST_APPROACHES]
    if found:
        return collected("vAP", found, confidence, NO_ANGLES)
    if any(len(ways) > _MOST_APPROACHES for _, ways in approached):
        return absent("vAP", confidence, "the moves to a pose differ from visit to visit: no approaches to compare")
    return absent("vAP", confidence, "every commanded pose was always approached in the same way")


def _approaches(pose: CommandedPose) -> list[tuple[str, NDArray[np.int64]]]:
    """Name and visits of each way of approach; visits to which no joint moved are left out."""
    if pose.direction is None:
        return []
    known = np.flatnonzero(np.any(pose.direction != 0, axis=0))
    ways, index = np.unique(pose.direction[:, known], axis=1, return_inverse=True)
    names = ["".join("−0+"[int(np.sign(value)) + 1] for value in way) for way in ways.T]
    return [(name, known[index.ravel() == i]) for i, name in enumerate(names)]


def _variation(pose: CommandedPose, ways: Sequence[tuple[str, NDArray[np.int64]]]) -> Found:
    turns = None if pose.turn is None else [pose.turn[:, rows] for _, rows in ways]
    groups = [pose.attained[:, rows] for _, rows in ways]
    position, angles, between = separation(groups, [name for name, _ in ways], turns)
    return Found(
        (pose.label,), pose.source, sum(rows.size for _, rows in ways), position, None, angles, between=between
    )


def exchangeability(
    robots: Sequence[Sequence[CommandedPose]], attained: Sequence[Sequence[Array]], confidence: float
) -> Characteristic:
    """E between robots, one file each, at the commanded poses that all of them have.

    Args:
        robots: The commanded poses of each file.
        attained: For each, the attained positions ``(3, n)`` in one frame that the robots share, m.
        confidence: Of the intervals.
    """
    if len(robots) < 2:
        return absent("E", confidence, "one file is one robot; it takes a file for each of several")
    by_label = [dict(zip((pose.label for pose in poses), range(len(poses)), strict=True)) for poses in robots]
    shared = [label for label in by_label[0] if all(label in labels for labels in by_label[1:])]
    if not shared:
        return absent("E", confidence, "the files share no commanded pose")
    found = []
    for label in shared:
        visited = [poses[labels[label]] for poses, labels in zip(robots, by_label, strict=True)]
        if (why := _not_the_same(visited)) is not None:
            return absent("E", confidence, why)
        groups = [places[labels[label]] for places, labels in zip(attained, by_label, strict=True)]
        position, _, between = separation(groups, [pose.source for pose in visited], None)
        found.append(Found((label,), None, sum(pose.n for pose in visited), position, between=between))
    return collected("E", found, confidence, "the criterion is of positions")


def _not_the_same(visited: Sequence[CommandedPose]) -> str | None:
    first = visited[0]
    for pose in visited[1:]:
        if first.commanded is None or pose.commanded is None:
            return None
        apart = float(np.linalg.norm(pose.commanded - first.commanded))
        if apart > _SAME:
            return (
                f"{pose.label} of {pose.source} is commanded {apart * 1e3:.3g} mm from that of {first.source}: "
                "exchangeability needs the same commanded poses"
            )
    return None
