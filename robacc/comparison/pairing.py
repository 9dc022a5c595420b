"""Pairing of two results by commanded pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.comparison.compared_result import ComparedPoses, ErrorSet
from robacc.comparison.differences import ErrorSample
from robacc.geometry import Array
from robacc.measurements import commanded_groups

_SAME_JOINT = 1e-6
"""Largest difference of equal joint commands, rad or m: below any encoder's step, above the rounding of a file."""
_SAME_POSITION = 1e-4
"""Largest distance of equal commanded positions, m, for arms or alignments that differ."""
_ENOUGH = 0.5
"""Smallest share of common poses, of either result's poses, for a paired comparison."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairing:
    """Two sets of errors as samples for :func:`robacc.comparison.differences.difference`."""

    first: ErrorSample
    second: ErrorSample
    paired: bool
    n_first: int
    """Commanded poses of the complete set."""
    n_second: int


@dataclass(frozen=True, slots=True)
class PoseMatch:
    """Match of the poses of two results."""

    first: str
    second: str
    """Names of the results."""
    paired: bool
    shared: int
    """Common commanded poses; 0 without pairs."""
    n_first: int
    """Commanded poses of each result."""
    n_second: int


def pair_poses(first: ErrorSet, second: ErrorSet) -> Pairing:
    """Pair the errors of common commanded poses; with too few common poses, return both complete sets unpaired."""
    samples = [unpaired_sample(errors) for errors in (first, second)]
    sizes = [sample.n_groups for sample in samples]
    keys = _common_keys(first.poses, second.poses)
    if keys is not None:
        common = np.intersect1d(keys[0], keys[1])
        if common.size >= max(2, _ENOUGH * max(np.unique(numbers).size for numbers in keys)):
            samples = []
            for errors, numbers in zip((first, second), keys, strict=True):
                rows = np.isin(numbers, common)
                samples.append(ErrorSample(errors.vectors[:, rows], np.searchsorted(common, numbers[rows])))
            return Pairing(samples[0], samples[1], True, *sizes)
    return Pairing(samples[0], samples[1], False, *sizes)


def unpaired_sample(errors: ErrorSet) -> ErrorSample:
    """Return a complete set of errors, grouped by its commanded poses."""
    return ErrorSample(errors.vectors, _numbered(_pose_numbers(errors.poses)))


def _numbered(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.unique(keys, return_inverse=True)[1].astype(np.int64)


def _pose_numbers(poses: ComparedPoses) -> NDArray[np.int64]:
    """Return the number of each row's commanded pose: by id, else by joints, else by position, as measurements do."""
    groups = commanded_groups(poses.pose, poses.q if poses.q is not None else poses.commanded)
    return np.arange(poses.n, dtype=np.int64) if groups is None else groups.numbers


def _common_keys(first: ComparedPoses, second: ComparedPoses) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Return numbers of commanded poses with the same meaning in both results; None if nothing relates the poses.

    Rows are matched in order if both results have the same rows; otherwise by the joints, or by ids that name the
    same positions.
    """
    same_joints = first.q is not None and second.q is not None and first.q.shape[0] == second.q.shape[0]
    if first.n == second.n and _same_targets(first, second):
        close = same_joints and _close(first.q, second.q, _SAME_JOINT)
        if close or _close(first.commanded, second.commanded, _SAME_POSITION):
            # A pose repeated in one result is one pose in both.
            keys = _numbered(_pose_numbers(first))
            return keys, keys
    if same_joints and first.q is not None and second.q is not None:
        return _numbers_by_joints(np.round(first.q / _SAME_JOINT), np.round(second.q / _SAME_JOINT))
    if first.pose is not None and second.pose is not None and _same_positions(first, second):
        return _numbers_by_id(first.pose, second.pose)
    return None


def _close(first: Array | None, second: Array | None, tolerance: float) -> bool:
    return (
        first is not None
        and second is not None
        and first.shape == second.shape
        and bool(np.all(np.abs(first - second) <= tolerance))
    )


def _same_targets(first: ComparedPoses, second: ComparedPoses) -> bool:
    if first.target is None or second.target is None:
        return first.target is second.target
    return bool(np.array_equal(first.target, second.target))


def _numbers_by_joints(first: Array, second: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    numbers = np.unique(np.concatenate((first, second), axis=1), axis=1, return_inverse=True)[1]
    numbers = numbers.ravel().astype(np.int64)
    return numbers[: first.shape[1]], numbers[first.shape[1] :]


def _numbers_by_id(first: NDArray[np.str_], second: NDArray[np.str_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    numbers = np.unique(np.concatenate((first, second)), return_inverse=True)[1].astype(np.int64)
    return numbers[: first.size], numbers[first.size :]


def _same_positions(first: ComparedPoses, second: ComparedPoses) -> bool:
    """Return whether equal ids have equal commanded positions, as far as both results list positions."""
    if first.commanded is None or second.commanded is None or first.pose is None or second.pose is None:
        return True
    positions = dict(zip(first.pose.tolist(), first.commanded.T, strict=True))
    return all(
        float(np.max(np.abs(positions[name] - position))) <= _SAME_POSITION
        for name, position in zip(second.pose.tolist(), second.commanded.T, strict=True)
        if name in positions
    )
