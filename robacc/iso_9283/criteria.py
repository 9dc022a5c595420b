"""Criteria of ISO 9283:1998, clause 7: pose and distance accuracy and repeatability, exchangeability, drift."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
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
)
from robacc.iso_9283.records import Characteristic, CriterionFigure, IsoCriterion, Symbol
from robacc.iso_9283.visits import CommandedPose, wrapped

# Characteristics from the estimates at each place: every place's figures, and the largest of them.

CLAUSES: dict[Symbol, str] = {
    "AP": "7.2.1",
    "RP": "7.2.2",
    "vAP": "7.2.3",
    "AD": "7.3.2",
    "RD": "7.3.3",
    "dAP": "7.6",
    "dRP": "7.6",
    "shift": "7.6",
    "E": "7.7",
}
"""Clause of ISO 9283:1998 that defines each criterion."""
ANGLE_LETTERS = "abc"


@dataclass(frozen=True, slots=True)
class PlaceEstimate:
    """Estimate of one criterion at one place, before a confidence is chosen."""

    poses: tuple[str, ...]
    source: str | None
    n: int
    position: IntervalEstimate
    axes: tuple[IntervalEstimate, ...] | None = None
    angles: tuple[IntervalEstimate, ...] | None = None
    mean_distance: float | None = None
    sd_distance: float | None = None
    between: str | None = None


def combine_places(
    symbol: Symbol, places: Sequence[PlaceEstimate], confidence: float, no_angle: str, notes: Sequence[str] = ()
) -> Characteristic:
    """Return the characteristic over at least one of ``places``; ``no_angle`` is the reason if angles are missing."""
    largest, position = largest_figure([magnitude(place.position) for place in places], confidence)
    angle, angle_at = CriterionFigure.missing(confidence, no_angle), None
    angles = [(place, letter, magnitude(estimate)) for place in places for letter, estimate in _lettered_angles(place)]
    if angles:
        worst, angle = largest_figure([estimate for _, _, estimate in angles], confidence)
        angle_at = f"{place_label(angles[worst][0], places)}, {angles[worst][1]}"
    return Characteristic(
        symbol,
        CLAUSES[symbol],
        position,
        place_label(places[largest], places),
        angle,
        angle_at,
        tuple(_place_criterion(place, confidence) for place in places),
        tuple(notes),
    )


def missing_characteristic(symbol: Symbol, confidence: float, reason: str) -> Characteristic:
    """Return a characteristic without a value, which the data cannot support, and the reason."""
    missing = CriterionFigure.missing(confidence, reason)
    return Characteristic(symbol, CLAUSES[symbol], missing, None, missing, None, ())


def place_label(place: PlaceEstimate, places: Sequence[PlaceEstimate]) -> str:
    """Return the label of a place: its poses, and the file if ``places`` come from several files."""
    name = "–".join(place.poses)
    in_several_files = len({entry.source for entry in places}) > 1
    return f"{name} of {place.source}" if in_several_files else name


def separation(
    groups: Sequence[Array], names: Sequence[str], group_angles: Sequence[Array] | None
) -> tuple[IntervalEstimate, tuple[IntervalEstimate, ...] | None, str]:
    """Return the largest distance and angle differences between barycentres of groups of visits ``(3, n_i)``.

    The scatter is pooled over the groups. The third element names the two groups with the largest distance.
    """
    pairs = list(combinations(range(len(groups)), 2))
    distances = [_position_separation(groups[first], groups[second], *_pooled(groups)) for first, second in pairs]
    first, second = pairs[max(range(len(pairs)), key=lambda i: distances[i].value)]
    largest_angles = None
    if group_angles is not None:
        covariance, dof = _pooled(group_angles)
        largest_angles = tuple(
            largest_estimate(
                [
                    _angle_separation(group_angles[h][axis], group_angles[k][axis], float(covariance[axis, axis]), dof)
                    for h, k in pairs
                ]
            )
            for axis in range(3)
        )
    return largest_estimate(distances), largest_angles, f"{names[first]} and {names[second]}"


def _pooled(groups: Sequence[Array]) -> tuple[Array, float]:
    """Return the covariance ``(3, 3)`` within groups and its degrees of freedom."""
    dof = sum(group.shape[1] - 1 for group in groups)
    centred = np.concatenate([group - group.mean(axis=1, keepdims=True) for group in groups], axis=1)
    return centred @ centred.T / max(dof, 1), float(dof)


def _position_separation(first: Array, second: Array, covariance: Array, dof: float) -> IntervalEstimate:
    factor = 1.0 / first.shape[1] + 1.0 / second.shape[1]
    return distance(first.mean(axis=1) - second.mean(axis=1), covariance * factor, dof)


def _angle_separation(first: Array, second: Array, variance: float, dof: float) -> IntervalEstimate:
    standard_error = (variance * (1.0 / first.size + 1.0 / second.size)) ** 0.5
    return magnitude(student(float(first.mean() - second.mean()), standard_error, dof))


def _lettered_angles(place: PlaceEstimate) -> list[tuple[str, IntervalEstimate]]:
    return [] if place.angles is None else list(zip(ANGLE_LETTERS, place.angles, strict=True))


def _place_criterion(place: PlaceEstimate, confidence: float) -> IsoCriterion:
    def figures(estimates: Sequence[IntervalEstimate] | None) -> tuple[CriterionFigure, ...] | None:
        return None if estimates is None else tuple(estimate.figure(confidence) for estimate in estimates)

    return IsoCriterion(
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


# Pose accuracy, repeatability, multi-directional variation and exchangeability: clauses 7.2 and 7.7 of ISO 9283:1998.
#
# With n visits p_j of a commanded pose p_c, their barycentre p̄ and the distances l_j = |p_j - p̄|:
#
#     AP_p = |p̄ - p_c|,  AP_x = x̄ - x_c …,  AP_a = ā - a_c …
#     RP_l = l̄ + 3 S_l,  S_l^2 = sum (l_j - l̄)^2 / (n - 1),  RP_a = ± 3 S_a …
#     vAP_p = max |p̄_h - p̄_k|,  vAP_a = max |ā_h - ā_k| …   over approaches h, k
#     E = max |p̄_h - p̄_k|                                    over robots h, k

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
    return combine_places("AP", [_pose_accuracy(pose) for pose in poses], confidence, _NO_COMMANDED_ANGLES)


def position_accuracy(deviation: Array) -> IntervalEstimate:
    """Return AP_p from deviations ``(3, n)`` of the visits from the command."""
    n = deviation.shape[1]
    covariance = np.cov(deviation, ddof=1) / n if n > 1 else np.zeros((3, 3))
    return distance(deviation.mean(axis=1), covariance, n - 1)


def _pose_accuracy(pose: CommandedPose) -> PlaceEstimate:
    assert pose.deviation is not None
    axes = tuple(estimates.mean(row) for row in pose.deviation)
    angles = None if pose.turn is None or not pose.oriented else tuple(estimates.mean(row) for row in pose.turn)
    return PlaceEstimate((pose.label,), pose.source, pose.n, position_accuracy(pose.deviation), axes, angles)


def repeatability(poses: Sequence[CommandedPose], confidence: float, seed: int) -> Characteristic:
    """Return the repeatability (RP) of every commanded pose with at least two visits."""
    places = [_pose_repeatability(pose, seed) for pose in poses if pose.n > 1]
    if not places:
        return missing_characteristic(
            "RP", confidence, "every commanded pose was visited only once: RP needs several cycles"
        )
    return combine_places("RP", places, confidence, NO_ANGLES)


def _pose_repeatability(pose: CommandedPose, seed: int) -> PlaceEstimate:
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


# Distance accuracy and distance repeatability: clause 7.3 of ISO 9283:1998.
#
# With D_j = |p_1j - p_2j| between the j-th visits of two commanded poses and D_c = |p_c1 - p_c2|:
#
#     AD_p = D̄ - D_c,   RD_p = ± 3 S_D,   S_D^2 = sum (D_j - D̄)^2 / (n - 1)
#
# and likewise for D_x = |x_1 - x_2| … and the angles' D_a = |a_1 - a_2| …; registration of frames has no effect.

MAX_POSES_ALL_PAIRS = 10
"""With more commanded poses, only neighbours in the order of their first visit are paired."""
_ONE_POSE = "one commanded pose has no distances"


def distance_criteria(poses: Sequence[CommandedPose], confidence: float) -> tuple[Characteristic, Characteristic]:
    """Return AD and RD between the commanded poses of each file."""
    pairs = _pairs(poses)
    if not pairs:
        return missing_characteristic("AD", confidence, _ONE_POSE), missing_characteristic("RD", confidence, _ONE_POSE)
    matched = [(pose_a, pose_b, *_matched_visits(pose_a, pose_b)) for pose_a, pose_b in pairs]
    matched = [entry for entry in matched if entry[2].size > 0]
    if not matched:
        reason = "no cycle visits two commanded poses"
        return missing_characteristic("AD", confidence, reason), missing_characteristic("RD", confidence, reason)
    notes = _notes(poses)
    accuracy = missing_characteristic("AD", confidence, NO_COMMAND)
    if all(pose.commanded is not None for pose in poses):
        accuracy = combine_places("AD", [_distance_accuracy(*entry) for entry in matched], confidence, NO_ANGLES, notes)
    repeatable = [_distance_repeatability(*entry) for entry in matched if entry[2].size > 1]
    if not repeatable:
        return accuracy, missing_characteristic(
            "RD", confidence, "every pair of commanded poses was visited once: RD needs cycles"
        )
    return accuracy, combine_places("RD", repeatable, confidence, NO_ANGLES, notes)


def _pairs(poses: Sequence[CommandedPose]) -> list[tuple[CommandedPose, CommandedPose]]:
    pairs: list[tuple[CommandedPose, CommandedPose]] = []
    for number in sorted({pose.number for pose in poses}):
        file_poses = [pose for pose in poses if pose.number == number]
        pairs += combinations(file_poses, 2) if len(file_poses) <= MAX_POSES_ALL_PAIRS else pairwise(file_poses)
    return pairs


def _notes(poses: Sequence[CommandedPose]) -> list[str]:
    if all(
        sum(pose.number == number for pose in poses) <= MAX_POSES_ALL_PAIRS
        for number in {pose.number for pose in poses}
    ):
        return []
    return [f"with more than {MAX_POSES_ALL_PAIRS} commanded poses only neighbours in order of visit are paired"]


def _matched_visits(pose_a: CommandedPose, pose_b: CommandedPose) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the matching visits of two poses: of the same cycle, else the j-th with the j-th."""
    if pose_a.cycle is not None and pose_b.cycle is not None:
        _, rows_a, rows_b = np.intersect1d(pose_a.cycle, pose_b.cycle, return_indices=True)
        if np.unique(pose_a.cycle).size == pose_a.n and np.unique(pose_b.cycle).size == pose_b.n:
            return rows_a.astype(np.int64), rows_b.astype(np.int64)
    rows = np.arange(min(pose_a.n, pose_b.n))
    return rows, rows


def _distances_between(
    pose_a: CommandedPose, pose_b: CommandedPose, rows_a: NDArray[np.int64], rows_b: NDArray[np.int64]
) -> tuple[Array, Array, Array | None]:
    """Return distances ``(n,)``, their components along the axes ``(3, n)`` and of the angles ``(3, n)``."""
    differences = pose_a.attained[:, rows_a] - pose_b.attained[:, rows_b]
    angles = None
    if pose_a.turn is not None and pose_b.turn is not None and not (pose_a.at_pole or pose_b.at_pole):
        # Relative to the references' difference, so that poses half a turn apart do not flip sign.
        angles = np.abs(
            _reference_difference(pose_a, pose_b)[:, None] + pose_a.turn[:, rows_a] - pose_b.turn[:, rows_b]
        )
    return np.sqrt(np.sum(np.square(differences), axis=0)), np.abs(differences), angles


def _reference_difference(pose_a: CommandedPose, pose_b: CommandedPose) -> Array:
    assert pose_a.reference is not None
    assert pose_b.reference is not None
    return wrapped(pose_a.reference - pose_b.reference)


def _distance_accuracy(
    pose_a: CommandedPose, pose_b: CommandedPose, rows_a: NDArray[np.int64], rows_b: NDArray[np.int64]
) -> PlaceEstimate:
    assert pose_a.commanded is not None
    assert pose_b.commanded is not None
    commanded = pose_a.commanded - pose_b.commanded
    length, axes, angles = _distances_between(pose_a, pose_b, rows_a, rows_b)
    angle_estimates = None
    if angles is not None and pose_a.oriented and pose_b.oriented:
        commanded_angles = np.abs(_reference_difference(pose_a, pose_b))
        angle_estimates = tuple(
            estimates.mean(distances, float(offset)) for distances, offset in zip(angles, commanded_angles, strict=True)
        )
    return PlaceEstimate(
        (pose_a.label, pose_b.label),
        pose_a.source,
        rows_a.size,
        estimates.mean(length, float(np.linalg.norm(commanded))),
        tuple(estimates.mean(distances, float(abs(offset))) for distances, offset in zip(axes, commanded, strict=True)),
        angle_estimates,
    )


def _distance_repeatability(
    pose_a: CommandedPose, pose_b: CommandedPose, rows_a: NDArray[np.int64], rows_b: NDArray[np.int64]
) -> PlaceEstimate:
    length, axes, angles = _distances_between(pose_a, pose_b, rows_a, rows_b)
    threefold_std: Callable[[Array], IntervalEstimate] = estimates.threefold_std
    return PlaceEstimate(
        (pose_a.label, pose_b.label),
        pose_a.source,
        rows_a.size,
        threefold_std(length),
        tuple(map(threefold_std, axes)),
        None if angles is None else tuple(map(threefold_std, angles)),
    )


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
    divided = [(pose, window_rows) for pose in poses if (window_rows := _window_rows(pose, windows)) is not None]
    if not divided:
        needed = MIN_WINDOW_VISITS * (windows or 2)
        reason = (
            f"drift needs {needed} visits of a commanded pose, {MIN_WINDOW_VISITS} in each of {windows or 2} windows"
        )
        return (
            missing_characteristic("dAP", confidence, reason),
            missing_characteristic("dRP", confidence, reason),
            missing_characteristic("shift", confidence, reason),
        )
    notes = [_window_note(divided[0][0], divided[0][1])]
    accuracy_change = missing_characteristic("dAP", confidence, NO_COMMAND)
    if all(pose.deviation is not None for pose, _ in divided):
        accuracy_change = combine_places(
            "dAP", [_accuracy_change(*entry) for entry in divided], confidence, NO_ANGLES, notes
        )
    repeatability_change = combine_places(
        "dRP", [_repeatability_change(*entry, seed) for entry in divided], confidence, NO_ANGLES, notes
    )
    return (
        accuracy_change,
        repeatability_change,
        combine_places(
            "shift",
            [_barycentre_shift(*entry) for entry in divided],
            confidence,
            "the angles' shift is their dAP",
            notes,
        ),
    )


def _window_rows(pose: CommandedPose, requested: int | None) -> list[NDArray[np.int64]] | None:
    count = requested or min(max(pose.n // USUAL_WINDOW_VISITS, 2), MAX_WINDOWS)
    return None if pose.n < MIN_WINDOW_VISITS * count else np.array_split(np.arange(pose.n), count)


def _window_note(pose: CommandedPose, window_rows: Sequence[NDArray[np.int64]]) -> str:
    order = "in the order of the file's rows"
    if pose.time is not None:
        first, last = (float(np.mean(pose.time[rows])) for rows in (window_rows[0], window_rows[-1]))
        order = f"by time_s, the first and the last {(last - first) / 60.0:.3g} min apart"
    return f"{len(window_rows)} windows of {_visit_count(window_rows)} visits, {order}; each against the first"


def _visit_count(window_rows: Sequence[NDArray[np.int64]]) -> str:
    smallest, largest = window_rows[-1].size, window_rows[0].size
    return str(largest) if smallest == largest else f"{smallest} or {largest}"


def _largest_change(
    window_rows: Sequence[NDArray[np.int64]], against_first: Callable[[int], IntervalEstimate]
) -> tuple[IntervalEstimate, int]:
    """Return the largest absolute change against the first window, and the index of its window."""
    changes = [magnitude(against_first(window)) for window in range(1, len(window_rows))]
    largest = max(range(len(changes)), key=lambda window: changes[window].value)
    return largest_estimate(changes), largest + 1


def _accuracy_change(pose: CommandedPose, window_rows: list[NDArray[np.int64]]) -> PlaceEstimate:
    deviation = pose.deviation
    assert deviation is not None
    dof = pose.n - len(window_rows)
    means = np.stack([deviation[:, rows].mean(axis=1) for rows in window_rows], axis=1)
    centred = np.concatenate(
        [deviation[:, rows] - deviation[:, rows].mean(axis=1, keepdims=True) for rows in window_rows], axis=1
    )
    covariance = centred @ centred.T / dof
    lengths = np.sqrt(np.sum(np.square(means), axis=0))
    directions = np.divide(means, lengths, out=np.zeros_like(means), where=lengths > 0.0)
    variances = np.einsum("iw,ij,jw->w", directions, covariance, directions) / [rows.size for rows in window_rows]

    def against_first(window: int) -> IntervalEstimate:
        # AP changes as the mean does along its own direction (delta method).
        return estimates.student(float(lengths[window] - lengths[0]), math.sqrt(variances[window] + variances[0]), dof)

    position, number = _largest_change(window_rows, against_first)
    angles = None
    if pose.turn is not None and pose.oriented:
        angles = tuple(_angle_accuracy_change(row, window_rows) for row in pose.turn)
    return PlaceEstimate(
        (pose.label,), pose.source, pose.n, position, None, angles, between=f"windows 1 and {number + 1}"
    )


def _angle_accuracy_change(values: NDArray[np.float64], window_rows: list[NDArray[np.int64]]) -> IntervalEstimate:
    """Return the largest change of AP_a = ā - a_c, which equals that of ā."""
    dof = len(values) - len(window_rows)
    means = [float(np.mean(values[rows])) for rows in window_rows]
    variance = (
        sum(float(np.sum(np.square(values[rows] - mean))) for rows, mean in zip(window_rows, means, strict=True)) / dof
    )

    def against_first(window: int) -> IntervalEstimate:
        standard_error = math.sqrt(variance * (1.0 / window_rows[window].size + 1.0 / window_rows[0].size))
        return estimates.student(means[window] - means[0], standard_error, dof)

    return _largest_change(window_rows, against_first)[0]


def _repeatability_change(pose: CommandedPose, window_rows: list[NDArray[np.int64]], seed: int) -> PlaceEstimate:
    estimates_by_window = []
    for index, rows in enumerate(window_rows):
        visits = pose.attained[:, rows]
        residuals = visits - visits.mean(axis=1, keepdims=True)
        estimates_by_window.append(position_repeatability(residuals, (seed, *pose.stream, index)))
    position, number = _largest_change(
        window_rows, lambda window: estimates.change(estimates_by_window[window], estimates_by_window[0])
    )
    angles = None
    if pose.turn is not None:
        angles = tuple(_angle_repeatability_change(row, window_rows) for row in pose.turn)
    return PlaceEstimate(
        (pose.label,), pose.source, pose.n, position, None, angles, between=f"windows 1 and {number + 1}"
    )


def _angle_repeatability_change(values: NDArray[np.float64], window_rows: list[NDArray[np.int64]]) -> IntervalEstimate:
    estimates_by_window = [estimates.threefold_std(values[rows]) for rows in window_rows]
    return _largest_change(
        window_rows, lambda window: estimates.change(estimates_by_window[window], estimates_by_window[0])
    )[0]


def _barycentre_shift(pose: CommandedPose, window_rows: list[NDArray[np.int64]]) -> PlaceEstimate:
    first, *later = (pose.attained[:, rows] for rows in window_rows)
    shifts = [separation([first, visits], ("", ""), None)[0] for visits in later]
    position, number = _largest_change(window_rows, lambda window: shifts[window - 1])
    return PlaceEstimate((pose.label,), pose.source, pose.n, position, between=f"windows 1 and {number + 1}")
