"""Poses that lie close together; repetitions of one commanded pose whose joints were logged as read."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.measurements import Measurements

MOST_POSES = 5000
"""Largest number of poses that are compared; more are close to others in any case."""
_NEAR = 5e-4
"""rad or m; distance of two readings of a joint at one commanded pose at most. Servo errors are smaller, and the error
of an arm hardly changes over it."""
_EVIDENT = 0.25
"""Share of the rows that repeat a pose from which a file has repetitions."""


def with_repetitions(data: Measurements) -> tuple[Measurements, str | None]:
    """Return data without ids of poses with ids of those that were repeated, and a remark; unchanged if there are none.

    Joints that were logged as read differ a little from visit to visit of one commanded pose.
    """
    if data.pose is not None or data.q is None or not 2 <= data.n <= MOST_POSES:
        return data, None
    groups = data.groups()
    if np.unique(groups).size < data.n:
        return data, None
    place = close_groups(data.q, _NEAR, 2.0 * _NEAR)
    count = np.bincount(place)
    if np.mean(count[place] > 1) < _EVIDENT:
        return data, None
    names, number = np.unique(place, return_inverse=True)
    ids = np.array([f"P{k + 1}" for k in range(names.size)])[number]
    remark = (
        f"{data.n} rows are read as {names.size} commanded poses and their repetitions, because joints differ "
        f"by less than {1e3 * _NEAR:g} mrad (mm); a pose column states repetitions"
    )
    return dataclasses.replace(data, pose=ids), remark


def close_groups(values: Array, near: float, widest: float) -> NDArray[np.int64]:
    """Return ``(P,)`` a number that columns of ``(K, P)`` share if they are linked by steps of at most ``near``.

    A group that extends over more than ``widest`` in a row of ``values``, such as a sweep of a joint, is none.
    """
    place = np.arange(values.shape[1])
    first, second = _close_pairs(values, near)
    while True:
        # The lowest number spreads along the pairs.
        lowest = np.minimum(place[first], place[second])
        before = place.copy()
        np.minimum.at(place, first, lowest)
        np.minimum.at(place, second, lowest)
        if np.array_equal(place, before):
            break
    low, high = (np.full(values.shape, start) for start in (np.inf, -np.inf))
    for row, lower, upper in zip(values, low, high, strict=True):
        np.minimum.at(lower, place, row)
        np.maximum.at(upper, place, row)
    wide = (high - low).max(axis=0) > widest
    return np.where(wide[place], np.arange(place.size), place)


def _close_pairs(values: Array, near: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the pairs of columns that differ by at most ``near`` in each row, the lower in the first row first."""
    order = np.argsort(values[0], kind="stable")
    ends = np.searchsorted(values[0, order], values[0, order] + near, side="right")
    firsts, seconds = [], []
    for i, end in enumerate(ends):
        others = order[i + 1 : end]
        close = others[np.abs(values[:, others] - values[:, order[i], None]).max(axis=0, initial=0.0) <= near]
        firsts.append(np.full(close.size, order[i]))
        seconds.append(close)
    return np.concatenate(firsts).astype(np.int64), np.concatenate(seconds).astype(np.int64)
