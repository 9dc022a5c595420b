"""Distance accuracy and distance repeatability: clause 7.3 of ISO 9283:1998.

With D_j = |p_1j - p_2j| between the j-th visits of two commanded poses and D_c = |p_c1 - p_c2|:

    AD_p = D̄ - D_c,   RD_p = ± 3 S_D,   S_D^2 = sum (D_j - D̄)^2 / (n - 1)

and likewise for D_x = |x_1 - x_2| … and the angles' D_a = |a_1 - a_2| …; registration of frames has no effect.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.iso_9283 import estimates
from robacc.iso_9283.characteristics import PlaceEstimate, combine_places, missing_characteristic
from robacc.iso_9283.estimates import IntervalEstimate
from robacc.iso_9283.pose_criteria import NO_ANGLES, NO_COMMAND
from robacc.iso_9283.records import Characteristic
from robacc.iso_9283.visits import CommandedPose, wrapped

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
        accuracy = combine_places("AD", [_accuracy_estimate(*entry) for entry in matched], confidence, NO_ANGLES, notes)
    repeatable = [_repeatability_estimate(*entry) for entry in matched if entry[2].size > 1]
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


def _accuracy_estimate(
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


def _repeatability_estimate(
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
