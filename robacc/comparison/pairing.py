"""Which rows of two results are of the same commanded pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.comparison.compared_result import ComparedPoses, ErrorSet
from robacc.comparison.differences import ErrorSample
from robacc.geometry import Array
from robacc.measurements import commanded_groups

_SAME_JOINT = 1e-6
"""Joints this near, rad or m, are commanded alike: below any encoder's step, above what a file's digits lose."""
_SAME_PLACE = 1e-4
"""Commanded positions this near, m, are the same place, though two arms' joints or an alignment differ."""
_ENOUGH = 0.5
"""Poses in common are compared in pairs where they are this share of either result's."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairing:
    """Two sets of errors as samples for :func:`robacc.comparison.differences.difference`."""

    first: ErrorSample
    second: ErrorSample
    paired: bool
    n_first: int
    """Commanded poses of the whole set."""
    n_second: int


def pair(first: ErrorSet, second: ErrorSet) -> Pairing:
    """Pair what is of the same poses; where too little is, each set stands for itself."""
    keys = _common_keys(first.poses, second.poses)
    own = [_numbered(_own_keys(one.poses)) for one in (first, second)]
    sizes = [int(one.max()) + 1 for one in own]
    if keys is not None:
        both = np.intersect1d(keys[0], keys[1])
        if both.size >= max(2, _ENOUGH * max(np.unique(one).size for one in keys)):
            samples = []
            for errors, key in zip((first, second), keys, strict=True):
                rows = np.isin(key, both)
                samples.append(ErrorSample(errors.vectors[:, rows], np.searchsorted(both, key[rows])))
            return Pairing(samples[0], samples[1], True, *sizes)
    return Pairing(ErrorSample(first.vectors, own[0]), ErrorSample(second.vectors, own[1]), False, *sizes)


def whole(errors: ErrorSet) -> ErrorSample:
    """A set of errors by its own commanded poses."""
    return ErrorSample(errors.vectors, _numbered(_own_keys(errors.poses)))


def _numbered(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.unique(keys, return_inverse=True)[1].astype(np.int64)


def _own_keys(poses: ComparedPoses) -> NDArray[np.int64]:
    """Number of each row's commanded pose, by its id, else its joints, else its place, as measurements have it."""
    found = commanded_groups(poses.pose, poses.q if poses.q is not None else poses.commanded)
    return np.arange(poses.n, dtype=np.int64) if found is None else found.numbers


def _common_keys(first: ComparedPoses, second: ComparedPoses) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Numbers of commanded poses that mean the same in both; None where nothing says which are the same.

    Row by row where both have the same rows in the same order; else by the joints, or by the ids where they name the
    same places.
    """
    same_joints = first.q is not None and second.q is not None and first.q.shape[0] == second.q.shape[0]
    if first.n == second.n and _same_targets(first, second):
        close = same_joints and _close(first.q, second.q, _SAME_JOINT)
        if close or _close(first.commanded, second.commanded, _SAME_PLACE):
            # What is repeated in either is one pose in both.
            keys = _numbered(_own_keys(first))
            return keys, keys
    if same_joints and first.q is not None and second.q is not None:
        return _matched(first, second, np.round(first.q / _SAME_JOINT), np.round(second.q / _SAME_JOINT))
    if first.pose is not None and second.pose is not None and _same_places(first, second):
        return _by_text(first.pose, second.pose)
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


def _matched(
    first: ComparedPoses, second: ComparedPoses, one: Array, other: Array
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    number = np.unique(np.concatenate((one, other), axis=1), axis=1, return_inverse=True)[1].ravel().astype(np.int64)
    return number[: first.n], number[first.n :]


def _by_text(one: NDArray[np.str_], other: NDArray[np.str_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    number = np.unique(np.concatenate((one, other)), return_inverse=True)[1].astype(np.int64)
    return number[: one.size], number[one.size :]


def _same_places(first: ComparedPoses, second: ComparedPoses) -> bool:
    """Whether equal ids stand for equal commanded positions, where both say what those are."""
    if first.commanded is None or second.commanded is None or first.pose is None or second.pose is None:
        return True
    places = dict(zip(first.pose.tolist(), first.commanded.T, strict=True))
    return all(
        float(np.max(np.abs(places[name] - place))) <= _SAME_PLACE
        for name, place in zip(second.pose.tolist(), second.commanded.T, strict=True)
        if name in places
    )
