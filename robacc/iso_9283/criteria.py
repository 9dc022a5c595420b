"""Criteria of ISO 9283:1998, clause 7: pose and distance accuracy and repeatability, exchangeability, drift."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.iso_9283 import estimates
from robacc.iso_9283.estimates import (
    IntervalEstimate,
    distance,
    largest_estimate,
    largest_figure,
    magnitude,
    position_repeatability,
    student,
    threefold_std,
)
from robacc.iso_9283.records import Characteristic, IsoCriterion, Symbol
from robacc.iso_9283.visits import CommandedPose, wrapped
from robacc.statistics.intervals import EstimateOrReason

# Characteristics from the estimates at each place: every place's figures, and the largest of them.

NO_COMMAND = "the commanded poses are not known: give `robot`, or columns cmd_x, cmd_y, cmd_z"
_NO_COMMANDED_ANGLES = "no orientation was commanded and measured"
_NO_ANGLES = "no orientation was measured"
_CRITERIA: dict[Symbol, tuple[str, str]] = {
    "AP": ("7.2.1", _NO_COMMANDED_ANGLES),
    "RP": ("7.2.2", _NO_ANGLES),
    "vAP": ("7.2.3", _NO_ANGLES),
    "AD": ("7.3.2", _NO_ANGLES),
    "RD": ("7.3.3", _NO_ANGLES),
    "dAP": ("7.6", _NO_ANGLES),
    "dRP": ("7.6", _NO_ANGLES),
    "shift": ("7.6", "the angles' shift is their dAP"),
    "E": ("7.7", "the criterion is defined for positions only"),
}
"""Clause of ISO 9283:1998 that defines each criterion, and the reason where no place has angles."""
ANGLE_LETTERS = "abc"
Place = IsoCriterion[IntervalEstimate]


def characteristic(
    symbol: Symbol, places: Sequence[Place], confidence: float, why: str, notes: Sequence[str] = ()
) -> Characteristic:
    """Return the criterion over ``places``; without any, it has no value, and ``why`` is the reason."""
    clause, no_angle = _CRITERIA[symbol]
    if not places:
        missing = EstimateOrReason.missing(confidence, why)
        return Characteristic(symbol, clause, missing, None, missing, None, ())
    several_files = len({place.source for place in places}) > 1
    labels = ["–".join(place.poses) + (f" of {place.source}" if several_files else "") for place in places]
    largest, position = largest_figure([magnitude(place.position) for place in places], confidence)
    angle, angle_at = EstimateOrReason.missing(confidence, no_angle), None
    angles = [
        (f"{label}, {letter}", magnitude(estimate))
        for place, label in zip(places, labels, strict=True)
        for letter, estimate in zip(ANGLE_LETTERS, place.angles or (), strict=False)
    ]
    if angles:
        worst, angle = largest_figure([estimate for _, estimate in angles], confidence)
        angle_at = angles[worst][0]

    def figures(parts: Sequence[IntervalEstimate] | None) -> tuple[EstimateOrReason, ...] | None:
        return None if parts is None else tuple(part.figure(confidence) for part in parts)

    criteria = tuple(
        IsoCriterion(
            place.poses,
            place.source,
            place.n,
            place.position.figure(confidence),
            figures(place.axes),
            figures(place.angles),
            place.mean_distance,
            place.sd_distance,
            place.between,
        )
        for place in places
    )
    return Characteristic(symbol, clause, position, labels[largest], angle, angle_at, criteria, tuple(notes))


def separation(
    groups: Sequence[Array], names: Sequence[str], group_angles: Sequence[Array] | None
) -> tuple[IntervalEstimate, tuple[IntervalEstimate, ...] | None, str]:
    """Return the largest distance and angle differences between barycentres of groups of visits ``(3, n_i)``.

    The scatter is pooled over the groups. The third element names the two groups with the largest distance.
    """
    pairs = list(combinations(range(len(groups)), 2))
    covariance, dof = _pooled(groups)
    distances = []
    for h, k in pairs:
        factor = 1.0 / groups[h].shape[1] + 1.0 / groups[k].shape[1]
        distances.append(distance(groups[h].mean(axis=1) - groups[k].mean(axis=1), covariance * factor, dof))
    first, second = pairs[max(range(len(pairs)), key=lambda i: distances[i].value)]
    largest_angles = None
    if group_angles is not None:
        variances, dof = _pooled(group_angles)
        largest_angles = tuple(
            largest_estimate(
                [
                    magnitude(
                        _mean_change(group_angles[h][axis], group_angles[k][axis], float(variances[axis, axis]), dof)
                    )
                    for h, k in pairs
                ]
            )
            for axis in range(3)
        )
    return largest_estimate(distances), largest_angles, f"{names[first]} and {names[second]}"


def _pooled(groups: Sequence[Array]) -> tuple[Array, float]:
    """Return the covariance ``(K, K)`` within groups ``(K, n_i)`` and its degrees of freedom."""
    dof = sum(group.shape[1] - 1 for group in groups)
    centred = np.concatenate([group - group.mean(axis=1, keepdims=True) for group in groups], axis=1)
    return centred @ centred.T / max(dof, 1), float(dof)


def _mean_change(after: Array, before: Array, variance: float, dof: float) -> IntervalEstimate:
    """Return the mean of ``after`` minus that of ``before``, of independent values with the pooled ``variance``."""
    standard_error = (variance * (1.0 / after.size + 1.0 / before.size)) ** 0.5
    return student(float(after.mean() - before.mean()), standard_error, dof)


# Pose accuracy, repeatability, multi-directional variation and exchangeability: clauses 7.2 and 7.7 of ISO 9283:1998.
#
# With n visits p_j of a commanded pose p_c, their barycentre p̄ and the distances l_j = |p_j - p̄|:
#
#     AP_p = |p̄ - p_c|,  AP_x = x̄ - x_c …,  AP_a = ā - a_c …
#     RP_l = l̄ + 3 S_l,  S_l^2 = sum (l_j - l̄)^2 / (n - 1),  RP_a = ± 3 S_a …
#     vAP_p = max |p̄_h - p̄_k|,  vAP_a = max |ā_h - ā_k| …   over approaches h, k
#     E = max |p̄_h - p̄_k|                                    over robots h, k

_MAX_APPROACHES = 8
"""Largest number of approach directions at a pose; more are random moves."""
_SAME_COMMAND = 1e-6
"""m: commanded positions closer than this are the same."""


def accuracy(poses: Sequence[CommandedPose], confidence: float) -> Characteristic:
    """Return the accuracy (AP) of every commanded pose."""
    places = []
    for pose in poses:
        if pose.deviation is None:
            return characteristic("AP", [], confidence, NO_COMMAND)
        angles = None if pose.turn is None or not pose.oriented else tuple(map(estimates.mean, pose.turn))
        axes = tuple(map(estimates.mean, pose.deviation))
        covariance = np.cov(pose.deviation, ddof=1) / pose.n if pose.n > 1 else np.zeros((3, 3))
        position = distance(pose.deviation.mean(axis=1), covariance, pose.n - 1)
        places.append(IsoCriterion((pose.label,), pose.source, pose.n, position, axes, angles))
    return characteristic("AP", places, confidence, NO_COMMAND)


def repeatability(poses: Sequence[CommandedPose], confidence: float, seed: int) -> Characteristic:
    """Return the repeatability (RP) of every commanded pose with at least two visits."""
    places = []
    for pose in poses:
        if pose.n > 1:
            lengths = np.sqrt(np.sum(np.square(pose.residuals), axis=0))
            position = position_repeatability(pose.residuals, (seed, *pose.stream))
            angles = None if pose.turn is None else tuple(map(threefold_std, pose.turn))
            scatter = float(np.mean(lengths)), float(np.std(lengths, ddof=1))
            places.append(IsoCriterion((pose.label,), pose.source, pose.n, position, None, angles, *scatter))
    return characteristic(
        "RP", places, confidence, "every commanded pose was visited only once: RP needs several cycles"
    )


def multidirectional(poses: Sequence[CommandedPose], confidence: float) -> Characteristic:
    """Return the variation (vAP) of every commanded pose with several approaches (directions of the joints)."""
    why = "every commanded pose was always approached from the same direction"
    if all(pose.direction is None for pose in poses):
        why = "approach directions are not known: give dir_q columns, or `ordered`"
    places = []
    for pose in poses:
        approaches = _approaches(pose)
        if len(approaches) > _MAX_APPROACHES:
            why = "the moves to a pose differ from visit to visit: there are no approaches to compare"
        elif len(approaches) > 1:
            rows = list(approaches.values())
            turns = None if pose.turn is None else [pose.turn[:, index] for index in rows]
            groups = [pose.attained[:, index] for index in rows]
            position, angles, between = separation(groups, list(approaches), turns)
            n = sum(index.size for index in rows)
            places.append(IsoCriterion((pose.label,), pose.source, n, position, None, angles, between=between))
    return characteristic("vAP", places, confidence, why)


def _approaches(pose: CommandedPose) -> dict[str, NDArray[np.int64]]:
    """Return the visits of each approach by its name; visits without a moving joint are left out."""
    if pose.direction is None:
        return {}
    moving = np.flatnonzero(np.any(pose.direction != 0, axis=0))
    approaches, index = np.unique(pose.direction[:, moving], axis=1, return_inverse=True)
    names = ["".join("−0+"[int(np.sign(value)) + 1] for value in directions) for directions in approaches.T]
    return {name: moving[index.ravel() == i] for i, name in enumerate(names)}


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
        return characteristic("E", [], confidence, "exchangeability compares several robots: give one file per robot")
    by_label = [
        {pose.label: (pose, positions) for pose, positions in zip(*file, strict=True)}
        for file in zip(poses_by_file, attained, strict=True)
    ]
    places = []
    for label in [label for label in by_label[0] if all(label in labels for labels in by_label[1:])]:
        shared, groups = zip(*(labels[label] for labels in by_label), strict=True)
        first = shared[0]
        for pose in shared[1:]:
            if first.commanded is None or pose.commanded is None:
                break
            offset = float(np.linalg.norm(pose.commanded - first.commanded))
            if offset > _SAME_COMMAND:
                reason = (
                    f"{pose.label} of {pose.source} is commanded {offset * 1e3:.3g} mm from that of {first.source}: "
                    "exchangeability needs the same commanded poses"
                )
                return characteristic("E", [], confidence, reason)
        position, _, between = separation(groups, [pose.source for pose in shared], None)
        places.append(IsoCriterion((label,), None, sum(pose.n for pose in shared), position, between=between))
    return characteristic("E", places, confidence, "the files share no commanded pose")


# Distance accuracy and distance repeatability: clause 7.3 of ISO 9283:1998.
#
# With D_j = |p_1j - p_2j| between the j-th visits of two commanded poses and D_c = |p_c1 - p_c2|:
#
#     AD_p = D̄ - D_c,   RD_p = ± 3 S_D,   S_D^2 = sum (D_j - D̄)^2 / (n - 1)
#
# and likewise for D_x = |x_1 - x_2| … and the angles' D_a = |a_1 - a_2| …; registration of frames has no effect.

MAX_POSES_ALL_PAIRS = 10
"""With more commanded poses, only neighbours in the order of their first visit are paired."""


def distance_criteria(poses: Sequence[CommandedPose], confidence: float) -> tuple[Characteristic, Characteristic]:
    """Return AD and RD between the commanded poses of each file."""
    pairs: list[tuple[CommandedPose, CommandedPose]] = []
    notes: list[str] = []
    for number in sorted({pose.number for pose in poses}):
        file_poses = [pose for pose in poses if pose.number == number]
        if len(file_poses) <= MAX_POSES_ALL_PAIRS:
            pairs += combinations(file_poses, 2)
        else:
            pairs += pairwise(file_poses)
            notes = [
                f"with more than {MAX_POSES_ALL_PAIRS} commanded poses only neighbours in order of visit are paired"
            ]
    why = why_accuracy = "no cycle visits two commanded poses" if pairs else "one commanded pose has no distances"
    accurate, repeatable = [], []
    is_commanded = all(pose.commanded is not None for pose in poses)
    for pose_a, pose_b in pairs:
        rows_a, rows_b = _matched_visits(pose_a, pose_b)
        if rows_a.size == 0:
            continue
        why, why_accuracy = "every pair of commanded poses was visited once: RD needs cycles", NO_COMMAND
        place = (pose_a.label, pose_b.label), pose_a.source, int(rows_a.size)
        differences = pose_a.attained[:, rows_a] - pose_b.attained[:, rows_b]
        length, axes, angles, turned = np.sqrt(np.sum(np.square(differences), axis=0)), np.abs(differences), None, None
        if not (pose_a.turn is None or pose_b.turn is None or pose_a.at_pole or pose_b.at_pole):
            assert pose_a.reference is not None
            assert pose_b.reference is not None
            turned = wrapped(pose_a.reference - pose_b.reference)
            # Relative to the references' difference, so that poses half a turn apart do not flip sign.
            angles = np.abs(turned[:, None] + pose_a.turn[:, rows_a] - pose_b.turn[:, rows_b])
        if pose_a.commanded is not None and pose_b.commanded is not None and is_commanded:
            offset = pose_a.commanded - pose_b.commanded
            commanded_angles = _less(angles, turned) if pose_a.oriented and pose_b.oriented else None
            distance_error = estimates.mean(length, float(np.linalg.norm(offset)))
            accurate.append(IsoCriterion(*place, distance_error, _less(axes, offset), commanded_angles))
        if rows_a.size > 1:
            repeated = None if angles is None else tuple(map(threefold_std, angles))
            repeatable.append(IsoCriterion(*place, threefold_std(length), tuple(map(threefold_std, axes)), repeated))
    return (
        characteristic("AD", accurate, confidence, why_accuracy, notes),
        characteristic("RD", repeatable, confidence, why, notes),
    )


def _matched_visits(pose_a: CommandedPose, pose_b: CommandedPose) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the matching visits of two poses: of the same cycle, else the j-th with the j-th."""
    if pose_a.cycle is not None and pose_b.cycle is not None:
        _, rows_a, rows_b = np.intersect1d(pose_a.cycle, pose_b.cycle, return_indices=True)
        if np.unique(pose_a.cycle).size == pose_a.n and np.unique(pose_b.cycle).size == pose_b.n:
            return rows_a.astype(np.int64), rows_b.astype(np.int64)
    rows = np.arange(min(pose_a.n, pose_b.n))
    return rows, rows


def _less(distances: Array | None, commanded: Array | None) -> tuple[IntervalEstimate, ...] | None:
    """Return the mean of each row of ``distances`` ``(3, n)`` less the commanded one; None where they are not known."""
    if distances is None or commanded is None:
        return None
    return tuple(estimates.mean(row, offset) for row, offset in zip(distances, np.abs(commanded).tolist(), strict=True))


# Drift of pose characteristics over the run: clause 7.6 of ISO 9283:1998.
#
# The visits of each commanded pose, ordered by time (by the file's rows if no time was logged), are divided into
# windows of equal size. With t = 0 the first window and T any later one:
#
#     dAP_p = max |AP_p(t = 0) - AP_p(t = T)|,   dRP_p = max |RP_l(t = 0) - RP_l(t = T)|,   angles likewise
#
# AP is a length and can stay constant while the pose moves around the command, so the shift of the barycentre itself
# is reported too: max |p̄(t = T) - p̄(t = 0)|.

MIN_WINDOW_VISITS = 3
"""Smallest number of visits in a window: RP of two visits is almost entirely chance."""
USUAL_WINDOW_VISITS = 10
MAX_WINDOWS = 10


def drift(
    poses: Sequence[CommandedPose], confidence: float, seed: int, windows: int | None = None
) -> tuple[Characteristic, Characteristic, Characteristic]:
    """Return dAP, dRP and the barycentre's shift; ``windows`` None: as many as have ten visits each, two to ten.

    Poses with fewer than three visits in each window are left out.
    """
    counts = [(pose, windows or min(max(pose.n // USUAL_WINDOW_VISITS, 2), MAX_WINDOWS)) for pose in poses]
    divided = [
        (pose, np.array_split(np.arange(pose.n), count))
        for pose, count in counts
        if pose.n >= MIN_WINDOW_VISITS * count
    ]
    needed = MIN_WINDOW_VISITS * (windows or 2)
    why = f"drift needs {needed} visits of a commanded pose, {MIN_WINDOW_VISITS} in each of {windows or 2} windows"
    notes = [_window_note(*entry) for entry in divided[:1]]
    accurate = []
    if all(pose.deviation is not None for pose, _ in divided):
        accurate = [_accuracy_change(*entry) for entry in divided]
    repeated = [_repeatability_change(*entry, seed) for entry in divided]
    shifted = []
    for pose, window_rows in divided:
        first, *later = (pose.attained[:, rows] for rows in window_rows)
        shifted.append(_drift_place(pose, [separation([first, visits], ("", ""), None)[0] for visits in later]))
    return (
        characteristic("dAP", accurate, confidence, NO_COMMAND if divided else why, notes),
        characteristic("dRP", repeated, confidence, why, notes),
        characteristic("shift", shifted, confidence, why, notes),
    )


def _window_note(pose: CommandedPose, window_rows: Sequence[NDArray[np.int64]]) -> str:
    order = "in the order of the file's rows"
    if pose.time is not None:
        first, last = (float(np.mean(pose.time[rows])) for rows in (window_rows[0], window_rows[-1]))
        order = f"by time_s, the first and the last {(last - first) / 60.0:.3g} min apart"
    smallest, largest = window_rows[-1].size, window_rows[0].size
    count = str(largest) if smallest == largest else f"{smallest} or {largest}"
    return f"{len(window_rows)} windows of {count} visits, {order}; each against the first"


def _drift_place(
    pose: CommandedPose,
    changes: Sequence[IntervalEstimate],
    angle_changes: Sequence[Sequence[IntervalEstimate]] | None = None,
) -> Place:
    """Return the largest absolute change of the windows after the first, of the position and of each angle."""
    sizes = [magnitude(change) for change in changes]
    largest = max(range(len(sizes)), key=lambda window: sizes[window].value)
    angles = None
    if angle_changes is not None:
        angles = tuple(largest_estimate([magnitude(change) for change in entry]) for entry in angle_changes)
    between = f"windows 1 and {largest + 2}"
    return IsoCriterion((pose.label,), pose.source, pose.n, largest_estimate(sizes), None, angles, between=between)


def _accuracy_change(pose: CommandedPose, window_rows: Sequence[NDArray[np.int64]]) -> Place:
    assert pose.deviation is not None
    windows = [pose.deviation[:, rows] for rows in window_rows]
    covariance, dof = _pooled(windows)
    means = np.stack([window.mean(axis=1) for window in windows], axis=1)
    lengths = np.sqrt(np.sum(np.square(means), axis=0))
    directions = np.divide(means, lengths, out=np.zeros_like(means), where=lengths > 0.0)
    variances = np.einsum("iw,ij,jw->w", directions, covariance, directions) / [rows.size for rows in window_rows]
    # AP changes as the mean does along its own direction (delta method).
    changes = [
        student(float(lengths[i] - lengths[0]), math.sqrt(variances[i] + variances[0]), dof)
        for i in range(1, len(windows))
    ]
    angle_changes = None
    if pose.turn is not None and pose.oriented:
        # AP_a = ā - a_c changes as ā does.
        first, *later = (pose.turn[:, rows] for rows in window_rows)
        spread = np.diag(_pooled([first, *later])[0])
        angle_changes = [
            [_mean_change(window[axis], first[axis], float(spread[axis]), dof) for window in later] for axis in range(3)
        ]
    return _drift_place(pose, changes, angle_changes)


def _repeatability_change(pose: CommandedPose, window_rows: Sequence[NDArray[np.int64]], seed: int) -> Place:
    def changes(windows: Sequence[IntervalEstimate]) -> list[IntervalEstimate]:
        return [estimates.change(window, windows[0]) for window in windows[1:]]

    repeatabilities = []
    for index, rows in enumerate(window_rows):
        visits = pose.attained[:, rows]
        residuals = visits - visits.mean(axis=1, keepdims=True)
        repeatabilities.append(position_repeatability(residuals, (seed, *pose.stream, index)))
    angle_changes = None
    if pose.turn is not None:
        angle_changes = [changes([threefold_std(angle[rows]) for rows in window_rows]) for angle in pose.turn]
    return _drift_place(pose, changes(repeatabilities), angle_changes)
