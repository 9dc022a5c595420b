"""Drift of pose characteristics over the run: clause 7.6 of ISO 9283:1998.

The visits of each commanded pose, ordered by time (by the file's rows if no time was logged), are divided into windows
of equal size. With t = 0 the first window and T any later one:

    dAP_p = max |AP_p(t = 0) - AP_p(t = T)|,   dRP_p = max |RP_l(t = 0) - RP_l(t = T)|,   angles likewise

AP is a length and can stay constant while the pose moves around the command, so the shift of the barycentre itself is
reported too: max |p̄(t = T) - p̄(t = 0)|.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.iso_9283 import estimates
from robacc.iso_9283.characteristics import PlaceEstimate, combine_places, missing_characteristic, separation
from robacc.iso_9283.estimates import IntervalEstimate, largest_estimate, magnitude
from robacc.iso_9283.pose_criteria import NO_ANGLES, NO_COMMAND
from robacc.iso_9283.records import Characteristic
from robacc.iso_9283.repeatability import position_repeatability
from robacc.iso_9283.visits import CommandedPose

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
