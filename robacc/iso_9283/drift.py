"""Drift of pose characteristics over the run: clause 7.6 of ISO 9283:1998.

The visits of each commanded pose, in the order of their time (of the file's rows where there is none), are cut into
windows of equally many. With t = 0 the first window and T any later one:

    dAP_p = max |AP_p(t = 0) - AP_p(t = T)|,   dRP_p = max |RP_l(t = 0) - RP_l(t = T)|,   angles alike

AP is a length and can stand while the pose wanders round the command, so the shift of the barycentre itself stands
beside: max |p̄(t = T) - p̄(t = 0)|.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.iso_9283 import estimates
from robacc.iso_9283.collecting import Found, absent, collected, separation
from robacc.iso_9283.estimates import IntervalEstimate, largest_of, size
from robacc.iso_9283.pose_criteria import NO_ANGLES, NO_COMMAND
from robacc.iso_9283.records import Characteristic
from robacc.iso_9283.repeatability import position_repeatability
from robacc.iso_9283.visits import CommandedPose

FEWEST = 3
"""Visits of a window: with two, RP is nearly nothing but chance."""
USUAL = 10
MOST_WINDOWS = 10


def drift(
    poses: Sequence[CommandedPose], confidence: float, seed: int, windows: int | None = None
) -> tuple[Characteristic, Characteristic, Characteristic]:
    """dAP, dRP and the barycentre's shift; ``windows`` None: as many as have ten visits each, two to ten.

    Poses with fewer than six visits (three a window) take no part.
    """
    cut = [(pose, parts) for pose in poses if (parts := _windows(pose, windows)) is not None]
    if not cut:
        fewest = FEWEST * (windows or 2)
        why = f"drift needs {fewest} visits of a commanded pose, {FEWEST} in each of {windows or 2} windows"
        return absent("dAP", confidence, why), absent("dRP", confidence, why), absent("shift", confidence, why)
    notes = [_described(cut[0][0], cut[0][1])]
    accurate = absent("dAP", confidence, NO_COMMAND)
    if all(pose.deviation is not None for pose, _ in cut):
        accurate = collected("dAP", [_of_accuracy(*entry) for entry in cut], confidence, NO_ANGLES, notes)
    repeated = collected("dRP", [_of_repeatability(*entry, seed) for entry in cut], confidence, NO_ANGLES, notes)
    return (
        accurate,
        repeated,
        collected("shift", [_shift(*entry) for entry in cut], confidence, "the angles' shift is their dAP", notes),
    )


def _windows(pose: CommandedPose, windows: int | None) -> list[NDArray[np.int64]] | None:
    count = windows or min(max(pose.n // USUAL, 2), MOST_WINDOWS)
    return None if pose.n < FEWEST * count else np.array_split(np.arange(pose.n), count)


def _described(pose: CommandedPose, parts: Sequence[NDArray[np.int64]]) -> str:
    order = "in the order of the file's rows"
    if pose.time is not None:
        first, last = (float(np.mean(pose.time[part])) for part in (parts[0], parts[-1]))
        order = f"by time_s, the first and the last {(last - first) / 60.0:.3g} min apart"
    return f"{len(parts)} windows of {_counted(parts)} visits, {order}; each against the first"


def _counted(parts: Sequence[NDArray[np.int64]]) -> str:
    fewest, most = parts[-1].size, parts[0].size
    return str(most) if fewest == most else f"{fewest} or {most}"


def _greatest(
    parts: Sequence[NDArray[np.int64]], against_first: Callable[[int], IntervalEstimate]
) -> tuple[IntervalEstimate, int]:
    """The largest size of a change against the first window, and the window."""
    changes = [size(against_first(i)) for i in range(1, len(parts))]
    worst = max(range(len(changes)), key=lambda i: changes[i].value)
    return largest_of(changes), worst + 1


def _of_accuracy(pose: CommandedPose, parts: list[NDArray[np.int64]]) -> Found:
    deviation = pose.deviation
    assert deviation is not None
    dof = pose.n - len(parts)
    means = np.stack([deviation[:, part].mean(axis=1) for part in parts], axis=1)
    within = np.concatenate(
        [deviation[:, part] - deviation[:, part].mean(axis=1, keepdims=True) for part in parts], axis=1
    )
    covariance = within @ within.T / dof
    lengths = np.sqrt(np.sum(np.square(means), axis=0))
    along = np.divide(means, lengths, out=np.zeros_like(means), where=lengths > 0.0)
    variance = np.einsum("iw,ij,jw->w", along, covariance, along) / [part.size for part in parts]

    def against_first(i: int) -> IntervalEstimate:
        # AP moves as the mean does along its own direction (delta method).
        return estimates.student(float(lengths[i] - lengths[0]), math.sqrt(variance[i] + variance[0]), dof)

    position, window = _greatest(parts, against_first)
    angles = None
    if pose.turn is not None and pose.oriented:
        angles = tuple(_mean_change(row, parts) for row in pose.turn)
    return Found((pose.label,), pose.source, pose.n, position, None, angles, between=f"windows 1 and {window + 1}")


def _mean_change(values: NDArray[np.float64], parts: list[NDArray[np.int64]]) -> IntervalEstimate:
    """Largest change of AP_a = ā - a_c, which is that of ā."""
    dof = len(values) - len(parts)
    means = [float(np.mean(values[part])) for part in parts]
    variance = sum(float(np.sum(np.square(values[part] - m))) for part, m in zip(parts, means, strict=True)) / dof

    def against_first(i: int) -> IntervalEstimate:
        error = math.sqrt(variance * (1.0 / parts[i].size + 1.0 / parts[0].size))
        return estimates.student(means[i] - means[0], error, dof)

    return _greatest(parts, against_first)[0]


def _of_repeatability(pose: CommandedPose, parts: list[NDArray[np.int64]], seed: int) -> Found:
    each = []
    for number, part in enumerate(parts):
        visits = pose.attained[:, part]
        residuals = visits - visits.mean(axis=1, keepdims=True)
        each.append(position_repeatability(residuals, (seed, *pose.stream, number)))
    position, window = _greatest(parts, lambda i: estimates.change(each[i], each[0]))
    angles = None
    if pose.turn is not None:
        angles = tuple(_spread_change(row, parts) for row in pose.turn)
    return Found((pose.label,), pose.source, pose.n, position, None, angles, between=f"windows 1 and {window + 1}")


def _spread_change(values: NDArray[np.float64], parts: list[NDArray[np.int64]]) -> IntervalEstimate:
    each = [estimates.threefold_sd(values[part]) for part in parts]
    return _greatest(parts, lambda i: estimates.change(each[i], each[0]))[0]


def _shift(pose: CommandedPose, parts: list[NDArray[np.int64]]) -> Found:
    first, *later = (pose.attained[:, part] for part in parts)
    found = [separation([first, visits], ("", ""), None)[0] for visits in later]
    position, window = _greatest(parts, lambda i: found[i - 1])
    return Found((pose.label,), pose.source, pose.n, position, between=f"windows 1 and {window + 1}")
