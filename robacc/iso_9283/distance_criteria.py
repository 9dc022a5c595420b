"""Distance accuracy and repeatability: clause 7.3 of ISO 9283:1998.

With D_j = |p_1j - p_2j| between the j-th visits of two commanded poses and D_c = |p_c1 - p_c2|:

    AD_p = D̄ - D_c,   RD_p = ± 3 S_D,   S_D^2 = sum (D_j - D̄)^2 / (n - 1)

and alike for D_x = |x_1 - x_2| … and the angles' D_a = |a_1 - a_2| …; no alignment of frames takes part.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.iso_9283 import estimates
from robacc.iso_9283.collecting import Found, absent, collected
from robacc.iso_9283.estimates import IntervalEstimate
from robacc.iso_9283.pose_criteria import NO_ANGLES, NO_COMMAND
from robacc.iso_9283.records import Characteristic
from robacc.iso_9283.visits import CommandedPose, wrapped

MOST_POSES = 10
"""With more commanded poses only neighbours in the order of their first visit are paired."""
_ONE_POSE = "one commanded pose has no distances"


def distance_criteria(poses: Sequence[CommandedPose], confidence: float) -> tuple[Characteristic, Characteristic]:
    """AD and RD between the commanded poses of each file."""
    pairs = _pairs(poses)
    if not pairs:
        return absent("AD", confidence, _ONE_POSE), absent("RD", confidence, _ONE_POSE)
    matched = [(one, other, *_matched(one, other)) for one, other in pairs]
    matched = [entry for entry in matched if entry[2].size > 0]
    if not matched:
        why = "no cycle has a visit of two commanded poses"
        return absent("AD", confidence, why), absent("RD", confidence, why)
    notes = _notes(poses)
    accurate = absent("AD", confidence, NO_COMMAND)
    if all(pose.commanded is not None for pose in poses):
        accurate = collected("AD", [_accuracy(*entry) for entry in matched], confidence, NO_ANGLES, notes)
    repeated = [_repeatability(*entry) for entry in matched if entry[2].size > 1]
    if not repeated:
        return accurate, absent("RD", confidence, "every pair of commanded poses was visited once: RD needs cycles")
    return accurate, collected("RD", repeated, confidence, NO_ANGLES, notes)


def _pairs(poses: Sequence[CommandedPose]) -> list[tuple[CommandedPose, CommandedPose]]:
    pairs: list[tuple[CommandedPose, CommandedPose]] = []
    for number in sorted({pose.number for pose in poses}):
        own = [pose for pose in poses if pose.number == number]
        pairs += combinations(own, 2) if len(own) <= MOST_POSES else pairwise(own)
    return pairs


def _notes(poses: Sequence[CommandedPose]) -> list[str]:
    if all(sum(pose.number == number for pose in poses) <= MOST_POSES for number in {pose.number for pose in poses}):
        return []
    return [f"with more than {MOST_POSES} commanded poses only neighbours in order of visit are paired"]


def _matched(one: CommandedPose, other: CommandedPose) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Visits of two poses that belong together: of the same cycle, else the j-th with the j-th."""
    if one.cycle is not None and other.cycle is not None:
        _, first, second = np.intersect1d(one.cycle, other.cycle, return_indices=True)
        if np.unique(one.cycle).size == one.n and np.unique(other.cycle).size == other.n:
            return first.astype(np.int64), second.astype(np.int64)
    both = np.arange(min(one.n, other.n))
    return both, both


def _distances(
    one: CommandedPose, other: CommandedPose, first: NDArray[np.int64], second: NDArray[np.int64]
) -> tuple[Array, Array, Array | None]:
    """``(n,)`` distances, ``(3, n)`` along the axes, ``(3, n)`` of the angles."""
    apart = one.attained[:, first] - other.attained[:, second]
    angles = None
    if one.turn is not None and other.turn is not None and not (one.at_pole or other.at_pole):
        # From the reference's difference on, so that half a turn apart is not once plus and once minus.
        angles = np.abs(_reference_apart(one, other)[:, None] + one.turn[:, first] - other.turn[:, second])
    return np.sqrt(np.sum(np.square(apart), axis=0)), np.abs(apart), angles


def _reference_apart(one: CommandedPose, other: CommandedPose) -> Array:
    assert one.reference is not None
    assert other.reference is not None
    return wrapped(one.reference - other.reference)


def _accuracy(one: CommandedPose, other: CommandedPose, first: NDArray[np.int64], second: NDArray[np.int64]) -> Found:
    assert one.commanded is not None
    assert other.commanded is not None
    apart = one.commanded - other.commanded
    length, axes, angles = _distances(one, other, first, second)
    turned = None
    if angles is not None and one.oriented and other.oriented:
        wanted = np.abs(_reference_apart(one, other))
        turned = tuple(estimates.mean(row, float(offset)) for row, offset in zip(angles, wanted, strict=True))
    return Found(
        (one.label, other.label),
        one.source,
        first.size,
        estimates.mean(length, float(np.linalg.norm(apart))),
        tuple(estimates.mean(row, float(abs(offset))) for row, offset in zip(axes, apart, strict=True)),
        turned,
    )


def _repeatability(
    one: CommandedPose, other: CommandedPose, first: NDArray[np.int64], second: NDArray[np.int64]
) -> Found:
    length, axes, angles = _distances(one, other, first, second)
    spread: Callable[[Array], IntervalEstimate] = estimates.threefold_sd
    return Found(
        (one.label, other.label),
        one.source,
        first.size,
        spread(length),
        tuple(map(spread, axes)),
        None if angles is None else tuple(map(spread, angles)),
    )
